"""Blocks: groups of neighbouring triangles of a tissue that a detection looks at together."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tissue_contact.geometry import FloatArray, IntArray

BLOCK = 128  # triangles of a block, at most


class Blocks(NamedTuple):
    """Triangles and vertices of the blocks of one tissue, ascending within a block."""

    triangles: list[NDArray[np.intp]]  # each triangle once
    vertices: list[IntArray]  # their corners
    middles: list[int]  # the corner nearest to the middle of the box of each


def blocks_of(vertices: FloatArray, triangles: IntArray) -> Blocks:
    """Halve the triangles [T, 3] along the longest side of the box of their middles, until they are few enough."""
    middles = vertices[triangles].mean(axis=1)
    found: list[NDArray[np.intp]] = []
    parts = [np.arange(len(triangles), dtype=np.intp)]
    while parts:
        part = parts.pop()
        if len(part) <= BLOCK:
            found.append(np.sort(part))
            continue
        axis = np.ptp(middles[part], axis=0).argmax()
        order = part[np.argsort(middles[part, axis], kind="stable")]
        parts += [order[len(part) // 2 :], order[: len(part) // 2]]
    corners = [np.unique(triangles[part]) for part in found]
    return Blocks(found, corners, [int(own[_central(vertices[own])]) for own in corners])


def _central(places: FloatArray) -> int:
    """Which of some places [n, 3] is nearest to the middle of their box."""
    middle = (places.min(axis=0) + places.max(axis=0)) / 2
    return int(((places - middle) ** 2).sum(axis=1).argmin())
