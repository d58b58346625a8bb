"""Triangular surfaces: read a mesh file, tell what it is, repair what is safe to repair, refuse the rest.

The only module that knows trimesh. Everything after `read` is plain numpy, in metres.
"""

import difflib
from dataclasses import dataclass, field
from itertools import combinations, permutations, product
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import breadth_first_order, connected_components
from scipy.spatial import ConvexHull, cKDTree

from tissue_contact.errors import InputError

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int32]

FORMATS = (".stl", ".obj", ".ply", ".off")

# Below this fraction of the mesh's largest dimension two vertices are one and a triangle has no height.
# STL files are float32 (6e-8 relative), so a smaller bound would miss what rounding tore apart; a real edge
# this short (0.2 µm on a liver) would only force a uselessly small time step.
TOLERANCE = 1e-6

EXTENT_MIN, EXTENT_MAX = 1e-3, 1.0  # [m] organs and instruments of surgery lie between


@dataclass(frozen=True, eq=False)
class Surface:
    """A triangular surface; the outer side of a triangle sees its vertices counterclockwise.

    Parameters
    ----------
    vertices : float64 [m], shape (n, 3)
    triangles : int32, shape (m, 3)
        Indices of vertices.
    part : int32, shape (m,)
        The convex part of an instrument that owns the triangle; all zero when not given.
    axes : float64 [m], shape (n_part, 2, 3), or None
        For every part two points of its shaft axis in the mesh's frame, tip end first, handle end second;
        None when unknown.

    Arrays are converted to these types, C-contiguous. A wrong shape raises ValueError.

    """

    vertices: FloatArray
    triangles: IntArray
    part: IntArray = field(default_factory=lambda: np.zeros(0, np.int32))
    axes: FloatArray | None = None

    def __post_init__(self) -> None:
        vertices = np.ascontiguousarray(self.vertices, np.float64)
        triangles = np.ascontiguousarray(self.triangles, np.int32)
        part = np.ascontiguousarray(self.part, np.int32)
        if part.size == 0:
            part = np.zeros(len(triangles), np.int32)
        if vertices.ndim != 2 or vertices.shape[1] != 3 or triangles.ndim != 2 or triangles.shape[1] != 3:
            raise ValueError(f"vertices {vertices.shape} and triangles {triangles.shape} must be (n, 3)")
        if part.shape != (len(triangles),):
            raise ValueError(f"part {part.shape} must have one entry for each of {len(triangles)} triangles")
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "triangles", triangles)
        object.__setattr__(self, "part", part)
        if self.axes is not None:
            axes = np.ascontiguousarray(self.axes, np.float64)
            if axes.ndim != 3 or axes.shape[1:] != (2, 3) or len(axes) <= part.max(initial=0):
                raise ValueError(f"axes {axes.shape} must be (n_part, 2, 3)")
            object.__setattr__(self, "axes", axes)


@dataclass(frozen=True)
class MeshReport:
    """What a mesh is, counted by `inspect`. Lengths [m], area [m²], volume [m³]."""

    triangles: int
    vertices: int
    edge_shortest: float
    edge_median: float
    edge_longest: float
    bounds: tuple[tuple[float, float, float], tuple[float, float, float]]
    extent: float
    area: float
    volume: float | None
    watertight: bool
    boundary_edges: int
    nonmanifold_edges: int
    degenerate_triangles: int
    duplicate_triangles: int
    duplicate_vertices: int
    components: int
    winding_consistent: bool
    outward: bool | None


@dataclass(frozen=True)
class Repair:
    """One kind of repair that was made, and how often."""

    what: str
    count: int

    def __str__(self) -> str:
        return f"{self.what}: {self.count}"


# --- measures ---------------------------------------------------------------------------------------------


def area_normals(corners: FloatArray) -> FloatArray:
    """(b - a) x (c - a) [m²] of triangles: outer normals, twice as long as the area; ``corners`` [m], shape (m, 3, 3).

    np.cross takes three times as long for the few triangles around a vertex.
    """
    u, v = (corners[:, (1, 2)] - corners[:, :1]).transpose(1, 2, 0)
    return np.ascontiguousarray((u[[1, 2, 0]] * v[[2, 0, 1]] - u[[2, 0, 1]] * v[[1, 2, 0]]).T)


def _area_vectors(surface: Surface) -> FloatArray:
    return 0.5 * area_normals(surface.vertices[surface.triangles])


def unit(vectors: FloatArray) -> FloatArray:
    """Vectors, shape (..., 3), with a length of 1; zero where there is none."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)


def triangle_areas(surface: Surface) -> FloatArray:
    """Area of every triangle [m²], shape (m,)."""
    return np.linalg.norm(_area_vectors(surface), axis=1)


def triangle_normals(surface: Surface) -> FloatArray:
    """Outer unit normal of every triangle, shape (m, 3); zero for a triangle without area."""
    return unit(_area_vectors(surface))


def vertex_normals(surface: Surface) -> FloatArray:
    """Outer unit normal of every vertex, the mean of its triangles' by area, shape (n, 3); zero where there is none."""
    sums = np.zeros_like(surface.vertices)
    np.add.at(sums, surface.triangles, _area_vectors(surface)[:, None])
    return unit(sums)


def longest_sides(corners: FloatArray) -> FloatArray:
    """Of every triangle [m], its corners [m] in shape (m, 3, 3)."""
    return np.asarray(np.linalg.norm(corners - corners[:, (1, 2, 0)], axis=2).max(axis=1))


def triangle_heights(surface: Surface) -> FloatArray:
    """Height of every triangle over its longest edge [m], shape (m,); zero when that edge has no length."""
    longest = longest_sides(surface.vertices[surface.triangles])
    area = triangle_areas(surface)
    return np.divide(2 * area, longest, out=np.zeros_like(area), where=longest > 0)


def volume(surface: Surface) -> float:
    """Signed volume [m³], Σ a·(b×c)/6; positive when the winding is outward. Means nothing if not closed."""
    # About the centre, so that a mesh far from the origin keeps its digits.
    a, b, c = np.moveaxis((surface.vertices - surface.vertices.mean(axis=0))[surface.triangles], 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def extent(surface: Surface) -> float:
    """Largest dimension of the axis-aligned bounds [m], of the vertices that triangles use."""
    return float(np.ptp(surface.vertices[surface.triangles.ravel()], axis=0).max())


# --- topology ---------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _EdgeUse:
    """Undirected edges and the half-edges on them (numbered as in `interior_edges`)."""

    edges: IntArray  # (e, 2), sorted in each row and by row
    edge: NDArray[np.intp]  # (3 m,) the edge of every half-edge
    count: NDArray[np.intp]  # (e,) how many half-edges use it
    forward: NDArray[np.bool_]  # (3 m,) runs from the lower to the higher vertex

    def pairs(self) -> NDArray[np.intp]:
        """The two half-edges of every edge that exactly two triangles share, shape (b, 2), in edge order."""
        order = np.argsort(self.edge, kind="stable")
        return order[self.count[self.edge[order]] == 2].reshape(-1, 2)


def half_edges(triangles: IntArray) -> IntArray:
    """Every side of every triangle as the triangle runs along it, shape (3 m, 2), numbered as in `interior_edges`."""
    return np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1).reshape(-1, 2)


def _edge_use(triangles: IntArray) -> _EdgeUse:
    half = half_edges(triangles)
    low, high = half.min(axis=1).astype(np.int64), half.max(axis=1).astype(np.int64)
    n = int(triangles.max(initial=0)) + 1
    key, edge, count = np.unique(low * n + high, return_inverse=True, return_counts=True)
    both = np.stack([key // n, key % n], axis=1).astype(np.int32)
    return _EdgeUse(both, edge.ravel(), count, half[:, 0] < half[:, 1])


def edges(surface: Surface) -> IntArray:
    """Every undirected edge once, shape (e, 2): lower vertex first, rows in ascending order."""
    return np.ascontiguousarray(_edge_use(surface.triangles).edges)


def interior_edges(triangles: IntArray) -> tuple[IntArray, NDArray[np.intp]]:
    """Edges that exactly two triangles share, shape (b, 2), and their half-edges, shape (b, 2).

    Half-edge 3 t + s runs from corner s to corner s + 1 of triangle t.
    """
    use = _edge_use(triangles)
    return use.edges[use.count == 2], use.pairs()


def flaps(surface: Surface) -> IntArray:
    """The two vertices opposite every interior edge, shape (b, 2), in the order of those edges.

    An edge is interior when exactly two triangles share it; others have no flap. For bending springs.
    """
    pairs = _edge_use(surface.triangles).pairs()
    corners = surface.triangles.reshape(-1)
    opposite = corners[3 * (pairs // 3) + (pairs % 3 + 2) % 3]
    return np.ascontiguousarray(opposite, np.int32).reshape(-1, 2)


def boundary_edges(triangles: IntArray) -> IntArray:
    """Edges that only one triangle uses, each as that triangle runs along it, shape (k, 2)."""
    use = _edge_use(triangles)
    return half_edges(triangles)[use.count[use.edge] == 1]


def boundary_vertices(surface: Surface) -> IntArray:
    """Vertices of the edges that only one triangle uses, ascending, shape (k,)."""
    return np.unique(boundary_edges(surface.triangles))


def components(surface: Surface) -> IntArray:
    """Component of every triangle, shape (m,), numbered by first appearance.

    Two triangles are joined by an edge that exactly these two share: bodies that touch in a vertex or in a
    non-manifold edge are apart.
    """
    joined = _edge_use(surface.triangles).pairs() // 3
    return _labels(len(surface.triangles), joined)


def _labels(n: int, pairs: ArrayLike) -> IntArray:
    """Label n things by connected component; labels in the order of first appearance."""
    ends = np.asarray(pairs).reshape(-1, 2)
    graph = coo_matrix((np.ones(len(ends), np.int8), (ends[:, 0], ends[:, 1])), shape=(n, n))
    _, label = connected_components(graph, directed=False)
    _, first, inverse = np.unique(label, return_index=True, return_inverse=True)
    rank = np.empty(len(first), np.int32)
    rank[np.argsort(first)] = np.arange(len(first))
    return rank[inverse.ravel()].astype(np.int32)


def _equal_vertices(vertices: FloatArray) -> NDArray[np.intp]:
    """For every vertex the index of the first vertex at exactly the same place, shape (n,)."""
    order = np.lexsort(vertices.T)  # stable, so the first stays first; −0.0 equals 0.0
    place = vertices[order]
    new = np.ones(len(order), bool)
    new[1:] = (place[1:] != place[:-1]).any(axis=1)
    first = np.empty(len(order), np.intp)
    first[order] = order[new][np.cumsum(new) - 1]
    return first


def _repeats_vertex(triangles: IntArray) -> NDArray[np.bool_]:
    return (triangles == np.roll(triangles, -1, axis=1)).any(axis=1)


def _duplicates(triangles: IntArray) -> NDArray[np.bool_]:
    """Triangles with the same three vertices, in whatever order, as an earlier one."""
    _, first = np.unique(np.sort(triangles, axis=1), axis=0, return_index=True)
    again = np.ones(len(triangles), bool)
    again[first] = False
    return again


# --- read -------------------------------------------------------------------------------------------------


def read(path: str | Path, scale: float = 1.0) -> Surface:
    """Read an STL, OBJ, PLY or OFF file as it is; quads are cut, nothing is merged or mended.

    Parameters
    ----------
    path : str or Path
        File name.
    scale : float
        Metres per unit of the file.

    Raises
    ------
    InputError
        Missing, unreadable or empty file, unknown format, no triangle, a coordinate that is not finite,
        a scale that is not positive.

    """
    path = Path(path)
    place = str(path)
    if not (np.isfinite(scale) and scale > 0):
        raise InputError(
            place,
            "scale must be a positive number of metres per unit",
            scale,
            "Give for instance scale = 0.001 for millimetres",
        )
    if not path.is_file():
        raise InputError(place, "the mesh file must exist", "no such file", _nearest_name(path))
    if path.suffix.lower() not in FORMATS:
        raise InputError(
            place,
            "a mesh file must be STL, OBJ, PLY or OFF",
            path.suffix or "no suffix",
            "Convert the mesh, or name the file after its format",
        )
    again = "Export the mesh again and check that a mesh viewer opens it"
    if path.stat().st_size == 0:
        raise InputError(place, "the mesh file must not be empty", "0 bytes", again)
    mesh: Any
    try:
        loaded = trimesh.load_scene(path, process=False)
        meshes = [m for m in loaded.geometry.values() if isinstance(m, trimesh.Trimesh)]
        mesh = trimesh.util.concatenate(meshes) if meshes else None
    except Exception as error:  # trimesh's readers raise nearly every type there is
        # What fits neither a binary nor a text format makes trimesh ask for a package that guesses encodings.
        unknown = isinstance(error, ImportError)
        found = "contents that are cut off or not text" if unknown else f"{type(error).__name__}: {error}"
        raise InputError(place, f"the file must be a valid {path.suffix[1:].upper()}", found, again) from error
    if mesh is None or len(mesh.faces) == 0:
        raise InputError(place, "a mesh must have at least one triangle", "none", again)
    vertices = np.array(mesh.vertices, np.float64) * scale
    bad = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
    if len(bad):
        found = f"{len(bad)} vertices, the first is number {bad[0]} at {vertices[bad[0]].tolist()}"
        raise InputError(place, "every coordinate must be finite", found, again)
    faces = np.asarray(mesh.faces)
    if faces.min() < 0 or faces.max() >= len(vertices):
        found = f"indices {faces.min()}..{faces.max()} for {len(vertices)} vertices"
        raise InputError(place, "every triangle must name existing vertices", found, again)
    return Surface(vertices, faces.astype(np.int32))


def _nearest_name(path: Path) -> str:
    folder = path.parent
    if not folder.is_dir():
        return f"There is no folder {folder} either; paths are relative to the scene file"
    names = sorted(p.name for p in folder.iterdir() if p.suffix.lower() in FORMATS)
    near = difflib.get_close_matches(path.name, names, n=1, cutoff=0.0)
    return f"The nearest name in that folder is {near[0]}" if near else "That folder holds no mesh file"


# --- inspect ----------------------------------------------------------------------------------------------


def inspect(surface: Surface) -> MeshReport:
    """Count what a mesh is and what is wrong with it.

    STL files store every triangle's vertices anew, so connections are judged as if vertices at exactly the
    same place were one (`duplicate_vertices` tells how many are superfluous); nothing else is mended first:

    - boundary edge: used by one triangle; non-manifold edge: by more than two; watertight: neither exists.
    - degenerate: a vertex twice, or a height over the longest edge of at most 1e-6 of the extent
      (`TOLERANCE`): slivers, and specks too small to be meant.
    - duplicate: the same three vertices, in any order, as an earlier triangle.
    - components: see `components`.
    - winding_consistent: the two triangles at every edge shared by two run along it in opposite directions.
    - volume: None unless watertight; outward (volume > 0): None unless watertight and consistently wound.
    """
    first = _equal_vertices(surface.vertices)
    merged = Surface(surface.vertices, first[surface.triangles].astype(np.int32), surface.part)
    use = _edge_use(merged.triangles)
    corner = merged.vertices[merged.triangles.ravel()]
    size = float(np.ptp(corner, axis=0).max())
    length = np.linalg.norm(merged.vertices[use.edges[:, 0]] - merged.vertices[use.edges[:, 1]], axis=1)
    degenerate = _repeats_vertex(merged.triangles) | (triangle_heights(merged) <= TOLERANCE * size)
    pairs = use.pairs()
    consistent = bool((use.forward[pairs[:, 0]] != use.forward[pairs[:, 1]]).all())
    watertight = bool((use.count == 2).all())
    inside = volume(merged) if watertight else None
    low, high = corner.min(axis=0).tolist(), corner.max(axis=0).tolist()
    return MeshReport(
        triangles=len(surface.triangles),
        vertices=len(surface.vertices),
        edge_shortest=float(length.min()),
        edge_median=float(np.median(length)),
        edge_longest=float(length.max()),
        bounds=((low[0], low[1], low[2]), (high[0], high[1], high[2])),
        extent=size,
        area=float(triangle_areas(merged).sum()),
        volume=inside,
        watertight=watertight,
        boundary_edges=int((use.count == 1).sum()),
        nonmanifold_edges=int((use.count > 2).sum()),
        degenerate_triangles=int(degenerate.sum()),
        duplicate_triangles=int(_duplicates(merged.triangles).sum()),
        duplicate_vertices=int((first != np.arange(len(first))).sum()),
        components=int(components(merged).max()) + 1,
        winding_consistent=consistent,
        outward=inside > 0 if inside is not None and consistent else None,
    )


# --- repair -----------------------------------------------------------------------------------------------


def repair(surface: Surface) -> tuple[Surface, tuple[Repair, ...]]:
    """Make the repairs that are safe: they move nothing by more than 1e-6 of the extent (`TOLERANCE`).

    In this order:

    1. merge vertices at the same place, then those nearer than the tolerance (the first one's place stays);
    2. drop triangles that thereby have a vertex twice;
    3. remove triangles without height: swap their longest edge with the neighbour there, or drop them when
       it lies on the boundary, so that no hole opens;
    4. drop all but the first of triangles with the same three vertices;
    5. drop vertices that no triangle uses;
    6. turn triangles so that each component is wound consistently (the smaller area is turned), and a closed
       component outward.

    Holes and non-manifold edges are left alone. Triangles keep their order and their `part`.

    Returns
    -------
    The repaired surface, with no triangle at all if every one is flat, and one `Repair` for every kind that
    was made, in the order above.

    """
    done: list[Repair] = []

    def note(what: str, count: int) -> None:
        if count:
            done.append(Repair(what, int(count)))

    vertices, part = surface.vertices, surface.part
    size = extent(surface)

    first = _equal_vertices(vertices)
    note("equal vertices merged", (first != np.arange(len(first))).sum())
    near = _near_vertices(vertices, np.unique(first), TOLERANCE * size)
    note(f"vertices nearer than {TOLERANCE:g} of the extent merged", (near[first] != first).sum())
    triangles = near[first][surface.triangles].astype(np.int32)

    keep = ~_repeats_vertex(triangles)
    note("triangles without area dropped", (~keep).sum())
    triangles, part = triangles[keep], part[keep]

    triangles, keep, swapped = _swap_flat(vertices, triangles, TOLERANCE * size)
    note("edges of flat triangles swapped", swapped)
    note("flat triangles on the boundary dropped", (~keep).sum())
    triangles, part = triangles[keep], part[keep]

    keep = ~_duplicates(triangles)
    note("duplicate triangles dropped", (~keep).sum())
    triangles, part = triangles[keep], part[keep]

    if not len(triangles):
        return Surface(np.empty((0, 3)), triangles, part), tuple(done)
    used = np.unique(triangles)
    note("vertices without a triangle dropped", len(np.unique(near[first])) - len(used))
    renumber = np.zeros(len(vertices), np.int32)
    renumber[used] = np.arange(len(used))
    vertices, triangles = vertices[used], renumber[triangles]

    turn = _winding_turns(Surface(vertices, triangles))
    note("triangles turned to a consistent, outward winding", turn.sum())
    triangles[turn] = triangles[turn][:, ::-1]
    return Surface(vertices, triangles, part, surface.axes), tuple(done)


def _near_vertices(vertices: FloatArray, among: NDArray[np.intp], radius: float) -> NDArray[np.intp]:
    """For every vertex the first of the chain of near ones that it belongs to, shape (n,)."""
    pairs = cKDTree(vertices[among]).query_pairs(radius, output_type="ndarray")
    label = _labels(len(among), pairs)
    _, head = np.unique(label, return_index=True)
    near = np.arange(len(vertices))
    near[among] = among[head[label]]
    return near


def _sides(triangle: IntArray) -> list[tuple[int, int]]:
    a, b, c = (int(i) for i in triangle)
    return [(min(i, j), max(i, j)) for i, j in ((a, b), (b, c), (c, a))]


def _swap_flat(vertices: FloatArray, triangles: IntArray, height: float) -> tuple[IntArray, NDArray[np.bool_], int]:
    """Remove flat triangles by swapping their longest edge: new triangles, which to keep, number of swaps."""
    triangles = triangles.copy()
    keep = np.ones(len(triangles), bool)
    swapped = 0
    for _ in range(200):  # a row of flat triangles is worked off from its ends; what is longer stays
        flat = np.flatnonzero(keep & (triangle_heights(Surface(vertices, triangles)) <= height))
        around: dict[tuple[int, int], list[int]] = {}
        if len(flat):
            for kept in np.flatnonzero(keep).tolist():
                for e in _sides(triangles[kept]):
                    around.setdefault(e, []).append(kept)
        busy: set[int] = set()
        changed = False
        for t in flat.tolist():
            corner = vertices[triangles[t]]
            s = int(np.argmax(np.linalg.norm(corner - np.roll(corner, -1, axis=0), axis=1)))
            a, b, c = (int(i) for i in np.roll(triangles[t], -s))
            sharing = around[min(a, b), max(a, b)]
            if busy.intersection(sharing):
                continue
            outline = [e for i in sharing for e in _sides(triangles[i])]
            if len(sharing) == 1:
                keep[t] = False
            elif len(sharing) == 2:
                other = sharing[0] + sharing[1] - t
                d = next((int(i) for i in triangles[other] if i not in (a, b)), c)
                if d == c or (min(c, d), max(c, d)) in around:
                    continue
                triangles[t], triangles[other] = (a, d, c), (d, b, c)
                around[min(c, d), max(c, d)] = [t, other]
                swapped += 1
            else:
                continue
            # Edges have other owners now: leave the neighbourhood to the next round.
            for e in outline:
                busy.update(around[e])
            changed = True
        if not changed:
            break
    return triangles, keep, swapped


def _winding_turns(surface: Surface) -> NDArray[np.bool_]:
    """The triangles to turn for a consistent winding of each component, outward where it is closed."""
    use = _edge_use(surface.triangles)
    pairs = use.pairs()
    m = len(surface.triangles)
    t, u = pairs[:, 0] // 3, pairs[:, 1] // 3
    same = use.forward[pairs[:, 0]] == use.forward[pairs[:, 1]]
    turn = np.zeros(m, bool)
    label = _labels(m, np.stack([t, u], axis=1))
    if same.any():
        # Walk outward from the first triangle of each component and pass on whether to turn.
        clash = {(int(i), int(j)) for i, j in zip(t[same], u[same], strict=True)}
        graph = coo_matrix((np.ones(len(t), np.int8), (t, u)), shape=(m, m)).tocsr()
        _, start = np.unique(label, return_index=True)
        for seed in start:
            order, before = breadth_first_order(graph, seed, directed=False)
            for i in order[1:]:
                j = before[i]
                turn[i] = turn[j] ^ ((min(i, j), max(i, j)) in clash)
    area = triangle_areas(surface)
    closed = np.ones(label.max(initial=-1) + 1, bool)
    half = np.arange(3 * m)[use.count[use.edge] != 2]
    closed[label[half // 3]] = False
    turned_area = np.bincount(label, area * turn, minlength=len(closed))
    whole_area = np.bincount(label, area, minlength=len(closed))
    a, b, c = np.moveaxis(surface.vertices[surface.triangles], 1, 0)
    middle = surface.vertices[surface.triangles.ravel()].mean(axis=0)
    six = np.einsum("ij,ij->i", a - middle, np.cross(b - middle, c - middle)) * np.where(turn, -1, 1)
    inward = np.bincount(label, six, minlength=len(closed)) < 0
    invert = np.where(closed, inward, turned_area > whole_area / 2)
    return turn ^ invert[label]


# --- load -------------------------------------------------------------------------------------------------


def load(
    path: str | Path,
    *,
    scale: float = 1.0,
    open_surface: bool = False,
    many_parts: bool = False,
    purpose: Literal["tissue", "instrument"] = "tissue",
) -> tuple[Surface, MeshReport, tuple[Repair, ...]]:
    """Read, repair, and refuse what cannot be repaired safely.

    An instrument is rigid and only its triangles are used, so `open_surface` also admits non-manifold edges,
    odd winding and flat triangles there; with `many_parts` its pieces become its parts.

    Parameters
    ----------
    path : str or Path
        File name.
    scale : float
        Metres per unit of the file.
    open_surface : bool
        The mesh is a sheet on purpose: boundary edges are right.
    many_parts : bool
        The mesh consists of several pieces on purpose.
    purpose : "tissue" or "instrument"
        What the mesh is used for.

    Returns
    -------
    The surface, the report on it after repair, the repairs.

    Raises
    ------
    InputError
        From `read` and `check_scale`; non-manifold edges, holes, several components, a surface without a
        consistent winding.

    """
    place = str(path)
    surface, repairs = repair(read(path, scale))
    if not len(surface.triangles):
        found = ", ".join(map(str, repairs))
        raise InputError(place, "a mesh must have a triangle with an area", found, "Export the mesh again")
    report = inspect(surface)
    check_scale(report, place, scale=scale)
    one = "an instrument" if purpose == "instrument" else "a tissue"
    mend = "Mend it in a mesh editor"
    loose = purpose == "instrument" and open_surface
    if report.nonmanifold_edges and not loose:
        also = ", or give open_surface = true for an instrument" if purpose == "instrument" else ""
        raise InputError(
            place,
            f"at most two triangles of {one} may share an edge",
            f"{report.nonmanifold_edges} edges with more",
            mend + also,
        )
    if report.degenerate_triangles and not loose:
        raise InputError(
            place,
            f"a triangle of {one} must have a height",
            f"{report.degenerate_triangles} flat triangles that cannot be removed safely",
            mend,
        )
    if not report.winding_consistent and not loose:
        raise InputError(
            place,
            f"{one} must have an inner and an outer side",
            "a one-sided surface, like a Möbius strip",
            mend,
        )
    if report.boundary_edges and not open_surface:
        raise InputError(
            place,
            f"{one} must be closed",
            f"{report.boundary_edges} boundary edges round one or more holes",
            f"Close it in a mesh editor, or give open_surface = true if the {purpose} is meant to be a sheet",
        )
    if report.components > 1 and not many_parts:
        raise InputError(
            place,
            f"{one} must be of one piece",
            f"{report.components} components",
            "Remove the stray pieces in a mesh editor, or give many_parts = true if all of them are meant",
        )
    if purpose == "instrument" and many_parts:
        surface = Surface(surface.vertices, surface.triangles, _pieces(surface), surface.axes)
    return surface, report, repairs


def _pieces(surface: Surface) -> IntArray:
    """Piece of every triangle: joined through any common vertex, so that bad edges cut nothing."""
    ends = edges(surface)
    return _labels(len(surface.vertices), ends)[surface.triangles[:, 0]]


def check_scale(report: MeshReport, place: str, *, scale: float = 1.0) -> None:
    """Refuse a mesh whose largest dimension is not between 1 mm and 1 m: its unit is probably not the metre.

    Parameters
    ----------
    report : MeshReport
        Of the mesh after `scale` was applied.
    place : str
        Named in the error.
    scale : float
        What was applied, so that the error can name the right one.

    Raises
    ------
    InputError
        The size is out of range; the message names the scale that would put it right.

    """
    if EXTENT_MIN <= report.extent <= EXTENT_MAX:
        return
    raw = report.extent / scale
    # mm, m, cm, µm; if the file has none of them, the power of 1000 that fits (the range has three decades).
    scales = [s for s in (1e-3, 1.0, 1e-2, 1e-6) if EXTENT_MIN <= raw * s <= EXTENT_MAX]
    scales = scales or [1000.0 ** -float(np.ceil(np.log10(raw) / 3))]
    advice = " or ".join(f"scale = {s:g} ({raw * s:.3g} m)" for s in scales)
    raise InputError(
        place,
        "the largest dimension must lie between 0.001 m and 1 m",
        f"{report.extent:.4g} m with scale = {scale:g}",
        f"Give the file's unit in metres: {advice}",
    )


# --- box --------------------------------------------------------------------------------------------------


def _rotations() -> FloatArray:
    """The 24 ways to name and point three given axes so that they are right-handed."""
    found = []
    for order, sign in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        matrix = np.zeros((3, 3))
        matrix[range(3), order] = sign
        if np.linalg.det(matrix) > 0:
            found.append(matrix)
    return np.array(found)


def oriented_box(points: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The object-oriented bounding box: the smallest box found round the points, whatever its direction.

    The axis-aligned box is taken unless another is smaller by more than 1e-6 of its volume, so that a
    symmetric instrument keeps its own axes. Axes are named and pointed as near to x, y, z as possible.

    Parameters
    ----------
    points : array of shape (n, 3)
        [m]

    Returns
    -------
    centre : [m], shape (3,)
    axes : unit vectors in rows, right-handed, shape (3, 3)
    half : half extents along them [m], shape (3,)

    """
    points = np.asarray(points, np.float64).reshape(-1, 3)
    best = np.eye(3)
    volume_best = float(np.ptp(points, axis=0).prod())
    turned = _least_box_axes(points)
    if float(np.ptp(points @ turned.T, axis=0).prod()) < volume_best * (1 - 1e-6):
        names = _rotations()
        best = names[np.argmax([np.trace(r @ turned) for r in names])] @ turned
    along = points @ best.T
    low, high = along.min(axis=0), along.max(axis=0)
    return (0.5 * (low + high)) @ best, best, 0.5 * (high - low)


def _least_box_axes(points: FloatArray) -> FloatArray:
    """Axes in rows of the least box, before they are named; flat and straight sets of points included."""
    spread = points - points.mean(axis=0)
    _, size, axes = np.linalg.svd(spread, full_matrices=len(points) < 3)
    rank = int((size > 1e-9 * max(size[0], 1e-300)).sum())
    if rank == 2:
        to_origin, _ = trimesh.bounds.oriented_bounds_2D(spread @ axes[:2].T)
        axes[:2] = to_origin[:2, :2] @ axes[:2]
    elif rank == 3:
        to_origin, _ = trimesh.bounds.oriented_bounds(points)
        axes = to_origin[:3, :3]
    axes[2] = np.cross(axes[0], axes[1])
    return np.ascontiguousarray(axes)


def nearest_place(surface: Surface, points: ArrayLike) -> tuple[IntArray, FloatArray]:
    """Where on the surface each point is nearest to.

    Parameters
    ----------
    points : array of shape (n, 3)
        [m]

    Returns
    -------
    triangle : int32, shape (n,)
    weight : areal coordinates of the place in its triangle, shape (n, 3)

    """
    corners = surface.vertices[surface.triangles]
    places = np.asarray(points, np.float64).reshape(-1, 3)
    if not len(places):
        return np.empty(0, np.int32), np.empty((0, 3))
    middle = corners.mean(axis=1)
    radius = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
    near, _ = cKDTree(corners.reshape(-1, 3)).query(places)
    # A triangle nearer than the nearest corner has its middle no farther than that and its own radius. Those of about
    # one size are looked at together: a single large one would make candidates of all.
    pairs = []
    size = np.frexp(radius)[1]
    for group in np.unique(size):
        own = np.flatnonzero(size == group)
        found = cKDTree(middle[own]).query_ball_point(places, (near + radius[own].max()) * (1 + 1e-9))
        point = np.repeat(np.arange(len(places)), [len(f) for f in found])
        pairs.append(np.column_stack([point, own[np.concatenate(found).astype(np.intp)]]))
    point, candidate = np.concatenate(pairs).T
    feet = trimesh.triangles.closest_point(corners[candidate], places[point])
    order = np.lexsort((candidate, ((feet - places[point]) ** 2).sum(axis=1), point))
    best = order[np.r_[True, np.diff(point[order]) > 0]]
    triangle = candidate[best].astype(np.int32)
    return triangle, np.asarray(trimesh.triangles.points_to_barycentric(corners[triangle], feet[best]))


class Hull(NamedTuple):
    """A convex hull: its vertices [m], shape (n, 3), and for each the vertices at the other ends of its edges."""

    vertices: FloatArray
    neighbours: list[IntArray]


NO_HULL = Hull(np.empty((0, 3)), [])


def convex_hull(surface: Surface, part: int) -> Hull:
    """Convex hull of one part of a surface."""
    points = surface.vertices[np.unique(surface.triangles[surface.part == part])]
    if len(points) < 4:  # of a single triangle
        number = np.arange(len(points), dtype=np.int32)
        return Hull(points, [np.delete(number, k) for k in number])
    # Joggled input (QJ): cocircular points make clean triangles, flat parts a hull of next to no thickness.
    hull = ConvexHull(points, qhull_options="QJ Pp")
    used = np.sort(hull.vertices)
    corners = np.searchsorted(used, hull.simplices)
    ends = np.unique(np.concatenate([corners[:, [i, j]] for i, j in permutations(range(3), 2)]), axis=0)
    return Hull(
        points[used], np.split(ends[:, 1].astype(np.int32), np.searchsorted(ends[:, 0], np.arange(1, len(used))))
    )


# Axes of the slabs of a k-DOP: 3 axes, 4 diagonals of the cube, 6 of its faces; the first k / 2 are taken.
SLABS = np.array(
    [(1, 0, 0), (0, 1, 0), (0, 0, 1)]
    + [(1, 1, 1), (1, 1, -1), (1, -1, 1), (-1, 1, 1)]
    + [(1, 1, 0), (1, -1, 0), (1, 0, 1), (1, 0, -1), (0, 1, 1), (0, 1, -1)],
    np.float64,
)
SLABS /= np.linalg.norm(SLABS, axis=1, keepdims=True)
CORNER_SAME = 1e-10  # [m] corners nearer than this are one: far above rounding, far below what matters


def kdop(points: ArrayLike, k: Literal[6, 14, 26]) -> Hull:
    """The k-DOP of points: what k / 2 slabs of fixed directions leave, each just wide enough for all the points.

    Its support is that of the points along the slabs and never less elsewhere; the more slabs, the nearer.

    Parameters
    ----------
    points : array of shape (n, 3)
        [m]
    k : 6, 14 or 26
        Faces: of the box along x, y, z; cut along the diagonals of the cube; along those of its faces too.

    """
    along = np.asarray(points, np.float64).reshape(-1, 3) @ SLABS[: k // 2].T
    face = np.concatenate([SLABS[: k // 2], -SLABS[: k // 2]])
    offset = np.concatenate([along.max(axis=0), -along.min(axis=0)])
    # Every corner is where three faces meet, beyond none of the others; every edge lies in two faces.
    three = np.array(list(combinations(range(k), 3)))
    three = three[np.abs(np.linalg.det(face[three])) > 1e-6]
    corners = np.linalg.solve(face[three], offset[three][..., None])[..., 0]
    corners = corners[(corners @ face.T <= offset + 0.01 * CORNER_SAME).all(axis=1)]
    corners = corners[np.unique(_near_vertices(corners, np.arange(len(corners)), CORNER_SAME))]
    within = (np.abs(corners @ face.T - offset) <= 3 * CORNER_SAME).astype(np.int32)
    joined = within @ within.T >= 2
    np.fill_diagonal(joined, False)
    return Hull(corners, [np.flatnonzero(row).astype(np.int32) for row in joined])


def box_hull(centre: ArrayLike, axes: ArrayLike, half: ArrayLike) -> Hull:
    """The hull of a box: centre [m], unit vectors of its axes in rows, half extents along them [m]."""
    sign = np.array(list(product((-1.0, 1.0), repeat=3)))
    number = np.arange(8, dtype=np.int32)
    return Hull(centre + sign * half @ np.asarray(axes), list(np.stack([number ^ 1, number ^ 2, number ^ 4], axis=1)))
