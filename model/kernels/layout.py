"""What a step reads and writes: three bundles of flat arrays, and nothing else.

Every array is one-dimensional and C-contiguous, either `Real` (float64) or `Index` (uint32: unsigned indices need no
wrap-around test, which lets the loops run without a branch). A bundle lives in two blocks, one of each kind, its
fields one after the other in the order of their declaration; `pack` makes the blocks and `spans` says where each
field lies. The FMU holds the same blocks and rebuilds the same bundles from the same spans, so nothing is listed
twice.
"""

from functools import cache
from typing import NamedTuple, TypeVar, get_type_hints

import numpy as np
import numpy.typing as npt

Real = npt.NDArray[np.float64]
Index = npt.NDArray[np.uint32]


class Model(NamedTuple):
    """Everything that never changes after assembly: topology, rest shape, rigid bodies.

    Counts: V tissue vertices, S springs, T tissue triangles, D blocks of them, N tissue points, n tissues; B bodies,
    that is I instruments and then the rigid bodies that do not move, P parts of bodies, W body vertices, U body
    triangles, M sample points; K contacts; G holds (a grasper and a tissue), J graspers; Q probes; F rows of the
    factor of projective dynamics, X panels of its columns and Y rows of those, of `elimination`. Tissues, and bodies,
    lie one after the other; ``*_start`` gives where each begins, with one entry more than there are. A triangle's
    corners are indices into all tissue (or all body) vertices. What no contact or effect of the scene asks for is
    empty.
    """

    # -- tissue
    tissue_vertex_start: Index  # shape [n + 1]
    tissue_spring_start: Index  # shape [n + 1]
    tissue_triangle_start: Index  # shape [n + 1]
    tissue_block_start: Index  # shape [n + 1]
    block_triangle_start: Index  # shape [D + 1], where the triangles of a block begin in block_triangle
    block_triangle: Index  # shape [T of tissues in contact], each once
    block_vertex_start: Index  # shape [D + 1], where the vertices of a block begin in block_vertex
    block_vertex: Index  # corners of the triangles of each block, once in a block, ascending
    block_middle: Index  # shape [D], the corner nearest to the middle of a block at rest
    spring_i: Index  # shape [S], first vertex
    spring_j: Index  # shape [S], second vertex
    triangle_a: Index  # shape [T]
    triangle_b: Index  # shape [T]
    triangle_c: Index  # shape [T]
    triangle_point_start: Index  # shape [T + 1], where the points of a triangle begin; if a field reads any tissue
    # -- bodies
    instruments: Index  # shape [1], I
    body_part_start: Index  # shape [B + 1]
    body_triangle_start: Index  # shape [B + 1], only of bodies whose triangles are looked for
    body_sample_start: Index  # shape [B + 1], only of bodies that another body's field reads
    body_a: Index  # shape [U]
    body_b: Index  # shape [U]
    body_c: Index  # shape [U]
    body_part: Index  # shape [U], the part that owns the triangle
    grid_size: Index  # shape [3 B], cells along each axis of the body frame
    grid_occupied: Index  # shape [B], cells that hold a triangle of the body
    grid_cell_start: Index  # shape [B + 1], where the cells of a body begin in cell_start
    cell_start: Index  # shape [cells + B], where the triangles of a cell begin in cell_triangle; one end mark each
    cell_triangle: Index  # shape [entries], body triangles that touch a cell
    part_field: Index  # shape [P], kind of a part's distance field, see `field`
    field_start: Index  # shape [P + 1], where the numbers of a field begin in field_value
    field_size: Index  # shape [3 P], nodes of a sampled field along each axis
    # -- contacts, holds, probes, solver
    contact_tissue: Index  # shape [K], 0 and not used between bodies
    contact_body: Index  # shape [K], the body that has the field or the triangles
    contact_other: Index  # shape [K], the body whose points are read; used between bodies only
    contact_response: Index  # shape [K], POLYTOPE to BODIES of `collision`
    contact_law: Index  # shape [K], KELVIN_VOIGT or HUNT_CROSSLEY of `laws`
    contact_both: Index  # shape [K], 1: both sides of the tissue count
    contact_weighted: Index  # shape [K], 1: the pairs of a region share one force; 0: each pair has its own
    contact_side_start: Index  # shape [K + 1], where a contact's latched sides begin
    contact_touch_start: Index  # shape [K + 1], where a contact's touches begin
    contact_near_start: Index  # shape [K + 1], where a contact's list of what is near begins
    contact_hull: Index  # shape [K], polytope of the first part of the contact's body
    hull_start: Index  # shape [polytopes + 1], where the vertices of a polytope begin
    hull_edge_start: Index  # shape [H + 1], where the neighbours of a polytope's vertex begin in hull_neighbour
    hull_neighbour: Index  # shape [edges x 2], vertices at the other end of an edge
    grasp_body: Index  # shape [G]
    grasp_tissue: Index  # shape [G]
    grasp_grasper: Index  # shape [G], which of the J graspers
    grasp_start: Index  # shape [G + 1], where a hold's anchors begin
    factor_vertex: Index  # shape [F], vertex of each row of the factor
    factor_place: Index  # shape [V], row of each vertex, F where it is fixed
    factor_panel: Index  # shape [F], panel of each row
    factor_column: Index  # shape [X + 1], first column of each panel, and F
    factor_start: Index  # shape [X + 1], where the rows of a panel begin
    factor_depth: Index  # shape [X], columns of a panel and of all panels that its elimination reaches
    factor_row: Index  # shape [Y], four times the row; 4 F + 4 where a panel has no such column
    factor_spring: Index  # shape [S], entry of each spring, 4 Y where an end is fixed
    probe_triangle: Index  # shape [Q]
    integrator: Index  # shape [1], SYMPLECTIC_EULER to PROJECTIVE_DYNAMICS of `stability`
    iterations: Index  # shape [1], of a substep of projective dynamics at most
    continuous: Index  # shape [1], 1: steps and detections follow the motion
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
    rest_area: Real  # [m²], shape [T where a tissue resists a change of area, else 0]
    rest_edges: Real  # [m²], shape [T where a tissue resists a change of area or volume, else 0], squared edges, summed
    tissue_rate: Real  # [N/m/m²], shape [n], largest eigenvalue of the springs' Laplacian over node_area
    tissue_damping_rate: Real  # [N·s/m/m²], shape [n], the same of their dampers
    tissue_area_rate: Real  # [1/m²], shape [n], the same of the area's resistance, for a stiffness of 1 N/m
    tissue_volume_rate: Real  # [1/m], shape [n], the same of the volume's resistance, for a stiffness of 1 Pa
    tissue_volume_bend: Real  # [1/m], shape [n], the same of a pressure within of 1 Pa
    tissue_volume: Real  # [m³], shape [n], at rest, negative where triangles face inward; 1 where it is not resisted
    tissue_node_area_min: Real  # [m²], shape [n], smallest node_area of a free vertex
    point_a: Real  # [1], shape [N], areal coordinates of the points at which fields are read
    point_b: Real  # [1], shape [N]
    point_c: Real  # [1], shape [N]
    point_area: Real  # [m²], shape [N], area at rest that a point stands for
    gravity: Real  # [m/s²], shape [3]
    # -- bodies, all in the body frame
    body_x: Real  # [m], shape [W]
    body_y: Real  # [m], shape [W]
    body_z: Real  # [m], shape [W]
    body_triangle_low: Real  # [m], shape [3 U], least corner of a triangle's box
    body_triangle_high: Real  # [m], shape [3 U], greatest corner of a triangle's box
    body_low: Real  # [m], shape [3 B], least corner of a body's box
    body_high: Real  # [m], shape [3 B], greatest corner of a body's box
    body_radius: Real  # [m], shape [B], largest distance from the frame's origin
    part_centre: Real  # [m], shape [3 P], centre of the object-oriented bounding box
    part_axes: Real  # [1], shape [9 P], its three unit axes, one after the other
    part_half: Real  # [m], shape [3 P], its half extents along them
    hull_x: Real  # [m], shape [H], vertices of the polytopes
    hull_y: Real  # [m], shape [H]
    hull_z: Real  # [m], shape [H]
    part_axis: Real  # [m], shape [6 P], shaft axis: tip end, handle end
    part_reach: Real  # [m], shape [P], how far the mark lies towards the handle from the axis point at the contact
    grid_low: Real  # [m], shape [3 B], least corner of the cell grid
    grid_cell: Real  # [m], shape [B], edge of a cell
    field_value: Real  # numbers of the distance fields, see `field`
    field_low: Real  # [m], shape [3 P], first node of a sampled field
    field_spacing: Real  # [m], shape [P], between its nodes
    sample_x: Real  # [m], shape [M], points of a body that another body's field reads
    sample_y: Real  # [m], shape [M]
    sample_z: Real  # [m], shape [M]
    sample_area: Real  # [m²], shape [M]
    # -- contacts, holds, probes, solver
    contact_reach: Real  # [m], shape [K], smallest half extent of the contact's bodies
    contact_depth: Real  # [m], shape [K], greatest depth of the body's field
    contact_slip_speed: Real  # [m/s], shape [K]
    grasp_centre: Real  # [m], shape [3 G], middle of the jaws in the body frame
    grasp_radius: Real  # [m], shape [G]
    grasp_close: Real  # [1], shape [G], the jaws close below it
    grasp_open: Real  # [1], shape [G], the jaws open above it
    probe_weight: Real  # [1], shape [3 Q], areal coordinates
    step: Real  # [s], shape [1], communication step that the scene foresees
    safety: Real  # [1], shape [1], share of the stable limit that is used
    detection_period: Real  # [s], shape [1], longest time between two collision detections, infinite: as motion asks
    energy_gain: Real  # [1], shape [1], energy that may come from nowhere over what was put in
    tolerance: Real  # [1], shape [1], change with which projective dynamics is content
    motion_limit: Real  # [m], shape [1], way of a vertex in a substep, beyond which projective dynamics is left; 0 none


class State(NamedTuple):
    """Everything that persists from step to step, contact memory included. A copy of it is the whole state.

    A *touch* is a tissue triangle with its intersecting pairs with one part of a body. H is the room for touches of
    all contacts, R that for what is near, A that for anchors; L counts parameters.
    """

    pairs: Index  # shape [K], what the last detection found
    rejected: Index  # shape [K], what of it was rejected as passed through
    side: Index  # shape [T of each contact], latched side: 0 not touched, 1 facing, 2 rejected
    touches: Index  # shape [K]
    regions: Index  # shape [K], parts of the body that touch
    touch_triangle: Index  # shape [H], tissue triangle
    touch_part: Index  # shape [H], part of the body
    touch_support: Index  # shape [H], vertex of polytope or body that was deepest at the last look
    near_count: Index  # shape [K]
    near: Index  # shape [R], triangles, or points of a body, near a field; of other responses, triangles with a side
    closed: Index  # shape [G], 1: the jaws are closed
    held: Index  # shape [G], anchors
    anchor_vertex: Index  # shape [A]
    x: Real  # [m], shape [V]
    y: Real  # [m], shape [V]
    z: Real  # [m], shape [V]
    vx: Real  # [m/s], shape [V]
    vy: Real  # [m/s], shape [V]
    vz: Real  # [m/s], shape [V]
    touch_share: Real  # [1], shape [H], share of the force of the part; the raw number of pairs if unweighted
    touch_a: Real  # [1], shape [H], areal coordinates of the point of collision
    touch_b: Real  # [1], shape [H]
    touch_c: Real  # [1], shape [H]
    touch_nx: Real  # [1], shape [H], inner normal of the triangle when it was found, world frame
    touch_ny: Real  # [1], shape [H]
    touch_nz: Real  # [1], shape [H]
    touch_load: Real  # [1/m²], shape [K], largest share of a vertex over its area
    deepest: Real  # [m], shape [K], when forces were last evaluated
    tissue_speed: Real  # [m/s], shape [n], greatest of a vertex at the last check, 0 if not in contact
    tissue_way: Real  # [m], shape [n], of a vertex since the last detection, at most; `ANYWHERE` if not known
    block_x: Real  # [m], shape [D], place of the middle of a block when its vertices were last looked at
    block_y: Real  # [m], shape [D]
    block_z: Real  # [m], shape [D]
    block_reach: Real  # [m], shape [D], within which of that all vertices of the block are, `ANYWHERE` if not known
    anchor_x: Real  # [m], shape [A], place of an anchor in the body frame
    anchor_y: Real  # [m], shape [A]
    anchor_z: Real  # [m], shape [A]
    held_area: Real  # [m²], shape [G], of all that was held when the jaws closed
    pose: Real  # [m, 1], shape [7 B], position and unit quaternion w, x, y, z at the last communication point
    tuned: Real  # shape [L], parameters of the last step
    crush: Real  # [1], shape [n], greatest stiffness across a crushed spring over that along it, so far
    since_detection: Real  # [s], shape [1]
    moved: Real  # [1], shape [1], since the last detection, over what bodies and tissues may move between two
    dissipated: Real  # [J], shape [1]
    work: Real  # [J], shape [1], done by the bodies on the tissue and on each other
    stored: Real  # [J], shape [1], energy of tissue, contacts and holds at the last communication point
    energy_start: Real  # [J], shape [1], stored energy when the work began to be counted
    put_in: Real  # [J], shape [1], stored at the start, and put in by bodies, gravity and changed parameters since
    gained: Real  # [J], shape [1], from nowhere since the start, what dampers gave included
    returned: Real  # [J], shape [1], negative work of the bodies since the start
    resolved: Real  # [1], shape [1], 1 where the last step ended with symplectic Euler, as motion was too fast
    found: Real  # [J], shape [1], the most that one late detection usually finds, since the start


class Scratch(NamedTuple):
    """Room to work in; meaningless between calls, but for ``detail`` after a status other than OK and for the factor,
    which depends on nothing but the model, the parameters and the substep noted beside it.

    M is the most touches of a contact; C the most cells that a body's grid has; E the points that a substep of
    symplectic or implicit Euler, or projective dynamics, may press at once; F, X, Y and D are 0 but for projective
    dynamics, D the rows whose compliances are kept, H the greatest depth of a panel.
    """

    outcode: Index  # shape [V], which faces of the body's box a vertex lies beyond, a bit a face
    block_outcode: Index  # shape [D], which faces of the body's box the ball around a block lies beyond, a bit a face
    marks: Index  # shape [T / 32, rounded up], triangles of a tissue that may touch, a bit each
    candidate: Index  # shape [T], the same, listed
    touching: (
        Index  # shape [R], 1 for what is near a field and touched it, or was rejected, when forces were last evaluated
    )
    stamp: Index  # shape [U], 1 + the last tissue triangle that met a body triangle
    cell_stamp: Index  # shape [C], 1 where a tissue triangle was met in a cell
    cells: Index  # shape [3], empty, solo and potentially colliding cells of the last detection
    hit: Index  # shape [U], body triangles that intersect one tissue triangle
    pair_triangle: Index  # shape [M], tissue triangle of a pair
    pair_instrument: Index  # shape [M], body triangle of a pair
    active: Index  # shape [1], pressed points that were noted, or would have been
    active_contact: Index  # shape [E]
    active_a: Index  # shape [E], corners of the tissue triangle
    active_b: Index  # shape [E]
    active_c: Index  # shape [E]
    corner: Index  # shape [V where symplectic Euler meets a contact, else 0], corners of all pressed points, once each
    path: Index  # shape [X], 1 where a panel is reached by the elimination of some rows
    path_panel: Index  # shape [X], the panels that are reached
    touched: Index  # shape [F], rows that contacts and holds press; ascending
    touched_mark: Index  # shape [F], 1 where a row is among them
    touched_count: Index  # shape [1]
    slot_row: Index  # shape [D], row whose compliances a slot holds, F if none
    slot_new: Index  # shape [D], 1 where they are still to be found
    row_slot: Index  # shape [F], slot of a row, D if none
    lane_slot: Index  # shape [4]
    push_row: Index  # shape [3 F]
    detail: Real  # shape [2], figures for the message of a status
    expansion: Real  # shape [256], exact arithmetic
    point_distance: Real  # [m], shape [most points of a triangle], signed distance of each from a body
    point_x: Real  # [1], shape [most points of a triangle], gradient of the distance, body frame
    point_y: Real  # [1], shape [most points of a triangle]
    point_z: Real  # [1], shape [most points of a triangle]
    fx: Real  # [N], shape [V], force on a vertex
    fy: Real  # [N], shape [V]
    fz: Real  # [N], shape [V]
    local_x: Real  # [m], shape [V], tissue vertices in the body frame
    local_y: Real  # [m], shape [V]
    local_z: Real  # [m], shape [V]
    loss: Real  # [J], shape [V], dissipated at a vertex within the step
    vertex_share: Real  # [1], shape [V where triangles are looked for, else 0], share of the force that a vertex takes
    damping: Real  # shape [23 V where symplectic Euler meets a contact, else 0], vectors of `damping`
    touch_length: Real  # [m], shape [M], length of the intersection curve within the triangle
    touch_pairs: Real  # [1], shape [M]
    part_length: Real  # [m], shape [P], length of the intersection curve of a part
    part_touches: Real  # [1], shape [P]
    pose: Real  # [m, 1], shape [7 I], pose of each instrument that the inputs ask for
    motion: Real  # [m/s, rad/s], shape [6 B], velocity and angular velocity of each body
    contact: Real  # shape [12 B], what each body feels, see `slots`
    pulse: Real  # [N·s], shape [3 B], impulse on each body within the step
    unit_x: Real  # [1], shape [S where a spring is damped or a step is implicit, else 0], direction of a spring
    unit_y: Real  # [1], shape as unit_x
    unit_z: Real  # [1], shape as unit_x
    solve: Real  # shape [12 V where a spring is damped or a step is implicit, else 0], vectors of a linear solve
    start: Real  # [m, m/s], shape [6 V for Runge–Kutta and implicit steps, else 0], at the beginning of a substep
    slope: (
        Real  # shape [6 V for Runge–Kutta and implicit Euler, else 0], sums of slopes, or the change of the velocities
    )
    along: Real  # [N/m], shape [S for implicit Euler, else 0], tangent stiffness along a spring
    across: Real  # [N/m], shape as along, across it
    volume_gradient: Real  # [m²], shape [3 V for implicit Euler, else 0]
    inverse_mass: Real  # [1/kg], shape [V for implicit Euler, else 0]
    loss_now: Real  # [J], shape as inverse_mass
    factor_key: Real  # shape [1 + L], substep [s] and parameters that the factor is made of; kept between calls
    factor: Real  # [1], shape [4 Y], its entries, in the place of the diagonal the inverse of that [1/kg]; kept
    half: Real  # [1/√kg], shape [D H], for each slot's row its column of D^(-1/2) L⁻¹, the root's end last; kept
    compliance: Real  # [1/kg], shape [D D], entries of the inverse matrix between the rows of two slots; kept
    right: Real  # [kg·m/s], shape [4 F + 12], right sides, x, y, z and padding of a row, and what panels lack
    unit_right: Real  # shape as right, right sides of single rows
    row_press: Real  # shape [5 F], how a row is pressed: sum of directions, and stiffness along and across [kg]
    push: Real  # [1], shape [9 F], directions in which touched rows are pressed
    push_stiffness: Real  # [kg], shape [3 F]
    push_size: Real  # [kg·m/s], shape [3 F]
    push_matrix: Real  # [1/kg], shape [9 D D]
    active_wa: Real  # [1], shape [E], areal coordinates of a pressed point
    active_wb: Real  # [1], shape [E]
    active_wc: Real  # [1], shape [E]
    active_x: Real  # [1], shape [E], direction of its push
    active_y: Real  # [1], shape [E]
    active_z: Real  # [1], shape [E]
    active_normal: Real  # [kg or N·s/m], shape [E], see `contact.note`
    active_tangential: Real  # [kg or N], shape [E]
    active_fx: Real  # [N], shape [E], force of its damper and its friction
    active_fy: Real  # [N], shape [E]
    active_fz: Real  # [N], shape [E]
    active_tx: Real  # [1], shape [E], its velocity of sliding over the root of the friction law
    active_ty: Real  # [1], shape [E]
    active_tz: Real  # [1], shape [E]
    active_axial: Real  # [N·s/m], shape [E], slope of its force along its direction, less that across it
    active_across: Real  # [N·s/m], shape [E], slope of its force across its direction
    active_arm_x: Real  # [m], shape [E], from the origin of the body frame
    active_arm_y: Real  # [m], shape [E]
    active_arm_z: Real  # [m], shape [E]


Bundle = TypeVar("Bundle", Model, State, Scratch)


@cache  # numba asks for every field that a kernel reads, and evaluating the hints takes milliseconds
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
