"""One rigid body, before it joins the others: parts, cells, polytopes, distance fields, sample points."""

from typing import NamedTuple

import numpy as np

from tissue_contact import fields, geometry
from tissue_contact.fields import Field
from tissue_contact.geometry import FloatArray, Hull, IntArray, Surface
from tissue_contact.kernels.field import NONE
from tissue_contact.scene import Contact, Instrument, Rigid, Scene
from tissue_contact.surfaces import placement, surface_of

CELLS_MAX = 32768  # of one body's grid: 128 KB of cell starts, which stay in the second-level cache
REACH_MIN = 1e-6  # [m], of the mark from a part that has no thickness
NO_FIELD = Field(NONE, np.empty(0))


class Grid(NamedTuple):
    """Cells of a body in its frame, and the triangles whose boxes touch each."""

    low: FloatArray  # [m], shape [3]
    cell: float  # [m]
    size: IntArray  # shape [3]
    start: IntArray
    triangle: IntArray


NO_GRID = Grid(np.zeros(3), 1.0, np.zeros(3, np.int32), np.zeros(1, np.int32), np.empty(0, np.int32))
NO_SURFACE = Surface(np.empty((0, 3)), np.empty((0, 3), np.int32))


class Body(NamedTuple):
    """Arrays of one rigid body; what they mean: `tissue_contact.kernels.layout.Model`."""

    surface: Surface  # whole
    searched: Surface  # the same where contacts look for its triangles, else empty
    centre: FloatArray
    axes: FloatArray
    half: FloatArray
    axis: FloatArray
    reach: FloatArray
    low: FloatArray
    high: FloatArray
    radius: float
    grid: Grid
    triangle_low: FloatArray
    triangle_high: FloatArray
    field: list[Field]
    sample: FloatArray
    sample_area: FloatArray

    @property
    def thickness(self) -> float:
        """Smallest half extent of a part [m]."""
        return float(self.reach.min())


def body_of(body: Instrument | Rigid, scene: Scene) -> Body:
    """Arrays of an instrument or a rigid body, those that the scene's contacts need.

    Raises
    ------
    InputError
        A surface that cannot be used.
    """
    asked = [c for c in scene.contact if body.name in c.between]
    # Between two bodies the first has the points and the second has the field.
    sampled = [c for c in asked if c.between[0] == body.name]
    searched = any(not c.is_field for c in asked)
    has_field = any(c.is_field and c.between[1] == body.name for c in asked)
    surface = surface_of(body, scene.folder, scene.place)
    boxes = [
        geometry.oriented_box(surface.vertices[np.unique(surface.triangles[surface.part == part])])
        for part in range(surface.part.max() + 1)
    ]
    centre, axes, half = (np.array(column) for column in zip(*boxes, strict=True))
    axis = np.array([_shaft_axis(surface, part, *box) for part, box in enumerate(boxes)])
    reach = np.maximum(half.min(axis=1), REACH_MIN)
    for a, r in zip(axis, reach, strict=True):
        if np.linalg.norm(a[1] - a[0]) < REACH_MIN:  # as long as wide: the handle is towards +z
            a[1] = a[0] + [0.0, 0.0, r]
    corners = surface.vertices[surface.triangles]
    low, high = corners.min(axis=1), corners.max(axis=1)
    points, weights = np.empty((0, 3)), np.empty(0)
    if sampled:
        start, areal, weights = fields.quadrature(surface, spacing_of(sampled, float(reach.min())))
        points = np.einsum("nk,nkc->nc", areal, np.repeat(corners, np.diff(start), axis=0))
    return Body(
        surface,
        surface if searched else NO_SURFACE,
        centre,
        axes,
        half,
        axis,
        reach,
        low.min(axis=0),
        high.max(axis=0),
        float(np.linalg.norm(surface.vertices[surface.triangles], axis=2).max()),
        _grid(surface, low, high) if searched else NO_GRID,
        low if searched else np.empty((0, 3)),
        high if searched else np.empty((0, 3)),
        [_field(body, surface, part) if has_field else NO_FIELD for part in range(len(half))],
        points,
        weights,
    )


def spacing_of(contacts: list[Contact], thickness: float) -> float:
    """Spacing of the points that some contacts read depth at [m]: the least that any of them asks for."""
    return min(c.quadrature_spacing or 0.25 * thickness for c in contacts)


def _field(body: Instrument | Rigid, surface: Surface, part: int) -> Field:
    """Exact field of a primitive shape, sampled field of any other part."""
    found = None if body.flip else fields.primitive(body.shape, *placement(body))
    return fields.sampled(surface, part) if found is None else found


def polytopes(contact: Contact, body: Body) -> list[Hull]:
    """What the support of every part is taken of: its box, its k-DOP or its hull; nothing for other responses."""
    made = []
    for part in range(len(body.half)):
        if contact.response == "oobb":
            made.append(geometry.box_hull(body.centre[part], body.axes[part], body.half[part]))
        elif contact.response == "hull":
            made.append(geometry.convex_hull(body.surface, part))
        elif contact.response == "kdop":
            points = body.surface.vertices[np.unique(body.surface.triangles[body.surface.part == part])]
            made.append(geometry.kdop(points, contact.kdop))
    return made


def _shaft_axis(surface: Surface, part: int, centre: FloatArray, axes: FloatArray, half: FloatArray) -> FloatArray:
    """Tip end and handle end of a part's axis, shape [2, 3]; the handle is away from the body frame's origin."""
    if surface.axes is not None:
        return surface.axes[part].copy()
    long = int(np.argmax(half))
    d = (half[long] - half.min()) * axes[long]
    ends = np.array([centre - d, centre + d])
    return ends if np.linalg.norm(ends[0]) <= np.linalg.norm(ends[1]) else ends[::-1].copy()


def _grid(surface: Surface, low: FloatArray, high: FloatArray) -> Grid:
    least, extent = low.min(axis=0), high.max(axis=0) - low.min(axis=0)
    cell = max(float(np.median((high - low).max(axis=1))), extent.max() / 256, 1e-6)
    while (size := np.floor(extent / cell).astype(np.int32) + 1).prod() > CELLS_MAX:
        cell *= 1.1
    # The same expression as in the kernel, so that boxes that overlap share a cell whatever the rounding.
    first = np.minimum((low - least) / cell, size - 1).astype(np.int32)
    last = np.minimum((high - least) / cell, size - 1).astype(np.int32)
    entries = [
        ((ix * size[1] + iy) * size[2] + iz, u)
        for u in range(len(surface.triangles))
        for ix in range(first[u, 0], last[u, 0] + 1)
        for iy in range(first[u, 1], last[u, 1] + 1)
        for iz in range(first[u, 2], last[u, 2] + 1)
    ]
    cells, triangles = np.array(sorted(entries), np.int64).T
    start = np.searchsorted(cells, np.arange(size.prod() + 1))
    return Grid(least, cell, size, start.astype(np.int32), triangles.astype(np.int32))
