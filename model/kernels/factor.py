"""The constant matrix of projective dynamics, A = M (1 + dt c/rho) + dt² L, factorised once: P A Pᵀ = L D Lᵀ.

M are the masses, c [N·s/m³] drag and support together, L the Laplacian of the springs' stiffness, a part of it, their
dampers over dt and the support. A is the same for x, y and z. Rows are the free vertices in an order of little fill,
found at assembly with the places of all entries (`tissue_contact.elimination`). L is kept twice, by columns and by
rows, so that both substitutions gather. Right sides lie four numbers a row: x, y, z and one of padding; entries name
their row, or column, by where its right sides begin.
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
def _fill(model, parameters, scratch, dt):
    """The entries of A: the diagonal into scratch.factor_inverse, what is below it into scratch.factor_down."""
    diagonal, down = scratch.factor_inverse, scratch.factor_down
    for e in range(down.size):
        down[e] = 0.0
    for tissue in range(model.tissue_rate.size):
        own = TISSUE_PARAMETERS * tissue
        per_area = parameters[own + AREAL_DENSITY] + dt * (
            parameters[own + DRAG] + parameters[own + SUPPORT_DAMPING] + dt * parameters[own + SUPPORT_STIFFNESS]
        )
        for v in range(model.tissue_vertex_start[tissue], model.tissue_vertex_start[tissue + 1]):
            row = model.factor_place[v]
            if row < diagonal.size:
                diagonal[row] = per_area * model.node_area[v]
        stiffness, damping = dt * dt * parameters[own + STIFFNESS_SCALE] / SOFTER, dt * parameters[own + DAMPING_SCALE]
        for s in range(model.tissue_spring_start[tissue], model.tissue_spring_start[tissue + 1]):
            k = stiffness * model.spring_stiffness[s] + damping * model.spring_damping[s]
            i, j = model.factor_place[model.spring_i[s]], model.factor_place[model.spring_j[s]]
            if i < diagonal.size:
                diagonal[i] += k
            if j < diagonal.size:
                diagonal[j] += k
            if model.factor_spring[s] < down.size:
                down[model.factor_spring[s]] -= k


@inner
def _factorise(model, scratch):
    """L and 1/D in the place of A, one column after the other."""
    start, rows, down, inverse = model.factor_start, model.factor_row, scratch.factor_down, scratch.factor_inverse
    work = scratch.right
    for j in range(inverse.size):
        first, last = start[j], start[j + 1]
        for e in range(first, last):
            work[rows[e]] = down[e]
        pivot = inverse[j]
        for q in range(model.factor_across_start[j], model.factor_across_start[j + 1]):
            k, at = model.factor_across_column[q] // 4, model.factor_across_entry[q]
            scaled = down[at] / inverse[k]  # of a column that is done the diagonal is 1/D
            pivot -= down[at] * scaled
            for e in range(at + 1, start[k + 1]):
                work[rows[e]] -= scaled * down[e]
        for e in range(first, last):
            down[e] = work[rows[e]] / pivot
        inverse[j] = 1.0 / pivot
    for q in range(scratch.factor_across.size):
        scratch.factor_across[q] = down[model.factor_across_entry[q]]


@inner
def _gather(right, o, scale, e, last, places, values):
    """Scale a right side and subtract values times others, from entry e to the last, in four sums that do not wait."""
    x, y, z, w = scale * right[o], scale * right[o + 1], scale * right[o + 2], scale * right[o + 3]
    x1, y1, z1, w1 = 0.0, 0.0, 0.0, 0.0
    x2, y2, z2, w2 = 0.0, 0.0, 0.0, 0.0
    x3, y3, z3, w3 = 0.0, 0.0, 0.0, 0.0
    while e + 4 <= last:
        j, a = places[e], values[e]
        x, y, z, w = x - a * right[j], y - a * right[j + 1], z - a * right[j + 2], w - a * right[j + 3]
        j, a = places[e + 1], values[e + 1]
        x1, y1, z1, w1 = x1 - a * right[j], y1 - a * right[j + 1], z1 - a * right[j + 2], w1 - a * right[j + 3]
        j, a = places[e + 2], values[e + 2]
        x2, y2, z2, w2 = x2 - a * right[j], y2 - a * right[j + 1], z2 - a * right[j + 2], w2 - a * right[j + 3]
        j, a = places[e + 3], values[e + 3]
        x3, y3, z3, w3 = x3 - a * right[j], y3 - a * right[j + 1], z3 - a * right[j + 2], w3 - a * right[j + 3]
        e += 4
    while e < last:
        j, a = places[e], values[e]
        x, y, z, w = x - a * right[j], y - a * right[j + 1], z - a * right[j + 2], w - a * right[j + 3]
        e += 1
    right[o], right[o + 1] = (x + x1) + (x2 + x3), (y + y1) + (y2 + y3)
    right[o + 2], right[o + 3] = (z + z1) + (z2 + z3), (w + w1) + (w2 + w3)


@inner
def forward(model, scratch):
    """L⁻¹ of the right sides, in place."""
    start = model.factor_across_start
    for i in range(model.factor_vertex.size):
        _gather(scratch.right, 4 * i, 1.0, start[i], start[i + 1], model.factor_across_column, scratch.factor_across)


@inner
def backward(model, scratch):
    """L⁻ᵀ D⁻¹ of the right sides, in place."""
    start, inverse = model.factor_start, scratch.factor_inverse
    for k in range(model.factor_vertex.size):
        i = model.factor_vertex.size - 1 - k
        _gather(scratch.right, 4 * i, inverse[i], start[i], start[i + 1], model.factor_row, scratch.factor_down)


@inner
def mark_path(model, scratch, row):
    """Mark a row and all that its elimination reaches, its ancestors in the elimination tree."""
    rows = model.factor_vertex.size
    while row < rows and scratch.path[row] == 0:
        scratch.path[row] = 1
        first = model.factor_start[row]
        row = int(model.factor_row[first]) // 4 if first < model.factor_start[row + 1] else rows


@inner
def list_path(scratch):
    """Rows that are marked into scratch.path_row, ascending; their number. None is marked then."""
    count = 0
    for row in range(scratch.path.size):
        scratch.path_row[count] = row
        count += scratch.path[row]
        scratch.path[row] = 0
    return count


@inner
def forward_path(model, scratch, count, right):
    """L⁻¹ of right sides that are zero but on the listed path of ``count`` rows, in place."""
    for m in range(count):
        j = scratch.path_row[m]
        x, y, z, w = right[4 * j], right[4 * j + 1], right[4 * j + 2], right[4 * j + 3]
        for e in range(model.factor_start[j], model.factor_start[j + 1]):
            o, a = model.factor_row[e], scratch.factor_down[e]
            right[o], right[o + 1] = right[o] - a * x, right[o + 1] - a * y
            right[o + 2], right[o + 3] = right[o + 2] - a * z, right[o + 3] - a * w


@inner
def backward_path(model, scratch, count, source, out):
    """Rows of L⁻ᵀ D⁻¹ of ``source`` on the listed path of ``count`` rows into ``out``."""
    for m in range(count):
        i = scratch.path_row[count - 1 - m]
        o, scale = 4 * i, scratch.factor_inverse[i]
        x, y, z, w = scale * source[o], scale * source[o + 1], scale * source[o + 2], scale * source[o + 3]
        for e in range(model.factor_start[i], model.factor_start[i + 1]):
            j, a = model.factor_row[e], scratch.factor_down[e]
            x, y, z, w = x - a * out[j], y - a * out[j + 1], z - a * out[j + 2], w - a * out[j + 3]
        out[o], out[o + 1], out[o + 2], out[o + 3] = x, y, z, w


@inner
def clear_path(scratch, count, right):
    """Right sides of the listed path of ``count`` rows become zero."""
    for m in range(count):
        o = 4 * scratch.path_row[m]
        right[o], right[o + 1], right[o + 2], right[o + 3] = 0.0, 0.0, 0.0, 0.0
