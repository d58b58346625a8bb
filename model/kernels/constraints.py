"""What resists a change of area and of volume (model section 1): energies of the surface, not of its edges."""

import math

from tissue_contact.kernels.compiled import inner
from tissue_contact.kernels.vectors import cross, dot


@inner
def add_area_forces(first, last, ta, tb, tc, rest_area, stiffness, x, y, z, fx, fy, fz):
    """Add minus the gradient of E = k/2 sum (A - A0)²/A0 over triangles first to last, k in N/m."""
    for t in range(first, last):
        a, b, c = ta[t], tb[t], tc[t]
        u = (x[b] - x[a], y[b] - y[a], z[b] - z[a])
        v = (x[c] - x[a], y[c] - y[a], z[c] - z[a])
        normal = cross(u, v)
        double = math.sqrt(dot(normal, normal))
        if double > 0.0:
            # dA/dx_b = (v x n)/2 and dA/dx_c = (n x u)/2 with the unit normal n; dA/dx_a makes their sum zero.
            f = -0.5 * stiffness * (0.5 * double / rest_area[t] - 1.0) / double
            gb, gc = cross(v, normal), cross(normal, u)
            fx[b] += f * gb[0]
            fy[b] += f * gb[1]
            fz[b] += f * gb[2]
            fx[c] += f * gc[0]
            fy[c] += f * gc[1]
            fz[c] += f * gc[2]
            fx[a] -= f * (gb[0] + gc[0])
            fy[a] -= f * (gb[1] + gc[1])
            fz[a] -= f * (gb[2] + gc[2])


@inner
def largest_growth(first, last, ta, tb, tc, rest_edges, x, y, z):
    """Largest factor, at least 1, by which the sum of the squared edges of a triangle has grown."""
    most = 1.0
    for t in range(first, last):
        a, b, c = ta[t], tb[t], tc[t]
        u = (x[b] - x[a], y[b] - y[a], z[b] - z[a])
        v = (x[c] - x[a], y[c] - y[a], z[c] - z[a])
        w = (v[0] - u[0], v[1] - u[1], v[2] - u[2])
        most = max(most, (dot(u, u) + dot(v, v) + dot(w, w)) / rest_edges[t])
    return most


@inner
def area_energy(first, last, ta, tb, tc, rest_area, stiffness, x, y, z):
    """k/2 sum (A - A0)²/A0 [J] over triangles first to last."""
    total = 0.0
    for t in range(first, last):
        a, b, c = ta[t], tb[t], tc[t]
        normal = cross(
            (x[b] - x[a], y[b] - y[a], z[b] - z[a]),
            (x[c] - x[a], y[c] - y[a], z[c] - z[a]),
        )
        d = 0.5 * math.sqrt(dot(normal, normal)) - rest_area[t]
        total += d * d / rest_area[t]
    return 0.5 * stiffness * total


@inner
def enclosed_volume(first, last, ta, tb, tc, x, y, z):
    """Volume [m³] within the closed surface of triangles first to last, sum of a . (b x c) / 6.

    Taken about the first corner, so that an organ far from the origin keeps its digits.
    """
    if first == last:
        return 0.0
    o = (x[ta[first]], y[ta[first]], z[ta[first]])
    total = 0.0
    for t in range(first, last):
        a, b, c = ta[t], tb[t], tc[t]
        total += dot(
            (x[a] - o[0], y[a] - o[1], z[a] - o[2]),
            cross(
                (x[b] - o[0], y[b] - o[1], z[b] - o[2]),
                (x[c] - o[0], y[c] - o[1], z[c] - o[2]),
            ),
        )
    return total / 6.0


@inner
def add_volume_forces(first, last, ta, tb, tc, pressure, x, y, z, fx, fy, fz):
    """Add a pressure [Pa] from within: pressure times dV/dx_i = sum of x_j x x_k / 6 over the adjacent triangles.

    Written with differences, (x_b - x_a) x (x_c - x_a) / 6 to each corner: on a closed surface it is the same.
    """
    f = pressure / 6.0
    for t in range(first, last):
        a, b, c = ta[t], tb[t], tc[t]
        g = cross(
            (x[b] - x[a], y[b] - y[a], z[b] - z[a]),
            (x[c] - x[a], y[c] - y[a], z[c] - z[a]),
        )
        px, py, pz = f * g[0], f * g[1], f * g[2]
        fx[a] += px
        fy[a] += py
        fz[a] += pz
        fx[b] += px
        fy[b] += py
        fz[b] += pz
        fx[c] += px
        fy[c] += py
        fz[c] += pz
