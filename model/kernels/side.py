"""On which side of a tissue triangle the body is: it is decided once and kept while the triangle stays touched.

An instrument that passes through a thin tissue also meets its far surface, which must not pull it on (thesis 3.6.3).
"""

from tissue_contact.kernels.compiled import inner

FACING, REJECTED = 1, 2  # latched side of a tissue triangle, 0: not touched
SIDE_HYSTERESIS = 0.1  # share of the part's reach by which a latched side must be contradicted before it turns


@inner
def latch(before, seen):
    """Side of a triangle from the one before and from what `collision.facing` says now."""
    if before != 0 and abs(seen) < SIDE_HYSTERESIS:
        return before
    return FACING if seen > 0.0 else REJECTED
