"""Explicit schemes (model section 2): explicit Euler, as in the thesis, and the classical 4th-order Runge–Kutta.

Both take every force, damping included, at the moment where it is evaluated.
"""

from tissue_contact.kernels.compiled import inner
from tissue_contact.kernels.forces import add_pulse, clear_contacts, contact_forces, tissue_forces
from tissue_contact.kernels.slots import (
    AREAL_DENSITY,
    DAMPING_SCALE,
    DRAG,
    SUPPORT_DAMPING,
    SUPPORT_STIFFNESS,
    TISSUE_PARAMETERS,
)
from tissue_contact.kernels.springs import damp_product, directions
from tissue_contact.kernels.start import keep_start, parts


@inner
def _accelerate(model, parameters, state, scratch, tau):
    """Turn the forces in scratch.fx, fy, fz into accelerations [m/s²], with support, weight and dampers.

    What the dampers take in a time tau [s] is added to scratch.loss.
    """
    n = state.x.size
    g = model.gravity
    for tissue in range(model.tissue_rate.size):
        own = TISSUE_PARAMETERS * tissue
        first, last = model.tissue_vertex_start[tissue], model.tissue_vertex_start[tissue + 1]
        density = parameters[own + AREAL_DENSITY]
        support = parameters[own + SUPPORT_STIFFNESS] / density
        c = parameters[own + DRAG] + parameters[own + SUPPORT_DAMPING]
        damped = scratch.unit_x.size > 0 and parameters[own + DAMPING_SCALE] > 0.0
        p, q = scratch.solve[: 3 * n], scratch.solve[3 * n : 6 * n]
        if damped:
            s_first, s_last = model.tissue_spring_start[tissue], model.tissue_spring_start[tissue + 1]
            for v in range(first, last):
                p[v], p[n + v], p[2 * n + v] = state.vx[v], state.vy[v], state.vz[v]
            directions(
                s_first,
                s_last,
                model.spring_i,
                model.spring_j,
                state.x,
                state.y,
                state.z,
                scratch.unit_x,
                scratch.unit_y,
                scratch.unit_z,
            )
            damp_product(
                first,
                last,
                s_first,
                s_last,
                model.spring_i,
                model.spring_j,
                model.spring_damping,
                parameters[own + DAMPING_SCALE],
                scratch.unit_x,
                scratch.unit_y,
                scratch.unit_z,
                model.node_free,
                p,
                q,
                n,
            )
        for v in range(first, last):
            vx, vy, vz = state.vx[v], state.vy[v], state.vz[v]
            scratch.loss[v] += tau * c * model.node_area[v] * (vx * vx + vy * vy + vz * vz)
            if damped:
                scratch.fx[v] -= q[v]
                scratch.fy[v] -= q[n + v]
                scratch.fz[v] -= q[2 * n + v]
                scratch.loss[v] += tau * (vx * q[v] + vy * q[n + v] + vz * q[2 * n + v])
            f, free = model.node_mobility[v] / density, model.node_free[v]
            drag = c / density
            scratch.fx[v] = f * scratch.fx[v] + (g[0] - support * (state.x[v] - model.rest_x[v]) - drag * vx) * free
            scratch.fy[v] = f * scratch.fy[v] + (g[1] - support * (state.y[v] - model.rest_y[v]) - drag * vy) * free
            scratch.fz[v] = f * scratch.fz[v] + (g[2] - support * (state.z[v] - model.rest_z[v]) - drag * vz) * free


@inner
def explicit_euler(model, parameters, state, scratch, dt):
    """x' = x + dt v, v' = v + dt a, under the forces in scratch.fx, fy, fz."""
    _accelerate(model, parameters, state, scratch, dt)
    for v in range(state.x.size):
        state.x[v] += dt * state.vx[v]
        state.y[v] += dt * state.vy[v]
        state.z[v] += dt * state.vz[v]
        state.vx[v] += dt * scratch.fx[v]
        state.vy[v] += dt * scratch.fy[v]
        state.vz[v] += dt * scratch.fz[v]


@inner
def runge_kutta(model, parameters, state, scratch, elapsed, dt):
    """One substep of the classical scheme of order 4, from elapsed [s] after the last communication point.

    scratch.start holds places and velocities at the beginning, scratch.slope the sums of the weighted slopes.
    """
    n = state.x.size
    start_x, start_y, start_z, start_vx, start_vy, start_vz = parts(scratch.start, n)
    slope_x, slope_y, slope_z, slope_vx, slope_vy, slope_vz = parts(scratch.slope, n)
    keep_start(state, scratch)
    scratch.slope[:] = 0.0
    node, weight, way = (0.0, 0.5, 0.5, 1.0), (1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0), (0.5, 0.5, 1.0, 0.0)
    for s in range(4):
        tissue_forces(model, parameters, state, scratch)
        clear_contacts(state, scratch)
        contact_forces(model, parameters, state, scratch, elapsed + node[s] * dt, weight[s] * dt, False)
        add_pulse(scratch, weight[s] * dt)
        _accelerate(model, parameters, state, scratch, weight[s] * dt)
        b, c = weight[s], way[s] * dt
        for v in range(n):
            vx, vy, vz = state.vx[v], state.vy[v], state.vz[v]
            slope_x[v] += b * vx
            slope_y[v] += b * vy
            slope_z[v] += b * vz
            slope_vx[v] += b * scratch.fx[v]
            slope_vy[v] += b * scratch.fy[v]
            slope_vz[v] += b * scratch.fz[v]
            state.x[v] = start_x[v] + c * vx
            state.y[v] = start_y[v] + c * vy
            state.z[v] = start_z[v] + c * vz
            state.vx[v] = start_vx[v] + c * scratch.fx[v]
            state.vy[v] = start_vy[v] + c * scratch.fy[v]
            state.vz[v] = start_vz[v] + c * scratch.fz[v]
    for v in range(n):
        state.x[v] = start_x[v] + dt * slope_x[v]
        state.y[v] = start_y[v] + dt * slope_y[v]
        state.z[v] = start_z[v] + dt * slope_z[v]
        state.vx[v] = start_vx[v] + dt * slope_vx[v]
        state.vy[v] = start_vy[v] + dt * slope_vy[v]
        state.vz[v] = start_vz[v] + dt * slope_vz[v]
