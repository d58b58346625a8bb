"""Grading of a generated mesh: finest within a box, its edges growing with the distance from it."""

from collections.abc import Callable
from numbers import Real

import numpy as np
from numpy.typing import NDArray

from tissue_contact.boxes import Corners, distance_to_box, held_vertices
from tissue_contact.errors import InputError

FloatArray = NDArray[np.float64]

GROWTH = 0.3  # twice as long at three edges from the box
GROWTH_MAX = 0.5  # of an edge over its distance; beyond, neighbours differ so much that triangles are slim
LOOKS = 8  # at the wanted length, for each of the finest edges along a side


class Grading:
    """Wanted lengths of edges; without a box they are the same everywhere.

    Parameters
    ----------
    place : str
        The shape, for messages.
    reach : two points, optional
        Least and greatest corner of the box [m].
    growth : float
        By how much an edge is longer over its distance from the box, above 0 and at most `GROWTH_MAX`.
    finest : float
        Length of an edge within the box [m].

    Raises
    ------
    InputError
        An argument breaks its rule.

    """

    def __init__(self, place: str, reach: Corners | None, growth: float, finest: float) -> None:
        self._place, self._growth, self._finest = place, growth, finest
        self._box: FloatArray | None = None
        if reach is None:
            return
        box = np.asarray(reach, np.float64)
        if box.shape != (2, 3) or not np.isfinite(box).all() or (box[0] > box[1]).any():
            rule = "must be the least and the greatest corner of a box, in metres"
            raise InputError(f"{place}, reach", rule, reach, "Give [[x, y, z], [x, y, z]]")
        if not (isinstance(growth, Real) and 0.0 < float(growth) <= GROWTH_MAX):
            rule = f"must be above 0 and at most {GROWTH_MAX:g}"
            raise InputError(f"{place}, growth", rule, growth, "Give the growth of an edge over its distance")
        self._box = box

    def coarseness(self, points: FloatArray) -> FloatArray:
        """Wanted length of an edge over the finest, at points [m] of shape (n, 3)."""
        if self._box is None:
            return np.ones(len(points))
        return 1.0 + self._growth * distance_to_box(points, self._box) / self._finest

    def edge(self, points: FloatArray) -> FloatArray:
        """Wanted length of an edge [m] at points [m] of shape (n, 3)."""
        return self._finest * self.coarseness(points)

    def weight(self, corners: FloatArray) -> FloatArray:
        """Twice the area [m²] of triangles over their squared coarseness; ``corners`` [m], shape (m, 3, 3)."""
        twice = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        return np.asarray(twice / self.coarseness(corners.mean(axis=1)) ** 2)

    def thinned(
        self, points: FloatArray, to_space: Callable[[FloatArray], FloatArray], rng: np.random.Generator
    ) -> FloatArray:
        """Of points that are spread evenly in space, of the finest mesh, as many as the wanted lengths ask for."""
        if self._box is None:
            return points
        return points[rng.random(len(points)) * self.coarseness(to_space(points)) ** 2 < 1.0]

    def places(self, side: Callable[[FloatArray], FloatArray], finest: int) -> FloatArray:
        """Where the vertices of a straight side are, 0 its start, without its end at 1.

        Parameters
        ----------
        side : function
            From places, shape (n,), to points in space [m], shape (n, 3).
        finest : int
            Edges of the finest mesh along it.
        """
        if self._box is None:
            return np.arange(finest) / finest
        look = np.linspace(0.0, 1.0, LOOKS * finest + 1)
        density = finest / self.coarseness(side(look))
        passed = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(look) * (density[1:] + density[:-1]))])
        edges = max(1, round(float(passed[-1])))
        return np.interp(np.arange(edges) / edges * passed[-1], passed, look)

    def check(self, vertices: FloatArray) -> None:
        """Raise InputError where none of the vertices [m], shape (n, 3), is within the box."""
        if self._box is not None:
            held_vertices(vertices, self._box, f"{self._place}, reach")
