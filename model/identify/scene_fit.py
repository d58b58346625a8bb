"""Identification of the parameters of a whole scene: rollouts against measured force, from many starts."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import casadi as ca
import numpy as np
from scipy.stats import qmc

from tissue_contact.errors import InputError
from tissue_contact.identify.least_squares import Fit, fit, weights
from tissue_contact.identify.recording import Real
from tissue_contact.identify.result import Fitted, HeldOut
from tissue_contact.identify.rollouts import Drive, ForceModel, as_casadi
from tissue_contact.identify.statistics import folds
from tissue_contact.identify.verdicts import estimates_of, numbers, tried
from tissue_contact.pool import Kept, Spread, in_line
from tissue_contact.settings import nearest
from tissue_contact.variables import Variable

TOLERANCE = 1e-6  # of a search: rollouts jump by more as single points come into contact
REACH = 10.0  # further starts lie between the scene's value over this and times this


class Maker(Protocol):
    """Makes the force model of some drives anew, in whatever process; can be pickled."""

    def __call__(self, drives: Sequence[Drive]) -> ForceModel: ...


@dataclass(frozen=True)
class SceneOptions:
    """What the user chose."""

    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)  # narrower than the scene's
    loss: str = "linear"
    starts: int = 1
    grid: Mapping[str, tuple[float, float, int]] = field(default_factory=dict)  # least, greatest, number of each
    folds: int = 5
    seed: int = 0  # of starts and folds


@dataclass(frozen=True, eq=False)
class _Task:
    make: Maker
    drives: Sequence[Drive]
    start: Real
    lower: Real
    upper: Real
    loss: str
    unseen: Sequence[Drive] = ()


class _Traced:
    """The force of some drives, and its Jacobian, as casadi evaluates them."""

    def __init__(self, make: Maker, drives: Sequence[Drive]) -> None:
        self.measured = np.concatenate([d.measured for d in drives])
        self._force = as_casadi(make(drives), len(self.measured))  # what is made of it does not keep it alive
        constants = ca.MX.sym("parameters", self._force.size1_in(0))
        force = self._force(constants)
        self._values = ca.Function("values", [constants], [force])
        self._slopes = ca.Function("slopes", [constants], [ca.jacobian(force, constants)])

    def values(self, constants: Real) -> Real:
        return np.asarray(self._values(constants)).ravel()

    def slopes(self, constants: Real) -> Real:
        return np.asarray(self._slopes(constants))


def _from_start(task: _Task) -> dict[str, Any]:
    model = _Traced(task.make, task.drives)
    found = fit(model, model.measured, [task.start], task.lower, task.upper, task.loss, tolerance=TOLERANCE)
    missed: list[float] = []
    if task.unseen:
        unseen = _Traced(task.make, task.unseen)
        missed = (unseen.values(found.values) - unseen.measured).tolist()
    return {
        "values": found.values.tolist(),
        "cost": found.cost,
        "noise": found.noise,
        "evaluations": found.evaluations,
        "converged": found.converged,
        "message": found.message,
        "missed": missed,
    }


def _cost_at(task: _Task) -> float:
    measured = np.concatenate([d.measured for d in task.drives])
    residual = task.make(task.drives).values(task.start) - measured
    return 0.5 * float(residual @ residual)


@dataclass(frozen=True, eq=False)
class SceneFit:
    """What the fit of a scene came to."""

    fitted: Fitted
    held_out: tuple[HeldOut, ...]
    values: Real  # in the order of the wanted parameters
    force: Real  # [N] at them, shape [samples · 3]
    measured: Real
    starts: list[dict[str, Any]]  # values, cost and evaluations from every start
    grid: tuple[Real, Real] | None  # points, shape [n, p], and their costs


def fit_scene(
    make: Maker,
    drives: Sequence[Drive],
    variables: Sequence[Variable],
    start: Real,
    options: SceneOptions,
    kept: Kept,
    spread: Spread = in_line,
    on_plan: Callable[[int], None] = lambda tasks: None,
    on_done: Callable[[], None] = lambda: None,
) -> SceneFit:
    """Fit the wanted parameters to all drives from several starts, and to all but some.

    Parameters
    ----------
    make
        Makes the force model.
    drives
        One for every recording.
    variables
        The wanted parameters, with their ranges.
    start : shape [p]
        Values of the scene, where the first fit begins.
    options
    kept
        File in which finished work is kept.
    spread
        From `pool`.
    on_plan, on_done
        Told the number of tasks, and whenever one is done.
    """
    names = [v.name for v in variables]
    for option, given in (("--bounds", options.bounds), ("--grid", options.grid)):
        for name in given:
            if name not in names:
                rule = "it must be for a parameter that --parameter names"
                raise InputError(option, rule, name, nearest(name, names, what="parameters"))
    limits = np.array([_limits(v, options) for v in variables])
    lower, upper = limits[:, 0], limits[:, 1]
    points = _grid(variables, start, options)
    parts = folds(len(drives), options.folds, options.seed) if len(drives) > 1 else []
    on_plan(len(points) + options.starts + len(parts))

    def task(at: Real, seen: Sequence[Drive] = drives, unseen: Sequence[Drive] = ()) -> _Task:
        return _Task(make, seen, np.clip(at, lower, upper), lower, upper, options.loss, unseen)

    costs = kept.spread(spread, _cost_at, [task(p) for p in points], [f"grid {p.tolist()}" for p in points], on_done)
    begin = points[int(np.argmin(costs))] if costs else start
    starts = _starts(begin, lower, upper, options)
    runs = kept.spread(spread, _from_start, [task(s) for s in starts], [f"start {s.tolist()}" for s in starts], on_done)
    best = min(runs, key=lambda run: run["cost"])
    values = np.array(best["values"])
    model = _Traced(make, drives)
    measured = model.measured
    force, jacobian = model.values(values), model.slopes(values)
    found = Fit(
        values, force - measured, jacobian, weights((force - measured) / best["noise"], options.loss), best["noise"],
        best["cost"],
        sum(run["evaluations"] for run in runs), best["converged"], best["message"],
    )  # fmt: skip
    estimates, correlation = estimates_of(found, names, [v.unit for v in variables], lower, upper)
    fitted = numbers(found, measured, "pooled", "all probes", "scene", estimates, correlation)
    folded = [([drives[k] for k in rest], [drives[k] for k in part]) for rest, part in parts]
    keys = [f"fold {part} from {values.tolist()}" for _, part in parts]
    runs_held = kept.spread(spread, _from_start, [task(values, *f) for f in folded], keys, on_done)
    errors = [
        (np.array(run["missed"]), np.concatenate([d.measured for d in unseen]))
        for run, (_, unseen) in zip(runs_held, folded, strict=True)
    ]
    held_out = (tried("scene", "probes", errors),) if errors else ()
    grid = (np.array(points), np.array(costs)) if costs else None
    return SceneFit(fitted, held_out, values, force, measured, runs, grid)


def _limits(variable: Variable, options: SceneOptions) -> tuple[float, float]:
    low, high = options.bounds.get(variable.name, (variable.minimum, variable.maximum))
    if not variable.minimum <= low < high <= variable.maximum:
        rule = f"bounds of {variable.name} must be in order and within {variable.minimum:g} to {variable.maximum:g}"
        raise InputError("--bounds", f"{rule} {variable.unit}", f"{low:g}:{high:g}", "Choose within")
    return low, high


def _starts(begin: Real, lower: Real, upper: Real, options: SceneOptions) -> list[Real]:
    """The first start, then others spread evenly over the logarithms round it."""
    low, high = np.fmax(lower, begin / REACH), np.fmin(upper, begin * REACH)
    starts = [begin]
    if options.starts > 1:
        share = qmc.Sobol(len(begin), rng=options.seed).random(options.starts - 1)
        with np.errstate(divide="ignore", invalid="ignore"):
            spread = np.where(low > 0.0, low * (high / np.where(low > 0.0, low, 1.0)) ** share, high * share)
        starts += list(spread)
    return starts


def _grid(variables: Sequence[Variable], start: Real, options: SceneOptions) -> list[Real]:
    if not options.grid:
        return []
    for v in variables:
        low, high, count = options.grid.get(v.name, (*_limits(v, options), 1))
        least, greatest = _limits(v, options)
        if not (least <= low <= high <= greatest and count >= 1):
            rule = f"a grid of {v.name} must lie in order between {least:g} and {greatest:g} {v.unit}, with a count"
            raise InputError("--grid", rule, f"{low:g}:{high:g}:{count}", "Choose within its bounds")
    axes = [
        np.linspace(*options.grid[v.name]) if v.name in options.grid else np.array([start[k]])
        for k, v in enumerate(variables)
    ]
    return list(np.stack([part.ravel() for part in np.meshgrid(*axes, indexing="ij")], axis=1))
