"""Signed distance phi of a point from a part of a rigid body, negative inside, and the exact gradient of what is given.

All in the body frame. A part has one field, by its kind:

- `CAPSULE`, values a(3), b(3), r: phi = |p - foot of p on the segment a b| - r; a = b is a sphere.
- `BOX`, values centre(3), axes(9, in rows), half(3): with e_k = |axis_k . (p - centre)| - half_k, phi = |max(e, 0)|
  outside, the largest e_k inside.
- `CYLINDER`, values a(3), b(3), r: flat ends; the same with the excess over the radius and over the half length.
- `GRID`, values of the nodes in C order: phi = sum over the 27 nodes about p of c B(x) B(y) B(z), with quadratic
  B-splines B. Once continuously differentiable, so that normals are smooth.

After Hirota (thesis 2.1.2); the field is that of the instrument, which is rigid, so it never goes stale.
"""

import math

import numpy as np

from tissue_contact.kernels.compiled import inner, pointwise
from tissue_contact.kernels.vectors import dot

NONE, CAPSULE, BOX, CYLINDER, GRID = 0, 1, 2, 3, 4
LANES = 4  # points of a triangle from which on vectors pay
FAR = 1e30  # [m] phi where a part has no field: beyond every depth and gap, its square still finite


@pointwise
def _three(value, i):
    return value[i], value[i + 1], value[i + 2]


@pointwise
def _less(a, b):
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@pointwise
def _capsule(a, b, r, p):
    w, d = _less(p, a), _less(b, a)
    dd = dot(d, d)
    f = min(1.0, max(0.0, dot(w, d) / dd)) if dd > 0.0 else 0.0
    x, y, z = w[0] - f * d[0], w[1] - f * d[1], w[2] - f * d[2]
    length = math.sqrt(x * x + y * y + z * z)
    g = 1.0 / length if length > 0.0 else 0.0
    return length - r, g * x, g * y, g * z


@pointwise
def _sign(x):
    return 1.0 if x > 0.0 else (-1.0 if x < 0.0 else 0.0)


@pointwise
def _box(value, i, p):
    w = _less(p, _three(value, i))
    a, b, c = _three(value, i + 3), _three(value, i + 6), _three(value, i + 9)
    x, y, z = dot(w, a), dot(w, b), dot(w, c)
    e, f, g = abs(x) - value[i + 12], abs(y) - value[i + 13], abs(z) - value[i + 14]
    if max(e, f, g) > 0.0:
        e, f, g = max(e, 0.0), max(f, 0.0), max(g, 0.0)
        phi = math.sqrt(e * e + f * f + g * g)
        e, f, g = e / phi, f / phi, g / phi
    else:
        phi = max(e, f, g)
        e, f, g = (1.0, 0.0, 0.0) if e == phi else ((0.0, 1.0, 0.0) if f == phi else (0.0, 0.0, 1.0))
    e, f, g = e * _sign(x), f * _sign(y), g * _sign(z)
    return (
        phi,
        e * a[0] + f * b[0] + g * c[0],
        e * a[1] + f * b[1] + g * c[1],
        e * a[2] + f * b[2] + g * c[2],
    )


@pointwise
def _cylinder(value, i, p):
    a, b, r = _three(value, i), _three(value, i + 3), value[i + 6]
    w, d = _less(p, a), _less(b, a)
    length = math.sqrt(dot(d, d))
    d = (d[0] / length, d[1] / length, d[2] / length)
    along = dot(w, d)
    x, y, z = w[0] - along * d[0], w[1] - along * d[1], w[2] - along * d[2]
    radial = math.sqrt(x * x + y * y + z * z)
    along -= 0.5 * length
    e, f = radial - r, abs(along) - 0.5 * length
    if max(e, f) > 0.0:
        e, f = max(e, 0.0), max(f, 0.0)
        phi = math.sqrt(e * e + f * f)
        e, f = e / phi, f / phi
    else:
        phi = max(e, f)
        e, f = (1.0, 0.0) if e == phi else (0.0, 1.0)
    e = e / radial if radial > 0.0 else 0.0
    f *= _sign(along)
    return phi, e * x + f * d[0], e * y + f * d[1], e * z + f * d[2]


@pointwise
def _weights(t):
    """Quadratic B-splines of three nodes at t from the middle one, -1/2 to 1/2 spacings, and their slopes."""
    a, b = 0.5 - t, 0.5 + t
    return (0.5 * a * a, 0.75 - t * t, 0.5 * b * b), (-a, -2.0 * t, b)


@pointwise
def _grid(value, i, size, low, h, p):
    nx, ny, nz = size
    x, y, z = (p[0] - low[0]) / h + 0.5, (p[1] - low[1]) / h + 0.5, (p[2] - low[2]) / h + 0.5
    # Where a node of the 27 is missing; not-a-number too, as none of these comparisons holds for it.
    if not (1.0 <= x < nx - 1.0 and 1.0 <= y < ny - 1.0 and 1.0 <= z < nz - 1.0):
        return FAR, 0.0, 0.0, 0.0
    ix, iy, iz = int(x), int(y), int(z)
    fx, gx = _weights(x - ix - 0.5)
    fy, gy = _weights(y - iy - 0.5)
    fz, gz = _weights(z - iz - 0.5)
    first = np.uint64(i + ((ix - 1) * ny + iy - 1) * nz + iz - 1)
    phi, dx, dy, dz = 0.0, 0.0, 0.0, 0.0
    for j in range(3):
        s, sy, sz = 0.0, 0.0, 0.0
        for k in range(3):
            row = first + np.uint64((j * ny + k) * nz)
            a, b, c = _three(value, row)
            line = fz[0] * a + fz[1] * b + fz[2] * c
            s += fy[k] * line
            sy += gy[k] * line
            sz += fy[k] * (gz[0] * a + gz[1] * b + gz[2] * c)
        phi += fx[j] * s
        dx += gx[j] * s
        dy += fx[j] * sy
        dz += fx[j] * sz
    return phi, dx / h, dy / h, dz / h


@inner
def fields_of(model):
    """The arrays of all distance fields, as `part_distance` and `body_distance` want them."""
    return (
        model.part_field,
        model.field_start,
        model.field_value,
        model.field_size,
        model.field_low,
        model.field_spacing,
    )


@pointwise
def part_distance(fields, part, p):
    """Signed distance [m] of a point from one part, and its gradient (the outer normal, of unit length but for a grid).

    The gradient is 0 where there is none to choose: on the axis of a capsule, at the middle of a box or a cylinder.
    Within a box or a cylinder, where two faces are equally near, it is that of one of them.

    Parameters
    ----------
    fields : tuple of six arrays
        From `fields_of`.
    part : int
        Which part.
    p : tuple of three
        [m], body frame. Not-a-number gives a phi that is not-a-number or `FAR`.

    Returns
    -------
    phi, gx, gy, gz : float
        `FAR` with gradient 0 where the part has no field or its grid does not reach.
    """
    kinds, start, value, sizes, lows, spacings = fields
    kind, i = kinds[part], start[part]
    if kind == GRID:
        size, low = _three(sizes, 3 * part), _three(lows, 3 * part)
        return _grid(value, i, size, low, spacings[part], p)
    if kind == CAPSULE:
        return _capsule(_three(value, i), _three(value, i + 3), value[i + 6], p)
    if kind == BOX:
        return _box(value, i, p)
    if kind == CYLINDER:
        return _cylinder(value, i, p)
    return FAR, 0.0, 0.0, 0.0


@pointwise
def body_distance(fields, first_part, last_part, p):
    """Signed distance [m] of a point from the union of the parts first_part to last_part - 1: the least of theirs.

    Exact outside; where parts overlap, the depth below the nearest surface of one part. Results as `part_distance`.
    """
    out = (FAR, 0.0, 0.0, 0.0)
    for part in range(first_part, last_part):
        found = part_distance(fields, part, p)
        if found[0] < out[0]:
            out = found
    return out


@pointwise
def _point(u, v, w, wa, wb, wc):
    """Point of a triangle, by areal coordinates."""
    return (
        wa * u[0] + wb * v[0] + wc * w[0],
        wa * u[1] + wb * v[1] + wc * w[1],
        wa * u[2] + wb * v[2] + wc * w[2],
    )


@inner
def triangle_distances(fields, first_part, last_part, u, v, w, wa, wb, wc, phi, gx, gy, gz):
    """`body_distance` of all points of a triangle, in vectors from parts that are capsules.

    Parameters
    ----------
    u, v, w : tuple of three
        Corners of the triangle [m], body frame.
    wa, wb, wc : float64 arrays, shape (n,)
        Areal coordinates of the points.
    phi, gx, gy, gz : float64 arrays, shape (n,) or more
        The results.
    """
    kinds, start, value, _, _, _ = fields
    for q in range(wa.size):
        phi[q], gx[q], gy[q], gz[q] = FAR, 0.0, 0.0, 0.0
    for part in range(first_part, last_part):
        i = start[part]
        if kinds[part] == CAPSULE and wa.size >= LANES:
            a, b, r = _three(value, i), _three(value, i + 3), value[i + 6]
            for q in range(wa.size):
                found = _capsule(a, b, r, _point(u, v, w, wa[q], wb[q], wc[q]))
                closer = found[0] < phi[q]
                gx[q] = found[1] if closer else gx[q]
                gy[q] = found[2] if closer else gy[q]
                gz[q] = found[3] if closer else gz[q]
                phi[q] = found[0] if closer else phi[q]
            continue
        for q in range(wa.size):
            found = part_distance(fields, part, _point(u, v, w, wa[q], wb[q], wc[q]))
            if found[0] < phi[q]:
                phi[q], gx[q], gy[q], gz[q] = found
