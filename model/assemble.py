"""From a scene to flat arrays: springs, masses, the instruments' cells and boxes, the table of variables."""

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix, diags
from scipy.sparse.csgraph import reverse_cuthill_mckee
from scipy.sparse.linalg import eigsh

from tissue_contact import geometry
from tissue_contact.assembly import Assembly, start_values
from tissue_contact.errors import InputError
from tissue_contact.geometry import FloatArray, IntArray, Surface
from tissue_contact.kernels import slots
from tissue_contact.kernels.collision import HULL, OOBB
from tissue_contact.kernels.layout import Model, Scratch, State, pack
from tissue_contact.scene import FixedBox, Instrument, Scene, Tissue
from tissue_contact.settings import Settings, setting
from tissue_contact.surfaces import surface_of
from tissue_contact.variables import Variable

RESPONSES = {"oobb": OOBB, "hull": HULL}
CELLS_MAX = 32768  # of one instrument's grid: 128 KB of cell starts, which stay in the second-level cache
REACH_MIN = 1e-6  # [m], of the mark from a part that has no thickness


class _Sheet(NamedTuple):
    """One tissue, before it joins the others."""

    surface: Surface
    springs: IntArray  # shape [S, 2]
    stiffness: FloatArray  # [N/m], shape [S]
    area: FloatArray  # [m²], shape [V]
    free: FloatArray  # shape [V]
    rate: float  # see Model.tissue_rate


class _Body(NamedTuple):
    """One instrument, before it joins the others; see Model for the arrays."""

    surface: Surface
    centre: FloatArray
    axes: FloatArray
    half: FloatArray
    axis: FloatArray
    reach: FloatArray
    low: FloatArray  # [m], shape [3], of the grid
    cell: float
    size: IntArray  # shape [3]
    cell_start: IntArray
    cell_triangle: IntArray
    triangle_low: FloatArray
    triangle_high: FloatArray


def assemble(scene: Scene) -> Assembly:
    """Arrays and variables of a scene.

    Raises
    ------
    InputError
        A surface that cannot be used, or a tissue that nothing holds in place.
    """
    sheets = [_sheet(tissue, scene) for tissue in scene.tissue]
    bodies = [_body(instrument, scene) for instrument in scene.instrument]
    model = _model(scene, sheets, bodies)
    state = _state(scene, model)
    variables = variable_table(scene)
    packed_model, packed_state, packed_scratch = pack(model), pack(state), pack(_scratch(scene, model))
    instruments = len(scene.instrument)
    return Assembly(
        scene.name,
        scene.description,
        *packed_model,
        *packed_state,
        *packed_scratch,
        parameters=_parameters(scene, variables),
        inputs=start_values(slots.POSE * instruments, variables, "inputs"),
        outputs=np.zeros(slots.INSTRUMENT_OUTPUTS * instruments + slots.COMMON_OUTPUTS + 3 * model.probe_triangle.size),
        variables=variables,
        start_time=0.0,
        stop_time=scene.solver.stop_time,
        step_size=scene.solver.step,
        source=scene.source,
    )


# --- tissue -----------------------------------------------------------------------------------------------


def _sheet(tissue: Tissue, scene: Scene) -> _Sheet:
    surface = surface_of(tissue, scene.folder, scene.place)
    fixed = _fixed(tissue, surface, f"{scene.place}, tissue[{tissue.name}].fixed")
    order = _local_order(surface)
    surface = _renumbered(surface, order)
    area = node_areas(surface)
    springs, stiffness = _springs(tissue, surface)
    free = 1.0 - fixed[order]
    return _Sheet(surface, springs, stiffness, area, free, laplacian_rate(springs, stiffness, area, free))


def _fixed(tissue: Tissue, surface: Surface, place: str) -> FloatArray:
    """1 for the vertices that never move, numbered as in the mesh."""
    fixed = np.zeros(len(surface.vertices))
    if isinstance(tissue.fixed, FixedBox):
        low, high = np.array(tissue.fixed.box)
        fixed[((surface.vertices >= low) & (surface.vertices <= high)).all(axis=1)] = 1.0
        if not fixed.any():
            least, most = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
            raise InputError(
                place,
                "the box must hold at least one vertex of the surface",
                f"none; the surface reaches from {_point(least)} to {_point(most)} m",
                "Enlarge or move the box",
            )
    elif isinstance(tissue.fixed, tuple):
        beyond = [i for i in tissue.fixed if i >= len(fixed)]
        if beyond:
            raise InputError(
                place, "a vertex index must be below the number of vertices", f"{beyond[0]}",
                f"The surface has {len(fixed)} vertices, numbered from 0",
            )  # fmt: skip
        fixed[list(tissue.fixed)] = 1.0
    elif tissue.fixed == "boundary":
        fixed[geometry.boundary_vertices(surface)] = 1.0
        if not fixed.any() and tissue.support_stiffness == 0.0:
            raise InputError(
                place,
                "something must hold the tissue in place",
                "a closed surface, which has no boundary, and no support",
                "Give support_stiffness, fix a box of vertices with fixed = {box = [[…], […]]}, "
                'or let it float with fixed = "none"',
            )
    return fixed


def _point(p: FloatArray) -> str:
    return f"[{', '.join(f'{c:.4g}' for c in p)}]"


def _local_order(surface: Surface) -> IntArray:
    """Order of the vertices that keeps neighbours close together in memory, whatever order the mesh file has."""
    e = geometry.edges(surface)
    n = len(surface.vertices)
    graph = csr_matrix((np.ones(len(e)), (e[:, 0], e[:, 1])), shape=(n, n))
    return np.asarray(reverse_cuthill_mckee(graph + graph.T, symmetric_mode=True), np.int32)


def _renumbered(surface: Surface, order: IntArray) -> Surface:
    """The surface with vertex order[k] become vertex k, its triangles sorted by their least vertex."""
    new = np.empty(len(order), np.int32)
    new[order] = np.arange(len(order))
    triangles = new[surface.triangles]
    triangles = triangles[np.lexsort((triangles.max(axis=1), triangles.min(axis=1)))]
    return Surface(surface.vertices[order], triangles)


def node_areas(surface: Surface) -> FloatArray:
    """Area of every vertex [m²], one third of its triangles."""
    areas = geometry.triangle_areas(surface)
    sums = np.bincount(surface.triangles.ravel(), np.repeat(areas / 3.0, 3), minlength=len(surface.vertices))
    return np.asarray(sums, np.float64)


def _springs(tissue: Tissue, surface: Surface) -> tuple[IntArray, FloatArray]:
    """Structural and bending springs with their stiffness [N/m].

    From Young's modulus E and thickness t: k = E t (sum of the adjacent areas) / l² (van Gelder 1998), which is
    approximate by its author's own statement.
    """
    structural = geometry.edges(surface)
    if tissue.stiffness is not None:
        stiffness = np.full(len(structural), tissue.stiffness)
    else:
        assert tissue.youngs_modulus is not None and tissue.thickness is not None  # the scene holds one of the two
        stiffness = tissue.youngs_modulus * tissue.thickness * _edge_areas(surface, structural)
        stiffness /= (np.diff(surface.vertices[structural], axis=1) ** 2).sum(axis=2).ravel()
    if tissue.bending_stiffness == 0.0:
        return structural, stiffness
    bending = np.sort(geometry.flaps(surface), axis=1)
    springs = np.concatenate([structural, bending])
    stiffness = np.concatenate([stiffness, np.full(len(bending), tissue.bending_stiffness)])
    order = np.lexsort((springs[:, 1], springs[:, 0]))
    return springs[order], stiffness[order]


def _edge_areas(surface: Surface, edges: IntArray) -> FloatArray:
    """Sum of the areas of the triangles at every edge [m²]."""
    n = len(surface.vertices)
    t = surface.triangles
    sides = np.sort(np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]]), axis=1)
    areas = coo_matrix((np.tile(geometry.triangle_areas(surface), 3), (sides[:, 0], sides[:, 1])), shape=(n, n))
    return np.asarray(areas.tocsr()[edges[:, 0], edges[:, 1]]).ravel()


def laplacian_rate(springs: IntArray, stiffness: FloatArray, area: FloatArray, free: FloatArray) -> float:
    """Largest eigenvalue of the springs' Laplacian over the vertex areas, fixed vertices held [N/m/m²].

    Over the areal density it bounds every squared frequency of the mesh, however deformed: the tangent stiffness of
    a linear spring is never more than k in any direction. Rounded up to three digits, so that a model does not
    depend on the last bits of a linear algebra library.
    """
    kept = np.flatnonzero(free)
    if kept.size == 0 or len(springs) == 0:
        return 0.0
    n = len(area)
    i, j = springs.T
    laplacian = coo_matrix(
        (
            np.concatenate([stiffness, stiffness, -stiffness, -stiffness]),
            (np.concatenate([i, j, i, j]), np.concatenate([i, j, j, i])),
        ),
        shape=(n, n),
    ).tocsr()[kept][:, kept]
    scale = diags(1.0 / np.sqrt(area[kept]))
    matrix = scale @ laplacian @ scale
    if kept.size <= 64:
        rate = float(np.linalg.eigvalsh(matrix.toarray())[-1])
    else:
        # Lanczos approaches from below; its tolerance is added.
        start = np.random.default_rng(0).standard_normal(kept.size)
        rate = float(eigsh(matrix, 1, which="LA", v0=start, tol=1e-3, return_eigenvectors=False)[0]) * 1.001
    unit = 10.0 ** (np.floor(np.log10(rate)) - 2)
    return float(np.ceil(rate / unit) * unit)


# --- instruments ------------------------------------------------------------------------------------------


def _body(instrument: Instrument, scene: Scene) -> _Body:
    surface = surface_of(instrument, scene.folder, scene.place)
    boxes = [
        geometry.oriented_box(surface.vertices[np.unique(surface.triangles[surface.part == part])])
        for part in range(surface.part.max() + 1)
    ]
    centre, axes, half = (np.array(column) for column in zip(*boxes, strict=True))
    axis = np.array([_shaft_axis(surface, part, *box) for part, box in enumerate(boxes)])
    reach = np.maximum(half.min(axis=1), REACH_MIN)
    for a, r in zip(axis, reach, strict=True):
        if np.linalg.norm(a[1] - a[0]) < REACH_MIN:  # as long as wide: the handle is towards +z
            a[1] = a[0] + [0.0, 0.0, r]
    corners = surface.vertices[surface.triangles]
    low, high = corners.min(axis=1), corners.max(axis=1)
    return _Body(surface, centre, axes, half, axis, reach, *_grid(surface, low, high), low, high)


def _shaft_axis(surface: Surface, part: int, centre: FloatArray, axes: FloatArray, half: FloatArray) -> FloatArray:
    """Tip end and handle end of a part's axis, shape [2, 3]; the handle is away from the body frame's origin."""
    if surface.axes is not None:
        return surface.axes[part].copy()
    long = int(np.argmax(half))
    d = (half[long] - half.min()) * axes[long]
    ends = np.array([centre - d, centre + d])
    return ends if np.linalg.norm(ends[0]) <= np.linalg.norm(ends[1]) else ends[::-1].copy()


def _grid(
    surface: Surface, low: FloatArray, high: FloatArray
) -> tuple[FloatArray, float, IntArray, IntArray, IntArray]:
    """Cells of an instrument in its body frame, and the triangles whose boxes touch each."""
    least, extent = low.min(axis=0), high.max(axis=0) - low.min(axis=0)
    cell = max(float(np.median((high - low).max(axis=1))), extent.max() / 256, 1e-6)
    while (size := np.floor(extent / cell).astype(np.int32) + 1).prod() > CELLS_MAX:
        cell *= 1.1
    # The same expression as in the kernel, so that boxes that overlap share a cell whatever the rounding.
    first = np.minimum((low - least) / cell, size - 1).astype(np.int32)
    last = np.minimum((high - least) / cell, size - 1).astype(np.int32)
    entries = [
        ((ix * size[1] + iy) * size[2] + iz, u)
        for u in range(len(surface.triangles))
        for ix in range(first[u, 0], last[u, 0] + 1)
        for iy in range(first[u, 1], last[u, 1] + 1)
        for iz in range(first[u, 2], last[u, 2] + 1)
    ]
    cells, triangles = np.array(sorted(entries), np.int64).T
    start = np.searchsorted(cells, np.arange(size.prod() + 1))
    return least, cell, size, start.astype(np.int32), triangles.astype(np.int32)


# --- model, state, scratch --------------------------------------------------------------------------------


def _starts(counts: list[int]) -> Any:  # signed, to count with; the Model takes it unsigned
    return np.concatenate([[0], np.cumsum(counts, dtype=np.int64)]).astype(np.int32)


def _joined(arrays: list[Any]) -> Any:
    return np.concatenate(arrays) if arrays else np.empty(0)


def _shifted(arrays: list[Any], starts: IntArray) -> Any:
    """Indices of several objects joined into indices of all of them."""
    return _joined([a + s for a, s in zip(arrays, starts, strict=False)])


def _model(scene: Scene, sheets: list[_Sheet], bodies: list[_Body]) -> Model:
    vertex_start = _starts([len(s.area) for s in sheets])
    triangles = _shifted([s.surface.triangles for s in sheets], vertex_start)
    springs = _shifted([s.springs for s in sheets], vertex_start)
    vertices = _joined([s.surface.vertices for s in sheets])
    area, free = _joined([s.area for s in sheets]), _joined([s.free for s in sheets])
    body_start = _starts([len(b.surface.vertices) for b in bodies])
    body_triangles = _shifted([b.surface.triangles for b in bodies], body_start).reshape(-1, 3)
    body_vertices = _joined([b.surface.vertices for b in bodies]).reshape(-1, 3)
    part_start = _starts([len(b.half) for b in bodies])
    body_triangle_start = _starts([len(b.surface.triangles) for b in bodies])
    entry_start = _starts([len(b.cell_triangle) for b in bodies])
    probe_triangle, probe_weight = _probes(scene, sheets)
    hulls = _hulls(scene, bodies)
    hull_start = _starts([len(h.vertices) for h in hulls])
    hull = _joined([h.vertices for h in hulls]).reshape(-1, 3)
    neighbours = [n + start for h, start in zip(hulls, hull_start, strict=False) for n in h.neighbours]
    names = {"tissue": [t.name for t in scene.tissue], "instrument": [i.name for i in scene.instrument]}
    contact_tissue = [names["tissue"].index(c.tissue) for c in scene.contact]
    return Model(
        tissue_vertex_start=vertex_start,
        tissue_spring_start=_starts([len(s.springs) for s in sheets]),
        tissue_triangle_start=_starts([len(s.surface.triangles) for s in sheets]),
        spring_i=springs[:, 0],
        spring_j=springs[:, 1],
        triangle_a=triangles[:, 0],
        triangle_b=triangles[:, 1],
        triangle_c=triangles[:, 2],
        instrument_part_start=part_start,
        instrument_triangle_start=body_triangle_start,
        instrument_a=body_triangles[:, 0],
        instrument_b=body_triangles[:, 1],
        instrument_c=body_triangles[:, 2],
        instrument_part=_shifted([b.surface.part for b in bodies], part_start),
        grid_size=_joined([b.size for b in bodies]),
        grid_occupied=np.array([np.count_nonzero(np.diff(b.cell_start)) for b in bodies]),
        grid_cell_start=_starts([len(b.cell_start) for b in bodies]),
        cell_start=_shifted([b.cell_start for b in bodies], entry_start),
        cell_triangle=_shifted([b.cell_triangle for b in bodies], body_triangle_start),
        contact_tissue=np.array(contact_tissue),
        contact_instrument=np.array([names["instrument"].index(c.instrument) for c in scene.contact]),
        contact_response=np.array([RESPONSES[c.response] for c in scene.contact]),
        contact_weighted=np.array([c.pair_weight != "none" for c in scene.contact]),
        contact_side_start=_starts([len(sheets[t].surface.triangles) for t in contact_tissue]),
        hull_start=hull_start,
        hull_edge_start=_starts([len(n) for n in neighbours]),
        hull_neighbour=_joined(neighbours),
        probe_triangle=probe_triangle,
        substeps_fixed=np.array([scene.solver.substeps]),
        substeps_max=np.array([scene.solver.max_substeps]),
        rest_x=vertices[:, 0],
        rest_y=vertices[:, 1],
        rest_z=vertices[:, 2],
        node_area=area,
        node_free=free,
        node_mobility=free / area,
        spring_rest=np.linalg.norm(vertices[springs[:, 1]] - vertices[springs[:, 0]], axis=1),
        spring_stiffness=_joined([s.stiffness for s in sheets]),
        spring_damping=np.repeat([t.damping for t in scene.tissue], [len(s.springs) for s in sheets]),
        tissue_rate=np.array([s.rate for s in sheets]),
        tissue_node_area_min=np.array([s.area[s.free > 0].min(initial=s.area.max()) for s in sheets]),
        gravity=np.array(scene.solver.gravity),
        instrument_x=body_vertices[:, 0],
        instrument_y=body_vertices[:, 1],
        instrument_z=body_vertices[:, 2],
        instrument_low=_joined([b.triangle_low.ravel() for b in bodies]),
        instrument_high=_joined([b.triangle_high.ravel() for b in bodies]),
        part_centre=_joined([b.centre.ravel() for b in bodies]),
        part_axes=_joined([b.axes.ravel() for b in bodies]),
        part_half=_joined([b.half.ravel() for b in bodies]),
        hull_x=hull[:, 0],
        hull_y=hull[:, 1],
        hull_z=hull[:, 2],
        part_axis=_joined([b.axis.ravel() for b in bodies]),
        part_reach=_joined([b.reach for b in bodies]),
        grid_low=_joined([b.low for b in bodies]),
        grid_cell=np.array([b.cell for b in bodies]),
        probe_weight=probe_weight.ravel(),
        safety=np.array([scene.solver.safety]),
        detection_period=np.array([scene.solver.detection_period]),
    )


def _probes(scene: Scene, sheets: list[_Sheet]) -> tuple[Any, FloatArray]:
    """Triangle of every probe, counted over all the tissues, and its areal coordinates there."""
    starts = _starts([len(s.surface.triangles) for s in sheets])
    found = [
        geometry.nearest_place(sheet.surface, tissue.probes) for tissue, sheet in zip(scene.tissue, sheets, strict=True)
    ]
    return _shifted([f[0] for f in found], starts), np.concatenate([f[1] for f in found])


def _hulls(scene: Scene, bodies: list[_Body]) -> list[geometry.Hull]:
    """Hull of every part, empty for an instrument of which no contact asks for it."""
    asked = {c.instrument for c in scene.contact if c.response == "hull"}
    return [
        geometry.convex_hull(body.surface, part) if instrument.name in asked else geometry.NO_HULL
        for instrument, body in zip(scene.instrument, bodies, strict=True)
        for part in range(len(body.half))
    ]


def _state(scene: Scene, model: Model) -> State:
    contacts = len(scene.contact)
    capacity = contacts * scene.solver.max_pairs
    pose = [[*i.start_position, *i.start_orientation] for i in scene.instrument]
    sizes = {
        **dict.fromkeys(("pairs", "rejected", "touches", "regions", "touch_load"), contacts),
        **dict.fromkeys(("since_detection", "dissipated", "work", "energy_start"), 1),
        "side": model.contact_side_start[-1],
    }
    start = {"x": model.rest_x, "y": model.rest_y, "z": model.rest_z, "pose": np.array(pose).ravel()}
    for name in State._fields:
        if name not in start:
            start[name] = np.zeros(sizes.get(name, capacity if name.startswith("touch_") else len(model.rest_x)))
    return State(**start)


def _scratch(scene: Scene, model: Model) -> Scratch:
    instruments, capacity = len(scene.instrument), scene.solver.max_pairs if scene.contact else 0
    cells = max((end - begin - 1 for begin, end in pairwise(model.grid_cell_start)), default=0)
    damped = any(tissue.damping > 0.0 for tissue in scene.tissue)
    sizes = {
        "cells": 3,
        "cell_stamp": cells,
        "detail": 2,
        "expansion": 256,
        "pose": slots.POSE * instruments,
        "motion": 6 * instruments,
        "contact": slots.GATHER * instruments,
        "pulse": 3 * instruments,
        "solve": 9 * len(model.rest_x) if damped else 0,
    }
    for name in Scratch._fields:
        if name in sizes:
            continue
        if name.startswith(("touch_", "pair_")):
            sizes[name] = capacity
        elif name.startswith("part_"):
            sizes[name] = len(model.part_reach)
        elif name.startswith("unit_"):
            sizes[name] = len(model.spring_i) if damped else 0
        elif name in ("stamp", "hit"):
            sizes[name] = len(model.instrument_a)
        else:
            sizes[name] = len(model.rest_x)
    return Scratch(**{name: np.zeros(sizes[name]) for name in Scratch._fields})


# --- variables --------------------------------------------------------------------------------------------


def _parameters(scene: Scene, variables: tuple[Variable, ...]) -> FloatArray:
    size = slots.TISSUE_PARAMETERS * len(scene.tissue) + slots.CONTACT_PARAMETERS * len(scene.contact)
    return start_values(size, variables, "parameters")


def variable_table(scene: Scene) -> tuple[Variable, ...]:
    """All the variables of a scene's FMU: inputs, parameters, outputs."""
    return (*_input_variables(scene), *_parameter_variables(scene), *_output_variables(scene))


def _vector(name: str, block: Any, slot: int, unit: str, start: Any, bound: float, description: str) -> list[Variable]:
    return [
        Variable(f"{name}[{k + 1}]", block, slot + k, unit, float(value), -bound, bound, f"{description}, {part}")
        for k, (value, part) in enumerate(zip(start, "wxyz" if len(start) == 4 else "xyz", strict=True))
    ]


def _input_variables(scene: Scene) -> list[Variable]:
    table = []
    for i, instrument in enumerate(scene.instrument):
        slot = slots.POSE * i
        position = f"origin of the body frame of {instrument.name} in the world"
        turn = f"unit quaternion of {instrument.name}, body to world; normalised inside"
        table += _vector(
            f"{instrument.name}.position", "inputs", slot, "m", instrument.start_position, np.inf, position
        )
        table += _vector(
            f"{instrument.name}.orientation", "inputs", slot + 3, "1", instrument.start_orientation, np.inf, turn
        )
    return table


def _parameter_variables(scene: Scene) -> list[Variable]:
    """Tunable constants: those that the scene declares. A range is that of the scene's own key."""
    table = []

    def add(prefix: str, name: str, slot: int, settings: Settings, key: str) -> None:
        own, start = setting(type(settings), key), getattr(settings, key)
        found = (own.unit, start, own.minimum, own.maximum, own.description)
        table.append(Variable(f"{prefix}.{name}", "parameters", slot, *found))

    for n, tissue in enumerate(scene.tissue):
        own = slots.TISSUE_PARAMETERS * n
        table.append(
            Variable(f"{tissue.name}.stiffnessScale", "parameters", own + slots.STIFFNESS_SCALE, "1", 1.0, 0.0, 1e3,
                     "factor on the stiffness of all springs")
        )  # fmt: skip
        if tissue.damping > 0.0:
            table.append(
                Variable(f"{tissue.name}.dampingScale", "parameters", own + slots.DAMPING_SCALE, "1", 1.0, 0.0, 1e3,
                         "factor on the damping of all springs")
            )  # fmt: skip
        add(tissue.name, "arealDensity", own + slots.AREAL_DENSITY, tissue, "areal_density")
        if tissue.support_stiffness > 0.0:
            add(tissue.name, "supportStiffness", own + slots.SUPPORT_STIFFNESS, tissue, "support_stiffness")
        if tissue.support_damping > 0.0:
            add(tissue.name, "supportDamping", own + slots.SUPPORT_DAMPING, tissue, "support_damping")
        if tissue.drag > 0.0:
            add(tissue.name, "drag", own + slots.DRAG, tissue, "drag")
    for k, contact in enumerate(scene.contact):
        own = slots.TISSUE_PARAMETERS * len(scene.tissue) + slots.CONTACT_PARAMETERS * k
        add(contact.name, "stiffness", own + slots.CONTACT_STIFFNESS, contact, "stiffness")
        add(contact.name, "damping", own + slots.CONTACT_DAMPING, contact, "damping")
    return table


def _output_variables(scene: Scene) -> list[Variable]:
    table: list[Variable] = []
    zero = (0.0, 0.0, 0.0)

    def scalar(name: str, slot: int, unit: str, description: str) -> None:
        table.append(Variable(name, "outputs", slot, unit, 0.0, -np.inf, np.inf, description))

    def vector(name: str, slot: int, unit: str, description: str) -> None:
        table.extend(_vector(name, "outputs", slot, unit, zero, np.inf, description))

    for i, instrument in enumerate(scene.instrument):
        name, own = instrument.name, slots.INSTRUMENT_OUTPUTS * i
        vector(f"{name}.force", own + slots.FORCE, "N", "penalty force on the instrument, world frame")
        vector(
            f"{name}.torque", own + slots.TORQUE, "N.m", "its torque about the origin of the body frame, world frame"
        )
        vector(f"{name}.meanForce", own + slots.MEAN_FORCE, "N", "impulse on the instrument over the step, by the step")
        scalar(f"{name}.depth", own + slots.DEPTH, "m", "deepest penetration")
        vector(f"{name}.contactPoint", own + slots.CONTACT_POINT, "m", "mean point of collision, weighted by force")
        scalar(f"{name}.contacts", own + slots.CONTACTS, "1", "number of contact regions")
    own = slots.INSTRUMENT_OUTPUTS * len(scene.instrument)
    scalar("energy.kinetic", own + slots.ENERGY_KINETIC, "J", "kinetic energy of the tissue")
    scalar("energy.elastic", own + slots.ENERGY_ELASTIC, "J", "energy of the springs, the support and the weight")
    scalar("energy.contact", own + slots.ENERGY_CONTACT, "J", "energy stored in the springs of the contact law")
    scalar("energy.dissipated", own + slots.ENERGY_DISSIPATED, "J", "energy taken by all the dampers so far")
    scalar("energy.work", own + slots.ENERGY_WORK, "J", "work of the instruments on the tissue so far")
    scalar("energy.balance", own + slots.ENERGY_BALANCE, "J", "work less dissipated less change of stored energy")
    scalar("solver.substeps", own + slots.SUBSTEPS, "1", "substeps of the last step")
    scalar("solver.rejectedPairs", own + slots.REJECTED_PAIRS, "1", "pairs rejected as passed through")
    scalar("solver.pairs", own + slots.PAIRS, "1", "intersecting triangle pairs that the response works on")
    own += slots.COMMON_OUTPUTS
    for tissue in scene.tissue:
        for k in range(len(tissue.probes)):
            vector(f"{tissue.name}.probe[{k + 1}].position", own, "m", "place of the probe point on the tissue")
            own += 3
    return table
