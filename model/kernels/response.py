"""Collision response: from the pairs that detection left to forces (thesis 3.6, model sections 5 and 6).

The pairs of a touched tissue triangle give it a point of collision and a share w of its contact region; a region has
one mean point, one mean normal, one depth, one force of the law, spread over its triangles by their shares. The share
is the length of the intersection curve within the triangle: the curve in which two surfaces meet does not depend on
how they are cut into triangles, so neither does the force. (The raw sum over pairs that the thesis implies grows with
their number; it stays available as ``pair_weight = "none"``, each touched triangle then a region of its own whose
force counts once for every pair.)

One normal for the region, not one for each triangle: the depth of the box below a triangle's own plane swings with the
tilt of that triangle, which does no work against the force and so would feed energy to the tissue.
"""

from tissue_contact.kernels.compiled import inner

from tissue_contact.kernels.collision import HULL, hull_depth, penetration
from tissue_contact.kernels.detection import pair_point
from tissue_contact.kernels.laws import kelvin_voigt
from tissue_contact.kernels.slots import (
    AREAL_DENSITY,
    CONTACT_DAMPING,
    CONTACT_PARAMETERS,
    CONTACT_STIFFNESS,
    GATHER,
    GATHER_DEPTH,
    GATHER_FORCE,
    GATHER_POINT,
    GATHER_REGIONS,
    GATHER_SIZE,
    GATHER_TORQUE,
    TISSUE_PARAMETERS,
)
from tissue_contact.kernels.vectors import cross, dot, to_body, to_world

NORMAL_MIN = 1e-9  # mean of unit normals below which they cancel: the region is pinched and has no inner side


@inner
def _touch(model, state, scratch, contact, r, p):
    """Gather the pairs of one contact into touched triangles, in the touch_ arrays of scratch; their count."""
    first = contact * (state.pair_triangle.size // state.pair_count.size)
    last = first + state.pair_count[contact]
    x, y, z = state.x, state.y, state.z
    n = 0
    k = first
    while k < last:
        t = state.pair_triangle[k]
        a, b, c = model.triangle_a[t], model.triangle_b[t], model.triangle_c[t]
        t1 = to_body(r, (x[a] - p[0], y[a] - p[1], z[a] - p[2]))
        t2 = to_body(r, (x[b] - p[0], y[b] - p[1], z[b] - p[2]))
        t3 = to_body(r, (x[c] - p[0], y[c] - p[1], z[c] - p[2]))
        e1 = (t2[0] - t1[0], t2[1] - t1[1], t2[2] - t1[2])
        e2 = (t3[0] - t1[0], t3[1] - t1[1], t3[2] - t1[2])
        normal = cross(e1, e2)
        nn = dot(normal, normal)
        scratch.touch_region[n] = state.pair_region[k]
        scratch.touch_part[n] = model.instrument_part[state.pair_instrument[k]]
        length, wa, wb, wc = 0.0, 0.0, 0.0, 0.0
        a_plain, b_plain, c_plain, pairs = 0.0, 0.0, 0.0, 0
        while k < last and state.pair_triangle[k] == t:
            if nn > 0.0:
                w, piece = pair_point(model, state.pair_instrument[k], t1, e1, e2, normal, nn)
                length += piece
                wa += piece * w[0]
                wb += piece * w[1]
                wc += piece * w[2]
                a_plain += w[0]
                b_plain += w[1]
                c_plain += w[2]
                pairs += 1
            k += 1
        if pairs == 0:  # the triangle has lost its area: it has no normal, hence no force
            continue
        if length > 0.0:
            wa, wb, wc = wa / length, wb / length, wc / length
        else:
            wa, wb, wc = a_plain / pairs, b_plain / pairs, c_plain / pairs
        size = nn**0.5
        scratch.touch_triangle[n] = t
        scratch.touch_pairs[n] = pairs
        scratch.touch_length[n] = length
        scratch.touch_a[n], scratch.touch_b[n], scratch.touch_c[n] = wa, wb, wc
        scratch.touch_nx[n] = -normal[0] / size
        scratch.touch_ny[n] = -normal[1] / size
        scratch.touch_nz[n] = -normal[2] / size
        scratch.touch_rx[n] = wa * t1[0] + wb * t2[0] + wc * t3[0]
        scratch.touch_ry[n] = wa * t1[1] + wb * t2[1] + wc * t3[1]
        scratch.touch_rz[n] = wa * t1[2] + wb * t2[2] + wc * t3[2]
        n += 1
    return n


@inner
def _weigh(model, state, scratch, contact, n):
    """Share of its region that each of n touched triangles has; the number of regions."""
    if model.contact_weighted[contact] == 0:
        for m in range(n):
            scratch.touch_region[m] = m
            scratch.touch_share[m] = 1.0
        return n
    regions = state.region_count[contact]
    for region in range(regions):
        scratch.region_length[region] = 0.0
        scratch.region_touches[region] = 0.0
    for m in range(n):
        scratch.region_length[scratch.touch_region[m]] += scratch.touch_length[m]
        scratch.region_touches[scratch.touch_region[m]] += 1.0
    for m in range(n):
        region = scratch.touch_region[m]
        if scratch.region_length[region] > 0.0:
            scratch.touch_share[m] = scratch.touch_length[m] / scratch.region_length[region]
        else:  # touching in points only
            scratch.touch_share[m] = 1.0 / scratch.region_touches[region]
    return int(regions)


@inner
def _average(model, state, scratch, contact, regions, n):
    """Mean inner normal, point, tissue velocity and depth of every region, body frame but for the velocity.

    The depth is the support depth, below the plane through the mean point across the mean normal, of the box or hull
    of the part that each triangle met.
    """
    for region in range(regions):
        scratch.region_nx[region] = 0.0
        scratch.region_ny[region] = 0.0
        scratch.region_nz[region] = 0.0
        scratch.region_rx[region] = 0.0
        scratch.region_ry[region] = 0.0
        scratch.region_rz[region] = 0.0
        scratch.region_vx[region] = 0.0
        scratch.region_vy[region] = 0.0
        scratch.region_vz[region] = 0.0
        scratch.region_depth[region] = 0.0
    for m in range(n):
        region, w, t = scratch.touch_region[m], scratch.touch_share[m], scratch.touch_triangle[m]
        a, b, c = model.triangle_a[t], model.triangle_b[t], model.triangle_c[t]
        wa, wb, wc = w * scratch.touch_a[m], w * scratch.touch_b[m], w * scratch.touch_c[m]
        scratch.region_nx[region] += w * scratch.touch_nx[m]
        scratch.region_ny[region] += w * scratch.touch_ny[m]
        scratch.region_nz[region] += w * scratch.touch_nz[m]
        scratch.region_rx[region] += w * scratch.touch_rx[m]
        scratch.region_ry[region] += w * scratch.touch_ry[m]
        scratch.region_rz[region] += w * scratch.touch_rz[m]
        scratch.region_vx[region] += wa * state.vx[a] + wb * state.vx[b] + wc * state.vx[c]
        scratch.region_vy[region] += wa * state.vy[a] + wb * state.vy[b] + wc * state.vy[c]
        scratch.region_vz[region] += wa * state.vz[a] + wb * state.vz[b] + wc * state.vz[c]
    for region in range(regions):
        n_ = (scratch.region_nx[region], scratch.region_ny[region], scratch.region_nz[region])
        size = dot(n_, n_) ** 0.5
        f = 1.0 / size if size > NORMAL_MIN else 0.0
        scratch.region_nx[region] *= f
        scratch.region_ny[region] *= f
        scratch.region_nz[region] *= f
    depth = 0.0
    for m in range(n):
        region = scratch.touch_region[m]
        inward = (scratch.region_nx[region], scratch.region_ny[region], scratch.region_nz[region])
        point = (scratch.region_rx[region], scratch.region_ry[region], scratch.region_rz[region])
        part = scratch.touch_part[m]
        if model.contact_response[contact] == HULL:
            # Neighbours nearly always met the same part: its depth is that of the one before.
            if m == 0 or part != scratch.touch_part[m - 1] or region != scratch.touch_region[m - 1]:
                first, last = model.hull_start[part], model.hull_start[part + 1]
                depth = hull_depth(point, inward, first, last, model.hull_x, model.hull_y, model.hull_z)
        else:
            depth = dot(
                penetration(point, inward, part, model.part_centre, model.part_axes, model.part_half), inward
            )
        scratch.region_depth[region] += scratch.touch_share[m] * depth


@inner
def _mobility(model, scratch, regions, n, density):
    """Velocity [m/s] that a unit impulse on each region gives to its mean point: sum of W_i^2 / m_i.

    W_i is the share of the region's force that vertex i takes. The damper of the law acts on the velocity at the end
    of the substep, which the force itself changes by this much.
    """
    weight = scratch.vertex_weight
    for region in range(regions):
        scratch.region_mobility[region] = 0.0
    for m in range(n):
        t = scratch.touch_triangle[m]
        weight[model.triangle_a[t]] = 0.0
        weight[model.triangle_b[t]] = 0.0
        weight[model.triangle_c[t]] = 0.0
    for m in range(n):
        t = scratch.touch_triangle[m]
        weight[model.triangle_a[t]] += scratch.touch_share[m] * scratch.touch_a[m]
        weight[model.triangle_b[t]] += scratch.touch_share[m] * scratch.touch_b[m]
        weight[model.triangle_c[t]] += scratch.touch_share[m] * scratch.touch_c[m]
    for m in range(n):
        t = scratch.touch_triangle[m]
        for v in (model.triangle_a[t], model.triangle_b[t], model.triangle_c[t]):
            scratch.region_mobility[scratch.touch_region[m]] += (
                weight[v] * weight[v] * model.node_mobility[v] / density
            )
            weight[v] = 0.0


@inner
def respond(model, parameters, state, scratch, contact, r, p, velocity, spin, dt):
    """Add the contact forces of one pair of objects to the tissue's vertices and to its instrument.

    Parameters
    ----------
    contact : int
        Which declared contact.
    r, p : tuple of nine, tuple of three
        Pose of the instrument's body frame: rotation matrix, position [m].
    velocity, spin : tuple of three
        Its velocity [m/s] and angular velocity [rad/s], world frame.
    dt : float
        Substep [s] over which the damper of the law is implicit: F = max(0, k d + c d') / (1 + dt c G) with the
        region's mobility G. 0 gives the law itself.

    Notes
    -----
    Forces on the vertices go to scratch.fx, fy, fz; what the instrument feels is added to its row of scratch.contact;
    the work of the instrument and what the damper dissipates within dt are added to the state.

    Returns
    -------
    float
        Energy [J] stored in the springs of the law, sum of k d^2 / 2.
    """
    i = model.contact_instrument[contact]
    tissue = model.contact_tissue[contact]
    density = parameters[TISSUE_PARAMETERS * tissue + AREAL_DENSITY]
    own = TISSUE_PARAMETERS * model.tissue_rate.size + CONTACT_PARAMETERS * contact
    stiffness, damping = parameters[own + CONTACT_STIFFNESS], parameters[own + CONTACT_DAMPING]
    n = _touch(model, state, scratch, contact, r, p)
    regions = _weigh(model, state, scratch, contact, n)
    _average(model, state, scratch, contact, regions, n)
    implicit = dt > 0.0 and damping > 0.0
    if implicit:
        _mobility(model, scratch, regions, n, density)
    row = GATHER * i
    gather = scratch.contact
    stored = 0.0
    for region in range(regions):
        inward = to_world(r, (scratch.region_nx[region], scratch.region_ny[region], scratch.region_nz[region]))
        arm = to_world(r, (scratch.region_rx[region], scratch.region_ry[region], scratch.region_rz[region]))
        turning = cross(spin, arm)
        rate = dot(
            inward,
            (
                velocity[0] + turning[0] - scratch.region_vx[region],
                velocity[1] + turning[1] - scratch.region_vy[region],
                velocity[2] + turning[2] - scratch.region_vz[region],
            ),
        )
        depth = scratch.region_depth[region]
        force = 0.0
        if depth > 0.0:
            force = kelvin_voigt(depth, rate, stiffness, damping)
            if implicit:
                force /= 1.0 + dt * damping * scratch.region_mobility[region]
            count = 1.0 if model.contact_weighted[contact] == 1 else scratch.touch_pairs[region]
            state.dissipated[0] += dt * count * (force - stiffness * depth) * rate
            stored += 0.5 * count * stiffness * depth * depth
            force *= count
            gather[row + GATHER_DEPTH] = max(gather[row + GATHER_DEPTH], depth)
        fx, fy, fz = force * inward[0], force * inward[1], force * inward[2]
        scratch.region_vx[region] = fx  # the velocities have done their work: the forces take their place
        scratch.region_vy[region] = fy
        scratch.region_vz[region] = fz
        moment = cross(arm, (fx, fy, fz))
        gather[row + GATHER_FORCE] -= fx
        gather[row + GATHER_FORCE + 1] -= fy
        gather[row + GATHER_FORCE + 2] -= fz
        gather[row + GATHER_TORQUE] -= moment[0]
        gather[row + GATHER_TORQUE + 1] -= moment[1]
        gather[row + GATHER_TORQUE + 2] -= moment[2]
        gather[row + GATHER_SIZE] += force
        gather[row + GATHER_POINT] += force * (p[0] + arm[0])
        gather[row + GATHER_POINT + 1] += force * (p[1] + arm[1])
        gather[row + GATHER_POINT + 2] += force * (p[2] + arm[2])
        state.work[0] += dt * (dot(velocity, (fx, fy, fz)) + dot(spin, moment))
    for m in range(n):
        t, region, w = scratch.touch_triangle[m], scratch.touch_region[m], scratch.touch_share[m]
        for v, share in (
            (model.triangle_a[t], w * scratch.touch_a[m]),
            (model.triangle_b[t], w * scratch.touch_b[m]),
            (model.triangle_c[t], w * scratch.touch_c[m]),
        ):
            scratch.fx[v] += share * scratch.region_vx[region]
            scratch.fy[v] += share * scratch.region_vy[region]
            scratch.fz[v] += share * scratch.region_vz[region]
    gather[row + GATHER_REGIONS] += state.region_count[contact]
    return stored
