"""Response to intersecting triangles: the force of every touch (thesis 3.6, model sections 5 and 6).

Between two detections a touch keeps its place on the tissue, its share and its normal; depth and rate follow the
motion. So between detections the contact is a true spring, whose force is minus the gradient of its energy, and the
work per substep is small.
"""

import math

from tissue_contact.kernels.collision import LITERAL, PRIMITIVE, body_size, penetration, support
from tissue_contact.kernels.compiled import inner
from tissue_contact.kernels.contact import (
    contact_law,
    gather,
    moving_point,
    note,
    note_split,
    press,
    press_elastic,
    scatter,
)
from tissue_contact.kernels.slots import GATHER, GATHER_REGIONS
from tissue_contact.kernels.vectors import dot, to_body, to_world

LITERAL_SPEED = 1e-3  # [m/s], below which the direction of motion gives way to the normal


@inner
def _literal(model, part, r, point, inward, velocity):
    """Deformation vector of the thesis (3.8), (D . v^) v^, as a depth [m] along a world direction.

    The direction of motion v^ is blended to the inner normal where the body stands still, and what would pull the
    tissue outward counts as no depth: the thesis divides by zero in the one case and attracts in the other.
    """
    d = to_world(r, penetration(point, to_body(r, inward), part, model.part_centre, model.part_axes, model.part_half))
    speed = math.sqrt(dot(velocity, velocity))
    moving = 1.0 / math.sqrt(speed * speed + LITERAL_SPEED * LITERAL_SPEED)
    still = 1.0 - speed * moving
    x = velocity[0] * moving + still * inward[0]
    y = velocity[1] * moving + still * inward[1]
    z = velocity[2] * moving + still * inward[2]
    size = math.sqrt(x * x + y * y + z * z)
    if not size > 0.0:
        return 0.0, inward
    x, y, z = x / size, y / size, z / size
    depth = d[0] * x + d[1] * y + d[2] * z
    if depth < 0.0:
        depth, x, y, z = -depth, -x, -y, -z
    if not x * inward[0] + y * inward[1] + z * inward[2] > 0.0:
        return 0.0, inward
    return depth, (x, y, z)


@inner
def _depth(model, state, contact, m, r, arm, inward, velocity):
    """Depth [m] of the touched part below the plane through the point arm, and the direction of the push."""
    point, normal = to_body(r, arm), to_body(r, inward)
    kind = model.contact_response[contact]
    if kind == LITERAL:
        return _literal(model, state.touch_part[m], r, point, inward, velocity)
    v = int(state.touch_support[m])
    if kind == PRIMITIVE:
        corner = (model.body_x[v], model.body_y[v], model.body_z[v])
    else:
        v = support(normal, v, model.hull_edge_start, model.hull_neighbour, model.hull_x, model.hull_y, model.hull_z)
        state.touch_support[m] = v
        corner = (model.hull_x[v], model.hull_y[v], model.hull_z[v])
    return dot(normal, (corner[0] - point[0], corner[1] - point[1], corner[2] - point[2])), inward


@inner
def respond(model, parameters, state, scratch, contact, r, p, velocity, spin, tau, split):
    """Add the forces of a contact's touches to the tissue's vertices and to its body.

    Parameters
    ----------
    contact : int
        Which declared contact.
    r, p : tuple of nine, tuple of three
        Pose of the body frame: rotation matrix, position [m].
    velocity, spin : tuple of three
        Its velocity [m/s] and angular velocity [rad/s], world frame.
    tau : float
        Time [s] for which work and dissipation are counted.
    split : bool
        Only the springs of the law act now, and `damping.damp_contacts` follows.

    Returns
    -------
    float
        Energy [J] stored in the springs of the law.
    """
    body = model.contact_body[contact]
    first = model.contact_touch_start[contact]
    law, noted = contact_law(model, parameters, contact), scratch.active_a.size > 0
    row, out = GATHER * body, scratch.contact
    fx, fy, fz = scratch.fx, scratch.fy, scratch.fz
    x, y, z, vx, vy, vz = state.x, state.y, state.z, state.vx, state.vy, state.vz
    total, work, dissipated, deepest = 0.0, 0.0, 0.0, 0.0
    # No touch is deeper than the body is long, nor so far from it: such a one is of long ago and touches no more.
    longest = body_size(model, body)
    far = model.body_radius[body] + longest
    for m in range(first, first + state.touches[contact]):
        t, w = state.touch_triangle[m], state.touch_share[m]
        a, b, c = model.triangle_a[t], model.triangle_b[t], model.triangle_c[t]
        wa, wb, wc = state.touch_a[m], state.touch_b[m], state.touch_c[m]
        inward = (state.touch_nx[m], state.touch_ny[m], state.touch_nz[m])
        arm = (
            wa * x[a] + wb * x[b] + wc * x[c] - p[0],
            wa * y[a] + wb * y[b] + wc * y[c] - p[1],
            wa * z[a] + wb * z[b] + wc * z[c] - p[2],
        )
        if dot(arm, arm) > far * far:
            continue
        own = moving_point(velocity, spin, arm)
        against = (
            own[0] - (wa * vx[a] + wb * vx[b] + wc * vx[c]),
            own[1] - (wa * vy[a] + wb * vy[b] + wc * vy[c]),
            own[2] - (wa * vz[a] + wb * vz[b] + wc * vz[c]),
        )
        depth, direction = _depth(model, state, contact, m, r, arm, inward, against)
        if not 0.0 < depth <= longest:
            continue
        if split:
            elastic, stored, viscous = press_elastic(law, depth)
            size, power = elastic, 0.0
            unit = (elastic * direction[0], elastic * direction[1], elastic * direction[2])
            place = note(scratch, a, b, c, wa, wb, wc, direction, w * viscous, w * elastic)
            note_split(scratch, place, contact, arm)
        else:
            unit, size, stored, power, tangent, viscous, sticking = press(law, depth, direction, against)
            if noted:
                normal = w * tau * (tau * tangent + viscous)
                note(scratch, a, b, c, wa, wb, wc, direction, normal, w * tau * sticking)
        force = (w * unit[0], w * unit[1], w * unit[2])
        scatter(fx, fy, fz, a, b, c, wa, wb, wc, force)
        gather(out, row, p, arm, (-force[0], -force[1], -force[2]), w * size, depth)
        deepest = max(deepest, depth)
        total += w * stored
        work += dot(own, force)
        dissipated += w * power
    state.deepest[contact] = deepest
    state.work[0] += tau * work
    state.dissipated[0] += tau * dissipated
    out[row + GATHER_REGIONS] += state.regions[contact]
    return total
