"""From the pairs of a detection to touches: where they are, which way they face, how they share the force.

The pairs of a tissue triangle with one part of the instrument are one *touch*, with one point of collision. All the
touches of a part are one contact region, and share one force of the law: the share is the length of the intersection
curve within the triangle. The curve in which two surfaces meet does not depend on how they are cut into triangles, so
neither does the force. (The raw sum over pairs that the thesis implies grows with their number; it stays available as
``pair_weight = "none"``: the force of a touch then counts once for every pair.)
"""

import math

from tissue_contact.kernels.collision import PRIMITIVE, pair_point
from tissue_contact.kernels.compiled import inner
from tissue_contact.kernels.vectors import cross, dot, to_world


@inner
def _deepest(model, u, normal, best, height):
    """Corner of body triangle u that lies deepest below a tissue plane, if below the best so far."""
    for v in (model.body_a[u], model.body_b[u], model.body_c[u]):
        h = normal[0] * model.body_x[v] + normal[1] * model.body_y[v] + normal[2] * model.body_z[v]
        if h < height:
            best, height = int(v), h
    return best, height


@inner
def _gather(model, state, scratch, contact, first, r):
    """Make touches of the pairs of one contact; their count."""
    last = state.pairs[contact]
    first_part = model.body_part_start[model.contact_body[contact]]
    n = 0
    k = 0
    while k < last:
        t = scratch.pair_triangle[k]
        part = model.body_part[scratch.pair_instrument[k]]
        a, b, c = model.triangle_a[t], model.triangle_b[t], model.triangle_c[t]
        t1 = (scratch.local_x[a], scratch.local_y[a], scratch.local_z[a])
        e1 = (scratch.local_x[b] - t1[0], scratch.local_y[b] - t1[1], scratch.local_z[b] - t1[2])
        e2 = (scratch.local_x[c] - t1[0], scratch.local_y[c] - t1[1], scratch.local_z[c] - t1[2])
        normal = cross(e1, e2)
        nn = dot(normal, normal)
        length, wa, wb, wc = 0.0, 0.0, 0.0, 0.0
        plain_a, plain_b, plain_c, pairs = 0.0, 0.0, 0.0, 0.0
        deepest, height = 0, math.inf
        while k < last and scratch.pair_triangle[k] == t and model.body_part[scratch.pair_instrument[k]] == part:
            w, piece = pair_point(model, scratch.pair_instrument[k], t1, e1, e2, normal, nn)
            length += piece
            wa += piece * w[0]
            wb += piece * w[1]
            wc += piece * w[2]
            plain_a += w[0]
            plain_b += w[1]
            plain_c += w[2]
            if model.contact_response[contact] == PRIMITIVE:
                deepest, height = _deepest(model, scratch.pair_instrument[k], normal, deepest, height)
            pairs += 1.0
            k += 1
        if length > 0.0:
            wa, wb, wc = wa / length, wb / length, wc / length
        else:  # touching in points only
            wa, wb, wc = plain_a / pairs, plain_b / pairs, plain_c / pairs
        size = nn**0.5
        m = first + n
        state.touch_triangle[m] = t
        state.touch_part[m] = part
        if model.contact_response[contact] != PRIMITIVE:
            state.touch_support[m] = model.hull_start[model.contact_hull[contact] + part - first_part]
        else:
            state.touch_support[m] = deepest
        state.touch_a[m], state.touch_b[m], state.touch_c[m] = wa, wb, wc
        state.touch_nx[m], state.touch_ny[m], state.touch_nz[m] = to_world(
            r, (-normal[0] / size, -normal[1] / size, -normal[2] / size)
        )
        scratch.touch_length[n] = length
        scratch.touch_pairs[n] = pairs
        n += 1
    return n


@inner
def _share(model, state, scratch, contact, first, n):
    """Give every touch its share of the force of its part, and count the parts."""
    for part in range(scratch.part_length.size):
        scratch.part_length[part] = 0.0
        scratch.part_touches[part] = 0.0
    for m in range(n):
        scratch.part_length[state.touch_part[first + m]] += scratch.touch_length[m]
        scratch.part_touches[state.touch_part[first + m]] += 1.0
    state.regions[contact] = 0
    for part in range(scratch.part_length.size):
        if scratch.part_touches[part] > 0.0:
            state.regions[contact] += 1
    for m in range(n):
        part = state.touch_part[first + m]
        share = 1.0 / scratch.part_touches[part]
        if scratch.part_length[part] > 0.0:
            share = scratch.touch_length[m] / scratch.part_length[part]
        if model.contact_weighted[contact] == 0:
            share = scratch.touch_pairs[m]
        state.touch_share[first + m] = share


@inner
def _load(model, state, scratch, contact, first, n):
    """Find the largest of W_i / A_i, W_i the share of the force that vertex i takes, A_i its area."""
    share = scratch.vertex_share
    for m in range(first, first + n):
        t = state.touch_triangle[m]
        share[model.triangle_a[t]] = 0.0
        share[model.triangle_b[t]] = 0.0
        share[model.triangle_c[t]] = 0.0
    for m in range(first, first + n):
        t, w = state.touch_triangle[m], state.touch_share[m]
        share[model.triangle_a[t]] += w * state.touch_a[m]
        share[model.triangle_b[t]] += w * state.touch_b[m]
        share[model.triangle_c[t]] += w * state.touch_c[m]
    state.touch_load[contact] = 0.0
    for m in range(first, first + n):
        t = state.touch_triangle[m]
        for v in (model.triangle_a[t], model.triangle_b[t], model.triangle_c[t]):
            state.touch_load[contact] = max(state.touch_load[contact], share[v] * model.node_mobility[v])


@inner
def find_touches(model, state, scratch, contact, r):
    """Turn the pairs that `detect` left into the touches of one contact, in the state.

    ``r`` is the rotation matrix of the instrument.
    """
    first = model.contact_touch_start[contact]
    n = _gather(model, state, scratch, contact, first, r)
    _share(model, state, scratch, contact, first, n)
    _load(model, state, scratch, contact, first, n)
    state.touches[contact] = n
