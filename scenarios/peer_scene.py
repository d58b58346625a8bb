"""What all of `make peers` looks at: the press-slide-leave scene of the bench, and its motion as recorded once."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from tissue_contact.assemble import assemble
from tissue_contact.assembly import Assembly
from tissue_contact.kernels.layout import Index, Real
from tissue_contact.scenarios import bench
from tissue_contact.scene import parse_scene
from tissue_contact.simulate import Instance, run

PRESSED = 300  # ms, the end of the press, when the probe is deepest
HULL = '[[contact]]\nresponse = "hull"\nstiffness = 100.0'  # a response that goes by intersecting triangles
PROJECTIVE = 'integrator = "projective_dynamics"\niterations = {}'


class Mesh(NamedTuple):
    """A triangle mesh."""

    vertices: Real  # [m], shape [V, 3]
    triangles: Index  # shape [T, 3]


class PeerScene(NamedTuple):
    """A sheet, a rod, and where both were at some moments of one run of ours, all of them in contact."""

    sheet: Path  # OBJ file
    tissue: Mesh  # at rest
    rod: Mesh  # in its own frame
    moments: Index  # [ms], shape [n]
    positions: Real  # of the tissue's vertices [m], shape [n, V, 3]
    lowest: Real  # [m] height of the tissue's lowest vertex at every millisecond


def assembly_of(sheet: Path, solver: str = "", contact: str = bench.CONTACT) -> Assembly:
    """The bench's scene on a sheet."""
    text = bench.SCENE.format(solver=solver, tissue=bench.MESH.format(name=sheet.name), contact=contact)
    return assemble(parse_scene(text.encode(), sheet.parent))


def record(sheet: Path, every: int) -> PeerScene:
    """Run the bench's motion and keep where the tissue is, at every so many of the steps in contact."""
    assembly = assembly_of(sheet, PROJECTIVE.format(2))
    body = assembly_of(sheet, contact=HULL).model  # a distance field keeps no triangles
    instance = Instance(assembly)
    state, model = instance.state, instance.model
    moments, positions, lowest = [], [], []
    for k in run(instance, bench.poses(), bench.STEP):
        lowest.append(float(state.z.min()))
        if state.pairs[0] > 0 and k % every == 0:
            moments.append(k)
            positions.append(np.column_stack([state.x, state.y, state.z]))
    return PeerScene(
        sheet,
        Mesh(
            np.column_stack([assembly.state.x, assembly.state.y, assembly.state.z]),
            np.column_stack([model.triangle_a, model.triangle_b, model.triangle_c]),
        ),
        Mesh(
            np.column_stack([body.body_x, body.body_y, body.body_z]),
            np.column_stack([body.body_a, body.body_b, body.body_c]),
        ),
        np.array(moments),
        np.array(positions),
        np.array(lowest),
    )
