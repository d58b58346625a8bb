"""Symplectic Euler with implicit damping (model section 2).

A substep: v* = v + dt f(x)/m, then (M (1 + dt c/rho) + dt D) v' = M v*, then x' = x + dt v'. Without dampers in the
springs (D = 0) the middle step is one factor a vertex; with them it is solved by conjugate gradients in the inner
product of the masses, which keeps linear and angular momentum whatever the number of iterations.
"""

from tissue_contact.kernels.compiled import inner
from tissue_contact.kernels.slots import (
    AREAL_DENSITY,
    DAMPING_SCALE,
    DRAG,
    SUPPORT_DAMPING,
    SUPPORT_STIFFNESS,
    TISSUE_PARAMETERS,
)
from tissue_contact.kernels.springs import damp_product, directions

# Conjugate gradients stop when the residual has fallen by this factor: damping forces are then exact to well below
# the error of the substep, and fewer than ten iterations do for a damper whose own rate is of the order of 1/dt.
RESIDUAL = 1e-6
ITERATIONS = 200


@inner
def advance(
    first, last, dt, travel, factor, density, support, gravity, rest_x, rest_y, rest_z, area, free, mobility,
    fx, fy, fz, x, y, z, vx, vy, vz, loss, lossy,
):  # fmt: skip
    """Kick, damp and drift vertices first to last of a tissue.

    ``travel`` is dt, or 0 where the springs are damped: then the velocities must be solved for before the drift.
    ``factor`` is 1 / (1 + dt c/rho) for the drag and support dampers c together [N·s/m³]; ``support`` is the stiffness
    of the support over the density [1/s²]. Where ``lossy``, what the dampers take in their way, dt c v'², is added to
    ``loss`` [J].
    """
    per_mass = dt / density
    pull = dt * support
    gx, gy, gz = dt * gravity[0], dt * gravity[1], dt * gravity[2]
    for i in range(first, last):
        f = per_mass * mobility[i]
        ux = (vx[i] + f * fx[i] - pull * (x[i] - rest_x[i]) + gx) * free[i]
        uy = (vy[i] + f * fy[i] - pull * (y[i] - rest_y[i]) + gy) * free[i]
        uz = (vz[i] + f * fz[i] - pull * (z[i] - rest_z[i]) + gz) * free[i]
        vx[i] = factor * ux
        vy[i] = factor * uy
        vz[i] = factor * uz
        x[i] += travel * vx[i]
        y[i] += travel * vy[i]
        z[i] += travel * vz[i]
        if lossy:
            loss[i] += density * area[i] * factor * (1.0 - factor) * (ux * ux + uy * uy + uz * uz)


@inner
def damp_springs(
    first, last, s_first, s_last, dt, density, drag, i, j, damping, scale, x, y, z, ux, uy, uz, area, free, mobility,
    vx, vy, vz, solve, loss,
):  # fmt: skip
    """Solve (M (1 + dt c/rho) + dt D) v' = M v for the velocities of one tissue, in place.

    ``drag`` is c/rho [1/s], ``damping`` and ``scale`` give the dampers of the springs, ``solve`` lends room for the
    residual, the direction, its image and the first velocities. What the dampers take in their way,
    v'^T M (v - v') = dt v'^T (c + D) v', is added to ``loss`` [J].
    """
    n = area.size
    r, p, q, u = solve[: 3 * n], solve[3 * n : 6 * n], solve[6 * n : 9 * n], solve[9 * n :]
    directions(s_first, s_last, i, j, x, y, z, ux, uy, uz)
    for v in range(first, last):
        p[v] = vx[v]
        p[n + v] = vy[v]
        p[2 * n + v] = vz[v]
        u[v], u[n + v], u[2 * n + v] = vx[v], vy[v], vz[v]
    damp_product(first, last, s_first, s_last, i, j, damping, scale, ux, uy, uz, free, p, q, n)
    rho = 0.0
    for v in range(first, last):
        m = density * area[v]
        for k in range(3):
            e = k * n + v
            r[e] = -dt * (drag * m * p[e] + q[e])
            p[e] = r[e] * mobility[v] / density
            rho += r[e] * p[e]
    target = RESIDUAL * RESIDUAL * rho
    iteration = 0
    while rho > target and rho > 0.0 and iteration < ITERATIONS:
        damp_product(first, last, s_first, s_last, i, j, damping, scale, ux, uy, uz, free, p, q, n)
        curvature = 0.0
        for v in range(first, last):
            m = (1.0 + dt * drag) * density * area[v]
            for k in range(3):
                e = k * n + v
                q[e] = m * p[e] + dt * q[e]
                curvature += p[e] * q[e]
        alpha = rho / curvature
        before = rho
        rho = 0.0
        for v in range(first, last):
            f = mobility[v] / density
            vx[v] += alpha * p[v]
            vy[v] += alpha * p[n + v]
            vz[v] += alpha * p[2 * n + v]
            for k in range(3):
                e = k * n + v
                r[e] -= alpha * q[e]
                rho += r[e] * r[e] * f
        beta = rho / before
        for v in range(first, last):
            f = mobility[v] / density
            for k in range(3):
                e = k * n + v
                p[e] = r[e] * f + beta * p[e]
        iteration += 1
    for v in range(first, last):
        taken = vx[v] * (u[v] - vx[v]) + vy[v] * (u[n + v] - vy[v]) + vz[v] * (u[2 * n + v] - vz[v])
        loss[v] += density * area[v] * taken


@inner
def drift(first, last, dt, x, y, z, vx, vy, vz):
    """x' = x + dt v'."""
    for i in range(first, last):
        x[i] += dt * vx[i]
        y[i] += dt * vy[i]
        z[i] += dt * vz[i]


@inner
def symplectic_euler(model, parameters, state, scratch, dt):
    """One substep of all the tissues under the forces in scratch.fx, fy, fz."""
    for n in range(model.tissue_rate.size):
        own = TISSUE_PARAMETERS * n
        first, last = model.tissue_vertex_start[n], model.tissue_vertex_start[n + 1]
        density = parameters[own + AREAL_DENSITY]
        drag = (parameters[own + DRAG] + parameters[own + SUPPORT_DAMPING]) / density
        damped = scratch.solve.size > 0 and parameters[own + DAMPING_SCALE] > 0.0
        advance(
            first,
            last,
            dt,
            0.0 if damped else dt,
            1.0 if damped else 1.0 / (1.0 + dt * drag),
            density,
            parameters[own + SUPPORT_STIFFNESS] / density,
            model.gravity,
            model.rest_x,
            model.rest_y,
            model.rest_z,
            model.node_area,
            model.node_free,
            model.node_mobility,
            scratch.fx,
            scratch.fy,
            scratch.fz,
            state.x,
            state.y,
            state.z,
            state.vx,
            state.vy,
            state.vz,
            scratch.loss,
            drag > 0.0 and not damped,
        )
        if damped:
            damp_springs(
                first,
                last,
                model.tissue_spring_start[n],
                model.tissue_spring_start[n + 1],
                dt,
                density,
                drag,
                model.spring_i,
                model.spring_j,
                model.spring_damping,
                parameters[own + DAMPING_SCALE],
                state.x,
                state.y,
                state.z,
                scratch.unit_x,
                scratch.unit_y,
                scratch.unit_z,
                model.node_area,
                model.node_free,
                model.node_mobility,
                state.vx,
                state.vy,
                state.vz,
                scratch.solve,
                scratch.loss,
            )
            drift(first, last, dt, state.x, state.y, state.z, state.vx, state.vy, state.vz)
