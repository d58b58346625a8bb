"""Signed distance fields against closed forms, brute force and scipy; k-DOPs and quadrature against definitions."""

import os
import re
import subprocess
import sys
import textwrap
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scenes import assembled
from scipy.ndimage import map_coordinates
from scipy.spatial.transform import Rotation

from tissue_contact import fields, geometry, shapes
from tissue_contact.errors import InputError
from tissue_contact.geometry import Surface
from tissue_contact.kernels.bundle import Bundle
from tissue_contact.kernels.collision import support
from tissue_contact.kernels.compiled import kernel
from tissue_contact.kernels.field import FAR, GRID, NONE, body_distance, fields_of, part_distance, triangle_distances
from tissue_contact.kernels.pressure import out_of_reach, steepness
from tissue_contact.kernels.sampling import sample

seeds = st.integers(0, 2**32 - 1)
R = 0.004  # [m] of the round shapes here
CAPSULE, BALL, BOX, ROD, UNEVEN = range(5)  # parts of `SEVERAL`


def model_of(*parts):
    """The arrays of some fields as `fields_of` gives them."""
    return (
        np.array([f.kind for f in parts], np.uint32),
        np.cumsum([0] + [len(f.values) for f in parts]).astype(np.uint32),
        np.concatenate([f.values for f in parts]),
        np.concatenate([f.size for f in parts]).astype(np.uint32),
        np.concatenate([f.low for f in parts]),
        np.array([f.spacing for f in parts], np.float64),
    )


def at(model, part, points):
    """Distances and gradients at points, shapes (n,) and (n, 3)."""
    found = np.array([part_distance(model, np.uint32(part), tuple(p)) for p in np.reshape(points, (-1, 3)).tolist()])
    return found[:, 0], found[:, 1:]


def differences(model, part, points, h=1e-8):
    """Gradient by central differences of phi."""
    steps = [h * e for e in np.eye(3)]
    return np.stack([(at(model, part, points + s)[0] - at(model, part, points - s)[0]) / (2 * h) for s in steps], 1)


def turn(rng):
    return Rotation.random(random_state=rng.integers(2**31)).as_matrix()


A, B, CENTRE, HALF = np.array([0.001, -0.002, 0.003]), np.array([0.004, 0.005, 0.012]), np.full(3, 0.002), [1, 2, 4]
TURN = turn(np.random.default_rng(5))
NODES, LOW, SPACING = (7, 8, 9), np.array([-0.003, -0.0025, -0.004]), 0.0009


# One part of every kind, with a grid of random coefficients.
SEVERAL = model_of(
    fields.capsule(A, B, R),
    fields.capsule(A, A, R),
    fields.box(CENTRE, TURN, 1e-3 * np.array(HALF)),
    fields.cylinder(A, B, R),
    fields.Field(GRID, np.random.default_rng(1).normal(0, 0.002, np.prod(NODES)), np.array(NODES), LOW, SPACING),
)


def scattered(seed, n=200):
    return np.random.default_rng(seed).uniform(-0.012, 0.018, (n, 3))


# --- primitives -------------------------------------------------------------------------------------------


def solid(part, points):
    """Signed distance by the definition of the shape: to many places on its surface, the sign by membership."""
    rng = np.random.default_rng(0)
    d = (B - A) / np.linalg.norm(B - A)
    if part == BALL:
        return np.linalg.norm(points - A, axis=1) - R
    if part == CAPSULE:
        places = A + np.linspace(0, 1, 20001)[:, None] * (B - A)
        return np.array([np.linalg.norm(places - p, axis=1).min() for p in points]) - R
    if part == BOX:
        places = rng.uniform(-1, 1, (60000, 3))
        face = rng.integers(3, size=len(places))
        places[np.arange(len(places)), face] = np.sign(places[np.arange(len(places)), face])
        places = CENTRE + places * 1e-3 * HALF @ TURN
        inside = (np.abs((points - CENTRE) @ TURN.T) < 1e-3 * np.array(HALF)).all(axis=1)
    else:
        across = np.linalg.svd(d[None])[2][1:]
        angle, length = rng.uniform(0, 2 * np.pi, 60000), np.linalg.norm(B - A)
        along, radius = rng.uniform(0, length, 60000), R * np.sqrt(rng.uniform(0, 1, 60000))
        where = rng.integers(3, size=60000)  # one end, the other, the wall
        along = np.where(where == 0, 0, np.where(where == 1, length, along))
        radius = np.where(where == 2, R, radius)
        places = A + along[:, None] * d + radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], 1) @ across
        w = points - A
        inside = (w @ d > 0) & (w @ d < length) & (np.linalg.norm(w - (w @ d)[:, None] * d, axis=1) < R)
    distance = np.array([np.linalg.norm(places - p, axis=1).min() for p in points])
    return np.where(inside, -distance, distance)


@pytest.mark.parametrize("part", [CAPSULE, BALL, BOX, ROD])
def test_a_primitive_is_as_far_as_its_surface(part):
    points = np.concatenate([scattered(2, 60), CENTRE + 0.1 * scattered(3, 40)])
    found, expected = at(SEVERAL, part, points)[0], solid(part, points)
    assert min(np.sum(found < 0), np.sum(found > 0)) >= 5
    # The nearest of many places is at least as far as the surface, and little more.
    assert np.all(np.abs(found) <= np.abs(expected) + 1e-6)
    np.testing.assert_allclose(found, expected, atol=1e-4, rtol=0)
    far = np.abs(found) > 0.001
    np.testing.assert_allclose(found[far], expected[far], atol=3e-5, rtol=0)


@settings(deadline=None)
@given(seed=seeds)
def test_the_gradient_is_that_of_phi(seed):
    points = scattered(seed, 10)
    for part in range(5):
        phi, gradient = at(SEVERAL, part, points)
        reached = phi < FAR
        expected = differences(SEVERAL, part, points)
        # Central differences that straddle a crease within are not wanted: there the two sides differ.
        smooth = reached & (np.abs(differences(SEVERAL, part, points, 2e-8) - expected).max(axis=1) < 1e-6)
        assert smooth.sum() >= 0.8 * reached.sum() - 1
        np.testing.assert_allclose(gradient[smooth], expected[smooth], atol=1e-6)
        if part != UNEVEN:
            assert reached.all()
            np.testing.assert_allclose(np.linalg.norm(gradient, axis=1), 1.0, rtol=1e-12)
        else:
            assert not gradient[~reached].any()


def test_places_without_a_gradient():
    middle = 0.5 * (A + B)
    straight = model_of(fields.capsule((0, 0, 0), (0, 0, 0.01), R), fields.cylinder((0, 0, 0), (0, 0, 0.01), 0.001))
    for model, part, p, phi in [
        (SEVERAL, BALL, A, -R),
        (SEVERAL, CAPSULE, A, -R),
        (SEVERAL, BOX, CENTRE, -0.001),
        (straight, 0, (0, 0, 0.005), -R),
        (straight, 1, (0, 0, 0.005), -0.001),
    ]:
        found, gradient = at(model, part, p)
        assert found[0] == pytest.approx(phi, rel=1e-12)
        assert not gradient.any()
    assert np.isfinite(at(SEVERAL, ROD, middle)[1]).all()


def test_a_number_that_is_none_stays_within_the_arrays():
    for bad in (np.nan, np.inf, -np.inf, 1e300):
        for k in range(3):
            p = [0.0, 0.0, 0.0]
            p[k] = bad
            for part in range(4):
                phi = part_distance(SEVERAL, np.uint32(part), tuple(p))[0]
                assert np.isnan(phi) or phi > 1e100
            assert part_distance(SEVERAL, np.uint32(UNEVEN), tuple(p)) == (FAR, 0, 0, 0)
    for last in (4, 5):
        assert body_distance(SEVERAL, np.uint32(0), np.uint32(last), (np.nan,) * 3) == (FAR, 0, 0, 0)


def test_a_body_is_the_union_of_its_parts():
    points = scattered(4)
    each = np.array([at(SEVERAL, part, points)[0] for part in range(5)])
    for first, last in ((0, 5), (1, 3), (2, 3)):
        nearest = first + each[first:last].argmin(axis=0)
        for p, part in zip(points.tolist(), nearest, strict=True):
            assert body_distance(SEVERAL, np.uint32(first), np.uint32(last), tuple(p)) == part_distance(
                SEVERAL, np.uint32(part), tuple(p)
            )
    assert len(set(nearest)) == 1 and len(set(each.argmin(axis=0))) >= 3
    assert body_distance(SEVERAL, np.uint32(2), np.uint32(2), (0.0, 0.0, 0.0)) == (FAR, 0, 0, 0)


@kernel
def distances_of(fields, first, last, u, v, w, wa, wb, wc, phi, gx, gy, gz):
    """The kernel for Python, which only kernels may call."""
    triangle_distances(fields, first, last, u, v, w, wa, wb, wc, phi, gx, gy, gz)


def test_the_points_of_a_triangle_are_as_far_as_each_of_them_alone():
    """To the last bit, whether parts are read in vectors or point by point; nothing beyond the points is written."""
    rng = np.random.default_rng(5)
    inside = 0
    for trial in range(300):
        corners = (A + B) / 2 + rng.normal(0.0, 0.006, (3, 3))
        if trial < 9:
            corners[:] = (A, B, (A + B) / 2)[trial % 3]  # all points are one, on the axis of the capsule
        weights = rng.dirichlet((1.0, 1.0, 1.0), rng.integers(1, 13)).T.copy()
        first, last = sorted(rng.integers(0, 6, 2))
        found = np.full((4, 13), 7.0)
        places = (tuple(corner) for corner in corners.tolist())
        distances_of(SEVERAL, np.uint32(first), np.uint32(last), *places, *weights, *found)
        for q, (a, b, c) in enumerate(weights.T.tolist()):
            u, v, w = corners.tolist()
            point = tuple(a * u[k] + b * v[k] + c * w[k] for k in range(3))
            wanted = body_distance(SEVERAL, np.uint32(first), np.uint32(last), point)
            assert tuple(found[:, q].tolist()) == wanted, (trial, q)
            inside += wanted[0] < 0.0
        assert (found[:, weights.shape[1] :] == 7.0).all()
    assert inside > 100


def test_no_field_is_far():
    model = model_of(fields.Field(NONE, np.empty(0)), fields.capsule(A, A, R))
    assert part_distance(model, np.uint32(0), tuple(A)) == (FAR, 0, 0, 0)
    assert body_distance(model, np.uint32(0), np.uint32(2), tuple(A))[0] == -R


@pytest.mark.parametrize(
    ("kind", "arguments"),
    [
        ("capsule", {"radius": 0.003, "length": 0.02}),
        ("sphere", {"radius": 0.003}),
        ("box", {"size": (0.004, 0.006, 0.01)}),
        ("cylinder", {"radius": 0.003, "length": 0.02}),
    ],
)
def test_the_field_of_a_shape_lies_on_its_mesh(kind, arguments):
    mesh = getattr(shapes, kind)(**arguments, triangles=600)
    rotation, offset = turn(np.random.default_rng(8)), np.array([0.01, -0.02, 0.03])
    field = fields.primitive(SimpleNamespace(kind=kind, **arguments, triangles=600), rotation, offset)
    model = model_of(field)
    phi, _ = at(model, 0, mesh.vertices @ rotation.T + offset)
    np.testing.assert_allclose(phi, 0, atol=1e-15)
    phi, gradient = at(model, 0, mesh.vertices[mesh.triangles].mean(axis=1) @ rotation.T + offset)
    assert np.all(phi <= 1e-15) and np.all(phi > -1.5e-4)  # the sag of a facet
    assert np.sum(gradient * (geometry.triangle_normals(mesh) @ rotation.T), axis=1).min() > 0.98


def test_other_shapes_have_no_primitive():
    for shape in (None, SimpleNamespace(kind="hook", radius=0.001, length=0.1)):
        assert fields.primitive(shape, np.eye(3), np.zeros(3)) is None


# --- grid -------------------------------------------------------------------------------------------------


@settings(deadline=None)
@given(seed=seeds)
def test_the_grid_is_scipys_spline(seed):
    points = LOW + SPACING * np.random.default_rng(seed).uniform(0.5, np.array(NODES) - 1.5, (20, 3))
    phi, _ = at(SEVERAL, UNEVEN, points)
    coefficients = SEVERAL[2][SEVERAL[1][UNEVEN] :].reshape(NODES)
    expected = map_coordinates(coefficients, ((points - LOW) / SPACING).T, order=2, prefilter=False)
    np.testing.assert_allclose(phi, expected, atol=1e-15, rtol=1e-10)


def test_the_grid_ends_where_a_node_is_missing():
    inside, end = 0.51 * SPACING, (np.array(NODES) - 1.51) * SPACING
    for k in range(3):
        for edge, step in ((inside, -0.02 * SPACING), (end[k], 0.02 * SPACING)):
            p = LOW + 3 * SPACING
            p[k] = LOW[k] + edge
            assert at(SEVERAL, UNEVEN, p)[0] < 1
            p[k] += step
            assert at(SEVERAL, UNEVEN, p)[0] == FAR


@settings(deadline=None)
@given(seed=seeds)
def test_the_gradient_goes_smoothly_from_cell_to_cell(seed):
    rng = np.random.default_rng(seed)
    for k in range(3):
        p = LOW + SPACING * rng.uniform(0.6, np.array(NODES) - 1.6)
        p[k] = LOW[k] + SPACING * (rng.integers(1, NODES[k] - 2) + 0.5)  # where the 27 nodes change
        step = 1e-9 * np.eye(3)[k] * SPACING
        before, after = at(SEVERAL, UNEVEN, p - step), at(SEVERAL, UNEVEN, p + step)
        assert before[0] == pytest.approx(after[0], abs=1e-10)
        np.testing.assert_allclose(before[1], after[1], atol=1e-7)


# --- sampled ----------------------------------------------------------------------------------------------


def joined(*surfaces):
    """One mesh, a part of each surface."""
    first = np.cumsum([0] + [len(s.vertices) for s in surfaces])
    return Surface(
        np.concatenate([s.vertices for s in surfaces]),
        np.concatenate([s.triangles + n for s, n in zip(surfaces, first, strict=False)]),
        np.repeat(np.arange(len(surfaces)), [len(s.triangles) for s in surfaces]),
    )


def brute_force(surface, points):
    """Unsigned distance by way of `geometry.nearest_place`, which is trimesh's."""
    triangle, weight = geometry.nearest_place(surface, points)
    feet = np.einsum("nk,nkx->nx", weight, surface.vertices[surface.triangles[triangle]])
    return np.linalg.norm(points - feet, axis=1)


def node_values(field):
    return map_coordinates(
        field.values.reshape(field.size),
        np.indices(field.size).reshape(3, -1),
        order=2,
        prefilter=False,
        mode="mirror",
    )


def places_of(field):
    return field.low + field.spacing * np.indices(field.size).reshape(3, -1).T


def test_the_nodes_hold_the_distance_to_the_mesh():
    mesh = joined(shapes.sphere(R, 32), shapes.box((0.004, 0.006, 0.01), 40))
    lone = joined(shapes.box((0.004, 0.006, 0.01), 40))
    field = fields.sampled(mesh, 1)
    assert field.kind == GRID and field.spacing == pytest.approx(0.002 / 8)
    places = places_of(field)
    some = np.random.default_rng(3).choice(len(places), 300, replace=False)
    expected = brute_force(lone, places[some])
    inside = (np.abs(places[some] - (0, 0, 0.005)) < (0.002, 0.003, 0.005)).all(axis=1)
    np.testing.assert_allclose(node_values(field)[some], np.where(inside, -expected, expected), atol=1e-14)


# Tolerance in spacings: the sag of the facets and the rounding of edges, where normals have no cosine to keep.
@pytest.mark.parametrize(
    ("mesh", "exact", "tolerance", "cosine"),
    [
        (shapes.capsule(R, 0.02, 1500), fields.capsule((0, 0, R), (0, 0, 0.02 - R), R), 0.15, 0.99),
        (shapes.sphere(R, 1500), fields.capsule((0, 0, R), (0, 0, R), R), 0.05, 0.998),
        (shapes.box((0.006, 0.008, 0.01)), fields.box((0, 0, 0.005), np.eye(3), (0.003, 0.004, 0.005)), 0.2, None),
    ],
)
def test_a_sampled_shape_is_like_the_exact_one(mesh, exact, tolerance, cosine):
    field = fields.sampled(mesh, 0)
    model = model_of(field, exact)
    rng = np.random.default_rng(6)
    least, greatest = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    points = rng.uniform(least - 2 * field.spacing, greatest + 2 * field.spacing, (2000, 3))
    (phi, gradient), (expected, normal) = at(model, 0, points), at(model, 1, points)
    near = (expected > -0.5 * R) & (expected < field.spacing)  # the axis has a crease
    assert np.abs(phi - expected)[near].max() < tolerance * field.spacing
    if cosine is not None:
        length = np.linalg.norm(gradient, axis=1)
        assert (np.sum(gradient * normal, axis=1) / length)[near].min() > cosine
        assert length[near].min() > 0.9 and length[near].max() < 1.1


@settings(deadline=None)
@given(seed=seeds)
def test_the_distance_to_lone_triangles(seed):
    rng = np.random.default_rng(seed)
    corners = rng.normal(0, R, (3, 3, 3))
    corners[1, 2] = corners[1, 0] + rng.uniform(-0.5, 1.5) * (corners[1, 1] - corners[1, 0])  # one without area
    middle = corners.mean(axis=1)
    ball = np.column_stack([middle, 1.001 * np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)])
    low, size = rng.normal(0, R, 3) - R, np.array([3, 4, 5])
    phi = np.empty(60)
    sample(corners.ravel(), ball.ravel(), tuple(low.tolist()), tuple(size.tolist()), R / 2, phi)
    places = low + R / 2 * np.indices(size).reshape(3, -1).T
    weight = np.array([(i, j, 100 - i - j) for i in range(101) for j in range(101 - i)]) / 100
    expected = np.linalg.norm(places[:, None] - (weight @ corners).reshape(-1, 3), axis=2).min(axis=1)
    assert np.all(np.abs(phi) <= expected + 1e-12)
    longest = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2).max()
    np.testing.assert_allclose(np.abs(phi), expected, atol=0.01 * longest)


def test_the_grid_reaches_two_spacings_beyond_the_part():
    field = fields.sampled(shapes.sphere(R, 128), 0)
    model = model_of(field)
    for k in range(3):
        for z in (-1, 1):
            p = np.array([0, 0, R])
            p[k] += z * (R + 2 * field.spacing)
            assert 0 < at(model, 0, p)[0] < 3 * field.spacing


def test_a_long_part_gets_wider_spacing():
    field = fields.sampled(shapes.capsule(0.0025, 0.3, 48), 0)
    assert field.spacing > 0.0025 / 8
    assert 0.9 * fields.NODES_MAX < field.size.prod() == len(field.values) <= fields.NODES_MAX


@pytest.mark.parametrize("inward", [False, True])
def test_an_open_mesh_still_has_an_inside(inward):
    ball = shapes.sphere(R, 512)
    middle = ball.vertices[ball.triangles].mean(axis=1)
    triangles = ball.triangles[middle[:, 2] < 1.7 * R]  # a hole of 0.7 R at the top
    mesh = Surface(ball.vertices, triangles[:, ::-1] if inward else triangles)
    assert not geometry.inspect(mesh).watertight
    model = model_of(fields.sampled(mesh, 0))
    points = np.random.default_rng(7).uniform([-R, -R, 0], [R, R, 2 * R], (500, 3))
    distance = np.linalg.norm(points - (0, 0, R), axis=1) - R
    kept = (np.abs(distance) > 0.1 * R) & (points[:, 2] < 1.6 * R)
    assert np.array_equal(np.sign(at(model, 0, points)[0][kept]), np.sign(distance[kept]))


def test_a_sheet_has_no_inside():
    field = fields.sampled(shapes.patch(0.01, 32), 0)
    assert field.size.prod() <= fields.NODES_MAX
    assert node_values(field).min() > -1e-15


# --- k-DOP ------------------------------------------------------------------------------------------------


@kernel
def passed_over(model, corners):
    """Which triangles [n, 3, 3] a response passes over."""
    out, parts = np.zeros(corners.shape[0]), model.part_field.size
    steep = steepness(model, 0, parts)
    for k in range(corners.shape[0]):
        a, b, c = corners[k]
        a, b, c = (a[0], a[1], a[2]), (b[0], b[1], b[2]), (c[0], c[1], c[2])
        culled = out_of_reach(model, 0, parts, steep, a, b, c)
        out[k] = 1.0 if culled else 0.0
    return out


@pytest.mark.parametrize(
    "shape",
    [
        'kind = "capsule", radius = 0.004, length = 0.02, triangles = 200',
        'kind = "box", size = [0.004, 0.008, 0.02]',
        'kind = "ellipsoid", radii = [0.004, 0.005, 0.01], triangles = 300',  # sampled
        'kind = "grasper", radius = 0.003, length = 0.02, jaw_length = 0.01',
    ],
)
def test_a_triangle_that_is_passed_over_has_no_point_within_the_body(shape):
    text = f"""
        [[tissue]]
        shape = {{ kind = "patch", size = [0.02, 0.02], triangles = 32 }}
        stiffness = 100.0
        areal_density = 1.0
        [[instrument]]
        shape = {{ {shape} }}
        [[contact]]
        stiffness_per_area = 1e7
    """
    model = assembled(text).model
    rng = np.random.default_rng(1)
    reach = np.array([model.body_low[:3], model.body_high[:3]])
    middle = rng.uniform(reach[0] - R, reach[1] + R, (4000, 3))
    corners = middle[:, None] + rng.normal(size=(4000, 3, 3)) * R * rng.uniform(0.05, 1, (4000, 1, 1))
    culled = passed_over(Bundle(model), corners) == 1.0
    weights = rng.dirichlet(np.ones(3), 300)
    arrays = fields_of.py_func(model)
    deepest = np.array(
        [min(body_distance(arrays, 0, len(model.part_field), tuple(p))[0] for p in weights @ t) for t in corners[:1000]]
    )
    assert (deepest[culled[:1000]] >= 0).all()
    assert 0.05 < culled.mean() < 0.95 and (deepest[~culled[:1000]] < 0).any()


def climbed(hull, directions):
    """Support of a hull in directions by the kernel's climbing, from its first vertex."""
    start = np.cumsum([0] + [len(n) for n in hull.neighbours]).astype(np.uint32)
    ends = np.concatenate(hull.neighbours).astype(np.uint32)
    x, y, z = np.ascontiguousarray(hull.vertices.T)
    return np.array([hull.vertices[support(tuple(d), 0, start, ends, x, y, z)] @ d for d in directions])


@settings(max_examples=50, deadline=None)
@given(seed=seeds, n=st.integers(1, 40), dimension=st.integers(0, 3), level=st.booleans())
@example(seed=0, n=40, dimension=3, level=True)
def test_a_kdop_holds_the_hull_and_lies_within_the_box(seed, n, dimension, level):
    rng = np.random.default_rng(seed)
    points = rng.normal(0, 0.01, (n, 3)) * (np.arange(3) < dimension)
    points = (points if level else points @ turn(rng)) + rng.normal(0, 0.05, 3)
    directions = rng.normal(size=(50, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    exact = (points @ directions.T).max(axis=0)
    least = exact
    for k in (26, 14, 6):
        hull = geometry.kdop(points, k)
        reach = (hull.vertices @ directions.T).max(axis=0)
        assert np.all(reach >= least - 1e-10)
        np.testing.assert_allclose(climbed(hull, directions), reach, atol=1e-10)
        faces = geometry.SLABS[: k // 2]
        for side in (faces, -faces):
            np.testing.assert_allclose((hull.vertices @ side.T).max(axis=0), (points @ side.T).max(axis=0), atol=1e-10)
        least = reach
    low, high = points.min(axis=0), points.max(axis=0)
    box = np.where(directions > 0, high, low)
    np.testing.assert_allclose(least, (box * directions).sum(axis=1), atol=1e-10)


@pytest.mark.parametrize("k", [6, 14, 26])
def test_a_kdop_is_exact_along_its_slabs(k):
    points = shapes.capsule(0.003, 0.02, 300).vertices
    hull = geometry.kdop(points, k)
    faces = np.concatenate([geometry.SLABS[: k // 2], -geometry.SLABS[: k // 2]])
    np.testing.assert_allclose((hull.vertices @ faces.T).max(axis=0), (points @ faces.T).max(axis=0), atol=1e-15)
    edges = sum(map(len, hull.neighbours)) // 2
    touched = np.sum(np.isclose(hull.vertices @ faces.T, (points @ faces.T).max(axis=0), atol=1e-12), axis=0)
    assert len(hull.vertices) - edges + np.sum(touched >= 3) == 2  # Euler: these are all the corners and edges


def test_a_box_is_its_own_hull():
    rng = np.random.default_rng(9)
    axes, centre, half = turn(rng), rng.normal(size=3), np.array([0.001, 0.002, 0.003])
    hull = geometry.box_hull(centre, axes, half)
    assert len(hull.vertices) == 8
    np.testing.assert_allclose(np.abs((hull.vertices - centre) @ axes.T), np.broadcast_to(half, (8, 3)), atol=1e-15)
    for v, ends in zip(hull.vertices, hull.neighbours, strict=True):
        lengths = np.linalg.norm(hull.vertices[ends] - v, axis=1)
        np.testing.assert_allclose(np.sort(lengths), 2 * half, rtol=1e-9)
    directions = rng.normal(size=(50, 3))
    expected = directions @ centre + np.abs(directions @ axes.T) @ half
    np.testing.assert_allclose(climbed(hull, directions), expected, atol=1e-15)


# --- quadrature -------------------------------------------------------------------------------------------


@settings(deadline=None)
@given(seed=seeds, spacing=st.floats(1e-4, 1e-1))
def test_quadrature_is_exact_for_what_is_linear(seed, spacing):
    rng = np.random.default_rng(seed)
    vertices = rng.normal(0, 0.01, (6, 3))
    surface = Surface(vertices, np.array([rng.permutation(6)[:3] for _ in range(4)]))
    start, weight, area = fields.quadrature(surface, spacing)
    corners = surface.vertices[surface.triangles]
    slope, level = rng.normal(size=3), rng.normal()
    whole = geometry.triangle_areas(surface)
    assert start[0] == 0 and start[-1] == len(weight) == len(area)
    np.testing.assert_allclose(weight.sum(axis=1), 1.0, rtol=1e-14)
    assert weight.min() > 0
    for t in range(4):
        own = slice(start[t], start[t + 1])
        longest = max(np.linalg.norm(corners[t] - corners[t, [1, 2, 0]], axis=1))
        n = min(8, max(1, int(np.ceil(longest / spacing))))
        assert start[t + 1] - start[t] == n * n
        assert len(np.unique(weight[own].round(9), axis=0)) == n * n
        np.testing.assert_allclose(area[own], whole[t] / n**2, rtol=1e-14)
        total = np.sum(area[own] * (weight[own] @ corners[t] @ slope + level))
        expected = whole[t] * (corners[t].mean(axis=0) @ slope + level)
        np.testing.assert_allclose(total, expected, rtol=1e-9, atol=1e-13)


SPACED = """
    [[tissue]]
    shape = {{ kind = "patch", size = [0.02, 0.02], triangles = 100 }}
    areal_density = 1.0
    stiffness = 100.0
    [[instrument]]
    shape = {{ kind = "box", size = [0.004, 0.004, 0.01] }}
    start_position = [0.0, 0.0, 0.01]
    [[rigid]]
    shape = {{ kind = "sphere", radius = 0.002, triangles = 100 }}
    position = [0.0, 0.0, 0.05]
    [[contact]]
    name = "touch"
    between = ["{first}", "{second}"]
    stiffness_per_area = 1e6
    {spacing}
"""


@pytest.mark.parametrize(
    ("first", "second", "surface"),
    [
        ("tissue", "instrument", shapes.patch((0.02, 0.02), 100)),
        ("instrument", "rigid", shapes.box((0.004, 0.004, 0.01), 12)),
    ],
)
def test_a_spacing_that_a_mesh_does_not_allow_is_refused(first, second, surface):
    """An eighth of its longest edge was taken instead, without a word."""
    text = partial(SPACED.format, first=first, second=second)
    corners = surface.vertices[surface.triangles]
    edge = np.linalg.norm(corners - corners[:, [1, 2, 0]], axis=2).max()
    with pytest.raises(InputError) as caught:
        assembled(text(spacing=f"quadrature_spacing = {0.99 * edge / 8}"))
    for part in ("scene, contact[touch].quadrature_spacing", "in 8 at most", first, f"{edge:.3g} m", "refine the mesh"):
        assert part in str(caught.value)
    least = re.search(r"Give (\S+) or more", str(caught.value)).group(1)
    assert float(least) == pytest.approx(edge / 8, rel=0.02)
    assembled(text(spacing=f"quadrature_spacing = {least}"))
    assembled(text(spacing=""))


def test_quadrature_of_a_square_gets_better_with_its_spacing():
    """The integral of x² over a triangle: the error of centroids goes with the square of the spacing."""
    surface = Surface([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)])
    error = []
    for n in (1, 2, 4, 8):
        _, weight, area = fields.quadrature(surface, 1.0001 * np.sqrt(2) / n)
        error.append(abs(np.sum(area * weight[:, 1] ** 2) - 1 / 12))
    np.testing.assert_allclose(np.array(error[:-1]) / error[1:], 4.0, rtol=1e-9)


def test_a_field_is_sampled_beside_what_is_cached_of_duals(tmp_path):
    """numba met duals in what it had cached of an inner kernel, halfway through the types of another."""
    of_duals = """
        from numba import types
        from tissue_contact.kernels.dual import DUAL
        from tissue_contact.kernels.vectors import dot
        vector = types.UniTuple(DUAL, 3)
        dot.compile((vector, vector))
    """
    of_numbers = """
        from numba import types
        from tissue_contact.fields import sample
        real, array = types.float64, types.float64[::1]
        sample.compile((array, array, types.UniTuple(real, 3), types.UniTuple(types.int64, 3), real, array))
    """
    for script in (of_duals, of_numbers):
        done = subprocess.run(
            [sys.executable, "-c", textwrap.dedent(script)],
            env=os.environ | {"TISSUE_CONTACT_CACHE": str(tmp_path)},
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stderr
    assert list(tmp_path.rglob("*dot*.nbi"))
