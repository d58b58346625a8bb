"""Meshes from files, coarser beyond a reach."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scenes import write_mesh
from scipy.spatial import Delaunay

from tissue_contact import geometry, shapes
from tissue_contact.assemble import assemble
from tissue_contact.boxes import distance_to_box
from tissue_contact.coarsening import LONG, coarsened
from tissue_contact.errors import InputError
from tissue_contact.geometry import Surface
from tissue_contact.grading import GROWTH, GROWTH_MAX
from tissue_contact.scenarios import bench
from tissue_contact.scene import parse_scene
from tissue_contact.simulate import Instance, run

ORGANS = {
    "patch": (shapes.patch((0.06, 0.06), 3000, 0.1, seed=1), [[-0.01, -0.005, -0.01], [0.01, 0.005, 0.01]]),
    "rows": (shapes.patch((0.06, 0.06), 3000, irregular=False), [[-0.01, -0.005, -0.01], [0.01, 0.005, 0.01]]),
    "wall": (shapes.abdominal_wall((0.08, 0.08), 3000, 0.012, 0.02), [[-0.05, -0.05, -0.1], [0.0, 0.0, 0.1]]),
    "ellipsoid": (shapes.ellipsoid((0.03, 0.02, 0.015), 3000), [[-0.01, -0.01, 0.005], [0.01, 0.01, 0.05]]),
}


def triangles_at(surface: Surface, chosen: np.ndarray) -> set[tuple[float, ...]]:
    """Some triangles by the places of their corners, whatever their numbers."""
    return {tuple(np.ravel(c[np.lexsort(c.T)])) for c in surface.vertices[surface.triangles[chosen]]}


def topology(surface: Surface) -> tuple[int, int, int, int, bool]:
    """Euler's characteristic, components, rims, edges of more than two triangles, whether it is wound one way."""
    report = geometry.inspect(surface)
    rim = geometry.boundary_edges(surface.triangles)
    follows = dict(rim.tolist())
    rims = 0
    while follows:
        rims += 1
        _, v = follows.popitem()
        while v in follows:
            v = follows.pop(v)
    euler = len(surface.vertices) - len(geometry.edges(surface)) + len(surface.triangles)
    return euler, report.components, rims, report.nonmanifold_edges, report.winding_consistent


@pytest.mark.parametrize("name", ORGANS)
def test_the_mesh_within_the_reach_is_that_of_the_file(name: str) -> None:
    whole, reach = ORGANS[name]
    found = coarsened(whole, reach, GROWTH, "mesh")
    within = [(distance_to_box(s.vertices, reach) == 0)[s.triangles].all(axis=1) for s in (whole, found)]
    assert within[0].sum() > 100
    # Vertices from around it may have been moved in.
    assert triangles_at(whole, within[0]) <= triangles_at(found, within[1])
    assert within[1].sum() < 1.1 * within[0].sum()


@pytest.mark.parametrize("name", ORGANS)
def test_edges_grow_with_the_distance_and_the_shape_stays(name: str) -> None:
    whole, reach = ORGANS[name]
    found = coarsened(whole, reach, GROWTH, "mesh")
    assert len(found.triangles) < 0.5 * len(whole.triangles)
    assert topology(found) == topology(whole)
    # Chords of an edge between normals 20° apart are 1.5 % shorter, and corners of two of them meet: twice that.
    assert geometry.triangle_areas(found).sum() == pytest.approx(geometry.triangle_areas(whole).sum(), rel=0.03)
    ends = geometry.edges(found)
    distance = distance_to_box(found.vertices, reach)[ends].mean(axis=1)
    length = np.linalg.norm(np.diff(found.vertices[ends], axis=1), axis=2).ravel()
    finest = np.median(length[distance == 0])
    over = length / (finest + GROWTH * distance)
    # Swaps and evening follow the last collapse, so a few are longer; where the organ bends most are shorter.
    assert np.quantile(over, 0.95) < LONG
    near = (distance > 0) & (distance < 0.008)
    assert 0.8 < np.median(over[near]) < 1.2
    report = geometry.inspect(found)
    corner = found.vertices[found.triangles]
    sides = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2)
    assert (geometry.triangle_heights(found) / sides.max(axis=1)).min() > 0.1, report


def test_rims_and_holes_stay() -> None:
    sheet, reach = ORGANS["patch"]
    middle = sheet.vertices[sheet.triangles].mean(axis=1)
    left = sheet.triangles[np.linalg.norm(middle[:, :2] - 0.015, axis=1) > 0.006]
    used, numbered = np.unique(left, return_inverse=True)
    ring = Surface(sheet.vertices[used], numbered.reshape(-1, 3))
    found = coarsened(ring, reach, GROWTH_MAX, "mesh")
    assert topology(found) == topology(ring) and topology(ring)[2] == 2
    for side in (np.min, np.max):
        assert side(found.vertices[:, :2], axis=0) == pytest.approx(side(ring.vertices[:, :2], axis=0), abs=1e-15)
    rim = found.vertices[np.unique(geometry.boundary_edges(found.triangles))]
    at_file = {tuple(v) for v in ring.vertices[np.unique(geometry.boundary_edges(ring.triangles))]}
    assert {tuple(v) for v in rim} < at_file, "no vertex of a rim is new"


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 2**31), st.floats(0.01, GROWTH_MAX), st.sampled_from(list(ORGANS)))
def test_any_reach_leaves_one_surface(seed: int, growth: float, name: str) -> None:
    whole, _ = ORGANS[name]
    rng = np.random.default_rng(seed)
    middle, half = rng.choice(whole.vertices), rng.uniform(0, 0.02, 3)
    found = coarsened(whole, [middle - half, middle + half], growth, "mesh")
    assert topology(found) == topology(whole)
    assert geometry.triangle_heights(found).min() > 1e-5


def test_a_coarse_organ_keeps_its_shape() -> None:
    """Its vertices are its shape: evened out they would cut off what bends."""
    whole = shapes.ellipsoid((0.03, 0.02, 0.015), 300)
    found = coarsened(whole, [[-0.01, -0.01, 0.005], [0.01, 0.01, 0.05]], GROWTH, "mesh")
    assert len(found.triangles) < len(whole.triangles)
    assert geometry.volume(found) == pytest.approx(geometry.volume(whole), rel=0.02)


@settings(max_examples=6, deadline=None)
@given(st.integers(0, 2**31), st.floats(0.05, 0.4))
def test_a_rough_organ_is_not_folded(seed: int, rough: float) -> None:
    """As from an image: every vertex is off by a share of an edge."""
    whole, reach = ORGANS["ellipsoid"]
    edge = np.median(np.linalg.norm(np.diff(whole.vertices[geometry.edges(whole)], axis=1), axis=2))
    noise = rough * edge * np.random.default_rng(seed).uniform(-0.5, 0.5, (len(whole.vertices), 3))
    organ = Surface(whole.vertices + noise, whole.triangles)
    found = coarsened(organ, reach, GROWTH, "mesh")
    assert topology(found) == topology(organ)
    normals, corners = geometry.vertex_normals(organ), found.vertices[found.triangles]
    triangle, weight = geometry.nearest_place(organ, corners.mean(axis=1))
    there = geometry.unit(np.einsum("ij,ijk->ik", weight, normals[organ.triangles[triangle]]))
    along = np.einsum("ij,ij->i", geometry.triangle_normals(found), there)
    assert along.min() > 0


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**31), st.floats(0.01, GROWTH_MAX))
@example(15, GROWTH_MAX)  # a triangle whose corners would all be on one side of the rim
@example(88, GROWTH_MAX)  # one that evening out would turn over
def test_a_flat_sheet_of_slivers_is_covered_once(seed: int, growth: float) -> None:
    """Random points: merging two of them would turn over many a triangle, and pinch others."""
    rng = np.random.default_rng(seed)
    side = 0.05 * np.linspace(0, 1, 15)[:-1]
    rim = np.concatenate([[(t, 0), (0.05, t), (0.05 - t, 0.05), (0, 0.05 - t)] for t in side])
    plan = np.concatenate([rim, rng.uniform(0.001, 0.049, (400, 2))])
    found = Delaunay(plan).simplices
    sheet, _ = geometry.repair(Surface(np.column_stack([plan, np.zeros(len(plan))]), found))
    middle, half = rng.choice(sheet.vertices), rng.uniform(0, 0.01)
    found = coarsened(sheet, [middle - half, middle + half], growth, "mesh")
    assert topology(found) == topology(sheet)
    assert np.unique(np.sign(geometry.triangle_normals(found)[:, 2])).size == 1
    assert geometry.triangle_areas(found).sum() == pytest.approx(0.05**2, rel=1e-9)


def test_a_tiny_organ_is_left_an_organ() -> None:
    """A tetrahedron has nothing to spare, and what has more is not folded to less than one."""
    corners = np.array([[0, 0, 0], [0.01, 0, 0], [0, 0.01, 0], [0, 0, 0.01]], float)
    four = Surface(corners, np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]))
    for surface in (four, shapes.ellipsoid((0.001, 0.001, 0.001), 20)):
        reach = [surface.vertices[0] - 1e-9, surface.vertices[0] + 1e-9]
        found = coarsened(surface, reach, GROWTH_MAX, "mesh")
        assert topology(found)[:4] == (2, 1, 0, 0) and geometry.volume(found) > 0


def test_a_reach_that_holds_nothing_is_refused() -> None:
    whole, _ = ORGANS["patch"]
    with pytest.raises(InputError, match=r"scene, reach: .*hold at least one vertex.*Enlarge or move the box"):
        coarsened(whole, [[1, 1, 1], [2, 2, 2]], GROWTH, "scene, reach")


def test_a_coarsened_sheet_presses_as_the_whole_one(tmp_path: Path) -> None:
    """The bench's press and slide: 1.5 % of the force on 6,000 triangles, and a coarse mesh errs more."""
    sheet = shapes.patch((0.06, 0.06), 3000, 0.4, seed=1)
    tissue = bench.MESH.format(name=write_mesh(tmp_path / "sheet.obj", sheet.vertices, sheet.triangles))
    forces, counts = [], []
    for more in ("", "\nreach = [[-0.01, -0.005, -0.01], [0.01, 0.005, 0.0]]"):
        scene = parse_scene(bench.scene_text(tissue + more, bench.PRESET.format("accurate")).encode(), tmp_path)
        instance = Instance(assemble(scene))
        counts.append(instance.state.x.size)
        forces.append(np.array([instance.outputs[:3].copy() for _ in run(instance, bench.poses(), bench.STEP)]))
    assert counts[1] < 0.3 * counts[0]
    assert np.linalg.norm(forces[1] - forces[0]) < 0.04 * np.linalg.norm(forces[0])
