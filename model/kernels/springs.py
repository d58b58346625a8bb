"""Forces and energies of the springs (thesis 3.2)."""

import math

from tissue_contact.kernels.compiled import inner, pointwise

COINCIDENT = 1e-300  # [m²] of a length; the inverse of less may overflow


@inner
def add_springs(first, last, i, j, rest, stiffness, scale, x, y, z, fx, fy, fz):
    """Add the elastic forces of springs first to last: f_ij = k (|x_j - x_i| - l) u, u the unit vector i to j."""
    for s in range(first, last):
        a, b = i[s], j[s]
        dx, dy, dz = x[b] - x[a], y[b] - y[a], z[b] - z[a]
        square = dx * dx + dy * dy + dz * dz
        length = math.sqrt(square)
        if square > COINCIDENT:  # else there is no direction to push in
            # |x_j - x_i| over its square, as a division by it would wait for the root
            q = scale * stiffness[s] * ((length - rest[s]) * (length * (1.0 / square)))
            px, py, pz = q * dx, q * dy, q * dz
            fx[a] += px
            fy[a] += py
            fz[a] += pz
            fx[b] -= px
            fy[b] -= py
            fz[b] -= pz


@inner
def add_stiffening_springs(first, last, i, j, rest, stiffness, scale, nonlinearity, x, y, z, fx, fy, fz):
    """Add the forces of springs that stiffen: k (1 + b e²) in the place of k, with strain e = |x_j - x_i| / l - 1."""
    for s in range(first, last):
        a, b = i[s], j[s]
        dx, dy, dz = x[b] - x[a], y[b] - y[a], z[b] - z[a]
        square = dx * dx + dy * dy + dz * dz
        length = math.sqrt(square)
        if square > COINCIDENT:
            strain = length / rest[s] - 1.0
            q = scale * stiffness[s] * (1.0 + nonlinearity * strain * strain)
            q *= (length - rest[s]) * (length * (1.0 / square))
            px, py, pz = q * dx, q * dy, q * dz
            fx[a] += px
            fy[a] += py
            fz[a] += pz
            fx[b] -= px
            fy[b] -= py
            fz[b] -= pz


@inner
def stretch_range(first, last, i, j, rest, x, y, z):
    """Least and greatest length over rest length of springs first to last."""
    least, greatest = math.inf, 0.0
    for s in range(first, last):
        a, b = i[s], j[s]
        dx, dy, dz = x[b] - x[a], y[b] - y[a], z[b] - z[a]
        square = (dx * dx + dy * dy + dz * dz) / (rest[s] * rest[s])
        least, greatest = min(least, square), max(greatest, square)
    return math.sqrt(least), math.sqrt(greatest)


@pointwise
def _longer(s, i, j, rest, x, y, z):
    """Length [m] of a spring beyond its rest length."""
    a, b = i[s], j[s]
    dx, dy, dz = x[b] - x[a], y[b] - y[a], z[b] - z[a]
    return math.sqrt(dx * dx + dy * dy + dz * dz) - rest[s]


@inner
def spring_energy(first, last, i, j, rest, stiffness, scale, x, y, z):
    """Elastic energy [J] of springs first to last, sum of k (|x_j - x_i| - l)²/2."""
    # Four sums: roots of one vector, and no sum waits for the one before.
    total, total1, total2, total3 = 0.0, 0.0, 0.0, 0.0
    s = first
    while s + 4 <= last:
        d, d1 = _longer(s, i, j, rest, x, y, z), _longer(s + 1, i, j, rest, x, y, z)
        d2, d3 = _longer(s + 2, i, j, rest, x, y, z), _longer(s + 3, i, j, rest, x, y, z)
        total += stiffness[s] * d * d
        total1 += stiffness[s + 1] * d1 * d1
        total2 += stiffness[s + 2] * d2 * d2
        total3 += stiffness[s + 3] * d3 * d3
        s += 4
    while s < last:
        d = _longer(s, i, j, rest, x, y, z)
        total += stiffness[s] * d * d
        s += 1
    return 0.5 * scale * ((total + total1) + (total2 + total3))


@inner
def stiffening_energy(first, last, i, j, rest, stiffness, scale, nonlinearity, x, y, z):
    """What springs that stiffen hold beyond `spring_energy` [J], sum of k l² b e⁴/4 with strain e."""
    total = 0.0
    for s in range(first, last):
        d = _longer(s, i, j, rest, x, y, z)
        strain = d / rest[s]
        total += stiffness[s] * d * d * strain * strain
    return 0.25 * scale * nonlinearity * total


@inner
def directions(first, last, i, j, x, y, z, ux, uy, uz):
    """Unit vectors i to j of springs first to last; zero where the ends coincide."""
    for s in range(first, last):
        a, b = i[s], j[s]
        dx, dy, dz = x[b] - x[a], y[b] - y[a], z[b] - z[a]
        length = math.sqrt(dx * dx + dy * dy + dz * dz)
        f = 1.0 / length if length > 0.0 else 0.0
        ux[s] = f * dx
        uy[s] = f * dy
        uz[s] = f * dz


@inner
def damp_product(first, last, s_first, s_last, i, j, damping, scale, ux, uy, uz, free, p, q, n):
    """q = D p for the dampers of the springs, each acting along its unit vector; fixed vertices stay at rest.

    ``p`` and ``q`` hold the n x, then the n y, then the n z components.
    """
    for v in range(first, last):
        q[v] = 0.0
        q[n + v] = 0.0
        q[2 * n + v] = 0.0
    for s in range(s_first, s_last):
        a, b = i[s], j[s]
        rate = (p[b] - p[a]) * ux[s] + (p[n + b] - p[n + a]) * uy[s] + (p[2 * n + b] - p[2 * n + a]) * uz[s]
        f = scale * damping[s] * rate
        q[a] -= f * ux[s]
        q[n + a] -= f * uy[s]
        q[2 * n + a] -= f * uz[s]
        q[b] += f * ux[s]
        q[n + b] += f * uy[s]
        q[2 * n + b] += f * uz[s]
    for v in range(first, last):
        q[v] *= free[v]
        q[n + v] *= free[v]
        q[2 * n + v] *= free[v]
