"""Implicit Euler: M (v' - v) = dt f(x + dt v', v'), by Newton iterations, each solved with conjugate gradients.

The linear system is kept positive definite: of a spring only what pulls back counts, of area and volume the
Gauss–Newton part, of a contact its own slopes. Where a Newton step makes the residual larger it is halved.
"""

import math

from tissue_contact.kernels.compiled import inner
from tissue_contact.kernels.forces import clear_contacts, contact_forces, tissue_forces
from tissue_contact.kernels.slots import (
    AREA_STIFFNESS,
    AREAL_DENSITY,
    DAMPING_SCALE,
    DRAG,
    NONLINEARITY,
    STIFFNESS_SCALE,
    SUPPORT_DAMPING,
    SUPPORT_STIFFNESS,
    TISSUE_PARAMETERS,
    VOLUME_STIFFNESS,
)
from tissue_contact.kernels.springs import damp_product
from tissue_contact.kernels.start import keep_start, parts, place
from tissue_contact.kernels.vectors import cross, dot

NEWTON = 12  # iterations at most
RESIDUAL = 1e-6  # of the first residual, at which the iteration ends: far below the error of the scheme
FLOOR = 1e-24  # [J], square of a residual over the masses, below which there is nothing to solve
HALVINGS = 4
FORCING = 1e-2  # of a Newton step's residual, to which its linear system is solved
CONJUGATE = 200  # iterations of one solve at most


@inner
def _tangents(model, parameters, state, scratch, tissue):
    """Directions of a tissue's springs and their stiffness along and across them [N/m], never negative."""
    own = TISSUE_PARAMETERS * tissue
    scale, nonlinearity = parameters[own + STIFFNESS_SCALE], parameters[own + NONLINEARITY]
    for s in range(model.tissue_spring_start[tissue], model.tissue_spring_start[tissue + 1]):
        a, b = model.spring_i[s], model.spring_j[s]
        dx, dy, dz = state.x[b] - state.x[a], state.y[b] - state.y[a], state.z[b] - state.z[a]
        length = math.sqrt(dx * dx + dy * dy + dz * dz)
        f = 1.0 / length if length > 0.0 else 0.0
        strain = length / model.spring_rest[s] - 1.0
        k = scale * model.spring_stiffness[s]
        scratch.unit_x[s], scratch.unit_y[s], scratch.unit_z[s] = f * dx, f * dy, f * dz
        scratch.along[s] = k * (1.0 + 3.0 * nonlinearity * strain * strain)
        across = k * (1.0 + nonlinearity * strain * strain) * (1.0 - model.spring_rest[s] * f)
        scratch.across[s] = max(0.0, across)


@inner
def _volume_gradient(model, state, tissue, n, out):
    """dV/dx [m²] of a closed organ's vertices into out."""
    for v in range(model.tissue_vertex_start[tissue], model.tissue_vertex_start[tissue + 1]):
        out[v] = 0.0
        out[n + v] = 0.0
        out[2 * n + v] = 0.0
    x, y, z = state.x, state.y, state.z
    for t in range(model.tissue_triangle_start[tissue], model.tissue_triangle_start[tissue + 1]):
        a, b, c = model.triangle_a[t], model.triangle_b[t], model.triangle_c[t]
        g = cross(
            (x[b] - x[a], y[b] - y[a], z[b] - z[a]),
            (x[c] - x[a], y[c] - y[a], z[c] - z[a]),
        )
        for v in (a, b, c):
            out[v] += g[0] / 6.0
            out[n + v] += g[1] / 6.0
            out[2 * n + v] += g[2] / 6.0


@inner
def _stiffness_product(model, parameters, state, scratch, tissue, n, factor, p, q):
    """q += factor K p for one tissue: springs, area and volume."""
    own = TISSUE_PARAMETERS * tissue
    ux, uy, uz = scratch.unit_x, scratch.unit_y, scratch.unit_z
    for s in range(model.tissue_spring_start[tissue], model.tissue_spring_start[tissue + 1]):
        a, b = model.spring_i[s], model.spring_j[s]
        dx, dy, dz = p[b] - p[a], p[n + b] - p[n + a], p[2 * n + b] - p[2 * n + a]
        across = factor * scratch.across[s]
        along = (factor * scratch.along[s] - across) * (dx * ux[s] + dy * uy[s] + dz * uz[s])
        fx, fy, fz = across * dx + along * ux[s], across * dy + along * uy[s], across * dz + along * uz[s]
        q[a] -= fx
        q[n + a] -= fy
        q[2 * n + a] -= fz
        q[b] += fx
        q[n + b] += fy
        q[2 * n + b] += fz
    x, y, z = state.x, state.y, state.z
    k = parameters[own + AREA_STIFFNESS]
    if k > 0.0:
        for t in range(model.tissue_triangle_start[tissue], model.tissue_triangle_start[tissue + 1]):
            a, b, c = model.triangle_a[t], model.triangle_b[t], model.triangle_c[t]
            u = (x[b] - x[a], y[b] - y[a], z[b] - z[a])
            v = (x[c] - x[a], y[c] - y[a], z[c] - z[a])
            normal = cross(u, v)
            square = dot(normal, normal)
            if square > 0.0:
                gb, gc = cross(v, normal), cross(normal, u)
                ga = (-gb[0] - gc[0], -gb[1] - gc[1], -gb[2] - gc[2])
                f = factor * k / model.rest_area[t] * 0.25 / square
                f *= (
                    dot(ga, (p[a], p[n + a], p[2 * n + a]))
                    + dot(gb, (p[b], p[n + b], p[2 * n + b]))
                    + dot(gc, (p[c], p[n + c], p[2 * n + c]))
                )
                for corner, g in ((a, ga), (b, gb), (c, gc)):
                    q[corner] += f * g[0]
                    q[n + corner] += f * g[1]
                    q[2 * n + corner] += f * g[2]
    k = parameters[own + VOLUME_STIFFNESS]
    if k > 0.0:
        g, f = scratch.volume_gradient, 0.0
        first, last = model.tissue_vertex_start[tissue], model.tissue_vertex_start[tissue + 1]
        for axis in range(3):
            for v in range(axis * n + first, axis * n + last):
                f += g[v] * p[v]
        f *= factor * k / abs(model.tissue_volume[tissue])
        for axis in range(3):
            for v in range(axis * n + first, axis * n + last):
                q[v] += f * g[v]


@inner
def _product(model, parameters, state, scratch, dt, n, p, q):
    """q = (M (1 + dt c/rho) + dt D + dt² K + contacts) p [N·s for p in m/s]; fixed vertices stay at rest."""
    for tissue in range(model.tissue_rate.size):
        own = TISSUE_PARAMETERS * tissue
        first, last = model.tissue_vertex_start[tissue], model.tissue_vertex_start[tissue + 1]
        damp_product(
            first,
            last,
            model.tissue_spring_start[tissue],
            model.tissue_spring_start[tissue + 1],
            model.spring_i,
            model.spring_j,
            model.spring_damping,
            dt * parameters[own + DAMPING_SCALE],
            scratch.unit_x,
            scratch.unit_y,
            scratch.unit_z,
            model.node_free,
            p,
            q,
            n,
        )
        _stiffness_product(model, parameters, state, scratch, tissue, n, dt * dt, p, q)
        per_area = parameters[own + AREAL_DENSITY] + dt * (
            parameters[own + DRAG] + parameters[own + SUPPORT_DAMPING] + dt * parameters[own + SUPPORT_STIFFNESS]
        )
        for v in range(first, last):
            m = per_area * model.node_area[v]
            q[v] += m * p[v]
            q[n + v] += m * p[n + v]
            q[2 * n + v] += m * p[2 * n + v]
    for k in range(min(int(scratch.active[0]), scratch.active_a.size)):
        a, b, c = scratch.active_a[k], scratch.active_b[k], scratch.active_c[k]
        wa, wb, wc = scratch.active_wa[k], scratch.active_wb[k], scratch.active_wc[k]
        g = (scratch.active_x[k], scratch.active_y[k], scratch.active_z[k])
        u = (
            wa * p[a] + wb * p[b] + wc * p[c],
            wa * p[n + a] + wb * p[n + b] + wc * p[n + c],
            wa * p[2 * n + a] + wb * p[2 * n + b] + wc * p[2 * n + c],
        )
        across = scratch.active_tangential[k]
        along = (scratch.active_normal[k] - across / max(dot(g, g), 1e-300)) * dot(g, u)
        f = (across * u[0] + along * g[0], across * u[1] + along * g[1], across * u[2] + along * g[2])
        for axis in range(3):
            q[axis * n + a] += wa * f[axis]
            q[axis * n + b] += wb * f[axis]
            q[axis * n + c] += wc * f[axis]
    for v in range(n):
        q[v] *= model.node_free[v]
        q[n + v] *= model.node_free[v]
        q[2 * n + v] *= model.node_free[v]


@inner
def _residual(model, parameters, state, scratch, elapsed, dt, n, r):
    """r = M (v0 - v) + dt f(x0 + dt v, v) at the velocities of the state; the square of its norm over the masses.

    Moves the state to x0 + dt v, with x0 and v0 from scratch.start.
    """
    _, _, _, start_vx, start_vy, start_vz = parts(scratch.start, n)
    place(state, scratch, dt)
    tissue_forces(model, parameters, state, scratch)
    clear_contacts(state, scratch)
    contact_forces(model, parameters, state, scratch, elapsed + dt, dt, False)
    total = 0.0
    gravity = model.gravity
    for tissue in range(model.tissue_rate.size):
        own = TISSUE_PARAMETERS * tissue
        _tangents(model, parameters, state, scratch, tissue)
        if parameters[own + VOLUME_STIFFNESS] > 0.0:
            _volume_gradient(model, state, tissue, n, scratch.volume_gradient)
        first, last = model.tissue_vertex_start[tissue], model.tissue_vertex_start[tissue + 1]
        p, q = scratch.solve[3 * n : 6 * n], scratch.solve[6 * n : 9 * n]
        for v in range(first, last):
            p[v], p[n + v], p[2 * n + v] = state.vx[v], state.vy[v], state.vz[v]
        damp_product(
            first,
            last,
            model.tissue_spring_start[tissue],
            model.tissue_spring_start[tissue + 1],
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
        density, support = parameters[own + AREAL_DENSITY], parameters[own + SUPPORT_STIFFNESS]
        c = parameters[own + DRAG] + parameters[own + SUPPORT_DAMPING]
        for v in range(first, last):
            area, free, mobility = model.node_area[v], model.node_free[v], model.node_mobility[v] / density
            vx, vy, vz = state.vx[v], state.vy[v], state.vz[v]
            r[v] = free * (
                density * area * (start_vx[v] - vx)
                + dt
                * (
                    scratch.fx[v]
                    - q[v]
                    + area * (density * gravity[0] - support * (state.x[v] - model.rest_x[v]) - c * vx)
                )
            )
            r[n + v] = free * (
                density * area * (start_vy[v] - vy)
                + dt
                * (
                    scratch.fy[v]
                    - q[n + v]
                    + area * (density * gravity[1] - support * (state.y[v] - model.rest_y[v]) - c * vy)
                )
            )
            r[2 * n + v] = free * (
                density * area * (start_vz[v] - vz)
                + dt
                * (
                    scratch.fz[v]
                    - q[2 * n + v]
                    + area * (density * gravity[2] - support * (state.z[v] - model.rest_z[v]) - c * vz)
                )
            )
            total += mobility * (r[v] * r[v] + r[n + v] * r[n + v] + r[2 * n + v] * r[2 * n + v])
            scratch.loss_now[v] = dt * (
                c * area * (vx * vx + vy * vy + vz * vz) + vx * q[v] + vy * q[n + v] + vz * q[2 * n + v]
            )
    return total


@inner
def _solve(model, parameters, state, scratch, dt, n, r, d):
    """Solve the linear system for the change d of the velocities, from the residual r, which is used up."""
    p, q = scratch.solve[3 * n : 6 * n], scratch.solve[6 * n : 9 * n]
    rho = 0.0
    for tissue in range(model.tissue_rate.size):
        density = parameters[TISSUE_PARAMETERS * tissue + AREAL_DENSITY]
        for v in range(model.tissue_vertex_start[tissue], model.tissue_vertex_start[tissue + 1]):
            scratch.inverse_mass[v] = model.node_mobility[v] / density
    for axis in range(3):
        for v in range(n):
            e = axis * n + v
            d[e] = 0.0
            p[e] = scratch.inverse_mass[v] * r[e]
            rho += r[e] * p[e]
    target = FORCING * FORCING * rho
    iteration = 0
    while rho > target and rho > 0.0 and iteration < CONJUGATE:
        _product(model, parameters, state, scratch, dt, n, p, q)
        curvature = 0.0
        for e in range(3 * n):
            curvature += p[e] * q[e]
        alpha = rho / curvature
        before = rho
        rho = 0.0
        for axis in range(3):
            for v in range(n):
                e = axis * n + v
                d[e] += alpha * p[e]
                r[e] -= alpha * q[e]
                rho += scratch.inverse_mass[v] * r[e] * r[e]
        beta = rho / before
        for axis in range(3):
            for v in range(n):
                e = axis * n + v
                p[e] = scratch.inverse_mass[v] * r[e] + beta * p[e]
        iteration += 1


@inner
def implicit_euler(model, parameters, state, scratch, elapsed, dt):
    """One substep, from elapsed [s] after the last communication point; what the bodies feel is that of its end."""
    n = state.x.size
    r, d = scratch.solve[: 3 * n], scratch.slope
    keep_start(state, scratch)
    work, dissipated = state.work[0], state.dissipated[0]
    square = _residual(model, parameters, state, scratch, elapsed, dt, n, r)
    target = max(FLOOR, RESIDUAL * RESIDUAL * square)
    iteration = 0
    while square > target and iteration < NEWTON:
        _solve(model, parameters, state, scratch, dt, n, r, d)
        before, part = square, 1.0
        for halving in range(HALVINGS + 1):
            # the first time the whole way, then back half of the way that was gone
            move = 1.0 if halving == 0 else -part
            for v in range(n):
                state.vx[v] += move * d[v]
                state.vy[v] += move * d[n + v]
                state.vz[v] += move * d[2 * n + v]
            part *= 0.5
            state.work[0], state.dissipated[0] = work, dissipated
            square = _residual(model, parameters, state, scratch, elapsed, dt, n, r)
            if square <= before:
                break
        iteration += 1
    for v in range(n):
        scratch.loss[v] += scratch.loss_now[v]
