"""Forces of the mass-spring tissue and their implicit damping (thesis 3.2)."""

import math

from tissue_contact.kernels.compiled import inner


@inner
def add_springs(first, last, i, j, rest, stiffness, scale, x, y, z, fx, fy, fz):
    """Add the elastic forces of springs first to last: f_ij = k (|x_j - x_i| - l) u, u the unit vector i to j."""
    for s in range(first, last):
        a, b = i[s], j[s]
        dx, dy, dz = x[b] - x[a], y[b] - y[a], z[b] - z[a]
        length = math.sqrt(dx * dx + dy * dy + dz * dz)
        if length > 0.0:  # coincident ends have no direction to push in
            q = scale * stiffness[s] * (1.0 - rest[s] / length)
            px, py, pz = q * dx, q * dy, q * dz
            fx[a] += px
            fy[a] += py
            fz[a] += pz
            fx[b] -= px
            fy[b] -= py
            fz[b] -= pz


@inner
def spring_energy(first, last, i, j, rest, stiffness, scale, x, y, z):
    """Elastic energy [J] of springs first to last, sum of k (|x_j - x_i| - l)^2 / 2."""
    total = 0.0
    for s in range(first, last):
        a, b = i[s], j[s]
        dx, dy, dz = x[b] - x[a], y[b] - y[a], z[b] - z[a]
        e = math.sqrt(dx * dx + dy * dy + dz * dz) - rest[s]
        total += stiffness[s] * e * e
    return 0.5 * scale * total


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
