"""Where and how deep a pair of triangles collides: point of collision, penetration vector (thesis 3.6.2, 3.6.3).

All in the body frame of the instrument; points and vectors are tuples of three.
"""

import math

from tissue_contact.kernels.compiled import inner, kernel

from tissue_contact.kernels.tritri import alone
from tissue_contact.kernels.vectors import dot

OOBB, HULL = 0, 1  # responses: depth by the support of a part's box, or of its convex hull


@kernel
def plane_segment(i1, i2, i3, s1, s2, s3):
    """Ends of the segment in which an instrument triangle cuts the tissue plane.

    ``s1`` to ``s3`` are the signed distances of its corners from the plane, not all of one strict sign and not all
    zero. With I3 the corner that is alone on its side: P1 = I1 + (I3 - I1) s1 / (s1 - s3), P2 likewise from I2.
    """
    k, _ = alone(s1, s2, s3)
    if k == 0:
        i1, i2, i3 = i2, i3, i1
        s1, s2, s3 = s2, s3, s1
    elif k == 1:
        i1, i2, i3 = i3, i1, i2
        s1, s2, s3 = s3, s1, s2
    f = s1 / (s1 - s3)
    g = s2 / (s2 - s3)
    return (
        (i1[0] + (i3[0] - i1[0]) * f, i1[1] + (i3[1] - i1[1]) * f, i1[2] + (i3[2] - i1[2]) * f),
        (i2[0] + (i3[0] - i2[0]) * g, i2[1] + (i3[1] - i2[1]) * g, i2[2] + (i3[2] - i2[2]) * g),
    )


@kernel
def areal(p, t1, u, v, n, nn):
    """Areal coordinates of the foot of p on the plane of the triangle t1, t1 + u, t1 + v; n = u x v, nn = n . n."""
    wx, wy, wz = p[0] - t1[0], p[1] - t1[1], p[2] - t1[2]
    b = ((wy * v[2] - wz * v[1]) * n[0] + (wz * v[0] - wx * v[2]) * n[1] + (wx * v[1] - wy * v[0]) * n[2]) / nn
    c = ((u[1] * wz - u[2] * wy) * n[0] + (u[2] * wx - u[0] * wz) * n[1] + (u[0] * wy - u[1] * wx) * n[2]) / nn
    return 1.0 - b - c, b, c


@kernel
def clip(a, b):
    """Part of a segment within a triangle, both ends given by areal coordinates.

    Returns
    -------
    begin, end : float
        Fractions of the segment; nothing of it lies within where begin > end.
    """
    begin, end = 0.0, 1.0
    for k in range(3):
        d = b[k] - a[k]
        if a[k] < 0.0 and b[k] < 0.0:
            end = -1.0
        elif a[k] < 0.0:
            begin = max(begin, -a[k] / d)
        elif b[k] < 0.0:
            end = min(end, -a[k] / d)
    return begin, end


@inner
def _square(a, uu, uv, vv):
    """Square of the length of a difference of areal coordinates, from the products of the edges u and v."""
    return a[1] * a[1] * uu + 2.0 * a[1] * a[2] * uv + a[2] * a[2] * vv


@inner
def _foot(p, a, b, uu, uv, vv):
    """Point of the segment a b nearest to p, all in areal coordinates."""
    d1, d2 = b[1] - a[1], b[2] - a[2]
    w1, w2 = p[1] - a[1], p[2] - a[2]
    dd = d1 * d1 * uu + 2.0 * d1 * d2 * uv + d2 * d2 * vv
    f = 0.0
    if dd > 0.0:
        f = min(1.0, max(0.0, (w1 * d1 * uu + (w1 * d2 + w2 * d1) * uv + w2 * d2 * vv) / dd))
    return a[0] + f * (b[0] - a[0]), a[1] + f * d1, a[2] + f * d2


@kernel
def nearest(a, b, uu, uv, vv):
    """Point of a triangle nearest to a segment of its plane that does not meet it, in areal coordinates.

    The least distance is between a corner and the segment or between an end of the segment and an edge.
    """
    corners = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    best = math.inf
    out = corners[0]
    for k in range(3):
        corner = corners[k]
        foot = _foot(corner, a, b, uu, uv, vv)
        d = _square((foot[0] - corner[0], foot[1] - corner[1], foot[2] - corner[2]), uu, uv, vv)
        if d < best:
            best, out = d, corner
        for p in (a, b):
            foot = _foot(p, corner, corners[(k + 1) % 3], uu, uv, vv)
            d = _square((foot[0] - p[0], foot[1] - p[1], foot[2] - p[2]), uu, uv, vv)
            if d < best:
                best, out = d, foot
    return out


@kernel
def penetration(p, inner, part, centre, axes, half):
    """Penetration vector D from the point of collision to the box of a part (thesis 3.6.3).

    D = sum over the box axes a of s_a d_a a, with the sign s_a that turns a to the inner side of the tissue and the
    distance d_a from p to the face there. D . inner is exactly the box's support depth below the tissue plane.

    Parameters
    ----------
    p, inner : tuple of three
        Point of collision [m] and the tissue's inner unit normal, body frame.
    part : int
        Which convex part; ``centre``, ``axes``, ``half`` as in `Model`.
    """
    dx, dy, dz = 0.0, 0.0, 0.0
    w = (centre[3 * part] - p[0], centre[3 * part + 1] - p[1], centre[3 * part + 2] - p[2])
    for k in range(3):
        i = 9 * part + 3 * k
        a = (axes[i], axes[i + 1], axes[i + 2])
        s = 1.0 if dot(a, inner) > 0.0 else -1.0
        d = s * (half[3 * part + k] + s * dot(w, a))
        dx += d * a[0]
        dy += d * a[1]
        dz += d * a[2]
    return dx, dy, dz


@kernel
def hull_depth(p, inner, first, last, x, y, z):
    """Support depth [m] of a convex hull, its vertices first to last of x, y, z, below the plane through p.

    The largest of inner . (vertex - p): what `penetration` gives for the box, for the part itself.
    """
    best = -math.inf
    for v in range(first, last):
        best = max(best, inner[0] * x[v] + inner[1] * y[v] + inner[2] * z[v])
    return best - dot(inner, p)


@kernel
def facing(p, outer, part, axis, reach):
    """How far the tissue's outer normal looks to the handle side, as a share of the part's reach, about -1.4 to 1.4.

    (M - p) . n_out / reach; the mark M lies on the shaft axis, at the point nearest to p and the reach further to the
    handle: a mark at the top of the instrument (thesis fig. 3.12) misjudges a shaft that lies along a convex organ.
    """
    i = 6 * part
    t = (axis[i], axis[i + 1], axis[i + 2])
    d = (axis[i + 3] - t[0], axis[i + 4] - t[1], axis[i + 5] - t[2])
    length = math.sqrt(dot(d, d))
    d = (d[0] / length, d[1] / length, d[2] / length)
    along = dot((p[0] - t[0], p[1] - t[1], p[2] - t[2]), d)
    along = min(length, max(0.0, along)) + reach[part]
    m = (t[0] + along * d[0] - p[0], t[1] + along * d[1] - p[1], t[2] + along * d[2] - p[2])
    return dot(m, outer) / reach[part]
