"""A step as one writes it first: a loop over the springs, a loop over the vertices, nothing else.

What the step of the FMU is measured against in `make peers`. Symplectic Euler on arrays of their own for every
coordinate, and a capsule that pushes on vertices by their distance from its axis. No energy is accounted for, nothing
is checked, and a capsule that passes a triangle between its vertices is not felt.
"""

import math
from typing import NamedTuple

import numpy as np

from tissue_contact.kernels.compiled import kernel
from tissue_contact.kernels.layout import Index, Model, Real, State


class Sheet(NamedTuple):
    """A sheet of masses and springs."""

    i: Index  # shape [S], ends of the springs: unsigned, or numba would look for negative ones at every access
    j: Index  # shape [S]
    rest: Real  # [m], shape [S]
    stiffness: Real  # [N/m], shape [S]
    area: Real  # [m²], shape [V]
    free: Real  # [1], shape [V], 0 where fixed
    x: Real  # [m], shape [V]
    y: Real
    z: Real
    vx: Real  # [m/s], shape [V]
    vy: Real
    vz: Real
    fx: Real  # [N], shape [V]
    fy: Real
    fz: Real


class Material(NamedTuple):
    """Constants of a sheet and of its contact."""

    density: float  # [kg/m²]
    drag: float  # [N·s/m³]
    stiffness_per_area: float  # [N/m³]
    damping_per_area: float  # [N·s/m³]
    radius: float  # [m] of the capsule
    length: float  # [m] of the capsule over all


def sheet_of(model: Model, state: State) -> Sheet:
    """Sheet at rest with the springs and masses of an assembled scene of one tissue."""
    return Sheet(
        model.spring_i,
        model.spring_j,
        model.spring_rest,
        model.spring_stiffness,
        model.node_area,
        model.node_free,
        state.x.copy(),
        state.y.copy(),
        state.z.copy(),
        *np.zeros((6, state.x.size)),
    )


@kernel
def advance(sheet, material, tip, axis, velocity, h, substeps):  # type: ignore[no-untyped-def]
    """Advance the sheet by h [s] in equal substeps while the capsule moves on, keeping its axis.

    ``tip`` [m] is the capsule's lowest point at the start, ``axis`` the direction from there to its other end,
    ``velocity`` [m/s] the capsule's.
    """
    i, j, rest, stiffness, area, free, x, y, z, vx, vy, vz, fx, fy, fz = sheet
    density, drag, contact_stiffness, contact_damping, radius, length = material
    dt = h / substeps
    damped = 1.0 / (1.0 + dt * drag / density)
    taken = 1.0 - 1.0 / (1.0 + dt * contact_damping / density)
    for n in range(substeps):
        for v in range(x.size):
            fx[v] = 0.0
            fy[v] = 0.0
            fz[v] = 0.0
        for s in range(i.size):
            a, b = i[s], j[s]
            dx, dy, dz = x[b] - x[a], y[b] - y[a], z[b] - z[a]
            q = stiffness[s] * (1.0 - rest[s] / math.sqrt(dx * dx + dy * dy + dz * dz))
            fx[a] += q * dx
            fy[a] += q * dy
            fz[a] += q * dz
            fx[b] -= q * dx
            fy[b] -= q * dy
            fz[b] -= q * dz
        px = tip[0] + n * dt * velocity[0]
        py = tip[1] + n * dt * velocity[1]
        pz = tip[2] + n * dt * velocity[2]
        for v in range(x.size):
            f = dt / (density * area[v])
            vx[v] = damped * (vx[v] + f * fx[v]) * free[v]
            vy[v] = damped * (vy[v] + f * fy[v]) * free[v]
            vz[v] = damped * (vz[v] + f * fz[v]) * free[v]
            dx, dy, dz = x[v] - px, y[v] - py, z[v] - pz
            along = min(max(dx * axis[0] + dy * axis[1] + dz * axis[2], radius), length - radius)
            dx, dy, dz = dx - along * axis[0], dy - along * axis[1], dz - along * axis[2]
            square = dx * dx + dy * dy + dz * dz
            if 0.0 < square < radius * radius and free[v] > 0.0:
                distance = math.sqrt(square)
                nx, ny, nz = dx / distance, dy / distance, dz / distance
                kick = dt * contact_stiffness * (radius - distance) / density
                # The damper at the velocity it ends with, so that no damping is too stiff.
                relative = (vx[v] - velocity[0]) * nx + (vy[v] - velocity[1]) * ny + (vz[v] - velocity[2]) * nz
                kick -= taken * (relative + kick)
                vx[v] += kick * nx
                vy[v] += kick * ny
                vz[v] += kick * nz
            x[v] += dt * vx[v]
            y[v] += dt * vy[v]
            z[v] += dt * vz[v]
