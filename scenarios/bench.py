"""`make bench`: what a step of 1 ms costs inside the FMU, on a press-slide-leave motion over meshes of growing size.

The whole step is timed by a small native program that drives the FMU; its parts by the same kernels, compiled just in
time, run again on the state that each step leaves. Figures in microseconds.
"""

import ctypes
import json
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from tissue_contact.assemble import assemble
from tissue_contact.assembly import Assembly
from tissue_contact.files import publish
from tissue_contact.fmu.build import build
from tissue_contact.fmu.native import drive, host_platform
from tissue_contact.kernels.compiled import kernel
from tissue_contact.kernels.layout import Real
from tissue_contact.kernels.step import _advance_all, _detect_all, _respond_all, _tissue_forces
from tissue_contact.scene import parse_scene
from tissue_contact.simulate import Instance

LEVELS = {"1.5K": 1500, "6K": 6000, "24K": 24000, "96K": 96000}
STEP = 1e-3  # s
CLOCK_MONOTONIC = 1

SCENE = """
name = "bench"
[solver]
max_substeps = 10000
[[tissue]]
shape = {{ kind = "patch", size = [0.06, 0.06], triangles = {triangles}, curvature_radius = 0.4, seed = 1 }}
areal_density = 1.0
stiffness = 200.0
drag = 20.0
[[instrument]]
shape = {{ kind = "capsule", radius = 0.0025, length = 0.04, triangles = 1500 }}
start_position = [-0.005, 0.0, 0.005]
{contact}
"""
CONTACT = """
[[contact]]
stiffness = 100.0
damping = 0.05
"""
EMPTY = """
name = "empty"
[[tissue]]
shape = { kind = "patch", size = [0.06, 0.06], triangles = 32 }
areal_density = 1000.0
stiffness = 0.01
[[instrument]]
shape = { kind = "box", size = [0.01, 0.01, 0.01] }
"""

_clock_gettime = ctypes.CDLL(None).clock_gettime
_clock_gettime.argtypes = [ctypes.c_int, ctypes.c_void_p]
_clock_gettime.restype = ctypes.c_int


def poses() -> Real:
    """Pose of the probe at every millisecond of 1 s: pressed 8 mm in 0.3 s, slid 10 mm, withdrawn; shape [1001, 7].

    Tilted by 20 degrees and slowly rolling, so that no axis is aligned with anything.
    """

    def smooth(u: Real) -> Real:
        return 0.5 - 0.5 * np.cos(np.pi * np.clip(u, 0, 1))

    t = np.arange(1001) * STEP
    tilt, roll = np.radians(20.0) / 2, np.radians(30.0) * t / 2
    x = -5e-3 + 10e-3 * smooth((t - 0.3) / 0.4)
    z = 5e-3 - 13e-3 * smooth(t / 0.3) + 13e-3 * smooth((t - 0.7) / 0.3)
    turn = [
        np.cos(tilt) * np.cos(roll),
        np.sin(tilt) * np.sin(roll),
        np.sin(tilt) * np.cos(roll),
        np.cos(tilt) * np.sin(roll),
    ]
    return np.column_stack([x, np.full_like(t, 2e-4), z, *turn])


@kernel
def _parts(model, parameters, state, scratch, substeps, dt, clock, spent):
    """Time [ns] of one detection, and of all the responses and tissue passes of a step, at the state as it is."""
    _clock_gettime(CLOCK_MONOTONIC, clock[0:].ctypes)
    _detect_all(model, state, scratch, 0.0)
    _clock_gettime(CLOCK_MONOTONIC, clock[2:].ctypes)
    for _ in range(substeps):
        _respond_all(model, parameters, state, scratch, 0.0, dt)
    _clock_gettime(CLOCK_MONOTONIC, clock[4:].ctypes)
    for _ in range(substeps):
        _tissue_forces(model, parameters, state, scratch)
        _advance_all(model, parameters, state, scratch, 0.0)  # no time passes: the state stays
    _clock_gettime(CLOCK_MONOTONIC, clock[6:].ctypes)
    for k in range(3):
        spent[k] = (clock[2 * k + 2] - clock[2 * k]) * 1000000000 + clock[2 * k + 3] - clock[2 * k + 1]


def part_times(assembly: Assembly, path: Real) -> Real:
    """Detection, response and tissue [µs] of every step, shape [steps, 3]."""
    instance = Instance(assembly)
    instance.inputs[:] = path[0]
    instance.initialize()
    (slot,) = [v.slot for v in assembly.variables if v.name == "solver.substeps"]
    clock, spent = np.zeros(8, np.int64), np.zeros(3, np.int64)
    out = np.empty((len(path) - 1, 3))
    for k, pose in enumerate(path[1:]):
        instance.inputs[:] = pose
        instance.step(STEP)
        instance.scratch.motion[:] = 0.0
        n = int(instance.outputs[slot])
        saved = instance.copy_state()
        _parts(
            instance.model, instance.parameters, instance.state, instance.scratch, n, STEP / n, clock, spent
        )
        instance.restore_state(saved)
        out[k] = spent / 1000
    return out


def figures(us: Real) -> dict[str, float]:
    """Median, 99th and 99.9th percentile and maximum."""
    values = np.percentile(us, [50, 99, 99.9, 100]) if us.size else np.full(4, np.nan)
    return {
        name: round(float(v), 3) for name, v in zip(("median", "p99", "p99.9", "max"), values, strict=True)
    }


def built(text: str, folder: Path) -> tuple[Assembly, Path]:
    """Assembly of a scene and its FMU for this machine."""
    assembly = assemble(parse_scene(text.encode(), Path()))
    return assembly, build(assembly, folder / f"{assembly.name}.fmu", [host_platform()])


def level_result(text: str, folder: Path) -> dict[str, Any]:
    """All figures of one mesh, in contact and out of it."""
    assembly, path = built(text, folder)
    inputs = poses()
    outputs, ns = drive(path, inputs[1:], STEP)
    names = [v.name for v in assembly.variables if v.block == "outputs"]
    pairs = outputs[:, names.index("solver.pairs")]
    substeps = outputs[:, names.index("solver.substeps")]
    touching = pairs > 0
    parts = part_times(assembly, inputs)
    step = ns / 1000
    result: dict[str, Any] = {
        "triangles": len(assembly.model.triangle_a),
        "vertices": len(assembly.model.rest_x),
        "springs": len(assembly.model.spring_i),
        "substeps": int(substeps.max()),
        "pairs in contact, median": float(np.median(pairs[touching])) if touching.any() else 0.0,
        "real-time factor, median": round(1e3 / float(np.median(step)), 3) if step.size else None,
        "step": figures(step),
        "step in contact": figures(step[touching]),
    }
    for k, name in enumerate(("detection", "response", "tissue")):
        result[f"{name} in contact"] = figures(parts[touching, k])
        result[f"{name} out of contact"] = figures(parts[~touching, k])
    return result


def fmi_overhead(folder: Path) -> dict[str, float]:
    """Whole step of a scene with next to nothing in it: 32 triangles, one substep, no contact."""
    _, path = built(EMPTY, folder)
    _, ns = drive(path, np.tile([0.0, 0, 0.05, 1, 0, 0, 0], (10000, 1)), STEP)
    return figures(ns / 1000)


def measure(levels: dict[str, int], say: Callable[[str], None]) -> dict[str, Any]:
    """All the figures of `make bench`."""
    results: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        say("FMI overhead")
        results["overhead"] = fmi_overhead(folder)
        for level, triangles in levels.items():
            say(f"{level} triangles")
            results[level] = level_result(SCENE.format(triangles=triangles, contact=CONTACT), folder)
        say("no contact declared")
        results["6K without a contact declared"] = level_result(
            SCENE.format(triangles=6000, contact=""), folder
        )
    return results


def table(results: dict[str, Any]) -> Table:
    """The figures as a table for the screen."""
    shown = Table("scene", "what", "median", "p99", "p99.9", "max", title="µs in one step of 1 ms")
    for level, result in results.items():
        rows = (
            {"step": result}
            if "median" in result
            else {k: v for k, v in result.items() if isinstance(v, dict)}
        )
        for what, f in rows.items():
            if not np.isnan(f["median"]):
                shown.add_row(level, what, *(f"{f[key]:,.1f}" for key in ("median", "p99", "p99.9", "max")))
        shown.add_section()
    return shown


def main(output: Path = Path("build/bench.json"), levels: str = ",".join(LEVELS)) -> None:
    """Measure, print and keep the figures."""
    console = Console()
    chosen = {level: LEVELS[level] for level in levels.split(",")}
    results = measure(chosen, lambda text: console.print(f"measuring: {text}", style="dim"))
    console.print(table(results))
    publish(output, (json.dumps(results, indent=1) + "\n").encode())
    console.print(f"kept in {output}")


if __name__ == "__main__":
    typer.run(main)
