"""Where the vertices of a tissue are in the body frame, and which triangles may touch."""

from tissue_contact.kernels.compiled import inner

WORD = 32  # triangles that one number marks, a bit each


@inner
def locate(x, y, z, first, last, r, p, low, high, local_x, local_y, local_z, outcode):
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
        local_x[v] = bx
        local_y[v] = by
        local_z[v] = bz
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
def find_candidates(model, state, scratch, contact):
    """Find the triangles of a contact's tissue whose vertices do not all lie beyond one face, after `locate`.

    Triangles are looked at in blocks that pass the same test as a whole. The side of one that had a side and is not
    found any longer is forgotten.

    Returns
    -------
    int
        How many they are; they are in scratch.candidate, ascending.
    """
    tissue = model.contact_tissue[contact]
    origin, end = model.tissue_triangle_start[tissue], model.tissue_triangle_start[tissue + 1]
    outcode, marks = scratch.outcode, scratch.marks
    marks[:] = 0
    for n in range(model.tissue_block_start[tissue], model.tissue_block_start[tissue + 1]):
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
