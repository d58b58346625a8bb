"""Boxes along the axes: how far points are from one, and which it holds."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tissue_contact.errors import InputError

Corners = Sequence[Sequence[float]] | NDArray[np.float64]  # least and greatest corner of a box [m]


def distance_to_box(points: NDArray[np.float64], box: Corners) -> NDArray[np.float64]:
    """Distance [m] of points, shape (n, 3), from a box, 0 within."""
    low, high = np.asarray(box)
    return np.asarray(np.linalg.norm(np.maximum(np.maximum(low - points, points - high), 0.0), axis=1))


def held_vertices(vertices: NDArray[np.float64], box: Corners, place: str) -> NDArray[np.bool_]:
    """Which vertices [m], shape (n, 3), of a surface a box holds. Raises InputError, naming the place, where none."""
    low, high = np.asarray(box)
    held = np.asarray(((vertices >= low) & (vertices <= high)).all(axis=1))
    if not held.any():
        least, most = _point(vertices.min(axis=0)), _point(vertices.max(axis=0))
        raise InputError(
            place,
            "the box must hold at least one vertex of the surface",
            f"none; the surface reaches from {least} to {most} m",
            "Enlarge or move the box",
        )
    return held


def _point(p: NDArray[np.float64]) -> str:
    return f"[{', '.join(f'{c:.4g}' for c in p)}]"
