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
    half_start: Index  # shape [V + 1], where the spring ends of a vertex begin in half_spring
    half_spring: Index  # shape [2 S], spring s as 2 s where the vertex is its first end, 2 s + 1 where its second
    # -- instruments
    instrument_part_start: Index  # shape [I + 1]
    instrument_triangle_start: Index  # shape [I + 1]
    instrument_a: Index  # shape [U]
    instrument_b: Index  # shape [U]
    instrument_c: Index  # shape [U]
    instrument_part: Index  # shape [U], the convex part that owns the triangle
    grid_size: Index  # shape [3 I], cells along each axis of the body frame
    grid_cell_start: Index  # shape [I + 1], where the cells of an instrument begin in cell_start
    cell_start: Index  # shape [cells + I], where the triangles of a cell begin in cell_triangle; one end mark each
    cell_triangle: Index  # shape [entries], instrument triangles that touch a cell
    # -- contact pairs, probes, solver
    contact_tissue: Index  # shape [K]
    contact_instrument: Index  # shape [K]
    contact_side_start: Index  # shape [K + 1], where a pair's latched sides begin
    probe_triangle: Index  # shape [Q]
    substeps_fixed: Index  # shape [1], 0: automatic
    substeps_max: Index  # shape [1]
    # -- tissue
    rest_x: Real  # [m], shape [V]
    rest_y: Real  # [m], shape [V]
    rest_z: Real  # [m], shape [V]
    node_area: Real  # [m²], shape [V], one third of the adjacent triangles
    node_free: Real  # [1], shape [V], 1 free, 0 fixed
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
    part_axis: Real  # [m], shape [6 P], shaft axis: tip end, handle end
    part_reach: Real  # [m], shape [P], how far the mark lies towards the handle from the axis point at the contact
    grid_low: Real  # [m], shape [3 I], least corner of the cell grid
    grid_cell: Real  # [m], shape [I], edge of a cell
    # -- probes, solver
    probe_weight: Real  # [1], shape [3 Q], areal coordinates
    safety: Real  # [1], shape [1], share of the stable limit that is used
    detection_period: Real  # [s], shape [1], time between two collision detections


class State(NamedTuple):
    """Everything that persists from step to step, contact memory included. A copy of it is the whole state."""

    pair_count: Index  # shape [K], pairs held by each contact
    pair_triangle: Index  # shape [K * capacity], tissue triangle of a pair
    pair_instrument: Index  # shape [K * capacity], instrument triangle of a pair
    pair_region: Index  # shape [K * capacity], contact region of a pair, counted from 0 in its contact
    region_count: Index  # shape [K]
    rejected: Index  # shape [K], pairs that the last detection rejected as passed through
    side: Index  # shape [K's tissue triangles], latched side: 0 not touched, 1 facing, 2 rejected
    x: Real  # [m], shape [V]
    y: Real  # [m], shape [V]
    z: Real  # [m], shape [V]
    vx: Real  # [m/s], shape [V]
    vy: Real  # [m/s], shape [V]
    vz: Real  # [m/s], shape [V]
    pose: Real  # [m, 1], shape [7 I], position and unit quaternion w, x, y, z at the last communication point
    since_detection: Real  # [s], shape [1]
    dissipated: Real  # [J], shape [1]
    work: Real  # [J], shape [1], done by the instruments on the tissue
    energy_start: Real  # [J], shape [1], stored energy when the work began to be counted


class Scratch(NamedTuple):
    """Room to work in; meaningless between calls, but for ``detail`` after a status other than OK."""

    outcode: Index  # shape [V], which faces of the instrument's box a vertex lies beyond
    stamp: Index  # shape [U], last tissue triangle that was paired with an instrument triangle
    cell_stamp: Index  # shape [cells], last detection pass that met a tissue triangle in a cell
    touched: Index  # shape [capacity], parents of the touched triangles in the search for regions
    vertex_touch: Index  # shape [V], touched triangle at a vertex, counted from 1; 0: none
    cells: Index  # shape [3], empty, solo and potentially colliding cells of the last detection
    detail: Real  # shape [2], figures for the message of a status
    fx: Real  # [N], shape [V]
    fy: Real  # [N], shape [V]
    fz: Real  # [N], shape [V]
    body_x: Real  # [m], shape [V], tissue vertices in the body frame
    body_y: Real  # [m], shape [V]
    body_z: Real  # [m], shape [V]
    loss: Real  # [J], shape [V], dissipated at a vertex within the step
    spring_x: Real  # [N], shape [S], force on the first end; later its unit vector
    spring_y: Real  # [N], shape [S]
    spring_z: Real  # [N], shape [S]
    solve: Real  # shape [9 V where a spring is damped, else 0], vectors of the conjugate gradients
    expansion: Real  # shape [1024], exact arithmetic
    pulse: Real  # [N·s, N·m·s], shape [6 I], impulse and its moment on each instrument within the step


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
