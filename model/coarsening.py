"""A mesh from a file made coarser beyond the reach of what touches it.

Edges shorter than wanted are collapsed, the shortest first, then edges are swapped and vertices evened out on the
surface of the file, again and again, after the remeshing of Botsch and Kobbelt (2004). No edge is split. Within the
reach no vertex moves, and no edge changes. Rims keep their corners; between them vertices are merged along them only.
"""

from heapq import heappop, heappush
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from tissue_contact.boxes import Corners, held_vertices
from tissue_contact.geometry import (
    FloatArray,
    IntArray,
    Surface,
    area_normals,
    boundary_edges,
    edges,
    half_edges,
    longest_sides,
    nearest_place,
    unit,
    vertex_normals,
)
from tissue_contact.grading import Grading
from tissue_contact.relaxation import centred, swapped

SHORT, LONG = 0.8, 4 / 3  # of the wanted length: edges below are collapsed, and none beyond comes of it
ROUNDS, EVENED = 6, 5  # of collapses, and of swaps and evening after each; more change next to nothing
BEND = np.cos(np.radians(20))  # between the normals at both ends of an edge, which follows the surface that closely
TURN = np.cos(np.radians(30))  # of a rim, beyond which its vertex is a corner
FOLD = 0.5  # least cosine of the turn of a triangle whose corners move
THIN = 0.1  # of the longest edge of a triangle, its height, below which none gets that was not

FREE, RIM, CORNER, KEPT = range(4)  # how firm a vertex is; of two the firmer one stays


def coarsened(surface: Surface, reach: Corners, growth: float, place: str) -> Surface:
    """The surface as it is within a box, with edges that grow with the distance beyond.

    Parameters
    ----------
    surface : Surface
        Of one layer, consistently wound.
    reach : two points
        Least and greatest corner of the box [m], in the frame of the surface.
    growth : float
        By how much an edge is wanted to be longer over its distance from the box.
    place : str
        For messages.

    Raises
    ------
    InputError
        The box holds no vertex.

    """
    held = held_vertices(surface.vertices, reach, place)
    vertices, triangles, normals = surface.vertices, surface.triangles, vertex_normals(surface)
    ends = edges(surface)
    ends = ends[held[ends].any(axis=1)]
    finest = float(np.median(np.linalg.norm(np.diff(vertices[ends], axis=1), axis=2)))
    grading = Grading(place, reach, growth, finest)
    of_file = np.stack([vertices, normals], axis=1)
    for _ in range(ROUNDS):
        web = _Web(vertices, triangles, normals, held, grading)
        if not web.collapse():
            break
        used, corners = np.unique(web.left(), return_inverse=True)
        triangles = corners.reshape(-1, 3).astype(np.int32)
        vertices, normals, held, free = web.vertices[used], web.normals[used], held[used], web.firm[used] == FREE
        for _ in range(EVENED):
            triangles = swapped(vertices, triangles, held)
            corner = vertices[triangles]
            moves = free & ~_bent(normals, triangles)
            middle = centred(triangles, corner.mean(axis=1), grading.weight(corner), vertices)[moves]
            foot, weight = nearest_place(surface, middle)
            before = vertices.copy(), normals.copy()
            vertices[moves], normals[moves] = np.einsum("ij,ijkl->kil", weight, of_file[surface.triangles[foot]])
            normals = unit(normals)
            while (spoilt := _spoilt(corner, vertices[triangles])).any():
                back = triangles[spoilt]
                vertices[back], normals[back] = before[0][back], before[1][back]
        triangles = swapped(vertices, triangles, held)
    return Surface(vertices, triangles)


def _spoilt(before: FloatArray, after: FloatArray) -> NDArray[np.bool_]:
    """Which triangles have turned too far or got too thin; corners [m], shape (m, 3, 3)."""
    old, new = area_normals(before), area_normals(after)
    size_old, size_new = np.linalg.norm(old, axis=1), np.linalg.norm(new, axis=1)
    thin_old, thin_new = size_old / longest_sides(before) ** 2, size_new / longest_sides(after) ** 2
    turned = np.einsum("ij,ij->i", old, new) < FOLD * size_old * size_new
    return np.asarray(turned | (thin_new < np.minimum(THIN, thin_old)))


def _bent(normals: FloatArray, triangles: IntArray) -> NDArray[np.bool_]:
    """Which vertices have an edge along which the surface bends: moved on, they would cut off what is convex."""
    bent = np.zeros(len(normals), bool)
    ends = half_edges(triangles)
    bent[ends[np.einsum("ij,ij->i", normals[ends[:, 0]], normals[ends[:, 1]]) < BEND]] = True
    return bent


def _firmness(vertices: FloatArray, triangles: IntArray, held: NDArray[np.bool_]) -> tuple[IntArray, NDArray[np.bool_]]:
    """How firm each vertex is, and whether it is on a rim."""
    firm = np.full(len(vertices), FREE, np.int32)
    rim = boundary_edges(triangles)
    firm[rim] = RIM
    way = unit(vertices[rim[:, 1]] - vertices[rim[:, 0]])
    come, go = np.zeros_like(vertices), np.zeros_like(vertices)
    come[rim[:, 1]], go[rim[:, 0]] = way, way
    meet = np.bincount(rim.ravel(), minlength=len(vertices)) > 2  # where several rims touch
    turned = np.einsum("ij,ij->i", come, go) < TURN
    firm[(firm == RIM) & (turned | meet)] = CORNER
    on_rim = firm != FREE
    firm[held] = KEPT
    return firm, on_rim


class _Web:
    """Triangles whose edges are being collapsed."""

    def __init__(
        self,
        vertices: FloatArray,
        triangles: IntArray,
        normals: FloatArray,
        held: NDArray[np.bool_],
        grading: Grading,
    ) -> None:
        self.vertices, self.normals = vertices.copy(), normals.copy()
        self.firm, self._on_rim = _firmness(vertices, triangles, held)
        self._grading = grading
        self._wanted = grading.edge(vertices)
        self._triangles: list[tuple[int, ...] | None] = [tuple(t) for t in triangles.tolist()]
        self._of: list[set[int]] = [set() for _ in vertices]  # triangles of every vertex
        for t, corners in enumerate(triangles.tolist()):
            for v in corners:
                self._of[v].add(t)
        self._queue: list[tuple[float, int, int]] = []
        for a, b in edges(Surface(vertices, triangles)).tolist():
            self._enqueue(a, b)

    def left(self) -> IntArray:
        """Triangles that are left."""
        return np.array([t for t in self._triangles if t is not None], np.int32)

    def collapse(self) -> int:
        """Collapse what is too short, the shortest first; how many edges."""
        done = 0
        while self._queue:
            length, a, b = heappop(self._queue)
            if b in self._around(a) and length == self._length(a, b):
                done += self._collapsed(*((a, b) if self.firm[a] >= self.firm[b] else (b, a)))
        return done

    def _around(self, v: int) -> set[int]:
        return {w for t in self._of[v] for w in self._corners(t)} - {v}

    def _corners(self, t: int) -> tuple[int, ...]:
        corners = self._triangles[t]
        assert corners is not None  # of a vertex that is left
        return corners

    def _length(self, a: int, b: int) -> float:
        """Length of an edge over that wanted."""
        wanted = 0.5 * (self._wanted[a] + self._wanted[b])
        way = self.vertices[a] - self.vertices[b]
        return sqrt(way @ way) / wanted

    def _enqueue(self, a: int, b: int) -> None:
        length = self._length(a, b)
        if length < SHORT and min(self.firm[a], self.firm[b]) < CORNER:
            heappush(self._queue, (length, min(a, b), max(a, b)))

    def _collapsed(self, a: int, b: int) -> bool:
        """Whether b was merged into a, the firmer of both: not where it changes the topology, or the shape too much."""
        near_a, near_b = self._around(a), self._around(b)
        shared, around = self._of[a] & self._of[b], (near_a | near_b) - {a, b}
        if len(near_a & near_b) != len(shared) or (self._on_rim[b] and len(shared) == 2):
            return False  # parts that touch nowhere else would be sewn together
        place, normal, wanted = self.vertices[a], self.normals[a], self._wanted[a]
        if self.firm[a] == FREE:
            place, normal = 0.5 * (place + self.vertices[b]), unit(normal + self.normals[b])
            wanted = self._grading.edge(place[None])[0]
        changed = list(around if self.firm[a] == FREE else near_b - near_a - {a})
        length = np.linalg.norm(self.vertices[changed] - place, axis=1)
        too_long = length > 0.5 * LONG * (self._wanted[changed] + wanted)
        if (too_long | (self.normals[changed] @ normal < BEND)).any() or self._spoils(a, b, place):
            return False
        self.vertices[a], self.normals[a], self._wanted[a] = place, normal, wanted
        for t in shared:
            for v in self._corners(t):
                self._of[v].discard(t)
            self._triangles[t] = None
        for t in self._of[b]:
            self._triangles[t] = tuple(a if v == b else v for v in self._corners(t))
        self._of[a] |= self._of[b]
        self._of[b] = set()
        for c in self._around(a):
            self._enqueue(a, c)
        return True

    def _spoils(self, a: int, b: int, place: FloatArray) -> bool:
        """Whether merging two vertices at a place spoils one of the triangles that are left."""
        left = self._of[a] ^ self._of[b]
        corners = np.array([self._corners(t) for t in left], np.int32).reshape(-1, 3)
        before = self.vertices[corners]
        after = np.where(((corners == a) | (corners == b))[..., None], place, before)
        return bool(_spoilt(before, after).any())
