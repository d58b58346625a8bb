"""Dampers and friction of contacts and holds, solved after all other forces of a substep (symplectic Euler).

A damper that is taken at the velocity before the springs' kick is either unstable or, eased until it is stable, too
weak: friction, whose slope at rest is mu F/e, hundreds of times. Here every point takes its law at the velocities v'
that the substep ends with (but for the dampers of springs, which come after):

    v' = v* + K sum of w f(u')        u' = v_body - sum of w v'        K = dt / (m (1 + dt c/rho))

v* is what all other forces give. Newton's method solves for v', each step by conjugate gradients with the row sums of
the slopes, a matrix a vertex, as preconditioner. Where a point comes to stick friction is far from linear, so that the
iteration starts from where the friction of each vertex alone, one scalar equation, would bring it. Very stiff points
that push the same vertices in very different directions may still lead it astray. Projected Gauss-Seidel over the
points (Moreau, Jean) then takes its place: slow, but without friction each visit lowers a convex function, whatever the
constants.
"""

import math

from tissue_contact.kernels.compiled import inner, pointwise
from tissue_contact.kernels.contact import contact_law, gather, moving_point, scatter
from tissue_contact.kernels.forces import motion_of, pose_of
from tissue_contact.kernels.slots import (
    AREAL_DENSITY,
    DRAG,
    GATHER,
    SUPPORT_DAMPING,
    SUPPORT_STIFFNESS,
    TISSUE_PARAMETERS,
)
from tissue_contact.kernels.vectors import dot

SLIDING = 12  # iterations for the velocity of sliding; it converges from below, quadratically
# Newton ends when the residual has fallen to this share of what the forces do to the velocities, in the norm of the
# masses. A force in a steady stick is then right to some thousandths.
RESIDUAL = 1e-3
NEWTON = 20  # steps at most; one or two do, but where many points come to stick or let go at once
FORCING = 3e-3  # of a Newton step's residual, to which its linear system is solved: one step does without friction
CONJUGATE = 60  # iterations of one solve at most
SWEEPS = 200  # of Gauss-Seidel at most, where Newton does not converge
SWEPT = 1e-10  # of what the first sweep changed: a result that depends on the order of the points by no more than that


@pointwise
def _sliding(speed, most, slip_speed):
    """Velocity s of sliding [m/s] that friction leaves of a speed: s + most s / sqrt(s² + slip_speed²) = speed.

    ``most`` [m/s] is what full friction takes within the substep. Left of the root the function is concave and
    increasing, so that Newton's iterations rise to it.
    """
    s = max(0.0, speed - most)
    for _ in range(SLIDING):
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
def _friction(model, parameters, contact):
    """Coefficient of friction and slip speed [m/s] of a noted point."""
    if contact < model.contact_body.size:
        law = contact_law(model, parameters, contact)
        return law[4], law[5]
    return 0.0, 1.0


@pointwise
def _corners(scratch, m):
    """Vertices of a noted point and their weights."""
    return (
        scratch.active_a[m],
        scratch.active_b[m],
        scratch.active_c[m],
        scratch.active_wa[m],
        scratch.active_wb[m],
        scratch.active_wc[m],
    )


@pointwise
def _arm(scratch, m):
    """Arm [m] of a noted point from the origin of its body's frame."""
    return scratch.active_arm_x[m], scratch.active_arm_y[m], scratch.active_arm_z[m]


@inner
def _axes(block, n):
    """A block of 3 n numbers by axis."""
    return block[:n], block[n : 2 * n], block[2 * n : 3 * n]


@pointwise
def _mean(x, y, z, a, b, c, wa, wb, wc):
    """Mean of three vertices."""
    return wa * x[a] + wb * x[b] + wc * x[c], wa * y[a] + wb * y[b] + wc * y[c], wa * z[a] + wb * z[b] + wc * z[c]


@inner
def _start(model, parameters, state, scratch, points, dt):
    """List the corners of all points, with their velocities from all other forces and their masses; their number."""
    n, vectors = state.x.size, scratch.damping
    (sx, sy, sz), (vx, vy, vz) = _axes(vectors, n), _axes(vectors[3 * n :], n)
    mobility, mass = vectors[21 * n : 22 * n], vectors[22 * n :]
    for m in range(points):
        for v in (scratch.active_a[m], scratch.active_b[m], scratch.active_c[m]):
            mass[v] = -1.0
    contact, corners = -1, 0
    density, factor, pull = 1.0, 1.0, 0.0
    for m in range(points):
        if int(scratch.active_contact[m]) != contact:
            contact = int(scratch.active_contact[m])
            own = TISSUE_PARAMETERS * _of_point(model, contact)[0]
            density = parameters[own + AREAL_DENSITY]
            drag = (parameters[own + DRAG] + parameters[own + SUPPORT_DAMPING]) / density
            factor = 1.0 / (1.0 + dt * drag)
            pull = dt * (parameters[own + SUPPORT_STIFFNESS] / density)
        for v in (scratch.active_a[m], scratch.active_b[m], scratch.active_c[m]):
            if mass[v] >= 0.0:
                continue
            scratch.corner[corners] = v
            corners += 1
            k, free = factor * (dt / density * model.node_mobility[v]), factor * model.node_free[v]
            mobility[v], mass[v] = k, 1.0 / k if k > 0.0 else 0.0
            # as `symplectic.advance` gives them
            sx[v] = free * (state.vx[v] - pull * (state.x[v] - model.rest_x[v]) + dt * model.gravity[0])
            sy[v] = free * (state.vy[v] - pull * (state.y[v] - model.rest_y[v]) + dt * model.gravity[1])
            sz[v] = free * (state.vz[v] - pull * (state.z[v] - model.rest_z[v]) + dt * model.gravity[2])
            sx[v] += k * scratch.fx[v]
            sy[v] += k * scratch.fy[v]
            sz[v] += k * scratch.fz[v]
            vx[v], vy[v], vz[v] = sx[v], sy[v], sz[v]
    return corners


@inner
def _rub(model, parameters, scratch, points, corners, n):
    """Bring every corner to where its shares of the friction would, across the mean direction of its points."""
    vectors = scratch.damping
    (vx, vy, vz), mobility = _axes(vectors[3 * n :], n), vectors[21 * n : 22 * n]
    (gx, gy, gz), (bx, by, bz) = _axes(vectors[6 * n :], n), _axes(vectors[9 * n :], n)
    full, slip, _ = _axes(vectors[12 * n :], n)
    for k in range(corners):
        v = scratch.corner[k]
        gx[v], gy[v], gz[v] = 0.0, 0.0, 0.0
        bx[v], by[v], bz[v] = 0.0, 0.0, 0.0
        full[v], slip[v] = 0.0, 0.0
    contact, friction, slip_speed, rubbed = -1, 0.0, 1.0, False
    velocity, spin = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for m in range(points):
        if int(scratch.active_contact[m]) != contact:
            contact = int(scratch.active_contact[m])
            friction, slip_speed = _friction(model, parameters, contact)
            velocity, spin = motion_of(scratch, _of_point(model, contact)[1])
        if friction == 0.0:
            continue
        rubbed = True
        a, b, c, wa, wb, wc = _corners(scratch, m)
        f = friction * scratch.active_tangential[m]
        wa, wb, wc = f * wa, f * wb, f * wc
        scatter(gx, gy, gz, a, b, c, wa, wb, wc, (scratch.active_x[m], scratch.active_y[m], scratch.active_z[m]))
        scatter(bx, by, bz, a, b, c, wa, wb, wc, moving_point(velocity, spin, _arm(scratch, m)))
        full[a] += wa
        full[b] += wb
        full[c] += wc
        slip[a] += wa * slip_speed
        slip[b] += wb * slip_speed
        slip[c] += wc * slip_speed
    if not rubbed:
        return
    for k in range(corners):
        v = scratch.corner[k]
        g = (gx[v], gy[v], gz[v])
        square = dot(g, g)
        if not (full[v] > 0.0 and square > 0.0):
            continue
        ux, uy, uz = bx[v] / full[v] - vx[v], by[v] / full[v] - vy[v], bz[v] / full[v] - vz[v]
        along = dot(g, (ux, uy, uz)) / square
        tx, ty, tz = ux - along * g[0], uy - along * g[1], uz - along * g[2]
        speed = math.sqrt(tx * tx + ty * ty + tz * tz)
        if speed > 0.0:
            f = 1.0 - _sliding(speed, mobility[v] * full[v], slip[v] / full[v]) / speed
            vx[v] += f * tx
            vy[v] += f * ty
            vz[v] += f * tz


@inner
def _residual(model, parameters, scratch, points, corners, n):
    """Forces of all points at the velocities now, their slopes, and the residual of every corner [N].

    Returns
    -------
    left, moved, power : float
        Squares of the norms of the residual and of what the forces have done to the velocities, and what the bodies
        give [W].
    """
    vectors = scratch.damping
    (sx, sy, sz), (vx, vy, vz) = _axes(vectors, n), _axes(vectors[3 * n :], n)
    rx, ry, rz = _axes(vectors[6 * n :], n)
    (xx, yy, zz), (xy, xz, yz) = _axes(vectors[15 * n :], n), _axes(vectors[18 * n :], n)
    mobility, mass = vectors[21 * n : 22 * n], vectors[22 * n :]
    left, moved, power = 0.0, 0.0, 0.0
    for k in range(corners):
        v = scratch.corner[k]
        m = mass[v]
        dx, dy, dz = sx[v] - vx[v], sy[v] - vy[v], sz[v] - vz[v]
        rx[v], ry[v], rz[v] = m * dx, m * dy, m * dz
        xx[v], yy[v], zz[v] = m, m, m
        xy[v], xz[v], yz[v] = 0.0, 0.0, 0.0
        moved += m * (dx * dx + dy * dy + dz * dz)
    contacts = model.contact_body.size
    contact, friction, slip_speed = -1, 0.0, 1.0
    velocity, spin = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for m in range(points):
        if int(scratch.active_contact[m]) != contact:
            contact = int(scratch.active_contact[m])
            friction, slip_speed = _friction(model, parameters, contact)
            velocity, spin = motion_of(scratch, _of_point(model, contact)[1])
        a, b, c, wa, wb, wc = _corners(scratch, m)
        own, taken = moving_point(velocity, spin, _arm(scratch, m)), _mean(vx, vy, vz, a, b, c, wa, wb, wc)
        u = (own[0] - taken[0], own[1] - taken[1], own[2] - taken[2])
        g = (scratch.active_x[m], scratch.active_y[m], scratch.active_z[m])
        viscous, elastic = scratch.active_normal[m], scratch.active_tangential[m]
        axial, across, t = 0.0, viscous, (0.0, 0.0, 0.0)
        force = (viscous * u[0], viscous * u[1], viscous * u[2])  # a hold damps in every direction
        if contact < contacts:
            rate = dot(g, u)
            size, axial, across = viscous * rate, viscous, 0.0
            if size < -elastic:
                size, axial = -elastic, 0.0
            force = (size * g[0], size * g[1], size * g[2])
            full = friction * (elastic + size)
            if full > 0.0:
                norm = dot(g, g)
                along = rate / norm
                t = (u[0] - along * g[0], u[1] - along * g[1], u[2] - along * g[2])
                root = 1.0 / math.sqrt(dot(t, t) + slip_speed * slip_speed)
                across = full * root
                axial -= across / norm
                force = (force[0] + across * t[0], force[1] + across * t[1], force[2] + across * t[2])
                t = (root * t[0], root * t[1], root * t[2])
        scratch.active_fx[m], scratch.active_fy[m], scratch.active_fz[m] = force
        scratch.active_tx[m], scratch.active_ty[m], scratch.active_tz[m] = t
        scratch.active_axial[m], scratch.active_across[m] = axial, across
        power += dot(force, own)
        scatter(rx, ry, rz, a, b, c, wa, wb, wc, force)
        slope = (
            across * (1.0 - t[0] * t[0]) + axial * g[0] * g[0],
            across * (1.0 - t[1] * t[1]) + axial * g[1] * g[1],
            across * (1.0 - t[2] * t[2]) + axial * g[2] * g[2],
        )
        mixed = (
            axial * g[0] * g[1] - across * t[0] * t[1],
            axial * g[0] * g[2] - across * t[0] * t[2],
            axial * g[1] * g[2] - across * t[1] * t[2],
        )
        scatter(xx, yy, zz, a, b, c, wa, wb, wc, slope)
        scatter(xy, xz, yz, a, b, c, wa, wb, wc, mixed)
    for k in range(corners):
        v = scratch.corner[k]
        left += mobility[v] * (rx[v] * rx[v] + ry[v] * ry[v] + rz[v] * rz[v])
    return left, moved, power


@inner
def _product(scratch, points, corners, n):
    """Image of the direction of the search under masses and slopes [N]."""
    vectors = scratch.damping
    (px, py, pz), (qx, qy, qz), mass = _axes(vectors[9 * n :], n), _axes(vectors[12 * n :], n), vectors[22 * n :]
    for k in range(corners):
        v = scratch.corner[k]
        qx[v], qy[v], qz[v] = mass[v] * px[v], mass[v] * py[v], mass[v] * pz[v]
    for m in range(points):
        a, b, c, wa, wb, wc = _corners(scratch, m)
        u = _mean(px, py, pz, a, b, c, wa, wb, wc)
        g = (scratch.active_x[m], scratch.active_y[m], scratch.active_z[m])
        t = (scratch.active_tx[m], scratch.active_ty[m], scratch.active_tz[m])
        across = scratch.active_across[m]
        axial, along = scratch.active_axial[m] * dot(g, u), across * dot(t, u)
        force = (
            across * u[0] + axial * g[0] - along * t[0],
            across * u[1] + axial * g[1] - along * t[1],
            across * u[2] + axial * g[2] - along * t[2],
        )
        scatter(qx, qy, qz, a, b, c, wa, wb, wc, force)


@inner
def _invert(scratch, corners, n):
    """Invert the matrices of the corners, masses and sums of slopes; those of fixed vertices become 0."""
    vectors = scratch.damping
    (xx, yy, zz), (xy, xz, yz) = _axes(vectors[15 * n :], n), _axes(vectors[18 * n :], n)
    mobility = vectors[21 * n : 22 * n]
    for k in range(corners):
        v = scratch.corner[k]
        a, b, c, d, e, f = xx[v], yy[v], zz[v], xy[v], xz[v], yz[v]
        ca, cd, ce = b * c - f * f, e * f - c * d, d * f - b * e
        scale = 1.0 / (a * ca + d * cd + e * ce) if mobility[v] > 0.0 else 0.0
        xx[v], yy[v], zz[v] = scale * ca, scale * (a * c - e * e), scale * (a * b - d * d)
        xy[v], xz[v], yz[v] = scale * cd, scale * ce, scale * (d * e - a * f)


@inner
def _precondition(scratch, corners, n):
    """Multiply the residual by the inverse matrices of the corners, in place of the image; the product with it."""
    vectors, rho = scratch.damping, 0.0
    (rx, ry, rz), (qx, qy, qz) = _axes(vectors[6 * n :], n), _axes(vectors[12 * n :], n)
    (xx, yy, zz), (xy, xz, yz) = _axes(vectors[15 * n :], n), _axes(vectors[18 * n :], n)
    for k in range(corners):
        v = scratch.corner[k]
        qx[v] = xx[v] * rx[v] + xy[v] * ry[v] + xz[v] * rz[v]
        qy[v] = xy[v] * rx[v] + yy[v] * ry[v] + yz[v] * rz[v]
        qz[v] = xz[v] * rx[v] + yz[v] * ry[v] + zz[v] * rz[v]
        rho += rx[v] * qx[v] + ry[v] * qy[v] + rz[v] * qz[v]
    return rho


@inner
def _newton(scratch, points, corners, n):
    """Add one Newton step to the velocities now; their residual is used up."""
    vectors = scratch.damping
    v, r, p = vectors[3 * n : 6 * n], vectors[6 * n : 9 * n], vectors[9 * n : 12 * n]
    q = vectors[12 * n : 15 * n]
    _invert(scratch, corners, n)
    rho, beta = _precondition(scratch, corners, n), 0.0
    target = FORCING * FORCING * rho
    for k in range(corners):
        i = scratch.corner[k]
        for e in range(i, i + 3 * n, n):
            p[e] = 0.0
    iteration = 0
    while rho > target and rho > 0.0 and iteration < CONJUGATE:
        for k in range(corners):
            i = scratch.corner[k]
            for e in range(i, i + 3 * n, n):
                p[e] = q[e] + beta * p[e]
        _product(scratch, points, corners, n)
        curvature = 0.0
        for k in range(corners):
            i = scratch.corner[k]
            for e in range(i, i + 3 * n, n):
                curvature += p[e] * q[e]
        alpha = rho / curvature
        for k in range(corners):
            i = scratch.corner[k]
            for e in range(i, i + 3 * n, n):
                v[e] += alpha * p[e]
                r[e] -= alpha * q[e]
        before = rho
        rho = _precondition(scratch, corners, n)
        beta = rho / before
        iteration += 1


@inner
def _sweep(model, parameters, scratch, points, n, backward):
    """Solve the law of each point in turn, the forces of all others held, and bring the velocities up to date.

    Returns
    -------
    change, power : float
        Square of the norm of what has changed, and what the bodies give [W].
    """
    vectors, contacts = scratch.damping, model.contact_body.size
    (vx, vy, vz), mobility = _axes(vectors[3 * n :], n), vectors[21 * n : 22 * n]
    contact, friction, slip_speed, change, power = -1, 0.0, 1.0, 0.0, 0.0
    velocity, spin = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for k in range(points):
        m = points - 1 - k if backward else k
        if int(scratch.active_contact[m]) != contact:
            contact = int(scratch.active_contact[m])
            friction, slip_speed = _friction(model, parameters, contact)
            velocity, spin = motion_of(scratch, _of_point(model, contact)[1])
        a, b, c, wa, wb, wc = _corners(scratch, m)
        ka, kb, kc = wa * mobility[a], wb * mobility[b], wc * mobility[c]
        w = wa * ka + wb * kb + wc * kc
        old = (scratch.active_fx[m], scratch.active_fy[m], scratch.active_fz[m])
        own, taken = moving_point(velocity, spin, _arm(scratch, m)), _mean(vx, vy, vz, a, b, c, wa, wb, wc)
        # the velocity without the force of the point, that with it is w times the force less
        u = (own[0] - taken[0] + w * old[0], own[1] - taken[1] + w * old[1], own[2] - taken[2] + w * old[2])
        viscous, elastic = scratch.active_normal[m], scratch.active_tangential[m]
        f = viscous / (1.0 + w * viscous)
        force = (f * u[0], f * u[1], f * u[2])
        if contact < contacts:
            g = (scratch.active_x[m], scratch.active_y[m], scratch.active_z[m])
            square = dot(g, g)
            rate = dot(g, u)
            size = max(-elastic, viscous * rate / (1.0 + w * viscous * square))
            force = (size * g[0], size * g[1], size * g[2])
            full, along = friction * (elastic + size), rate / square
            t = (u[0] - along * g[0], u[1] - along * g[1], u[2] - along * g[2])
            speed = math.sqrt(dot(t, t))
            if full > 0.0 and speed > 0.0:
                s = _sliding(speed, w * full, slip_speed)
                f = full * s / (math.sqrt(s * s + slip_speed * slip_speed) * speed)
                force = (force[0] + f * t[0], force[1] + f * t[1], force[2] + f * t[2])
        scratch.active_fx[m], scratch.active_fy[m], scratch.active_fz[m] = force
        more = (force[0] - old[0], force[1] - old[1], force[2] - old[2])
        scatter(vx, vy, vz, a, b, c, ka, kb, kc, more)
        change += w * dot(more, more)
        power += dot(force, own)
    return change, power


@inner
def _sweeps(model, parameters, scratch, points, corners, n):
    """Sweep over all points to and fro, beginning without force; what the bodies give [W]."""
    vectors = scratch.damping
    for k in range(corners):
        i = scratch.corner[k]
        for e in range(i, i + 3 * n, n):
            vectors[3 * n + e], vectors[6 * n + e] = vectors[e], 0.0
    for m in range(points):
        scratch.active_fx[m], scratch.active_fy[m], scratch.active_fz[m] = 0.0, 0.0, 0.0
    first, power = _sweep(model, parameters, scratch, points, n, False)
    change, sweeps = first, 1
    while change > SWEPT * SWEPT * first and sweeps < SWEEPS:
        change, power = _sweep(model, parameters, scratch, points, n, sweeps % 2 == 1)
        sweeps += 1
    return power


@inner
def _share(scratch, corners, n, power):
    """Share of the forces, 1 or a little less where the residual needs it, with which they give no energy.

    Together they take f·u' = f·u* - |v' - v*|² of power, the norm that of the masses: a share s of them s f·u* less s²
    times the square.
    """
    vectors = scratch.damping
    s, v, r = vectors[: 3 * n], vectors[3 * n : 6 * n], vectors[6 * n : 9 * n]
    mobility, mass = vectors[21 * n : 22 * n], vectors[22 * n :]
    taken, square = power, 0.0
    for k in range(corners):
        i = scratch.corner[k]
        for e in range(i, i + 3 * n, n):
            force = r[e] + mass[i] * (v[e] - s[e])
            moved = mobility[i] * force
            taken -= force * (s[e] + moved)
            square += force * moved
    return max(0.0, 1.0 + taken / square) if taken < 0.0 else 1.0


@inner
def damp_contacts(model, parameters, state, scratch, elapsed, dt):
    """Add the dampers and the friction of all noted points to the forces on the tissue and on the bodies.

    The points are those that `contact.note` noted, with springs only, at ``elapsed`` [s] after the last communication
    point.
    """
    points, n = min(int(scratch.active[0]), scratch.active_a.size), state.x.size
    if points == 0:
        return
    corners = _start(model, parameters, state, scratch, points, dt)
    _rub(model, parameters, scratch, points, corners, n)
    left, moved, power = _residual(model, parameters, scratch, points, corners, n)
    iteration = 0
    while left > RESIDUAL * RESIDUAL * moved and iteration < NEWTON:
        _newton(scratch, points, corners, n)
        left, moved, power = _residual(model, parameters, scratch, points, corners, n)
        iteration += 1
    if left > RESIDUAL * RESIDUAL * moved:
        power = _sweeps(model, parameters, scratch, points, corners, n)
    share = _share(scratch, corners, n, power)
    contact, row, p = -1, 0, (0.0, 0.0, 0.0)
    for m in range(points):
        if int(scratch.active_contact[m]) != contact:
            contact = int(scratch.active_contact[m])
            body = _of_point(model, contact)[1]
            _, p = pose_of(state, scratch, body, elapsed)
            row = GATHER * body
        a, b, c, wa, wb, wc = _corners(scratch, m)
        force = (share * scratch.active_fx[m], share * scratch.active_fy[m], share * scratch.active_fz[m])
        scratch.active_fx[m], scratch.active_fy[m], scratch.active_fz[m] = force
        scatter(scratch.fx, scratch.fy, scratch.fz, a, b, c, wa, wb, wc, force)
        gather(scratch.contact, row, p, _arm(scratch, m), (-force[0], -force[1], -force[2]), 0.0, 0.0)


@inner
def count_damping(model, parameters, state, scratch, dt):
    """Count work and dissipation of what `damp_contacts` added, at the velocities that the substep ends with."""
    contact = -1
    velocity, spin = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    work, dissipated = 0.0, 0.0
    for m in range(min(int(scratch.active[0]), scratch.active_a.size)):
        if int(scratch.active_contact[m]) != contact:
            contact = int(scratch.active_contact[m])
            velocity, spin = motion_of(scratch, _of_point(model, contact)[1])
        a, b, c, wa, wb, wc = _corners(scratch, m)
        force = (scratch.active_fx[m], scratch.active_fy[m], scratch.active_fz[m])
        given = dot(force, moving_point(velocity, spin, _arm(scratch, m)))
        work += given
        dissipated += given - dot(force, _mean(state.vx, state.vy, state.vz, a, b, c, wa, wb, wc))
    state.work[0] += dt * work
    state.dissipated[0] += dt * dissipated
