"""`make bench`: what a step of 1 ms costs inside the FMU, on a press-slide-leave motion over meshes of growing size.

Timed by a small native program that drives the FMU. The parts of a step are timed by an FMU of the same kernels that
does one part several times over, each step by the fastest of some runs. Figures in microseconds.
"""

import json
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from tissue_contact.assemble import assemble
from tissue_contact.assembly import Assembly
from tissue_contact.commandline import guarded
from tissue_contact.files import publish
from tissue_contact.fmu.build import build
from tissue_contact.fmu.native import drive, host_platform
from tissue_contact.kernels import measured
from tissue_contact.kernels.layout import Real
from tissue_contact.presets import PRESETS
from tissue_contact.scene import parse_scene
from tissue_contact.settings import check_file, check_word
from tissue_contact.variables import Variable

# Cells along a side of the sheet, two triangles each, its length [m] and its support [N/m3]: ever finer; and as fine
# but larger. Supported, both feel the same contact, within 6 % of the force; else the larger one is thrown off the tip.
LEVELS = {
    "1.5K": (27, 0.06, 0.0),
    "6K": (55, 0.06, 0.0),
    "24K": (110, 0.06, 0.0),
    "96K": (219, 0.06, 0.0),
    "6K supported": (55, 0.06, 1e5),
    "96K supported": (220, 0.24, 1e5),
}
COMPARED = "6K"  # the sheet on which a step has a budget
STEP = 1e-3  # s
ROUNDS, PATIENCE = 6, 30.0  # of runs of which the fastest of each step counts, and seconds for them
REPEATS = {"detection": 64, "response": 4, "tissue": 1}  # of a part, to time it: the more, the less it takes
MEASURED = Path(measured.__file__)  # kernels of a step that does its parts once more, as often as it is told
PARTS = {"accurate": tuple(REPEATS), "fast": ("detection", "response")}  # that are timed; "tissue" is symplectic Euler

SCENE = """
name = "bench"
[solver]
max_substeps = 10000
{solver}
[[tissue]]
{tissue}
areal_density = 1.0
stiffness = 200.0
drag = 20.0
[[instrument]]
shape = {{ kind = "capsule", radius = 0.0025, length = 0.04, triangles = 1500 }}
start_position = [-0.005, 0.0, 0.005]
{contact}
"""
MESH = 'mesh = "{name}"\nopen_surface = true'
PRESET = 'preset = "{}"'
PATCH = 'shape = {{ kind = "patch", size = [0.06, 0.06], triangles = 6000, curvature_radius = 0.4, seed = 1{more} }}'
IRREGULAR = PATCH.format(more="")
# As fine as that where the capsule gets to: within two radii of the line that its tip slides along.
REACH = "reach = [[-0.01, -0.005, -0.01], [0.01, 0.005, 0.0]]"
GRADED = PATCH.format(more=f", {REACH}")
CONTACT = """
[[contact]]
stiffness_per_area = 1e8
damping_per_area = 2e4
"""
SPARSE = CONTACT + "quadrature_spacing = 1e-3\n"  # four points on a triangle of the sheets in the place of nine
CONTACTS = {CONTACT: "", SPARSE: ", points 1 mm apart", "": ", no contact declared"}
EMPTY = """
name = "empty"
[[tissue]]
shape = { kind = "patch", size = [0.06, 0.06], triangles = 32 }
areal_density = 1000.0
stiffness = 0.01
[[instrument]]
shape = { kind = "box", size = [0.01, 0.01, 0.01] }
"""


def cut_cells(along: int, across: int) -> NDArray[np.intp]:
    """Triangles, shape [2 along across, 3], of a grid of cells, each cut along the same diagonal.

    Vertices are numbered across first, from 0.
    """
    corner = (np.arange(along)[:, None] * (across + 1) + np.arange(across)).ravel()
    right, up = corner + across + 1, corner + 1
    return np.concatenate([np.column_stack([corner, right, right + 1]), np.column_stack([corner, right + 1, up])])


def sheet(cells: int, length: float = 0.06) -> str:
    """OBJ text of a curved square sheet of a length [m], cells x cells, each cut along the same diagonal."""
    side = np.linspace(-length / 2, length / 2, cells + 1)
    x, y = (c.ravel() for c in np.meshgrid(side, side, indexing="ij"))
    faces = cut_cells(cells, cells) + 1
    lines = [f"v {a!r} {b!r} {-(a * a + b * b) / 0.8!r}" for a, b in zip(x.tolist(), y.tolist(), strict=True)]
    return "\n".join([*lines, *(f"f {a} {b} {c}" for a, b, c in faces.tolist())]) + "\n"


def write_sheet(level: str, folder: Path) -> Path:
    """Write the sheet of a level to a folder."""
    mesh = folder / f"{level}.obj"
    cells, length, _ = LEVELS[level]
    mesh.write_text(sheet(cells, length))
    return mesh


def tissue_text(level: str, folder: Path) -> str:
    """Text of the tissue of a level, whose sheet is written to a folder."""
    *_, support = LEVELS[level]
    return f"{MESH.format(name=write_sheet(level, folder).name)}\nsupport_stiffness = {support}"


def scene_text(tissue: str, solver: str = "", contact: str = CONTACT) -> str:
    """Text of the scene with a tissue: a mesh or a shape."""
    return SCENE.format(solver=solver, tissue=tissue, contact=contact)


def on_sheet(mesh: Path, solver: str = "", contact: str = CONTACT) -> str:
    """Text of the scene with a sheet that lies beside it."""
    return scene_text(MESH.format(name=mesh.name), solver, contact)


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


def figures(us: Real) -> dict[str, float]:
    """Median, 99th and 99.9th percentile and maximum."""
    values = np.percentile(us, [50, 99, 99.9, 100]) if us.size else np.full(4, np.nan)
    return {name: round(float(v), 3) for name, v in zip(("median", "p99", "p99.9", "max"), values, strict=True)}


def built(text: str, folder: Path) -> tuple[Assembly, Path]:
    """Assembly of a scene and its FMU for this machine."""
    assembly = assemble(parse_scene(text.encode(), folder))
    return assembly, build(assembly, folder / f"{assembly.name}.fmu", [host_platform()])


def fastest(fmu: Path, path: Real, starts: dict[str, float] | None = None) -> Real:
    """Time [µs] of every step, the least of some runs: as many as fit into `PATIENCE`, `ROUNDS` at most."""
    begun, found, rounds = time.monotonic(), np.full(len(path), np.inf), 0
    while rounds == 0 or (rounds < ROUNDS and (time.monotonic() - begun) * (rounds + 1) / rounds < PATIENCE):
        found = np.minimum(found, drive(fmu, path, STEP, starts=starts)[1] / 1000)
        rounds += 1
    return found


def repeating(assembly: Assembly, folder: Path) -> Path:
    """The FMU of an assembly with parameters ``repeat.`` and the name of a part: how often a step does it once more."""
    first = len(assembly.parameters)
    repeats = [
        Variable(f"repeat.{part}", "parameters", first + k, "1", 0.0, 0.0, 100.0, f"repeats of {part}")
        for k, part in enumerate(measured.REPEATS)
    ]
    assembly = replace(
        assembly,
        parameters=np.concatenate([assembly.parameters, np.zeros(3)]),
        variables=(*assembly.variables, *repeats),
    )
    return build(assembly, folder / "measured.fmu", [host_platform()], kernels=MEASURED)


def part_times(assembly: Assembly, folder: Path, path: Real, parts: Sequence[str]) -> dict[str, Real]:
    """Time [µs] of parts in every step: with the part repeated, less without."""
    fmu = repeating(assembly, folder)
    plain = fastest(fmu, path)
    return {p: (fastest(fmu, path, {f"repeat.{p}": REPEATS[p]}) - plain) / REPEATS[p] for p in parts}


def level_result(text: str, folder: Path, parts: Sequence[str]) -> dict[str, Any]:
    """All figures of one mesh, in contact and out of it, with those of some parts."""
    assembly, fmu = built(text, folder)
    inputs = poses()[1:]
    outputs, ns = drive(fmu, inputs, STEP)
    names = [v.name for v in assembly.variables if v.block == "outputs"]
    pairs = outputs[:, names.index("solver.pairs")]
    touching = pairs > 0
    step = ns / 1000
    result: dict[str, Any] = {
        "triangles": len(assembly.model.triangle_a),
        "vertices": len(assembly.model.rest_x),
        "springs": len(assembly.model.spring_i),
        "substeps": int(outputs[:, names.index("solver.substeps")].max()),
        "pairs in contact, median": float(np.median(pairs[touching])) if touching.any() else 0.0,
        "real-time factor, median": round(1e6 / float(np.median(ns)), 3),
        "step": figures(step),
        "step in contact": figures(step[touching]),
    }
    own = np.minimum(step, fastest(fmu, inputs))  # what a step takes beyond that is the machine's
    for where, steps in (("", slice(None)), (" in contact", touching), (" out of contact", ~touching)):
        result[f"step{where}, fastest"] = figures(own[steps])
    for part, us in part_times(assembly, folder, inputs, parts).items() if parts else ():
        result[f"{part} in contact"] = figures(us[touching])
        result[f"{part} out of contact"] = figures(us[~touching])
    return result


def fmi_overhead(folder: Path) -> dict[str, float]:
    """Whole step of a scene with next to nothing in it: 32 triangles, one substep, no contact."""
    _, path = built(EMPTY, folder)
    _, ns = drive(path, np.tile([0.0, 0, 0.05, 1, 0, 0, 0], (10000, 1)), STEP)
    return figures(ns / 1000)


def measure(levels: Sequence[str], say: Callable[[str], None]) -> dict[str, Any]:
    """All the figures of `make bench`."""
    results: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        say("FMI overhead")
        results["overhead"] = fmi_overhead(folder)
        tissues = {level: tissue_text(level, folder) for level in levels}
        reaching = {f"{level} with a reach": f"{tissue}\n{REACH}" for level, tissue in tissues.items()}
        tissues |= {"6K irregular": IRREGULAR, "6K graded": GRADED}
        cases = [(level, "accurate", CONTACT) for level in tissues]
        tissues |= reaching
        cases += [(level, preset, CONTACT) for level in tissues for preset in sorted(PRESETS.keys() - {"accurate"})]
        cases += [(level, "fast", SPARSE) for level in ("6K graded", f"{COMPARED} with a reach") if level in tissues]
        cases += [("6K irregular", "accurate", "")]
        for level, preset, contact in cases:
            what = level + (f" {preset}" if preset != "accurate" else "") + CONTACTS[contact]
            say(what)
            text = scene_text(tissues[level], PRESET.format(preset), contact)
            results[what] = level_result(text, folder, PARTS.get(preset, ()))
    return results


def table(results: dict[str, Any]) -> Table:
    """The figures as a table for the screen."""
    shown = Table("scene", "what", "median", "p99", "p99.9", "max", title="µs in one step of 1 ms")
    for level, result in results.items():
        rows = {"step": result} if "median" in result else {k: v for k, v in result.items() if isinstance(v, dict)}
        for what, f in rows.items():
            if not np.isnan(f["median"]):
                shown.add_row(level, what, *(f"{f[key]:,.1f}" for key in ("median", "p99", "p99.9", "max")))
        shown.add_section()
    return shown


def main(output: Path = Path("build/bench.json"), levels: str = ",".join(LEVELS)) -> None:
    """Measure, print and keep the figures."""
    check_file("--output", output)
    for level in levels.split(","):
        check_word("--levels", level, LEVELS)
    console = Console()
    results = measure(levels.split(","), lambda text: console.print(f"measuring: {text}", style="dim"))
    console.print(table(results))
    publish(output, (json.dumps(results, indent=1) + "\n").encode())
    console.print(f"kept in {output}")


if __name__ == "__main__":
    typer.run(guarded(main, "bench"))
