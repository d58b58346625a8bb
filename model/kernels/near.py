"""What lies near a rigid body: the triangles of a tissue, or the points of another body, that its field may reach.

The counterpart of `detection` for contacts by distance field. Until the next detection the response looks at what was
found here and at nothing else.
"""

import math

from tissue_contact.kernels.collision import facing, shaft
from tissue_contact.kernels.compiled import inner, pointwise
from tissue_contact.kernels.field import FAR, GRID, fields_of, part_distance
from tissue_contact.kernels.occupancy import find_candidates, in_body
from tissue_contact.kernels.side import FACING, REJECTED, latch
from tissue_contact.kernels.vectors import cross, dot, to_body, to_world

# Share of the thinnest half extent that bodies may move between two continuous detections.
MOTION = 0.25


@inner
def is_by_motion(model):
    """Whether detections come as bodies and tissues move, each before the substep that asks for it, not by a period."""
    return model.detection_period[0] == math.inf


@inner
def margin_of(model, contact, ahead):
    """Distance [m] from the body of a contact within which what may be touched until the next detection is.

    All that bodies may move until then, and what they move ``ahead`` in the next substep as a share of it, at most as
    far again: a tissue may go faster by then.
    """
    return (1.0 + min(1.0, ahead)) * MOTION * model.contact_reach[contact]


@pointwise
def middle_of(a, b, c):
    """Middle of a triangle, its corners from there, and the distance of the farthest [m]."""
    middle = ((a[0] + b[0] + c[0]) / 3.0, (a[1] + b[1] + c[1]) / 3.0, (a[2] + b[2] + c[2]) / 3.0)
    u = (a[0] - middle[0], a[1] - middle[1], a[2] - middle[2])
    v = (b[0] - middle[0], b[1] - middle[1], b[2] - middle[2])
    w = (c[0] - middle[0], c[1] - middle[1], c[2] - middle[2])
    return middle, u, v, w, math.sqrt(max(dot(u, u), dot(v, v), dot(w, w)))


@inner
def gap_to(model, first, last, p):
    """Distance of a point from a body, or less: beyond the grid of a sampled part it is that from the grid."""
    gap = math.inf
    fields = fields_of(model)
    for k in range(first, last):
        distance, _, _, _ = part_distance(fields, k, p)
        if distance == FAR and model.part_field[k] == GRID:
            square = 0.0
            for axis in range(3):
                low = model.field_low[3 * k + axis] + model.field_spacing[k]
                high = low + (model.field_size[3 * k + axis] - 3.0) * model.field_spacing[k]
                beyond = max(0.0, low - p[axis], p[axis] - high)
                square += beyond * beyond
            distance = math.sqrt(square)
        gap = min(gap, distance)
    return gap


@inner
def _nearest_part(model, first, last, p):
    """The part of a body whose surface is nearest to a point of its frame."""
    if last - first == 1:
        return first
    best, part = math.inf, first
    fields = fields_of(model)
    for k in range(first, last):
        distance, _, _, _ = part_distance(fields, k, p)
        if distance < best:
            best, part = distance, k
    return part


@inner
def _turn_side(model, state, contact, side, middle, u, v, w, part, axis):
    """Latch the side of a triangle anew; the part of the body that it is nearest to, and its shaft axis.

    ``middle``, ``u``, ``v``, ``w`` are as from `middle_of`, ``part`` and ``axis`` those of the triangle before.
    """
    if model.contact_both[contact] == 1:
        state.side[side] = FACING
        return part, axis
    normal = cross((v[0] - u[0], v[1] - u[1], v[2] - u[2]), (w[0] - u[0], w[1] - u[1], w[2] - u[2]))
    size = math.sqrt(dot(normal, normal))
    if size > 0.0:
        body = model.contact_body[contact]
        nearest = _nearest_part(model, model.body_part_start[body], model.body_part_start[body + 1], middle)
        if nearest != part:
            part, axis = nearest, shaft(model.part_axis, nearest)
        state.side[side] = latch(state.side[side], facing(middle, normal, axis, model.part_reach[part]) / size)
    elif state.side[side] == 0:
        state.side[side] = FACING
    return part, axis


@inner
def turn_sides(model, state, scratch, contact, r, p):
    """Latch the sides of the triangles near a field anew that touch it or are rejected, as `press_tissue` noted.

    ``r`` and ``p`` are as for `find_near_triangles`.
    """
    body, begin = model.contact_body[contact], model.contact_near_start[contact]
    shift = model.contact_side_start[contact] - model.tissue_triangle_start[model.contact_tissue[contact]]
    first_part, last_part = model.body_part_start[body], model.body_part_start[body + 1]
    part, axis = first_part, shaft(model.part_axis, first_part)
    rejected = 0
    for k in range(begin, begin + state.near_count[contact]):
        if scratch.touching[k] == 0:
            continue
        t = state.near[k]
        middle, u, v, w, _ = middle_of(
            in_body(state, model.triangle_a[t], r, p),
            in_body(state, model.triangle_b[t], r, p),
            in_body(state, model.triangle_c[t], r, p),
        )
        part, axis = _turn_side(model, state, contact, shift + t, middle, u, v, w, part, axis)
        if state.side[shift + t] == REJECTED and gap_to(model, first_part, last_part, middle) < 0.0:
            rejected += 1
    state.rejected[contact] = rejected


@inner
def find_near_triangles(model, state, scratch, contact, r, p, known, ahead):
    """Find the triangles of a tissue near its body, and on which side of the tissue the body is.

    ``r`` and ``p`` [m] are the rotation matrix and the position of the body frame, ``known`` is as for
    `find_candidates`, ``ahead`` as for `margin_of`. The triangles go to state.near, the latched sides to state.side. By
    motion only what is new gets a side, and `turn_sides` looks at the others: no side depends on when detections come.
    """
    tissue, body = model.contact_tissue[contact], model.contact_body[contact]
    margin = margin_of(model, contact, ahead)
    low = (
        model.body_low[3 * body] - margin,
        model.body_low[3 * body + 1] - margin,
        model.body_low[3 * body + 2] - margin,
    )
    high = (
        model.body_high[3 * body] + margin,
        model.body_high[3 * body + 1] + margin,
        model.body_high[3 * body + 2] + margin,
    )
    origin, sides = model.tissue_triangle_start[tissue], model.contact_side_start[contact]
    begin = model.contact_near_start[contact]
    first_part, last_part = model.body_part_start[body], model.body_part_start[body + 1]
    part, axis = first_part, shaft(model.part_axis, first_part)
    n, rejected = 0, 0
    x, y, z = scratch.local_x, scratch.local_y, scratch.local_z
    for k in range(find_candidates(model, state, scratch, contact, r, p, low, high, known)):
        t = scratch.candidate[k]
        side = sides + t - origin
        a, b, c = model.triangle_a[t], model.triangle_b[t], model.triangle_c[t]
        middle, u, v, w, radius = middle_of((x[a], y[a], z[a]), (x[b], y[b], z[b]), (x[c], y[c], z[c]))
        distance = gap_to(model, first_part, last_part, middle)
        if not distance < radius + margin:
            state.side[side] = 0
            continue
        if state.side[side] == 0 or not is_by_motion(model):
            part, axis = _turn_side(model, state, contact, side, middle, u, v, w, part, axis)
        if state.side[side] == REJECTED and distance < 0.0:
            rejected += 1
        state.near[begin + n] = t
        n += 1
    state.near_count[contact] = n
    state.pairs[contact] = n
    state.rejected[contact] = rejected


@inner
def find_near_samples(model, state, contact, r, p, r2, p2, ahead):
    """Find the sample points of the contact's other body near the field of its body, into state.near.

    ``r``, ``p`` are the pose of the body with the field, ``r2``, ``p2`` that of the other one, ``ahead`` is as for
    `margin_of`.
    """
    body, other = model.contact_body[contact], model.contact_other[contact]
    margin = margin_of(model, contact, ahead)
    begin = model.contact_near_start[contact]
    first_part, last_part = model.body_part_start[body], model.body_part_start[body + 1]
    n = 0
    for s in range(model.body_sample_start[other], model.body_sample_start[other + 1]):
        q = to_world(r2, (model.sample_x[s], model.sample_y[s], model.sample_z[s]))
        q = to_body(r, (p2[0] + q[0] - p[0], p2[1] + q[1] - p[1], p2[2] + q[2] - p[2]))
        outside = False
        for k in range(3):
            outside |= q[k] < model.body_low[3 * body + k] - margin or q[k] > model.body_high[3 * body + k] + margin
        if outside:
            continue
        distance = gap_to(model, first_part, last_part, q)
        if distance < margin:
            state.near[begin + n] = s
            n += 1
    state.near_count[contact] = n
    state.pairs[contact] = n
