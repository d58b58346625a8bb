"""The constant matrix of projective dynamics, A = M (1 + dt c/rho) + dt² L, factorised once: P A Pᵀ = L D Lᵀ.

M are the masses, c [N·s/m³] drag and support together, L the Laplacian of the springs' stiffness, a part of it, their
dampers over dt and the support. A is the same for x, y and z. Rows are the free vertices in an order of little fill,
found at assembly with the places of all entries (`tissue_contact.elimination`). L lies in panels of four columns with
the same rows below them, D in its diagonal; columns that a panel does not have change nothing, as their entries are
zeros and ones. Of a panel's own rows the inverse of L is kept, so that none of them waits for the one before. Backward,
a panel is read from its end to its begin as panels are: memory is fetched ahead in one direction. Right sides lie four
numbers a row: x, y, z and one of padding; rows are named by where those begin.
"""

from tissue_contact.kernels.compiled import inner
from tissue_contact.kernels.slots import (
    AREAL_DENSITY,
    DAMPING_SCALE,
    DRAG,
    STIFFNESS_SCALE,
    SUPPORT_DAMPING,
    SUPPORT_STIFFNESS,
    TISSUE_PARAMETERS,
)

# A whole Laplacian, springs as stiff across as along, bounds their own matrix from above and each iteration goes too
# short a way: waves along a sheet of triangles need 3/4 of it, motion along springs in one line all of it. Of a motion
# far stiffer than its mass that is s times as stiff as it is in A, one iteration multiplies place and dt velocity by
# matrices of eigenvalues c ± sqrt(c² - c), c = 1 - s: within the unit circle up to s = 4/3.
SOFTER = 4.0 / 3.0


@inner
def ready(model, parameters, scratch, dt):
    """Factorise for a substep dt [s] and these parameters, where that is not what the factor is made of."""
    key = scratch.factor_key
    same = key[0] == dt
    for k in range(key.size - 1):
        same = same and key[1 + k] == parameters[k]
    if same:
        return
    _fill(model, parameters, scratch, dt)
    _factorise(model, scratch)
    key[0] = dt
    for k in range(key.size - 1):
        key[1 + k] = parameters[k]
    for k in range(scratch.slot_row.size):
        scratch.slot_row[k] = model.factor_vertex.size  # compliances of another matrix
    for row in range(model.factor_vertex.size):
        scratch.row_slot[row] = scratch.slot_row.size


@inner
def diagonal(model, row):
    """Place of the diagonal's entry of a row in scratch.factor."""
    panel = model.factor_panel[row]
    within = row - model.factor_column[panel]
    return 4 * (model.factor_start[panel] + within) + within


@inner
def _fill(model, parameters, scratch, dt):
    """The entries of A that are not above its diagonal, and ones in the diagonal of columns that panels do not have."""
    rows, values = model.factor_vertex.size, scratch.factor
    for e in range(values.size):
        values[e] = 0.0
    for panel in range(model.factor_start.size - 1):
        for within in range(4):
            values[4 * (model.factor_start[panel] + within) + within] = 1.0
    for row in range(rows):
        values[diagonal(model, row)] = 0.0
    for tissue in range(model.tissue_rate.size):
        own = TISSUE_PARAMETERS * tissue
        per_area = parameters[own + AREAL_DENSITY] + dt * (
            parameters[own + DRAG] + parameters[own + SUPPORT_DAMPING] + dt * parameters[own + SUPPORT_STIFFNESS]
        )
        for v in range(model.tissue_vertex_start[tissue], model.tissue_vertex_start[tissue + 1]):
            row = model.factor_place[v]
            if row < rows:
                values[diagonal(model, row)] = per_area * model.node_area[v]
        stiffness, damping = dt * dt * parameters[own + STIFFNESS_SCALE] / SOFTER, dt * parameters[own + DAMPING_SCALE]
        for s in range(model.tissue_spring_start[tissue], model.tissue_spring_start[tissue + 1]):
            k = stiffness * model.spring_stiffness[s] + damping * model.spring_damping[s]
            i, j = model.factor_place[model.spring_i[s]], model.factor_place[model.spring_j[s]]
            if i < rows:
                values[diagonal(model, i)] += k
            if j < rows:
                values[diagonal(model, j)] += k
            if model.factor_spring[s] < values.size:
                values[model.factor_spring[s]] -= k


@inner
def _factorise_columns(values, first, last):
    """1/D, L below and L⁻¹ within the rows of one panel in the place of its entries, which no other will change."""
    for j in range(4):
        inverse = 1.0 / values[4 * (first + j) + j]
        for k in range(j + 1, 4):
            scaled = inverse * values[4 * (first + k) + j]
            for r in range(first + k, first + 4):
                values[4 * r + k] -= scaled * values[4 * r + j]
        values[4 * (first + j) + j] = inverse
        for r in range(first + j + 1, first + 4):
            values[4 * r + j] *= inverse
    e = 4 * first
    i0, i1, i2, i3 = values[e], values[e + 5], values[e + 10], values[e + 15]
    l10, l20, l21 = values[e + 4], values[e + 8], values[e + 9]
    l30, l31, l32 = values[e + 12], values[e + 13], values[e + 14]
    for r in range(first + 4, last):
        a = values[4 * r]
        b = values[4 * r + 1] - a * l10
        c = values[4 * r + 2] - a * l20 - b * l21
        d = values[4 * r + 3] - a * l30 - b * l31 - c * l32
        values[4 * r], values[4 * r + 1], values[4 * r + 2], values[4 * r + 3] = a * i0, b * i1, c * i2, d * i3
    values[e + 4], values[e + 9], values[e + 14] = -l10, -l21, -l32
    values[e + 8], values[e + 13] = l21 * l10 - l20, l32 * l21 - l31
    values[e + 12] = l31 * l10 + l32 * (l20 - l21 * l10) - l30


@inner
def _factorise(model, scratch):
    """L and 1/D in the place of A, one panel after the other: what it changes is changed at once."""
    start, row, values, scaled = model.factor_start, model.factor_row, scratch.factor, scratch.unit_right
    for panel in range(start.size - 1):
        first, last = start[panel], start[panel + 1]
        _factorise_columns(values, first, last)
        s = first + 4
        while s < last:
            begin, other = s, model.factor_panel[row[s] // 4]
            for k in range(16):
                scaled[k] = 0.0
            while s < last and model.factor_panel[row[s] // 4] == other:
                column = row[s] // 4 - model.factor_column[other]
                for k in range(4):
                    scaled[4 * k + column] = values[4 * s + k] / values[4 * (first + k) + k]
                s += 1
            at = int(start[other])
            for r in range(begin, last):
                while row[at] != row[r]:  # it has all of these rows
                    at += 1
                o, a, b, c, d = 4 * at, values[4 * r], values[4 * r + 1], values[4 * r + 2], values[4 * r + 3]
                # what is above the diagonal means nothing
                values[o], values[o + 1], values[o + 2], values[o + 3] = (
                    values[o] - (a * scaled[0] + b * scaled[4]) - (c * scaled[8] + d * scaled[12]),
                    values[o + 1] - (a * scaled[1] + b * scaled[5]) - (c * scaled[9] + d * scaled[13]),
                    values[o + 2] - (a * scaled[2] + b * scaled[6]) - (c * scaled[10] + d * scaled[14]),
                    values[o + 3] - (a * scaled[3] + b * scaled[7]) - (c * scaled[11] + d * scaled[15]),
                )


@inner
def _forward(model, scratch, panel, right):
    """Subtract what the right sides of a panel's columns make of those below, in place."""
    first, last, o = model.factor_start[panel], model.factor_start[panel + 1], 4 * model.factor_column[panel]
    row, values, e = model.factor_row, scratch.factor, 4 * first
    x0, y0, z0, w0 = right[o], right[o + 1], right[o + 2], right[o + 3]
    x1, y1, z1, w1 = right[o + 4], right[o + 5], right[o + 6], right[o + 7]
    x2, y2, z2, w2 = right[o + 8], right[o + 9], right[o + 10], right[o + 11]
    x3, y3, z3, w3 = right[o + 12], right[o + 13], right[o + 14], right[o + 15]
    a, b, c = values[e + 12], values[e + 13], values[e + 14]
    x3, y3 = (x3 + a * x0) + (b * x1 + c * x2), (y3 + a * y0) + (b * y1 + c * y2)
    z3, w3 = (z3 + a * z0) + (b * z1 + c * z2), (w3 + a * w0) + (b * w1 + c * w2)
    a, b = values[e + 8], values[e + 9]
    x2, y2, z2, w2 = x2 + a * x0 + b * x1, y2 + a * y0 + b * y1, z2 + a * z0 + b * z1, w2 + a * w0 + b * w1
    a = values[e + 4]
    x1, y1, z1, w1 = x1 + a * x0, y1 + a * y0, z1 + a * z0, w1 + a * w0
    right[o + 4], right[o + 5], right[o + 6], right[o + 7] = x1, y1, z1, w1
    right[o + 8], right[o + 9], right[o + 10], right[o + 11] = x2, y2, z2, w2
    right[o + 12], right[o + 13], right[o + 14], right[o + 15] = x3, y3, z3, w3
    for r in range(first + 4, last):
        o, e = row[r], 4 * r
        a, b, c, d = values[e], values[e + 1], values[e + 2], values[e + 3]
        x, y, z, w = right[o], right[o + 1], right[o + 2], right[o + 3]
        x, y = x - (a * x0 + b * x1) - (c * x2 + d * x3), y - (a * y0 + b * y1) - (c * y2 + d * y3)
        z, w = z - (a * z0 + b * z1) - (c * z2 + d * z3), w - (a * w0 + b * w1) - (c * w2 + d * w3)
        right[o], right[o + 1], right[o + 2], right[o + 3] = x, y, z, w


@inner
def _backward(model, scratch, panel, right):
    """The solution at a panel's columns from that at the rows below, in place."""
    first, r, o = model.factor_start[panel], model.factor_start[panel + 1], 4 * model.factor_column[panel]
    row, values, e = model.factor_row, scratch.factor, 4 * first
    x0, y0, z0, w0, x1, y1, z1, w1 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    x2, y2, z2, w2, x3, y3, z3, w3 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    while r > first + 4:
        r -= 1
        q, p = row[r], 4 * r
        a, b, c, d = values[p], values[p + 1], values[p + 2], values[p + 3]
        x, y, z, w = right[q], right[q + 1], right[q + 2], right[q + 3]
        x0, y0, z0, w0 = x0 + a * x, y0 + a * y, z0 + a * z, w0 + a * w
        x1, y1, z1, w1 = x1 + b * x, y1 + b * y, z1 + b * z, w1 + b * w
        x2, y2, z2, w2 = x2 + c * x, y2 + c * y, z2 + c * z, w2 + c * w
        x3, y3, z3, w3 = x3 + d * x, y3 + d * y, z3 + d * z, w3 + d * w
    i = values[e + 15]
    x3, y3, z3, w3 = i * right[o + 12] - x3, i * right[o + 13] - y3, i * right[o + 14] - z3, i * right[o + 15] - w3
    i = values[e + 10]
    x2, y2, z2, w2 = i * right[o + 8] - x2, i * right[o + 9] - y2, i * right[o + 10] - z2, i * right[o + 11] - w2
    i = values[e + 5]
    x1, y1, z1, w1 = i * right[o + 4] - x1, i * right[o + 5] - y1, i * right[o + 6] - z1, i * right[o + 7] - w1
    i = values[e]
    x0, y0, z0, w0 = i * right[o] - x0, i * right[o + 1] - y0, i * right[o + 2] - z0, i * right[o + 3] - w0
    a, b, c = values[e + 4], values[e + 8], values[e + 12]
    x0, y0 = (x0 + a * x1) + (b * x2 + c * x3), (y0 + a * y1) + (b * y2 + c * y3)
    z0, w0 = (z0 + a * z1) + (b * z2 + c * z3), (w0 + a * w1) + (b * w2 + c * w3)
    a, b = values[e + 9], values[e + 13]
    x1, y1, z1, w1 = x1 + a * x2 + b * x3, y1 + a * y2 + b * y3, z1 + a * z2 + b * z3, w1 + a * w2 + b * w3
    a = values[e + 14]
    x2, y2, z2, w2 = x2 + a * x3, y2 + a * y3, z2 + a * z3, w2 + a * w3
    right[o], right[o + 1], right[o + 2], right[o + 3] = x0, y0, z0, w0
    right[o + 4], right[o + 5], right[o + 6], right[o + 7] = x1, y1, z1, w1
    right[o + 8], right[o + 9], right[o + 10], right[o + 11] = x2, y2, z2, w2
    right[o + 12], right[o + 13], right[o + 14], right[o + 15] = x3, y3, z3, w3


@inner
def forward(model, scratch):
    """L⁻¹ of the right sides, in place."""
    for k in range(4 * model.factor_vertex.size, scratch.right.size):
        scratch.right[k] = 0.0  # beyond the last panel, whatever was there: times zero, not-a-number would not be zero
    for panel in range(model.factor_start.size - 1):
        _forward(model, scratch, panel, scratch.right)


@inner
def backward(model, scratch):
    """L⁻ᵀ D⁻¹ of the right sides, in place."""
    panels = model.factor_start.size - 1
    for k in range(panels):
        _backward(model, scratch, panels - 1 - k, scratch.right)


@inner
def parent(model, panel):
    """The first panel that the elimination of a panel reaches, its parent in the elimination tree; X if none."""
    below, last = model.factor_start[panel] + 4, model.factor_start[panel + 1]
    return int(model.factor_panel[model.factor_row[below] // 4]) if below < last else model.factor_start.size - 1


@inner
def mark_path(model, scratch, row):
    """Mark the panel of a row and all that its elimination reaches, its ancestors in the elimination tree."""
    panel = int(model.factor_panel[row])
    while panel < scratch.path.size and scratch.path[panel] == 0:
        scratch.path[panel] = 1
        panel = parent(model, panel)


@inner
def list_path(scratch):
    """Panels that are marked into scratch.path_panel, ascending; their number. None is marked then."""
    count = 0
    for panel in range(scratch.path.size):
        scratch.path_panel[count] = panel
        count += scratch.path[panel]
        scratch.path[panel] = 0
    return count


@inner
def forward_path(model, scratch, count, right):
    """L⁻¹ of right sides that are zero but on the listed path of ``count`` panels, in place."""
    for m in range(count):
        _forward(model, scratch, scratch.path_panel[m], right)


@inner
def backward_path(model, scratch, count, right):
    """Rows of L⁻ᵀ D⁻¹ of the right sides on the listed path of ``count`` panels, in place."""
    for m in range(count):
        _backward(model, scratch, scratch.path_panel[count - 1 - m], right)


@inner
def copy_path(model, scratch, count, source, right):
    """Right sides of the listed path of ``count`` panels, from ``source``."""
    for m in range(count):
        o = 4 * model.factor_column[scratch.path_panel[m]]
        for k in range(16):  # what is beyond the panel is on the path, or means nothing
            right[o + k] = source[o + k]


@inner
def clear_path(model, scratch, count, right):
    """Right sides of the listed path of ``count`` panels become zero."""
    for m in range(count):
        o = 4 * model.factor_column[scratch.path_panel[m]]
        for k in range(16):
            right[o + k] = 0.0


@inner
def subtract_path(model, scratch, count, part, right):
    """Subtract ``part`` from the right sides on the listed path of ``count`` panels."""
    for m in range(count):
        panel = scratch.path_panel[m]
        for k in range(4 * model.factor_column[panel], 4 * model.factor_column[panel + 1]):
            right[k] -= part[k]
