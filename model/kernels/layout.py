"""What a step reads and writes: three bundles of flat arrays, and nothing else.

Every array is one-dimensional and C-contiguous, either `Real` (float64) or `Index` (uint32: unsigned indices need no
wrap-around test, which lets the loops run without a branch). A bundle lives in two blocks, one of each kind, its
fields one after the other in the order of their declaration; `pack` makes the blocks and `spans` says where each
field lies. The FMU holds the same blocks and rebuilds the same bundles from the same spans, so nothing is listed
twice.
"""

from typing import NamedTuple, TypeVar, get_type_hints

import numpy as np
import numpy.typing as npt

Real = npt.NDArray[np.float64]
Index = npt.NDArray[np.uint32]


class Model(NamedTuple):
    """Everything that never changes after assembly: topology, rest shape, instrument bodies.

    Counts: V tissue vertices, S springs, T tissue triangles, n tissues; I instruments, P convex parts, W instrument
    vertices, U instrument triangles; K contact pairs; Q probes. Tissues, and instruments, lie one after the other;
    ``*_start`` gives where each begins, with one entry more than there are. A triangle's corners are indices into
    all tissue (or all instrument) vertices.
    """

    # -- tissue
    tissue_vertex_start: Index  # shape [n + 1]
    tissue_spring_start: Index  # shape [n + 1]
    tissue_triangle_start: Index  # shape [n + 1]
    spring_i: Index  # shape [S], first vertex
    spring_j: Index  # shape [S], second vertex
    triangle_a: Index  # shape [T]
    triangle_b: Index  # shape [T]
    triangle_c: Index  # shape [T]
    # -- instruments
    instrument_part_start: Index  # shape [I + 1]
    instrument_triangle_start: Index  # shape [I + 1]
    instrument_a: Index  # shape [U]
    instrument_b: Index  # shape [U]
    instrument_c: Index  # shape [U]
    instrument_part: Index  # shape [U], the convex part that owns the triangle
    grid_size: Index  # shape [3 I], cells along each axis of the body frame
    grid_occupied: Index  # shape [I], cells that hold a triangle of the instrument
    grid_cell_start: Index  # shape [I + 1], where the cells of an instrument begin in cell_start
    cell_start: Index  # shape [cells + I], where the triangles of a cell begin in cell_triangle; one end mark each
    cell_triangle: Index  # shape [entries], instrument triangles that touch a cell
    # -- contact pairs, probes, solver
    contact_tissue: Index  # shape [K]
    contact_instrument: Index  # shape [K]
    contact_response: Index  # shape [K], how depth is measured: OOBB or HULL of `collision`
    contact_weighted: Index  # shape [K], 1: the pairs of a region share one force; 0: each pair has its own
    contact_side_start: Index  # shape [K + 1], where a pair's latched sides begin
    hull_start: Index  # shape [P + 1], where the hull vertices of a part begin; empty parts where no contact asks
    hull_edge_start: Index  # shape [H + 1], where the neighbours of a hull vertex begin in hull_neighbour
    hull_neighbour: Index  # shape [hull edges x 2], hull vertices at the other end of an edge
    probe_triangle: Index  # shape [Q]
    substeps_fixed: Index  # shape [1], 0: automatic
    substeps_max: Index  # shape [1]
    # -- tissue
    rest_x: Real  # [m], shape [V]
    rest_y: Real  # [m], shape [V]
    rest_z: Real  # [m], shape [V]
    node_area: Real  # [m²], shape [V], one third of the adjacent triangles
    node_free: Real  # [1], shape [V], 1 free, 0 fixed
    node_mobility: Real  # [1/m²], shape [V], node_free / node_area
    spring_rest: Real  # [m], shape [S], rest length
    spring_stiffness: Real  # [N/m], shape [S]
    spring_damping: Real  # [N·s/m], shape [S]
    tissue_rate: Real  # [N/m/m²], shape [n], largest eigenvalue of the springs' Laplacian over node_area
    tissue_node_area_min: Real  # [m²], shape [n], smallest node_area of a free vertex
    gravity: Real  # [m/s²], shape [3]
    # -- instruments, all in the body frame
    instrument_x: Real  # [m], shape [W]
    instrument_y: Real  # [m], shape [W]
    instrument_z: Real  # [m], shape [W]
    instrument_low: Real  # [m], shape [3 U], least corner of a triangle's box
    instrument_high: Real  # [m], shape [3 U], greatest corner of a triangle's box
    part_centre: Real  # [m], shape [3 P], centre of the object-oriented bounding box
    part_axes: Real  # [1], shape [9 P], its three unit axes, one after the other
    part_half: Real  # [m], shape [3 P], its half extents along them
    hull_x: Real  # [m], shape [H], vertices of the convex hulls of the parts
    hull_y: Real  # [m], shape [H]
    hull_z: Real  # [m], shape [H]
    part_axis: Real  # [m], shape [6 P], shaft axis: tip end, handle end
    part_reach: Real  # [m], shape [P], how far the mark lies towards the handle from the axis point at the contact
    grid_low: Real  # [m], shape [3 I], least corner of the cell grid
    grid_cell: Real  # [m], shape [I], edge of a cell
    # -- probes, solver
    probe_weight: Real  # [1], shape [3 Q], areal coordinates
    safety: Real  # [1], shape [1], share of the stable limit that is used
    detection_period: Real  # [s], shape [1], time between two collision detections


class State(NamedTuple):
    """Everything that persists from step to step, contact memory included. A copy of it is the whole state.

    A *touch* is a tissue triangle with its intersecting pairs with one part of an instrument. M is the capacity for
    pairs of one contact; contact k has the entries from k M of every touch_ array.
    """

    pairs: Index  # shape [K], intersecting pairs of the last detection
    rejected: Index  # shape [K], pairs that it rejected as passed through
    side: Index  # shape [T of each contact], latched side: 0 not touched, 1 facing, 2 rejected
    touches: Index  # shape [K]
    regions: Index  # shape [K], parts of the instrument that touch
    touch_triangle: Index  # shape [K M], tissue triangle
    touch_part: Index  # shape [K M], part of the instrument
    touch_support: Index  # shape [K M], hull vertex that was deepest at the last look
    x: Real  # [m], shape [V]
    y: Real  # [m], shape [V]
    z: Real  # [m], shape [V]
    vx: Real  # [m/s], shape [V]
    vy: Real  # [m/s], shape [V]
    vz: Real  # [m/s], shape [V]
    touch_share: Real  # [1], shape [K M], share of the force of the part; the raw number of pairs if unweighted
    touch_a: Real  # [1], shape [K M], areal coordinates of the point of collision
    touch_b: Real  # [1], shape [K M]
    touch_c: Real  # [1], shape [K M]
    touch_nx: Real  # [1], shape [K M], inner normal of the triangle when it was found, world frame
    touch_ny: Real  # [1], shape [K M]
    touch_nz: Real  # [1], shape [K M]
    touch_load: Real  # [1/m²], shape [K], largest share of a vertex over its area
    pose: Real  # [m, 1], shape [7 I], position and unit quaternion w, x, y, z at the last communication point
    since_detection: Real  # [s], shape [1]
    dissipated: Real  # [J], shape [1]
    work: Real  # [J], shape [1], done by the instruments on the tissue
    energy_start: Real  # [J], shape [1], stored energy when the work began to be counted


class Scratch(NamedTuple):
    """Room to work in; meaningless between calls, but for ``detail`` after a status other than OK.

    M is the capacity for pairs; C the most cells that an instrument's grid has.
    """

    outcode: Index  # shape [V], which faces of the instrument's box a vertex lies beyond, a bit a face
    stamp: Index  # shape [U], 1 + the last tissue triangle that met an instrument triangle
    cell_stamp: Index  # shape [C], 1 where a tissue triangle was met in a cell
    cells: Index  # shape [3], empty, solo and potentially colliding cells of the last detection
    hit: Index  # shape [U], instrument triangles that intersect one tissue triangle
    pair_triangle: Index  # shape [M], tissue triangle of a pair
    pair_instrument: Index  # shape [M], instrument triangle of a pair
    detail: Real  # shape [2], figures for the message of a status
    expansion: Real  # shape [256], exact arithmetic
    fx: Real  # [N], shape [V], force on a vertex
    fy: Real  # [N], shape [V]
    fz: Real  # [N], shape [V]
    body_x: Real  # [m], shape [V], tissue vertices in the body frame
    body_y: Real  # [m], shape [V]
    body_z: Real  # [m], shape [V]
    loss: Real  # [J], shape [V], dissipated at a vertex within the step
    vertex_share: Real  # [1], shape [V], share of the force that a vertex takes
    touch_length: Real  # [m], shape [M], length of the intersection curve within the triangle
    touch_pairs: Real  # [1], shape [M]
    part_length: Real  # [m], shape [P], length of the intersection curve of a part
    part_touches: Real  # [1], shape [P]
    pose: Real  # [m, 1], shape [7 I], pose of each instrument within the step
    motion: Real  # [m/s, rad/s], shape [6 I], velocity and angular velocity of each instrument
    contact: Real  # shape [12 I], see `response`: force, torque, depth, regions, weighted point
    pulse: Real  # [N·s], shape [3 I], impulse on each instrument within the step
    unit_x: Real  # [1], shape [S where a spring is damped, else 0], direction of a spring
    unit_y: Real  # [1], shape as unit_x
    unit_z: Real  # [1], shape as unit_x
    solve: Real  # [m/s], shape [9 V where a spring is damped, else 0], vectors of the conjugate gradients


Bundle = TypeVar("Bundle", Model, State, Scratch)


def blocks(bundle: type[Bundle]) -> dict[str, type]:
    """Field names of a bundle with the scalar type of the block that each lies in."""
    hints = get_type_hints(bundle)
    return {name: np.uint32 if hints[name] == Index else np.float64 for name in bundle._fields}


def pack(bundle: Bundle) -> tuple[Bundle, Index, Real]:
    """Copy the arrays of a bundle into one `Index` and one `Real` block.

    Returns
    -------
    bundle, index, real
        The bundle again, its fields now views of the two blocks, and the blocks.
    """
    kinds = blocks(type(bundle))
    fields, made = {}, []
    for kind in (np.uint32, np.float64):
        names = [name for name in bundle._fields if kinds[name] is kind]
        parts = [np.asarray(getattr(bundle, name), kind).ravel() for name in names]
        block = np.concatenate(parts) if parts else np.empty(0, kind)
        ends = np.cumsum([part.size for part in parts])
        for name, part, end in zip(names, parts, ends, strict=True):
            fields[name] = block[end - part.size : end]
        made.append(block)
    return type(bundle)(**fields), made[0], made[1]


def spans(bundle: Bundle) -> npt.NDArray[np.uint64]:
    """Begin and end of every field in its block, shape [2 fields], in the order of declaration."""
    kinds = blocks(type(bundle))
    at = {np.uint32: 0, np.float64: 0}
    out = []
    for name in bundle._fields:
        size = getattr(bundle, name).size
        out += [at[kinds[name]], at[kinds[name]] + size]
        at[kinds[name]] += size
    return np.array(out, np.uint64)
