"""Collision detection: spatial occupancy with a hashed, cascaded structure (OHC; thesis 3.4).

Space is cut in equal cells, here in the body frame of the instrument: the instrument is rigid, so its own occupancy is
found once, offline, and the hash of a cell is its number in the grid over the instrument's box. Cells of a detection
are *empty*, *solo* (one object) or *potentially colliding* (both). The cascade: the whole tissue against the
instrument's box, then each triangle against it (both by the faces that the vertices lie beyond), then the cells, and
only the potentially colliding ones go to the exact triangle-triangle test. Cost follows the contact region but for the
first pass, one change of frame for every vertex.
"""

from tissue_contact.kernels.collision import facing, pair_point
from tissue_contact.kernels.compiled import inner
from tissue_contact.kernels.tritri import INTERSECT, intersect
from tissue_contact.kernels.vectors import cross, dot
from tissue_contact.status import OK, TOO_MANY_PAIRS

EMPTY, SOLO, POTENTIAL = 0, 1, 2  # classes of cells, places in scratch.cells
FACING, REJECTED = 1, 2  # latched side of a tissue triangle, 0: not touched
SIDE_HYSTERESIS = 0.1  # share of the part's reach by which a latched side must be contradicted before it turns


@inner
def locate(x, y, z, first, last, r, p, low, high, body_x, body_y, body_z, outcode):
    """Change vertices to the body frame and mark the faces of the box low, high that each lies beyond.

    Returns
    -------
    int
        The faces that all the vertices lie beyond; not 0: nothing can touch.
    """
    common = 63
    for v in range(first, last):
        dx, dy, dz = x[v] - p[0], y[v] - p[1], z[v] - p[2]
        bx = r[0] * dx + r[3] * dy + r[6] * dz
        by = r[1] * dx + r[4] * dy + r[7] * dz
        bz = r[2] * dx + r[5] * dy + r[8] * dz
        body_x[v] = bx
        body_y[v] = by
        body_z[v] = bz
        code = (
            (1 if bx < low[0] else 0)
            | (2 if bx > high[0] else 0)
            | (4 if by < low[1] else 0)
            | (8 if by > high[1] else 0)
            | (16 if bz < low[2] else 0)
            | (32 if bz > high[2] else 0)
        )
        outcode[v] = code
        common &= code
    return common


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
        (scratch.body_x[a], scratch.body_y[a], scratch.body_z[a]),
        (scratch.body_x[b], scratch.body_y[b], scratch.body_z[b]),
        (scratch.body_x[c], scratch.body_y[c], scratch.body_z[c]),
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
                        model.instrument_low[3 * u] > high[0]
                        or model.instrument_low[3 * u + 1] > high[1]
                        or model.instrument_low[3 * u + 2] > high[2]
                        or model.instrument_high[3 * u] < low[0]
                        or model.instrument_high[3 * u + 1] < low[1]
                        or model.instrument_high[3 * u + 2] < low[2]
                    ):
                        continue
                    a, b, c = model.instrument_a[u], model.instrument_b[u], model.instrument_c[u]
                    i1 = (model.instrument_x[a], model.instrument_y[a], model.instrument_z[a])
                    i2 = (model.instrument_x[b], model.instrument_y[b], model.instrument_z[b])
                    i3 = (model.instrument_x[c], model.instrument_y[c], model.instrument_z[c])
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
        total += facing(p, outer, model.instrument_part[u], model.part_axis, model.part_reach)
    total /= n
    if latched != 0 and abs(total) < SIDE_HYSTERESIS:
        return latched
    return FACING if total > 0.0 else REJECTED


@inner
def detect(model, state, scratch, contact, r, p):
    """Find the intersecting triangle pairs of one contact, into scratch.pair_triangle and scratch.pair_instrument.

    Parameters
    ----------
    contact : int
        Which declared contact.
    r, p : tuple of nine, tuple of three
        Rotation matrix and position [m] of the instrument's body frame.

    Returns
    -------
    int
        Status. The pairs are each there once, ordered by tissue triangle, then instrument triangle; their number and
        that of the rejected ones, and the latched sides, go to the state.
    """
    tissue, i = model.contact_tissue[contact], model.contact_instrument[contact]
    nx, ny, nz = model.grid_size[3 * i], model.grid_size[3 * i + 1], model.grid_size[3 * i + 2]
    edge = model.grid_cell[i]
    low = (model.grid_low[3 * i], model.grid_low[3 * i + 1], model.grid_low[3 * i + 2])
    high = (low[0] + nx * edge, low[1] + ny * edge, low[2] + nz * edge)
    common = locate(
        state.x,
        state.y,
        state.z,
        model.tissue_vertex_start[tissue],
        model.tissue_vertex_start[tissue + 1],
        r,
        p,
        low,
        high,
        scratch.body_x,
        scratch.body_y,
        scratch.body_z,
        scratch.outcode,
    )
    capacity = scratch.pair_triangle.size
    sides = model.contact_side_start[contact]
    first, last = model.tissue_triangle_start[tissue], model.tissue_triangle_start[tissue + 1]
    if common != 0 and state.pairs[contact] == 0 and state.rejected[contact] == 0:
        return OK  # nothing touches and nothing is latched
    state.pairs[contact] = 0
    state.rejected[contact] = 0
    if common != 0:
        for k in range(sides, sides + last - first):
            state.side[k] = 0
        return OK
    for k in range(model.instrument_triangle_start[i], model.instrument_triangle_start[i + 1]):
        scratch.stamp[k] = 0
    for k in range(nx * ny * nz):
        scratch.cell_stamp[k] = 0
    scratch.cells[SOLO] = 0
    scratch.cells[POTENTIAL] = 0
    count = 0
    outcode = scratch.outcode
    for t in range(first, last):
        side = sides + t - first
        if outcode[model.triangle_a[t]] & outcode[model.triangle_b[t]] & outcode[model.triangle_c[t]] != 0:
            state.side[side] = 0
            continue
        t1, t2, t3 = _corners(model, scratch, t)
        n = _hits(model, scratch, i, t, t1, t2, t3)
        if n == 0:
            state.side[side] = 0
            continue
        state.side[side] = _latch(model, scratch, state.side[side], n, t1, t2, t3)
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
    occupied = model.grid_occupied[i]
    scratch.cells[EMPTY] = nx * ny * nz - scratch.cells[SOLO] - occupied
    scratch.cells[SOLO] += occupied - scratch.cells[POTENTIAL]
    return OK
