"""Maps of stability: a scene tried with other values of its constants, and the limit that the kernels go by.

Two questions, each with a run that answers it. `try_scheme`: with one substep a step, does a random motion of the
tissue stay bounded? `try_automatic`: with the number of substeps that the model chooses, does a press stay bounded, or
is it refused because no stable number is within the budget?
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from tissue_contact.assembly import Assembly
from tissue_contact.kernels.layout import Real
from tissue_contact.kernels.slots import (
    AREAL_DENSITY,
    BODY_OUTPUTS,
    COMMON_OUTPUTS,
    CONTACT_PARAMETERS,
    CONTACT_STIFFNESS,
    DAMPING_SCALE,
    ENERGY_BALANCE,
    STIFFNESS_SCALE,
    SUBSTEPS,
    SUPPORT_DAMPING,
    SUPPORT_STIFFNESS,
    TISSUE_PARAMETERS,
)
from tissue_contact.simulate import Instance, Refused
from tissue_contact.status import ENERGY_GAIN, ENERGY_RETURNED, ENERGY_SUM, NONFINITE_OUTPUT, NONFINITE_STATE
from tissue_contact.study.press import Press

STABLE, MARGINAL, GAINING, REFUSED, UNSTABLE = VERDICTS = ("stable", "marginal", "gaining", "refused", "unstable")

STEPS = 600  # of a random motion: near the limit of symplectic Euler some 200 periods of the fastest motion
KICK = 1e-3  # of the shortest spring that the fastest motion swings by: springs stay as good as linear
FROM_NOWHERE = 0.1  # of the energy put in, beyond which a motion is not called stable
REST_STEPS = 3  # least number of steps for which the instrument is held after a press
BLOWN_UP = (ENERGY_GAIN, ENERGY_SUM, ENERGY_RETURNED, NONFINITE_STATE, NONFINITE_OUTPUT)
FINER = 4  # times as many substeps as before, where the automatic number did not hold


class Axis(NamedTuple):
    """A constant that a map varies."""

    unit: str
    meaning: str


AXES = {
    "step": Axis("s", "communication step, which is the substep where there is one a step"),
    "stiffness": Axis("N/m", "stiffness of the springs of the first tissue; those of others keep their ratio to it"),
    "damping": Axis("N.s/m", "damping of every spring of the tissues"),
    "support_damping": Axis("N.s/m3", "damping of the support of the tissues, per area"),
    "density": Axis("kg/m2", "mass per area of the tissues"),
    "contact_stiffness": Axis("N/m3 or N/m", "stiffness of the first contact; those of others keep their ratio to it"),
    "speed": Axis("m/s", "speed of the instrument in a press"),
    "detection_period": Axis("s", "longest time between two detections"),
}


@dataclass(frozen=True, eq=False)
class Bench:
    """A scene ready to be tried.

    ``values`` are those of the scene on every axis, or of the right size where it has none. ``press`` goes ``depth``
    [m] beyond the first touch.
    """

    assembly: Assembly
    values: Mapping[str, float]
    press: Press
    depth: float
    seed: int


class Cell(NamedTuple):
    """What became of one pair of values."""

    verdict: str  # of VERDICTS
    status: str  # name of the status of the step that was not done, "" where all were
    gain: float  # [1] greatest energy from nowhere, over what was put in
    limit: float  # [s] stable limit of a substep, safety 1, by the kernels
    substeps: int  # most of a step that was done


@dataclass(frozen=True, eq=False)
class Row:
    """Cells that differ in one value: the work of one task."""

    bench: Bench
    automatic: bool
    fixed: Mapping[str, float]
    axis: str
    along: Sequence[float]


def try_row(row: Row) -> list[Cell]:
    """All cells of a row."""
    work = try_automatic if row.automatic else try_scheme
    return [work(row.bench, {**row.fixed, row.axis: value}) for value in row.along]


def judge(gains: Real) -> str:
    """Verdict on a run of which every step was done.

    ``gains`` are the energy from nowhere after every step, over what was put in by the end. More than `FROM_NOWHERE` at
    some time is marginal: a slow growth, or the swing of symplectic Euler near its limit. More than all that was put
    in, growing to the end, is unstable.
    """
    third = max(1, len(gains) // 3)
    early, late, most = gains[:third].max(), gains[-third:].max(), gains.max()
    if late > 1.0 and late > 2.0 * early:
        return UNSTABLE
    return MARGINAL if most > FROM_NOWHERE else STABLE


def try_scheme(bench: Bench, varied: Mapping[str, float]) -> Cell:
    """The limit of the scheme itself: random velocities of the tissue, one substep a step."""
    instance, h = _instance(bench, varied, 1), {**bench.values, **varied}["step"]
    instance.initialize()
    limit = instance.stable_substep(h)
    rng = np.random.default_rng(bench.seed)
    free, state = instance.model.node_free, instance.state
    size = KICK * float(instance.model.spring_rest.min()) * _fastest(instance)
    for v in (state.vx, state.vy, state.vz):
        v[:] = size * rng.standard_normal(free.size) * free
    state.tuned[:] = np.nan  # no parameter equals it, so that the step counts what is stored now as put in
    gained: list[float] = []
    status = ""
    try:
        for _ in range(STEPS):
            instance.step(h)
            gained.append(_from_nowhere(instance))
    except Refused as refused:
        status = refused.status.name
    gains = _gains(instance, gained)
    return Cell(UNSTABLE if status else judge(gains), status, float(gains.max()), limit, 1)


def try_automatic(bench: Bench, varied: Mapping[str, float]) -> Cell:
    """The choice of substeps: a press at constant speed, and a rest of the same time.

    A run that blows up or grows, though more substeps within the budget keep it stable, is unstable: the choice was
    wrong. Where no number of substeps helps, as with the chatter of triangle pairs, it is refused rightly, or gaining
    where every step was done.
    """
    cell, code = _pressed(bench, varied, 0)
    if code not in BLOWN_UP and cell.verdict != UNSTABLE:
        return cell
    most, budget = max(1, cell.substeps), int(bench.assembly.model.substeps_max[0])
    while most < budget:
        most = min(FINER * most, budget)
        if _pressed(bench, varied, most)[0].verdict == STABLE:
            return cell._replace(verdict=UNSTABLE)
    return cell if code else cell._replace(verdict=GAINING)


def _pressed(bench: Bench, varied: Mapping[str, float], substeps: int) -> tuple[Cell, int]:
    """Cell of a press, and the code of the status that ended it."""
    instance, values, start = _instance(bench, varied, substeps), {**bench.values, **varied}, bench.assembly.inputs
    h = values["step"]
    begin = -0.1 * bench.depth
    way = bench.depth - begin
    gained: list[float] = []
    most, limit = 0, math.nan
    try:
        bench.press.put(instance, start, bench.depth)
        instance.initialize()
        motion = 6 * bench.press.instrument
        instance.scratch.motion[motion : motion + 3] = min(values["speed"], way / h) * bench.press.axis
        limit = instance.stable_substep(h)
        bench.press.put(instance, start, begin)
        instance.initialize()
        moving = math.ceil(way / (values["speed"] * h))
        for n in range(1, 2 * moving + REST_STEPS + 1):
            bench.press.put(instance, start, min(begin + n * values["speed"] * h, bench.depth))
            instance.step(h)
            gained.append(_from_nowhere(instance))
            most = max(most, int(_common(instance)[SUBSTEPS]))
    except Refused as refused:
        most_gained = float(_gains(instance, gained).max())
        return Cell(REFUSED, refused.status.name, most_gained, limit, most), refused.status.code
    gains = _gains(instance, gained)
    return Cell(judge(gains), "", float(gains.max()), limit, most), 0


def _instance(bench: Bench, varied: Mapping[str, float], substeps: int) -> Instance:
    """The scene with the values of a cell on the axes that are varied; all else is its own."""
    own, values = bench.values, {**bench.values, **varied}
    model = bench.assembly.model._replace(substeps_fixed=np.array([substeps], np.uint32))
    if "detection_period" in varied:
        model = model._replace(detection_period=np.array([varied["detection_period"]]))
    instance = Instance(replace(bench.assembly, model=model))
    tissues = TISSUE_PARAMETERS * model.tissue_rate.size
    tissue = instance.parameters[:tissues].reshape(-1, TISSUE_PARAMETERS)
    tissue[:, STIFFNESS_SCALE] *= values["stiffness"] / own["stiffness"]
    if "damping" in varied:
        tissue[:, DAMPING_SCALE] = varied["damping"] / own["damping"]
    for name, slot in (("density", AREAL_DENSITY), ("support_damping", SUPPORT_DAMPING)):
        if name in varied:
            tissue[:, slot] = varied[name]
    contacts = instance.parameters[tissues : tissues + CONTACT_PARAMETERS * model.contact_tissue.size]
    contacts.reshape(-1, CONTACT_PARAMETERS)[:, CONTACT_STIFFNESS] *= (
        values["contact_stiffness"] / own["contact_stiffness"]
    )
    return instance


def _fastest(instance: Instance) -> float:
    """Circular frequency [1/s] of the fastest motion of springs and support at rest."""
    model = instance.model
    tissue = instance.parameters[: TISSUE_PARAMETERS * model.tissue_rate.size].reshape(-1, TISSUE_PARAMETERS)
    per_area = tissue[:, STIFFNESS_SCALE] * model.tissue_rate + tissue[:, SUPPORT_STIFFNESS]
    return float(np.sqrt(per_area / tissue[:, AREAL_DENSITY]).max())


def _common(instance: Instance) -> Real:
    first = BODY_OUTPUTS * instance.model.body_radius.size
    return instance.outputs[first : first + COMMON_OUTPUTS]


def _from_nowhere(instance: Instance) -> float:
    """Energy from nowhere so far [J]."""
    return -float(_common(instance)[ENERGY_BALANCE])


def _gains(instance: Instance, gained: Sequence[float]) -> Real:
    """Energies from nowhere over what was put in by now; 0 where nothing was, or no step was done."""
    put_in = float(instance.state.put_in[0])
    return np.array(gained) / put_in if gained and put_in > 0.0 else np.zeros(1)


# --- what a map says --------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Map:
    """The cells of one integrator over two axes.

    ``cells[j][i]`` is that of ``y[j]`` and ``x[i]``; ``share[j, i]`` is the step, with one substep, or the least
    substep that the budget allows, over the limit of the kernels times the safety that is asked for: at 1 lies the
    line that theory draws.
    """

    integrator: str
    automatic: bool
    x_axis: str
    x: Real
    y_axis: str
    y: Real
    cells: Sequence[Sequence[Cell]]
    share: Real

    def count(self, verdict: str) -> int:
        """Number of cells of a verdict."""
        return sum(cell.verdict == verdict for row in self.cells for cell in row)

    def shares_of(self, *verdicts: str) -> Real:
        """Shares of the limit of all cells of some verdicts, those without a finite limit left out."""
        found = [
            s
            for row, shares in zip(self.cells, self.share, strict=True)
            for cell, s in zip(row, shares, strict=True)
            if cell.verdict in verdicts and np.isfinite(s) and np.isfinite(cell.limit)
        ]
        return np.array(found)

    def worst(self) -> tuple[float, float, Cell] | None:
        """Values of x and y and the unstable cell that lies deepest below the limit, the least share."""
        found = [
            (self.share[j, i], self.x[i], self.y[j], cell)
            for j, row in enumerate(self.cells)
            for i, cell in enumerate(row)
            if cell.verdict == UNSTABLE
        ]
        if not found:
            return None
        _, x, y, cell = min(found, key=lambda f: f[:3])
        return float(x), float(y), cell


def make_map(
    integrator: str, automatic: bool, bench: Bench, x: tuple[str, Real], y: tuple[str, Real],
    cells: Sequence[Sequence[Cell]],
) -> Map:  # fmt: skip
    """The map of the cells of all rows."""
    model = bench.assembly.model
    step = np.full((len(y[1]), len(x[1])), bench.values["step"])
    if x[0] == "step":
        step[:] = x[1]
    if y[0] == "step":
        step[:] = y[1][:, None]
    limit = np.array([[cell.limit for cell in row] for row in cells])
    allowed = limit * float(model.safety[0] * model.substeps_max[0]) if automatic else limit
    with np.errstate(divide="ignore"):
        share = step / allowed
    return Map(integrator, automatic, *x, *y, cells, share)
