"""Which triangles of a tissue may touch a body: where its vertices are in the body frame, block by block."""

import math

from tissue_contact.kernels.compiled import inner, pointwise
from tissue_contact.kernels.vectors import dot, to_body

WORD = 32  # triangles that one number marks, a bit each
ANYWHERE = 1e9  # [m] radius of a ball that holds all places that a step may be made of
ROUNDING = 1e-9  # of lengths, far more than what sums and turns of them err by


@pointwise
def in_body(state, v, r, p):
    """A vertex in the body frame [m]."""
    return to_body(r, (state.x[v] - p[0], state.y[v] - p[1], state.z[v] - p[2]))


@pointwise
def _faces(q, low, high):
    """The faces of the box low, high that a point lies beyond, a bit each."""
    return (
        (1 if q[0] < low[0] else 0)
        | (2 if q[0] > high[0] else 0)
        | (4 if q[1] < low[1] else 0)
        | (8 if q[1] > high[1] else 0)
        | (16 if q[2] < low[2] else 0)
        | (32 if q[2] > high[2] else 0)
    )


@inner
def loosen(model, state, tissue, way):
    """Let the vertices of blocks be as far from the middles as they may be when each has gone a ``way`` [m] more."""
    for n in range(model.tissue_block_start[tissue], model.tissue_block_start[tissue + 1]):
        state.block_reach[n] = min(ANYWHERE, state.block_reach[n] + 2.0 * way)


@inner
def _is_beyond(model, state, block, r, p, low, high):
    """Whether the ball around the middle of a block, which holds all of its vertices, lies beyond a face of the box."""
    q = in_body(state, model.block_middle[block], r, p)
    reach = (1.0 + ROUNDING) * state.block_reach[block] + ROUNDING * (abs(q[0]) + abs(q[1]) + abs(q[2]))
    low = (low[0] - reach, low[1] - reach, low[2] - reach)
    high = (high[0] + reach, high[1] + reach, high[2] + reach)
    return _faces(q, low, high) != 0


@inner
def _locate(state, scratch, v, r, p, low, high):
    """Change a vertex to the body frame and mark the faces of the box low, high that it lies beyond."""
    q = in_body(state, v, r, p)
    scratch.local_x[v] = q[0]
    scratch.local_y[v] = q[1]
    scratch.local_z[v] = q[2]
    scratch.outcode[v] = _faces(q, low, high)


@inner
def _locate_block(model, state, scratch, block, r, p, low, high):
    """Locate the vertices of a block, and find how far from its middle they are."""
    c, farthest = model.block_middle[block], 0.0
    for k in range(model.block_vertex_start[block], model.block_vertex_start[block + 1]):
        v = model.block_vertex[k]
        _locate(state, scratch, v, r, p, low, high)
        d = (state.x[v] - state.x[c], state.y[v] - state.y[c], state.z[v] - state.z[c])
        farthest = max(farthest, dot(d, d))
    state.block_reach[block] = math.sqrt(farthest)


@inner
def find_candidates(model, state, scratch, contact, r, p, low, high, known):
    """Find the triangles of a contact's tissue whose vertices do not all lie beyond one face of the box low, high.

    ``r`` and ``p`` [m] are the rotation matrix and the position of the body frame, in which the box is. Triangles are
    looked at in blocks. Where it is ``known`` how far vertices have gone since they were looked at, nothing is read of
    a block whose ball lies beyond a face; else all vertices are located first, in vectors. The side of a triangle that
    had a side and is not found any longer is forgotten.

    Returns
    -------
    int
        How many they are; they are in scratch.candidate, ascending, their corners in scratch.local_x, local_y, local_z.
    """
    tissue = model.contact_tissue[contact]
    origin, end = model.tissue_triangle_start[tissue], model.tissue_triangle_start[tissue + 1]
    outcode, marks = scratch.outcode, scratch.marks
    marks[:] = 0
    if not known:
        for v in range(model.tissue_vertex_start[tissue], model.tissue_vertex_start[tissue + 1]):
            _locate(state, scratch, v, r, p, low, high)
    for n in range(model.tissue_block_start[tissue], model.tissue_block_start[tissue + 1]):
        if known:
            if _is_beyond(model, state, n, r, p, low, high):
                continue
            _locate_block(model, state, scratch, n, r, p, low, high)
        common = 63
        for k in range(model.block_vertex_start[n], model.block_vertex_start[n + 1]):
            common &= outcode[model.block_vertex[k]]
        if common != 0:
            continue
        for k in range(model.block_triangle_start[n], model.block_triangle_start[n + 1]):
            t = model.block_triangle[k]
            if outcode[model.triangle_a[t]] & outcode[model.triangle_b[t]] & outcode[model.triangle_c[t]] == 0:
                marks[(t - origin) // WORD] |= 1 << (t - origin) % WORD
    begin, sides = model.contact_near_start[contact], model.contact_side_start[contact]
    for k in range(begin, begin + state.near_count[contact]):
        t = state.near[k] - origin
        if marks[t // WORD] >> t % WORD & 1 == 0:
            state.side[sides + t] = 0
    n = 0
    for word in range((end - origin + WORD - 1) // WORD):
        if marks[word] != 0:
            for bit in range(WORD):
                if marks[word] >> bit & 1 == 1:
                    scratch.candidate[n] = origin + WORD * word + bit
                    n += 1
    return n
