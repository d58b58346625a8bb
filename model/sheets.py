"""One tissue, before it joins the others: springs, masses, constraints, the points at which fields are read."""

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix, diags
from scipy.sparse.csgraph import reverse_cuthill_mckee
from scipy.sparse.linalg import eigsh

from tissue_contact import fields, geometry
from tissue_contact.boxes import held_vertices
from tissue_contact.errors import InputError
from tissue_contact.geometry import FloatArray, IntArray, Surface
from tissue_contact.scene import FixedBox, Scene, Tissue
from tissue_contact.surfaces import surface_of


class Sheet(NamedTuple):
    """Arrays of one tissue; what they mean: `tissue_contact.kernels.layout.Model`."""

    surface: Surface
    springs: IntArray  # shape [S, 2]
    rest: FloatArray  # [m], shape [S]
    stiffness: FloatArray  # [N/m], shape [S]
    area: FloatArray  # [m²], shape [V]
    free: FloatArray  # shape [V]
    rate: float
    damping_rate: float
    triangle_area: FloatArray  # [m²], shape [T]
    triangle_edges: FloatArray  # [m²], shape [T]
    area_rate: float
    volume: float  # [m³], negative where triangles face inward; 1 where it is not resisted
    volume_rate: float
    volume_bend: float
    point_start: IntArray  # shape [T + 1]
    point_weight: FloatArray  # shape [N, 3]
    point_area: FloatArray  # [m²], shape [N]


def sheet_of(tissue: Tissue, scene: Scene, spacing: float | None) -> Sheet:
    """Arrays of a tissue; ``spacing`` [m] is that of its points, None where no field reads it.

    Raises
    ------
    InputError
        A surface that cannot be used, or a tissue that nothing holds in place.
    """
    place = f"{scene.place}, tissue[{tissue.name}]"
    surface = surface_of(tissue, scene.folder, scene.place)
    fixed = _fixed(tissue, surface, f"{place}.fixed")
    order = _local_order(surface)
    surface = _renumbered(surface, order)
    area = node_areas(surface)
    springs, stiffness = _springs(tissue, surface)
    free = 1.0 - fixed[order]
    length = np.linalg.norm(surface.vertices[springs[:, 1]] - surface.vertices[springs[:, 0]], axis=1)
    damping = np.full(len(springs), tissue.damping)
    damping_rate = laplacian_rate(springs, damping, area, free) if tissue.damping > 0.0 else 0.0
    triangle_area = geometry.triangle_areas(surface)
    corners = surface.vertices[surface.triangles]
    triangle_edges = ((corners - np.roll(corners, 1, axis=1)) ** 2).sum(axis=(1, 2))
    if spacing is None:
        points = (np.zeros(len(surface.triangles) + 1, np.int32), np.empty((0, 3)), np.empty(0))
    else:
        points = fields.quadrature(surface, spacing)
    return Sheet(
        surface,
        springs,
        (1.0 - tissue.preload) * length,
        stiffness,
        area,
        free,
        laplacian_rate(springs, stiffness, area, free),
        damping_rate,
        triangle_area,
        triangle_edges,
        area_rate(triangle_area, triangle_edges),
        *_volume(tissue, surface, area, free, f"{place}.volume_stiffness"),
        *points,
    )


def area_rate(area: FloatArray, edges: FloatArray) -> float:
    """Bound of the eigenvalues of E = 1/2 sum (A - A0)²/A0 over the vertex areas, at rest [1/m²].

    Of one triangle the second derivative is at most S/(4 A0) from the gradient, with S its squared edges, and once
    more as much from the tension; over a third of its own area at every corner that bounds the sum of all triangles.
    """
    return float((1.5 * edges / area**2).max())


def _volume(
    tissue: Tissue, surface: Surface, area: FloatArray, free: FloatArray, place: str
) -> tuple[float, float, float]:
    """Volume at rest, and bounds of the eigenvalues of E = (V - V0)²/(2 |V0|) and of V itself over the vertex areas."""
    if tissue.volume_stiffness == 0.0:
        return 1.0, 0.0, 0.0
    report = geometry.inspect(surface)
    if not (report.watertight and report.winding_consistent):
        wound = "an open surface" if not report.watertight else "triangles wound both ways"
        raise InputError(
            place, "only a closed, consistently wound surface has a volume", wound,
            "Remove volume_stiffness, or close the surface",
        )  # fmt: skip
    corners = surface.vertices[surface.triangles]
    normals = geometry.area_normals(corners) / 6.0
    gradient = np.zeros_like(surface.vertices)
    np.add.at(gradient, surface.triangles, normals[:, None])
    volume = geometry.volume(surface)
    rate = float(((gradient**2).sum(axis=1) * free / area).sum()) / abs(volume)
    # d²V/dx_i dx_j is a sixth of the cross product with the way between the two corners opposite to the edge i j, which
    # is no longer than the ways over j: the edges opposite to i, once for each of the two edges at i.
    opposite = np.linalg.norm(np.roll(corners, -1, axis=1) - np.roll(corners, -2, axis=1), axis=2)
    bend = np.zeros(len(area))
    np.add.at(bend, surface.triangles, opposite / 3.0)
    return volume, rate, float((bend / area).max())


def _fixed(tissue: Tissue, surface: Surface, place: str) -> FloatArray:
    """1 for the vertices that never move, numbered as in the mesh."""
    fixed = np.zeros(len(surface.vertices))
    if isinstance(tissue.fixed, FixedBox):
        fixed[held_vertices(surface.vertices, tissue.fixed.box, place)] = 1.0
    elif isinstance(tissue.fixed, tuple):
        beyond = [i for i in tissue.fixed if i >= len(fixed)]
        if beyond:
            raise InputError(
                place, "a vertex index must be below the number of vertices", f"{beyond[0]}",
                f"The surface has {len(fixed)} vertices, numbered from 0",
            )  # fmt: skip
        fixed[list(tissue.fixed)] = 1.0
    elif tissue.fixed == "boundary":
        fixed[geometry.boundary_vertices(surface)] = 1.0
        if not fixed.any() and tissue.support_stiffness == 0.0:
            raise InputError(
                place,
                "something must hold the tissue in place",
                "a closed surface, which has no boundary, and no support",
                "Give support_stiffness, fix a box of vertices with fixed = {box = [[…], […]]}, "
                'or let it float with fixed = "none"',
            )
    return fixed


def _local_order(surface: Surface) -> IntArray:
    """Order of the vertices that keeps neighbours close together in memory, whatever order the mesh file has."""
    e = geometry.edges(surface)
    n = len(surface.vertices)
    graph = csr_matrix((np.ones(len(e)), (e[:, 0], e[:, 1])), shape=(n, n))
    return np.asarray(reverse_cuthill_mckee(graph + graph.T, symmetric_mode=True), np.int32)


def _renumbered(surface: Surface, order: IntArray) -> Surface:
    """The surface with vertex order[k] become vertex k, its triangles sorted by their least vertex."""
    new = np.empty(len(order), np.int32)
    new[order] = np.arange(len(order))
    triangles = new[surface.triangles]
    triangles = triangles[np.lexsort((triangles.max(axis=1), triangles.min(axis=1)))]
    return Surface(surface.vertices[order], triangles)


def node_areas(surface: Surface) -> FloatArray:
    """Area of every vertex [m²], one third of its triangles."""
    areas = geometry.triangle_areas(surface)
    sums = np.bincount(surface.triangles.ravel(), np.repeat(areas / 3.0, 3), minlength=len(surface.vertices))
    return np.asarray(sums, np.float64)


def _springs(tissue: Tissue, surface: Surface) -> tuple[IntArray, FloatArray]:
    """Structural and bending springs with their stiffness [N/m].

    From Young's modulus E and thickness t: k = E t (sum of the adjacent areas) / l² (van Gelder 1998), which is
    approximate by its author's own statement.
    """
    structural = geometry.edges(surface)
    if tissue.stiffness is not None:
        stiffness = np.full(len(structural), tissue.stiffness)
    else:
        assert tissue.youngs_modulus is not None and tissue.thickness is not None  # the scene holds one of the two
        stiffness = tissue.youngs_modulus * tissue.thickness * _edge_areas(surface, structural)
        stiffness /= (np.diff(surface.vertices[structural], axis=1) ** 2).sum(axis=2).ravel()
    if tissue.bending_stiffness == 0.0:
        return structural, stiffness
    bending = np.sort(geometry.flaps(surface), axis=1)
    springs = np.concatenate([structural, bending])
    stiffness = np.concatenate([stiffness, np.full(len(bending), tissue.bending_stiffness)])
    order = np.lexsort((springs[:, 1], springs[:, 0]))
    return springs[order], stiffness[order]


def _edge_areas(surface: Surface, edges: IntArray) -> FloatArray:
    """Sum of the areas of the triangles at every edge [m²]."""
    n = len(surface.vertices)
    t = surface.triangles
    sides = np.sort(np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]]), axis=1)
    areas = coo_matrix((np.tile(geometry.triangle_areas(surface), 3), (sides[:, 0], sides[:, 1])), shape=(n, n))
    return np.asarray(areas.tocsr()[edges[:, 0], edges[:, 1]]).ravel()


def laplacian_rate(springs: IntArray, stiffness: FloatArray, area: FloatArray, free: FloatArray) -> float:
    """Largest eigenvalue of the springs' Laplacian over the vertex areas, fixed vertices held [N/m/m²].

    Over the areal density it bounds every squared frequency of the mesh, however deformed: the tangent stiffness of
    a linear spring is never more than k in any direction. Rounded up to three digits, so that a model does not
    depend on the last bits of a linear algebra library.
    """
    kept = np.flatnonzero(free)
    if kept.size == 0 or len(springs) == 0:
        return 0.0
    n = len(area)
    i, j = springs.T
    laplacian = coo_matrix(
        (
            np.concatenate([stiffness, stiffness, -stiffness, -stiffness]),
            (np.concatenate([i, j, i, j]), np.concatenate([i, j, j, i])),
        ),
        shape=(n, n),
    ).tocsr()[kept][:, kept]
    scale = diags(1.0 / np.sqrt(area[kept]))
    matrix = scale @ laplacian @ scale
    if kept.size <= 64:
        rate = float(np.linalg.eigvalsh(matrix.toarray())[-1])
    else:
        # Lanczos approaches from below; its tolerance is added.
        start = np.random.default_rng(0).standard_normal(kept.size)
        rate = float(eigsh(matrix, 1, which="LA", v0=start, tol=1e-3, return_eigenvectors=False)[0]) * 1.001
    unit = 10.0 ** (np.floor(np.log10(rate)) - 2)
    return float(np.ceil(rate / unit) * unit)
