"""Dampers and friction of contacts and holds, solved after all other forces of a substep (symplectic Euler).

A damper that is taken at the velocity before the springs' kick is either unstable or, eased until it is stable, too
weak: friction, whose slope at rest is mu F/e, hundreds of times. Here the forces are those of an implicit damper at the
velocities u* that all other forces will give, with the dampers lumped to the vertices: at vertex i

    u'_i = u*_i / (1 + dt D_i/m_i)        D_i = sum over the points of alpha_i c

and a point takes c times the mean of its corners' u'. What moves evenly under a contact feels the law itself; D_i is
the row sum of a matrix without negative entries, so that whatever the constants are, the eigenvalues lie between 0 and
1 and no motion grows without end. (For a substep it may: a very stiff damper, dt c/m far above 1, throws the heavier
weighted of unlike corners back.) Nothing depends on the order of the points.
"""

import math

from tissue_contact.kernels.compiled import inner, pointwise
from tissue_contact.kernels.contact import contact_law, gather, moving_point, scatter
from tissue_contact.kernels.forces import motion_of, pose_of
from tissue_contact.kernels.slots import AREAL_DENSITY, GATHER, SUPPORT_STIFFNESS, TISSUE_PARAMETERS
from tissue_contact.kernels.vectors import dot

NEWTON = 12  # iterations for the velocity of sliding; it converges from below, quadratically


@pointwise
def _sliding(speed, most, slip_speed):
    """Velocity s of sliding [m/s] that friction leaves of a speed: s + most s / sqrt(s² + slip_speed²) = speed.

    ``most`` [m/s] is what full friction takes within the substep. Left of the root the function is concave and
    increasing, so that Newton's iterations rise to it.
    """
    s = max(0.0, speed - most)
    for _ in range(NEWTON):
        root = math.sqrt(s * s + slip_speed * slip_speed)
        step = (speed - s - most * s / root) / (1.0 + most * slip_speed * slip_speed / (root * root * root))
        s += step
        if not step > 1e-12 * speed:
            break
    return s


@inner
def _of_point(model, contact):
    """Tissue and body of a noted point; the numbers of holds follow those of contacts."""
    if contact < model.contact_body.size:
        return int(model.contact_tissue[contact]), int(model.contact_body[contact])
    hold = contact - model.contact_body.size
    return int(model.grasp_tissue[hold]), int(model.grasp_body[hold])


@inner
def _lump(model, parameters, scratch):
    """Lump dampers [N·s/m] and full friction [N] of all noted points to the vertices."""
    damping, friction = scratch.vertex_damping, scratch.vertex_friction
    points = min(int(scratch.active[0]), scratch.active_a.size)
    for m in range(points):
        for v in (scratch.active_a[m], scratch.active_b[m], scratch.active_c[m]):
            damping[v] = 0.0
            friction[v] = 0.0
    contact, rubs = -1, 0.0
    for m in range(points):
        if int(scratch.active_contact[m]) != contact:
            contact = int(scratch.active_contact[m])
            rubs = contact_law(model, parameters, contact)[4] if contact < model.contact_body.size else 0.0
        a, b, c = scratch.active_a[m], scratch.active_b[m], scratch.active_c[m]
        wa, wb, wc = scratch.active_wa[m], scratch.active_wb[m], scratch.active_wc[m]
        viscous, full = scratch.active_normal[m], rubs * scratch.active_tangential[m]
        damping[a] += wa * viscous
        damping[b] += wb * viscous
        damping[c] += wc * viscous
        friction[a] += wa * full
        friction[b] += wb * full
        friction[c] += wc * full
    return points


@pointwise
def _left(ux, uy, uz, g, square, most, slip_speed):
    """Tangential part of a velocity [m/s] after the friction of a vertex."""
    along = (g[0] * ux + g[1] * uy + g[2] * uz) / square
    tx, ty, tz = ux - along * g[0], uy - along * g[1], uz - along * g[2]
    speed = math.sqrt(tx * tx + ty * ty + tz * tz)
    f = _sliding(speed, most, slip_speed) / speed if speed > 0.0 else 0.0
    return f * tx, f * ty, f * tz


@pointwise
def _against(v, own, x, y, z, vx, vy, vz, fx, fy, fz, rest, mobility, free, dt, density, support, gravity):
    """Velocity [m/s] of a body's point against vertex v after the kick of all other forces."""
    f, still = dt * mobility[v] / density, dt * free[v]
    return (
        own[0] - vx[v] - f * fx[v] - still * (gravity[0] - support * (x[v] - rest[0][v])),
        own[1] - vy[v] - f * fy[v] - still * (gravity[1] - support * (y[v] - rest[1][v])),
        own[2] - vz[v] - f * fz[v] - still * (gravity[2] - support * (z[v] - rest[2][v])),
    )


@inner
def damp_contacts(model, parameters, state, scratch, elapsed, dt):
    """Add the dampers and the friction of all noted points to the forces on the tissue and on the bodies.

    The points are those that `contact.note` noted, with springs only, at ``elapsed`` [s] after the last communication
    point. Their forces take the place of their directions, for `count_damping`.
    """
    contacts = model.contact_body.size
    x, y, z, vx, vy, vz = state.x, state.y, state.z, state.vx, state.vy, state.vz
    rest, mobility, free = (model.rest_x, model.rest_y, model.rest_z), model.node_mobility, model.node_free
    fx, fy, fz, out = scratch.fx, scratch.fy, scratch.fz, scratch.contact
    damping, rub = scratch.vertex_damping, scratch.vertex_friction
    gravity = (model.gravity[0], model.gravity[1], model.gravity[2])
    points = _lump(model, parameters, scratch)
    contact, density, support, friction, slip_speed = -1, 1.0, 0.0, 0.0, 1.0
    p, velocity, spin = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for m in range(points):
        if int(scratch.active_contact[m]) != contact:
            contact = int(scratch.active_contact[m])
            tissue, body = _of_point(model, contact)
            density = parameters[TISSUE_PARAMETERS * tissue + AREAL_DENSITY]
            support = parameters[TISSUE_PARAMETERS * tissue + SUPPORT_STIFFNESS] / density
            friction, slip_speed = 0.0, 1.0
            if contact < contacts:
                law = contact_law(model, parameters, contact)
                friction, slip_speed = law[4], law[5]
            velocity, spin = motion_of(scratch, body)
        viscous, elastic = scratch.active_normal[m], scratch.active_tangential[m]
        g = (scratch.active_x[m], scratch.active_y[m], scratch.active_z[m])
        scratch.active_x[m], scratch.active_y[m], scratch.active_z[m] = 0.0, 0.0, 0.0
        if viscous == 0.0 and friction == 0.0:
            continue
        a, b, c = scratch.active_a[m], scratch.active_b[m], scratch.active_c[m]
        wa, wb, wc = scratch.active_wa[m], scratch.active_wb[m], scratch.active_wc[m]
        arm = (scratch.active_arm_x[m], scratch.active_arm_y[m], scratch.active_arm_z[m])
        own = moving_point(velocity, spin, arm)
        ua = _against(a, own, x, y, z, vx, vy, vz, fx, fy, fz, rest, mobility, free, dt, density, support, gravity)
        ub = _against(b, own, x, y, z, vx, vy, vz, fx, fy, fz, rest, mobility, free, dt, density, support, gravity)
        uc = _against(c, own, x, y, z, vx, vy, vz, fx, fy, fz, rest, mobility, free, dt, density, support, gravity)
        ma, mb, mc = dt * mobility[a] / density, dt * mobility[b] / density, dt * mobility[c] / density
        ka, kb, kc = wa / (1.0 + ma * damping[a]), wb / (1.0 + mb * damping[b]), wc / (1.0 + mc * damping[c])
        ux = ka * ua[0] + kb * ub[0] + kc * uc[0]
        uy = ka * ua[1] + kb * ub[1] + kc * uc[1]
        uz = ka * ua[2] + kb * ub[2] + kc * uc[2]
        if contact >= contacts:  # a hold damps in every direction
            force = (viscous * ux, viscous * uy, viscous * uz)
        else:
            size = max(-elastic, viscous * (g[0] * ux + g[1] * uy + g[2] * uz))
            force = (size * g[0], size * g[1], size * g[2])
            full = friction * (elastic + size)
            if full > 0.0:
                square = dot(g, g)
                ta = _left(ua[0], ua[1], ua[2], g, square, ma * rub[a], slip_speed)
                tb = _left(ub[0], ub[1], ub[2], g, square, mb * rub[b], slip_speed)
                tc = _left(uc[0], uc[1], uc[2], g, square, mc * rub[c], slip_speed)
                tx = wa * ta[0] + wb * tb[0] + wc * tc[0]
                ty = wa * ta[1] + wb * tb[1] + wc * tc[1]
                tz = wa * ta[2] + wb * tb[2] + wc * tc[2]
                f = full / math.sqrt(tx * tx + ty * ty + tz * tz + slip_speed * slip_speed)
                force = (force[0] + f * tx, force[1] + f * ty, force[2] + f * tz)
        scratch.active_x[m], scratch.active_y[m], scratch.active_z[m] = force
    contact, row = -1, 0
    for m in range(points):
        if int(scratch.active_contact[m]) != contact:
            contact = int(scratch.active_contact[m])
            _, body = _of_point(model, contact)
            _, p = pose_of(state, scratch, body, elapsed)
            row = GATHER * body
        a, b, c = scratch.active_a[m], scratch.active_b[m], scratch.active_c[m]
        wa, wb, wc = scratch.active_wa[m], scratch.active_wb[m], scratch.active_wc[m]
        arm = (scratch.active_arm_x[m], scratch.active_arm_y[m], scratch.active_arm_z[m])
        force = (scratch.active_x[m], scratch.active_y[m], scratch.active_z[m])
        scatter(fx, fy, fz, a, b, c, wa, wb, wc, force)
        gather(out, row, p, arm, (-force[0], -force[1], -force[2]), 0.0, 0.0)


@inner
def count_damping(model, parameters, state, scratch, dt):
    """Count work and dissipation of what `damp_contacts` added, at the velocities that the substep ends with."""
    contact = -1
    velocity, spin = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    vx, vy, vz = state.vx, state.vy, state.vz
    work, dissipated = 0.0, 0.0
    for m in range(min(int(scratch.active[0]), scratch.active_a.size)):
        if int(scratch.active_contact[m]) != contact:
            contact = int(scratch.active_contact[m])
            _, body = _of_point(model, contact)
            velocity, spin = motion_of(scratch, body)
        force = (scratch.active_x[m], scratch.active_y[m], scratch.active_z[m])
        a, b, c = scratch.active_a[m], scratch.active_b[m], scratch.active_c[m]
        wa, wb, wc = scratch.active_wa[m], scratch.active_wb[m], scratch.active_wc[m]
        arm = (scratch.active_arm_x[m], scratch.active_arm_y[m], scratch.active_arm_z[m])
        given = dot(force, moving_point(velocity, spin, arm))
        taken = dot(
            force,
            (
                wa * vx[a] + wb * vx[b] + wc * vx[c],
                wa * vy[a] + wb * vy[b] + wc * vy[c],
                wa * vz[a] + wb * vz[b] + wc * vz[c],
            ),
        )
        work += given
        dissipated += given - taken
    state.work[0] += dt * work
    state.dissipated[0] += dt * dissipated
