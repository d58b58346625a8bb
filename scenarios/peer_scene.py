"""What all of `make peers` looks at: the press-slide-leave scene of the bench, and its motion as recorded once."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.interpolate import LinearNDInterpolator

from tissue_contact.assemble import assemble
from tissue_contact.assembly import Assembly
from tissue_contact.kernels.layout import Index, Real
from tissue_contact.scenarios import bench
from tissue_contact.scene import parse_scene
from tissue_contact.simulate import Instance, run

PRESSED = 300  # ms, the end of the press, when the probe is deepest
HULL = '[[contact]]\nresponse = "hull"\nstiffness = 100.0'  # a response that goes by intersecting triangles


class Mesh(NamedTuple):
    """A triangle mesh."""

    vertices: Real  # [m], shape [V, 3]
    triangles: Index  # shape [T, 3]


class PeerScene(NamedTuple):
    """A sheet, a rod, and where the sheet was at some moments of one run of ours, all of them in contact."""

    sheet: Path  # OBJ file
    tissue: Mesh  # at rest
    rod: Mesh  # in its own frame
    moments: Index  # [ms], shape [n]
    positions: Real  # of the tissue's vertices [m], shape [n, V, 3]
    lowest: Real  # [m] height of the tissue's lowest vertex at every millisecond


def assembly_of(sheet: Path, solver: str = bench.PRESET.format("accurate"), contact: str = bench.CONTACT) -> Assembly:
    """The bench's scene on a sheet."""
    return assemble(parse_scene(bench.on_sheet(sheet, solver, contact).encode(), sheet.parent))


def graded_assembly(folder: Path, contact: str) -> Assembly:
    """The bench's scene with the preset fast on a sheet that is graded, in the place of one of equal cells."""
    return assemble(parse_scene(bench.scene_text(bench.GRADED, bench.PRESET.format("fast"), contact).encode(), folder))


def lowest_of(assembly: Assembly) -> Real:
    """Height [m] of the tissue's lowest vertex at every millisecond of the bench's motion, from the first on."""
    instance = Instance(assembly)
    return np.array([float(instance.state.z.min()) for _ in run(instance, bench.poses(), bench.STEP)])


def record(sheet: Path, every: int) -> PeerScene:
    """Run the bench's motion and keep where the tissue is, at every so many of the steps in contact."""
    assembly = assembly_of(sheet, bench.PRESET.format("balanced"))
    instance = Instance(assembly)
    state = instance.state
    moments, positions, lowest = [], [], []
    for k in run(instance, bench.poses(), bench.STEP):
        lowest.append(float(state.z.min()))
        if state.pairs[0] > 0 and k % every == 0:
            moments.append(k)
            positions.append(np.column_stack([state.x, state.y, state.z]))
    return PeerScene(sheet, *_meshes(sheet), np.array(moments), np.array(positions), np.array(lowest))


def moved_alike(scene: PeerScene, sheet: Path, every: int) -> PeerScene:
    """Another sheet in the same motion, each vertex moved as the place where it lies, at fewer moments."""
    tissue, rod = _meshes(sheet)
    moments, displacement = scene.moments[::every], scene.positions[::every] - scene.tissue.vertices
    columns = displacement.transpose(1, 0, 2).reshape(len(scene.tissue.vertices), -1)
    there = LinearNDInterpolator(scene.tissue.vertices[:, :2], columns, fill_value=0.0)(tissue.vertices[:, :2])
    positions = tissue.vertices + there.reshape(-1, len(moments), 3).transpose(1, 0, 2)
    return scene._replace(sheet=sheet, tissue=tissue, rod=rod, moments=moments, positions=positions)


def _meshes(sheet: Path) -> tuple[Mesh, Mesh]:
    """Sheet and rod at rest; the rod's triangles are those of a response that has any."""
    assembly = assembly_of(sheet, contact=HULL)
    model, state = assembly.model, assembly.state
    return (
        Mesh(
            np.column_stack([state.x, state.y, state.z]),
            np.column_stack([model.triangle_a, model.triangle_b, model.triangle_c]),
        ),
        Mesh(
            np.column_stack([model.body_x, model.body_y, model.body_z]),
            np.column_stack([model.body_a, model.body_b, model.body_c]),
        ),
    )
