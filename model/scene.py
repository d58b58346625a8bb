"""The scene file: what exists, in SI units, validated into a frozen tree.

A scene declares tissues, instruments, rigid bodies, contact pairs, solver and motion. Only what it declares
exists in the FMU and costs anything. Lengths are in metres, quaternions are w, x, y, z.
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Discriminator, Field, PrivateAttr, Tag, model_validator

from tissue_contact.grading import GROWTH, GROWTH_MAX
from tissue_contact.presets import BEYOND_SPRINGS, DEFAULT, OF_PROJECTIVE, PRESETS, PresetName
from tissue_contact.settings import (
    Settings,
    broken,
    items,
    nearest,
    parse_toml,
    quantity,
    read_toml,
    show,
    validate,
)

DETECTION_PERIOD = 1e-3  # [s] where a scene gives none and does not go by the motion alone
NAME_PATTERN = r"^[A-Za-z][A-Za-z0-9_]{0,63}$"
RESERVED = ("energy", "solver")  # the FMU has variables of its own under these names
NOT_SPRINGS = ("nonlinearity", "area_stiffness", "volume_stiffness")  # what a tissue has beyond linear springs

Name = Annotated[str, Field(pattern=NAME_PATTERN)]
Coordinate = Annotated[float, Field(ge=-100, le=100)]
Point = Annotated[tuple[Coordinate, ...], Field(min_length=3, max_length=3, strict=False)]


def _unit_quaternion(value: tuple[float, ...]) -> tuple[float, ...]:
    norm = math.hypot(*value)
    if norm < 1e-6:
        rule = "a quaternion w, x, y, z must have a norm above 1e-6"
        raise broken((), rule, show(value), "No rotation is [1, 0, 0, 0]")
    return tuple(v / norm for v in value)


Quaternion = Annotated[
    tuple[Annotated[float, Field(ge=-1e6, le=1e6)], ...],
    Field(min_length=4, max_length=4, strict=False),
    AfterValidator(_unit_quaternion),
]


def _in_order(value: tuple[tuple[float, ...], ...]) -> tuple[tuple[float, ...], ...]:
    low, high = value
    if any(a > b for a, b in zip(low, high, strict=True)):
        rule = "the first corner must be the least one along x, y and z"
        raise broken((), rule, show(value), "Order the coordinates of the two corners")
    return value


Corners = Annotated[tuple[Point, ...], Field(min_length=2, max_length=2, strict=False), AfterValidator(_in_order)]
IDENTITY = (1.0, 0.0, 0.0, 0.0)
ORIGIN = (0.0, 0.0, 0.0)

# --- shapes -----------------------------------------------------------------------------------------------

Length = Annotated[float, Field(ge=1e-5, le=1)]
Lengths2 = Annotated[tuple[Length, ...], Field(min_length=2, max_length=2, strict=False)]
Lengths3 = Annotated[tuple[Length, ...], Field(min_length=3, max_length=3, strict=False)]


def _length(description: str) -> Any:
    return quantity("m", 1e-5, 1, description)


def _triangles(default: Any = ..., more: str = "") -> Any:
    return quantity("1", 2, 1_000_000, f"wanted number of triangles{more}", default)


def _seed() -> Any:
    return quantity("1", 0, 2**31 - 1, "number that picks one of the irregular triangulations", 0)


class Reach(Settings):
    """Where a tissue is touched, and how its mesh gets coarser beyond."""

    reach: Corners | None = items(
        "m",
        "least and greatest corner of a box in the frame of the shape or the mesh, beyond which it gets coarser",
        None,
    )
    growth: float = quantity(
        "1", 0.01, GROWTH_MAX, "how much longer edges get beyond the reach, over their distance from it", GROWTH
    )

    @model_validator(mode="after")
    def _grows_beyond_reach(self) -> "Reach":
        if self.reach is None and "growth" in self.model_fields_set:
            rule = "growth has no meaning where the mesh is as fine all over"
            raise broken(("growth",), rule, show(self.growth), "Give reach, or remove growth")
        return self


class Graded(Reach):
    """What generated tissues share: a mesh that is finest where it is touched."""

    triangles: int = _triangles(more=", with a reach if it were as fine all over")


class Patch(Graded):
    """A rectangular sheet round the origin, outer side toward +z."""

    kind: Literal["patch"]
    size: Lengths2 = items("m", "side lengths along x and y")
    curvature_radius: float | None = quantity(
        "m",
        -1000,
        1000,
        "radius of curvature: positive bulges toward +z, negative is a hollow, none is flat",
        None,
    )
    seed: int = _seed()
    irregular: bool = Field(True, description="irregular triangulation; false gives rows of equal triangles")

    @model_validator(mode="after")
    def _graded_is_irregular(self) -> "Patch":
        if self.reach is not None and not self.irregular:
            raise broken(
                ("reach",), "rows of equal triangles have no reach", show(self.reach), "Remove reach or irregular"
            )
        return self


class Ellipsoid(Graded):
    """A closed organ round the origin."""

    kind: Literal["ellipsoid"]
    radii: Lengths3 = items("m", "half axes along x, y, z")
    seed: int = _seed()


class AbdominalWall(Graded):
    """A flat sheet, outer side toward +z, with a hernia sac that hangs toward −z."""

    kind: Literal["abdominal_wall"]
    size: Lengths2 = items("m", "side lengths along x and y")
    opening_radius: float = _length("radius of the neck of the sac")
    sac_depth: float = _length("depth from the sheet to the bottom of the sac")
    seed: int = _seed()


class Capsule(Settings):
    """A rod with hemispherical ends, tip at the origin, handle toward +z."""

    kind: Literal["capsule"]
    radius: float = _length("radius of the rod")
    length: float = _length("length over all")
    triangles: int = _triangles()


class Sphere(Settings):
    """A ball whose lowest point is the origin."""

    kind: Literal["sphere"]
    radius: float = _length("radius of the ball")
    triangles: int = _triangles()


class Box(Settings):
    """A box, middle of its tip face at the origin, other face toward +z."""

    kind: Literal["box"]
    size: Lengths3 = items("m", "side lengths along x, y, z")
    triangles: int = _triangles(12)


class Cylinder(Settings):
    """A rod with flat ends, middle of its tip face at the origin, handle toward +z."""

    kind: Literal["cylinder"]
    radius: float = _length("radius of the rod")
    length: float = _length("length over all")
    triangles: int = _triangles()


class Grasper(Settings):
    """A shaft with two jaws, tips at z = 0, handle toward +z."""

    kind: Literal["grasper"]
    radius: float = _length("radius of the shaft")
    length: float = _length("length of closed jaws and shaft together")
    jaw_length: float = _length("length of the jaws")
    opening: float = quantity("rad", 0, 3, "angle between the jaws", 0.0)
    triangles: int = _triangles(300)


class Hook(Settings):
    """A shaft along z with a round bar toward +x at its foot."""

    kind: Literal["hook"]
    radius: float = _length("radius of shaft and bar")
    length: float = _length("length of the shaft")
    hook_length: float = _length("distance from the shaft's axis to the end of the bar")
    triangles: int = _triangles(300)


Shape = Annotated[
    Patch | Ellipsoid | AbdominalWall | Capsule | Sphere | Box | Cylinder | Grasper | Hook,
    Field(discriminator="kind"),
]

# --- objects ----------------------------------------------------------------------------------------------


class _Body(Settings):
    """What tissue and instrument share: where the surface comes from."""

    mesh: str | None = Field(None, min_length=1, description="mesh file, relative to the scene file")
    scale: float = quantity("1", 1e-9, 1e3, "metres per unit of the mesh file, 0.001 for millimetres", 1.0)
    open_surface: bool = Field(False, description="the mesh is meant to be a sheet with a boundary")
    many_parts: bool = Field(False, description="the mesh is meant to be of several pieces")
    flip: bool = Field(False, description="turn the surface inside out: what was its inner side becomes the outer one")
    shape: Shape | None = Field(None, description="generated surface, instead of a mesh file")

    @model_validator(mode="after")
    def _one_source(self) -> "_Body":
        if self.mesh is None and self.shape is None:
            way_out = 'Give mesh = "file.stl", or shape = {kind = "…"}'
            raise broken((), "either mesh or shape must be given", "neither", way_out)
        if self.mesh is not None and self.shape is not None:
            raise broken((), "only one of mesh and shape may be given", "both", "Remove one of the two")
        for_mesh = [k for k in ("scale", "open_surface", "many_parts") if k in self.model_fields_set]
        if self.shape is not None and for_mesh:
            rule = "the key describes a mesh file and has no meaning for a shape"
            raise broken((for_mesh[0],), rule, show(getattr(self, for_mesh[0])), "Remove it")
        return self


class FixedBox(Settings):
    """The vertices inside a box of the world frame."""

    box: Corners = items("m", "least and greatest corner")


def _fixed_form(value: object) -> str:
    return "word" if isinstance(value, str) else "table" if isinstance(value, dict | FixedBox) else "list"


VertexList = Annotated[tuple[Annotated[int, Field(ge=0, le=10_000_000)], ...], Field(min_length=1, strict=False)]
Fixed = Annotated[
    Annotated[Literal["boundary", "none"], Tag("word")]
    | Annotated[VertexList, Tag("list")]
    | Annotated[FixedBox, Tag("table")],
    Discriminator(_fixed_form),
]


class Tissue(Reach, _Body):
    """A deformable surface of springs."""

    name: Name = Field("tissue", description="name, first part of the names of its variables")
    position: Point = items("m", "place of the surface's origin in the world", ORIGIN)
    rotation: Quaternion = items("1", "rotation of the surface into the world, quaternion w, x, y, z", IDENTITY)
    areal_density: float = quantity("kg/m2", 1e-3, 1e3, "mass per area")
    stiffness: float | None = quantity("N/m", 1e-2, 1e7, "stiffness of every structural spring", None)
    youngs_modulus: float | None = quantity(
        "Pa", 1, 1e9, "Young's modulus, from which with thickness the springs follow", None
    )
    thickness: float | None = quantity("m", 1e-5, 0.2, "thickness of the tissue layer", None)
    bending_stiffness: float = quantity("N/m", 0, 1e7, "stiffness of every bending spring, 0 for none", 0.0)
    nonlinearity: float = quantity("1", 0, 1e4, "b of a spring that stiffens with strain e: k (1 + b e²)", 0.0)
    preload: float = quantity("1", 0, 0.9, "share by which the springs at rest are shorter than meshed", 0.0)
    damping: float = quantity("N.s/m", 0, 1e4, "damping of every spring along its direction", 0.0)
    area_stiffness: float = quantity("N/m", 0, 1e7, "resistance of every triangle against a change of its area", 0.0)
    volume_stiffness: float = quantity("Pa", 0, 1e9, "resistance of a closed organ against a change of volume", 0.0)
    drag: float = quantity("N.s/m3", 0, 1e7, "damping of motion against the surroundings, per area", 0.0)
    support_stiffness: float = quantity(
        "N/m3", 0, 1e10, "elastic foundation under the surface, per area, 0 for none", 0.0
    )
    support_damping: float = quantity("N.s/m3", 0, 1e7, "damping of the foundation, per area", 0.0)
    fixed: Fixed = Field("boundary", description="vertices that never move: boundary, none, indices or a box")
    probes: tuple[Point, ...] = items("m", "points whose nearest place on the surface is followed", ())

    @model_validator(mode="after")
    def _one_stiffness(self) -> "Tissue":
        layer = [k for k in ("youngs_modulus", "thickness") if getattr(self, k) is not None]
        rule = "either stiffness, or youngs_modulus and thickness together, must be given"
        if self.stiffness is not None and layer:
            raise broken((layer[0],), rule, f"stiffness and {' and '.join(layer)}", "Remove one of the two")
        if self.stiffness is None and not layer:
            raise broken(("stiffness",), rule, "neither", "Give for instance stiffness = 200.0 (N/m)")
        if len(layer) == 1:
            other = "thickness" if layer[0] == "youngs_modulus" else "youngs_modulus"
            raise broken((other,), rule, f"{layer[0]} alone", f"Add {other}, or give stiffness instead")
        return self

    @model_validator(mode="after")
    def _reach_of_mesh(self) -> "Tissue":
        if self.reach is not None and self.shape is not None:
            raise broken(("reach",), "the reach of a shape is part of the shape", show(self.reach), "Move it to shape")
        if self.reach is not None and isinstance(self.fixed, tuple):
            rule = "with a reach the vertices of a mesh have other numbers than in its file"
            way_out = "Give fixed = {box = [[…], […]]}, or remove reach"
            raise broken(("fixed",), rule, f"{len(self.fixed)} numbers", way_out)
        return self

    @property
    def meshing(self) -> Reach:
        """What says how fine it is where: its shape if it is generated, or itself."""
        return self.shape if isinstance(self.shape, Graded) else self

    @property
    def beyond_springs(self) -> list[str]:
        """Keys by which it resists otherwise than by linear springs."""
        return [key for key in NOT_SPRINGS if getattr(self, key) > 0.0]


class Grasp(Settings):
    """Jaws that hold tissue: what lies within their reach as they close keeps its place in the body frame."""

    radius: float = _length("reach of the jaws: tissue vertices this near to their centre are held")
    centre: Point = items("m", "middle of the jaws in the body frame", ORIGIN)
    stiffness: float = quantity("N/m", 1, 1e7, "stiffness of the whole hold")
    damping: float = quantity("N.s/m", 0, 1e4, "damping of the whole hold", 0.0)
    slip_force: float = quantity("N", 1e-3, 1e4, "force of the whole hold above which the tissue slides in the jaws")
    close_below: float = quantity("1", 0, 1, "the jaws close when their input falls below", 0.3)
    open_above: float = quantity("1", 0, 1, "the jaws open when their input rises above", 0.5)

    @model_validator(mode="after")
    def _hysteresis(self) -> "Grasp":
        if self.close_below > self.open_above:
            found = f"{self.close_below:g} and {self.open_above:g}"
            raise broken(("close_below",), "close_below must not exceed open_above", found, "Swap the two")
        return self


class Instrument(_Body):
    """A rigid body whose pose is the input."""

    name: Name = Field("instrument", description="name, first part of the names of its variables")
    offset: Point = items("m", "place of the mesh's origin in the body frame", ORIGIN)
    rotation: Quaternion = items("1", "rotation of the mesh into the body frame, quaternion w, x, y, z", IDENTITY)
    start_position: Point = items("m", "place of the body frame's origin in the world at the start", ORIGIN)
    start_orientation: Quaternion = items(
        "1", "rotation of the body frame into the world at the start, quaternion w, x, y, z", IDENTITY
    )
    grasp: Grasp | None = Field(None, description="jaws that can hold tissue; adds the input jaw")


class Rigid(_Body):
    """A rigid body that does not move, such as a bone."""

    name: Name = Field("rigid", description="name, first part of the names of its variables")
    position: Point = items("m", "place of the surface's origin in the world", ORIGIN)
    rotation: Quaternion = items("1", "rotation of the surface into the world, quaternion w, x, y, z", IDENTITY)


Response = Literal["distance_field", "hull", "kdop", "oobb", "oobb_literal", "primitive"]


class Contact(Settings):
    """Two objects that are watched for collision.

    In a validated scene `between` and `name` are always filled in, a tissue first, a rigid body last.
    """

    name: str = Field("", pattern=NAME_PATTERN, description="name, first part of the names of its variables")
    between: Annotated[tuple[Name, ...], Field(max_length=2, strict=False)] = Field(
        (), description="names of the two objects; without it the only tissue and the only instrument"
    )
    response: Response = Field(
        "distance_field",
        description="how depth is measured: at the tissue's points in the field of the other body, or by the support "
        "of its hull, of its k-DOP, of its box, by the box as in the thesis, by the intersecting triangles alone",
    )
    law: Literal["kelvin_voigt", "hunt_crossley"] = Field("kelvin_voigt", description="force law over depth")
    stiffness_per_area: float | None = quantity(
        "N/m3", 1e2, 1e12, "stiffness of a distance_field contact, force per depth and area", None
    )
    damping_per_area: float = quantity("N.s/m3", 0, 1e9, "damping of a distance_field contact, per area", 0.0)
    stiffness: float | None = quantity("N/m", 1, 1e10, "stiffness of the whole contact, for every other response", None)
    damping: float = quantity("N.s/m", 0, 1e4, "damping of the whole contact", 0.0)
    exponent: float = quantity("1", 1, 5, "n of hunt_crossley, F = k d (d / 1 m)^(n - 1) (1 + lambda d')", 1.5)
    dissipation: float = quantity("s/m", 0, 1e3, "lambda of hunt_crossley", 0.0)
    friction: float = quantity("1", 0, 10, "coefficient of Coulomb friction, 0 for none", 0.0)
    slip_speed: float = quantity("m/s", 1e-6, 1, "speed above which friction is nearly full", 1e-3)
    side: Literal["outer", "both"] | None = Field(
        None, description="sides of the tissue that count; without it both for a rigid body, outer for an instrument"
    )
    kdop: Literal[6, 14, 26] = Field(
        14,
        description="faces of the polytope of the kdop response: more fit tighter and cost as much",
        json_schema_extra={"unit": "1", "minimum": 6, "maximum": 26},
    )
    pair_weight: Literal["length", "none"] = Field(
        "length",
        description="share of a pair in its region's force: by its length of contact, or each in full",
    )
    quadrature_spacing: float | None = quantity(
        "m", 1e-6, 0.1,
        "distance_field reads depth about this far apart, cutting no edge in more than 8; without it a quarter of the "
        "thinnest part, or as near as that allows",
        None,
    )  # fmt: skip

    @property
    def is_field(self) -> bool:
        """Whether depth is read at points in a distance field."""
        return self.response == "distance_field"

    @model_validator(mode="after")
    def _one_law(self) -> "Contact":
        needed, field = "stiffness_per_area" if self.is_field else "stiffness", self.is_field
        viscous = self.law == "kelvin_voigt"
        unused = {
            "stiffness": field, "damping": field or not viscous, "stiffness_per_area": not field,
            "damping_per_area": not field or not viscous, "quadrature_spacing": not field, "pair_weight": field,
            "kdop": self.response != "kdop", "exponent": viscous, "dissipation": viscous,
            "slip_speed": "friction" not in self.model_fields_set,
        }  # fmt: skip
        given = [key for key, wrong in unused.items() if wrong and key in self.model_fields_set]
        if getattr(self, needed) is None:
            unit = "N/m3" if field else "N/m"
            rule = f"response {self.response} takes {needed} [{unit}]"
            found = f"{given[0]} instead" if given else "nothing"
            example = "1e6 (N/m3)" if field else "200.0 (N/m)"
            raise broken((needed,), rule, found, f"Give for instance {needed} = {example}")
        if given:
            rule = f"{given[0]} has no meaning for response {self.response} and law {self.law}"
            if given[0] == "slip_speed":
                rule = "slip_speed has no meaning without friction"
            raise broken((given[0],), rule, show(getattr(self, given[0])), "Remove it")
        return self


PRESET_MEANING = (
    f"fills in what is not given here: {'; '.join(f'{name} {preset.words}' for name, preset in PRESETS.items())}. With "
    f"a tissue that has {', '.join(NOT_SPRINGS[:-1])} or {NOT_SPRINGS[-1]} every preset is {BEYOND_SPRINGS.words}"
)


class Solver(Settings):
    """Time steps and limits.

    In a validated scene what the preset fills in is filled in.
    """

    preset: PresetName = Field(DEFAULT, description=PRESET_MEANING)
    step: float = quantity("s", 1e-6, 1, "communication step", 0.001)
    stop_time: float = quantity("s", 1e-6, 1e6, "end of the default experiment", 1.0)
    gravity: Annotated[tuple[Coordinate, ...], Field(min_length=3, max_length=3)] = items(
        "m/s2", "acceleration of gravity", ORIGIN
    )
    safety: float = quantity("1", 0.01, 1, "share of the stable limit that a substep uses", 0.95)
    substeps: int = quantity("1", 0, 100_000, "substeps of a communication step, 0 to follow the stable limit", 0)
    max_substeps: int = quantity("1", 1, 100_000, "substeps of a communication step above which it is refused", 1000)
    detection_period: float | None = quantity(
        "s", 1e-6, 1,
        "longest time between two collision detections; without it 1 ms, or only as the motion asks where detection is "
        "continuous and every contact a distance_field",
        None,
    )  # fmt: skip
    detection: Literal["continuous", "discrete"] = Field(
        "continuous",
        description="whether steps are cut so that little moves between two detections, or only the period counts",
    )
    max_pairs: int = quantity("1", 16, 1_000_000, "most intersecting triangle pairs of one contact", 1024)
    integrator: Literal[
        "symplectic_euler", "explicit_euler", "implicit_euler", "runge_kutta_4", "projective_dynamics"
    ] = Field("symplectic_euler", description="scheme in time")
    iterations: int = quantity("1", 1, 100, "iterations of a substep of projective_dynamics, at most", 3)
    tolerance: float = quantity(
        "1",
        0,
        1,
        "share of the contacts' impulse, or of the motion where nothing is touched, with a change of which an "
        "iteration of projective_dynamics is the last, 0 for none",
        0.0,
    )
    motion_limit: float = quantity(
        "m",
        0,
        1,
        "way of a vertex in a substep of projective_dynamics above which the rest of the communication step is made by "
        "symplectic_euler, or over max_substeps by half as long ones, as where its way changes by two fifths of that, "
        "and the steps after it until no vertex goes a fifth of it; 0 for never, as where substeps is given",
        0.0,
    )
    energy_gain: float = quantity(
        "1",
        0,
        1e6,
        "energy from nowhere since the start above which a step is undone, over all that was put in",
        1.0,
    )

    @model_validator(mode="after")
    def _in_order(self) -> "Solver":
        if self.stop_time < self.step:
            found, way_out = f"{self.stop_time:g} and {self.step:g}", "Lengthen stop_time or shorten step"
            raise broken(("stop_time",), "stop_time must not be less than step", found, way_out)
        if self.substeps > self.max_substeps:
            found, way_out = (
                f"{self.substeps} and {self.max_substeps}",
                "Raise max_substeps or lower substeps",
            )
            raise broken(("substeps",), "substeps must not exceed max_substeps", found, way_out)
        return self


class Motion(Settings):
    """How an instrument moves between two communication points."""

    kind: Literal["ramp"] = Field("ramp", description="from the last pose to the one set now, over the step")


class Scene(Settings):
    """Everything that a scene file declares. Read it with `read_scene`."""

    name: Name = Field(description="name of the scene and of its FMU")
    description: str = Field("", max_length=1000, description="one sentence about the scene")
    solver: Solver = Field(Solver(), description="time steps and limits")
    motion: Motion = Field(Motion(), description="motion between communication points")
    tissue: tuple[Tissue, ...] = Field((), strict=False, description="deformable surfaces")
    instrument: tuple[Instrument, ...] = Field((), strict=False, description="rigid bodies whose poses are inputs")
    rigid: tuple[Rigid, ...] = Field((), strict=False, description="rigid bodies that do not move")
    contact: tuple[Contact, ...] = Field((), strict=False, description="pairs of objects that may touch")
    _source: bytes = PrivateAttr(b"")
    _folder: Path = PrivateAttr(Path())
    _place: str = PrivateAttr("scene")
    _remarks: tuple[str, ...] = PrivateAttr(())

    @property
    def source(self) -> bytes:
        """The scene file as it was read."""
        return self._source

    @property
    def folder(self) -> Path:
        """Where relative mesh paths begin."""
        return self._folder

    @property
    def place(self) -> str:
        """The scene file's name, for messages."""
        return self._place

    @property
    def remarks(self) -> tuple[str, ...]:
        """What the user should know of it, one line each."""
        return self._remarks

    @property
    def bodies(self) -> tuple[Instrument | Rigid, ...]:
        """All that is rigid: the instruments, then the rigid bodies."""
        return (*self.instrument, *self.rigid)

    @property
    def detection_period(self) -> float:
        """Longest time between two detections [s], infinite where only the motion asks for them."""
        if self.solver.detection_period is not None:
            return self.solver.detection_period
        by_motion = self.solver.detection == "continuous" and all(c.is_field for c in self.contact)
        return math.inf if by_motion else DETECTION_PERIOD

    @property
    def not_springs(self) -> list[str]:
        """The first key of each tissue that resists otherwise than by linear springs, with its name."""
        return [f"{t.beyond_springs[0]} of tissue {t.name}" for t in self.tissue if t.beyond_springs]

    @model_validator(mode="after")
    def _preset(self) -> "Scene":
        """Fill in the solver's keys that its preset gives and the file does not."""
        solver, given = self.solver, self.solver.model_fields_set
        chosen = PRESETS[solver.preset]
        if self.not_springs and chosen.integrator == "projective_dynamics" and "integrator" not in given:
            if "preset" in given:
                self._remarks = (
                    f"preset {solver.preset} is {BEYOND_SPRINGS.words} in this scene, for {chosen.integrator} does not "
                    f"know the {self.not_springs[0]}",
                )
            chosen = BEYOND_SPRINGS
        # What goes with another integrator than the file's has no meaning for that.
        fits = "integrator" not in given or ("preset" in given and solver.integrator == chosen.integrator)
        missing = {key: value for key, value in chosen.keys.items() if fits and key not in given}
        self.__dict__["solver"] = solver.model_copy(update=missing)
        for key in OF_PROJECTIVE:
            if key in given and self.solver.integrator != "projective_dynamics":
                rule = f"{key} has no meaning for integrator {self.solver.integrator}"
                way_out = "Remove it" if self._remarks else "Remove it, or take projective_dynamics"
                raise broken(("solver", key), rule, show(getattr(solver, key)), way_out)
        return self

    @model_validator(mode="after")
    def _names_agree(self) -> "Scene":
        if not self.tissue and not self.instrument:
            raise broken((), "a scene must have a tissue or an instrument", "neither", "Declare a [[tissue]]")
        seen: dict[str, str] = {}
        for kind in ("tissue", "instrument", "rigid"):
            for i, thing in enumerate(getattr(self, kind)):
                self._own_name(seen, kind, i, thing.name)
        self.__dict__["contact"] = tuple(self._resolved(i) for i in range(len(self.contact)))
        for i, contact in enumerate(self.contact):
            before = [set(c.between) for c in self.contact[:i]]
            if set(contact.between) in before:
                rule, found = "two objects may be one contact only", " and ".join(contact.between)
                raise broken(
                    ("contact", i), rule, found, f"Remove this or contact[{before.index(set(contact.between))}]"
                )
            self._own_name(seen, "contact", i, contact.name)
        grasped = {name for c in self.contact for name in c.between if c.between[0] in {t.name for t in self.tissue}}
        for i, instrument in enumerate(self.instrument):
            if instrument.grasp is not None and instrument.name not in grasped:
                rule = "a grasper must be in contact with a tissue"
                way_out = f'Declare a [[contact]] with between = ["TISSUE", "{instrument.name}"], or remove grasp'
                raise broken(("instrument", i, "grasp"), rule, "no such contact", way_out)
        return self

    @staticmethod
    def _own_name(seen: dict[str, str], kind: str, i: int, name: str) -> None:
        if name in RESERVED:
            rule = f"{' and '.join(RESERVED)} are names of the FMU's own variables"
            raise broken((kind, i, "name"), rule, show(name), "Choose another name")
        if name in seen:
            rule = "every object and contact must have a name of its own"
            raise broken(
                (kind, i, "name"), rule, f"{show(name)}, also the name of {seen[name]}", "Give it another name"
            )
        seen[name] = f"{kind}[{i}]"

    def _resolved(self, i: int) -> Contact:
        """Contact i with its objects in order and with the names filled in that the file may leave out."""
        contact = self.contact[i]
        kinds = {t.name: "tissue" for t in self.tissue}
        kinds |= {t.name: "instrument" for t in self.instrument} | {r.name: "rigid" for r in self.rigid}
        between: Sequence[str] = contact.between
        if not between:
            if len(self.tissue) != 1 or len(self.instrument) != 1:
                rule = "a contact must name its two objects unless the scene has one tissue and one instrument"
                found = f"{len(self.tissue)} tissues and {len(self.instrument)} instruments"
                raise broken(("contact", i, "between"), rule, found, f"Name two of {', '.join(kinds) or 'its objects'}")
            between = (self.tissue[0].name, self.instrument[0].name)
        if len(between) != 2 or between[0] == between[1]:
            rule = "a contact is between two objects"
            way_out = "A tissue's contact with itself is not modelled" if len(between) == 2 else "Name two"
            raise broken(("contact", i, "between"), rule, show(between), way_out)
        for name in between:
            if name not in kinds:
                rule = "the objects of a contact must be declared"
                raise broken(("contact", i, "between"), rule, show(name), nearest(name, kinds, what="objects"))
        order = ("tissue", "instrument", "rigid")
        first, second = sorted(between, key=lambda name: order.index(kinds[name]))
        pair = (kinds[first], kinds[second])
        if pair in (("tissue", "tissue"), ("rigid", "rigid")):
            why = "is not built yet" if pair[0] == "tissue" else "is none, as neither moves"
            rule = f"a contact joins an instrument or a rigid body with something; {pair[0]}–{pair[1]} contact {why}"
            raise broken(("contact", i, "between"), rule, show(between), "Remove the contact")
        if pair != ("tissue", "instrument") and not contact.is_field:
            rule = f"the response of a contact of {pair[0]} and {pair[1]} must be distance_field"
            raise broken(("contact", i, "response"), rule, show(contact.response), "Leave response out")
        if contact.side is not None and (pair[0] != "tissue" or not contact.is_field):
            rule = "side is for a tissue's distance_field contact"
            raise broken(("contact", i, "side"), rule, show(contact.side), "Remove it")
        chosen: dict[str, object] = {"between": (first, second)}
        chosen["name"] = contact.name or ("contact" if len(self.contact) == 1 else f"{second}_{first}")
        chosen["side"] = contact.side or ("both" if kinds[second] == "rigid" else "outer")
        return contact.model_copy(update=chosen)


def parse_scene(source: bytes, folder: Path, place: str = "scene") -> Scene:
    """Scene of a TOML text; `folder` is where relative mesh paths begin, `place` names it in messages.

    Raises
    ------
    InputError
        One, whatever is wrong: place, key, rule, value, way out.

    """
    scene = validate(Scene, parse_toml(source, place), place)
    scene._source, scene._folder, scene._place = source, folder, place
    return scene


def read_scene(path: str | Path) -> Scene:
    """Scene of a TOML file. Errors as `parse_scene`, and a missing file."""
    path = Path(path)
    source, _ = read_toml(path, "scene")
    return parse_scene(source, path.parent, str(path))


def scene_schema() -> dict[str, Any]:
    """JSON schema of the scene file, for editors."""
    schema = Scene.model_json_schema()
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}
