"""What may be changed of a scene to trade accuracy for time, and the finest that a scene can be.

A change is an edit of the scene file, so that what was measured and what is written afterwards are one text.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import product
from typing import Any

import numpy as np

from tissue_contact.bodies import spacing_of
from tissue_contact.edits import Edit, changed
from tissue_contact.errors import InputError
from tissue_contact.fields import CUTS_MAX
from tissue_contact.geometry import FloatArray
from tissue_contact.presets import OF_PROJECTIVE, PRESETS, Preset
from tissue_contact.scene import DETECTION_PERIOD, Contact, Graded, Instrument, Rigid, Scene, Tissue
from tissue_contact.settings import setting
from tissue_contact.surfaces import in_own_frame, surface_of, touched_edge

SAFETIES = (0.95, 0.7, 0.5, 0.25)  # of symplectic Euler, shares of its stable limit
IMPLICIT_SUBSTEPS = (1, 2, 4)
PROJECTIVE = (PRESETS["fast"], PRESETS["balanced"], *(Preset("projective_dynamics", n) for n in (2, 3, 5)))
MESH_FACTORS = (1 / 8, 1 / 4, 1 / 2, 2, 4)  # on the number of triangles
SPACING_FACTORS = (1 / 2, 2, 4)
PERIOD_FACTORS = (1 / 4, 4)
# How far a mesh stays fine around what is touched, over half of the thinnest part of what touches it, and its growth.
GRADINGS = ((2.0, 0.3), (3.0, 0.3), (3.0, 0.15))
# `oobb_literal` and the raw sum over pairs are there to compare with the thesis, not to be chosen.
RESPONSES: dict[str, dict[str, Any]] = {
    "hull": {"response": "hull"},
    "kdop 26": {"response": "kdop", "kdop": 26},
    "oobb": {"response": "oobb"},
    "primitive": {"response": "primitive"},
}
LONGEST = 1.2  # of the longest edge of a mesh, with room for that of a finer one, which is irregular anew


@dataclass(frozen=True)
class Option:
    """One setting of one lever."""

    lever: str
    label: str
    edits: tuple[Edit, ...]


Configuration = tuple[Option, ...]  # of levers that differ, in the order of `LEVERS`; the empty one is the scene itself


@dataclass(frozen=True, eq=False)
class Grounds:
    """What levers must know besides the scene, by the name of a contact.

    Parameters
    ----------
    spacing : of its points [m]
    edge : longest edge of the surface that its points lie on [m]
    half : half of the thinnest part of its bodies [m]
    area : what bears its force [m²]; only of those that `areas` can tell it of
    touched : least and greatest of the points of contact of its second body [m], shape (2, 3); where there are any
    """

    spacing: Mapping[str, float]
    edge: Mapping[str, float]
    half: Mapping[str, float]
    area: Mapping[str, float] = field(default_factory=dict)
    touched: Mapping[str, FloatArray] = field(default_factory=dict)


def grounds(scene: Scene, reach: FloatArray) -> Grounds:
    """What is known before a run; `reach` is half of the thinnest part of each contact [m]."""
    spacing, edge = {}, {}
    thin = {contact.name: float(half) for contact, half in zip(scene.contact, reach, strict=True)}
    for contact in scene.contact:
        if contact.is_field:
            first = _body(scene, contact.between[0])
            edge[contact.name] = touched_edge(first, surface_of(first, scene.folder, scene.place))
            # as fine as it is asked for, or as the mesh allows
            spacing[contact.name] = max(spacing_of([contact], thin[contact.name]), edge[contact.name] / CUTS_MAX)
    return Grounds(spacing, edge, thin)


def areas(scene: Scene, force: Mapping[str, FloatArray], depth: Mapping[str, FloatArray]) -> dict[str, float]:
    """Area [m²] that bears the force of each contact of a tissue in the field of an instrument.

    That of k A d^n = F, with k per area, at the depths d beyond half of the greatest, the median. Only for an
    instrument with one contact and no grasp, whose force is that contact's alone.

    Parameters
    ----------
    scene : Scene
    force : [N], shape (n, 3) each
        On every rigid body, by name, at the communication points of a run.
    depth : [m], shape (n,) each
    """
    found = {}
    for contact in scene.contact:
        name = contact.between[1]
        body = _body(scene, name)
        alone = sum(name in c.between for c in scene.contact) == 1 and getattr(body, "grasp", None) is None
        if not (_presses_tissue(scene, contact) and contact.is_field and alone and depth[name].max() > 0.0):
            continue
        deep = depth[name] > 0.5 * depth[name].max()
        assert contact.stiffness_per_area is not None
        pressure = contact.stiffness_per_area * depth[name][deep] ** _exponent(contact)
        size = (force[name][deep] ** 2).sum(axis=1) ** 0.5
        found[contact.name] = float(sorted(size / pressure)[deep.sum() // 2])
    return found


def _exponent(contact: Contact) -> float:
    return contact.exponent if contact.law == "hunt_crossley" else 1.0


def things(scene: Scene) -> list[tuple[str, int, Tissue | Instrument | Rigid]]:
    """Everything with a surface, with its place in the scene file."""
    found: list[tuple[str, int, Tissue | Instrument | Rigid]] = []
    for kind in ("tissue", "instrument", "rigid"):
        found += [(kind, i, thing) for i, thing in enumerate(getattr(scene, kind))]
    return found


def _body(scene: Scene, name: str) -> Tissue | Instrument | Rigid:
    return next(b for b in (*scene.tissue, *scene.bodies) if b.name == name)


def _presses_tissue(scene: Scene, contact: Contact) -> bool:
    first, second = (_body(scene, name) for name in contact.between)
    return isinstance(first, Tissue) and isinstance(second, Instrument)


def _digits(value: float) -> float:
    return float(f"{value:.4g}")


# --- levers -----------------------------------------------------------------------------------------------

Choices = dict[str, list[Edit]]  # by label


def _named(settings: Preset) -> str:
    """The preset that settings are, or the settings in words."""
    return next((f"preset {name}" for name, preset in PRESETS.items() if preset == settings), settings.words)


def _integration(scene: Scene, known: Grounds) -> Choices:
    """Integrators, each with what sets its substep."""
    schemes: dict[str, dict[str, Any]] = {
        f"symplectic_euler, safety {s:g}": {"integrator": "symplectic_euler", "substeps": 0, "safety": s}
        for s in SAFETIES
    }
    schemes |= {name: {"integrator": name, "substeps": 0} for name in ("explicit_euler", "runge_kutta_4")}
    schemes |= {
        f"implicit_euler, {n} substep{'s' * (n > 1)}": {"integrator": "implicit_euler", "substeps": n}
        for n in IMPLICIT_SUBSTEPS
    }
    schemes |= {_named(settings): {"substeps": 0, **settings.keys} for settings in PROJECTIVE}
    # what has no meaning for any other
    projective = scene.solver.integrator == "projective_dynamics"
    without: dict[str, Any] = dict.fromkeys(OF_PROJECTIVE) if projective else {}
    return {label: [Edit(("solver", k), v) for k, v in (without | keys).items()] for label, keys in schemes.items()}


def _response(scene: Scene, known: Grounds) -> Choices:
    """Responses by intersecting triangles instead of a field, as stiff as the field over the area that bore its force.

    A whole contact stays as stiff under another response. It is not made a field: nothing says over which area.
    """
    choices: Choices = {}
    for label, keys in RESPONSES.items():
        edits = []
        for i, contact in enumerate(scene.contact):
            other: dict[str, Any] = {"kdop": None, **keys}
            if contact.is_field:
                if contact.name not in known.area:
                    continue
                area = known.area[contact.name]
                assert contact.stiffness_per_area is not None
                other |= {
                    "stiffness": _digits(contact.stiffness_per_area * area),
                    "damping": _digits(contact.damping_per_area * area) if contact.damping_per_area > 0.0 else None,
                    "stiffness_per_area": None,
                    "damping_per_area": None,
                    "quadrature_spacing": None,
                    "side": None,
                }
            edits += [Edit(("contact", i, k), v) for k, v in other.items()]
        choices[label] = edits
    return choices


def _detection(scene: Scene, known: Grounds) -> Choices:
    return {word: [Edit(("solver", "detection"), word)] for word in ("continuous", "discrete")}


def _period(scene: Scene) -> float:
    """Detection period [s] that others are told from, also where the motion alone asks for detections."""
    return scene.solver.detection_period or DETECTION_PERIOD


def _detection_period(scene: Scene, known: Grounds) -> Choices:
    periods = [_digits(f * _period(scene)) for f in PERIOD_FACTORS]
    return {f"detection every {1e3 * p:g} ms": [Edit(("solver", "detection_period"), p)] for p in periods}


def _mesh(scene: Scene, known: Grounds) -> Choices:
    choices: Choices = {}
    for factor in MESH_FACTORS:
        edits = _finer(scene, factor)
        choices[f"{' + '.join(f'{e.value:,}' for e in edits)} triangles"] = edits
    return choices


def _grading(scene: Scene, known: Grounds) -> Choices:
    """Tissues as fine as they are only around what was touched, and all over."""
    choices: Choices = {}
    for margin, growth in GRADINGS:
        edits = []
        for tissue, own in _gradable(scene):
            boxes = [
                _in_frame(tissue, known.touched[c.name]) + margin * known.half[c.name] * np.array([[-1.0], [1.0]])
                for c in scene.contact
                if c.between[0] == tissue.name and c.name in known.touched
            ]
            if boxes:
                low, high = np.min(boxes, axis=0)[0], np.max(boxes, axis=0)[1]
                reach = tuple(tuple(_digits(x) for x in corner.tolist()) for corner in (low, high))
                edits += [Edit((*own, "reach"), reach), Edit((*own, "growth"), growth)]
        choices[f"graded from {margin:g} half thicknesses on, growth {growth:g}"] = edits
    everywhere = [Edit((*own, key), None) for _, own in _gradable(scene) for key in ("reach", "growth")]
    choices["as fine all over"] = everywhere
    return choices


def _gradable(scene: Scene) -> list[tuple[Tissue, tuple[str | int, ...]]]:
    """Tissues that may be graded, with the place of what says so: not where vertices are held by number."""
    return [
        (tissue, ("tissue", i, "shape") if tissue.shape is not None else ("tissue", i))
        for i, tissue in enumerate(scene.tissue)
        if not isinstance(tissue.fixed, tuple)
        and (tissue.shape is None or isinstance(tissue.shape, Graded))
        and getattr(tissue.shape, "irregular", True)
    ]


def _in_frame(tissue: Tissue, box: FloatArray) -> FloatArray:
    """Box of the shape's frame around a box of the world [m], shape (2, 3)."""
    corners = in_own_frame(tissue, np.array(list(product(*box.T))))
    return np.array([corners.min(axis=0), corners.max(axis=0)])


def _quadrature_spacing(scene: Scene, known: Grounds) -> Choices:
    choices: Choices = {}
    for factor in SPACING_FACTORS:
        edits = [
            Edit(("contact", i, "quadrature_spacing"), _digits(factor * known.spacing[c.name]))
            for i, c in enumerate(scene.contact)
            if c.is_field
        ]
        choices[f"spacing {' + '.join(f'{1e3 * e.value:g}' for e in edits)} mm"] = edits
    return choices


LEVERS: dict[str, Callable[[Scene, Grounds], Choices]] = {
    "mesh": _mesh,
    "grading": _grading,
    "integration": _integration,
    "response": _response,
    "quadrature_spacing": _quadrature_spacing,
    "detection": _detection,
    "detection_period": _detection_period,
}


def options(scene: Scene, known: Grounds) -> list[Option]:
    """All settings of all levers that make another scene of this one."""
    own = scene.model_dump()
    found = []
    for lever, choices in LEVERS.items():
        for label, edits in choices(scene, known).items():
            option = Option(lever, label, tuple(edits))
            made = variant(scene, (option,))
            if made is not None and made.model_dump() != own:
                found.append(option)
    return found


def with_option(configuration: Configuration, option: Option) -> Configuration:
    """A configuration with one lever set anew."""
    order = list(LEVERS)
    return tuple(sorted((*(o for o in configuration if o.lever != option.lever), option),
                        key=lambda o: order.index(o.lever)))  # fmt: skip


def label_of(configuration: Configuration) -> str:
    """A configuration in words."""
    return "; ".join(o.label for o in configuration) or "the scene as it is"


def variant(scene: Scene, configuration: Configuration) -> Scene | None:
    """The scene with a configuration; None where its parts contradict each other."""
    try:
        return changed(scene, [edit for option in configuration for edit in option.edits])
    except InputError:
        return None


# --- the finest -------------------------------------------------------------------------------------------


def _finer(scene: Scene, factor: float) -> list[Edit]:
    """Other numbers of triangles for generated tissues and for generated bodies whose own points read depth.

    A mesh from a file stays, and so does one of whose vertices some are held by number.
    """
    read = {c.between[0] for c in scene.contact if c.is_field}
    edits = []
    for kind, i, thing in things(scene):
        numbered = isinstance(getattr(thing, "fixed", None), tuple)
        if thing.shape is not None and not numbered and (kind == "tissue" or thing.name in read):
            count = max(2, round(factor * thing.shape.triangles))
            edits.append(Edit((kind, i, "shape", "triangles"), count))
    return edits


def meshes_left(scene: Scene) -> list[str]:
    """Names of the tissues whose mesh cannot be made finer."""
    finer = {e.key[1] for e in _finer(scene, 2) if e.key[0] == "tissue"}
    return [t.name for i, t in enumerate(scene.tissue) if i not in finer]


def reference(scene: Scene, known: Grounds, factor: float) -> list[Edit]:
    """The scene's own physics, finer: so many times the triangles, and all that is set by their edges with them.

    Edges, substeps, periods and spacings shrink with the root of the factor: substeps by themselves as the edges do,
    or by the safety where a mesh stays as it is.
    """
    finer, solver = math.sqrt(factor), scene.solver
    period = max(_period(scene) / finer, setting(type(solver), "detection_period").minimum)
    edits = _finer(scene, factor)
    for tissue, own in _gradable(scene):
        if tissue.shape is None:
            edits += [Edit((*own, key), None) for key in ("reach", "growth")]
        elif tissue.meshing.reach is not None:
            growth = max(tissue.meshing.growth / finer, setting(Graded, "growth").minimum)
            edits.append(Edit((*own, "growth"), growth))
    keys = {
        "integrator": "symplectic_euler",
        **dict.fromkeys(OF_PROJECTIVE),
        "substeps": 0,
        "safety": _digits(solver.safety / finer) if meshes_left(scene) else solver.safety,
        "max_substeps": 100_000,
        "detection": "continuous",
        "detection_period": period,
    }
    edits += [Edit(("solver", k), v) for k, v in keys.items()]
    left = {t.name for t in (*scene.tissue, *scene.bodies) if t.shape is None} | set(meshes_left(scene))
    for i, contact in enumerate(scene.contact):
        if contact.is_field:
            least = LONGEST * known.edge[contact.name] / CUTS_MAX / (1.0 if contact.between[0] in left else finer)
            edits.append(
                Edit(
                    ("contact", i, "quadrature_spacing"),
                    _digits(max(known.spacing[contact.name] / finer, least)),
                )
            )
    return edits
