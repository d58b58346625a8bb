"""Identification of a contact law alone: from depth, rate of depth and force, without a deforming tissue."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from tissue_contact.errors import InputError
from tissue_contact.identify.laws import LAWS, VISCOUS, Constant, Force, Touches, constants_of
from tissue_contact.identify.least_squares import Fit, fit
from tissue_contact.identify.recording import Real
from tissue_contact.identify.result import Estimate, Fitted, HeldOut
from tissue_contact.identify.statistics import folds
from tissue_contact.identify.verdicts import estimates_of, numbers, tried
from tissue_contact.pool import Spread, in_line
from tissue_contact.settings import nearest

EXPONENTS = (1.2, 2.0, 2.8)  # from which a fit starts, within the range of the scene
VISCOUS_SHARE = 0.1  # of the force at a start
SMALLEST = 4  # samples: fewer are not worth a fit of their own


Place = tuple[str, str, str]  # law, scope and label of a fit


@dataclass(frozen=True, eq=False)
class Probe:
    """Geometry and force of one recording."""

    label: str
    region: str
    touches: Touches
    force: Real  # [N], shape [samples · d]


@dataclass(frozen=True)
class Options:
    """What the user chose."""

    laws: tuple[str, ...] = tuple(LAWS)
    per_area: bool = False
    given: Mapping[str, float] = field(default_factory=dict)  # constants that are not fitted
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)  # narrower than the scene's
    loss: str = "linear"
    folds: int = 5
    seed: int = 0  # of the folds


@dataclass(frozen=True, eq=False)
class _Task:
    """A fit that another process can do."""

    law: str
    touches: Touches
    force: Real
    options: Options
    has_rate: bool
    unseen: tuple[Touches, Real] | None = None  # on which the fit is tried


@dataclass(frozen=True, eq=False)
class _Done:
    fit: Fit
    wanted: tuple[int, ...]  # the constants that were fitted
    missed: Real  # residual on the unseen
    constants: Real  # all of the law


@dataclass(frozen=True, eq=False)
class _Wanted:
    """A force as a function of some of its constants."""

    force: Force
    whole: Real  # all constants, of which the others stay
    wanted: tuple[int, ...]

    def _full(self, constants: Real) -> Real:
        full = self.whole.copy()
        full[list(self.wanted)] = constants
        return full

    def values(self, constants: Real) -> Real:
        return self.force.values(self._full(constants))

    def slopes(self, constants: Real) -> Real:
        return self.force.slopes(self._full(constants))[:, list(self.wanted)]


def _fit(task: _Task) -> _Done:
    options, constants = task.options, constants_of(task.law, task.options.per_area)
    whole = np.array([options.given.get(c.name, 0.0) for c in constants])
    wanted = tuple(k for k, c in enumerate(constants) if c.name not in options.given and _felt(c, task))
    limits = np.array([options.bounds.get(constants[k].name, _range(constants[k])) for k in wanted]).reshape(-1, 2)
    model = _Wanted(Force(task.law, task.touches), whole, wanted)
    starts = [np.clip(s[list(wanted)], limits[:, 0], limits[:, 1]) for s in _starts(task, constants, whole)]
    found = fit(model, task.force, starts, limits[:, 0], limits[:, 1], options.loss)
    missed, constants_found = np.empty(0), whole.copy()
    constants_found[list(wanted)] = found.values
    if task.unseen is not None:
        missed = Force(task.law, task.unseen[0]).values(constants_found) - task.unseen[1]
    return _Done(found, wanted, missed, constants_found)


def _range(constant: Constant) -> tuple[float, float]:
    return constant.minimum, constant.maximum


def _felt(constant: Constant, task: _Task) -> bool:
    """Whether the data can tell of a constant at all."""
    return constant.name not in VISCOUS or (task.has_rate and bool(np.any(task.touches.rate[task.touches.depth > 0.0])))


def _starts(task: _Task, constants: tuple[Constant, ...], given: Real) -> list[Real]:
    """Starts: some exponents, each with the stiffness that fits best and a little damping."""
    names = [c.name for c in constants]
    starts = []
    force, t = Force(task.law, task.touches), task.touches
    rate = np.abs(t.rate[t.depth > 0.0])
    for exponent in EXPONENTS if "exponent" in names and "exponent" not in task.options.given else (None,):
        start = given.copy()
        if exponent is not None:
            start[names.index("exponent")] = exponent
        start[0] = 1.0
        elastic = force(start)[0]
        square = float(elastic @ elastic)
        start[0] = max(float(elastic @ task.force) / square, 1e-12) if square > 0.0 else 1.0
        typical = float(rate.mean()) if rate.size and rate.any() else 1.0
        depth = float(t.depth[t.depth > 0.0].mean()) if rate.size else 1.0
        start[1] = VISCOUS_SHARE / typical * (start[0] * depth if task.law == "kelvin_voigt" else 1.0)
        starts.append(np.where([n in task.options.given for n in names], given, start))
    return starts


def joined(probes: Sequence[Probe]) -> tuple[Touches, Real]:
    """Several probes as one, their samples one after the other."""
    begin = np.cumsum([0, *[p.touches.samples for p in probes]])
    touches = Touches(
        np.concatenate([p.touches.sample + b for p, b in zip(probes, begin, strict=False)]),
        np.concatenate([p.touches.depth for p in probes]),
        np.concatenate([p.touches.rate for p in probes]),
        np.concatenate([p.touches.weight for p in probes]),
        int(begin[-1]),
    )
    return touches, np.concatenate([p.force for p in probes])


def check_options(options: Options) -> None:
    """Refuse names of constants that no chosen law has, and values outside their ranges, with InputError."""
    known = {c.name: c for law in options.laws for c in constants_of(law, options.per_area)}
    asked = [("--fix", n, (v, v)) for n, v in options.given.items()]
    asked += [("--bounds", n, b) for n, b in options.bounds.items()]
    for option, name, (low, high) in asked:
        if name not in known:
            rule = f"{' or '.join(options.laws)} must have the constant"
            raise InputError(option, rule, name, nearest(name, known, what="constants"))
        own = known[name]
        if not own.minimum <= low <= high <= own.maximum:
            rule = f"{name} must lie between {own.minimum:g} and {own.maximum:g} {own.unit}, the least first"
            raise InputError(option, rule, f"{low:g}" if low == high else f"{low:g}:{high:g}", "Choose within")
        if low == high and option == "--bounds":
            way_out = f"Give --fix {name}={low:g} to hold it there"
            raise InputError(option, f"the least of {name} must be below the greatest", f"{low:g}:{high:g}", way_out)


def fit_laws(
    probes: Sequence[Probe],
    options: Options,
    has_rate: bool,
    why_no_rate: str,
    spread: Spread = in_line,
    on_done: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[list[Fitted], list[HeldOut], dict[Place, Real]]:
    """Fit every law to all probes together, to every region and to every probe, and to all but some.

    Parameters
    ----------
    probes
    options
    has_rate
        Whether rates of depth are known; without them dampers are told as not identifiable.
    why_no_rate
        Reason for that, for the report.
    spread
        From `pool`.
    on_done
        Told how many of all fits are done.

    Returns
    -------
    fits, held_out, constants
        The constants of every fit, those that were not fitted at 0 or as given.
    """
    check_options(options)
    groups: list[tuple[str, str, list[Probe]]] = [("pooled", "all probes", list(probes))]
    regions = sorted({p.region for p in probes if p.region})
    groups += [("region", r, [p for p in probes if p.region == r]) for r in regions if len(regions) > 1]
    if len(probes) > 1:
        groups += [("probe", p.label, [p]) for p in probes if p.touches.samples >= SMALLEST]
    splits = list(_folds(probes, options))
    tasks, places = [], []
    for law in options.laws:
        for scope, label, members in groups:
            tasks.append(_Task(law, *joined(members), options, has_rate))
            places.append((law, scope, label))
        for seen, unseen in splits:
            tasks.append(_Task(law, *seen, options, has_rate, unseen))
            places.append((law, "fold", ""))
    count = 0

    def done(n: int, result: _Done) -> None:
        nonlocal count
        count += 1
        on_done(count, len(tasks))

    results = spread(_fit, tasks, done)
    fitted = [
        _fitted(place, task, result, why_no_rate)
        for place, task, result in zip(places, tasks, results, strict=True)
        if place[1] != "fold"
    ]
    held_out = []
    for law in options.laws if splits else ():
        parts = [(r.missed, t.unseen[1]) for p, t, r in zip(places, tasks, results, strict=True)
                 if p[0] == law and t.unseen is not None]  # fmt: skip
        what = "probes" if len(probes) > 1 else "stretches of the recording"
        held_out.append(tried(law, what, parts))
    return fitted, held_out, {p: r.constants for p, r in zip(places, results, strict=True) if p[1] != "fold"}


def _folds(probes: Sequence[Probe], options: Options) -> list[tuple[tuple[Touches, Real], tuple[Touches, Real]]]:
    """What is fitted and what is held out: probes by turns, or with one probe stretches of its samples."""
    if len(probes) == 1:
        touches, force = probes[0].touches, probes[0].force.reshape(probes[0].touches.samples, -1)
        parts = np.array_split(np.arange(touches.samples), max(1, min(options.folds, touches.samples // SMALLEST)))
        if len(parts) < 2:
            return []
        rest = [np.setdiff1d(np.arange(touches.samples), part) for part in parts]
        return [
            ((touches.at(r), force[r].ravel()), (touches.at(p), force[p].ravel()))
            for r, p in zip(rest, parts, strict=True)
        ]  # fmt: skip
    return [
        (joined([probes[k] for k in rest]), joined([probes[k] for k in part]))
        for rest, part in folds(len(probes), options.folds, options.seed)
    ]


def _fitted(place: Place, task: _Task, done: _Done, why_no_rate: str) -> Fitted:
    law, scope, label = place
    constants = constants_of(law, task.options.per_area)
    names = [c.name for c in constants]
    reason = why_no_rate if not task.has_rate else "no motion while in contact"
    own = [constants[k] for k in done.wanted]
    limits = np.array([task.options.bounds.get(c.name, _range(c)) for c in own]).reshape(-1, 2)
    estimates, correlation = estimates_of(
        done.fit, [c.name for c in own], [c.unit for c in own], limits[:, 0], limits[:, 1]
    )
    by_name = {e.name: e for e in estimates}
    for c in constants:
        if c.name in task.options.given:
            by_name[c.name] = Estimate(name=c.name, unit=c.unit, value=task.options.given[c.name], verdict="given")
        elif c.name not in by_name:
            by_name[c.name] = Estimate(name=c.name, unit=c.unit, value=None, verdict="not identifiable", reason=reason)
    return numbers(done.fit, task.force, scope, label, law, [by_name[n] for n in names], correlation)
