"""Rotations and products of three-vectors, on tuples of scalars."""

import math

from tissue_contact.kernels.compiled import kernel


@kernel
def cross(a, b):
    """Vector product of two tuples of three."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel
def dot(a, b):
    """Scalar product of two tuples of three."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def rotation(q):
    """Rotation matrix of a unit quaternion w, x, y, z (body to world), row after row as a tuple of nine."""
    w, x, y, z = q
    return (
        1 - 2 * (y * y + z * z),
        2 * (x * y - w * z),
        2 * (x * z + w * y),
        2 * (x * y + w * z),
        1 - 2 * (x * x + z * z),
        2 * (y * z - w * x),
        2 * (x * z - w * y),
        2 * (y * z + w * x),
        1 - 2 * (x * x + y * y),
    )


@kernel
def to_world(r, v):
    """Turn a body vector into the world: r v."""
    return (
        r[0] * v[0] + r[1] * v[1] + r[2] * v[2],
        r[3] * v[0] + r[4] * v[1] + r[5] * v[2],
        r[6] * v[0] + r[7] * v[1] + r[8] * v[2],
    )


@kernel
def to_body(r, v):
    """Turn a world vector into the body frame: transposed r times v."""
    return (
        r[0] * v[0] + r[3] * v[1] + r[6] * v[2],
        r[1] * v[0] + r[4] * v[1] + r[7] * v[2],
        r[2] * v[0] + r[5] * v[1] + r[8] * v[2],
    )


@kernel
def quaternion_product(a, b):
    """Hamilton product a b: first turn by b, then by a."""
    return (
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )


@kernel
def turn_between(a, b):
    """Smallest turn from orientation a to b as a world rotation vector [rad], both unit quaternions."""
    w, x, y, z = quaternion_product(b, (a[0], -a[1], -a[2], -a[3]))
    if w < 0.0:
        w, x, y, z = -w, -x, -y, -z
    s = math.sqrt(x * x + y * y + z * z)
    if s == 0.0:
        return 0.0, 0.0, 0.0
    f = 2.0 * math.atan2(s, w) / s
    return f * x, f * y, f * z


@kernel
def turned(q, v):
    """Orientation q after a turn by the world rotation vector v [rad]."""
    angle = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    if angle == 0.0:
        return q
    s = math.sin(0.5 * angle) / angle
    return quaternion_product((math.cos(0.5 * angle), s * v[0], s * v[1], s * v[2]), q)
