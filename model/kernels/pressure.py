"""Response by the distance field of a rigid body: pressure times area at points of the other surface.

After Hirota (thesis 2.1.2), but the field belongs to the body, which is rigid, so it never goes stale. Depth is minus
the field's distance and the push follows its gradient exactly, so the force is minus the gradient of an energy.
"""

from tissue_contact.kernels.compiled import inner, pointwise
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
from tissue_contact.kernels.field import GRID, body_distance, fields_of, triangle_distances
from tissue_contact.kernels.near import gap_to, middle_of
from tissue_contact.kernels.side import REJECTED
from tissue_contact.kernels.slots import GATHER, GATHER_REGIONS
from tissue_contact.kernels.vectors import dot, to_body, to_world

FEW = 3  # points of a triangle that are sooner read than the triangle is tried
STEEP = 2.0  # how much faster than distance a sampled field may grow, near the edges of what it was sampled from


@inner
def steepness(model, first_part, last_part):
    """How much faster than distance the field of a body may grow."""
    steep = 1.0
    for part in range(first_part, last_part):
        if model.part_field[part] == GRID:
            steep = STEEP
    return steep


@pointwise
def out_of_reach(model, first_part, last_part, steep, a, b, c):
    """Whether no point of a triangle lies within a body; corners [m] in the body frame."""
    middle, _, _, _, radius = middle_of(a, b, c)
    return gap_to(model, first_part, last_part, middle) > steep * radius


@inner
def press_tissue(model, parameters, state, scratch, contact, r, p, velocity, spin, tau, split):
    """Add the forces between the points of a tissue and the field of a body; arguments and result as for `respond`."""
    tissue, body = model.contact_tissue[contact], model.contact_body[contact]
    first_part, last_part = model.body_part_start[body], model.body_part_start[body + 1]
    sides = model.contact_side_start[contact]
    origin = model.tissue_triangle_start[tissue]
    begin = model.contact_near_start[contact]
    fields, law, noted = fields_of(model), contact_law(model, parameters, contact), scratch.active_a.size > 0
    steep = steepness(model, first_part, last_part)
    phi, normal_x, normal_y, normal_z = scratch.point_distance, scratch.point_x, scratch.point_y, scratch.point_z
    row, out = GATHER * body, scratch.contact
    fx, fy, fz = scratch.fx, scratch.fy, scratch.fz
    x, y, z, vx, vy, vz = state.x, state.y, state.z, state.vx, state.vy, state.vz
    total, work, dissipated, deepest = 0.0, 0.0, 0.0, 0.0
    for k in range(begin, begin + state.near_count[contact]):
        t = state.near[k]
        scratch.touching[k] = 1 if state.side[sides + t - origin] == REJECTED else 0
        if scratch.touching[k] == 1:
            continue
        a, b, c = model.triangle_a[t], model.triangle_b[t], model.triangle_c[t]
        ax, ay, az = x[a] - p[0], y[a] - p[1], z[a] - p[2]
        bx, by, bz = x[b] - p[0], y[b] - p[1], z[b] - p[2]
        cx, cy, cz = x[c] - p[0], y[c] - p[1], z[c] - p[2]
        first, last = model.triangle_point_start[t], model.triangle_point_start[t + 1]
        # Most points do not touch: corners are turned into the body frame, not points.
        u, v, w = to_body(r, (ax, ay, az)), to_body(r, (bx, by, bz)), to_body(r, (cx, cy, cz))
        if last - first > FEW and out_of_reach(model, first_part, last_part, steep, u, v, w):
            continue
        triangle_distances(
            fields, first_part, last_part, u, v, w,
            model.point_a[first:last], model.point_b[first:last], model.point_c[first:last],
            phi, normal_x, normal_y, normal_z,
        )  # fmt: skip
        for q in range(first, last):
            distance = phi[q - first]
            if not distance < 0.0:
                continue
            scratch.touching[k] = 1
            direction = to_world(r, (normal_x[q - first], normal_y[q - first], normal_z[q - first]))
            if direction[0] == 0.0 and direction[1] == 0.0 and direction[2] == 0.0:
                continue  # in the middle of the body, as far from one side as from the other
            wa, wb, wc = model.point_a[q], model.point_b[q], model.point_c[q]
            arm = (wa * ax + wb * bx + wc * cx, wa * ay + wb * by + wc * cy, wa * az + wb * bz + wc * cz)
            own = moving_point(velocity, spin, arm)
            against = (
                own[0] - (wa * vx[a] + wb * vx[b] + wc * vx[c]),
                own[1] - (wa * vy[a] + wb * vy[b] + wc * vy[c]),
                own[2] - (wa * vz[a] + wb * vz[b] + wc * vz[c]),
            )
            depth, area = -distance, model.point_area[q]
            if split:
                elastic, stored, viscous = press_elastic(law, depth)
                size, power = elastic, 0.0
                unit = (elastic * direction[0], elastic * direction[1], elastic * direction[2])
                place = note(scratch, a, b, c, wa, wb, wc, direction, area * viscous, area * elastic)
                note_split(scratch, place, contact, arm)
            else:
                unit, size, stored, power, tangent, viscous, sticking = press(law, depth, direction, against)
                if noted:
                    normal = area * tau * (tau * tangent + viscous)
                    note(scratch, a, b, c, wa, wb, wc, direction, normal, area * tau * sticking)
            force = (area * unit[0], area * unit[1], area * unit[2])
            scatter(fx, fy, fz, a, b, c, wa, wb, wc, force)
            gather(out, row, p, arm, (-force[0], -force[1], -force[2]), area * size, depth)
            deepest = max(deepest, depth)
            total += area * stored
            work += dot(own, force)
            dissipated += area * power
    state.deepest[contact] = deepest
    state.work[0] += tau * work
    state.dissipated[0] += tau * dissipated
    if deepest > 0.0:
        out[row + GATHER_REGIONS] += 1.0
    return total


@inner
def press_bodies(model, parameters, state, scratch, contact, r, p, velocity, spin, r2, p2, velocity2, spin2, tau):
    """Add the forces between two rigid bodies: points of the second read depth in the field of the first.

    ``r``, ``p``, ``velocity``, ``spin`` are those of the body with the field, those with a 2 of the other one; the
    rest and the result as for `respond`. Both bodies move as they are told, so nothing is split.
    """
    body, other = model.contact_body[contact], model.contact_other[contact]
    first_part, last_part = model.body_part_start[body], model.body_part_start[body + 1]
    begin = model.contact_near_start[contact]
    fields, law = fields_of(model), contact_law(model, parameters, contact)
    row, row2, out = GATHER * body, GATHER * other, scratch.contact
    total, work, dissipated, deepest = 0.0, 0.0, 0.0, 0.0
    for k in range(begin, begin + state.near_count[contact]):
        s = state.near[k]
        arm2 = to_world(r2, (model.sample_x[s], model.sample_y[s], model.sample_z[s]))
        arm = (p2[0] + arm2[0] - p[0], p2[1] + arm2[1] - p[1], p2[2] + arm2[2] - p[2])
        distance, gx, gy, gz = body_distance(fields, first_part, last_part, to_body(r, arm))
        if not distance < 0.0:
            continue
        own, theirs = moving_point(velocity, spin, arm), moving_point(velocity2, spin2, arm2)
        against = (own[0] - theirs[0], own[1] - theirs[1], own[2] - theirs[2])
        direction = to_world(r, (gx, gy, gz))
        if direction[0] == 0.0 and direction[1] == 0.0 and direction[2] == 0.0:
            continue
        depth, area = -distance, model.sample_area[s]
        unit, size, stored, power, _, _, _ = press(law, depth, direction, against)
        force = (area * unit[0], area * unit[1], area * unit[2])
        gather(out, row2, p2, arm2, force, area * size, depth)
        gather(out, row, p, arm, (-force[0], -force[1], -force[2]), area * size, depth)
        deepest = max(deepest, depth)
        total += area * stored
        work += dot(against, force)
        dissipated += area * power
    state.deepest[contact] = deepest
    state.work[0] += tau * work
    state.dissipated[0] += tau * dissipated
    if deepest > 0.0:
        out[row + GATHER_REGIONS] += 1.0
        out[row2 + GATHER_REGIONS] += 1.0
    return total
