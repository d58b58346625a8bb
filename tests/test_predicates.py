"""Signs and triangle-triangle intersection against exact rational arithmetic."""

import itertools
import random
from fractions import Fraction

import numpy as np
import pytest

from tissue_contact.kernels.predicates import side
from tissue_contact.kernels.tritri import COPLANAR, DISJOINT, INTERSECT, intersect

ROOM = np.zeros(256)


def exact(points):
    return [[Fraction(c) for c in p] for p in points]


def sub(a, b):
    return [x - y for x, y in zip(a, b, strict=True)]


def cross(u, v):
    return [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]


def dot(u, v):
    return sum(x * y for x, y in zip(u, v, strict=True))


def sign(x):
    return (x > 0) - (x < 0)


def segment_meets(a, b, triangle, n):
    """Whether a closed segment meets a closed triangle with normal n, in rational arithmetic."""
    sa, sb = dot(n, sub(a, triangle[0])), dot(n, sub(b, triangle[0]))
    if sa * sb > 0:
        return False
    if sa == sb == 0:  # in the plane: clip by the three edges
        low, high = Fraction(0), Fraction(1)
        for k in range(3):
            inward = cross(n, sub(triangle[(k + 1) % 3], triangle[k]))
            fa, fb = dot(inward, sub(a, triangle[k])), dot(inward, sub(b, triangle[k]))
            if fa < 0 and fb < 0:
                return False
            if fa < 0 or fb < 0:
                cut = fa / (fa - fb)
                low, high = (max(low, cut), high) if fb > fa else (low, min(high, cut))
        return low <= high
    cut = sa / (sa - sb)
    p = [x + cut * (y - x) for x, y in zip(a, b, strict=True)]
    edges = [(triangle[k], triangle[(k + 1) % 3]) for k in range(3)]
    return all(dot(cross(n, sub(q, r)), sub(p, r)) >= 0 for r, q in edges)


def reference(t, u):
    """INTERSECT, DISJOINT or COPLANAR of two triangles of rational points, from their edges alone."""
    nt, nu = cross(sub(t[1], t[0]), sub(t[2], t[0])), cross(sub(u[1], u[0]), sub(u[2], u[0]))
    if not any(nt) or not any(nu) or not any(dot(nt, sub(p, t[0])) for p in u):
        return COPLANAR
    pairs = [(k, (k + 1) % 3) for k in range(3)]
    meets = any(segment_meets(u[i], u[j], t, nt) or segment_meets(t[i], t[j], u, nu) for i, j in pairs)
    return INTERSECT if meets else DISJOINT


def coordinates(kind, rng):
    """A source of coordinates: general, on a small lattice (touching, coplanar, degenerate), or a few ulps off it."""
    if kind == "random":
        return lambda: rng.uniform(-1, 1)
    if kind == "lattice":
        return lambda: float(rng.randint(-2, 2))
    if kind == "inexact lattice":
        return lambda: rng.randint(-2, 2) * 0.1
    return lambda: rng.choice([0.1, 0.2, 0.3, 0.7]) + rng.choice([0, 1e-17, 1e-16, -1e-16])


KINDS = ["random", "lattice", "inexact lattice", "nearly degenerate"]


@pytest.mark.parametrize("kind", KINDS)
def test_side_is_the_exact_sign(kind):
    seed = 11
    draw = coordinates(kind, random.Random(seed))
    for trial in range(2000):
        points = [tuple(draw() for _ in range(3)) for _ in range(4)]
        a, b, c, d = exact(points)
        expected = sign(dot(cross(sub(b, a), sub(c, a)), sub(d, a)))
        assert side(*points, ROOM) == expected, (seed, trial, points)


@pytest.mark.parametrize("kind", KINDS)
def test_intersection_agrees_with_rational_arithmetic(kind):
    seed = 12
    draw = coordinates(kind, random.Random(seed))
    met = set()
    for trial in range(3000):
        points = [tuple(draw() for _ in range(3)) for _ in range(6)]
        expected = reference(exact(points[:3]), exact(points[3:]))
        got = intersect(*points, ROOM)
        # Two flat triangles that a plane parts are disjoint as well as degenerate: neither is a contact.
        assert (got == INTERSECT) == (expected == INTERSECT), (seed, trial, points)
        assert got != COPLANAR or expected == COPLANAR, (seed, trial, points)
        met.add(expected)
    assert {DISJOINT, INTERSECT} <= met
    assert kind == "random" or COPLANAR in met


def test_intersection_does_not_depend_on_the_order_of_corners_or_triangles():
    seed = 13
    rng = random.Random(seed)
    for trial in range(300):
        draw = coordinates(rng.choice(KINDS), rng)
        t, u = ([tuple(draw() for _ in range(3)) for _ in range(3)] for _ in range(2))
        first = intersect(*t, *u, ROOM) == INTERSECT
        for p, q in itertools.product(itertools.permutations(t), itertools.permutations(u)):
            assert (intersect(*p, *q, ROOM) == INTERSECT) == first, (seed, trial, p, q)
            assert (intersect(*q, *p, ROOM) == INTERSECT) == first, (seed, trial, q, p)


def test_edge_contact_and_a_gap_of_one_ulp():
    t = ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    touching = ((0.25, 0.25, 0.0), (0.25, 0.25, 1.0), (0.5, 0.5, 1.0))
    above = ((0.25, 0.25, 5e-324), (0.25, 0.25, 1.0), (0.5, 0.5, 1.0))
    assert intersect(*t, *touching, ROOM) == INTERSECT
    assert intersect(*t, *above, ROOM) == DISJOINT
