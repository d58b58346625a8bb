"""Where a scene is stable: maps over two of its constants, and how stiff a contact a haptic device bears."""

import csv
import io
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from tissue_contact.assemble import INTEGRATORS, assemble
from tissue_contact.assembly import Assembly
from tissue_contact.errors import InputError, WorkError
from tissue_contact.files import publish
from tissue_contact.kernels.layout import Real
from tissue_contact.pool import Kept, Spread, pool, problem_of
from tissue_contact.scenarios.report import png
from tissue_contact.scenarios.run import bar_of, interrupted, scene_key, tell_kept
from tissue_contact.scene import DETECTION_PERIOD, Contact, FixedBox, Scene, Solver, Tissue
from tissue_contact.settings import check_word, nearest, setting
from tissue_contact.simulate import Instance
from tissue_contact.study import z_width as widths
from tissue_contact.study.haptic import Device, exact_stiffness, linear_stiffness, passive_stiffness
from tissue_contact.study.press import Press, find_press
from tissue_contact.study.stability_map import (
    AXES,
    GAINING,
    MARGINAL,
    REFUSED,
    STABLE,
    UNSTABLE,
    VERDICTS,
    Bench,
    Cell,
    Map,
    Row,
    make_map,
    try_row,
)

KINDS = ("one", "automatic")  # of substeps
DECADE = 10.0  # a range goes so many times below and above the value of the scene
BUDGET_SPAN = (1 / 300, 3.0)  # of the longest step that the budget allows: range of the step with automatic substeps
SPEED_RANGE = (1e-6, 1e3)  # [m/s]
SCALE_RANGE = (1e-3, 1e3)  # of the scene's own stiffness: what the parameter stiffnessScale takes, and as far below
SEARCHED = (0.02, 20.0)  # stiffness, times `linear_stiffness`
VIRTUAL = (0.0, 0.25, 1.0, 4.0)  # damping of the contact, times that of the device
EVERYWHERE = FixedBox(box=((-100.0, -100.0, -100.0), (100.0, 100.0, 100.0)))


@dataclass(frozen=True)
class Request:
    """What the command line asks for, of either study."""

    KEPT: ClassVar[str]  # file in the folder of the results: finished work

    scene: Scene
    output: Path
    instrument: str | None = None
    axis: tuple[float, float, float] = (0.0, 0.0, -1.0)
    workers: int = 1
    scheduler: str | None = None
    progress: bool = True


@dataclass(frozen=True)
class MapRequest(Request):
    """Of maps."""

    KEPT = "stability-kept.json"

    x: str = "step"
    y: str = "stiffness"
    x_range: tuple[float, float] | None = None
    y_range: tuple[float, float] | None = None
    grid: int = 16
    integrators: Sequence[str] = ()  # none for all that know the forces of the tissues
    kinds: Sequence[str] = KINDS
    speed: float = 0.5  # [m/s]
    depth: float | None = None  # [m]
    seed: int = 0


@dataclass(frozen=True)
class HapticRequest(Request):
    """Of the loop with a haptic device."""

    KEPT = "z-width-kept.json"

    mass: float = 0.1  # [kg]
    damping: float = 0.5  # [N·s/m]
    hand_mass: float = 0.0
    hand_damping: float = 0.0
    quantum: float = 0.0  # [m]
    push: float | None = None  # [N]
    speed: float = 0.0  # [m/s] at the touch
    delays: Sequence[float] = (0.0, 1e-3, 5e-3)  # [s]
    virtual: Sequence[float] = ()  # [N·s/m]


def stability(request: MapRequest | HapticRequest) -> bool:
    """Run the study, print what it says, write figures and data; whether the automatic choice held everywhere.

    Raises
    ------
    InputError
        The scene or an option is wrong. No file is written.
    WorkError
        The scene could not be run at all.
    Interrupted
        By the user; what is finished is kept, and the same command goes on there.
    """
    console = Console(stderr=True)
    for remark in request.scene.remarks:
        console.print(remark, highlight=False, markup=False, soft_wrap=True)
    problem = problem_of(scene_key(request.scene), replace(request, workers=1, scheduler=None, progress=True))
    kept = Kept(request.output / request.KEPT, problem)
    try:
        with bar_of(console, request.progress) as bar, pool(request.workers, request.scheduler) as spread:
            runner = _Runner(kept, spread, bar, console)
            if isinstance(request, MapRequest):
                told, files, holds = _maps(request, runner)
            else:
                told, files, holds = _haptic(request, runner)
        out = Console()
        for part in told:
            out.print(part, highlight=False, markup=False, soft_wrap=isinstance(part, str))
        for name, content in files.items():
            publish(request.output / name, content)
            out.print(f"wrote {request.output / name}", highlight=False, markup=False, soft_wrap=True)
    except KeyboardInterrupt as error:
        raise interrupted(kept) from error
    kept.path.unlink(missing_ok=True)
    return holds


@dataclass(frozen=True, eq=False)
class _Runner:
    """Runs tasks, with what is kept and a bar."""

    kept: Kept
    spread: Spread
    bar: Progress
    console: Console

    def run(self, text: str, work: Any, tasks: Sequence[Any], keys: Sequence[str]) -> list[Any]:
        tell_kept(self.console, self.kept)
        task = self.bar.add_task(f"{text} (the first time compiles for minutes)", total=len(tasks))
        return self.kept.spread(self.spread, work, tasks, keys, lambda: self.bar.advance(task))


def _instrument(request: Request, scene: Scene) -> int:
    names = [i.name for i in scene.instrument]
    if request.instrument is not None and request.instrument not in names:
        way_out = nearest(request.instrument, names, what="instruments")
        raise InputError("--instrument", "the scene must have the instrument", request.instrument, way_out)
    if not names or not scene.tissue:
        raise InputError(scene.place, "there must be a tissue and an instrument", "not both", "Declare them")
    if request.instrument is None and len(names) > 1:
        found = ", ".join(names)
        raise InputError("--instrument", "it must be said which instrument presses", found, "Name one of them")
    return names.index(request.instrument) if request.instrument else 0


def _press(request: Request, scene: Scene, assembly: Assembly) -> Press:
    if not np.linalg.norm(request.axis) > 0.0:
        raise InputError("--axis", "an axis must have a direction", list(request.axis), "Give 0 0 -1 for down")
    return find_press(assembly, _instrument(request, scene), np.array(request.axis), scene.place)


def _varied(scene: Scene, tissue: Mapping[str, object], solver: Mapping[str, object]) -> Scene:
    """The scene with other keys of all its tissues and its solver."""
    tissues = tuple(t.model_copy(update=tissue) for t in scene.tissue)
    return scene.model_copy(update={"tissue": tissues, "solver": scene.solver.model_copy(update=solver)})


# --- maps -------------------------------------------------------------------------------------------------


def _maps(request: MapRequest, runner: _Runner) -> tuple[list[Any], dict[str, bytes], bool]:
    scene = request.scene
    for option, words, known in (
        ("--integrator", request.integrators, INTEGRATORS),
        ("--substeps", request.kinds, KINDS),
        ("--x", [request.x], AXES),
        ("--y", [request.y], AXES),
    ):
        for word in words:
            check_word(option, word, known)
    if request.x == request.y:
        raise InputError("--y", "the axes must be two", request.y, f"Take another of {', '.join(AXES)}")
    first = assemble(_varied(scene, {}, {"integrator": "symplectic_euler", "substeps": 1}))
    press = _press(request, scene, first)
    depth = press.reach if request.depth is None else request.depth
    limit = _limit_at_rest(first)
    own = _own_values(scene, first, request.speed)
    start = _start_values(own, first, limit)
    integrators = _integrators(request, runner.console)
    benches = {}
    for integrator in integrators:
        damping = {"damping": start["damping"]} if "damping" in (request.x, request.y) else {}
        # With the substeps fixed no scheme is refused for want of damping; each run sets them.
        made = assemble(_varied(scene, damping, {"integrator": integrator, "substeps": 1}))
        benches[integrator] = Bench(made, start, press, depth, request.seed)
    budget = limit * scene.solver.safety * scene.solver.max_substeps
    values: dict[tuple[str, str], Real] = {}
    for kind in request.kinds:
        for option, axis, given in (("--x", request.x, request.x_range), ("--y", request.y, request.y_range)):
            if axis == "step":
                span = (limit / DECADE, limit * DECADE)
                span = span if kind == "one" else (BUDGET_SPAN[0] * budget, BUDGET_SPAN[1] * budget)
            else:
                span = (start[axis] / DECADE, start[axis] * DECADE)
            low, high = _limits(scene, axis, start)
            span = given or (max(span[0], low), min(span[1], high))
            if not low <= span[0] < span[1] <= high:
                rule = f"the range of {axis} must be in order and within {low:g} to {high:g} {_unit(scene, axis)}"
                raise InputError(option, rule, f"{span[0]:g}:{span[1]:g}", f"The scene has {own[axis]:g}")
            values[kind, axis] = np.geomspace(*span, request.grid)
    rows = [(kind, integrator, n) for kind in request.kinds for integrator in integrators for n in range(request.grid)]
    tasks = [
        Row(benches[i], kind == "automatic", {request.y: float(values[kind, request.y][n])}, request.x,
            values[kind, request.x].tolist())
        for kind, i, n in rows
    ]  # fmt: skip
    found = runner.run("trying", try_row, tasks, [f"{kind} {i} {n}" for kind, i, n in rows])
    cells = {key: [Cell(*cell) for cell in row] for key, row in zip(rows, found, strict=True)}
    maps = [
        make_map(i, kind == "automatic", benches[i], (request.x, values[kind, request.x]),
                 (request.y, values[kind, request.y]), [cells[kind, i, n] for n in range(request.grid)])
        for kind in request.kinds
        for i in integrators
    ]  # fmt: skip
    units = {axis: _unit(scene, axis) for axis in (request.x, request.y)}
    files = {"stability.csv": _map_table(maps, units), "stability.json": _map_summary(maps, scene, request, own)}
    for kind in request.kinds:
        files[f"{kind}.png"] = draw_maps([m for m in maps if m.automatic == (kind == "automatic")], units, scene.name)
    told = [_screen(maps), f"seed {request.seed}", *_sentences(maps, units)]
    return told, files, not any(m.automatic and m.count(UNSTABLE) for m in maps)


def _integrators(request: MapRequest, console: Console) -> Sequence[str]:
    """Those asked for, or all that know the forces of the tissues."""
    asked, not_springs = request.integrators, request.scene.not_springs
    if not not_springs or "projective_dynamics" not in (asked or INTEGRATORS):
        return asked or tuple(INTEGRATORS)
    if asked:
        rule = "projective_dynamics knows no other forces in the tissue than linear springs"
        raise InputError("--integrator", rule, not_springs[0], "Leave it out, or take implicit_euler")
    said = f"projective_dynamics is left out, for it does not know the {not_springs[0]}"
    console.print(said, highlight=False, markup=False, soft_wrap=True)
    return tuple(i for i in INTEGRATORS if i != "projective_dynamics")


def _limit_at_rest(assembly: Assembly) -> float:
    instance = Instance(assembly)
    instance.initialize()
    limit = instance.stable_substep(assembly.step_size)
    if not math.isfinite(limit):
        raise WorkError("the tissues have no motion that a substep could be too long for: all vertices are fixed")
    return limit


def _own_values(scene: Scene, assembly: Assembly, speed: float) -> dict[str, float]:
    """The scene's value on every axis."""
    tissue, contact, solver = scene.tissue[0], scene.contact[0], scene.solver
    return {
        "step": solver.step,
        "stiffness": float(assembly.model.spring_stiffness[: assembly.model.tissue_spring_start[1]].mean()),
        "damping": tissue.damping,
        "support_damping": tissue.support_damping,
        "density": tissue.areal_density,
        "contact_stiffness": (contact.stiffness_per_area if contact.is_field else contact.stiffness) or 0.0,
        "speed": speed,
        "detection_period": solver.detection_period or 0.0,
    }


def _start_values(own: Mapping[str, float], assembly: Assembly, limit: float) -> dict[str, float]:
    """The scene's values, and where it has no damping one to start from: a half, or a tenth, of the critical one."""
    start = {
        "damping": 0.5 * float(assembly.model.spring_stiffness.mean()) * limit,
        "support_damping": 0.4 * own["density"] / limit,
        "detection_period": DETECTION_PERIOD,
    }
    return {axis: value or start.get(axis, value) for axis, value in own.items()}


def _unit(scene: Scene, axis: str) -> str:
    if axis == "contact_stiffness":
        return "N/m3" if scene.contact[0].is_field else "N/m"
    return AXES[axis].unit


def _limits(scene: Scene, axis: str, start: Mapping[str, float]) -> tuple[float, float]:
    """Range that a value on an axis may have."""
    if axis == "speed":
        return SPEED_RANGE
    if axis in ("stiffness", "damping"):
        return SCALE_RANGE[0] * start[axis], SCALE_RANGE[1] * start[axis]
    contact = "stiffness_per_area" if scene.contact[0].is_field else "stiffness"
    found = {
        "step": setting(Solver, "step"),
        "detection_period": setting(Solver, "detection_period"),
        "density": setting(Tissue, "areal_density"),
        "support_damping": setting(Tissue, "support_damping"),
        "contact_stiffness": setting(Contact, contact),
    }[axis]
    return found.minimum, found.maximum


def _map_table(maps: Sequence[Map], units: Mapping[str, str]) -> bytes:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    x, y = maps[0].x_axis, maps[0].y_axis
    writer.writerow(
        ["substeps", "integrator", f"{x} [{units[x]}]", f"{y} [{units[y]}]", "verdict", "status", "gain [1]",
         "stable substep [s]", "share of the limit [1]", "most substeps [1]"]
    )  # fmt: skip
    for m in maps:
        for j, row in enumerate(m.cells):
            for i, cell in enumerate(row):
                writer.writerow(
                    ["automatic" if m.automatic else "one", m.integrator, f"{m.x[i]:.6g}", f"{m.y[j]:.6g}",
                     cell.verdict, cell.status, f"{cell.gain:.4g}", f"{cell.limit:.6g}", f"{m.share[j, i]:.5g}",
                     cell.substeps]
                )  # fmt: skip
    return text.getvalue().encode()


def _map_summary(maps: Sequence[Map], scene: Scene, request: MapRequest, own: Mapping[str, float]) -> bytes:
    found = {
        "scene": scene.name,
        "values": own,
        "seed": request.seed,
        "maps": [
            {
                "substeps": "automatic" if m.automatic else "one",
                "integrator": m.integrator,
                "cells": {v: m.count(v) for v in VERDICTS},
                "statuses": _statuses(m),
                **_sharpness(m),
            }
            for m in maps
        ],
    }
    return (json.dumps(found, indent=1) + "\n").encode()


def _statuses(m: Map) -> dict[str, int]:
    words = [cell.status for row in m.cells for cell in row if cell.status]
    return {word: words.count(word) for word in sorted(set(words))}


def _sharpness(m: Map) -> dict[str, float | None]:
    """How near the line of theory the measured border lies."""
    bad, good = m.shares_of(UNSTABLE, REFUSED), m.shares_of(STABLE, MARGINAL, GAINING)
    return {
        "not done below the line": int((bad < 1.0).sum()),
        "least share not done": float(bad.min()) if bad.size else None,
        "greatest share done": float(good.max()) if good.size else None,
    }


def _screen(maps: Sequence[Map]) -> Table:
    table = Table(
        box=None,
        pad_edge=False,
        title="done and not done: step over the limit, with automatic substeps over what the budget allows",
    )
    for name in ("substeps", "integrator", *VERDICTS, "not done", "done"):
        table.add_column(name, justify="left" if name in ("substeps", "integrator") else "right", no_wrap=True)
    for m in maps:
        sharp = _sharpness(m)
        ends = [sharp["least share not done"], sharp["greatest share done"]]
        table.add_row(
            "auto" if m.automatic else "one", m.integrator,
            *(str(m.count(v)) for v in VERDICTS),
            *("-" if end is None else f"{sign} {end:.2g}" for sign, end in zip((">=", "<="), ends, strict=True)),
        )  # fmt: skip
    return table


def _sentences(maps: Sequence[Map], units: Mapping[str, str]) -> list[str]:
    """What the maps say, one line each."""
    said = []
    for m in maps:
        total = sum(len(row) for row in m.cells)
        sharp = _sharpness(m)
        if not m.automatic and not m.shares_of(*VERDICTS).size:
            text = f"{m.integrator}, one substep a step: no limit; {m.count(UNSTABLE)} of {total} cells are unstable"
        elif not m.automatic:
            below, least = sharp["not done below the line"], sharp["least share not done"]
            text = f"{m.integrator}, one substep a step: {below} of {m.count(UNSTABLE)} unstable cells lie below the"
            text += " limit" + ("" if least is None else f"; the first at {least:.3g} times it")
        elif m.count(UNSTABLE) == 0:
            refused = ", ".join(f"{n} {status}" for status, n in _statuses(m).items()) or "none"
            text = f"{m.integrator}, automatic substeps: none of {total} cells is unstable; refused: {refused}"
            if m.count(GAINING):
                text += f"; {m.count(GAINING)} gain more than was put in, with any number of substeps"
        else:
            worst = m.worst()
            assert worst is not None
            x, y, cell = worst
            text = (
                f"{m.integrator}, automatic substeps: {m.count(UNSTABLE)} of {total} cells are UNSTABLE, the worst at "
                f"{m.x_axis} {x:.4g} {units[m.x_axis]}, {m.y_axis} {y:.4g} {units[m.y_axis]} "
                f"({cell.status or 'grows'}, {cell.substeps} substeps)"
            )
        said.append(text)
    return said


COLOURS = {
    STABLE: "#5aa469", MARGINAL: "#f2cc60", GAINING: "#e08e45", "refused: substep_budget": "#c3cfdd",
    "refused: other": "#7f8fa6", UNSTABLE: "#c8553d",
}  # fmt: skip


def _shade(cell: Cell) -> int:
    if cell.verdict == REFUSED:
        return list(COLOURS).index("refused: substep_budget" if cell.status == "substep_budget" else "refused: other")
    return list(COLOURS).index(cell.verdict)


def draw_maps(maps: Sequence[Map], units: Mapping[str, str], title: str) -> bytes:
    """One panel for each integrator: the cells, and the line at which the limit of the kernels lies. PNG."""
    columns = min(2, len(maps))
    rows = math.ceil(len(maps) / columns)
    figure = Figure(figsize=(1.0 + 4.2 * columns, 1.1 + 3.5 * rows), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    palette, norm = ListedColormap(list(COLOURS.values())), BoundaryNorm(np.arange(-0.5, len(COLOURS)), len(COLOURS))
    shades = set()
    for m, ax in zip(maps, axes.flat, strict=False):
        shade = np.array([[_shade(cell) for cell in row] for row in m.cells])
        shades |= set(shade.ravel().tolist())
        ax.pcolormesh(m.x, m.y, shade, cmap=palette, norm=norm, shading="nearest", edgecolors="white", linewidth=0.3)
        with np.errstate(divide="ignore"):
            height = np.clip(np.nan_to_num(np.log10(m.share), nan=9.0), -9.0, 9.0)
        if height.min() < 0.0 < height.max():
            ax.contour(m.x, m.y, height, levels=[0.0], colors="black", linewidths=1.6)
        ax.set(xscale="log", yscale="log", title=m.integrator.replace("_", " "))
    for ax in axes.flat[len(maps) :]:
        ax.set_axis_off()
    for ax in axes[-1]:
        ax.set_xlabel(f"{maps[0].x_axis.replace('_', ' ')} [{units[maps[0].x_axis]}]")
    for ax in axes[:, 0]:
        ax.set_ylabel(f"{maps[0].y_axis.replace('_', ' ')} [{units[maps[0].y_axis]}]")
    line = "limit times budget and safety" if maps[0].automatic else "limit of the scheme"
    handles: list[Any] = [Patch(color=c, label=n) for k, (n, c) in enumerate(COLOURS.items()) if k in shades]
    handles.append(Line2D([], [], color="black", lw=1.6, label=line))
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False)
    figure.suptitle(f"{title}: {'automatic substeps, a press' if maps[0].automatic else 'one substep a step'}")
    return png(figure)


# --- a haptic device --------------------------------------------------------------------------------------


def _haptic(request: HapticRequest, runner: _Runner) -> tuple[list[Any], dict[str, bytes], bool]:
    scene = request.scene
    assembly = assemble(scene)
    press = _press(request, scene, assembly)
    # A rigid wall is no model whose energy is to be watched: one substep counts its work at the begin of the step.
    held = assemble(_varied(scene, {"fixed": EVERYWHERE}, {"energy_gain": 1e6}))
    h = scene.solver.step
    way = 0.25 * press.reach
    rest = widths.resting_force(assembly, press, way, h)
    push = request.push or rest
    if not push > 0.0:
        raise InputError("--push", "the hand must push into the tissue", f"{push:g} N", "Give a force above 0")
    device = Device(request.mass, request.damping, request.quantum, push, request.hand_mass, request.hand_damping)
    virtual = request.virtual or [share * request.damping for share in VIRTUAL]
    least, greatest = widths.stiffness_range(held, press, push)
    points = [(rigid, td, b) for rigid in (True, False) for td in request.delays for b in virtual]
    tasks = []
    for rigid, td, b in points:
        about = linear_stiffness(device, b, h, td)
        low, high = (float(np.clip(f * about, least, greatest)) for f in SEARCHED)
        soft = math.inf if rigid else rest / way
        tasks.append(widths.Search(assembly, held, press, rigid, device, b, td, h, request.speed, soft, low, high))
    keys = [f"{rigid} {td} {b}" for rigid, td, b in points]
    found = [widths.Width(*w) for w in runner.run("pressing", widths.z_width, tasks, keys)]
    rows: list[dict[str, Any]] = [
        {
            "wall": "rigid" if rigid else "tissue",
            "delay [s]": td,
            "virtual damping [N.s/m]": b,
            "borne [N/m]": w.borne,
            "not borne [N/m]": w.not_borne,
            "ended by": w.status or ("" if math.isinf(w.not_borne) else "limit cycle"),
            "passive bound [N/m]": passive_stiffness(request.damping, b, h, td),
            "linear limit [N/m]": exact_stiffness(device, b, h, td),
        }
        for (rigid, td, b), w in zip(points, found, strict=True)
    ]
    text = io.StringIO()
    writer = csv.DictWriter(text, rows[0], lineterminator="\n")
    writer.writeheader()
    writer.writerows({k: f"{v:.5g}" if isinstance(v, float) else v for k, v in row.items()} for row in rows)
    told = {
        "scene": scene.name,
        "period [s]": h,
        "device": device._asdict(),
        "speed [m/s]": request.speed,
        "rows": rows,
    }
    table = Table(
        box=None,
        pad_edge=False,
        title="stiffness K of the contact that is borne and by theory [N/m], damping B [N.s/m], delay [ms]",
    )
    for name in ("wall", "delay", "B", "K borne", "ended by", "passive", "linear"):
        table.add_column(name, justify="left" if name in ("wall", "ended by") else "right", no_wrap=True)
    for row in rows:
        borne = f">= {row['borne [N/m]']:.4g}" if math.isinf(row["not borne [N/m]"]) else f"{row['borne [N/m]']:.4g}"
        table.add_row(
            row["wall"], f"{1e3 * row['delay [s]']:g}", f"{row['virtual damping [N.s/m]']:g}", borne,
            row["ended by"] or "-", f"{row['passive bound [N/m]']:.4g}", f"{row['linear limit [N/m]']:.4g}",
        )  # fmt: skip
    files = {
        "z-width.png": draw_widths(rows, device, h, scene.name),
        "z-width.csv": text.getvalue().encode(),
        "z-width.json": (json.dumps(told, indent=1) + "\n").encode(),
    }
    return [table, *_haptic_sentences(rows, push, rest / way)], files, True


def _haptic_sentences(rows: Sequence[Mapping[str, Any]], push: float, soft: float) -> list[str]:
    said = [f"the hand pushes with {push:.3g} N; at rest the scene gives way like a spring of {soft:.3g} N/m"]
    for wall in ("rigid", "tissue"):
        own = [row for row in rows if row["wall"] == wall]
        # by more than the search leaves open
        below = sum(widths.RATIO * row["not borne [N/m]"] < row["passive bound [N/m]"] for row in own)
        ratios = [row["borne [N/m]"] / row["linear limit [N/m]"] for row in own if row["linear limit [N/m]"] > 0.0]
        borne = (
            f"{min(ratios):.3g} to {max(ratios):.3g} times the linear limit of this device is borne"
            if ratios
            else "the linear loop of this device is unstable at any stiffness"
        )
        said.append(f"{wall} wall: {below} of {len(own)} limits lie below the bound of passivity; {borne}")
    return said


def draw_widths(rows: Sequence[Mapping[str, Any]], device: Device, period: float, title: str) -> bytes:
    """Stiffness that is borne over virtual damping, a colour for each delay; on a rigid wall and on the tissue. PNG."""
    figure = Figure(figsize=(10, 4.8), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, 2, sharex=True, sharey=True)
    delays = sorted({row["delay [s]"] for row in rows})
    colours = ["#1b6ca8", "#d95f02", "#66a61e", "#7b3f9d", "#4d4d4d"]
    fine = np.linspace(0.0, max(row["virtual damping [N.s/m]"] for row in rows), 80)
    limits = {td: [exact_stiffness(device, f, period, td) for f in fine] for td in delays}
    for ax, wall in zip(axes, ("rigid", "tissue"), strict=True):
        for n, td in enumerate(delays):
            colour = colours[n % len(colours)]
            own = [row for row in rows if row["wall"] == wall and row["delay [s]"] == td]
            b = [row["virtual damping [N.s/m]"] for row in own]
            k = [row["borne [N/m]"] for row in own]
            ax.plot(b, k, "o", color=colour, ms=5)
            for row in own:
                if math.isinf(row["not borne [N/m]"]):
                    ax.annotate("", (row["virtual damping [N.s/m]"], 1.6 * row["borne [N/m]"]),
                                (row["virtual damping [N.s/m]"], row["borne [N/m]"]),
                                arrowprops={"arrowstyle": "->", "color": colour})  # fmt: skip
            ax.plot(fine, limits[td], "-", color=colour, lw=1.0)
            bound = np.array([passive_stiffness(device.damping, f, period, td) for f in fine])
            ax.plot(fine[bound > 0], bound[bound > 0], "--", color=colour, lw=1.4)
        ax.set(yscale="log", xlabel="virtual damping B [N.s/m]", title=f"{wall} wall")
        ax.grid(alpha=0.25)
    axes[0].set_ylabel("stiffness K of the contact [N/m]")
    handles = [
        Line2D([], [], color=colours[n % len(colours)], label=f"delay {1e3 * td:g} ms") for n, td in enumerate(delays)
    ]
    handles += [
        Line2D([], [], color="0.3", marker="o", ls="", label="measured, borne"),
        Line2D([], [], color="0.3", lw=1.0, label="linear limit of this device"),
        Line2D([], [], color="0.3", ls="--", lw=1.4, label="b > K (T/2 + delay) + |B|"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False)
    figure.suptitle(f"{title}: {device.mass:g} kg, {device.damping:g} N.s/m, {1e3 * period:g} ms")
    return png(figure)
