"""`make roofline`: how close a step is to what this machine can do at most.

The machine: cycles, flops, roots and bytes per second of one core, by a small C program. The method: what `counts` says
of the sheet of 6,000 triangles of `bench`, pressed. A part's bound is the longest of the times that its operations, its
roots and its bytes take at full rate, with the bytes from the nearest memory that holds all of them. Parts are timed
alone, compiled just in time; the step and its instructions are those of the FMU.
"""

import json
import subprocess
import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path
from time import thread_time
from typing import Any, NamedTuple

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from tissue_contact.assembly import Assembly
from tissue_contact.commandline import guarded
from tissue_contact.files import publish
from tissue_contact.fmu import compile
from tissue_contact.fmu.native import drive
from tissue_contact.kernels import energy, factor, forces, symplectic
from tissue_contact.kernels.bundle import Bundle
from tissue_contact.kernels.compiled import kernel
from tissue_contact.scenarios import bench, counts, instructions
from tissue_contact.scenarios.counts import Part
from tissue_contact.settings import check_file
from tissue_contact.simulate import Instance, run

SOLVERS = {
    "symplectic_euler": 'integrator = "symplectic_euler"',
    "projective_dynamics": 'integrator = "projective_dynamics"\niterations = 2',
}
PRESSED = 450  # steps of the motion of bench until the capsule is deep and slides
COUNTED = 20  # steps whose instructions are counted
REPEATS, TRIES = 10, 50  # of a part, and how often they are timed: the least counts
CACHES = Path("/sys/devices/system/cpu/cpu0/cache")
USUAL = {"L1": 32 << 10, "L2": 512 << 10, "L3": 8 << 20}  # bytes, where the machine does not say


class Level(NamedTuple):
    """A memory: how much it holds [bytes] and how much of it can be read in a second."""

    name: str
    size: float
    rate: float


class Machine(NamedTuple):
    """What one core can do at most, per second."""

    cycles: float
    flops_f64: float
    flops_f32: float
    roots_f64: float
    levels: tuple[Level, ...]  # from the nearest memory to the farthest, which holds everything


def cache_sizes() -> dict[str, int]:
    """Bytes of the caches of data of a core."""
    sizes = dict(USUAL)
    for folder in CACHES.glob("index*"):
        level, kind, size = ((folder / name).read_text("utf-8").strip() for name in ("level", "type", "size"))
        if kind != "Instruction" and f"L{level}" in sizes:
            sizes[f"L{level}"] = int(size.rstrip("KM")) << (20 if size.endswith("M") else 10)
    return sizes


def measure_machine(folder: Path) -> Machine:
    """Compile and run ``peak.c``."""
    sizes = cache_sizes()
    # Half of a cache is surely within it. Of the last level a core of a shared machine has but a part.
    probes = {name: size // 2 for name, size in sizes.items()} | {"L3": min(sizes["L3"] // 2, 4 << 20)}
    probes["memory"] = max(128 << 20, 4 * sizes["L3"])
    compile.copy_sources(["peak"], folder)
    flags = ["-std=c11", "-O3", "-Wall", "-Wextra", "-Werror", "-mcpu=native", "-ffp-contract=fast"]
    compile.zig([*flags, "peak.c", "-o", "peak"], folder)
    command = [str(folder / "peak"), *(str(size) for size in probes.values())]
    ran = subprocess.run(command, capture_output=True, text=True, check=True)
    found = {name: float(rate) for name, rate in (line.split() for line in ran.stdout.splitlines())}
    levels = [Level(name, sizes.get(name, float("inf")), found[str(size)]) for name, size in probes.items()]
    return Machine(*(found[name] for name in Machine._fields[:-1]), levels=tuple(levels))


def bound(part: Part, machine: Machine) -> tuple[float, str]:
    """Least time [µs] of all passes of a part, and what sets it."""
    level = next(level for level in machine.levels if part.bytes <= level.size)
    needs = {
        "flops": part.flops / machine.flops_f64,
        "roots": part.roots / machine.roots_f64,
        level.name: part.bytes / level.rate,
    }
    limit = max(needs, key=needs.__getitem__)
    return 1e6 * part.passes * needs[limit], limit


# --- parts, timed alone -----------------------------------------------------------------------------------


@kernel
def _springs(model, parameters, state, scratch, n):
    for _ in range(n):
        forces.tissue_forces(model, parameters, state, scratch)


@kernel
def _motion(model, parameters, state, scratch, n):
    for _ in range(n):
        symplectic.symplectic_euler(model, parameters, state, scratch, 0.0)  # no time passes


@kernel
def _contact(model, parameters, state, scratch, n):
    for _ in range(n):
        forces.clear_contacts(state, scratch)
        forces.contact_forces(model, parameters, state, scratch, 0.0, 0.0, False)


@kernel
def _substitutions(model, parameters, state, scratch, n):
    for _ in range(n):
        for k in range(scratch.right.size):
            scratch.right[k] = 1.0  # what is solved for again and again would leave the range of numbers
        factor.forward(model, scratch)
        factor.backward(model, scratch)


@kernel
def _energies(model, parameters, state, scratch, n):
    for k in range(n):
        scratch.detail[k % 2], _ = energy.tissue_energies(model, parameters, state)


TIMED: dict[str, Callable[..., None]] = {
    "springs": _springs,
    "motion": _motion,
    "contact": _contact,
    "substitutions": _substitutions,
    "energies": _energies,
}


def part_times(assembly: Assembly, instance: Instance, names: Iterable[str]) -> dict[str, float]:
    """Time [µs] of one pass of parts, of those that can be timed alone, at the state of an instance."""
    model, state, scratch = Bundle(assembly.model), Bundle(instance.state), Bundle(instance.scratch)
    times = {}
    for name in TIMED.keys() & set(names):
        work = TIMED[name]
        work(model, instance.parameters, state, scratch, 1)  # compiles
        tries = []
        for _ in range(TRIES):
            before = thread_time()
            work(model, instance.parameters, state, scratch, REPEATS)
            tries.append(thread_time() - before)
        times[name] = 1e6 * min(tries) / REPEATS
    return times


# --- the step ---------------------------------------------------------------------------------------------


def solver_result(solver: str, machine: Machine, folder: Path) -> dict[str, Any]:
    """All figures of one integrator."""
    text = bench.scene_text(bench.tissue_text(bench.COMPARED, folder), solver)
    assembly, fmu = bench.built(text, folder)
    outputs, ns = drive(fmu, bench.poses()[1:], bench.STEP)
    around = slice(PRESSED - COUNTED, PRESSED + COUNTED)
    names = [v.name for v in assembly.variables if v.block == "outputs"]
    substeps = int(np.median(outputs[around, names.index("solver.substeps")]))
    step = float(ns[around].min()) / 1000  # as of the parts
    instance = Instance(assembly)
    for _ in run(instance, bench.poses()[: PRESSED + 1], bench.STEP):
        pass
    found = counts.parts(assembly, instance.state, instance.scratch, substeps)
    times = part_times(assembly, instance, [part.name for part in found])
    rows = []
    for part in found:
        least, limit = bound(part, machine)
        alone = times.get(part.name)
        rows.append(
            {
                "part": part.name,
                "passes": part.passes,
                "kflop": part.passes * part.flops / 1e3,
                "roots": part.passes * part.roots,
                "KB": part.passes * part.bytes / 1e3,
                "bound": least,
                "limit": limit,
                "measured": None if alone is None else part.passes * alone,
            }
        )
    measured = sum(row["measured"] or 0.0 for row in rows)
    counted = instructions.of_steps(fmu, bench.poses()[1 : PRESSED + COUNTED + 1], bench.STEP, COUNTED)
    return {
        "substeps": substeps,
        "parts": rows,
        "bound": sum(row["bound"] for row in rows),
        "step": step,
        "rest": step - measured,
        "rest bound": sum(row["bound"] for row in rows if row["measured"] is None),
        "instructions": counted,
        "instructions per cycle": None if counted is None else counted / (step * 1e-6 * machine.cycles),
    }


def remains(result: dict[str, Any]) -> str:
    """One sentence: the ratio of the whole, and the parts that are farthest from their bounds."""
    rows = [(row["part"], row["measured"], row["bound"]) for row in result["parts"] if row["measured"] is not None]
    rows.append(("what is not timed alone", result["rest"], result["rest bound"]))
    most = max(rows, key=lambda row: row[1] - row[2])
    farthest = max(rows, key=lambda row: row[1] / row[2])
    text = f"A step takes {result['step'] / result['bound']:.1f} times its bound. "
    text += f"Most is to be gained in {most[0]}: {most[1] - most[2]:.0f} of {result['step'] - result['bound']:.0f} µs"
    if farthest == most:
        return f"{text}; nothing is farther from its bound, by {most[1] / most[2]:.0f} times."
    return f"{text}; farthest from its bound is {farthest[0]}, by {farthest[1] / farthest[2]:.0f} times."


def measure(say: Callable[[str], None]) -> dict[str, Any]:
    """The figures of `make roofline`."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        say("the machine")
        machine = measure_machine(folder)
        levels = [{"name": level.name, "rate": level.rate} for level in machine.levels]
        results: dict[str, Any] = {"machine": machine._asdict() | {"levels": levels}}
        for solver, text in SOLVERS.items():
            say(solver)
            results[solver] = solver_result(text, machine, folder)
            results[solver]["remains"] = remains(results[solver])
    return results


def table(name: str, result: dict[str, Any]) -> Table:
    """The figures of one integrator as a table for the screen."""
    shown = Table("part", "passes", "kflop", "KB", "bound", "by", "measured", "ratio", title=f"{name}: µs in one step")
    for row in result["parts"]:
        alone = row["measured"]
        times = ("", "") if alone is None else (f"{alone:,.0f}", f"{alone / row['bound']:.1f}")
        amounts = (f"{row['passes']}", f"{row['kflop']:,.0f}", f"{row['KB']:,.0f}")
        shown.add_row(row["part"], *amounts, f"{row['bound']:,.1f}", row["limit"], *times)
    rest, least = result["rest"], result["rest bound"]
    shown.add_row("rest", "", "", "", f"{least:,.1f}", "", f"{rest:,.0f}", f"{rest / least:.1f}")
    whole = (f"{result['bound']:,.1f}", "", f"{result['step']:,.0f}", f"{result['step'] / result['bound']:.1f}")
    shown.add_row("step", "", "", "", *whole)
    return shown


def main(output: Path = Path("build/roofline.json")) -> None:
    """Measure, print and keep the figures."""
    check_file("--output", output)
    console = Console()
    results = measure(lambda text: console.print(f"measuring: {text}", style="dim"))
    machine = results["machine"]
    rates = [f"{level['name']} {level['rate'] / 1e9:.0f} GB/s" for level in machine["levels"]]
    peaks = f"{machine['flops_f64'] / 1e9:.0f} Gflop/s (f32 {machine['flops_f32'] / 1e9:.0f})"
    console.print(f"one core: {machine['cycles'] / 1e9:.2f} GHz, {peaks}, {', '.join(rates)}")
    for solver in SOLVERS:
        console.print(table(solver, results[solver]))
        console.print(results[solver]["remains"])
    publish(output, (json.dumps(results, indent=1) + "\n").encode())
    console.print(f"kept in {output}")


if __name__ == "__main__":
    typer.run(guarded(main, "roofline"))
