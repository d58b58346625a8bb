"""The signed distance field of a part of an instrument, and the points of the tissue where it is read."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import spline_filter

# numba must know duals before it reads what is cached of them: learning of them in between confuses it
import tissue_contact.kernels.dual  # noqa: F401
from tissue_contact.geometry import FloatArray, IntArray, Surface, longest_sides, triangle_areas
from tissue_contact.kernels.field import BOX, CAPSULE, CYLINDER, GRID
from tissue_contact.kernels.sampling import sample

NODES_MAX = 150_000  # of a part's grid: 1.2 MB; sampling takes about 3 s for 1,500 triangles
NODES_ACROSS = 8  # spacings in the smallest half extent of a part, if the nodes suffice
NODES_BEYOND = 3  # on every side; the spline needs half of one, so it is there 2.5 spacings outside the part
CUTS_MAX = 8  # of an edge of a triangle, for quadrature


class Field(NamedTuple):
    """Signed distance field of one part in the body frame; what the kinds mean: `tissue_contact.kernels.field`."""

    kind: int
    values: FloatArray  # shape and place [m] of a primitive, or B-spline coefficients [m] in C order
    size: NDArray[np.int64] = np.zeros(3, np.int64)  # nodes of the grid along each axis
    low: FloatArray = np.zeros(3)  # [m], first node
    spacing: float = 0.0  # [m], of the nodes


def _values(*parts: ArrayLike) -> FloatArray:
    return np.concatenate([np.ravel(np.asarray(part, np.float64)) for part in parts])


def capsule(a: ArrayLike, b: ArrayLike, r: float) -> Field:
    """Field of a rod with hemispherical ends of radius r [m] about the points a and b [m]; a = b is a ball."""
    return Field(CAPSULE, _values(a, b, r))


def box(centre: ArrayLike, axes: ArrayLike, half: ArrayLike) -> Field:
    """Field of a box: centre [m], unit vectors of its axes in rows, half extents along them [m]."""
    return Field(BOX, _values(centre, axes, half))


def cylinder(a: ArrayLike, b: ArrayLike, r: float) -> Field:
    """Field of a rod of radius r [m] with flat ends at the points a and b [m], which differ."""
    return Field(CYLINDER, _values(a, b, r))


def primitive(shape: Any, rotation: FloatArray, offset: FloatArray) -> Field | None:
    """The exact field of a shape of the scene, placed as its mesh is: p_body = rotation p + offset.

    Parameters
    ----------
    shape : settings of a shape, or None
        Its ``kind`` and its lengths [m]; frames as in `tissue_contact.shapes`.
    rotation : shape (3, 3)
    offset : [m], shape (3,)

    Returns
    -------
    None for every shape but a capsule, sphere, box or cylinder: it needs `sampled`.

    """
    kind = getattr(shape, "kind", None)

    def up(z: float) -> FloatArray:
        return np.asarray(z * rotation[:, 2] + offset)

    if kind == "capsule":
        return capsule(up(shape.radius), up(shape.length - shape.radius), shape.radius)
    if kind == "sphere":
        return capsule(up(shape.radius), up(shape.radius), shape.radius)
    if kind == "box":
        half = 0.5 * np.asarray(shape.size)
        return box(up(half[2]), rotation.T, half)
    if kind == "cylinder":
        return cylinder(up(0.0), up(shape.length), shape.radius)
    return None


def sampled(surface: Surface, part: int) -> Field:
    """Field of any part, from the distances of the nodes of a grid over its axis-aligned box to its triangles.

    The quadratic B-spline goes through all the samples. Its error is of the order of the spacing squared over the
    radius of curvature, and up to a fifth of the spacing at sharp edges. What is thinner than two spacings is not seen
    well: a sheet has no inside. Holes are spanned (see `tissue_contact.kernels.sampling.sample`).

    Parameters
    ----------
    surface : Surface
        Of the instrument, body frame.
    part : int
        Whose triangles to take.

    Returns
    -------
    Field
        The spacing is an eighth of the smallest half extent, or more to keep within `NODES_MAX` nodes.

    """
    corners = surface.vertices[surface.triangles[surface.part == part]]
    least, greatest = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    extent = greatest - least
    spacing = max(0.5 * float(extent.min()) / NODES_ACROSS, 1e-3 * float(extent.max()))
    while (size := np.ceil(extent / spacing).astype(np.int64) + 1 + 2 * NODES_BEYOND).prod() > NODES_MAX:
        spacing *= 1.02
    low = 0.5 * (least + greatest) - 0.5 * (size - 1) * spacing
    middle = corners.mean(axis=1)
    radius = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
    phi = np.empty(size.prod())
    ball = np.column_stack([middle, radius * (1 + 1e-9)])  # no corner left out by rounding
    sample(corners.ravel(), ball.ravel(), tuple(low.tolist()), tuple(size.tolist()), spacing, phi)
    return Field(GRID, spline_filter(phi.reshape(size), order=2, mode="mirror").ravel(), size, low, spacing)


def longest_edges(surface: Surface) -> FloatArray:
    """Of every triangle [m]."""
    return longest_sides(surface.vertices[surface.triangles])


def quadrature(surface: Surface, spacing: float) -> tuple[IntArray, FloatArray, FloatArray]:
    """Points of a surface, each standing for an equal share of its triangle: what is linear is integrated exactly.

    A triangle is cut in n² equal ones, n = longest edge / spacing rounded up, 1 to `CUTS_MAX`; the points are their
    centroids.

    Parameters
    ----------
    surface : Surface
    spacing : float
        Of the points, about [m].

    Returns
    -------
    start : shape (m + 1,)
        Where the points of a triangle begin.
    weight : shape (n, 3)
        Areal coordinates of the points in their triangle.
    area : [m²], shape (n,)

    """
    cuts = np.clip(np.ceil(longest_edges(surface) / spacing), 1, CUTS_MAX).astype(np.int64)
    patterns = [_centroids(n) for n in range(1, CUTS_MAX + 1)]
    weight = np.concatenate([patterns[n - 1] for n in cuts])
    start = np.concatenate([[0], np.cumsum(cuts**2)]).astype(np.int32)
    return start, weight, np.repeat(triangle_areas(surface) / cuts**2, cuts**2)


def _centroids(n: int) -> FloatArray:
    """Areal coordinates of the centroids of the n² equal triangles that a triangle is cut in, shape (n², 3)."""
    i, j = np.mgrid[:n, :n].reshape(2, -1)
    upright, turned = (np.stack([i, j], axis=1)[i + j < n - k] + (1 + k) / 3 for k in (0, 1))
    ab = np.concatenate([upright, turned]) / n
    return np.column_stack([ab, 1 - ab.sum(axis=1)])
