"""Where and how deep a pair of triangles collides: point of collision, penetration vector (thesis 3.6.2, 3.6.3).

All in the body frame of the instrument; points and vectors are tuples of three.
"""

import math

from tissue_contact.kernels.compiled import inner, kernel, pointwise
from tissue_contact.kernels.tritri import alone
from tissue_contact.kernels.vectors import dot

# What Model.contact_response says: depth by the support of a polytope (box, k-DOP or hull), as the thesis has it, by
# the intersecting triangles alone, or in a distance field, at points of the tissue or of another body.
POLYTOPE, LITERAL, PRIMITIVE, FIELD, BODIES = 0, 1, 2, 3, 4


@inner
def _edges(model, body):
    """Lengths of the box of a body in its frame [m]."""
    k = 3 * body
    return (
        model.body_high[k] - model.body_low[k],
        model.body_high[k + 1] - model.body_low[k + 1],
        model.body_high[k + 2] - model.body_low[k + 2],
    )


@inner
def body_size(model, body):
    """Diagonal of the box of a body [m]: no two of its points are farther apart."""
    edges = _edges(model, body)
    return math.sqrt(dot(edges, edges))


@inner
def body_face(model, body):
    """Area of the greatest face of the box of a body [m²]."""
    a, b, c = _edges(model, body)
    return max(a * b, b * c, c * a)


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


@inner
def pair_point(model, u, t1, e1, e2, n, nn):
    """Point of collision of instrument triangle u on a tissue triangle, as areal coordinates, and the curve's length.

    The tissue triangle is t1, t1 + e1, t1 + e2 in the body frame, n = e1 x e2, nn = n . n. The middle of the clipped
    segment; where rounding leaves nothing of the segment, the nearest point of the triangle, with length 0; where the
    instrument triangle does not cross the plane but for rounding, its middle takes the segment's place.
    """
    a, b, c = model.body_a[u], model.body_b[u], model.body_c[u]
    i1 = (model.body_x[a], model.body_y[a], model.body_z[a])
    i2 = (model.body_x[b], model.body_y[b], model.body_z[b])
    i3 = (model.body_x[c], model.body_y[c], model.body_z[c])
    s1 = dot(n, (i1[0] - t1[0], i1[1] - t1[1], i1[2] - t1[2]))
    s2 = dot(n, (i2[0] - t1[0], i2[1] - t1[1], i2[2] - t1[2]))
    s3 = dot(n, (i3[0] - t1[0], i3[1] - t1[1], i3[2] - t1[2]))
    if min(s1, s2, s3) > 0.0 or max(s1, s2, s3) < 0.0 or (s1 == 0.0 and s2 == 0.0 and s3 == 0.0):
        p1 = (
            (i1[0] + i2[0] + i3[0]) / 3.0,
            (i1[1] + i2[1] + i3[1]) / 3.0,
            (i1[2] + i2[2] + i3[2]) / 3.0,
        )
        p2 = p1
    else:
        p1, p2 = plane_segment(i1, i2, i3, s1, s2, s3)
    f = areal(p1, t1, e1, e2, n, nn)
    g = areal(p2, t1, e1, e2, n, nn)
    begin, end = clip(f, g)
    if begin > end:
        return nearest(f, g, dot(e1, e1), dot(e1, e2), dot(e2, e2)), 0.0
    middle = 0.5 * (begin + end)
    d = (p2[0] - p1[0], p2[1] - p1[1], p2[2] - p1[2])
    return (
        (f[0] + middle * (g[0] - f[0]), f[1] + middle * (g[1] - f[1]), f[2] + middle * (g[2] - f[2])),
        (end - begin) * dot(d, d) ** 0.5,
    )


@kernel
def penetration(p, inward, part, centre, axes, half):
    """Penetration vector D from the point of collision to the box of a part (thesis 3.6.3).

    D = sum over the box axes a of s_a d_a a, with the sign s_a that turns a to the inner side of the tissue and the
    distance d_a from p to the face there. D . inward is exactly the box's support depth below the tissue plane.

    Parameters
    ----------
    p, inward : tuple of three
        Point of collision [m] and the tissue's inner unit normal, body frame.
    part : int
        Which convex part; ``centre``, ``axes``, ``half`` as in `Model`.
    """
    dx, dy, dz = 0.0, 0.0, 0.0
    w = (centre[3 * part] - p[0], centre[3 * part + 1] - p[1], centre[3 * part + 2] - p[2])
    for k in range(3):
        i = 9 * part + 3 * k
        a = (axes[i], axes[i + 1], axes[i + 2])
        s = 1.0 if dot(a, inward) > 0.0 else -1.0
        d = s * (half[3 * part + k] + s * dot(w, a))
        dx += d * a[0]
        dy += d * a[1]
        dz += d * a[2]
    return dx, dy, dz


@kernel
def support(inward, start, edge_start, neighbour, x, y, z):
    """Vertex of a convex hull that is farthest along a direction, found by climbing from vertex start.

    On a convex polyhedron a vertex without a higher neighbour is the highest.
    """
    best = start
    height = inward[0] * x[best] + inward[1] * y[best] + inward[2] * z[best]
    climbing = True
    while climbing:
        climbing = False
        for k in range(edge_start[best], edge_start[best + 1]):
            v = int(neighbour[k])
            h = inward[0] * x[v] + inward[1] * y[v] + inward[2] * z[v]
            if h > height:
                best, height, climbing = v, h, True
    return best


@pointwise
def shaft(axis, part):
    """The shaft axis of a part of a body: tip end, unit vector to the handle, and length."""
    i = 6 * part
    t = (axis[i], axis[i + 1], axis[i + 2])
    d = (axis[i + 3] - t[0], axis[i + 4] - t[1], axis[i + 5] - t[2])
    length = math.sqrt(dot(d, d))
    return t, (d[0] / length, d[1] / length, d[2] / length), length


@pointwise
def facing(p, outer, axis, reach):
    """How far the tissue's outer normal looks to the handle side, as a share of the part's reach, about -1.4 to 1.4.

    (M - p) . n_out / reach; the mark M lies on the shaft axis, at the point nearest to p and the reach further to the
    handle: a mark at the top of the instrument (thesis fig. 3.12) misjudges a shaft that lies along a convex organ.
    """
    t, d, length = axis
    along = dot((p[0] - t[0], p[1] - t[1], p[2] - t[2]), d)
    along = min(length, max(0.0, along)) + reach
    m = (t[0] + along * d[0] - p[0], t[1] + along * d[1] - p[1], t[2] + along * d[2] - p[2])
    return dot(m, outer) / reach
