"""Projective dynamics: implicit Euler, M (v' - v) = dt f(x + dt v', v'), by a few quasi-Newton iterations.

Each iteration solves with one constant matrix, `factor`, that bounds the springs' own from above: with every spring as
stiff across as along (Liu, Bargteil, O'Brien and Kavan 2013). What the contacts add to the matrix reaches few vertices.
It is taken in whole by the identity of Woodbury: with E the touched rows, H their stiffness and S = Eᵀ A⁻¹ E,

    (A + E H Eᵀ)⁻¹ r = A⁻¹ (r - E y),    (H⁻¹ + S) y = Eᵀ A⁻¹ r.

Of H only what lies on the diagonal of blocks counts, the sum of each row of the contacts' matrix, along the mean of the
row's directions.
Of few touched rows all entries of S are kept, and the system for y is factorised. Of many, each product with S is one
with the factor of A, along the path of the touched rows in the elimination tree, and conjugate gradients solve it.
"""

import math

from tissue_contact.kernels.compiled import inner
from tissue_contact.kernels.factor import (
    backward,
    backward_path,
    clear_path,
    copy_path,
    diagonal,
    forward,
    forward_path,
    list_path,
    mark_path,
    parent,
    ready,
    subtract_path,
)
from tissue_contact.kernels.forces import clear_contacts, contact_forces, tissue_forces
from tissue_contact.kernels.slots import (
    AREAL_DENSITY,
    DAMPING_SCALE,
    DRAG,
    GATHER,
    GATHER_SIZE,
    SUPPORT_DAMPING,
    SUPPORT_STIFFNESS,
    TISSUE_PARAMETERS,
)
from tissue_contact.kernels.springs import damp_product, directions
from tissue_contact.kernels.start import back_to_start, keep_start, parts, place

FAINT = 1e-9  # of a row's diagonal in A, below which the stiffness of a contact is left out
SETTLED = 1e-6  # of the right side, weighted by H: far less than an iteration leaves out of the springs
SUDDEN = 0.4  # of the longest way of a vertex in a substep: the change of its way that is as much too fast


@inner
def _damp(model, parameters, state, scratch, tissue, n):
    """Whether the springs of a tissue are damped; if so, the damping force of its velocities in scratch.solve[3 n:]."""
    scale = parameters[TISSUE_PARAMETERS * tissue + DAMPING_SCALE]
    if scale == 0.0:
        return False
    first, last = model.tissue_vertex_start[tissue], model.tissue_vertex_start[tissue + 1]
    s_first, s_last = model.tissue_spring_start[tissue], model.tissue_spring_start[tissue + 1]
    ux, uy, uz = scratch.unit_x, scratch.unit_y, scratch.unit_z
    p, q = scratch.solve[: 3 * n], scratch.solve[3 * n : 6 * n]
    for v in range(first, last):
        p[v], p[n + v], p[2 * n + v] = state.vx[v], state.vy[v], state.vz[v]
    directions(s_first, s_last, model.spring_i, model.spring_j, state.x, state.y, state.z, ux, uy, uz)
    damp_product(
        first, last, s_first, s_last, model.spring_i, model.spring_j, model.spring_damping, scale, ux, uy, uz,
        model.node_free, p, q, n,
    )  # fmt: skip
    return True


@inner
def _residual(model, parameters, state, scratch, elapsed, dt, n):
    """M (v0 - v) + dt f(x0 + dt v, v) of every row into scratch.right [N·s]."""
    place(state, scratch, dt)
    tissue_forces(model, parameters, state, scratch)
    clear_contacts(state, scratch)
    contact_forces(model, parameters, state, scratch, elapsed + dt, dt, False)
    right, g = scratch.right, model.gravity
    _, _, _, start_vx, start_vy, start_vz = parts(scratch.start, n)
    for tissue in range(model.tissue_rate.size):
        own = TISSUE_PARAMETERS * tissue
        if _damp(model, parameters, state, scratch, tissue, n):
            q = scratch.solve[3 * n : 6 * n]
            for v in range(model.tissue_vertex_start[tissue], model.tissue_vertex_start[tissue + 1]):
                scratch.fx[v] -= q[v]
                scratch.fy[v] -= q[n + v]
                scratch.fz[v] -= q[2 * n + v]
        density, support = parameters[own + AREAL_DENSITY], parameters[own + SUPPORT_STIFFNESS]
        c = dt * (parameters[own + DRAG] + parameters[own + SUPPORT_DAMPING])
        gx, gy, gz = dt * density * g[0], dt * density * g[1], dt * density * g[2]
        first, last = model.tissue_vertex_start[tissue], model.tissue_vertex_start[tissue + 1]
        for v in range(first, last if support > 0.0 else first):
            a = support * model.node_area[v]
            scratch.fx[v] -= a * (state.x[v] - model.rest_x[v])
            scratch.fy[v] -= a * (state.y[v] - model.rest_y[v])
            scratch.fz[v] -= a * (state.z[v] - model.rest_z[v])
        for v in range(first, last):
            a, o = model.node_area[v], 4 * model.factor_place[v]  # fixed: behind the rows, which is cleared
            vx, vy, vz = state.vx[v], state.vy[v], state.vz[v]
            right[o] = dt * scratch.fx[v] + a * (density * (start_vx[v] - vx) - c * vx + gx)
            right[o + 1] = dt * scratch.fy[v] + a * (density * (start_vy[v] - vy) - c * vy + gy)
            right[o + 2] = dt * scratch.fz[v] + a * (density * (start_vz[v] - vz) - c * vz + gz)
            right[o + 3] = 0.0


@inner
def _lump(model, scratch, vertex, weight, k):
    """Add the part of a pressed point k that one corner bears to the stiffness of the corner's row."""
    row = model.factor_place[vertex]
    if row == model.factor_vertex.size or weight <= 0.0:
        return
    press = scratch.row_press
    along, across, o = scratch.active_normal[k], scratch.active_tangential[k], 5 * row
    if scratch.touched_mark[row] == 0:
        scratch.touched_mark[row] = 1
        scratch.touched[scratch.touched_count[0]] = row
        scratch.touched_count[0] += 1
        for e in range(5):
            press[o + e] = 0.0
    nx, ny, nz, f = scratch.active_x[k], scratch.active_y[k], scratch.active_z[k], weight * along
    # Pressed from both sides a row is as stiff as both together: n and -n are one direction.
    toward = f if press[o] * nx + press[o + 1] * ny + press[o + 2] * nz >= 0.0 else -f
    press[o] += toward * nx
    press[o + 1] += toward * ny
    press[o + 2] += toward * nz
    press[o + 3] += f
    press[o + 4] += weight * across


@inner
def _touched(model, scratch):
    """Gather the stiffness that the pressed points give to rows, and which rows; their number."""
    scratch.touched_count[0] = 0
    for k in range(min(int(scratch.active[0]), scratch.active_a.size)):
        _lump(model, scratch, scratch.active_a[k], scratch.active_wa[k], k)
        _lump(model, scratch, scratch.active_b[k], scratch.active_wb[k], k)
        _lump(model, scratch, scratch.active_c[k], scratch.active_wc[k], k)
    count = int(scratch.touched_count[0])
    for row in range(scratch.touched_mark.size):
        scratch.touched_mark[row] = 0
    # Ascending, so that what comes of them does not depend on which was touched first in an earlier step.
    for k in range(1, count):
        row, m = scratch.touched[k], k
        while m > 0 and scratch.touched[m - 1] > row:
            scratch.touched[m] = scratch.touched[m - 1]
            m -= 1
        scratch.touched[m] = row
    return count


@inner
def _compliances(model, scratch, count):
    """Have S of all touched rows at hand: columns of L⁻¹ of rows that were not touched before, four at once."""
    rows, slots = model.factor_vertex.size, scratch.slot_row.size
    work = scratch.unit_right
    missing = 0
    for k in range(count):
        if scratch.row_slot[scratch.touched[k]] == slots:
            missing += 1
    if missing == 0:
        return
    free = 0
    for k in range(count):
        row = scratch.touched[k]
        if scratch.row_slot[row] < slots:
            continue
        while True:  # the next slot whose row is not touched now
            old = scratch.slot_row[free]
            wanted = False
            if old < rows:
                for m in range(count):
                    wanted = wanted or scratch.touched[m] == old
            if not wanted:
                break
            free += 1
        if scratch.slot_row[free] < rows:
            scratch.row_slot[scratch.slot_row[free]] = slots
        scratch.slot_row[free] = row
        scratch.row_slot[row] = free
        scratch.slot_new[free] = 1
    lanes = 0
    for own in range(slots):
        if scratch.slot_new[own] == 1:
            scratch.lane_slot[lanes] = own
            lanes += 1
        if lanes == 0 or (lanes < 4 and own < slots - 1):
            continue
        for lane in range(lanes):
            mark_path(model, scratch, int(scratch.slot_row[scratch.lane_slot[lane]]))
        path = list_path(scratch)
        clear_path(model, scratch, path, work)
        for lane in range(lanes):
            work[4 * scratch.slot_row[scratch.lane_slot[lane]] + lane] = 1.0
        forward_path(model, scratch, path, work)
        for lane in range(lanes):
            _keep(model, scratch, int(scratch.lane_slot[lane]), lane)
        lanes = 0


@inner
def _keep(model, scratch, own, lane):
    """A slot's column of D^(-1/2) L⁻¹ from that of L⁻¹ in a lane of right sides; its compliances with all kept ones.

    S_ij is the product of columns i and j, along the path from where they meet in the elimination tree. So it depends
    on nothing but the two, to the last bit, where an entry of one column of S may differ from that of the other.
    """
    slots, rows, panels = scratch.slot_row.size, model.factor_vertex.size, scratch.path.size
    longest, half = scratch.half.size // slots, scratch.half
    row = int(scratch.slot_row[own])
    panel = int(model.factor_panel[row])
    at = (own + 1) * longest - model.factor_depth[panel]
    while panel < panels:
        scratch.path[panel] = 1
        for r in range(model.factor_column[panel], model.factor_column[panel + 1]):
            half[at] = scratch.unit_right[4 * r + lane] * math.sqrt(scratch.factor[diagonal(model, r)])
            at += 1
        panel = parent(model, panel)
    scratch.slot_new[own] = 0
    for other in range(slots):
        if scratch.slot_row[other] == rows or scratch.slot_new[other] == 1:
            continue
        panel = int(model.factor_panel[scratch.slot_row[other]])
        while panel < panels and scratch.path[panel] == 0:
            panel = parent(model, panel)
        shared = int(model.factor_depth[panel]) if panel < panels else 0
        value = _product(half, (own + 1) * longest, (other + 1) * longest, shared)
        scratch.compliance[own * slots + other] = value
        scratch.compliance[other * slots + own] = value
    list_path(scratch)


@inner
def _product(values, a, b, count):
    """Sum of the products of the ``count`` values before place a and before place b; the same for b and a."""
    # Four sums, none of which waits for the one before.
    total, total1, total2, total3 = 0.0, 0.0, 0.0, 0.0
    k = count
    while k >= 4:
        total += values[a - k] * values[b - k]
        total1 += values[a - k + 1] * values[b - k + 1]
        total2 += values[a - k + 2] * values[b - k + 2]
        total3 += values[a - k + 3] * values[b - k + 3]
        k -= 4
    while k > 0:
        total += values[a - k] * values[b - k]
        k -= 1
    return (total + total1) + (total2 + total3)


@inner
def _directions_of(scratch, row, out, m, stiffness):
    """Directions in which a row is pressed and how stiffly, from place m on; the place after the last."""
    press, o = scratch.row_press, 5 * row
    nx, ny, nz, along, across = press[o], press[o + 1], press[o + 2], press[o + 3], press[o + 4]
    norm = math.sqrt(nx * nx + ny * ny + nz * nz)
    if norm > 0.0:
        nx, ny, nz = nx / norm, ny / norm, nz / norm
    if across <= 0.0 and norm > 0.0:
        out[3 * m], out[3 * m + 1], out[3 * m + 2] = nx, ny, nz
        stiffness[m] = along
        return m + 1
    if norm == 0.0:
        nx, ny, nz = 0.0, 0.0, 1.0
    # two more that are square to the first and to each other (Duff and others 2017)
    sign = 1.0 if nz >= 0.0 else -1.0
    a = -1.0 / (sign + nz)
    b = nx * ny * a
    out[3 * m], out[3 * m + 1], out[3 * m + 2] = nx, ny, nz
    out[3 * m + 3], out[3 * m + 4], out[3 * m + 5] = 1.0 + sign * nx * nx * a, sign * b, -sign * nx
    out[3 * m + 6], out[3 * m + 7], out[3 * m + 8] = b, sign + ny * ny * a, -ny
    stiffness[m] = max(along, across)
    stiffness[m + 1], stiffness[m + 2] = across, across
    return m + 3


@inner
def _press_back(model, scratch, count):
    """Take the stiffness of the touched rows into the solution: subtract L⁻¹ E y from the right sides L⁻¹ r.

    Returns
    -------
    float
        Sum of |y| [kg·m/s], by which this changes the impulses of the contacts.
    """
    right, work = scratch.right, scratch.unit_right
    few = count <= scratch.slot_row.size
    if few:
        _compliances(model, scratch, count)
    for k in range(count):
        mark_path(model, scratch, int(scratch.touched[k]))
    path = list_path(scratch)
    copy_path(model, scratch, path, right, work)
    backward_path(model, scratch, path, work)
    stiffness, y = scratch.push_stiffness, scratch.push_size
    m = 0
    for k in range(count):
        row, before = int(scratch.touched[k]), m
        m = _directions_of(scratch, row, scratch.push, m, stiffness)
        for i in range(before, m):
            scratch.push_row[i] = row
            stiffness[i] = max(stiffness[i], FAINT / scratch.factor[diagonal(model, row)])
            y[i] = _along(scratch, i, work)
    if few:
        _solve_few(scratch, y, m)
    else:
        _solve_many(model, scratch, path, y, m)
    _spread(model, scratch, path, y, m, work)
    forward_path(model, scratch, path, work)
    subtract_path(model, scratch, path, work, right)
    changed = 0.0
    for i in range(m):
        changed += abs(y[i])
    return changed


@inner
def _along(scratch, i, values):
    """Component of values of rows along push i."""
    push, o = scratch.push, 4 * scratch.push_row[i]
    return push[3 * i] * values[o] + push[3 * i + 1] * values[o + 1] + push[3 * i + 2] * values[o + 2]


@inner
def _spread(model, scratch, path, y, m, out):
    """E y of m pushes into ``out``, on the listed path of ``path`` panels."""
    clear_path(model, scratch, path, out)
    for i in range(m):
        o = 4 * scratch.push_row[i]
        for axis in range(3):
            out[o + axis] += y[i] * scratch.push[3 * i + axis]


@inner
def _solve_few(scratch, y, m):
    """Solve (H⁻¹ + S) y = y in place by the kept entries of S."""
    slots, push, matrix = scratch.slot_row.size, scratch.push, scratch.push_matrix
    for i in range(m):
        own = int(scratch.row_slot[scratch.push_row[i]]) * slots
        for j in range(i + 1):
            s = scratch.compliance[own + int(scratch.row_slot[scratch.push_row[j]])]
            s *= push[3 * i] * push[3 * j] + push[3 * i + 1] * push[3 * j + 1] + push[3 * i + 2] * push[3 * j + 2]
            matrix[i * m + j] = s
        matrix[i * m + i] += 1.0 / scratch.push_stiffness[i]
    _cholesky_solve(matrix, y, m)


@inner
def _solve_many(model, scratch, path, y, m):
    """Solve (H⁻¹ + S) y = y in place by conjugate gradients, H before them, to `SETTLED` of the right side."""
    work, h = scratch.unit_right, scratch.push_stiffness
    room = scratch.solve.size // 4  # of the vectors of a solve, which no force needs now
    residual, search, product = scratch.solve[:room], scratch.solve[room : 2 * room], scratch.solve[2 * room : 3 * room]
    square = 0.0
    for i in range(m):
        residual[i], search[i], y[i] = y[i], h[i] * y[i], 0.0
        square += residual[i] * search[i]
    enough = SETTLED * SETTLED * square
    for _ in range(m):
        if square <= enough:
            return
        _spread(model, scratch, path, search, m, work)
        forward_path(model, scratch, path, work)
        backward_path(model, scratch, path, work)
        curve = 0.0
        for i in range(m):
            product[i] = search[i] / h[i] + _along(scratch, i, work)
            curve += search[i] * product[i]
        way, before, square = square / curve, square, 0.0
        for i in range(m):
            y[i] += way * search[i]
            residual[i] -= way * product[i]
            square += h[i] * residual[i] * residual[i]
        for i in range(m):
            search[i] = h[i] * residual[i] + square / before * search[i]


@inner
def _cholesky_solve(a, y, m):
    """Solve a y = y in place, a symmetric and positive definite, its lower half in rows of m."""
    for i in range(m):
        for j in range(i + 1):
            s = a[i * m + j]
            for k in range(j):
                s -= a[i * m + k] * a[j * m + k]
            a[i * m + j] = s / a[j * m + j] if j < i else math.sqrt(s)
    for i in range(m):
        s = y[i]
        for k in range(i):
            s -= a[i * m + k] * y[k]
        y[i] = s / a[i * m + i]
    for k in range(m):
        i = m - 1 - k
        s = y[i]
        for j in range(i + 1, m):
            s -= a[j * m + i] * y[j]
        y[i] = s / a[i * m + i]


@inner
def _pressed(scratch):
    """Sum of the sizes of all forces on bodies [N]."""
    total = 0.0
    for b in range(scratch.contact.size // GATHER):
        total += scratch.contact[GATHER * b + GATHER_SIZE]
    return total


@inner
def _settled(model, state, scratch, dt, count, changed):
    """Whether an iteration changed the impulses of the contacts of ``count`` touched rows within the tolerance.

    Where nothing is touched it is the motion, in the norm of the areas: what few iterations leave out of a free motion
    is energy.
    """
    tolerance = model.tolerance[0]
    if count > 0:
        return changed <= tolerance * dt * _pressed(scratch)
    right, change, motion = scratch.right, 0.0, 0.0
    for row in range(model.factor_vertex.size):
        v, o = model.factor_vertex[row], 4 * row
        a, vx, vy, vz = model.node_area[v], state.vx[v], state.vy[v], state.vz[v]
        change += a * (right[o] * right[o] + right[o + 1] * right[o + 1] + right[o + 2] * right[o + 2])
        motion += a * (vx * vx + vy * vy + vz * vz)
    return change <= tolerance * tolerance * motion


@inner
def _too_fast(state, scratch, longest, dt):
    """Whether any vertex goes a longer way in dt than ``longest`` [m], or changes its way by `SUDDEN` of that."""
    _, _, _, start_vx, start_vy, start_vz = parts(scratch.start, state.x.size)
    most = (longest / dt) ** 2
    sudden = SUDDEN * SUDDEN * most
    found = False
    for v in range(state.x.size):  # with no way out it runs in vectors
        vx, vy, vz = state.vx[v], state.vy[v], state.vz[v]
        ax, ay, az = vx - start_vx[v], vy - start_vy[v], vz - start_vz[v]
        found |= (vx * vx + vy * vy + vz * vz > most) | (ax * ax + ay * ay + az * az > sudden)
    return found


@inner
def projective_dynamics(model, parameters, state, scratch, elapsed, dt, longest):
    """One substep, from elapsed [s] after the last communication point; what the bodies then feel is not told.

    Returns
    -------
    bool
        Whether it was done: not where a vertex moves too fast for a way of ``longest`` [m], 0 for any; then the state
        is that of before.
    """
    n, right = state.x.size, scratch.right
    ready(model, parameters, scratch, dt)
    keep_start(state, scratch)
    work, dissipated = state.work[0], state.dissipated[0]
    for left in range(model.iterations[0] - 1, -1, -1):
        _residual(model, parameters, state, scratch, elapsed, dt, n)
        state.work[0], state.dissipated[0] = work, dissipated
        count, changed = _touched(model, scratch), 0.0
        forward(model, scratch)
        if count > 0:
            changed = _press_back(model, scratch, count)
        backward(model, scratch)
        for v in range(n):
            o = 4 * model.factor_place[v]  # fixed: behind the rows, zeros
            state.vx[v] += right[o]
            state.vy[v] += right[o + 1]
            state.vz[v] += right[o + 2]
        if left > 0 and _settled(model, state, scratch, dt, count, changed):
            break
    if longest > 0.0 and _too_fast(state, scratch, longest, dt):
        back_to_start(state, scratch)
        state.work[0], state.dissipated[0] = work, dissipated
        return False
    place(state, scratch, dt)
    for tissue in range(model.tissue_rate.size):
        own = TISSUE_PARAMETERS * tissue
        c = dt * (parameters[own + DRAG] + parameters[own + SUPPORT_DAMPING])
        damped = _damp(model, parameters, state, scratch, tissue, n)
        for v in range(model.tissue_vertex_start[tissue], model.tissue_vertex_start[tissue + 1]):
            vx, vy, vz = state.vx[v], state.vy[v], state.vz[v]
            scratch.loss[v] += c * model.node_area[v] * (vx * vx + vy * vy + vz * vz)
            if damped:
                q = scratch.solve[3 * n : 6 * n]
                scratch.loss[v] += dt * (vx * q[v] + vy * q[n + v] + vz * q[2 * n + v])
    return True
