"""Signed distance of the nodes of a grid from a soup of triangles; done once, when a scene is assembled."""

import math

from tissue_contact.kernels.collision import areal
from tissue_contact.kernels.compiled import inner, kernel
from tissue_contact.kernels.vectors import cross, dot


@inner
def _less(a, b):
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@inner
def _segment(a, d):
    """Square of the distance of 0 from the segment from a to a + d."""
    dd = dot(d, d)
    f = min(1.0, max(0.0, -dot(a, d) / dd)) if dd > 0.0 else 0.0
    r = (a[0] + f * d[0], a[1] + f * d[1], a[2] + f * d[2])
    return dot(r, r)


@inner
def _square(a, b, c):
    """Square of the distance of 0 from the triangle a b c, which may have no area."""
    u, v = _less(b, a), _less(c, a)
    n = cross(u, v)
    nn = dot(n, n)
    if nn > 0.0 and min(areal((0.0, 0.0, 0.0), a, u, v, n, nn)) >= 0.0:
        return dot(a, n) ** 2 / nn
    return min(_segment(a, u), _segment(a, v), _segment(b, _less(c, b)))


@inner
def _angle(a, b, c):
    """Half the solid angle of the triangle a b c seen from 0 (van Oosterom and Strackee 1983), -pi to pi."""
    la, lb, lc = math.sqrt(dot(a, a)), math.sqrt(dot(b, b)), math.sqrt(dot(c, c))
    return math.atan2(dot(a, cross(b, c)), la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb)


@inner
def _corners(corner, t, p):
    """Corners of triangle t seen from p."""
    i = 9 * t
    return (
        (corner[i] - p[0], corner[i + 1] - p[1], corner[i + 2] - p[2]),
        (corner[i + 3] - p[0], corner[i + 4] - p[1], corner[i + 5] - p[2]),
        (corner[i + 6] - p[0], corner[i + 7] - p[1], corner[i + 8] - p[2]),
    )


@inner
def _distance(corner, ball, p, bound):
    """Distance of p from the nearest triangle, which is not beyond bound."""
    for t in range(ball.size // 4):
        b = 4 * t
        w = (ball[b] - p[0], ball[b + 1] - p[1], ball[b + 2] - p[2])
        if dot(w, w) <= (bound + ball[b + 3]) ** 2:
            bound = min(bound, math.sqrt(_square(*_corners(corner, t, p))))
    return bound


@inner
def _winding(corner, p):
    """Generalised winding number: how often the triangles surround p (Jacobson, Kavan and Sorkine 2013)."""
    total = 0.0
    for t in range(corner.size // 9):
        total += _angle(*_corners(corner, t, p))
    return total / (2.0 * math.pi)


@kernel
def sample(corner, ball, low, size, spacing, phi_out):
    """Signed distance [m] of every node of a grid from the nearest triangle, negative within.

    Within is where the winding number is above 1/2 or below -1/2: a closed surface may be wound either way, and holes
    are spanned.

    Parameters
    ----------
    corner : float64 [m], shape [9 T]
        Corners of the triangles.
    ball : float64 [m], shape [4 T]
        Centre and radius of a ball round each triangle.
    low, size, spacing : tuple of three [m], tuple of three int, float [m]
        First node, nodes along each axis, distance of neighbours.
    phi_out : float64 [m], shape [nodes]
        In C order.
    """
    last, distance = low, math.inf
    for n in range(size[0] * size[1] * size[2]):
        x, y, z = n // (size[1] * size[2]), n // size[2] % size[1], n % size[2]
        p = (low[0] + x * spacing, low[1] + y * spacing, low[2] + z * spacing)
        # No further than by way of the node before; a little room for rounding.
        step = _less(p, last)
        distance = _distance(corner, ball, p, 1.000001 * (distance + math.sqrt(dot(step, step))))
        last = p
        phi_out[n] = -distance if abs(_winding(corner, p)) > 0.5 else distance
