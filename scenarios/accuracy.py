"""`make accuracy`: the force of every response against a converged reference, and of two meshes of one organ.

Every run is kept in the output file as soon as it is done. When started again, runs of the same scene, motion and
sources are taken from there, so that an interrupted measurement goes on where it was.
"""

import hashlib
import json
import math
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console
from scipy.spatial.transform import Rotation

from tissue_contact import geometry, shapes
from tissue_contact.assemble import assemble
from tissue_contact.commandline import guarded
from tissue_contact.errors import WorkError
from tissue_contact.fields import CUTS_MAX, longest_edges, quadrature
from tissue_contact.files import publish
from tissue_contact.fmu.build import build
from tissue_contact.geometry import Surface
from tissue_contact.scenarios.outcome import Trace
from tissue_contact.scenarios.run import communication_points, drive, empty_trace, instance_of, scene_key
from tissue_contact.scenarios.stimulus import minimum_jerk
from tissue_contact.scene import Scene, parse_scene
from tissue_contact.settings import check_file, check_word
from tissue_contact.simulate import Instance

FloatArray = NDArray[np.float64]
Say = Callable[[str], None]

STEP = 1e-3  # s, communication step
COARSE, COMPARED, CONVERGED = 1500, 6000, 96000  # triangles of the sheet
MESHES = (COARSE, COMPARED, 24000, CONVERGED)
ROUNDS = 5  # of the timed runs, one response after the other, of which the fastest counts

# Tissue as in the press scenario, springs from a Young's modulus.
SCENE = """
name = "accuracy"
[solver]
preset = "accurate"
max_substeps = 100000
{solver}
[[tissue]]
shape = {{ kind = "patch", size = [0.06, 0.06], triangles = {triangles}, curvature_radius = 0.4, seed = 1 }}
areal_density = 2.0
youngs_modulus = 1e5
thickness = 0.002
support_stiffness = 1e5
support_damping = 4000.0
[[instrument]]
shape = {{ {shape} }}
start_position = {position}
start_orientation = {orientation}
[[contact]]
{contact}
"""
SHAPES = {
    "capsule": 'kind = "capsule", radius = 0.0025, length = 0.04, triangles = 1500',
    "box": 'kind = "box", size = [0.006, 0.006, 0.03], triangles = 768',
}
# So stiff that the tissue gives way, not the contact; damped about critically: 2 sqrt(k rho) for the field, and for a
# whole contact 2 sqrt(k m) of the 4e-5 kg of tissue under the round tip.
FIELD = "stiffness_per_area = 2e8\ndamping_per_area = 4e4"
WHOLE = 'response = "{response}"\nstiffness = 400.0\ndamping = 0.25'
FINE = "\nquadrature_spacing = 0.0003"  # m, half of what the compared runs use without being told
COARSE_FINE = "\nquadrature_spacing = 0.0004"  # m, as fine as the coarse sheet allows
GAINS = "energy_gain = 1000.0"  # energy from nowhere is measured, not refused; but raw pairs run off
OFTEN = "substeps = 160"  # twice what the finest mesh needs
RESPONSES = {
    "distance_field": FIELD,
    "hull": WHOLE.format(response="hull"),
    "kdop 26": WHOLE.format(response="kdop") + "\nkdop = 26",
    "kdop 14": WHOLE.format(response="kdop") + "\nkdop = 14",
    "kdop 6": WHOLE.format(response="kdop") + "\nkdop = 6",
    "oobb": WHOLE.format(response="oobb"),
    "oobb_literal": WHOLE.format(response="oobb_literal"),
    "primitive": WHOLE.format(response="primitive"),
}
ON_COARSE = ("distance_field", "hull")  # what is compared on the coarse sheet too
RAW = WHOLE.format(response="hull") + '\npair_weight = "none"'


# --- motions ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Case:
    """A motion of an instrument, by its body frame's origin x, z [mm] at times [ms].

    ``even`` is for an even speed between two points; the others are smooth. The instrument is turned about x.
    """

    points: tuple[tuple[float, float, float], ...]
    shape: str = "capsule"
    tilt: float = 0.0  # degree
    even: bool = False

    def orientation(self) -> list[float]:
        """Unit quaternion w, x, y, z."""
        half = math.radians(self.tilt) / 2
        return [math.cos(half), math.sin(half), 0.0, 0.0]

    def inputs(self, times: FloatArray) -> FloatArray:
        """Pose at some times [s], shape (n, 7)."""
        points = np.array(self.points) * 1e-3
        first = np.clip(np.searchsorted(points[:, 0], times, side="right") - 1, 0, len(points) - 2)
        share = np.clip((times - points[first, 0]) / (points[first + 1, 0] - points[first, 0]), 0.0, 1.0)
        share = share if self.even else minimum_jerk(share)
        x, z = (points[first, k] + share * (points[first + 1, k] - points[first, k]) for k in (1, 2))
        off_axis = np.full(len(times), 1e-4)  # m, off the symmetry of the sheet
        return np.column_stack([x, off_axis, z, np.tile(self.orientation(), (len(times), 1))])


PRESS = ((0.0, 0.2, 1.0), (200.0, 0.2, -5.0), (300.0, 0.2, -5.0))
CASES = {
    "press": Case(PRESS),
    "slide": Case(((0.0, -5.0, 1.0), (150.0, -5.0, -4.0), (400.0, 5.0, -4.0), (500.0, 5.0, 1.0))),
    "tilt": Case(PRESS, tilt=30.0),
    # 6 mm in 7.5 ms, at most 1.5 m/s
    "poke": Case(((0.0, 0.2, 2.0), (2.0, 0.2, 2.0), (9.5, 0.2, -4.0), (40.0, 0.2, -4.0), (60.0, 0.2, 2.0))),
    "flat": Case(PRESS, "box"),
    "edge": Case(PRESS, "box", tilt=30.0),
    # 0.15 m/s. The touch is at 100.5 ms, half a millisecond after 1 kHz, 100 Hz and 30 Hz all look; and delayed.
    "late": Case(((0.0, 0.2, 15.075), (133.833, 0.2, -5.0), (250.0, 0.2, -5.0)), even=True),
}
DISCRETE = {"1 kHz": 1e-3, "100 Hz": 1e-2, "30 Hz": 1 / 30}  # s between two detections
DELAYS = (0, 8, 16, 24)  # steps of the late case: how long after a detection the touch comes


@dataclass(frozen=True)
class Run:
    """One scene and one motion."""

    case: str
    triangles: int
    contact: str
    solver: str = ""
    delay: int = 0  # steps that the motion begins later; they are not kept, so that the rest compares

    def scene(self) -> Scene:
        """The scene, validated."""
        case = CASES[self.case]
        x, y, z = case.inputs(np.zeros(1))[0, :3].tolist()
        text = SCENE.format(
            solver=self.solver if self.contact == RAW else f"{self.solver}\n{GAINS}",
            triangles=self.triangles,
            shape=SHAPES[case.shape],
            position=[x, y, z],
            orientation=case.orientation(),
            contact=self.contact,
        )
        return parse_scene(text.encode(), Path())


def runs() -> dict[str, Run]:
    """Every run by its name: the case, then what is varied."""
    found = {}
    for name in CASES:
        for n in MESHES:
            found[f"{name}, reference, {n}"] = Run(name, n, FIELD + (COARSE_FINE if n == COARSE else FINE), OFTEN)
        if name != "late":
            for response, contact in RESPONSES.items():
                found[f"{name}, {response}"] = Run(name, COMPARED, contact)
            for response in ON_COARSE:
                found[f"{name}, {response}, coarse"] = Run(name, COARSE, RESPONSES[response])
            found[f"{name}, hull, raw pairs"] = Run(name, COMPARED, RAW)
            continue
        for response, contact in RESPONSES.items():
            found[f"{name}, {response}, continuous"] = Run(name, COMPARED, contact)
            for rate, period in DISCRETE.items():
                solver = f'detection = "discrete"\ndetection_period = {period!r}'
                for delay in DELAYS if period > STEP else DELAYS[:1]:
                    found[f"{name}, {response}, {rate}, {delay}"] = Run(name, COMPARED, contact, solver, delay)
    for name in ("press", "poke"):
        for substeps in (40, 80, 320):  # 40 by itself
            solver = f"substeps = {substeps}"
            found[f"{name}, reference, 24000, {substeps} substeps"] = Run(name, 24000, FIELD + FINE, solver)
    # What calms a box: a softer contact, or a detection in every substep.
    found["press, distance_field, 8e8"] = Run("press", 24000, "stiffness_per_area = 8e8\ndamping_per_area = 8e4" + FINE)
    found["press, hull, 4 times as stiff"] = Run("press", COMPARED, RESPONSES["hull"].replace("400.0", "1600.0"))
    for response in ("kdop 14", "oobb"):
        soft, often = RESPONSES[response].replace("400.0", "100.0"), "detection_period = 2e-5"
        found[f"press, {response}, a quarter as stiff"] = Run("press", COMPARED, soft)
        found[f"press, {response}, every substep"] = Run("press", COMPARED, RESPONSES[response], often)
    return found


# --- running ----------------------------------------------------------------------------------------------


def built(scene: Scene, folder: Path) -> Path:
    """The scene's FMU for this machine."""
    return build(assemble(scene), folder / "accuracy.fmu", [fmpy.platform])


def followed(fmu: Path, case: Case, delay: int = 0) -> tuple[Trace, str]:
    """Rows of an FMU moved as the case says, some steps later, and what ended it early, if anything."""
    about = fmpy.read_model_description(str(fmu))
    times, steps = communication_points(case.points[-1][0] * 1e-3 + delay * STEP, STEP)
    trace = empty_trace(about, times)
    pose = case.inputs(np.maximum(times - delay * STEP, 0.0))
    names = [f"instrument.position[{k}]" for k in (1, 2, 3)] + [f"instrument.orientation[{k}]" for k in (1, 2, 3, 4)]
    try:
        with instance_of(fmu, about, []) as slave:
            drive(slave, about, steps, dict(zip(names, pose.T, strict=True)), {}, trace)
    except WorkError as error:
        return trace, str(error)
    return trace, ""


def median_cost(trace: Trace) -> float:
    """Median time of a step in contact [µs]."""
    touching = np.linalg.norm(trace.vector("instrument.force"), axis=1) > 0.0
    return float(1e6 * np.median(trace.step_time[: trace.done][touching])) if touching.any() else 0.0


def record(trace: Trace, refusal: str, delay: int = 0) -> dict[str, Any]:
    """What is kept of a run: the force at every communication point after the delay, and figures."""
    work, balance = (float(np.abs(trace.column(f"energy.{name}")).max()) for name in ("work", "balance"))
    return {
        "steps": len(trace.time) - 1 - delay,
        "force": [[float(f"{f:.7g}") for f in row] for row in trace.vector("instrument.force")[delay:].tolist()],
        "depth": float(trace.column("instrument.depth").max()),
        "substeps": int(trace.column("solver.substeps").max()),
        "balance": balance / work if work > 0.0 else 0.0,
        "us": median_cost(trace),
        "refusal": refusal,
    }


def key_of(run: Run) -> str:
    """Hash of all that a run depends on."""
    motion = CASES[run.case].inputs(np.linspace(0.0, CASES[run.case].points[-1][0] * 1e-3, 100))
    return f"{scene_key(run.scene())}-{hashlib.sha256(motion.tobytes()).hexdigest()[:16]}-{run.delay}"


def timed(folder: Path, say: Say) -> dict[str, float]:
    """Median time of a step in contact [µs] in the press case, of the fastest of some rounds."""
    asked = {name: Run("press", COMPARED, contact) for name, contact in RESPONSES.items()}
    asked |= {f"{name}, coarse": Run("press", COARSE, RESPONSES[name]) for name in ON_COARSE}
    fmus = {}
    for name, run in asked.items():
        (folder / name).mkdir()
        fmus[name] = built(run.scene(), folder / name)
    found = dict.fromkeys(fmus, math.inf)
    for k in range(ROUNDS):
        say(f"step times, round {k + 1} of {ROUNDS}")
        for name, fmu in fmus.items():
            found[name] = min(found[name], median_cost(followed(fmu, CASES["press"])[0]))
    return found


# --- errors -----------------------------------------------------------------------------------------------


def errors(force: FloatArray, reference: FloatArray) -> tuple[float, float]:
    """Relative L2 error of the force vector over a run, and relative error of its peak.

    A run that was refused counts as far as it came for the error over the run, against the same part of the reference.
    """
    same = reference[: len(force)]
    size, true = (float(np.linalg.norm(f, axis=1).max()) for f in (force, reference))
    return float(np.linalg.norm(force - same)) / max(float(np.linalg.norm(same)), 1e-30), size / true - 1.0


def summary(kept: Mapping[str, Any]) -> dict[str, Any]:
    """Errors and figures of every run that is there, without its rows."""
    found = {}
    for name, run in kept["runs"].items():
        case = name.split(",")[0]
        reference = kept["runs"].get(f"{case}, reference, {CONVERGED}")
        if reference is None:
            continue
        force = np.array(run["force"]).reshape(-1, 3)
        over_run, peak = errors(force, np.array(reference["force"]))
        size = np.linalg.norm(force, axis=1)
        figures = {
            "error": over_run,
            "peak error": peak,
            "peak": float(size.max()),
            "end": float(size[-1]),
            "depth": run["depth"],
            "balance": run["balance"],
            "substeps": run["substeps"],
        }
        found[name] = {k: float(f"{v:.4g}") for k, v in figures.items()}
        if run["refusal"]:
            found[name]["refused at"] = STEP * len(force)
    return {"runs": found, "us": kept.get("us", {}), "meshes": kept.get("meshes", {})}


# --- one organ, two meshes --------------------------------------------------------------------------------

# A gallbladder full of bile and under tension, as an obstructed one is: a soft wall of 2 mm, stretched, round a volume
# that hardly changes, in soft surroundings.
ORGAN = """
name = "organ"
[solver]
preset = "accurate"
max_substeps = 100000
[[tissue]]
{source}
fixed = "none"
areal_density = 2.0
youngs_modulus = 1e5
thickness = 0.002
preload = {preload}
volume_stiffness = 1e6
support_stiffness = {support}
support_damping = 200.0
[[instrument]]
shape = {{ kind = "sphere", radius = {radius}, triangles = 500 }}
start_position = {position}
[[contact]]
stiffness_per_area = 1e7
damping_per_area = 100.0
quadrature_spacing = {spacing}
"""
SPACING = 5e-4  # m, or as fine as a mesh allows
PLACES = 6
AWAY = 0.05  # m, of the tip from the organ while that comes to rest
CLEARANCE = 1e-4  # m, of the tip from the organ before it is pressed
RESTING, PRESSING, HOLDING, SLOW = 30, 8, 24, 5e-3  # steps of coming to rest, of a press and after it, their length [s]


@dataclass(frozen=True)
class Study:
    """How an organ is pressed: radius of the tip and depth [m], stretch of the wall, support [N/m³]."""

    radius: float = 0.01
    depth: float = 0.01
    preload: float = 0.1
    support: float = 3e4


TAUT = Study()
STUDIES = {
    "taut wall": TAUT,
    "less deep": Study(depth=0.005),
    "thinner tip": Study(radius=0.005),
    "firm support": Study(support=3e5),
    "slack wall": Study(preload=0.0),
    "slack wall, firm support": Study(preload=0.0, support=3e5),
}


@dataclass(frozen=True, eq=False)
class Place:
    """Where an organ is pressed: a point near its surface [m] and the outer normal there."""

    point: FloatArray
    normal: FloatArray


def places(surface: Surface, count: int, radius: float = 0.012) -> list[Place]:
    """The broadest places of a surface: of 60 spread evenly those about which the normals turn least."""
    corners = surface.vertices[surface.triangles]
    middle = corners.mean(axis=1)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    distance, last, found = np.full(len(middle), np.inf), 0, []
    for _ in range(60):  # each the farthest from those before
        distance = np.minimum(distance, np.linalg.norm(middle - middle[last], axis=1))
        last = int(distance.argmax())
        near = normal[np.linalg.norm(middle - middle[last], axis=1) < radius]
        mean = near.sum(axis=0)
        size = float(np.linalg.norm(mean))
        found.append((size / np.linalg.norm(near, axis=1).sum(), Place(middle[last], mean / size)))
    found.sort(key=lambda entry: -entry[0])
    return [place for _, place in found[:count]]


def touch(surface: Surface, place: Place, radius: float) -> float:
    """Height [m] above a place, along its normal, of the lowest point of a ball that just touches the surface."""
    start, weight, _ = quadrature(surface, 5e-4)
    points = np.einsum("nk,nkc->nc", weight, np.repeat(surface.vertices[surface.triangles], np.diff(start), axis=0))
    offset = np.concatenate([points, surface.vertices]) - place.point
    height = offset @ place.normal
    aside = ((offset - np.outer(height, place.normal)) ** 2).sum(axis=1)
    under = (aside < radius**2) & (np.abs(height) < 3 * radius)
    return float((height[under] + np.sqrt(radius**2 - aside[under])).max() - radius)


@dataclass(frozen=True, eq=False)
class Mesh:
    """An organ's mesh: the lines of a scene that tell of it, and its surface."""

    source: str
    surface: Surface

    def spacing(self) -> float:
        """Of the points at which depth is read [m]."""
        return max(SPACING, float(longest_edges(self.surface).max()) / CUTS_MAX)


def settled_force(mesh: Mesh, place: Place, study: Study) -> float:
    """Force [N] along the normal on a ball pressed into an organ and held.

    The organ comes to rest before it is touched, and depth counts from the
    first touch, each mesh from its own.
    """
    up, far = place.normal, place.point + AWAY * place.normal
    scene = ORGAN.format(
        source=mesh.source, radius=study.radius, position=far.tolist(), preload=study.preload, support=study.support,
        spacing=mesh.spacing(),
    )  # fmt: skip
    assembly = assemble(parse_scene(scene.encode(), Path()))
    slots = [v.slot for k in (1, 2, 3) for v in assembly.variables if v.name == f"instrument.force[{k}]"]
    instance = Instance(assembly)
    instance.inputs[3:7] = np.roll(Rotation.align_vectors([up], [[0.0, 0.0, 1.0]])[0].as_quat(), 1)
    instance.initialize()
    for _ in range(RESTING):
        instance.step(SLOW)
    model, state = assembly.model, instance.state
    triangles = np.column_stack([model.triangle_a, model.triangle_b, model.triangle_c]).astype(np.int32)
    rested = Surface(np.column_stack([state.x, state.y, state.z]), triangles)
    touching = place.point + touch(rested, place, study.radius) * up
    instance.inputs[:3] = touching + CLEARANCE * up
    instance.step(SLOW)
    for share in (*np.linspace(0.0, 1.0, PRESSING + 1), *np.ones(HOLDING)):
        instance.inputs[:3] = touching - share * study.depth * up
        instance.step(SLOW)
    return float(instance.outputs[slots] @ up)


@dataclass(frozen=True, eq=False)
class Organ:
    """One organ in several meshes, from coarse to fine."""

    name: str
    meshes: dict[str, Mesh]

    @property
    def finest(self) -> Surface:
        """Surface of the finest mesh."""
        return list(self.meshes.values())[-1].surface


def cut(surface: Surface) -> Surface:
    """The same surface with every triangle cut in four, twice."""
    for _ in range(2):
        edges = geometry.edges(surface)
        count = len(surface.vertices)
        number = {(int(a), int(b)): count + k for k, (a, b) in enumerate(edges)}
        made = []
        for corners in surface.triangles.tolist():
            a, b, c = corners
            ab, bc, ca = (number[min(e), max(e)] for e in ((a, b), (b, c), (c, a)))
            made += [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
        middle = surface.vertices[edges].mean(axis=1)
        surface = Surface(np.concatenate([surface.vertices, middle]), np.array(made, np.int32))
    return surface


def gallbladder(folder: Path, room: Path) -> Organ:
    """The gallbladder of 500 and of 14,700 triangles, files that are not part of this project.

    Between them the coarse one with its triangles cut in 16, which is written into ``room``.
    """
    coarse, fine = (folder / f"lapgym_gallbladder_{which}.stl" for which in ("collision", "visual"))
    surfaces = [geometry.load(path, scale=0.001)[0] for path in (coarse, fine)]
    between, rough = room / "cut.obj", cut(surfaces[0])
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in rough.vertices.tolist()]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in rough.triangles.tolist()]
    between.write_text("\n".join(lines) + "\n")
    meshes = {
        "500": Mesh(f"mesh = {json.dumps(str(coarse.resolve()))}\nscale = 0.001", surfaces[0]),
        "500 cut": Mesh(f"mesh = {json.dumps(str(between.resolve()))}", rough),
        "14700": Mesh(f"mesh = {json.dumps(str(fine.resolve()))}\nscale = 0.001", surfaces[1]),
    }
    return Organ("gallbladder", meshes)


def ellipsoid() -> Organ:
    """A generated organ of the size of a gallbladder."""
    line = 'shape = {{ kind = "ellipsoid", radii = [0.03, 0.016, 0.016], triangles = {n} }}'
    meshes = {str(n): Mesh(line.format(n=n), shapes.ellipsoid((0.03, 0.016, 0.016), n)) for n in (500, 8000)}
    return Organ("ellipsoid", meshes)


def refinement(
    organ: Organ, at: Iterable[Place], study: Study = TAUT, meshes: Sequence[str] = ()
) -> dict[str, list[float]]:
    """Settled force [N] at every place, by mesh; all of the organ's meshes unless some are named."""
    at = list(at)
    return {name: [settled_force(organ.meshes[name], place, study) for place in at] for name in meshes or organ.meshes}


# --- all of it --------------------------------------------------------------------------------------------


def measure(output: Path, wanted: Sequence[str], meshes: Path, say: Say) -> dict[str, Any]:
    """Do what is not yet in the output file, and keep every part as soon as it is done."""
    kept: dict[str, Any] = {"runs": {}, "us": {}, "meshes": {}}
    if output.is_file():
        kept |= json.loads(output.read_text("utf-8"))

    def keep() -> None:
        publish(output, (json.dumps(kept) + "\n").encode())

    asked = {name: run for name, run in runs().items() if name.split(",")[0] in wanted}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for k, (name, run) in enumerate(asked.items()):
            key = key_of(run)
            if kept["runs"].get(name, {}).get("key") == key:
                continue
            say(f"run {k + 1} of {len(asked)}: {name}")
            done = record(*followed(built(run.scene(), folder), CASES[run.case], run.delay), run.delay)
            kept["runs"][name] = {"key": key, **done}
            keep()
        if "time" in wanted:
            kept["us"] = timed(folder, say)
            keep()
    if "meshes" in wanted:
        study_meshes(kept["meshes"], meshes, say, keep)
    return kept


def study_meshes(kept: dict[str, Any], meshes: Path, say: Say, keep: Callable[[], None]) -> None:
    """Forces on the coarse and the fine mesh of an organ, into ``kept``; those that are there stay."""
    with tempfile.TemporaryDirectory() as room:
        organs = [ellipsoid()]
        if (meshes / "lapgym_gallbladder_visual.stl").is_file():
            organs.append(gallbladder(meshes, Path(room)))
        else:
            say(f"no meshes of the gallbladder in {meshes}: left out")
        for organ in organs:
            at = places(organ.finest, PLACES)
            for name, study in STUDIES.items():
                if kept.get(f"{organ.name}, {name}", {}).get("study") == asdict(study):
                    continue
                say(f"{organ.name}, {name}")
                kept[f"{organ.name}, {name}"] = {"study": asdict(study), "forces": refinement(organ, at, study)}
                keep()


PARTS = (*CASES, "time", "meshes")


def main(
    output: Path = Path("build/accuracy.json"),
    parts: str = ",".join(PARTS),
    meshes: Path = Path("../shared/meshes"),
) -> None:
    """Measure what is not yet in the output file; its parts are the cases, the step times and the two meshes."""
    check_file("--output", output)
    console = Console(stderr=True)
    wanted = parts.split(",")
    for part in wanted:
        check_word("--parts", part, PARTS)
    kept = measure(output, wanted, meshes, lambda text: console.print(text, style="dim", highlight=False))
    publish(output.with_name(f"{output.stem}-summary.json"), (json.dumps(summary(kept), indent=1) + "\n").encode())
    console.print(f"kept in {output}", highlight=False)


if __name__ == "__main__":
    typer.run(guarded(main, "accuracy"))
