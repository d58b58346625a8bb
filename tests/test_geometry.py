"""Meshes: what the report says, what repair does and does not do, what is refused and how it is said."""

from collections import Counter, defaultdict
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tissue_contact import geometry, shapes
from tissue_contact.errors import InputError
from tissue_contact.geometry import Surface

MESHES = Path(__file__).parents[1].parent / "shared" / "meshes"

# --- independent counting: tuples, dictionaries and loops ---------------------------------------------------


def merged(surface):
    """Triangles by the coordinates of their corners, the way a reader of the file sees them."""
    return [tuple(tuple(p) for p in corners) for corners in surface.vertices[surface.triangles].tolist()]


def directed_edges(corners):
    return [(c[i], c[(i + 1) % 3]) for c in corners for i in range(3)]


def edge_counts(corners):
    return Counter(frozenset(e) for e in directed_edges(corners) if e[0] != e[1])


def count_components(corners):
    """Flood over edges that exactly two triangles share."""
    owners = defaultdict(list)
    for t, c in enumerate(corners):
        for i in range(3):
            owners[frozenset((c[i], c[(i + 1) % 3]))].append(t)
    next_to = defaultdict(set)
    for ts in owners.values():
        if len(ts) == 2:
            next_to[ts[0]].add(ts[1])
            next_to[ts[1]].add(ts[0])
    seen, count = set(), 0
    for start in range(len(corners)):
        if start in seen:
            continue
        count += 1
        todo = [start]
        while todo:
            t = todo.pop()
            if t not in seen:
                seen.add(t)
                todo += next_to[t]
    return count


def heron_height(c):
    """Height over the longest side from the side lengths alone, by Kahan's stable form of Heron's formula."""
    low, mid, high = sorted(float(np.linalg.norm(np.subtract(c[i], c[i - 1]))) for i in range(3))
    s = (high + (mid + low)) * (low - (high - mid)) * (low + (high - mid)) * (high + (mid - low))
    return 0.5 * np.sqrt(max(s, 0)) / high if high else 0.0


def divergence_volume(surface):
    """∮ x n_x dA, another closed form than the module's."""
    a, b, c = (surface.vertices[surface.triangles[:, i]] for i in range(3))
    return float((np.cross(b - a, c - a)[:, 0] / 2 * (a + b + c)[:, 0] / 3).sum())


def tetrahedron(**kwargs):
    return Surface(
        np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]]) * 0.1,
        np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]),
        **kwargs,
    )


def soup(surface):
    """The same surface with vertices of its own for every triangle, as an STL file stores it."""
    n = len(surface.triangles)
    return Surface(surface.vertices[surface.triangles].reshape(-1, 3), np.arange(3 * n).reshape(n, 3))


def write_obj(path, vertices, triangles):
    rows = [f"v {x!r} {y!r} {z!r}" for x, y, z in np.asarray(vertices, float).tolist()]
    rows += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in np.asarray(triangles).tolist()]
    path.write_text("\n".join(rows) + "\n")
    return path


def repaired(surface):
    mended, repairs = geometry.repair(surface)
    return mended, {r.what: r.count for r in repairs}


# --- the measured meshes ------------------------------------------------------------------------------------

# Triangles, vertices when merged, boundary, non-manifold, degenerate, duplicate, components, winding right.
FACTS = {
    "openhelp_Kidney_left.stl": (6570, 3287, 0, 0, 0, 0, 1, True),
    "lapgym_gallbladder_collision.stl": (500, 252, 0, 0, 0, 0, 1, True),
    "lapgym_gallbladder_visual.stl": (14700, 7352, 0, 0, 0, 0, 1, True),
    "sofa_liver-smooth.obj": (4384, 2194, 0, 0, 0, 0, 1, True),
    "lapgym_liver_collision.stl": (479, 279, 31, 2, 153, 3, 25, False),
    "lapgym_gripper_15deg_collision.stl": (193, 105, 19, 6, 0, 0, 7, True),
}


def shared(name):
    path = MESHES / name
    if not path.is_file():
        pytest.skip(f"{name} is not in shared/meshes beside the checkout")
    return path


@pytest.mark.shared_meshes
@pytest.mark.parametrize("name", FACTS)
def test_report_on_measured_meshes(name):
    surface = geometry.read(shared(name))
    report = geometry.inspect(surface)
    triangles, vertices, boundary, nonmanifold, degenerate, duplicate, pieces, wound = FACTS[name]
    assert report.triangles == triangles
    assert report.vertices - report.duplicate_vertices == vertices
    assert report.boundary_edges == boundary
    assert report.nonmanifold_edges == nonmanifold
    assert report.degenerate_triangles == degenerate
    assert report.duplicate_triangles == duplicate
    assert report.components == pieces
    assert report.winding_consistent == wound
    assert report.watertight == (boundary == 0 and nonmanifold == 0)

    corners = merged(surface)
    counts = Counter(edge_counts(corners).values())
    assert len({p for c in corners for p in c}) == vertices
    assert counts[1] == boundary
    assert sum(n for used, n in counts.items() if used > 2) == nonmanifold
    points = np.array(corners).reshape(-1, 3)
    size = (points.max(axis=0) - points.min(axis=0)).max()
    assert sum(heron_height(c) <= 1e-6 * size for c in corners) == degenerate
    assert len(corners) - len({frozenset(c) for c in corners}) == duplicate
    assert count_components(corners) == pieces
    again = Counter(directed_edges(corners))
    shared_by_two = {e for e, n in edge_counts(corners).items() if n == 2}
    assert all(n == 1 for e, n in again.items() if frozenset(e) in shared_by_two) == wound
    assert report.extent == pytest.approx(size, rel=1e-12)
    if report.watertight:
        assert report.volume == pytest.approx(divergence_volume(surface), rel=1e-9)
        assert report.outward


@pytest.mark.shared_meshes
@pytest.mark.parametrize("name", [n for n, f in FACTS.items() if f[2] == 0])
def test_sound_meshes_are_only_merged(name):
    raw = geometry.read(shared(name), 0.001)
    surface, report, repairs = geometry.load(shared(name), scale=0.001)
    assert {r.what for r in repairs} <= {"equal vertices merged"}
    assert merged(surface) == merged(raw)
    assert (report.vertices, report.duplicate_vertices) == (FACTS[name][1], 0)


@pytest.mark.shared_meshes
def test_ugly_liver_becomes_one_closed_body():
    raw = geometry.read(shared("lapgym_liver_collision.stl"), 0.001)
    surface, report, repairs = geometry.load(shared("lapgym_liver_collision.stl"), scale=0.001)
    assert [(r.what, r.count) for r in repairs] == [
        ("equal vertices merged", 1158),
        ("vertices nearer than 1e-06 of the extent merged", 401),
        ("triangles without area dropped", 153),
        ("vertices without a triangle dropped", 15),
    ]
    assert (report.triangles, report.vertices, report.components) == (326, 165, 1)
    assert report.watertight and report.winding_consistent and report.outward
    assert report.area == pytest.approx(geometry.triangle_areas(raw).sum(), rel=1e-9)
    assert divergence_volume(surface) == pytest.approx(divergence_volume(raw), rel=1e-6)


@pytest.mark.shared_meshes
def test_gripper_needs_both_switches():
    path = shared("lapgym_gripper_15deg_collision.stl")
    with pytest.raises(InputError, match=r"share an edge; found 6 edges.*open_surface = true"):
        geometry.load(path, purpose="instrument")
    with pytest.raises(InputError, match=r"one piece; found 7 components.*many_parts = true"):
        geometry.load(path, purpose="instrument", open_surface=True)
    surface, report, _ = geometry.load(path, purpose="instrument", open_surface=True, many_parts=True)
    assert report.triangles == 193
    assert sorted(set(surface.part.tolist())) == [0, 1, 2]
    for one, other in ((0, 1), (0, 2), (1, 2)):
        corners = [set(surface.triangles[surface.part == p].ravel().tolist()) for p in (one, other)]
        assert not corners[0] & corners[1]
    with pytest.raises(InputError, match="at most two triangles of a tissue"):
        geometry.load(path, open_surface=True, many_parts=True)


# --- measures and topology ----------------------------------------------------------------------------------


def test_surface_converts_and_checks():
    surface = Surface(np.asfortranarray(np.eye(3, dtype=np.float32)), np.array([[0, 1, 2]], np.int64))
    assert surface.vertices.dtype == np.float64 and surface.vertices.flags.c_contiguous
    assert surface.triangles.dtype == np.int32 and surface.part.dtype == np.int32
    assert surface.part.tolist() == [0] and surface.axes is None
    with pytest.raises(ValueError, match="part"):
        Surface(np.eye(3), np.array([[0, 1, 2]]), np.array([0, 0]))
    with pytest.raises(ValueError, match="axes"):
        Surface(np.eye(3), np.array([[0, 1, 2]]), np.array([1]), np.zeros((1, 2, 3)))
    with pytest.raises(ValueError, match="triangles"):
        Surface(np.eye(3), np.array([0, 1, 2]))


def test_measures_of_a_tetrahedron():
    surface = tetrahedron()
    assert geometry.triangle_areas(surface) == pytest.approx([0.005, 0.005, 0.005 * np.sqrt(3), 0.005])
    assert geometry.triangle_normals(surface)[2] == pytest.approx(np.full(3, 1 / np.sqrt(3)))
    assert geometry.triangle_normals(surface)[0] == pytest.approx([0, 0, -1])
    assert geometry.volume(surface) == pytest.approx(1e-3 / 6)
    flat = Surface([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]])
    assert geometry.triangle_normals(flat).tolist() == [[0, 0, 0]]


@pytest.mark.parametrize(
    "surface",
    [
        shapes.patch(0.1, 150, seed=3),
        shapes.ellipsoid(0.05, 120, seed=1),
        shapes.grasper(0.003, 0.1, 0.01, 0.3),
    ],
    ids=["patch", "ellipsoid", "grasper"],
)
def test_edges_flaps_and_boundary_by_brute_force(surface):
    owners = defaultdict(list)
    for a, b, c in surface.triangles.tolist():
        for i, j, opposite in ((a, b, c), (b, c, a), (c, a, b)):
            owners[min(i, j), max(i, j)].append(opposite)
    rows = geometry.edges(surface)
    assert rows.dtype == np.int32 and rows.flags.c_contiguous
    assert [tuple(e) for e in rows.tolist()] == sorted(owners)
    opposite = geometry.flaps(surface)
    assert opposite.dtype == np.int32 and opposite.flags.c_contiguous
    expected = [sorted(owners[e]) for e in sorted(owners) if len(owners[e]) == 2]
    assert [sorted(f) for f in opposite.tolist()] == expected
    rim = sorted({i for e, o in owners.items() if len(o) == 1 for i in e})
    assert geometry.boundary_vertices(surface).tolist() == rim


def test_flaps_leave_out_nonmanifold_edges():
    book = Surface([[0, 0, 0], [0, 0, 1], [1, 0, 0], [0, 1, 0], [-1, 0, 0]], [[0, 1, 2], [0, 1, 3], [0, 1, 4]])
    assert geometry.flaps(book).shape == (0, 2)
    report = geometry.inspect(book)
    assert (report.nonmanifold_edges, report.boundary_edges, report.components) == (1, 6, 3)


def test_a_nonmanifold_edge_is_no_boundary():
    """Two tetrahedra that share an edge, which thereby has four triangles."""
    one = tetrahedron()
    both = Surface(
        np.concatenate([one.vertices, -one.vertices[2:]]),
        np.concatenate([one.triangles, np.where(one.triangles > 1, one.triangles + 2, one.triangles)]),
    )
    assert geometry.boundary_vertices(both).tolist() == []
    report = geometry.inspect(both)
    assert (report.nonmanifold_edges, report.boundary_edges, report.components) == (1, 0, 2)
    assert not report.watertight and report.volume is None and report.outward is None


def test_bodies_that_touch_in_a_vertex_are_apart():
    one = tetrahedron()
    both = Surface(
        np.concatenate([one.vertices, -one.vertices[1:]]),
        np.concatenate([one.triangles, np.where(one.triangles > 0, one.triangles + 3, 0)[:, ::-1]]),
    )
    report = geometry.inspect(both)
    assert report.components == 2 and report.watertight and report.outward


# --- repair -------------------------------------------------------------------------------------------------


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0, 0.9))
def test_repair_restores_a_shuffled_soup(seed, share):
    """Vertices torn apart within the tolerance, triangles shuffled and turned at random, copies added."""
    rng = np.random.default_rng(seed)
    whole = shapes.ellipsoid((0.05, 0.04, 0.03), 80, seed=seed % 7)
    torn = soup(whole)
    vertices = torn.vertices + rng.uniform(-1, 1, torn.vertices.shape) * 2e-8
    triangles = torn.triangles[rng.permutation(80)]
    turned = rng.random(80) < share
    triangles[turned] = triangles[turned][:, ::-1]
    triangles = np.concatenate([triangles, triangles[:5]])
    mended, done = repaired(Surface(vertices, triangles))
    report = geometry.inspect(mended)
    assert (report.triangles, report.vertices) == (80, len(whole.vertices))
    assert report.watertight and report.winding_consistent and report.outward
    assert report.volume == pytest.approx(geometry.volume(whole), rel=1e-5)
    assert report.area == pytest.approx(geometry.triangle_areas(whole).sum(), rel=1e-5)
    assert done["duplicate triangles dropped"] == 5
    assert done.get("triangles turned to a consistent, outward winding", 0) == turned.sum()


def test_repair_of_a_sound_mesh_does_nothing():
    surface = shapes.grasper(0.003, 0.1, 0.01, 0.3)
    mended, done = repaired(surface)
    assert done == {}
    assert np.array_equal(mended.vertices, surface.vertices)
    assert np.array_equal(mended.triangles, surface.triangles)
    assert np.array_equal(mended.part, surface.part) and mended.axes is surface.axes


def test_repair_keeps_part_in_step():
    surface = shapes.grasper(0.003, 0.1, 0.01, 0.3)
    where = dict(zip(merged(surface), surface.part.tolist(), strict=True))
    order = np.random.default_rng(1).permutation(len(surface.triangles))
    triangles = np.concatenate([[[0, 0, 1]], surface.triangles[order[:9]], surface.triangles[order]])
    part = np.concatenate([[2], surface.part[order[:9]], surface.part[order]])
    mended, _ = repaired(Surface(surface.vertices, triangles, part, surface.axes))
    assert dict(zip(merged(mended), mended.part.tolist(), strict=True)) == where


def test_repair_merges_minus_zero_and_keeps_the_first():
    surface = Surface(
        [[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [-0.0, 0, 0], [1, 1e-8, 0], [1, -1, 0]], [[0, 1, 2], [4, 3, 5]]
    )
    mended, done = repaired(surface)
    assert done == {"equal vertices merged": 1, "vertices nearer than 1e-06 of the extent merged": 1}
    assert mended.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, -1, 0]]


def test_flat_triangles_are_swapped_without_opening_a_hole():
    """A tetrahedron whose edge 0-1 carries extra vertices on one side only, bridged by flat triangles."""
    corner = tetrahedron()
    vertices = np.concatenate([corner.vertices, [[0.025, 0, 0], [0.05, 0, 0], [0.075, 0, 0]]])
    triangles = [[0, 2, 1], [1, 2, 3], [0, 3, 2]]
    triangles += [[0, 4, 3], [4, 5, 3], [5, 6, 3], [6, 1, 3]]
    triangles += [[0, 1, 6], [0, 6, 5], [0, 5, 4]]
    surface = Surface(vertices, triangles)
    before = geometry.inspect(surface)
    assert before.watertight and before.degenerate_triangles == 3
    mended, done = repaired(surface)
    after = geometry.inspect(mended)
    assert after.watertight and after.degenerate_triangles == 0 and after.winding_consistent
    assert after.triangles == before.triangles
    assert after.volume == pytest.approx(before.volume, rel=1e-12)
    assert after.area == pytest.approx(before.area, rel=1e-12)
    assert set(done) == {"edges of flat triangles swapped"}


def test_flat_triangles_on_the_boundary_are_dropped():
    surface = Surface([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.5, 0, 0]], [[0, 3, 2], [3, 1, 2], [0, 1, 3]])
    mended, done = repaired(surface)
    assert done == {"flat triangles on the boundary dropped": 1}
    assert mended.triangles.tolist() == [[0, 3, 2], [3, 1, 2]]


def test_winding_of_a_sheet_follows_the_larger_area():
    surface = shapes.patch(0.1, 200, seed=1)
    triangles = surface.triangles.copy()
    triangles[::4] = triangles[::4, ::-1]
    mended, done = repaired(Surface(surface.vertices, triangles))
    assert np.array_equal(geometry.triangle_normals(mended)[:, 2] > 0, np.ones(200, bool))
    assert done == {"triangles turned to a consistent, outward winding": 50}


def test_every_closed_piece_is_turned_outward():
    one = tetrahedron()
    both = Surface(
        np.concatenate([one.vertices, one.vertices + 1]),
        np.concatenate([one.triangles, one.triangles[:, ::-1] + 4]),
    )
    mended, done = repaired(both)
    assert done == {"triangles turned to a consistent, outward winding": 4}
    assert geometry.volume(mended) == pytest.approx(2e-3 / 6)


# --- reading ------------------------------------------------------------------------------------------------

ASCII_STL = """solid two
facet normal 0 0 1
 outer loop
  vertex 0 0 0
  vertex 1 0 0
  vertex 0 1 0
 endloop
endfacet
facet normal 0 0 1
 outer loop
  vertex 1 0 0
  vertex 1 1 0
  vertex 0 1 0
 endloop
endfacet
endsolid two
"""
QUAD_OBJ = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n"
QUAD_OFF = "OFF\n4 1 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n"
QUAD_PLY = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 2
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
1 1 0
0 1 0
3 0 1 2
3 2 3 0
"""
PIECES_OBJ = "o b\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\no a\nusemtl z\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 4 5 6\n"


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.stl", ASCII_STL),
        ("a.obj", QUAD_OBJ),
        ("a.off", QUAD_OFF),
        ("a.ply", QUAD_PLY),
        ("pieces.obj", PIECES_OBJ),
        ("A.OBJ", QUAD_OBJ),
    ],
)
def test_reads_every_format(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    surface = geometry.read(tmp_path / name, 0.01)
    assert len(surface.triangles) == 2
    assert geometry.triangle_areas(surface).sum() == pytest.approx(1e-4)
    assert geometry.triangle_normals(surface) == pytest.approx(np.array([[0, 0, 1], [0, 0, 1]]))


def test_reads_binary_stl(tmp_path):
    one = tetrahedron()
    record = np.zeros(4, [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")])
    record["corners"] = one.vertices[one.triangles]
    data = b"\0" * 80 + np.uint32(4).tobytes() + record.tobytes()
    (tmp_path / "a.stl").write_bytes(data)
    _, report, repairs = geometry.load(tmp_path / "a.stl")
    assert (report.triangles, report.vertices) == (4, 4)
    assert [str(r) for r in repairs] == ["equal vertices merged: 8"]
    assert report.volume == pytest.approx(1e-3 / 6)
    (tmp_path / "cut.stl").write_bytes(data[:150])
    with pytest.raises(InputError, match="must be a valid STL"):
        geometry.read(tmp_path / "cut.stl")


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.obj", "", "must not be empty; found 0 bytes"),
        ("a.step", "x", "must be STL, OBJ, PLY or OFF; found .step"),
        ("a.obj", "v 0 0 0\nv 1 0 0\n", "at least one triangle; found none"),
        ("a.stl", "hello world " * 20, "at least one triangle; found none"),
        ("a.ply", "ply\nfoo", "must be a valid PLY"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "must be a valid OBJ"),
        ("a.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n", "must be a valid OFF"),
        ("a.ply", QUAD_PLY.replace("3 0 1 2", "3 0 1 7"), "must name existing vertices; found indices 0..7"),
        ("a.obj", "v 0 0 0\nv 1 nan 0\nv 0 1 0\nf 1 2 3\n", "must be finite; found 1 vertices.*number 1"),
        ("a.off", "OFF\n3 1 0\n0 0 0\n1 inf 0\n0 1 0\n3 0 1 2\n", "must be finite"),
    ],
)
def test_unreadable_files_are_refused(tmp_path, name, content, message):
    (tmp_path / name).write_text(content)
    with pytest.raises(InputError, match=message) as caught:
        geometry.read(tmp_path / name)
    assert caught.value.place == str(tmp_path / name)
    assert caught.value.way_out


def test_missing_file_names_the_nearest(tmp_path):
    (tmp_path / "liver.stl").write_text(ASCII_STL)
    (tmp_path / "kidney.stl").write_text(ASCII_STL)
    (tmp_path / "livre.txt").write_text("")
    with pytest.raises(InputError, match=r"nearest name in that folder is liver\.stl\."):
        geometry.read(tmp_path / "livre.stl")
    with pytest.raises(InputError, match="no folder"):
        geometry.read(tmp_path / "nowhere" / "liver.stl")


@pytest.mark.parametrize("scale", [0.0, -1.0, float("nan"), float("inf")])
def test_scale_must_be_positive(tmp_path, scale):
    (tmp_path / "a.obj").write_text(QUAD_OBJ)
    with pytest.raises(InputError, match="scale must be a positive number"):
        geometry.read(tmp_path / "a.obj", scale)


# --- refusals -----------------------------------------------------------------------------------------------


def test_a_sheet_needs_open_surface(tmp_path):
    sheet = shapes.patch(0.1, 100)
    path = write_obj(tmp_path / "a.obj", sheet.vertices, sheet.triangles)
    with pytest.raises(InputError, match=r"a tissue must be closed; found 28 boundary.*open_surface = true"):
        geometry.load(path)
    surface, report, repairs = geometry.load(path, open_surface=True)
    assert (len(surface.triangles), report.boundary_edges, repairs) == (100, 28, ())
    assert not report.watertight and report.volume is None and report.outward is None


def test_several_pieces_need_many_parts(tmp_path):
    one = tetrahedron()
    vertices, triangles = np.concatenate([one.vertices, one.vertices + 0.3]), one.triangles
    path = write_obj(tmp_path / "a.obj", vertices, np.concatenate([triangles, triangles + 4]))
    with pytest.raises(InputError, match=r"a tissue must be of one piece; found 2 components.*many_parts = true"):
        geometry.load(path)
    assert geometry.load(path, many_parts=True)[0].part.tolist() == [0] * 8
    surface, _, _ = geometry.load(path, many_parts=True, purpose="instrument")
    assert surface.part.tolist() == [0] * 4 + [1] * 4


def test_a_one_sided_surface_is_refused(tmp_path):
    n = 12
    turn = 2 * np.pi * np.arange(n) / n
    rows = []
    for side in (-0.02, 0.02):
        r = 0.1 + side * np.cos(turn / 2)
        rows.append(np.column_stack([r * np.cos(turn), r * np.sin(turn), side * np.sin(turn / 2)]))
    triangles = []
    for i in range(n):
        j, cross = (i + 1) % n, i == n - 1
        low, high = (j + n, j) if cross else (j, j + n)
        triangles += [(i, low, high), (i, high, i + n)]
    path = write_obj(tmp_path / "a.obj", np.concatenate(rows), triangles)
    with pytest.raises(InputError, match="inner and an outer side; found a one-sided surface"):
        geometry.load(path, open_surface=True)


def test_nonmanifold_tissue_is_refused_whatever_the_switches(tmp_path):
    vertices = np.array([[0, 0, 0], [0, 0, 1], [1, 0, 0], [0, 1, 0], [-1, 0, 0]]) * 0.1
    path = write_obj(tmp_path / "a.obj", vertices, [[0, 1, 2], [0, 1, 3], [0, 1, 4]])
    with pytest.raises(InputError, match=r"at most two triangles of a tissue may share an edge; found 1 edges"):
        geometry.load(path, open_surface=True, many_parts=True)
    surface, _, _ = geometry.load(path, open_surface=True, many_parts=True, purpose="instrument")
    assert surface.part.tolist() == [0, 0, 0]


def test_only_flat_triangles_are_refused(tmp_path):
    path = write_obj(tmp_path / "a.obj", [[0, 0, 0], [0.1, 0, 0], [0.05, 0, 0]], [[0, 1, 2]])
    with pytest.raises(InputError, match="must have a triangle with an area; found flat triangles"):
        geometry.load(path, open_surface=True)


@pytest.mark.parametrize(
    ("size", "scale", "advice"),
    [
        (100.0, 1.0, "found 100 m with scale = 1.*: scale = 0.001 \\(0.1 m\\) or scale = 0.01 \\(1 m\\)"),
        (200.0, 1.0, ": scale = 0.001 \\(0.2 m\\)\\."),
        (0.1, 0.001, "found 0.0001 m with scale = 0.001.*: scale = 1 \\(0.1 m\\)"),
        (3e9, 1.0, ": scale = 1e-12 \\(0.003 m\\)"),
        (3e-8, 1.0, ": scale = 1e\\+06 \\(0.03 m\\)"),
    ],
)
def test_scale_advice(tmp_path, size, scale, advice):
    one = tetrahedron()
    path = write_obj(tmp_path / "a.obj", one.vertices * 10 * size, one.triangles)
    with pytest.raises(InputError, match=advice):
        geometry.load(path, scale=scale)


@settings(max_examples=50, deadline=None)
@given(st.floats(-12, 12))
def test_scale_advice_always_fits(power):
    one = tetrahedron()
    report = geometry.inspect(Surface(one.vertices * 10 * 10**power, one.triangles))
    try:
        geometry.check_scale(report, "organ")
    except InputError as error:
        first = float(error.way_out.split("scale = ")[1].split()[0])
        assert 0.999e-3 <= report.extent * first <= 1.001
    else:
        assert -3.001 <= power <= 0.001


# --- the oriented box ---------------------------------------------------------------------------------------


def check_box(points, centre, axes, half):
    assert axes @ axes.T == pytest.approx(np.eye(3), abs=1e-9)
    assert np.linalg.det(axes) == pytest.approx(1)
    away = np.abs((points - centre) @ axes.T) - half
    size = np.ptp(points, axis=0).max()
    assert away.max() <= 1e-9 * size  # inside
    assert np.abs(away.max(axis=0)).max() <= 1e-9 * size  # and touched on every axis


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_box_of_a_turned_box_is_found(seed):
    """Hypothesis prints the seed of a failure."""
    rng = np.random.default_rng(seed)
    size = rng.uniform(0.005, 0.1, 3)
    rotation = Rotation.random(rng=rng).as_matrix()
    shift = rng.normal(size=3)
    inside = rng.uniform(-0.5, 0.5, (50, 3)) * size
    points = np.concatenate([shapes.box(size, 100).vertices - (0, 0, size[2] / 2), inside]) @ rotation.T + shift
    centre, axes, half = geometry.oriented_box(points)
    check_box(points, centre, axes, half)
    assert sorted(half) == pytest.approx(sorted(size / 2), rel=1e-6)
    assert centre == pytest.approx(shift, abs=1e-7)
    alike = np.abs(axes @ rotation)  # a permutation, whatever the names
    assert np.sort(alike.ravel())[:6].max() < 1e-5
    for a, b, c in zip(geometry.oriented_box(points), (centre, axes, half), (0, 1, 2), strict=True):
        assert np.array_equal(a, b), c


@pytest.mark.parametrize("turn", [0.0, 0.2, 1.2, -2.0])
def test_box_axes_are_named_nearest_to_the_frame(turn):
    size = np.array([0.03, 0.02, 0.01])
    rotation = Rotation.from_euler("z", turn).as_matrix()
    _, axes, half = geometry.oriented_box(shapes.box(size).vertices @ rotation.T)
    quarter = (turn + np.pi / 4) % (np.pi / 2) - np.pi / 4
    assert axes[0] == pytest.approx([np.cos(quarter), np.sin(quarter), 0], abs=1e-9)
    assert axes[2] == pytest.approx([0, 0, 1], abs=1e-9)
    swapped = round((turn - quarter) / (np.pi / 2)) % 2
    assert half == pytest.approx((size[[1, 0, 2]] if swapped else size) / 2)


@pytest.mark.parametrize("count", [96, 192, 400, 1000])
@pytest.mark.parametrize("rod", [shapes.capsule, shapes.cylinder])
def test_rods_keep_their_own_axes(rod, count):
    surface = rod(0.004, 0.08, count)
    centre, axes, half = geometry.oriented_box(surface.vertices)
    assert np.array_equal(axes, np.eye(3))
    assert centre == pytest.approx([0, 0, 0.04], abs=1e-12)
    assert half[2] == pytest.approx(0.04)
    assert half[0] == pytest.approx(half[1]) and 0.9 * 0.004 < half[0] <= 0.004


def test_box_is_not_larger_than_any_turned_one():
    """Against 2,000 random directions, on an organ."""
    rng = np.random.default_rng(5)
    points = shapes.ellipsoid((0.05, 0.03, 0.02), 300).vertices @ Rotation.random(rng=rng).as_matrix()
    centre, axes, half = geometry.oriented_box(points)
    check_box(points, centre, axes, half)
    least = min(np.ptp(points @ m, axis=0).prod() for m in Rotation.random(2000, rng=rng).as_matrix())
    assert 8 * half.prod() <= least


@pytest.mark.parametrize("flatness", [2, 1])
def test_box_of_flat_and_straight_points(flatness):
    rng = np.random.default_rng(7)
    rotation = Rotation.random(rng=rng).as_matrix()
    points = np.array([[0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0], [0.4, 0.3, 0]]) * 0.01
    points[:, flatness:] = 0
    centre, axes, half = geometry.oriented_box(points @ rotation.T)
    check_box(points @ rotation.T, centre, axes, half)
    expected = [0, 0.005, 0.01] if flatness == 2 else [0, 0, 0.01]
    assert sorted(half) == pytest.approx(expected, abs=1e-12)


# --- nearest ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(3))
def test_the_nearest_place_is_nearer_than_any_other(seed):
    """Triangles of all sizes, one of them across the whole set, against every triangle for every point."""
    rng = np.random.default_rng(seed)
    size = 10.0 ** rng.uniform(-4, -1, (200, 1, 1))
    corners = rng.uniform(-0.05, 0.05, (200, 1, 3)) + size * rng.normal(size=(200, 3, 3))
    corners[0] = [[-1, -1, 0.03], [1, -1, 0.03], [0, 1, 0.03]]
    surface = Surface(corners.reshape(-1, 3), np.arange(600).reshape(-1, 3))
    points = rng.uniform(-0.1, 0.1, (150, 3))
    triangle, weight = geometry.nearest_place(surface, points)
    feet = np.einsum("ij,ijk->ik", weight, corners[triangle])
    for point, foot in zip(points, feet, strict=True):
        every = trimesh.triangles.closest_point(corners, np.broadcast_to(point, (200, 3)))
        least = np.linalg.norm(every - point, axis=1).min()
        assert np.linalg.norm(foot - point) == pytest.approx(least, rel=1e-9, abs=1e-12)
    nothing = geometry.nearest_place(surface, np.empty((0, 3)))
    assert nothing[0].shape == (0,) and nothing[1].shape == (0, 3)
