"""Run a scenario: build its FMU or take it from the cache, drive it step by step, keep what it says."""

import shutil
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from ctypes import byref
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
from fmpy import fmi2
from fmpy.fmi1 import FMICallException
from fmpy.model_description import ModelDescription, ScalarVariable
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.table import Table

import tissue_contact
import tissue_contact.fmu
from tissue_contact import cache
from tissue_contact.assemble import assemble
from tissue_contact.assembly import Assembly
from tissue_contact.errors import InputError, WorkError
from tissue_contact.fmu.build import build
from tissue_contact.pool import Kept
from tissue_contact.scenarios.outcome import (
    FloatArray,
    Summary,
    Trace,
    Verdict,
    check_names,
    judge,
    summarise,
    write_csv,
)
from tissue_contact.scenarios.scenario import SHIPPED, Scenario
from tissue_contact.scene import Scene
from tissue_contact.settings import nearest

PROGRESS_PARTS = 200  # redraws of the bar over a run: drawing it must not slow the steps


class Interrupted(KeyboardInterrupt):
    """The user stopped a run; the message says what was kept."""


def tell_kept(console: Console, kept: Kept) -> None:
    """Tell what is kept already, or was of other work, if anything."""
    if kept.remark:
        console.print(kept.remark, highlight=False, markup=False, soft_wrap=True)


def interrupted(kept: Kept) -> Interrupted:
    """What to raise when the user stops work of which a file keeps what is finished, if anything."""
    said = f"Kept what is finished in {kept.path}: the same command goes on there" if kept.done else "Nothing kept"
    return Interrupted(f"interrupted. {said}")


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a run came to."""

    scenario: Scenario
    trace: Trace
    summary: Summary
    verdicts: list[Verdict]
    files: list[Path]

    @property
    def holds(self) -> bool:
        """Whether every expectation holds."""
        return all(v.holds for v in self.verdicts)


# --- FMU --------------------------------------------------------------------------------------------------


def scene_key(scene: Scene) -> str:
    """Hash of all that goes into a scene's FMU: its file, its meshes, this package's sources and version."""
    meshes = [scene.folder / body.mesh for body in (*scene.tissue, *scene.bodies) if body.mesh]
    roots = [Path(m.__file__).parent for m in (tissue_contact, tissue_contact.fmu) if m.__file__]
    sources = [p for root in roots for p in root.rglob("*") if p.suffix in (".py", ".c", ".h", ".def")]
    # Assembly tells of a missing mesh. The scene is hashed as bytes: latin-1 makes a text of any.
    there = [p for p in meshes if p.is_file()]
    return cache.digest([*sources, *there], scene.source.decode("latin-1"), tissue_contact.__version__)


def fmu_of(scene: Scene, assembly: Callable[[], Assembly], on_progress: Callable[[str], None]) -> Path:
    """The scene's FMU for this machine, from the cache or built now; `assembly` is called only then."""
    kept = cache.folder() / f"{scene.name}-{scene_key(scene)}.fmu"
    if not kept.is_file():
        on_progress("assembling the scene")
        made = assembly()
        on_progress("building the FMU")
        kept.parent.mkdir(parents=True, exist_ok=True)
        build(made, kept, platforms=[fmpy.platform], on_progress=on_progress)
    return kept


# --- parameters -------------------------------------------------------------------------------------------


def check_parameters(values: Mapping[str, float], description: ModelDescription) -> None:
    """Refuse values that the FMU has no parameter for or whose range they leave, with InputError."""
    known = {v.name: v for v in description.modelVariables if v.causality == "parameter"}
    for name, value in values.items():
        place = f"--set {name}={value:g}"
        if name not in known:
            raise InputError(place, "the FMU must have the parameter", name, nearest(name, known, what="parameters"))
        low, high = bound(known[name].min, -np.inf), bound(known[name].max, np.inf)
        if not low <= value <= high:  # also refuses NaN
            rule = f"the value must lie between {low:g} and {high:g} {known[name].unit or ''}".rstrip()
            raise InputError(place, rule, value, f"It starts at {known[name].start}")


def bound(text: str | None, default: float) -> float:
    """Bound of a variable in a model description, which may lack it."""
    return default if text is None else float(text)


# --- driving ----------------------------------------------------------------------------------------------


@contextmanager
def instance_of(path: Path, description: ModelDescription, log: list[tuple[int, str]]) -> Iterator[fmi2.FMU2Slave]:
    """An instance of an FMU, freed at the end; what it logs, as (status, text), goes to `log`."""

    def logger(environment: Any, instance: bytes, status: int, category: bytes, message: bytes) -> None:
        log.append((status, message.decode("utf-8", "replace")))

    callbacks = fmi2.fmi2CallbackFunctions()
    callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(logger)
    callbacks.allocateMemory = fmi2.defaultCallbacks.allocateMemory
    callbacks.freeMemory = fmi2.defaultCallbacks.freeMemory
    fmi2.addLoggerProxy(byref(callbacks))  # the message is a printf format, which ctypes cannot fill
    folder = fmpy.extract(str(path))
    slave = None
    try:
        slave = fmi2.FMU2Slave(
            guid=description.guid,
            modelIdentifier=description.coSimulation.modelIdentifier,
            unzipDirectory=folder,
            instanceName=description.modelName,
        )
        slave.instantiate(callbacks=callbacks, loggingOn=True)
        yield slave
    except FMICallException as error:
        told = [text for status, text in log if status > fmi2.fmi2OK]
        raise WorkError(f"{error.function}: {told[-1] if told else error}") from error
    finally:
        if slave is not None:
            if slave.component is not None:
                slave.freeInstance()
            else:
                slave.freeLibrary()
        shutil.rmtree(folder, ignore_errors=True)


class _Port:
    """Some Real variables of an instance with a buffer for their values, so that a step allocates nothing."""

    def __init__(self, variables: list[ScalarVariable]) -> None:
        n = len(variables)
        self.count = n
        self.references = (fmi2.fmi2ValueReference * n)(*[v.valueReference for v in variables])
        self.buffer = (fmi2.fmi2Real * n)()
        self.values = np.ctypeslib.as_array(self.buffer) if n else np.empty(0)

    def write(self, slave: fmi2.FMU2Slave) -> None:
        if self.count:
            slave.fmi2SetReal(slave.component, self.references, self.count, self.buffer)

    def read(self, slave: fmi2.FMU2Slave) -> None:
        if self.count:
            slave.fmi2GetReal(slave.component, self.references, self.count, self.buffer)


def empty_trace(description: ModelDescription, times: FloatArray) -> Trace:
    """Room for the rows of a run at `times` [s]: the FMU's inputs, then its outputs."""
    variables = _inputs(description) + _outputs(description)
    names, units = tuple(v.name for v in variables), tuple(v.unit or "1" for v in variables)
    n = len(times)
    return Trace(times, names, units, np.zeros((n, len(names))), np.zeros(n))


def _inputs(description: ModelDescription) -> list[ScalarVariable]:
    return [v for v in description.modelVariables if v.causality == "input"]


def _outputs(description: ModelDescription) -> list[ScalarVariable]:
    return [v for v in description.modelVariables if v.causality == "output"]


def drive(
    slave: fmi2.FMU2Slave,
    description: ModelDescription,
    steps: FloatArray,
    inputs: Mapping[str, FloatArray],
    parameters: Mapping[str, float],
    trace: Trace,
    on_rows: Callable[[int], None] = lambda rows: None,
) -> None:
    """Step an instance through the times of `trace`, `steps` [s] apart, and fill its rows.

    The pose at the end of a step is set before it, so a row holds pose and force of one moment. `inputs` are
    values at the times of `trace`; an input that is not there keeps its start value. When a step fails or the
    user interrupts, the rows so far stay in `trace`.

    Raises
    ------
    FMICallException
        A call failed.

    """
    in_port, out_port = _Port(_inputs(description)), _Port(_outputs(description))
    n_in = in_port.count
    for column, variable in enumerate(_inputs(description)):
        trace.values[:, column] = inputs.get(variable.name, float(variable.start))
    tuned = _Port([v for v in description.modelVariables if v.name in parameters])
    tuned.values[:] = [parameters[v.name] for v in description.modelVariables if v.name in parameters]

    time_of = trace.time
    slave.setupExperiment(startTime=time_of[0], stopTime=time_of[-1])
    slave.enterInitializationMode()
    tuned.write(slave)
    in_port.values[:] = trace.values[0, :n_in]
    in_port.write(slave)
    slave.exitInitializationMode()
    out_port.read(slave)
    trace.values[0, n_in:] = out_port.values
    trace.done = 1
    part = max(1, len(time_of) // PROGRESS_PARTS)
    for row in range(1, len(time_of)):
        in_port.values[:] = trace.values[row, :n_in]
        in_port.write(slave)
        before, step = time_of[row - 1], steps[row - 1]
        begin = time.perf_counter_ns()
        slave.fmi2DoStep(slave.component, before, step, 1)
        trace.step_time[row] = 1e-9 * (time.perf_counter_ns() - begin)
        out_port.read(slave)
        trace.values[row, n_in:] = out_port.values
        trace.done = row + 1
        if row % part == 0:
            on_rows(trace.done)
    slave.terminate()


def communication_points(stop_time: float, step: float) -> tuple[FloatArray, FloatArray]:
    """Times 0, step, 2 step … stop_time [s] and the steps between; the last is shorter when it must be.

    Steps are not differences of times, whose last bits vary: every full step is the same number.
    """
    n = max(1, int(np.ceil(stop_time / step - 1e-9)))
    times, steps = step * np.arange(n + 1, dtype=np.float64), np.full(n, step)
    if times[-1] - stop_time > 1e-9 * step:
        steps[-1] = stop_time - times[-2]
    times[-1] = stop_time
    return times, steps


# --- run --------------------------------------------------------------------------------------------------


def run(
    scenario: Scenario,
    output: Path,
    set_values: Mapping[str, float] | None = None,
    progress: bool = True,
    figures: bool = True,
) -> Outcome:
    """Build, drive, write `NAME.csv` and the figures, print the summary.

    Parameters
    ----------
    scenario : Scenario
        What to run.
    output : Path
        Folder for the files; made when missing.
    set_values : mapping of str to float
        Values of FMU parameters by name.
    progress : bool
        Show a bar on stderr, if that is a terminal.
    figures : bool
        Draw the figures too.

    Raises
    ------
    InputError
        The scenario, its scene, a mesh, a recording or a parameter is wrong. No file is written.
    WorkError
        The FMU does not build, or a step failed; the rows so far are in `NAME.partial.csv`.
    Interrupted
        By the user; the rows so far are kept likewise.

    """
    parameters = dict(set_values or {})
    console = Console(stderr=True)
    made: list[Assembly] = []

    def assembly() -> Assembly:
        if not made:
            made.append(assemble(scenario.scene))
        return made[0]

    for remark in (*scenario.scene.remarks, *scenario.stimulus.remarks()):
        console.print(remark, highlight=False, markup=False)
    times, steps = communication_points(scenario.duration, scenario.scene.solver.step)
    inputs = scenario.stimulus.sample(times)
    with bar_of(console, progress) as bar:
        task = bar.add_task("", total=len(times))
        fmu = fmu_of(scenario.scene, assembly, lambda text: bar.update(task, description=text))
        description = fmpy.read_model_description(str(fmu))
        check_parameters(parameters, description)
        check_names(scenario.expect, [v.name for v in _outputs(description)], scenario.place)
        trace = empty_trace(description, times)
        log: list[tuple[int, str]] = []
        bar.update(task, description=scenario.name)
        try:
            with instance_of(fmu, description, log) as slave:
                drive(
                    slave,
                    description,
                    steps,
                    inputs,
                    parameters,
                    trace,
                    lambda rows: bar.update(task, completed=rows),
                )
        except WorkError as error:
            raise WorkError(f"{error}. {_keep(trace, output, scenario.name)}") from error
        except KeyboardInterrupt as error:
            raise Interrupted(f"interrupted. {_keep(trace, output, scenario.name)}") from error
        bar.update(task, completed=len(times))
    for status, text in log:
        if status > fmi2.fmi2OK:
            console.print(f"FMU: {text}", highlight=False, markup=False)
    table = output / f"{scenario.name}.csv"
    write_csv(trace, table)
    _partial(output, scenario.name).unlink(missing_ok=True)
    outcome = Outcome(scenario, trace, summarise(trace), judge(scenario.expect, trace), [table])
    print_summary(outcome, Console())
    deep = too_deep(outcome.summary, scenario.scene, assembly().model.contact_reach)
    for remark in (*deep, *too_slow(outcome.summary, scenario)):
        console.print(remark, highlight=False, markup=False)
    if figures:
        from tissue_contact.scenarios.report import draw  # matplotlib takes a second

        with bar_of(console, progress) as bar:
            bar.add_task("drawing (the first time compiles for a minute)", total=None)
            files = draw(outcome, tuned(assembly(), parameters), output)
        outcome = replace(outcome, files=[table, *files])
    for file in outcome.files:
        Console().print(f"wrote {file}", highlight=False, markup=False, soft_wrap=True)
    return outcome


def tuned(assembly: Assembly, parameters: Mapping[str, float]) -> Assembly:
    """The assembly with other start values of the named parameters."""
    values = assembly.parameters.copy()
    for variable in assembly.variables:
        if variable.block == "parameters" and variable.name in parameters:
            values[variable.slot] = parameters[variable.name]
    return replace(assembly, parameters=values)


def _partial(output: Path, name: str) -> Path:
    return output / f"{name}.partial.csv"


def _keep(trace: Trace, output: Path, name: str) -> str:
    """Write the rows so far and say so."""
    if trace.done == 0:
        return "No row was done, nothing was written"
    path = _partial(output, name)
    write_csv(trace, path)
    return f"Kept the {trace.done} rows up to {trace.time[trace.done - 1]:g} s in {path}"


def bar_of(console: Console, wanted: bool) -> Progress:
    """A progress bar with the remaining time, on a terminal only."""
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=not (wanted and console.is_terminal),
    )


def too_deep(summary: Summary, scene: Scene, thickness: FloatArray) -> Iterator[str]:
    """A remark on every instrument that went deeper than a distance field can press.

    ``thickness`` is half of the thinnest part of each contact [m]. Half of it is less than the two thirds at which a
    ball presses most, and more than any contact that is stiff enough.
    """
    for contact, half in zip(scene.contact, thickness, strict=True):
        name = contact.between[1]
        if contact.is_field and summary.deepest.get(name, 0.0) > 0.5 * half:
            yield (
                f"{name} went {1e3 * summary.deepest[name]:.2f} mm deep, and its thinnest part is {2e3 * half:.2f} mm "
                f"thick: the tissue may pass through it. Raise the stiffness of {contact.name}"
            )


def too_slow(summary: Summary, scenario: Scenario) -> Iterator[str]:
    """A remark on a run whose steps took longer than the time that they are for."""
    if summary.real_time_factor < 1.0:
        name, scene = scenario.name, scenario.scene
        word = name if Path(scenario.place).is_relative_to(SHIPPED) else scenario.place
        slow = scene.solver.integrator != "projective_dynamics" and not any(t.beyond_springs for t in scene.tissue)
        presets = " The presets balanced and fast take less (`--preset`)." if scene.tissue and slow else ""
        yield (
            f"{name} is slower than real time.{presets} `tissue-contact tune {word} "
            f"--budget-us {0.5e6 * scene.solver.step:g}` finds what errs least in half of the time"
        )


def print_summary(outcome: Outcome, console: Console) -> None:
    """Print what a run came to and how its expectations fared."""
    summary, trace = outcome.summary, outcome.trace
    table = Table(title=f"{outcome.scenario.name}: {trace.time[-1]:g} s in {trace.done - 1} steps", show_header=False)
    for name, force in summary.peak_force.items():
        at = f"at {summary.peak_time[name]:.3f} s" if force > 0 else "no contact"
        table.add_row(f"{name}: peak force", f"{force:.4g} N, {at}")
        table.add_row(f"{name}: deepest penetration", f"{1e3 * summary.deepest[name]:.3f} mm")
        table.add_row(f"{name}: time in contact", f"{summary.contact_time[name]:.3f} s")
        if name in summary.held:
            table.add_row(f"{name}: tissue vertices held", f"{summary.held[name]}")
    if summary.balance is not None and summary.work is not None:
        share = f", {100 * summary.balance / summary.work:.2g} % of the work" if summary.work > 0 else ""
        table.add_row("energy balance at its worst", f"{summary.balance:.3g} J{share}")
    micro = [f"{1e6 * t:.1f}" for t in (summary.step_median, summary.step_tail, summary.step_max)]
    table.add_row("step time median / p99.9 / maximum", f"{' / '.join(micro)} µs")
    table.add_row("real-time factor", f"{summary.real_time_factor:.1f}")
    console.print(table)
    for v in outcome.verdicts:
        mark = "[green]holds[/]" if v.holds else "[red]fails[/]"
        console.print(f"{mark}  {escape(v.told)}", highlight=False, soft_wrap=True)
        if v.expectation.reason:
            console.print(f"       {v.expectation.reason}", style="dim", highlight=False, markup=False, soft_wrap=True)
