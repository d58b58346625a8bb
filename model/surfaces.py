"""The surface that a tissue or an instrument of a scene names: its mesh or shape, put in its place."""

from pathlib import Path
from typing import Literal

import numpy as np

from tissue_contact import geometry, shapes
from tissue_contact.boxes import distance_to_box
from tissue_contact.coarsening import coarsened
from tissue_contact.errors import InputError
from tissue_contact.fields import longest_edges
from tissue_contact.geometry import FloatArray, Surface
from tissue_contact.scene import Instrument, Rigid, Tissue


def rotation_matrix(quaternion: tuple[float, ...]) -> FloatArray:
    """Matrix of a unit quaternion w, x, y, z, shape (3, 3)."""
    w, x, y, z = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def placement(body: Tissue | Instrument | Rigid) -> tuple[FloatArray, FloatArray]:
    """Rotation and shift [m] of a mesh into the world (tissue) or into the body frame, which is a rigid body's own."""
    if isinstance(body, Rigid):
        return np.eye(3), np.zeros(3)
    return rotation_matrix(body.rotation), np.array(body.position if isinstance(body, Tissue) else body.offset)


def in_own_frame(body: Tissue | Instrument | Rigid, points: FloatArray) -> FloatArray:
    """Points of a placed surface, shape (n, 3) [m], in the frame of the mesh or the shape; `placement` undone."""
    rotation, shift = placement(body)
    return np.asarray((points - shift) @ rotation)


def surface_of(body: Tissue | Instrument | Rigid, folder: Path, place: str = "scene") -> Surface:
    """Surface of a tissue in the world, or of an instrument or a rigid body in its body frame [m].

    Parameters
    ----------
    body : Tissue, Instrument or Rigid
        What the scene declares.
    folder : Path
        Where relative mesh paths begin.
    place : str
        The scene file, for messages.

    Raises
    ------
    InputError
        A missing, unreadable or unsuitable mesh, a wrong unit scale, a reach that holds none of it, arguments that make
        no shape.

    """
    purpose: Literal["tissue", "instrument"] = "tissue" if isinstance(body, Tissue) else "instrument"
    here = f"{place}, {'rigid' if isinstance(body, Rigid) else purpose}[{body.name}]"
    try:
        if body.shape is not None:
            arguments = body.shape.model_dump(exclude={"kind"})
            surface: Surface = getattr(shapes, body.shape.kind)(**arguments)
            geometry.check_scale(geometry.inspect(surface), "shape")
        else:
            assert body.mesh is not None  # the scene holds one of the two
            surface, _, _ = geometry.load(
                folder / body.mesh,
                scale=body.scale,
                open_surface=body.open_surface,
                many_parts=body.many_parts,
                purpose=purpose,
            )
            if isinstance(body, Tissue) and body.reach is not None:
                surface = coarsened(surface, body.reach, body.growth, "reach")
    except InputError as error:
        raise InputError(f"{here}, {error.place}", error.rule, error.value, error.way_out) from error
    if body.flip:
        surface = Surface(surface.vertices, surface.triangles[:, ::-1], surface.part, surface.axes)
    return _placed(surface, *placement(body))


def touched_edge(body: Tissue | Instrument | Rigid, surface: Surface) -> float:
    """Longest edge [m] of the surface of a body, of a graded one of the triangles with a corner within the reach.

    A corner on the very edge of the reach may be out of it by rounding, as it was placed: the nearest are as good.
    """
    edges = longest_edges(surface)
    reach = body.meshing.reach if isinstance(body, Tissue) else None
    if reach is None:
        return float(edges.max())
    distance = distance_to_box(in_own_frame(body, surface.vertices), reach)
    nearest = distance == distance.min()
    return float(edges[nearest[surface.triangles].any(axis=1)].max())


def _placed(surface: Surface, rotation: FloatArray, shift: FloatArray) -> Surface:
    if np.array_equal(rotation, np.eye(3)) and not shift.any():
        return surface
    axes = None if surface.axes is None else surface.axes @ rotation.T + shift
    return Surface(surface.vertices @ rotation.T + shift, surface.triangles, surface.part, axes)


def stl_bytes(surface: Surface) -> bytes:
    """The surface as a binary STL file in metres; STL keeps seven digits of a coordinate."""
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    found = np.zeros(len(surface.triangles), record)
    found["normal"] = geometry.triangle_normals(surface)
    found["corners"] = surface.vertices[surface.triangles]
    return bytes(80) + len(found).to_bytes(4, "little") + found.tobytes()
