"""Where the vertices of a tissue are in the body frame, and which cannot touch."""

from tissue_contact.kernels.compiled import inner


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
