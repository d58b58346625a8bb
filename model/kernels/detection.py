"""Collision detection: spatial occupancy with a hashed, cascaded structure (OHC; thesis 3.4).

Space is cut in equal cells, here in the body frame of the instrument: the instrument is rigid, so its own occupancy is
found once, offline, and the hash of a cell is its number in the grid over the instrument's box. Cells of a detection
are *empty*, *solo* (one object) or *potentially colliding* (both). The cascade: blocks of tissue triangles against the
instrument's box, by a ball around each and by the faces that their vertices lie beyond, then each triangle by those of
its corners, then the cells, and only the potentially colliding ones go to the exact triangle-triangle test. Cost
follows the contact region but for the balls.
"""

from tissue_contact.kernels.collision import facing, pair_point, shaft
from tissue_contact.kernels.compiled import inner
from tissue_contact.kernels.occupancy import find_candidates
from tissue_contact.kernels.side import REJECTED, latch
from tissue_contact.kernels.tritri import INTERSECT, intersect
from tissue_contact.kernels.vectors import cross, dot
from tissue_contact.status import OK, TOO_MANY_PAIRS

EMPTY, SOLO, POTENTIAL = 0, 1, 2  # classes of cells, places in scratch.cells


@inner
def _cell(value, low, edge, n):
    """Cell of a coordinate, held within the grid before it becomes an integer; not-a-number goes to cell 0."""
    cell = (value - low) / edge
    if not cell > 0.0:
        return 0
    return n - 1 if cell >= n else int(cell)


@inner
def _corners(model, scratch, t):
    """Corners of a tissue triangle in the body frame."""
    a, b, c = model.triangle_a[t], model.triangle_b[t], model.triangle_c[t]
    return (
        (scratch.local_x[a], scratch.local_y[a], scratch.local_z[a]),
        (scratch.local_x[b], scratch.local_y[b], scratch.local_z[b]),
        (scratch.local_x[c], scratch.local_y[c], scratch.local_z[c]),
    )


@inner
def _hits(model, scratch, i, t, t1, t2, t3):
    """Instrument triangles of instrument i that intersect tissue triangle t, sorted, in scratch.hit; their count."""
    low = (min(t1[0], t2[0], t3[0]), min(t1[1], t2[1], t3[1]), min(t1[2], t2[2], t3[2]))
    high = (max(t1[0], t2[0], t3[0]), max(t1[1], t2[1], t3[1]), max(t1[2], t2[2], t3[2]))
    edge = model.grid_cell[i]
    nx, ny, nz = model.grid_size[3 * i], model.grid_size[3 * i + 1], model.grid_size[3 * i + 2]
    gx, gy, gz = model.grid_low[3 * i], model.grid_low[3 * i + 1], model.grid_low[3 * i + 2]
    cells = model.grid_cell_start[i]
    n = 0
    for ix in range(_cell(low[0], gx, edge, nx), _cell(high[0], gx, edge, nx) + 1):
        for iy in range(_cell(low[1], gy, edge, ny), _cell(high[1], gy, edge, ny) + 1):
            for iz in range(_cell(low[2], gz, edge, nz), _cell(high[2], gz, edge, nz) + 1):
                cell = (ix * ny + iy) * nz + iz
                first, last = model.cell_start[cells + cell], model.cell_start[cells + cell + 1]
                if scratch.cell_stamp[cell] == 0:
                    scratch.cell_stamp[cell] = 1
                    scratch.cells[SOLO if first == last else POTENTIAL] += 1
                for k in range(first, last):
                    u = model.cell_triangle[k]
                    if scratch.stamp[u] == t + 1:
                        continue
                    scratch.stamp[u] = t + 1
                    if (
                        model.body_triangle_low[3 * u] > high[0]
                        or model.body_triangle_low[3 * u + 1] > high[1]
                        or model.body_triangle_low[3 * u + 2] > high[2]
                        or model.body_triangle_high[3 * u] < low[0]
                        or model.body_triangle_high[3 * u + 1] < low[1]
                        or model.body_triangle_high[3 * u + 2] < low[2]
                    ):
                        continue
                    a, b, c = model.body_a[u], model.body_b[u], model.body_c[u]
                    i1 = (model.body_x[a], model.body_y[a], model.body_z[a])
                    i2 = (model.body_x[b], model.body_y[b], model.body_z[b])
                    i3 = (model.body_x[c], model.body_y[c], model.body_z[c])
                    if intersect(t1, t2, t3, i1, i2, i3, scratch.expansion) == INTERSECT:
                        k_sorted = n
                        while k_sorted > 0 and scratch.hit[k_sorted - 1] > u:
                            scratch.hit[k_sorted] = scratch.hit[k_sorted - 1]
                            k_sorted -= 1
                        scratch.hit[k_sorted] = u
                        n += 1
    return n


@inner
def _latch(model, scratch, latched, n, t1, t2, t3):
    """Side of a touched triangle, from its hits and the side that it was latched on."""
    e1 = (t2[0] - t1[0], t2[1] - t1[1], t2[2] - t1[2])
    e2 = (t3[0] - t1[0], t3[1] - t1[1], t3[2] - t1[2])
    normal = cross(e1, e2)
    nn = dot(normal, normal)
    if nn == 0.0:
        return REJECTED
    size = nn**0.5
    outer = (normal[0] / size, normal[1] / size, normal[2] / size)
    total = 0.0
    for k in range(n):
        u = scratch.hit[k]
        w, _ = pair_point(model, u, t1, e1, e2, normal, nn)
        p = (
            t1[0] + w[1] * e1[0] + w[2] * e2[0],
            t1[1] + w[1] * e1[1] + w[2] * e2[1],
            t1[2] + w[1] * e1[2] + w[2] * e2[2],
        )
        part = model.body_part[u]
        total += facing(p, outer, shaft(model.part_axis, part), model.part_reach[part])
    return latch(latched, total / n)


@inner
def detect(model, state, scratch, contact, r, p, known):
    """Find the intersecting triangle pairs of one contact, into scratch.pair_triangle and scratch.pair_instrument.

    Parameters
    ----------
    contact : int
        Which declared contact.
    r, p : tuple of nine, tuple of three
        Rotation matrix and position [m] of the instrument's body frame.
    known : bool
        As for `find_candidates`.

    Returns
    -------
    int
        Status. The pairs are each there once, ordered by tissue triangle, then instrument triangle; their number and
        that of the rejected ones, and the latched sides, go to the state.
    """
    tissue, i = model.contact_tissue[contact], model.contact_body[contact]
    nx, ny, nz = model.grid_size[3 * i], model.grid_size[3 * i + 1], model.grid_size[3 * i + 2]
    edge = model.grid_cell[i]
    low = (model.grid_low[3 * i], model.grid_low[3 * i + 1], model.grid_low[3 * i + 2])
    high = (low[0] + nx * edge, low[1] + ny * edge, low[2] + nz * edge)
    capacity = model.contact_touch_start[contact + 1] - model.contact_touch_start[contact]
    origin, sides = model.tissue_triangle_start[tissue], model.contact_side_start[contact]
    begin = model.contact_near_start[contact]
    candidates = find_candidates(model, state, scratch, contact, r, p, low, high, known)
    state.pairs[contact] = 0
    state.rejected[contact] = 0
    state.near_count[contact] = 0
    if candidates == 0:
        return OK
    for k in range(model.body_triangle_start[i], model.body_triangle_start[i + 1]):
        scratch.stamp[k] = 0
    for k in range(nx * ny * nz):
        scratch.cell_stamp[k] = 0
    scratch.cells[SOLO] = 0
    scratch.cells[POTENTIAL] = 0
    count, latched = 0, 0
    for candidate in range(candidates):
        t = scratch.candidate[candidate]
        side = sides + t - origin
        t1, t2, t3 = _corners(model, scratch, t)
        n = _hits(model, scratch, i, t, t1, t2, t3)
        if n == 0:
            state.side[side] = 0
            continue
        state.side[side] = _latch(model, scratch, state.side[side], n, t1, t2, t3)
        state.near[begin + latched] = t
        latched += 1
        if state.side[side] == REJECTED:
            state.rejected[contact] += n
            continue
        if count + n > capacity:
            scratch.detail[0] = capacity
            scratch.detail[1] = contact
            return TOO_MANY_PAIRS
        for k in range(n):
            scratch.pair_triangle[count + k] = t
            scratch.pair_instrument[count + k] = scratch.hit[k]
        count += n
    state.pairs[contact] = count
    state.near_count[contact] = latched
    occupied = model.grid_occupied[i]
    scratch.cells[EMPTY] = nx * ny * nz - scratch.cells[SOLO] - occupied
    scratch.cells[SOLO] += occupied - scratch.cells[POTENTIAL]
    return OK
