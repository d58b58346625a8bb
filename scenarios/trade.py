"""The trade between time and accuracy of a scenario: run it in many configurations, time them, tell what to choose."""

import base64
import math
import re
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
from rich.console import Console

from tissue_contact import cache
from tissue_contact.assemble import assemble
from tissue_contact.edits import edited
from tissue_contact.errors import InputError, WorkError
from tissue_contact.files import publish
from tissue_contact.fmu import native
from tissue_contact.fmu.build import build
from tissue_contact.fmu.compile import shared_library
from tissue_contact.pool import Kept, Spread, in_line, pool, problem_of
from tissue_contact.scenarios.outcome import FloatArray, Trace, judge
from tissue_contact.scenarios.run import (
    bar_of,
    communication_points,
    drive,
    empty_trace,
    instance_of,
    interrupted,
    scene_key,
    tell_kept,
)
from tissue_contact.scenarios.scenario import Expectation, Scenario
from tissue_contact.scene import Scene, parse_scene
from tissue_contact.study import deviation, levers
from tissue_contact.study.deviation import DEPTH, FORCE, WIDTH, errors
from tissue_contact.study.front import Point, Sweep, advice, front, percent, promising, unresolved
from tissue_contact.study.levers import Configuration, Grounds
from tissue_contact.study.trade_report import csv_text, figure, raw, table

KEPT = "runs.json"  # in the folder of the results: finished runs, for this command and for tune
# Times of runs side by side are rough: what is beaten only by runs less than so many times as fast may yet be on the
# front, so it is combined further, and timed alone.
COMBINED, TIMED = 1.5, 2.0
SHARE = 1 / 3  # of the runs that are left, tried before the front is looked at again

Say = Callable[[str], None]


@dataclass(frozen=True)
class Request:
    """What is asked of a sweep.

    Parameters
    ----------
    measure : error of the front, one of `tissue_contact.study.deviation.MEASURES`
    runs : most configurations to try
    rounds : of timed runs, of which the fastest counts at each step
    refine : triangles of the reference for each of the scene's, 4 or more
    """

    measure: str = "force"
    runs: int = 60
    rounds: int = 3
    refine: float = 16.0
    workers: int = 1
    scheduler: str | None = None
    progress: bool = True


@dataclass(frozen=True, eq=False)
class Measured:
    """A sweep, and the rows of the reference that its errors are against."""

    sweep: Sweep
    true: FloatArray


def trade(scenario: Scenario, output: Path, request: Request) -> Sweep:
    """Sweep, print, and write `trade.csv`, `trade.png` and `trade.json`.

    Raises
    ------
    InputError
        The scenario, its scene or the request is wrong, or nothing is touched. No file is written.
    WorkError
        The reference was refused.
    Interrupted
        By the user; finished runs are kept in `runs.json`.
    """
    found = measured(scenario, output, request).sweep
    console = Console()
    console.print(table(found, request.measure))
    for remark in found.remarks:
        console.print(remark, highlight=False, markup=False)
    console.print(advice(found.points, request.measure), style="bold", highlight=False, markup=False)
    contents = {
        "trade.csv": csv_text(found, request.measure).encode(),
        "trade.png": figure(found, request.measure),
        "trade.json": raw(found, request.measure),
    }
    for name, content in contents.items():
        publish(output / name, content)
        console.print(f"wrote {output / name}", highlight=False, markup=False, soft_wrap=True)
    return found


# --- runs -------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Job:
    """One scene moved as a scenario says: what a worker needs to run it. Meshes are read from where they are."""

    source: bytes
    folder: Path
    place: str
    times: FloatArray  # [s]
    steps: FloatArray  # [s]
    inputs: Mapping[str, FloatArray]  # at the times
    expect: tuple[Expectation, ...] = ()

    def scene(self) -> Scene:
        """The scene, validated."""
        return parse_scene(self.source, self.folder, self.place)

    @property
    def key(self) -> str:
        """Name of what is kept of it; the scenario is the same for all."""
        return cache.digest([], self.source.decode())


def job_of(scenario: Scenario, source: bytes) -> Job:
    """A scenario with another scene file."""
    times, steps = communication_points(scenario.duration, scenario.scene.solver.step)
    scene = scenario.scene
    return Job(source, scene.folder.resolve(), scene.place, times, steps, scenario.stimulus.sample(times))


def built(job: Job, folder: Path) -> Path:
    """The FMU of a job for this machine. Raises InputError where its scene cannot be assembled."""
    return build(assemble(job.scene()), folder / f"{job.key}.fmu", [fmpy.platform])


def follow(job: Job) -> dict[str, Any]:
    """Run a job: its rows for `rows_of`, its rough time of a step [µs], what failed or refused it, if anything."""
    with tempfile.TemporaryDirectory() as name:
        try:
            fmu = built(job, Path(name))
        except InputError as error:
            return {"refusal": str(error)}
        about = fmpy.read_model_description(str(fmu))
        trace = empty_trace(about, job.times)
        begin = time.thread_time()
        try:
            with instance_of(fmu, about, []) as slave:
                drive(slave, about, job.steps, job.inputs, {}, trace)
        except WorkError as error:
            told = re.sub("^fmi2(ExitInitializationMode|DoStep): ", "", str(error))
            return {"refusal": f"at {trace.time[max(trace.done - 1, 0)]:g} s: {told}"}
    taken = time.thread_time() - begin
    bodies = bodies_of(trace.names)
    vectors = ("force", "torque", "meanForce")
    rows = np.stack(
        [np.column_stack([*(trace.vector(f"{b}.{v}") for v in vectors), trace.column(f"{b}.depth")]) for b in bodies],
        axis=1,
    )
    work, balance = (float(np.abs(trace.column(f"energy.{what}")).max()) for what in ("work", "balance"))
    return {
        "rows": base64.b64encode(rows.astype("<f4").tobytes()).decode(),  # single precision, 1e-7, is plenty
        "bodies": bodies,
        "touched": [_touched(trace, body) for body in bodies],
        # Processor time of all steps: other work on the machine lengthens it little.
        "us": 1e6 * taken / len(job.steps),
        "substeps": int(trace.column("solver.substeps").max()),
        "balance": balance / work if work > 0.0 else 0.0,
        "failed": [v.told for v in judge(job.expect, trace) if not v.holds],
        "refusal": "",
    }


def _touched(trace: Trace, body: str) -> list[list[float]] | None:
    """Least and greatest coordinates [m] of the points of contact of a body; None where it touched nothing."""
    pressed = trace.vector(f"{body}.force").any(axis=1)  # without a force there is no such point
    points = trace.vector(f"{body}.contactPoint")[pressed]
    return [points.min(axis=0).tolist(), points.max(axis=0).tolist()] if len(points) else None


def check_references(results: Sequence[Mapping[str, Any]], name: str, way_out: str = "") -> None:
    """WorkError where a run that the others of a scenario are compared with was refused."""
    for result in results:
        if result["refusal"]:
            raise WorkError(f"the reference of {name} was refused: {result['refusal']}{way_out}")


def bodies_of(names: Sequence[str]) -> list[str]:
    """Names of the bodies among those of an FMU's outputs."""
    return [n.removesuffix(".depth") for n in names if n.endswith(".depth")]


def rows_of(result: Mapping[str, Any]) -> FloatArray:
    """Rows of a run that was not refused, shape (communication points, bodies, `WIDTH`)."""
    flat = np.frombuffer(base64.b64decode(result["rows"]), "<f4").astype(np.float64)
    return flat.reshape(-1, len(result["bodies"]), WIDTH)


# --- times ------------------------------------------------------------------------------------------------


def timed(jobs: Mapping[str, Job], rounds: int, kept: Kept, on_done: Callable[[], None]) -> dict[str, float | str]:
    """Median time of a step in contact [µs], each the fastest of some rounds, or what refused it, by key.

    One job after the other, then the next round, so that a slow moment of the machine meets them all.
    """
    with tempfile.TemporaryDirectory() as name:
        fmus: dict[str, Path] = {}

        def timed_once(key: str) -> list[float] | str:
            if key not in fmus:
                fmus[key] = built(jobs[key], Path(name))
            return step_times(fmus[key], jobs[key])

        keys = list(jobs) * rounds
        names = [f"times {n // len(jobs)} {key}" for n, key in enumerate(keys)]
        found = kept.spread(in_line, timed_once, keys, names, on_done)
    return {key: median_of(found[n :: len(jobs)]) for n, key in enumerate(jobs)}


def median_of(rounds: Sequence[list[float] | str]) -> float | str:
    """Median over the steps [µs] of the fastest round of each, or what refused one of the rounds.

    Every round does the same, so what one takes longer at a step than another is the machine's.
    """
    refused = [r for r in rounds if isinstance(r, str)]
    return refused[0] if refused else float(np.median(np.min([r for r in rounds if not isinstance(r, str)], axis=0)))


def step_times(fmu: Path, job: Job) -> list[float] | str:
    """Times of all steps in contact [µs], driven by a native program; what refused it where it was."""
    about = fmpy.read_model_description(str(fmu))
    asked = [v for v in about.modelVariables if v.causality == "input"]
    inputs = [job.inputs.get(v.name, np.full(len(job.times), float(v.start))) for v in asked]
    try:
        outputs, ns = native.drive(fmu, np.column_stack(inputs), float(job.steps[0]))
    except WorkError as error:
        return str(error)
    names = [v.name for v in about.modelVariables if v.causality == "output"]
    forces = [names.index(f"{b}.force[{k}]") for b in bodies_of(names) for k in (1, 2, 3)]
    touching = np.any(outputs[:, forces] != 0.0, axis=1)
    return [round(1e-3 * int(t), 3) for t in (ns[touching] if touching.any() else ns)]


# --- the sweep --------------------------------------------------------------------------------------------


def kept_of(scene: Scene, motion: Job, path: Path) -> Kept:
    """What a file keeps of runs of a scene, in any configuration, with one motion and what is expected of it."""
    inputs = [part for item in sorted(motion.inputs.items()) for part in item]
    return Kept(path, problem_of(scene_key(scene), motion.times, motion.expect, *inputs))


def measured(scenario: Scenario, folder: Path, request: Request) -> Measured:
    """Run and time a scenario in many configurations; `folder` keeps what is finished. Errors as `trade`."""
    console = Console(stderr=True)
    for remark in (*scenario.scene.remarks, *scenario.stimulus.remarks()):
        console.print(remark, highlight=False, markup=False)
    assembly = assemble(scenario.scene)  # a wrong scene is told before anything is compiled
    known = levers.grounds(scenario.scene, assembly.model.contact_reach)
    kept = kept_of(scenario.scene, job_of(scenario, b""), folder / KEPT)
    tell_kept(console, kept)
    try:
        with bar_of(console, request.progress) as bar:
            task = bar.add_task("", total=0)
            counts = [0]

            def more(count: int, text: str) -> None:
                counts[0] += count
                bar.update(task, total=counts[0], description=text)

            more(0, "compiling (the first time takes a minute)")
            # Workers side by side would compile side by side.
            shared_library(fmpy.platform, progress=lambda text: bar.update(task, description=text))
            with pool(request.workers, request.scheduler) as spread:
                search = _Search(scenario, known, request, kept, spread, more, lambda: bar.advance(task))
                search.run()
            near = front(search.points(), request.measure, TIMED)
            own = [] if search.results[()]["refusal"] else [()]
            jobs = {job.key: job for job in map(search.job, [*own, *(p.configuration for p in near)])}
            more(request.rounds * len(jobs), "timing, one at a time")
            times = timed(jobs, request.rounds, kept, lambda: bar.advance(task))
    except KeyboardInterrupt as error:
        raise interrupted(kept) from error
    return Measured(search.sweep(times), search.true)


class _Search:
    """Which configurations are run: every change alone, then what lies on the front combined, until nothing is new."""

    def __init__(
        self, scenario: Scenario, known: Grounds, request: Request, kept: Kept, spread: Spread,
        more: Callable[[int, str], None], on_done: Callable[[], None],
    ) -> None:  # fmt: skip
        self.scenario, self.request = scenario, request
        self._known, self._kept, self._spread, self._more, self._on_done = known, kept, spread, more, on_done
        self._own = job_of(scenario, scenario.scene.source)
        self.results: dict[Configuration, Mapping[str, Any]] = {}
        self.remarks: list[str] = []

    def job(self, configuration: Configuration) -> Job:
        """What runs a configuration."""
        edits = [edit for option in configuration for edit in option.edits]
        return replace(self._own, source=edited(self.scenario.scene, edits))

    def run(self) -> None:
        """Run all that is to be run."""
        scene, request = self.scenario.scene, self.request
        self._try([()], "the scene as it is")
        options = levers.options(scene, self._grounds())
        self.references = request.refine / 4.0, request.refine
        sources = [edited(scene, levers.reference(scene, self._known, f)) for f in self.references]
        for source in sources:  # a scene that cannot be is told before the long runs
            parse_scene(source, scene.folder, f"{scene.place}, made finer")
        wanted = [(option,) for option in options[: request.runs - 1]]
        if untried := options[request.runs - 1 :]:
            self.remarks.append(
                f"Stopped at {request.runs} runs with {len(untried)} single changes untried, of "
                f"{', '.join(dict.fromkeys(o.lever for o in untried))}: --runs {len(options) + 1} tries every one."
            )
        finer, finest = (replace(self._own, source=source) for source in sources)
        jobs = [finest, finer, *map(self.job, wanted)]  # the longest first
        found = self._follow(jobs, "the references and every change alone")
        check_references(found[:2], self.scenario.name)
        self.true = rows_of(found[0])
        self.convergence = errors(rows_of(found[1]), self.true, finest.steps)
        self._check_touched(self.true)
        low, high = self.references
        known = deviation.known(self.convergence)
        for measure, off in self.convergence.items():
            if measure not in known:
                apart = f"differ by {percent(off)} in it" if off is not None else "have none"
                text = f"the references at {low:g} and {high:g} times the triangles {apart}"
                if measure == request.measure:
                    raise WorkError(f"no error of the {measure} can be told: {text}. Raise --refine")
                self.remarks.append(f"No error of the {measure} is told: {text}.")
        self.results |= zip(wanted, found[2:], strict=True)
        while new := self._combinations():
            left = request.runs - len(self.results)
            if left <= 0:
                self.remarks.append(
                    f"Stopped at {request.runs} runs with {len(new)} combinations of what is on the front untried: "
                    "--runs allows more."
                )
                break
            # Not all that is left at once: what comes of the most promising ones is combined further.
            self._try(new[: math.ceil(SHARE * left)], "combining what is on the front")

    def _grounds(self) -> Grounds:
        """What levers must know, with the areas in contact as the scene's own run has them."""
        scene, own = self.scenario.scene, self.results[()]
        if own["refusal"]:
            self.remarks.append(f"The scene as it is was refused, {own['refusal']}")
            return self._known
        rows = rows_of(own)
        self._check_touched(rows)
        force = {name: rows[:, n, FORCE] for n, name in enumerate(own["bodies"])}
        depth = {name: rows[:, n, DEPTH] for n, name in enumerate(own["bodies"])}
        area = levers.areas(scene, force, depth)
        for contact in scene.contact:
            if contact.name in area:
                self.remarks.append(
                    f"Other responses of {contact.name} are as stiff as the field over the "
                    f"{1e6 * area[contact.name]:.3g} mm² that bore its force in the scene as it is."
                )
            elif contact.is_field:
                self.remarks.append(
                    f"The response of {contact.name} stays: its force is not alone on one instrument against a tissue."
                )
        boxes = dict(zip(own["bodies"], own["touched"], strict=True))
        touched = {c.name: np.array(boxes[c.between[1]]) for c in scene.contact if boxes[c.between[1]]}
        return replace(self._known, area=area, touched=touched)

    def _check_touched(self, rows: FloatArray) -> None:
        if not np.any(rows[..., FORCE]):
            way_out = "Lengthen stop_time, or move an instrument to the tissue"
            raise InputError(self.scenario.place, "something must be touched", "no force in the whole run", way_out)

    def _combinations(self) -> list[Configuration]:
        """Configurations not yet tried: those near the front, each with an option that another of them has."""
        points = self.points()
        near = front(points, self.request.measure, COMBINED)
        found: dict[Configuration, None] = {}
        for point in near:
            for option in (o for other in near for o in other.configuration):
                made = levers.with_option(point.configuration, option)
                if made not in self.results and levers.variant(self.scenario.scene, made) is not None:
                    found[made] = None
        return promising(found, points, self.request.measure)

    def _try(self, configurations: Sequence[Configuration], text: str) -> None:
        self.results |= zip(configurations, self._follow([self.job(c) for c in configurations], text), strict=True)

    def _follow(self, jobs: Sequence[Job], text: str) -> list[Any]:
        self._more(len(jobs), text)
        return self._kept.spread(self._spread, follow, jobs, [job.key for job in jobs], self._on_done)

    def points(self, times: Mapping[str, float | str] | None = None) -> list[Point]:
        """All that was tried, with times taken alone where there are any."""
        found = []
        for configuration, result in self.results.items():
            job = self.job(configuration)
            us = (times or {}).get(job.key)
            found.append(point_of(configuration, result, self.true, self.convergence, job.steps, us))
        return found

    def sweep(self, times: Mapping[str, float | str]) -> Sweep:
        """What was found, and what the user should know of it."""
        request, points = self.request, self.points(times)
        left = levers.meshes_left(self.scenario.scene)
        if left:
            self.remarks.append(f"The mesh of {', '.join(left)} gets no finer: what it errs by is in no figure.")
        low, high = self.references
        doubtful = unresolved(front([p for p in points if p.timed], request.measure), request.measure, self.convergence)
        if doubtful:
            self.remarks.append(
                f"The references at {low:g} and {high:g} times the triangles differ by a third or more of the error of "
                f"{', '.join(f'“{p.label}”' for p in doubtful)}: take such errors as bounds, or raise --refine."
            )
        return Sweep(self.scenario.name, self.scenario.scene.solver.step, points, self.convergence, self.references,
                     self.remarks)  # fmt: skip


def point_of(
    configuration: Configuration, result: Mapping[str, Any], true: FloatArray, convergence: Mapping[str, float | None],
    steps: FloatArray, us: float | str | None,
) -> Point:  # fmt: skip
    """A configuration with the errors that can be told.

    `steps` [s] as in `errors`; `us` is its time [µs] taken alone, or what refused it then, if it was timed.
    """
    if isinstance(us, str) or result["refusal"]:
        return Point(configuration, {}, None, refusal=us if isinstance(us, str) else result["refusal"])
    return Point(
        configuration,
        {m: e for m, e in errors(rows_of(result), true, steps).items() if m in deviation.known(convergence)},
        result["us"] if us is None else us,
        us is not None,
        result["substeps"],
        result["balance"],
    )
