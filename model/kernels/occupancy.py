"""Which triangles of a tissue may touch a body: where its vertices are in the body frame, block by block."""

import math

from tissue_contact.kernels.compiled import inner, pointwise
from tissue_contact.kernels.vectors import dot, to_body

WORD = 32  # triangles that one number marks, a bit each
ANYWHERE = 1e9  # [m] radius of a ball that holds all places that a step may be made of
ROUNDING = 1e-9  # of lengths, far more than what sums and turns of them err by


@pointwise
def _place_in_body(x, y, z, k, r, p):
    """Place k of those of x, y and z in the body frame [m]."""
    return to_body(r, (x[k] - p[0], y[k] - p[1], z[k] - p[2]))


@pointwise
def in_body(state, v, r, p):
    """A vertex in the body frame [m]."""
    return _place_in_body(state.x, state.y, state.z, v, r, p)


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
    """Let the vertices of blocks be as far as they may be when each has gone a ``way`` [m] more."""
    for n in range(model.tissue_block_start[tissue], model.tissue_block_start[tissue + 1]):
        state.block_reach[n] = min(ANYWHERE, state.block_reach[n] + way)


@inner
def _pass_over(state, scratch, first, last, r, p, low, high):
    """Mark the faces of the box low, high that the balls around the vertices of blocks first to last lie beyond."""
    x, y, z = state.block_x[first:last], state.block_y[first:last], state.block_z[first:last]
    reach, beyond = state.block_reach[first:last], scratch.block_outcode[first:last]
    for k in range(reach.size):  # with no way out it runs in vectors
        q = _place_in_body(x, y, z, k, r, p)
        far = (1.0 + ROUNDING) * reach[k] + ROUNDING * (abs(q[0]) + abs(q[1]) + abs(q[2]))
        beyond[k] = _faces(q, (low[0] - far, low[1] - far, low[2] - far), (high[0] + far, high[1] + far, high[2] + far))


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
    """Locate the vertices of a block, and find the ball around its middle that holds them."""
    c, farthest = model.block_middle[block], 0.0
    x, y, z = state.x[c], state.y[c], state.z[c]
    for k in range(model.block_vertex_start[block], model.block_vertex_start[block + 1]):
        v = model.block_vertex[k]
        _locate(state, scratch, v, r, p, low, high)
        d = (state.x[v] - x, state.y[v] - y, state.z[v] - z)
        farthest = max(farthest, dot(d, d))
    state.block_x[block], state.block_y[block], state.block_z[block] = x, y, z
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
    first, last = model.tissue_block_start[tissue], model.tissue_block_start[tissue + 1]
    if known:
        _pass_over(state, scratch, first, last, r, p, low, high)
    for n in range(first, last):
        if known:
            if scratch.block_outcode[n] != 0:
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
