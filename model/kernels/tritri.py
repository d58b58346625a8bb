"""Triangle against triangle: do they share a point? Decided by exact signs alone.

After Guigue and Devillers (2003, Fast and robust triangle-triangle overlap test using orientation predicates). Each
triangle must have a vertex that is alone on its side of the other's plane; turned so that these come first, on the
positive sides, the two triangles cut the line common to their planes in two intervals, and two more signs say whether
the intervals overlap.
"""

from tissue_contact.kernels.compiled import inner, kernel
from tissue_contact.kernels.predicates import side

DISJOINT = 0
INTERSECT = 1
COPLANAR = 2  # in one plane, or one has no area: no contact by definition, as no side is inner


@kernel
def alone(s0, s1, s2):
    """Vertex that is alone on its side of a plane, and whether that side is the negative one.

    ``s0``, ``s1``, ``s2`` are the vertices' signed distances or their signs, neither all of one strict sign nor all
    zero. A vertex in the plane counts for the side on which no other vertex lies.
    """
    positive = (1 if s0 > 0 else 0) + (1 if s1 > 0 else 0) + (1 if s2 > 0 else 0)
    negative = (1 if s0 < 0 else 0) + (1 if s1 < 0 else 0) + (1 if s2 < 0 else 0)
    if positive == 1:
        return (0 if s0 > 0 else (1 if s1 > 0 else 2)), False
    if negative == 1:
        return (0 if s0 < 0 else (1 if s1 < 0 else 2)), True
    # two on one side, the third in the plane
    return (0 if s0 == 0 else (1 if s1 == 0 else 2)), positive == 2


@inner
def _turn(p, q, r, first):
    if first == 0:
        return p, q, r
    if first == 1:
        return q, r, p
    return r, p, q


@kernel
def intersect(p1, q1, r1, p2, q2, r2, expansion):
    """Whether two closed triangles share a point: `DISJOINT`, `INTERSECT` or `COPLANAR`.

    The corners are tuples of three; ``expansion`` lends room, shape [256].
    """
    a = side(p2, q2, r2, p1, expansion)
    b = side(p2, q2, r2, q1, expansion)
    c = side(p2, q2, r2, r1, expansion)
    if a == b and b == c:
        return COPLANAR if a == 0 else DISJOINT
    first1, negative1 = alone(a, b, c)
    a = side(p1, q1, r1, p2, expansion)
    b = side(p1, q1, r1, q2, expansion)
    c = side(p1, q1, r1, r2, expansion)
    if a == b and b == c:
        return COPLANAR if a == 0 else DISJOINT
    first2, negative2 = alone(a, b, c)
    p1, q1, r1 = _turn(p1, q1, r1, first1)
    p2, q2, r2 = _turn(p2, q2, r2, first2)
    if negative1:
        q2, r2 = r2, q2
    if negative2:
        q1, r1 = r1, q1
    if side(q1, p2, p1, q2, expansion) > 0 or side(p1, p2, r1, r2, expansion) > 0:
        return DISJOINT
    return INTERSECT
