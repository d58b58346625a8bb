"""Generated surfaces: topology, size, shape, triangle quality, frames, and what is refused."""

from collections import Counter

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tissue_contact import geometry, shapes
from tissue_contact.errors import InputError


def euler_characteristic(surface):
    sides = {frozenset((t[i], t[i - 1])) for t in surface.triangles.tolist() for i in range(3)}
    return len(np.unique(surface.triangles)) - len(sides) + len(surface.triangles)


def directed_edges(surface):
    return Counter((t[i], t[(i + 1) % 3]) for t in surface.triangles.tolist() for i in range(3))


def boundary(surface):
    """Directed edges without a partner; each edge must be used once in each direction at most."""
    counts = directed_edges(surface)
    assert set(counts.values()) == {1}
    return [e for e in counts if e[::-1] not in counts]


def smallest_angle(surface):
    """In degrees, by the law of cosines."""
    p = surface.vertices[surface.triangles]
    a, b, c = (np.linalg.norm(p[:, i - 1] - p[:, i - 2], axis=1) for i in range(3))
    cosines = [(y**2 + z**2 - x**2) / (2 * y * z) for x, y, z in ((a, b, c), (b, c, a), (c, a, b))]
    return float(np.degrees(np.arccos(np.max(cosines))))


def valences(surface):
    """Number of edges of every inner vertex."""
    rim = set(np.ravel(boundary(surface)).tolist())
    count = Counter(i for e in directed_edges(surface) for i in e[:1])
    return Counter(n for i, n in count.items() if i not in rim)


def assert_same(one, other):
    assert np.array_equal(one.vertices, other.vertices)
    assert np.array_equal(one.triangles, other.triangles)


def assert_closed(surface, pieces=1):
    assert boundary(surface) == []
    assert euler_characteristic(surface) == 2 * pieces
    assert len(np.unique(surface.triangles)) == len(surface.vertices)
    report = geometry.inspect(surface)
    assert report.watertight and report.outward and report.components == pieces
    assert report.degenerate_triangles == 0


def assert_sheet(surface, lengths):
    """One disc whose rim is the exact rectangle, with vertices at its corners."""
    rim = boundary(surface)
    assert euler_characteristic(surface) == 1
    assert geometry.inspect(surface).components == 1
    ends = Counter(i for e in rim for i in e)
    assert set(ends.values()) == {2}
    x, y = surface.vertices[list(ends), :2].T
    half_x, half_y = lengths[0] / 2, lengths[1] / 2
    assert np.all((np.abs(x) == half_x) | (np.abs(y) == half_y))
    corners = {(float(i), float(j)) for i, j in zip(x, y, strict=True)}
    assert {(i * half_x, j * half_y) for i in (-1, 1) for j in (-1, 1)} <= corners


# --- sheets -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("count", [200, 1000, 3001])
@pytest.mark.parametrize("size", [0.1, (0.1, 0.04)])
def test_patch(size, count, seed):
    surface = shapes.patch(size, count, seed=seed)
    lengths = np.broadcast_to(size, 2)
    assert_sheet(surface, lengths)
    assert abs(len(surface.triangles) - count) <= 0.02 * count
    assert np.all(surface.vertices[:, 2] == 0)
    assert geometry.triangle_normals(surface)[:, 2] == pytest.approx(1)
    assert geometry.triangle_areas(surface).sum() == pytest.approx(lengths.prod())
    assert smallest_angle(surface) > 15
    report = geometry.inspect(surface)
    assert report.edge_longest < 4 * report.edge_shortest


@settings(max_examples=30, deadline=None)
@given(st.floats(0.01, 1), st.floats(0.01, 1), st.integers(2, 400), st.integers(0, 2**32 - 1))
def test_any_patch_covers_its_rectangle_once(length, width, count, seed):
    surface = shapes.patch((length, width), count, seed=seed)
    assert_sheet(surface, (length, width))
    assert geometry.triangle_normals(surface)[:, 2] == pytest.approx(1)
    assert geometry.triangle_areas(surface).sum() == pytest.approx(length * width)
    if max(length, width) < 10 * min(length, width):
        assert abs(len(surface.triangles) - count) <= 2


def test_patch_is_irregular_unless_asked():
    irregular = valences(shapes.patch(0.1, 1000))
    assert irregular[6] < 0.8 * irregular.total()
    assert {5, 7} <= set(irregular)
    surface = shapes.patch(0.1, 1000, irregular=False)
    assert_sheet(surface, (0.1, 0.1))
    regular = valences(surface)
    assert regular[6] == regular.total()
    assert smallest_angle(surface) > 25
    assert abs(len(surface.triangles) - 1000) <= 60


@pytest.mark.parametrize("radius", [0.08, 0.5, -0.08])
@pytest.mark.parametrize("irregular", [True, False])
def test_curved_patch_is_a_paraboloid(radius, irregular):
    surface = shapes.patch((0.1, 0.06), 1000, radius, seed=2, irregular=irregular)
    assert_sheet(surface, (0.1, 0.06))
    x, y, z = surface.vertices.T
    assert z == pytest.approx(-(x**2 + y**2) / (2 * radius), abs=1e-15)
    assert np.all(geometry.triangle_normals(surface)[:, 2] > 0.6)
    assert smallest_angle(surface) > 15


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("opening", "depth"), [(0.015, 0.03), (0.01, 0.06), (0.02, 0.01)])
def test_abdominal_wall(opening, depth, seed):
    surface = shapes.abdominal_wall(0.12, 3000, opening, depth, seed)
    assert_sheet(surface, (0.12, 0.12))
    assert abs(len(surface.triangles) - 3000) <= 60
    assert smallest_angle(surface) > 12
    x, y, z = surface.vertices.T
    distance = np.hypot(x, y)
    flat = distance > 1.3 * opening
    deep = z < -0.3 * opening
    assert np.all(z[flat & ~deep] == 0) and np.all(z <= 0)
    assert z.min() == pytest.approx(-depth, rel=0.03)
    # Its profile: a quarter of a circle round the rim, then the sac, near the top no narrower than the neck.
    fillet = 0.3 * opening
    rim = (distance < 1.3 * opening) & ~deep
    assert rim.sum() > 20
    assert np.hypot(distance - 1.3 * opening, z + fillet)[rim] == pytest.approx(fillet, rel=1e-3)
    angle = np.arcsin(np.clip((-z[deep] - fillet) / (depth - fillet), 0, 1))
    sac = opening * (np.cos(angle) + 0.6 * np.sin(2 * angle) ** 2)
    assert distance[deep] == pytest.approx(sac, rel=1e-2, abs=1e-3 * opening)
    assert 1.25 * opening < distance[deep].max() < 1.37 * opening
    assert distance[deep & (z > -0.3 * opening - 0.2 * (depth - fillet))].min() >= 0.999 * opening
    normals = geometry.triangle_normals(surface)
    middle = surface.vertices[surface.triangles].mean(axis=1)
    on_flat = (np.hypot(*middle[:, :2].T) > 1.5 * opening) & (middle[:, 2] == 0)
    assert normals[on_flat][:, 2] == pytest.approx(1)
    # The outer side of the sac looks to its axis and up.
    wall = (middle[:, 2] < -0.4 * depth) & (middle[:, 2] > -0.6 * depth)
    low = middle[:, 2] < -0.95 * depth
    inward = -middle[:, :2] / np.linalg.norm(middle[:, :2], axis=1)[:, None]
    assert np.all((normals[:, :2] * inward).sum(axis=1)[wall] > 0.3) or depth <= opening
    assert np.all(normals[low][:, 2] > 0.3)
    spread = geometry.triangle_areas(surface)
    assert spread.max() < 8 * np.median(spread)


def test_abdominal_wall_is_smooth():
    """Neighbouring triangles of a fine mesh never meet at a sharp angle."""
    surface = shapes.abdominal_wall(0.08, 12000, 0.015, 0.03)
    normals = geometry.triangle_normals(surface)
    owners = {}
    for t, corners in enumerate(surface.triangles.tolist()):
        for i in range(3):
            owners.setdefault(frozenset((corners[i], corners[i - 1])), []).append(t)
    pairs = np.array([o for o in owners.values() if len(o) == 2])
    cosine = (normals[pairs[:, 0]] * normals[pairs[:, 1]]).sum(axis=1)
    assert np.degrees(np.arccos(cosine.min())) < 35


# --- organs -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("radii", [0.05, (0.06, 0.04, 0.03), (0.1, 0.02, 0.01), (0.1, 0.08, 0.02)])
def test_ellipsoid(radii, seed):
    surface = shapes.ellipsoid(radii, 1000, seed)
    half = np.broadcast_to(radii, 3)
    assert_closed(surface)
    assert len(surface.triangles) == 1000
    assert np.linalg.norm(surface.vertices / half, axis=1) == pytest.approx(1)
    full = 4 / 3 * np.pi * half.prod()
    assert 0.95 * full < geometry.volume(surface) < full
    assert smallest_angle(surface) > 20
    report = geometry.inspect(surface)
    assert report.edge_longest < 6 * report.edge_shortest
    assert valences(surface)[6] < 0.8 * len(surface.vertices)


def test_ellipsoid_converges_to_its_volume():
    full = 4 / 3 * np.pi * 0.06 * 0.04 * 0.03
    lack = [1 - geometry.volume(shapes.ellipsoid((0.06, 0.04, 0.03), n)) / full for n in (250, 1000, 4000)]
    assert np.log(lack[0] / lack[2]) / np.log(16) == pytest.approx(1, abs=0.15)  # one over the number of triangles


@settings(max_examples=15, deadline=None)
@given(st.integers(20, 300), st.integers(0, 2**32 - 1))
def test_any_round_ellipsoid_is_closed(count, seed):
    surface = shapes.ellipsoid((0.05, 0.045, 0.04), count, seed)
    assert_closed(surface)
    assert len(surface.triangles) == count + count % 2


# --- grading ------------------------------------------------------------------------------------------------

GRADED = {
    "patch": (
        lambda **own: shapes.patch((0.06, 0.06), 6000, 0.4, 1, **own),
        [[-0.009, -0.004, -0.01], [0.009, 0.004, 0]],
    ),
    "abdominal_wall": (
        lambda **own: shapes.abdominal_wall((0.06, 0.06), 4500, 0.01, 0.018, 7, **own),
        [[-0.01, -0.01, -0.02], [0.01, 0.01, -0.01]],
    ),
    "ellipsoid": (
        lambda **own: shapes.ellipsoid((0.02, 0.02, 0.005), 2500, 3, **own),
        [[-0.005, -0.005, 0], [0.005, 0.005, 0.01]],
    ),
}


def away_from(surface, box):
    """Distance of the middles of all triangles from a box."""
    middle = surface.vertices[surface.triangles].mean(axis=1)
    return np.linalg.norm(np.maximum(np.maximum(box[0] - middle, middle - box[1]), 0), axis=1)


@pytest.mark.parametrize("growth", [0.1, 0.3, 0.5])
@pytest.mark.parametrize("kind", GRADED)
def test_a_graded_mesh_is_as_fine_as_asked_at_every_distance(kind, growth):
    make, box = GRADED[kind]
    box = np.array(box)
    uniform, surface = make(), make(reach=box.tolist(), growth=growth)
    if kind == "ellipsoid":
        assert_closed(surface)
    else:
        assert_sheet(surface, (0.06, 0.06))
    assert smallest_angle(surface) > 15
    area, distance = geometry.triangle_areas(surface), away_from(surface, box)
    finest = np.median(geometry.triangle_areas(uniform))
    edge = np.sqrt(finest * 4 / np.sqrt(3))
    over = area / (finest * (1 + growth * distance / edge) ** 2)
    far = np.quantile(distance, [0.5, 0.8])
    for near, beyond in ((-1, 0), (0, far[0]), (far[0], far[1]), (far[1], np.inf)):
        # A middle of few triangles: the coarsest ring, at growth 0.5, has some forty.
        assert 0.75 < np.median(over[(distance > near) & (distance <= beyond)]) < 1.35, (near, beyond)
    # as many as the wanted areas fill
    expected = (geometry.triangle_areas(uniform) / finest / (1 + growth * away_from(uniform, box) / edge) ** 2).sum()
    assert len(surface.triangles) == pytest.approx(expected, rel=0.1)
    assert len(surface.triangles) < 0.5 * len(uniform.triangles)


@settings(max_examples=30, deadline=None)
@given(
    st.floats(0.01, 1), st.floats(0.01, 1), st.integers(2, 400), st.integers(0, 2**32 - 1),
    st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(0.01, 0.5),
)  # fmt: skip
def test_any_graded_patch_covers_its_rectangle_once(length, width, count, seed, x, y, growth):
    corner = [[x * length, y * width, 0], [0.5 * length, 0.5 * width, 0]]  # which holds a corner of the patch
    surface = shapes.patch((length, width), count, seed=seed, reach=corner, growth=growth)
    assert_sheet(surface, (length, width))
    assert geometry.triangle_normals(surface)[:, 2] == pytest.approx(1)
    assert geometry.triangle_areas(surface).sum() == pytest.approx(length * width)


@settings(max_examples=60, deadline=None)
@given(st.integers(20, 300), st.integers(0, 2**32 - 1), st.floats(-0.9, 1), st.floats(0.01, 0.5), st.floats(0.2, 1))
@example(20, 0, -0.9, 0.5, 0.2)  # of whose vertices too few are left for a hull
def test_any_graded_ellipsoid_is_closed_or_refused_by_a_rule(count, seed, cut, growth, flatness):
    half = 0.05 * np.array([1.0, 0.8, flatness])
    try:
        surface = shapes.ellipsoid(half, count, seed, reach=[[-1, -1, -1], [cut * half[0], 1, 1]], growth=growth)
    except InputError as error:
        assert error.place in ("ellipsoid, triangles", "ellipsoid, reach")
        return
    assert_closed(surface)


def test_a_reach_around_all_of_it_leaves_the_mesh_alone():
    for make, _ in GRADED.values():
        uniform, graded = make(), make(reach=[[-1, -1, -1], [1, 1, 1]])
        assert np.array_equal(uniform.triangles, graded.triangles)
        assert graded.vertices == pytest.approx(uniform.vertices, abs=1e-12)  # places along the rim only round


# --- the same again -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "make",
    [
        lambda seed: shapes.patch(0.1, 200, seed=seed),
        lambda seed: shapes.ellipsoid(0.05, 200, seed),
        lambda seed: shapes.abdominal_wall(0.12, 400, 0.015, 0.03, seed),
    ],
    ids=["patch", "ellipsoid", "abdominal_wall"],
)
def test_a_seed_is_a_mesh(make):
    assert_same(make(5), make(5))
    assert not np.array_equal(make(5).vertices, make(6).vertices)


# --- instruments --------------------------------------------------------------------------------------------


def assert_instrument(surface, pieces=1):
    assert_closed(surface, pieces)
    assert surface.vertices[:, 2].min() == pytest.approx(0, abs=1e-15)
    assert surface.axes.shape == (pieces, 2, 3)
    assert surface.part.tolist() == sorted(surface.part.tolist())
    assert set(surface.part.tolist()) == set(range(pieces))
    for p in range(pieces):
        corners = surface.vertices[surface.triangles[surface.part == p]]
        points, normals = corners.reshape(-1, 3), geometry.triangle_normals(surface)[surface.part == p]
        above = points @ normals.T - (corners[:, 0] * normals).sum(axis=1)
        assert above.max() <= 1e-6 * np.ptp(points, axis=0).max()  # convex: nothing lies above a triangle
        tip, end = surface.axes[p]
        inside = (normals @ np.array([tip, end]).T) - (corners[:, 0] * normals).sum(axis=1)[:, None]
        assert inside.max() <= 1e-9  # the axis lies within its part


@settings(max_examples=20, deadline=None)
@given(st.floats(0.001, 0.02), st.floats(2, 100), st.integers(16, 1000))
def test_rods(radius, slenderness, count):
    length = slenderness * radius
    for make, full in (
        (shapes.capsule, np.pi * radius**2 * (length - 2 * radius / 3)),
        (shapes.cylinder, np.pi * radius**2 * length),
    ):
        surface = make(radius, length, count)
        assert_instrument(surface)
        assert np.ptp(surface.vertices[:, 2]) == pytest.approx(length)
        away = np.hypot(*surface.vertices[:, :2].T)
        assert away.max() == pytest.approx(radius)
        assert surface.vertices[0] == pytest.approx([0, 0, 0], abs=1e-15)
        if count >= 160:
            assert 0.85 * full < geometry.volume(surface) < full
            assert abs(len(surface.triangles) - count) <= 4 * np.sqrt(count) + 8


def test_capsule_hardly_longer_than_a_sphere():
    assert_instrument(shapes.capsule(0.01, 0.02 * (1 + 1e-12), 200))


def test_capsule_is_round_at_both_ends():
    surface = shapes.capsule(0.005, 0.05, 1000)
    middle = np.column_stack([np.zeros((len(surface.vertices), 2)), np.clip(surface.vertices[:, 2], 0.005, 0.045)])
    assert np.linalg.norm(surface.vertices - middle, axis=1) == pytest.approx(0.005)
    assert surface.axes.tolist() == [[[0, 0, 0.005], [0, 0, 0.05]]]
    assert smallest_angle(surface) > 30


@pytest.mark.parametrize(("count", "met"), [(8, 8), (30, 32), (200, 200), (1000, 968)])
def test_sphere(count, met):
    surface = shapes.sphere(0.01, count)
    assert_instrument(surface)
    assert len(surface.triangles) == met
    assert np.linalg.norm(surface.vertices - (0, 0, 0.01), axis=1) == pytest.approx(0.01)
    assert smallest_angle(surface) > 35


@pytest.mark.parametrize("count", [12, 50, 200, 1000, 2000])
@pytest.mark.parametrize("size", [0.01, (0.01, 0.02, 0.03), (0.002, 0.05, 0.1)])
def test_box(size, count):
    surface = shapes.box(size, count)
    lengths = np.broadcast_to(size, 3)
    assert_instrument(surface)
    assert geometry.volume(surface) == pytest.approx(lengths.prod())
    assert geometry.triangle_areas(surface).sum() == pytest.approx(2 * (lengths.prod() / lengths).sum())
    assert surface.vertices.min(axis=0) == pytest.approx([-lengths[0] / 2, -lengths[1] / 2, 0])
    assert surface.axes == pytest.approx(np.array([[[0, 0, 0], [0, 0, lengths[2]]]]))
    if count == 12:
        assert len(surface.triangles) == 12 or size == (0.002, 0.05, 0.1)
    if count >= 1000:
        assert abs(len(surface.triangles) - count) <= 0.1 * count


@pytest.mark.parametrize("opening", [0.0, 0.4, 1.5])
def test_grasper(opening):
    surface = shapes.grasper(0.0025, 0.1, 0.015, opening)
    assert_instrument(surface, 3)
    assert abs(len(surface.triangles) - 300) < 60
    tips = surface.axes[:, 0]
    reach = 2 * 0.015 * np.sin(opening / 2)
    width = np.sqrt(2) * 0.0025
    assert tips[0, 0] - tips[1, 0] == pytest.approx(reach + 0.51 * width * np.cos(opening / 2), rel=1e-9)
    assert tips[0] == pytest.approx(tips[1] * (-1, 1, 1))
    assert np.linalg.norm(surface.axes[:2, 1] - surface.axes[:2, 0], axis=1) == pytest.approx(0.015)
    assert surface.axes[2, 1, 2] - surface.axes[2, 0, 2] == pytest.approx(0.085)
    if opening == 0:
        assert surface.vertices[:, 2].max() == pytest.approx(0.1)
    jaws = [surface.vertices[surface.triangles[surface.part == p]].reshape(-1, 3) for p in (0, 1)]
    assert jaws[0][:, 0].min() > 0 > jaws[1][:, 0].max()  # the jaws never touch


def test_hook():
    surface = shapes.hook(0.0025, 0.1, 0.015)
    assert_instrument(surface, 2)
    assert abs(len(surface.triangles) - 300) < 40
    assert surface.axes == pytest.approx(
        np.array([[[0.0125, 0, 0.0025], [0, 0, 0.0025]], [[0, 0, 0.0025], [0, 0, 0.1]]]), abs=1e-15
    )
    assert surface.vertices[:, 0].max() == pytest.approx(0.015)
    assert surface.vertices[:, 0].min() == pytest.approx(-0.0025)
    assert surface.vertices[:, 2].max() == pytest.approx(0.1)


# --- refusals -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: shapes.patch(-0.1, 100), "patch, size: must be 1 or 2 positive lengths"),
        (lambda: shapes.patch((0.1, 0.1, 0.1), 100), "patch, size"),
        (lambda: shapes.patch(0.1, 1), "patch, triangles: .*at least 2; found 1"),
        (lambda: shapes.patch(0.1, 10.5), "patch, triangles"),
        (lambda: shapes.patch(0.1, 100, 0.05), r"curvature_radius: .*\(0.07071 m\)"),
        (lambda: shapes.patch(0.1, 100, float("nan")), "curvature_radius"),
        (lambda: shapes.patch(0.1, 100, reach=[[0, 0], [1, 1]]), "patch, reach: .*corner of a box.*x, y, z"),
        (lambda: shapes.patch(0.1, 100, reach=[[1, 0, 0], [0, 1, 0]]), "patch, reach: .*corner of a box"),
        (
            lambda: shapes.patch(0.1, 100, reach=[[0, 0, 1], [1, 1, 2]]),
            r"patch, reach: .*hold at least one vertex of the surface.*\[-0.05, -0.05, 0\]",
        ),
        (lambda: shapes.patch(0.1, 100, reach=[[0, 0, 0], [1, 1, 1]], growth=0.6), "growth: .*at most 0.5; found 0.6"),
        (lambda: shapes.patch(0.1, 100, reach=[[0, 0, 0], [1, 1, 1]], irregular=False), "patch, reach: .*left out"),
        (lambda: shapes.ellipsoid((0.1, 0.1), 100), "ellipsoid, size|ellipsoid, radii"),
        (lambda: shapes.ellipsoid(0.1, 19), "ellipsoid, triangles: .*at least 20"),
        (lambda: shapes.ellipsoid((1, 1, 0.01), 100), "ellipsoid, radii: .*20 times"),
        (lambda: shapes.ellipsoid((0.1, 0.02, 0.01), 40), "half the ellipsoid's volume.*more triangles"),
        # a vertex falls out of the hull
        (lambda: shapes.ellipsoid((0.0054463, 0.0077810, 0.0021285), 20), "half the ellipsoid's volume"),
        (lambda: shapes.abdominal_wall(0.1, 50, 0.01, 0.02), "abdominal_wall, triangles"),
        (lambda: shapes.abdominal_wall(0.1, 500, 0.04, 0.04), "abdominal_wall, opening_radius: .*2.8 times"),
        (lambda: shapes.abdominal_wall(0.1, 500, 0.01, 0.07), "abdominal_wall, sac_depth: .*0.5 to 6"),
        (lambda: shapes.abdominal_wall(0.1, 500, 0.01, float("nan")), "abdominal_wall, sac_depth"),
        (lambda: shapes.capsule(0.01, 0.019, 100), "capsule, length: .*2 radii"),
        (lambda: shapes.capsule(float("inf"), 1, 100), "capsule, radius"),
        (lambda: shapes.sphere(0, 100), "sphere, radius"),
        (lambda: shapes.cylinder(0.01, 0.1, 15), "cylinder, triangles: .*at least 16"),
        (lambda: shapes.box((1, 2), 12), "box, size: must be 1 or 3"),
        (lambda: shapes.box(1, 11), "box, triangles"),
        (lambda: shapes.grasper(0.01, 0.1, 0.1), "grasper, jaw_length: must be less than length"),
        (lambda: shapes.grasper(0.01, 0.1, 0.01, 4), "grasper, opening: .*3 rad"),
        (lambda: shapes.grasper(0.01, 0.1, 0.01, 0, 40), "grasper, triangles"),
        (lambda: shapes.hook(0.01, 0.1, 0.01), "hook, hook_length: .*2 radii"),
        (lambda: shapes.hook(0.01, 0.1, 0.05, 31), "hook, triangles"),
    ],
)
def test_wrong_arguments_are_refused(make, message):
    with pytest.raises(InputError, match=message) as caught:
        make()
    assert caught.value.way_out
