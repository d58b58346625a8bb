"""Signs of determinants, exact for every float64 input.

A floating-point filter decides nearly all cases; what lies within its error bound is decided by expansion arithmetic
(Shewchuk 1997, Adaptive precision floating-point arithmetic and fast robust geometric predicates), in the room that
the caller lends. Exact as long as no product underflows: coordinates above 1e-100 in size, or zero.
"""

import math

from tissue_contact.kernels.compiled import inner, kernel

# Error bound of a 3x3 determinant of differences, relative to its permanent: (7 + 56 eps) eps, eps = 2^-53.
FILTER = 7.771561172376103e-16
SPLITTER = 134217729.0  # 2^27 + 1, halves a float64 for an exact product


@inner
def _product(a, b):
    """Product and its rounding error: a b = p + e exactly."""
    p = a * b
    t = SPLITTER * a
    ah = t - (t - a)
    al = a - ah
    t = SPLITTER * b
    bh = t - (t - b)
    bl = b - bh
    return p, al * bl - (((p - ah * bh) - al * bh) - ah * bl)


@inner
def _difference(a, b):
    """Difference and its rounding error: a - b = d + e exactly."""
    d = a - b
    t = a - d
    return d, (a - (d + t)) + (t - b)


@inner
def _add(expansion, n, b):
    """Add a number to an expansion of n components of growing size, in place; the new n."""
    m = 0
    q = b
    for i in range(n):
        e = expansion[i]
        s = q + e
        t = s - q
        error = (q - (s - t)) + (e - t)
        q = s
        if error != 0.0:
            expansion[m] = error
            m += 1
    if q != 0.0:
        expansion[m] = q
        m += 1
    return m


@inner
def _add_product(expansion, n, sign, a, b, c):
    """Add sign a b c, each factor a sum of two numbers, to the expansion; the new n."""
    for x in a:
        for y in b:
            if x != 0.0 and y != 0.0:
                p, e = _product(x, y)
                for z in c:
                    if z != 0.0:
                        for w in (p, e):
                            r, f = _product(sign * w, z)
                            n = _add(expansion, n, f)
                            n = _add(expansion, n, r)
    return n


@inner
def _side_exact(a, b, c, d, expansion):
    u = (_difference(b[0], a[0]), _difference(b[1], a[1]), _difference(b[2], a[2]))
    v = (_difference(c[0], a[0]), _difference(c[1], a[1]), _difference(c[2], a[2]))
    w = (_difference(d[0], a[0]), _difference(d[1], a[1]), _difference(d[2], a[2]))
    n = _add_product(expansion, 0, 1.0, u[0], v[1], w[2])
    n = _add_product(expansion, n, 1.0, u[1], v[2], w[0])
    n = _add_product(expansion, n, 1.0, u[2], v[0], w[1])
    n = _add_product(expansion, n, -1.0, u[2], v[1], w[0])
    n = _add_product(expansion, n, -1.0, u[1], v[0], w[2])
    n = _add_product(expansion, n, -1.0, u[0], v[2], w[1])
    if n == 0:
        return 0
    return 1 if expansion[n - 1] > 0.0 else -1


@kernel
def side(a, b, c, d, expansion):
    """Side of the plane through a, b, c on which d lies.

    sign of ((b - a) x (c - a)) . (d - a): 1 on the side from which a, b, c run counter-clockwise, -1 on the other,
    0 in the plane, or where a product overflows. The points are tuples of three; ``expansion`` lends room, shape [256].
    """
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    wx, wy, wz = d[0] - a[0], d[1] - a[1], d[2] - a[2]
    yz, zy = uy * vz, uz * vy
    zx, xz = uz * vx, ux * vz
    xy, yx = ux * vy, uy * vx
    determinant = (yz - zy) * wx + (zx - xz) * wy + (xy - yx) * wz
    permanent = (abs(yz) + abs(zy)) * abs(wx) + (abs(zx) + abs(xz)) * abs(wy) + (abs(xy) + abs(yx)) * abs(wz)
    if determinant > FILTER * permanent:
        return 1
    if -determinant > FILTER * permanent:
        return -1
    if permanent == 0.0:  # a zero difference of float64 is an exact zero
        return 0
    if not permanent < math.inf:  # what overflows or is not-a-number has no side, and no exact arithmetic
        return 0
    return _side_exact(a, b, c, d, expansion)
