"""Triangles made even: edges swapped, vertices put in the middle of their triangles."""

import numpy as np
from numpy.typing import NDArray

from tissue_contact.geometry import FloatArray, IntArray, interior_edges

SWAP_COSINE = 0.7  # edges are swapped between triangles nearly in one plane only: sharp ones are shape


def in_order(triangles: np.ndarray) -> IntArray:
    """Triangles with the lowest vertex first, in ascending order: independent of the triangulator's order."""
    lead = triangles.argmin(axis=1)
    turned = np.take_along_axis(triangles, (lead[:, None] + np.arange(3)) % 3, axis=1)
    return np.ascontiguousarray(turned[np.lexsort(turned.T[::-1])], np.int32)


def centred(triangles: IntArray, centre: FloatArray, weight: FloatArray, vertices: FloatArray) -> FloatArray:
    """For every vertex the weighted mean of its triangles' centres; a vertex of none stays."""
    corners, n = triangles.ravel(), len(vertices)
    total = np.bincount(corners, np.repeat(weight, 3), n)[:, None]
    sums = np.column_stack([np.bincount(corners, np.repeat(weight * x, 3), n) for x in centre.T])
    return np.divide(sums, total, out=vertices.copy(), where=total > 0)


def swapped(vertices: FloatArray, triangles: IntArray, firm: NDArray[np.bool_] | None = None) -> IntArray:
    """Swap edges until opposite angles sum to at most π, as in a Delaunay triangulation.

    Edges between triangles that do not lie nearly in one plane stay, and those between two ``firm`` vertices.
    """
    triangles = triangles.copy()
    for _ in range(100):
        edge, half = interior_edges(triangles)
        t, s = half // 3, half % 3
        a, b = triangles[t[:, 0], s[:, 0]], triangles[t[:, 0], (s[:, 0] + 1) % 3]
        c, d = (triangles[t[:, i], (s[:, i] + 2) % 3] for i in (0, 1))
        total = _angle(vertices, a, c, b) + _angle(vertices, a, d, b)
        n = len(vertices)
        known = np.isin(
            np.minimum(c, d).astype(np.int64) * n + np.maximum(c, d),
            edge[:, 0].astype(np.int64) * n + edge[:, 1],
        )
        normal = np.cross(vertices[b] - vertices[a], vertices[c] - vertices[a])
        across = np.cross(vertices[a] - vertices[b], vertices[d] - vertices[b])
        cosine = np.einsum("ij,ij->i", normal, across)
        smooth = cosine > SWAP_COSINE * np.linalg.norm(normal, axis=1) * np.linalg.norm(across, axis=1)
        wanted = (total > np.pi + 1e-6) & ~known & smooth
        if firm is not None:
            wanted &= ~(firm[a] & firm[b])
        wanted = np.flatnonzero(wanted)
        if not len(wanted):
            break
        busy: set[int] = set()
        for i in wanted[np.argsort(-total[wanted], kind="stable")]:
            around = {*triangles[t[i, 0]].tolist(), *triangles[t[i, 1]].tolist()}
            if not busy & around:
                busy |= around
                triangles[t[i, 0]], triangles[t[i, 1]] = (a[i], d[i], c[i]), (d[i], b[i], c[i])
    return in_order(triangles)


def _angle(vertices: FloatArray, a: IntArray, corner: IntArray, b: IntArray) -> FloatArray:
    u, v = vertices[a] - vertices[corner], vertices[b] - vertices[corner]
    return np.arctan2(np.linalg.norm(np.cross(u, v), axis=1), np.einsum("ij,ij->i", u, v))
