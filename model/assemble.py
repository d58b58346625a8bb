"""From a scene to flat arrays: tissues and bodies joined, contacts, holds, probes, state and room to work in."""

from itertools import pairwise
from typing import Any

import numpy as np

from tissue_contact import fields, geometry
from tissue_contact.assembly import Assembly, start_values
from tissue_contact.blocks import Blocks, blocks_of
from tissue_contact.bodies import Body, body_of, polytopes, spacing_of
from tissue_contact.elimination import WIDTH, Elimination, elimination
from tissue_contact.errors import InputError
from tissue_contact.geometry import FloatArray, IntArray
from tissue_contact.kernels import slots
from tissue_contact.kernels.collision import BODIES, FIELD, LITERAL, POLYTOPE, PRIMITIVE
from tissue_contact.kernels.laws import HUNT_CROSSLEY, KELVIN_VOIGT
from tissue_contact.kernels.layout import Model, Scratch, State, pack
from tissue_contact.kernels.occupancy import ANYWHERE, WORD
from tissue_contact.kernels.stability import (
    EXPLICIT_EULER,
    IMPLICIT_EULER,
    PROJECTIVE_DYNAMICS,
    RUNGE_KUTTA_4,
    SYMPLECTIC_EULER,
)
from tissue_contact.scene import Scene
from tissue_contact.sheets import Sheet, sheet_of
from tissue_contact.surfaces import touched_edge
from tissue_contact.table import Sizes, graspers_of, variable_table

RESPONSES = {
    "oobb": POLYTOPE, "kdop": POLYTOPE, "hull": POLYTOPE, "oobb_literal": LITERAL, "primitive": PRIMITIVE,
    "distance_field": FIELD,
}  # fmt: skip
LAWS = {"kelvin_voigt": KELVIN_VOIGT, "hunt_crossley": HUNT_CROSSLEY}
INTEGRATORS = {
    "symplectic_euler": SYMPLECTIC_EULER, "explicit_euler": EXPLICIT_EULER, "implicit_euler": IMPLICIT_EULER,
    "runge_kutta_4": RUNGE_KUTTA_4, "projective_dynamics": PROJECTIVE_DYNAMICS,
}  # fmt: skip

KEPT_ROWS = 96  # pressed vertices whose compliances projective dynamics keeps, for a dense solve: 0.7 MB of matrices
POINTS_OF_PAIR = 64  # pressed points of all contacts for every pair of solver.max_pairs: 8 MB at its default


def assemble(scene: Scene) -> Assembly:
    """Arrays and variables of a scene.

    Raises
    ------
    InputError
        A surface that cannot be used, a tissue that nothing holds in place, a scheme that is never stable, points
        nearer to each other than the mesh allows.
    """
    _check_scheme(scene)
    bodies = [body_of(body, scene) for body in scene.bodies]
    sheets = [sheet_of(tissue, scene, _spacing(scene, tissue.name, bodies)) for tissue in scene.tissue]
    _check_spacing(scene, sheets, bodies)
    sizes, variables = Sizes(scene), variable_table(scene)
    model = _model(scene, sheets, bodies)
    packed_model, packed_state = pack(model), pack(_state(scene, model, sizes))
    packed_scratch = pack(_scratch(scene, model, sizes.parameters))
    return Assembly(
        scene.name,
        scene.description,
        *packed_model,
        *packed_state,
        *packed_scratch,
        parameters=_parameters(scene, sizes, variables),
        inputs=start_values(sizes.inputs, variables, "inputs"),
        outputs=np.zeros(sizes.outputs),
        variables=variables,
        start_time=0.0,
        stop_time=scene.solver.stop_time,
        step_size=scene.solver.step,
        source=scene.source,
    )


def _check_scheme(scene: Scene) -> None:
    """Refuse a scheme for tissues that it is never stable for, or that it does not know."""
    place, scheme = f"{scene.place}, solver.integrator", scene.solver.integrator
    for tissue in scene.tissue:
        damped = tissue.drag + tissue.support_damping > 0.0
        if scheme == "explicit_euler" and scene.solver.substeps == 0 and not damped:
            raise InputError(
                place,
                "explicit_euler is stable only where every motion is damped",
                f"neither drag nor support_damping of tissue {tissue.name}",
                "Give one of them, fix solver.substeps, or take symplectic_euler",
            )
        if scheme == "projective_dynamics" and tissue.beyond_springs:
            raise InputError(
                place,
                "the constant matrix of projective_dynamics knows no other forces in the tissue than linear springs",
                f"{tissue.beyond_springs[0]} of tissue {tissue.name}",
                "Remove it, or take implicit_euler",
            )


def _check_spacing(scene: Scene, sheets: list[Sheet], bodies: list[Body]) -> None:
    """Refuse a spacing that the points of a mesh cannot have."""
    things = (*scene.tissue, *scene.bodies)
    surfaces = [sheet.surface for sheet in sheets] + [body.surface for body in bodies]
    longest = {thing.name: touched_edge(thing, surface) for thing, surface in zip(things, surfaces, strict=True)}
    for contact in scene.contact:
        spacing, edge = contact.quadrature_spacing, longest[contact.between[0]]
        if spacing is not None and spacing * fields.CUTS_MAX < edge * (1.0 - 1e-9):  # a mesh rounds its edges
            raise InputError(
                f"{scene.place}, contact[{contact.name}].quadrature_spacing",
                f"points at which depth is read cut an edge of a triangle in {fields.CUTS_MAX} at most",
                f"{spacing:g} m for {contact.between[0]}, which has an edge of {edge:.3g} m",
                # a little more, for the digits that are left out
                f"Give {1.006 * edge / fields.CUTS_MAX:.3g} or more, or refine the mesh",
            )


def _spacing(scene: Scene, tissue: str, bodies: list[Body]) -> float | None:
    """Spacing of the points of a tissue [m]: the least that a contact asks for; None where no field reads it."""
    asked = [
        spacing_of([c], bodies[_body_index(scene, c.between[1])].thickness)
        for c in scene.contact
        if c.is_field and c.between[0] == tissue
    ]
    return min(asked, default=None)


def _body_index(scene: Scene, name: str) -> int:
    return [b.name for b in scene.bodies].index(name)


def _starts(counts: list[int]) -> Any:  # signed, to count with; the Model takes it unsigned
    return np.concatenate([[0], np.cumsum(counts, dtype=np.int64)]).astype(np.int32)


def _joined(arrays: list[Any]) -> Any:
    return np.concatenate(arrays) if arrays else np.empty(0)


def _shifted(arrays: list[Any], starts: IntArray) -> Any:
    """Indices of several objects joined into indices of all of them."""
    return _joined([a + s for a, s in zip(arrays, starts, strict=False)])


def _model(scene: Scene, sheets: list[Sheet], bodies: list[Body]) -> Model:
    vertex_start = _starts([len(s.area) for s in sheets])
    triangle_start = _starts([len(s.surface.triangles) for s in sheets])
    triangles = _shifted([s.surface.triangles for s in sheets], vertex_start).reshape(-1, 3)
    springs = _shifted([s.springs for s in sheets], vertex_start).reshape(-1, 2)
    vertices = _joined([s.surface.vertices for s in sheets]).reshape(-1, 3)
    area, free = _joined([s.area for s in sheets]), _joined([s.free for s in sheets])
    point_weight = _joined([s.point_weight for s in sheets]).reshape(-1, 3)
    point_counts = [n for s in sheets for n in np.diff(s.point_start)]
    resists_area = any(t.area_stiffness > 0.0 for t in scene.tissue)
    resists = resists_area or any(t.volume_stiffness > 0.0 for t in scene.tissue)
    body_start = _starts([len(b.searched.vertices) for b in bodies])
    body_triangles = _shifted([b.searched.triangles for b in bodies], body_start).reshape(-1, 3)
    body_vertices = _joined([b.searched.vertices for b in bodies]).reshape(-1, 3)
    part_start = _starts([len(b.half) for b in bodies])
    body_triangle_start = _starts([len(b.searched.triangles) for b in bodies])
    entry_start = _starts([len(b.grid.triangle) for b in bodies])
    part_fields = [f for b in bodies for f in b.field]
    samples = _joined([b.sample for b in bodies]).reshape(-1, 3)
    probe_triangle, probe_weight = _probes(scene, sheets, triangle_start)
    contacts = _contacts(scene, sheets, bodies)
    return Model(
        **contacts,
        **_blocks(scene, sheets, vertex_start, triangle_start),
        **_factor(elimination(springs, free) if scene.solver.integrator == "projective_dynamics" else None),
        **_holds(scene, vertex_start),
        tissue_vertex_start=vertex_start,
        tissue_spring_start=_starts([len(s.springs) for s in sheets]),
        tissue_triangle_start=triangle_start,
        spring_i=springs[:, 0],
        spring_j=springs[:, 1],
        triangle_a=triangles[:, 0],
        triangle_b=triangles[:, 1],
        triangle_c=triangles[:, 2],
        triangle_point_start=_starts(point_counts) if len(point_weight) else _joined([]),
        instruments=np.array([len(scene.instrument)]),
        body_part_start=part_start,
        body_triangle_start=body_triangle_start,
        body_sample_start=_starts([len(b.sample) for b in bodies]),
        body_a=body_triangles[:, 0],
        body_b=body_triangles[:, 1],
        body_c=body_triangles[:, 2],
        body_part=_shifted([b.searched.part for b in bodies], part_start),
        grid_size=_joined([b.grid.size for b in bodies]),
        grid_occupied=np.array([np.count_nonzero(np.diff(b.grid.start)) for b in bodies]),
        grid_cell_start=_starts([len(b.grid.start) for b in bodies]),
        cell_start=_shifted([b.grid.start for b in bodies], entry_start),
        cell_triangle=_shifted([b.grid.triangle for b in bodies], body_triangle_start),
        part_field=np.array([f.kind for f in part_fields]),
        field_start=_starts([f.values.size for f in part_fields]),
        field_size=_joined([f.size for f in part_fields]),
        probe_triangle=probe_triangle,
        integrator=np.array([INTEGRATORS[scene.solver.integrator]]),
        iterations=np.array([scene.solver.iterations]),
        continuous=np.array([scene.solver.detection == "continuous"]),
        substeps_fixed=np.array([scene.solver.substeps]),
        substeps_max=np.array([scene.solver.max_substeps]),
        rest_x=vertices[:, 0],
        rest_y=vertices[:, 1],
        rest_z=vertices[:, 2],
        node_area=area,
        node_free=free,
        node_mobility=free / area,
        spring_rest=_joined([s.rest for s in sheets]),
        spring_stiffness=_joined([s.stiffness for s in sheets]),
        spring_damping=np.repeat([t.damping for t in scene.tissue], [len(s.springs) for s in sheets]),
        rest_area=_joined([s.triangle_area for s in sheets]) if resists_area else np.empty(0),
        rest_edges=_joined([s.triangle_edges for s in sheets]) if resists else np.empty(0),
        tissue_rate=np.array([s.rate for s in sheets]),
        tissue_damping_rate=np.array([s.damping_rate for s in sheets]),
        tissue_area_rate=np.array([s.area_rate for s in sheets]),
        tissue_volume_rate=np.array([s.volume_rate for s in sheets]),
        tissue_volume_bend=np.array([s.volume_bend for s in sheets]),
        tissue_volume=np.array([s.volume for s in sheets]),
        tissue_node_area_min=np.array([s.area[s.free > 0].min(initial=s.area.max()) for s in sheets]),
        point_a=point_weight[:, 0],
        point_b=point_weight[:, 1],
        point_c=point_weight[:, 2],
        point_area=_joined([s.point_area for s in sheets]),
        gravity=np.array(scene.solver.gravity),
        body_x=body_vertices[:, 0],
        body_y=body_vertices[:, 1],
        body_z=body_vertices[:, 2],
        body_triangle_low=_joined([b.triangle_low.ravel() for b in bodies]),
        body_triangle_high=_joined([b.triangle_high.ravel() for b in bodies]),
        body_low=_joined([b.low for b in bodies]),
        body_high=_joined([b.high for b in bodies]),
        body_radius=np.array([b.radius for b in bodies]),
        part_centre=_joined([b.centre.ravel() for b in bodies]),
        part_axes=_joined([b.axes.ravel() for b in bodies]),
        part_half=_joined([b.half.ravel() for b in bodies]),
        part_axis=_joined([b.axis.ravel() for b in bodies]),
        part_reach=_joined([b.reach for b in bodies]),
        grid_low=_joined([b.grid.low for b in bodies]),
        grid_cell=np.array([b.grid.cell for b in bodies]),
        field_value=_joined([f.values for f in part_fields]),
        field_low=_joined([f.low for f in part_fields]),
        field_spacing=np.array([f.spacing for f in part_fields]),
        sample_x=samples[:, 0],
        sample_y=samples[:, 1],
        sample_z=samples[:, 2],
        sample_area=_joined([b.sample_area for b in bodies]),
        probe_weight=probe_weight.ravel(),
        step=np.array([scene.solver.step]),
        safety=np.array([scene.solver.safety]),
        detection_period=np.array([scene.detection_period]),
        energy_gain=np.array([scene.solver.energy_gain]),
        tolerance=np.array([scene.solver.tolerance]),
        motion_limit=np.array([scene.solver.motion_limit]),
    )


def _factor(found: Elimination | None) -> dict[str, Any]:
    """Fields factor_ of the Model; empty where nothing is eliminated."""
    return {f"factor_{name}": _joined([]) if found is None else getattr(found, name) for name in Elimination._fields}


def _blocks(scene: Scene, sheets: list[Sheet], vertex_start: IntArray, triangle_start: IntArray) -> dict[str, Any]:
    """The arrays of the blocks, of tissues that a contact looks at: fields block_ of the Model."""
    asked = {c.between[0] for c in scene.contact}
    found = [
        blocks_of(sheet.surface.vertices, sheet.surface.triangles) if tissue.name in asked else Blocks([], [], [])
        for tissue, sheet in zip(scene.tissue, sheets, strict=True)
    ]
    triangles = [part + start for b, start in zip(found, triangle_start, strict=False) for part in b.triangles]
    vertices = [part + start for b, start in zip(found, vertex_start, strict=False) for part in b.vertices]
    return {
        "tissue_block_start": _starts([len(b.triangles) for b in found]),
        "block_triangle_start": _starts([len(part) for part in triangles]),
        "block_triangle": _joined(triangles),
        "block_vertex_start": _starts([len(part) for part in vertices]),
        "block_vertex": _joined(vertices),
        "block_middle": _shifted([np.array(b.middles, np.intp) for b in found], vertex_start),
    }


def _contacts(scene: Scene, sheets: list[Sheet], bodies: list[Body]) -> dict[str, Any]:
    """The arrays of the contacts: fields contact_ and hull_ of the Model."""
    tissues = [t.name for t in scene.tissue]
    found = scene.contact
    tissue = [tissues.index(c.between[0]) if c.between[0] in tissues else 0 for c in found]
    between_bodies = [c.between[0] not in tissues for c in found]
    body = [_body_index(scene, c.between[1]) for c in found]
    other = [_body_index(scene, c.between[0]) if b else 0 for c, b in zip(found, between_bodies, strict=True)]
    of_tissue = [0 if b else len(sheets[t].surface.triangles) for t, b in zip(tissue, between_bodies, strict=True)]
    near = [len(bodies[o].sample) if b else n for o, b, n in zip(other, between_bodies, of_tissue, strict=True)]
    hulls = [polytopes(c, bodies[b]) for c, b in zip(found, body, strict=True)]
    flat = [h for made in hulls for h in made]
    hull_start = _starts([len(h.vertices) for h in flat])
    hull = _joined([h.vertices for h in flat]).reshape(-1, 3)
    neighbours = [n + start for h, start in zip(flat, hull_start, strict=False) for n in h.neighbours]
    return {
        "contact_tissue": np.array(tissue),
        "contact_body": np.array(body),
        "contact_other": np.array(other),
        "contact_response": np.array(
            [BODIES if b else RESPONSES[c.response] for c, b in zip(found, between_bodies, strict=True)]
        ),
        "contact_law": np.array([LAWS[c.law] for c in found]),
        "contact_both": np.array([c.side == "both" for c in found]),
        "contact_weighted": np.array([c.pair_weight != "none" for c in found]),
        "contact_side_start": _starts(of_tissue),
        "contact_touch_start": _starts([0 if c.is_field else scene.solver.max_pairs for c in found]),
        "contact_near_start": _starts(near),
        "contact_hull": _starts([len(made) for made in hulls])[:-1],
        "hull_start": hull_start,
        "hull_edge_start": _starts([len(n) for n in neighbours]),
        "hull_neighbour": _joined(neighbours),
        "hull_x": hull[:, 0],
        "hull_y": hull[:, 1],
        "hull_z": hull[:, 2],
        "contact_reach": np.array(
            [
                min(bodies[k].thickness, bodies[o].thickness) if b else bodies[k].thickness
                for k, o, b in zip(body, other, between_bodies, strict=True)
            ]
        ),
        "contact_depth": np.array([float(bodies[k].reach.max()) for k in body]),
        "contact_slip_speed": np.array([c.slip_speed for c in found]),
    }


def _holds(scene: Scene, vertex_start: Any) -> dict[str, Any]:
    """The arrays of the holds, one for every grasper and tissue that are in contact: fields grasp_ of the Model."""
    graspers, tissues = graspers_of(scene), [t.name for t in scene.tissue]
    pairs = [
        (grasper, grasper.grasp, tissues.index(c.between[0]))
        for grasper in graspers
        for c in scene.contact
        if c.between[1] == grasper.name and c.between[0] in tissues and grasper.grasp is not None
    ]
    grasps = [grasp for _, grasp, _ in pairs]
    return {
        "grasp_body": np.array([_body_index(scene, grasper.name) for grasper, _, _ in pairs]),
        "grasp_tissue": np.array([t for _, _, t in pairs]),
        "grasp_grasper": np.array([graspers.index(grasper) for grasper, _, _ in pairs]),
        "grasp_start": _starts([int(vertex_start[t + 1] - vertex_start[t]) for _, _, t in pairs]),
        "grasp_centre": _joined([grasp.centre for grasp in grasps]),
        "grasp_radius": np.array([grasp.radius for grasp in grasps]),
        "grasp_close": np.array([grasp.close_below for grasp in grasps]),
        "grasp_open": np.array([grasp.open_above for grasp in grasps]),
    }


def _probes(scene: Scene, sheets: list[Sheet], starts: IntArray) -> tuple[Any, FloatArray]:
    """Triangle of every probe, counted over all the tissues, and its areal coordinates there."""
    found = [
        geometry.nearest_place(sheet.surface, tissue.probes) for tissue, sheet in zip(scene.tissue, sheets, strict=True)
    ]
    return _shifted([f[0] for f in found], starts), _joined([f[1] for f in found])


def _state(scene: Scene, model: Model, sizes: Sizes) -> State:
    contacts, holds = len(scene.contact), len(model.grasp_body)
    pose = [[*i.start_position, *i.start_orientation] for i in scene.instrument]
    pose += [[*r.position, *r.rotation] for r in scene.rigid]
    touches, vertices = int(model.contact_touch_start[-1]), len(model.rest_x)
    each = {
        **dict.fromkeys(("pairs", "rejected", "touches", "regions", "near_count", "touch_load", "deepest"), contacts),
        **dict.fromkeys(("since_detection", "dissipated", "work", "stored", "energy_start", "moved"), 1),
        **dict.fromkeys(("put_in", "gained", "returned", "found", "resolved"), 1),
        **dict.fromkeys(("crush", "tissue_speed"), len(scene.tissue)),
        **dict.fromkeys(("closed", "held", "held_area"), holds),
        "side": model.contact_side_start[-1],
        "near": model.contact_near_start[-1],
        "tuned": sizes.parameters,
    }
    start = {"x": model.rest_x, "y": model.rest_y, "z": model.rest_z, "pose": np.array(pose).ravel()}
    blocks = len(model.block_middle)
    start["block_reach"] = np.full(blocks, ANYWHERE)
    start["tissue_way"] = np.full(len(scene.tissue), ANYWHERE)
    for name in State._fields:
        if name not in start:
            groups = {"touch_": touches, "anchor_": int(model.grasp_start[-1]), "block_": blocks}
            size = next((n for prefix, n in groups.items() if name.startswith(prefix)), vertices)
            start[name] = np.zeros(each.get(name, size))
    return State(**start)


def _scratch(scene: Scene, model: Model, parameters: int) -> Scratch:
    bodies, vertices, springs = len(model.body_radius), len(model.rest_x), len(model.spring_i)
    triangles = len(model.block_triangle)
    capacity = max((end - begin for begin, end in pairwise(model.contact_touch_start)), default=0)
    cells = max((end - begin - 1 for begin, end in pairwise(model.grid_cell_start)), default=0)
    scheme = scene.solver.integrator
    symplectic, implicit = scheme == "symplectic_euler", scheme == "implicit_euler"
    projective, stages = scheme == "projective_dynamics", scheme == "runge_kutta_4"
    split = symplectic or (projective and scene.solver.motion_limit > 0.0)
    solved = implicit or projective or any(tissue.damping > 0.0 for tissue in scene.tissue)
    # every touch, every point of every tissue for each of its contacts, every anchor, as far as that is not absurd
    points = len(model.point_area) * len(scene.contact) + len(scene.contact) * capacity + int(model.grasp_start[-1])
    points = min(points, POINTS_OF_PAIR * scene.solver.max_pairs) if implicit or projective or symplectic else 0
    rows, panels = len(model.factor_vertex), len(model.factor_start) - 1 if projective else 0
    kept = min(rows, KEPT_ROWS)
    sizes = {
        "cells": 3,
        "cell_stamp": cells,
        "active": 1,
        "detail": 2,
        "expansion": 256,
        **dict.fromkeys(("point_distance", "point_x", "point_y", "point_z"), fields.CUTS_MAX**2),
        "block_outcode": len(model.block_middle),
        "marks": -(-triangles // WORD),
        "candidate": triangles,
        "touching": int(model.contact_near_start[-1]),
        "vertex_share": vertices if capacity else 0,
        "corner": vertices if split and scene.contact else 0,
        "damping": 23 * vertices if split and scene.contact else 0,
        "pose": slots.POSE * len(scene.instrument),
        "motion": 6 * bodies,
        "contact": slots.GATHER * bodies,
        "pulse": 3 * bodies,
        "solve": 12 * vertices if solved else 0,
        **dict.fromkeys(("stamp", "hit"), len(model.body_a)),
        "start": 6 * vertices if implicit or projective or stages else 0,
        "slope": 6 * vertices if implicit or stages else 0,
        **dict.fromkeys(("unit_x", "unit_y", "unit_z"), springs if solved else 0),
        **dict.fromkeys(("along", "across"), springs if implicit else 0),
        **dict.fromkeys(("inverse_mass", "loss_now"), vertices if implicit else 0),
        "volume_gradient": 3 * vertices if implicit else 0,
        "factor_key": 1 + parameters if projective else 0,
        "factor": WIDTH * len(model.factor_row),
        **dict.fromkeys(("path", "path_panel"), panels),
        **dict.fromkeys(("touched", "touched_mark", "row_slot"), rows),
        **dict.fromkeys(("right", "unit_right"), 4 * (rows + WIDTH - 1) if projective else 0),
        "row_press": 5 * rows,
        "touched_count": 1,
        "lane_slot": 4,
        **dict.fromkeys(("slot_row", "slot_new"), kept),
        **dict.fromkeys(("push_row", "push_stiffness", "push_size"), 3 * rows),
        "push": 9 * rows,
        "half": kept * int(model.factor_depth.max(initial=0)),
        "compliance": kept**2,
        "push_matrix": (3 * kept) ** 2,
    }
    groups = {
        "touch_": capacity, "pair_": capacity, "part_": len(model.part_reach), "active_": points,
    }  # fmt: skip
    for name in Scratch._fields:
        group = next((n for prefix, n in groups.items() if name.startswith(prefix)), vertices)
        sizes.setdefault(name, group)
    return Scratch(**{name: np.zeros(sizes[name]) for name in Scratch._fields})


def _parameters(scene: Scene, sizes: Sizes, variables: tuple[Any, ...]) -> FloatArray:
    """Start vector; what has no variable keeps the value that it has here."""
    values = start_values(sizes.parameters, variables, "parameters")
    for k in range(len(scene.contact)):
        own = sizes.contacts + slots.CONTACT_PARAMETERS * k
        if values[own + slots.CONTACT_EXPONENT] == 0.0:
            values[own + slots.CONTACT_EXPONENT] = 1.0
    return values
