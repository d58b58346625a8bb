"""Generated surfaces: patches and organs of tissue, and instruments; in metres.

The same arguments give the same mesh. Tissue may be graded: with ``reach`` [m], two corners of a box, ``triangles`` is
how many there were if all of it were as fine as within the box; beyond, edges grow by ``growth`` of the distance.

Tissue is triangulated irregularly, as from an image, because a regular lattice lets waves and folds run along
its rows. Its outer side is +z for sheets and outside for closed organs.

An instrument's frame has its origin at the tip (the mesh's lowest z is 0) and +z toward the handle. Rings
have their facets, not their vertices, toward x and y, so that the smallest box round a rod has its own axes.
"""

from collections.abc import Callable, Sequence
from itertools import product
from numbers import Real
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull, Delaunay

from tissue_contact.boxes import Corners
from tissue_contact.errors import InputError
from tissue_contact.geometry import FloatArray, IntArray, Surface, area_normals, volume
from tissue_contact.grading import GROWTH, Grading
from tissue_contact.relaxation import centred, in_order, swapped

RELAXATIONS = 30  # rounds of Lloyd smoothing; more gain less than a degree in the smallest angle
SAC_FILLET = 0.3  # radius of the rounded rim of a hernia's opening over the opening's radius
LEAST_VERTICES = 12  # of a closed organ: those of the 20 triangles that it has at least
JAW_GAP = 0.02  # between closed jaws over their width, so that two parts never share an edge
SAC_BULGE = 0.6  # how much the sac is wider than its neck: the widest place is 1.35 times the neck


def _require(holds: bool, place: str, rule: str, value: object, way_out: str) -> None:
    if not holds:
        raise InputError(place, rule, value, way_out)


def _positive(place: str, **lengths: Any) -> None:
    for name, value in lengths.items():
        good = isinstance(value, Real) and 0 < float(value) < np.inf
        _require(good, f"{place}, {name}", "must be a positive length in metres", value, f"Give {name} > 0")


def _count(place: str, triangles: int, least: int) -> None:
    good = isinstance(triangles, int | np.integer) and triangles >= least
    way_out = f"Ask for {least} triangles or more"
    _require(bool(good), f"{place}, triangles", f"must be a whole number of at least {least}", triangles, way_out)


def _size(place: str, size: float | Sequence[float], n: int) -> FloatArray:
    """The n lengths of `size`; one number stands for all of them."""
    lengths = np.atleast_1d(np.asarray(size, np.float64))
    good = lengths.shape in ((1,), (n,)) and bool(np.isfinite(lengths).all() and (lengths > 0).all())
    _require(good, f"{place}, size", f"must be 1 or {n} positive lengths in metres", size, "Give size > 0")
    return np.broadcast_to(lengths, n).copy()


def _spread(n: int, dimension: int, rng: np.random.Generator) -> FloatArray:
    """Evenly spread points of the unit cube (the additive sequence of the generalised golden ratio)."""
    ratio = 2.0
    for _ in range(60):
        ratio = (1 + ratio) ** (1 / (dimension + 1))
    step = ratio ** -np.arange(1, dimension + 1)
    return np.asarray((rng.random(dimension) + np.outer(np.arange(1, n + 1), step)) % 1)


# --- tissue -----------------------------------------------------------------------------------------------


def patch(
    size: float | Sequence[float],
    triangles: int,
    curvature_radius: float | None = None,
    seed: int = 0,
    irregular: bool = True,
    reach: Corners | None = None,
    growth: float = GROWTH,
) -> Surface:
    """A rectangular sheet round the origin, flat or curved: z = −(x² + y²)/(2R).

    Parameters
    ----------
    size : float or two floats
        Side lengths along x and y [m].
    triangles : int
        How many; met within 2 % from 200 triangles on.
    curvature_radius : float, optional
        R [m]: positive bulges toward the outer side +z, negative is a hollow, None is flat. At least half the
        diagonal, so that the sheet never gets steeper than 45°.
    seed : int
        Another seed gives another mesh of the same sheet.
    irregular : bool
        False gives rows of equal triangles, their number within 6 % from 200 triangles on; not with a reach.
    reach, growth
        See the module.

    Raises
    ------
    InputError
        An argument breaks its rule.

    """
    lengths = _size("patch", size, 2)
    _count("patch", triangles, 2)
    bend = 0.0
    if curvature_radius is not None:
        least = 0.5 * float(np.hypot(*lengths))
        good = np.isfinite(curvature_radius) and abs(curvature_radius) >= least
        rule = f"must be at least half the diagonal ({least:.4g} m) in magnitude"
        way_out = "Give a larger radius, or none for a flat sheet"
        _require(bool(good), "patch, curvature_radius", rule, curvature_radius, way_out)
        bend = 0.5 / curvature_radius

    def to_space(plan: FloatArray) -> FloatArray:
        return np.column_stack([plan, 0.0 - bend * (plan**2).sum(axis=1)])

    grading = Grading("patch", reach, growth, _edge(float(lengths.prod()), triangles))
    if not irregular:
        way_out = "Leave reach out, or irregular"
        _require(reach is None, "patch, reach", "must be left out where irregular is false", reach, way_out)
        plan = _rows(lengths, triangles)
        return Surface(to_space(plan), _delaunay(plan))
    rng = np.random.default_rng(seed)
    count, margin, inner = _finest(lengths, triangles, float(lengths.prod()))
    start = grading.thinned((_spread(inner, 2, rng) - 0.5) * (lengths - margin), to_space, rng)
    return _relaxed(_rim(lengths, count, to_space, grading), start, to_space, grading)


def _rows(lengths: FloatArray, triangles: int) -> FloatArray:
    """Rows of points, every second one shifted by half a step: ny rows of 2 nx + 1 triangles."""
    best = (np.inf, 1, 1)
    middle = max(1.0, np.sqrt(triangles * lengths[1] / lengths[0] / np.sqrt(3)))
    for ny in range(max(1, int(0.7 * middle)), int(1.4 * middle) + 2):
        nx = max(1, round((triangles / ny - 1) / 2))
        skew = abs(np.log(lengths[0] / nx * np.sqrt(0.75) / (lengths[1] / ny)))
        best = min(best, (5 * abs(ny * (2 * nx + 1) / triangles - 1) + skew, nx, ny))
    _, nx, ny = best
    points = []
    for j in range(ny + 1):
        x = np.arange(nx + 1) / nx if j % 2 == 0 else np.r_[0, (np.arange(nx) + 0.5) / nx, 1]
        points.append(np.column_stack([x, np.full(len(x), j / ny)]))
    return np.asarray((np.concatenate(points) - 0.5) * lengths)


def _edge(area: float, triangles: int) -> float:
    """Length [m] of the edges of so many equal triangles with three equal sides."""
    return float(np.sqrt(area / triangles * 4 / np.sqrt(3)))


def _finest(lengths: FloatArray, triangles: int, area: float) -> tuple[tuple[int, int], float, int]:
    """Edges along both sides of a rectangle, how far inner points keep from its rim in all, and how many there are.

    A triangulated disc with b points on its rim and i inside has 2 i + b − 2 triangles (Euler).
    """
    step = _edge(area, triangles)
    nx, ny = (max(1, round(float(length / step))) for length in lengths)
    while nx + ny > 2 and 2 * (nx + ny) - 2 > triangles:
        nx, ny = (nx - 1, ny) if nx > ny else (nx, ny - 1)
    rim = 2 * (nx + ny)
    return (nx, ny), 0.5 * lengths.min() / rim, max(0, round((triangles + 2 - rim) / 2))


def _rim(
    lengths: FloatArray, finest: tuple[int, int], to_space: Callable[[FloatArray], FloatArray], grading: Grading
) -> FloatArray:
    """Points of a rectangle's rim, with so many edges along its sides where they are finest."""
    corners = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])

    def side(turn: int) -> FloatArray:
        def plan(place: FloatArray) -> FloatArray:
            return np.asarray((corners[turn] + place[:, None] * (corners[(turn + 1) % 4] - corners[turn])) * lengths)

        return plan(grading.places(lambda place: to_space(plan(place)), finest[turn % 2]))

    return np.concatenate([side(turn) for turn in range(4)])


def _delaunay(plan: FloatArray) -> IntArray:
    """Delaunay triangles, counterclockwise, without the flat ones along a straight rim."""
    found = Delaunay(plan).simplices
    a, b, c = np.moveaxis(plan[found], 1, 0)
    twice = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    longest = np.maximum.reduce([((p - q) ** 2).sum(axis=1) for p, q in ((a, b), (b, c), (c, a))])
    found = np.where((twice < 0)[:, None], found[:, ::-1], found)
    return in_order(found[np.abs(twice) > 1e-9 * longest])


def _relaxed(
    rim: FloatArray, inner: FloatArray, to_space: Callable[[FloatArray], FloatArray], grading: Grading
) -> Surface:
    """Triangulate in the plan and move inner points to the middle of their triangles, by area over that wanted.

    `to_space` must keep angles roughly (a conformal map): Delaunay triangles are good in the plan only.
    """
    plan = np.concatenate([rim, inner])
    fixed = len(rim)
    for _ in range(RELAXATIONS):
        triangles = _delaunay(plan)
        weight = grading.weight(to_space(plan)[triangles])
        plan[fixed:] = centred(triangles, plan[triangles].mean(axis=1), weight, plan)[fixed:]
    surface = Surface(to_space(plan), _delaunay(plan))
    grading.check(surface.vertices)
    return surface


def abdominal_wall(
    size: float | Sequence[float],
    triangles: int,
    opening_radius: float,
    sac_depth: float,
    seed: int = 0,
    reach: Corners | None = None,
    growth: float = GROWTH,
) -> Surface:
    """The inner side of an abdominal wall with a hernia: a flat sheet whose middle is pushed out into a sac.

    One open sheet. Its outer normal, +z on the flat, looks into the abdomen where the instrument works; the
    sac hangs through a round opening toward −z and is wider than its neck.

    Parameters
    ----------
    size : float or two floats
        Side lengths along x and y [m]; more than 2.8 times the opening's radius.
    triangles : int
        How many; met within 2 % from 400 triangles on.
    opening_radius : float
        Radius of the neck [m].
    sac_depth : float
        From the flat sheet to the bottom of the sac [m]; 0.5 to 6 times the opening's radius.
    seed : int
        Another seed gives another mesh of the same wall.
    reach, growth
        See the module.

    Raises
    ------
    InputError
        An argument breaks its rule.

    """
    place = "abdominal_wall"
    lengths = _size(place, size, 2)
    _count(place, triangles, 100)
    _positive(place, opening_radius=opening_radius, sac_depth=sac_depth)
    fillet = SAC_FILLET * opening_radius
    edge = opening_radius + fillet
    room = 2.8 * opening_radius < lengths.min()
    _require(bool(room), f"{place}, opening_radius", "2.8 times it must fit in size", opening_radius, "Lessen it")
    depth_fits = 0.5 <= sac_depth / opening_radius <= 6
    rule = "must be 0.5 to 6 times opening_radius"
    _require(depth_fits, f"{place}, sac_depth", rule, sac_depth, "Change one of the two")

    # Profile (radius, z) from the flat edge over the rounded rim and the neck to the bottom.
    turn = np.linspace(0, np.pi / 2, 500)
    angle = np.linspace(0, np.pi / 2, 4001)[1:-1]
    r = np.r_[edge - fillet * np.sin(turn), opening_radius * (np.cos(angle) + SAC_BULGE * np.sin(2 * angle) ** 2)]
    z = np.r_[fillet * (np.cos(turn) - 1), -fillet - (sac_depth - fillet) * np.sin(angle)]
    ds, middle = np.hypot(np.diff(r), np.diff(z)), 0.5 * (r[1:] + r[:-1])
    area = np.r_[0, np.cumsum(2 * np.pi * middle * ds)]
    # Conformal plan of a surface of revolution: dρ/ρ = ds/r.
    rho = edge * np.exp(-np.r_[0, np.cumsum(ds / middle)])

    def to_space(plan: FloatArray) -> FloatArray:
        distance = np.linalg.norm(plan, axis=1)
        inside = distance < edge
        grow = np.ones(len(plan))
        clipped = np.maximum(distance[inside], rho[-1])
        grow[inside] = np.interp(clipped, rho[::-1], r[::-1]) / clipped
        height = np.zeros(len(plan))
        height[inside] = np.interp(clipped, rho[::-1], z[::-1])
        return np.column_stack([plan * grow[:, None], height])

    flat = float(lengths.prod()) - np.pi * edge**2
    rng = np.random.default_rng(seed)
    grading = Grading(place, reach, growth, _edge(flat + area[-1], triangles))
    count, margin, inner = _finest(lengths, triangles, flat + area[-1])
    in_sac = round(inner * area[-1] / (flat + area[-1]))
    spread = _spread(in_sac, 2, rng)
    distance = np.interp(spread[:, 0] * area[-1], area, rho)
    around = 2 * np.pi * spread[:, 1]
    sac = distance[:, None] * np.column_stack([np.cos(around), np.sin(around)])
    many = int(2 * (inner - in_sac) * lengths.prod() / flat) + 100
    sheet = (_spread(many, 2, rng) - 0.5) * (lengths - margin)
    sheet = sheet[np.linalg.norm(sheet, axis=1) > edge][: inner - in_sac]
    start = grading.thinned(np.concatenate([sac, sheet]), to_space, rng)
    return _relaxed(_rim(lengths, count, to_space, grading), start, to_space, grading)


def ellipsoid(
    radii: float | Sequence[float],
    triangles: int,
    seed: int = 0,
    reach: Corners | None = None,
    growth: float = GROWTH,
) -> Surface:
    """A closed organ round the origin, triangulated irregularly.

    Parameters
    ----------
    radii : float or three floats
        Half axes along x, y, z [m].
    triangles : int
        How many, at least 20, more for a slim shape; an odd number gives one more.
    seed : int
        Another seed gives another mesh of the same ellipsoid.
    reach, growth
        See the module.

    Raises
    ------
    InputError
        An argument breaks its rule.

    """
    half = _size("ellipsoid", radii, 3)
    _count("ellipsoid", triangles, 20)
    slim = half.max() <= 20 * half.min()
    _require(bool(slim), "ellipsoid, radii", "must not differ by more than 20 times", radii, "Choose rounder radii")

    def lifted(points: FloatArray) -> FloatArray:
        # Steps along the gradient of f = |p/r| − 1 land near the closest point; a ray from the centre would
        # pull points along a slim body.
        for _ in range(3):
            level = np.linalg.norm(points / half, axis=1, keepdims=True)
            gradient = points / half**2 / level
            points = points - (level - 1) * gradient / (gradient**2).sum(axis=1, keepdims=True)
        return np.asarray(points / np.linalg.norm(points / half, axis=1, keepdims=True))

    n = (triangles + 1) // 2 + 2  # a closed surface of n vertices has 2 n − 4 triangles (Euler)
    rng = np.random.default_rng(seed)
    # Even on the ellipsoid: take points of the sphere in proportion to how much its area is stretched there.
    weight_max = half.prod() / half.min()
    found = np.empty((0, 3))
    many = 4 * n
    while len(found) < n:
        spread = _spread(many, 3, rng)
        z, around = 2 * spread[:, 0] - 1, 2 * np.pi * spread[:, 1]
        flat = np.sqrt(1 - z**2)
        sphere = np.column_stack([flat * np.cos(around), flat * np.sin(around), z])
        stretch = half.prod() * np.linalg.norm(sphere / half, axis=1)
        found = sphere[stretch > spread[:, 2] * weight_max][:n]
        many *= 2
    grading = Grading("ellipsoid", reach, growth, _edge(float(4 * np.pi * stretch.mean()), triangles))
    vertices = grading.thinned(found, lambda sphere: sphere * half, rng) * half
    rule = f"must leave {LEAST_VERTICES} vertices or more of a graded mesh"
    way_out = "Ask for more, or enlarge the reach"
    _require(len(vertices) >= LEAST_VERTICES, "ellipsoid, triangles", rule, triangles, way_out)
    for _ in range(RELAXATIONS):
        hull = swapped(vertices, _hull(vertices))
        corner = vertices[hull]
        weight = grading.weight(corner)
        vertices = lifted(centred(hull, lifted(corner.mean(axis=1)), weight, vertices))
    surface = Surface(vertices, swapped(vertices, _hull(vertices)))
    full = 4 / 3 * np.pi * half.prod()
    rule = "must suffice for half the ellipsoid's volume"
    way_out = "Ask for more triangles or for rounder radii"
    _require(volume(surface) > 0.5 * full, "ellipsoid, triangles", rule, triangles, way_out)
    grading.check(surface.vertices)
    return surface


def _hull(vertices: FloatArray) -> IntArray:
    """Triangles of the convex hull of points, wound outward."""
    found = ConvexHull(vertices).simplices
    outward = vertices[found[:, 0]] - vertices.mean(axis=0)
    inward = np.einsum("ij,ij->i", area_normals(vertices[found]), outward) < 0
    return in_order(np.where(inward[:, None], found[:, ::-1], found))


# --- instruments ------------------------------------------------------------------------------------------


def capsule(radius: float, length: float, triangles: int) -> Surface:
    """A rod with hemispherical ends: tip point at the origin, other end at z = length.

    Parameters
    ----------
    radius : float
        [m]
    length : float
        Over all [m], at least 2 radii.
    triangles : int
        How many, at least 8; met within one ring, 8 k (k + q) with whole k and q.

    Raises
    ------
    InputError
        An argument breaks its rule.

    """
    _positive("capsule", radius=radius, length=length)
    _count("capsule", triangles, 8)
    long = length >= 2 * radius
    _require(long, "capsule, length", "must be at least 2 radii", length, "Give a longer one, or take a sphere")
    wall = length - 2 * radius
    wall = wall if wall > 1e-3 * radius else 0.0  # no ring of triangles without height
    k, q = _divisions(0.5 * np.pi * radius, wall, triangles)
    angle = 0.5 * np.pi * np.arange(k + 1) / k
    cap = radius * np.column_stack([np.sin(angle), 1 - np.cos(angle)])
    return _turned(cap, length, q, ((0, 0, radius), (0, 0, length)))


def sphere(radius: float, triangles: int) -> Surface:
    """A ball whose lowest point is the origin.

    Parameters
    ----------
    radius : float
        [m]
    triangles : int
        How many, at least 8; the nearest 8 k² is taken.

    Raises
    ------
    InputError
        An argument breaks its rule.

    """
    _positive("sphere", radius=radius)
    _count("sphere", triangles, 8)
    return capsule(radius, 2 * radius, triangles)


def cylinder(radius: float, length: float, triangles: int) -> Surface:
    """A rod with flat ends: middle of the tip face at the origin, other end at z = length.

    Parameters
    ----------
    radius : float
        [m]
    length : float
        [m]
    triangles : int
        How many, at least 16; met within one ring, 8 k (k + q) with whole k and q.

    Raises
    ------
    InputError
        An argument breaks its rule.

    """
    _positive("cylinder", radius=radius, length=length)
    _count("cylinder", triangles, 16)
    k, q = _divisions(radius, length, triangles)
    cap = np.column_stack([radius * np.arange(k + 1) / k, np.zeros(k + 1)])
    return _turned(cap, length, q, ((0, 0, 0), (0, 0, length)))


def _divisions(cap: float, wall: float, triangles: int) -> tuple[int, int]:
    """Rings k of a cap and rings q of the wall: near 8 k (k + q) triangles, as equilateral as that allows.

    `cap` and `wall` are the lengths of the profile on each [m].
    """
    best = (np.inf, 1, 0)
    least = 1  # 4 k facets: a rod is round first, its triangles equilateral second
    while least < 4 and 8 * (least + 1) * (least + 1 + (wall > 0)) <= triangles:
        least += 1
    for k in range(least, int(np.sqrt(triangles / 8)) + 2):
        q = max(1, round(triangles / (8 * k) - k)) if wall > 0 else 0
        skew = abs(np.log(cap / k * q / wall)) if wall > 0 else 0.0
        best = min(best, (20 * abs(8 * k * (k + q) / triangles - 1) + skew, k, q))
    return best[1], best[2]


def _turned(cap: FloatArray, length: float, q: int, axis: Sequence[Sequence[float]]) -> Surface:
    """A body of revolution about z from the profile (radius, z) of its tip's cap and the cap's mirror.

    Ring j of a cap has 4 j vertices, so triangles keep their size toward the pole.
    """
    k = len(cap) - 1
    radius = cap[-1, 0]
    wall = [(4 * k, radius, z) for z in np.linspace(cap[-1, 1], length - cap[-1, 1], q + 1)[1:-1]]
    tip = [(max(1, 4 * j), r, z) for j, (r, z) in enumerate(cap)]
    end = [(n, r, length - z) for n, r, z in reversed(tip)]
    rings = tip + wall + (end if q else end[1:])
    vertices, first = [], [0]
    for n, r, z in rings:
        angle = 2 * np.pi * np.arange(n) / n + np.pi / (4 * k)
        vertices.append(np.column_stack([r * np.cos(angle), r * np.sin(angle), np.full(n, z)]))
        first.append(first[-1] + n)
    triangles: list[tuple[int, int, int]] = []
    for j in range(len(rings) - 1):
        triangles += _band(rings[j][0], first[j], rings[j + 1][0], first[j + 1])
    return Surface(np.concatenate(vertices), np.array(triangles), axes=np.array([axis], np.float64))


def _band(n: int, low: int, m: int, high: int) -> list[tuple[int, int, int]]:
    """Triangles from a ring of n vertices, numbered from `low`, up to one of m from `high`, by quarters."""
    if n == 1:
        return [(low, high + (i + 1) % m, high + i) for i in range(m)]
    if m == 1:
        return [(low + i, low + (i + 1) % n, high) for i in range(n)]
    found = []
    for sector, i in product(range(4), range(max(n, m) // 4)):
        a, b = sector * (n // 4), sector * (m // 4)
        if i < n // 4:
            found.append((low + (a + i) % n, low + (a + i + 1) % n, high + (b + i + (n <= m)) % m))
        if i < m // 4:
            found.append((low + (a + i + (n > m)) % n, high + (b + i + 1) % m, high + (b + i) % m))
    return found


def box(size: float | Sequence[float], triangles: int = 12) -> Surface:
    """A box: middle of the tip face at the origin, other face at z = size[2].

    Parameters
    ----------
    size : float or three floats
        Side lengths along x, y, z [m].
    triangles : int
        How many, at least 12; the nearest 4 (ab + bc + ca) that keeps the faces' cells nearly square.

    Raises
    ------
    InputError
        An argument breaks its rule.

    """
    lengths = _size("box", size, 3)
    _count("box", triangles, 12)
    steps = np.sqrt(4 * (lengths.prod() / lengths).sum() / triangles) * np.linspace(0.7, 1.6, 181)
    divisions = np.maximum(1, np.rint(lengths / steps[:, None])).astype(int)
    counts = 4 * (divisions.prod(axis=1, keepdims=True) // divisions).sum(axis=1)
    n = divisions[np.argmin(np.abs(counts - triangles))]
    index: dict[tuple[int, ...], int] = {}
    found = []
    for normal, side in product(range(3), (0, 1)):
        u, v = (normal + 1) % 3, (normal + 2) % 3
        for i, j in product(range(n[u]), range(n[v])):
            corner = []
            for di, dj in ((0, 0), (1, 0), (1, 1), (0, 1)):
                place = [0, 0, 0]
                place[normal], place[u], place[v] = int(side * n[normal]), i + di, j + dj
                corner.append(index.setdefault(tuple(place), len(index)))
            a, b, c, d = corner if side else corner[::-1]
            found += [(a, b, c), (a, c, d)]
    vertices = (np.array(list(index)) / n - (0.5, 0.5, 0)) * lengths
    return Surface(vertices, np.array(found), axes=np.array([[(0, 0, 0), (0, 0, lengths[2])]]))


def _moved(surface: Surface, rotation: FloatArray, shift: Sequence[float]) -> Surface:
    assert surface.axes is not None
    vertices, axes = surface.vertices @ rotation.T + shift, surface.axes @ rotation.T + shift
    return Surface(vertices, surface.triangles, surface.part, axes)


def _joined(parts: Sequence[Surface]) -> Surface:
    """One instrument of several convex parts, numbered in the order given."""
    first = np.cumsum([0] + [len(p.vertices) for p in parts])
    return Surface(
        np.concatenate([p.vertices for p in parts]),
        np.concatenate([p.triangles + n for p, n in zip(parts, first, strict=False)]),
        np.concatenate([np.full(len(p.triangles), i) for i, p in enumerate(parts)]),
        np.concatenate([p.axes for p in parts if p.axes is not None]),
    )


def grasper(radius: float, length: float, jaw_length: float, opening: float = 0.0, triangles: int = 300) -> Surface:
    """A grasper of three convex parts: jaw toward +x (0), jaw toward −x (1), round shaft (2).

    The jaws are boxes as wide and together as thick as an inscribed square of the shaft; closed, they leave a
    gap of 2 % of their width, and they turn about y at the end of the shaft. The tips lie at z = 0.

    Parameters
    ----------
    radius : float
        Of the shaft [m].
    length : float
        Of jaws (closed) and shaft together [m].
    jaw_length : float
        [m], less than `length`.
    opening : float
        Angle between the jaws [rad], 0 to 3.
    triangles : int
        How many, at least 48, a third for each part; met as by `box` and `cylinder`.

    Raises
    ------
    InputError
        An argument breaks its rule.

    """
    _positive("grasper", radius=radius, length=length, jaw_length=jaw_length)
    _count("grasper", triangles, 48)
    place, rule = "grasper, jaw_length", "must be less than length"
    _require(jaw_length < length, place, rule, jaw_length, "Give shorter jaws or a longer instrument")
    good = bool(np.isfinite(opening) and 0 <= opening <= 3)
    _require(good, "grasper, opening", "must be an angle from 0 to 3 rad", opening, "Give it in radians")
    width = np.sqrt(2) * radius
    thick = 0.5 * (1 - JAW_GAP) * width
    jaw = box((thick, width, jaw_length), triangles // 3)
    parts = []
    for side in (1, -1):
        c, s = np.cos(opening / 2), side * np.sin(opening / 2)
        swing = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
        hinged = _moved(jaw, np.eye(3), (side * (width - thick) / 2, 0, -jaw_length))  # origin at the hinge
        parts.append(_moved(hinged, swing, (0, 0, 0)))
    parts.append(cylinder(radius, length - jaw_length, triangles // 3))
    low = min(part.vertices[:, 2].min() for part in parts)
    return _moved(_joined(parts), np.eye(3), (0, 0, -low))


def hook(radius: float, length: float, hook_length: float, triangles: int = 300) -> Surface:
    """An L-shaped hook of two capsules: a bar toward +x (part 0) at the foot of a shaft along z (part 1).

    The shaft's lowest point is the origin; both lie on z = 0.

    Parameters
    ----------
    radius : float
        Of both [m].
    length : float
        Of the shaft [m], at least 2 radii.
    hook_length : float
        From the shaft's axis to the end of the bar [m], at least 2 radii.
    triangles : int
        How many, at least 32, shared by length; met as by `capsule`.

    Raises
    ------
    InputError
        An argument breaks its rule.

    """
    _positive("hook", radius=radius, length=length, hook_length=hook_length)
    _count("hook", triangles, 32)
    for name, value in (("length", length), ("hook_length", hook_length)):
        _require(value >= 2 * radius, f"hook, {name}", "must be at least 2 radii", value, "Give a longer one")
    bar_length = hook_length + radius
    share = max(16, round(triangles * bar_length / (bar_length + length)))
    bar = capsule(radius, bar_length, min(share, triangles - 16))
    lying = np.array([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]])  # z of the bar becomes −x
    bar = _moved(bar, lying, (hook_length, 0, radius))
    assert bar.axes is not None
    axes = np.array([[bar.axes[0, 0], (0, 0, radius)]])  # it ends for the handle at the shaft's axis
    bar = Surface(bar.vertices, bar.triangles, bar.part, axes)
    return _joined([bar, capsule(radius, length, triangles - len(bar.triangles))])
