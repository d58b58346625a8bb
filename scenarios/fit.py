"""From recordings to constants: read, fit, tell, write."""

import csv
import io
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import fmpy
import numpy as np
from rich.console import Console
from rich.progress import Progress

from tissue_contact.assemble import assemble
from tissue_contact.errors import InputError
from tissue_contact.files import publish
from tissue_contact.identify.contact_fit import Options, Probe, fit_laws
from tissue_contact.identify.laws import LAWS, Force
from tissue_contact.identify.reading import Description, read, read_description
from tissue_contact.identify.recording import Reading, Real
from tissue_contact.identify.report import Curve, summary, write_report
from tissue_contact.identify.result import Fitted, HeldOut, Result, write_result
from tissue_contact.identify.rollouts import SceneMaker, drive_of, instrument_of, wanted_variables
from tissue_contact.identify.scene_fit import Maker, SceneFit, SceneOptions, fit_scene
from tissue_contact.identify.touching import contact_of, of_depth, of_pose, of_tip
from tissue_contact.identify.treatment import Treatment
from tissue_contact.identify.write_scene import write_scene
from tissue_contact.pool import Kept, Spread, pool, problem_of
from tissue_contact.scenarios.fmu_force import FmuMaker, variables_of
from tissue_contact.scenarios.run import bar_of, interrupted, tell_kept
from tissue_contact.scene import Scene, read_scene
from tissue_contact.settings import check_file, check_folder, validate
from tissue_contact.table import camel
from tissue_contact.variables import Variable

STARTS = "starts.json"  # in the folder of the results: finished work of a fit of a whole model


@dataclass(frozen=True)
class Request:
    """What the command line asks for."""

    data: Sequence[Path]
    output: Path
    mapping: Path | None = None
    treatment: Sequence[str] = ()  # KEY=VALUE, over those of the mapping
    laws: Sequence[str] = tuple(LAWS)
    scene: Path | None = None
    fmu: Path | None = None
    parameters: Sequence[str] = ()  # of a whole model
    instrument: str | None = None
    contact: str | None = None
    tip_radius: float | None = None  # [m]
    tip_area: float | None = None  # [m²]
    given: Mapping[str, float] = field(default_factory=dict)
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    grid: Mapping[str, tuple[float, float, int]] = field(default_factory=dict)
    loss: str = "linear"
    folds: int = 5
    starts: int = 1
    seed: int = 0
    workers: int = 1
    scheduler: str | None = None
    write_scene: Path | None = None
    progress: bool = True


@dataclass(frozen=True, eq=False)
class _Found:
    """What either depth of a fit gives."""

    fits: tuple[Fitted, ...]
    held_out: tuple[HeldOut, ...]
    chosen: str
    parameters: dict[str, float]
    notes: list[str]
    fitted: dict[str, list[Real]]  # force of every recording, by law
    own: dict[str, list[Real]]  # by its own fit
    measured: list[Real]


def fit(request: Request) -> Result:
    """Fit the constants, print a summary, write `result.json`, `report.html` and `fitted.csv`.

    Raises
    ------
    InputError
        The data, the mapping, the scene or an option is wrong. No file is written; but where only the scene to write
        would be wrong, all others are.
    WorkError
        A rollout failed.
    Interrupted
        By the user, in a fit of a whole model; what it has finished is kept in `starts.json`.
    """
    _check(request)
    scene = read_scene(request.scene) if request.scene else None
    description = read_description(request.mapping) if request.mapping else Description()
    treatment = with_options(description.treatment, request.treatment)
    reading = read(request.data, description.columns, treatment)
    console = Console(stderr=True)
    kept = request.output / STARTS
    with bar_of(console, request.progress) as bar, pool(request.workers, request.scheduler) as spread:
        if request.parameters:
            found = _whole_model(request, scene, reading, spread, bar, kept, console)
        else:
            found = _law_alone(request, scene, reading, spread, bar)
    result = Result(
        data=tuple(str(p) for p in request.data),
        probes=len(reading.recordings),
        samples=sum(len(r) for r in reading.recordings),
        excluded=tuple(f"{e.place}, line {e.line}: {e.reason}" for e in reading.exclusions),
        notes=(*reading.notes, *found.notes),
        fits=found.fits,
        held_out=found.held_out,
        chosen=found.chosen,
        parameters=found.parameters,
    )
    write_result(result, request.output / "result.json")
    write_report(result, _curves(reading, found), request.output / "report.html")
    publish(request.output / "fitted.csv", _table(reading, found).encode())
    if request.parameters:
        kept.unlink(missing_ok=True)
    out = Console()
    out.print(summary(result))

    def tell(file: Path) -> None:
        out.print(f"wrote {file}", highlight=False, markup=False, soft_wrap=True)

    for name in ("result.json", "report.html", "fitted.csv"):
        tell(request.output / name)
    if request.write_scene is not None:
        assert scene is not None
        write_scene(scene, result.parameters, request.write_scene, None if request.parameters else result.chosen)
        tell(request.write_scene)
    return result


def with_options(treatment: Treatment, words: Sequence[str]) -> Treatment:
    """A treatment with options KEY=VALUE over its own; values as in TOML, where words need no quotes."""
    values = treatment.model_dump(exclude_unset=True)
    for word in words:
        key, equals, text = (part.strip() for part in word.partition("="))
        if not (key and equals and text):
            raise InputError("--treat", "it must be written as KEY=VALUE", word, "Write for instance low_pass=20")
        try:
            values[key] = tomllib.loads(f"value = {text}")["value"]
        except tomllib.TOMLDecodeError:
            values[key] = text
    return validate(Treatment, values, "--treat")


def _check(request: Request) -> None:
    """Refuse options that contradict each other."""
    whole = bool(request.parameters)
    rules = [
        (whole and bool(request.scene) == bool(request.fmu), "--parameter",
         "a fit of the whole model needs a scene or an FMU", "both" if request.scene else "neither",
         "Give --scene SCENE or --fmu X.fmu"),
        (not whole and request.fmu is not None, "--fmu", "an FMU is for a fit of the whole model", request.fmu,
         "Name what to fit, for instance --parameter contact.stiffness"),
        (whole and (request.tip_radius or request.tip_area), "--tip-radius, --tip-area",
         "the tip is for a fit of the law alone", "--parameter as well", "Leave one of the two out"),
        (bool(request.tip_radius and request.tip_area), "--tip-radius, --tip-area", "a tip is round or flat", "both",
         "Leave one of the two out"),
        (bool(request.scene and (request.tip_radius or request.tip_area)), "--tip-radius, --tip-area",
         "the scene says what the tip is like", "--scene as well", "Leave one of the two out"),
        (request.write_scene is not None and request.scene is None, "--write-scene",
         "there must be a scene to store in", request.write_scene, "Give --scene SCENE"),
        (bool(request.grid) and not whole, "--grid", "a grid is for a fit of the whole model", ", ".join(request.grid),
         "Name what to fit with --parameter"),
        (whole and tuple(request.laws) != tuple(LAWS), "--law", "the scene or the FMU says what the law is",
         ", ".join(request.laws), "Leave --law out"),
        (whole and bool(request.given), "--fix", "a whole model keeps what --parameter does not name",
         ", ".join(request.given), "Leave --fix out, and set the value in the scene"),
    ]  # fmt: skip
    for wrong, place, rule, value, way_out in rules:
        if wrong:
            raise InputError(place, rule, value, way_out)
    check_folder("--output", request.output)
    if request.write_scene is not None:
        check_file("--write-scene", request.write_scene)


# --- the law alone ----------------------------------------------------------------------------------------


def _law_alone(request: Request, scene: Scene | None, reading: Reading, spread: Spread, bar: Progress) -> _Found:
    task = bar.add_task("fitting laws", total=None)
    per_area = bool(scene or request.tip_radius or request.tip_area)
    name, contact = "contact", -1
    if scene is not None:
        contact, chosen = contact_of(scene, request.contact)
        name = chosen.name
    probes = []
    for r in reading.recordings:
        if scene is not None:
            touches, force = of_pose(r, scene, contact), r.force_vector
        else:
            if r.depth is None or r.force is None:
                rule = "a fit without a scene needs depth and normal force"
                raise InputError(r.place, rule, "no depth" if r.depth is None else "no force", "Name their columns")
            tip = request.tip_radius, request.tip_area
            touches, force = of_tip(r, *tip) if any(tip) else of_depth(r), r.force
        assert force is not None
        probes.append(Probe(r.name, r.region, touches, force.ravel()))
    has_rate = all((r.time if scene else r.rate) is not None for r in reading.recordings)
    options = Options(
        tuple(request.laws), per_area, request.given, request.bounds, request.loss, request.folds, request.seed
    )
    fits, held_out, constants = fit_laws(
        probes,
        options,
        has_rate,
        "the data have neither time stamps nor rates",
        spread,
        lambda done, total: bar.update(task, completed=done, total=total),
    )
    pooled = {f.law: f for f in fits if f.scope == "pooled"}
    # With nothing to hold out the information criterion chooses.
    chosen_law = min(held_out, key=lambda h: h.rmse).law if held_out else min(pooled.values(), key=lambda f: f.aic).law
    values = {f"{name}.{camel(e.name)}": e.value for e in pooled[chosen_law].estimates if e.value is not None}

    def forces(law: str, scope: str) -> list[Real]:
        labels = ["all probes" if scope == "pooled" else p.label for p in probes]
        # A probe of few samples has no fit of its own.
        whole = constants[law, "pooled", "all probes"]
        return [
            Force(law, p.touches)(constants.get((law, scope, label), whole))[0]
            for p, label in zip(probes, labels, strict=True)
        ]

    return _Found(
        tuple(fits),
        tuple(held_out),
        chosen_law,
        values,
        [],
        {law: forces(law, "pooled") for law in request.laws},
        {law: forces(law, "probe") for law in request.laws} if len(probes) > 1 else {},
        [p.force for p in probes],
    )


# --- the whole model --------------------------------------------------------------------------------------


def _whole_model(
    request: Request, scene: Scene | None, reading: Reading, spread: Spread, bar: Progress, kept: Path, console: Console
) -> _Found:
    task = bar.add_task("rolling out (the first time compiles for minutes)", total=None)
    variables: Sequence[Variable]
    make: Maker
    names = tuple(request.parameters)
    if scene is not None:
        assembly = assemble(scene)
        variables = assembly.variables
        instrument = instrument_of(variables, request.instrument)
        make = SceneMaker(assembly, instrument, names)
        model: bytes = scene.source + assembly.model_real.tobytes()
    else:
        assert request.fmu is not None
        if not request.fmu.is_file():
            raise InputError(
                str(request.fmu), "the FMU must exist", "no such file", "Build it with tissue-contact build"
            )
        variables = variables_of(fmpy.read_model_description(str(request.fmu)))
        instrument = instrument_of(variables, request.instrument)
        model = request.fmu.read_bytes()
        make = FmuMaker(model, instrument, names)
    wanted = wanted_variables(variables, names)
    drives = [drive_of(r, variables, instrument) for r in reading.recordings]
    options = SceneOptions(
        request.bounds, request.loss, request.starts, request.grid, request.folds, request.seed
    )  # fmt: skip
    problem = problem_of(
        model, names, instrument, request.loss, sorted(request.bounds.items()),
        *[part for d in drives for part in (d.inputs, d.measured, d.step, d.at)],
    )  # fmt: skip
    store = Kept(kept, problem)
    tell_kept(console, store)
    start = np.array([v.start for v in wanted])
    try:
        found = fit_scene(
            make,
            drives,
            wanted,
            start,
            options,
            store,
            spread,
            lambda total: bar.update(task, total=total),
            lambda: bar.advance(task),
        )
    except KeyboardInterrupt as error:
        raise interrupted(store) from error
    if found.grid is not None:
        publish(request.output / "grid.csv", _grid_table(wanted, found).encode())
    values = {e.name: e.value for e in found.fitted.estimates if e.value is not None}
    parts = np.split(found.force, np.cumsum([len(d.measured) for d in drives])[:-1])
    notes = []
    missing = sum(len(d.inputs) for d in drives) - sum(len(r) for r in reading.recordings)
    if missing:
        notes.append(f"{missing} samples are missing between others: the instrument goes on evenly there")
    if request.starts > 1:
        best = min(run["cost"] for run in found.starts)
        near = sum(run["cost"] <= best * (1 + 1e-6) + 1e-300 for run in found.starts)
        notes.append(f"{near} of {request.starts} starts end at the best fit")
    return _Found((found.fitted,), found.held_out, "scene", values, notes, {"scene": parts}, {},
                  [d.measured for d in drives])  # fmt: skip


def _grid_table(variables: Sequence[Variable], found: SceneFit) -> str:
    assert found.grid is not None
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*[f"{v.name} [{v.unit}]" for v in variables], "cost [N2]"])
    writer.writerows([*point, cost] for point, cost in zip(*found.grid, strict=True))
    return text.getvalue()


# --- what is written --------------------------------------------------------------------------------------


def _curves(reading: Reading, found: _Found) -> list[Curve]:
    """What the figures show: normal forces, or force vectors along the mean of the measured ones."""
    curves = []
    for k, r in enumerate(reading.recordings):
        n = len(r)
        mean = found.measured[k].reshape(n, -1).sum(axis=0)
        along = mean / (np.linalg.norm(mean) or 1.0) if mean.size > 1 else np.ones(1)

        def shown(force: Real, n: int = n, along: Real = along) -> Real:
            return force.reshape(n, -1) @ along

        x, name, unit = (r.depth, "depth", "m") if r.depth is not None else (r.time, "time", "s")
        curves.append(
            Curve(
                r.name,
                r.region,
                x if x is not None else np.arange(n, dtype=float),
                name if x is not None else "sample",
                unit if x is not None else "1",
                shown(found.measured[k]),
                {law: shown(parts[k]) for law, parts in found.fitted.items()},
                {law: shown(parts[k]) for law, parts in found.own.items()},
            )
        )
    return curves


def _table(reading: Reading, found: _Found) -> str:
    """Measured and fitted force of every sample, components in their own columns."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    vector = found.measured[0].size > len(reading.recordings[0])
    parts = ("_x", "_y", "_z") if vector else ("",)
    head = [f"{kind}{p}_N" for kind in ("force", *found.fitted) for p in parts]
    writer.writerow(["file", "line", "region", "probe", *head])
    for k, r in enumerate(reading.recordings):
        columns = [found.measured[k], *[parts_[k] for parts_ in found.fitted.values()]]
        rows = np.concatenate([c.reshape(len(r), -1) for c in columns], axis=1)
        writer.writerows([r.place, int(line), r.region, r.name, *row] for line, row in zip(r.lines, rows, strict=True))
    return text.getvalue()
