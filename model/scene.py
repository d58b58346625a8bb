"""The scene file: what exists, in SI units, validated into a frozen tree.

A scene declares tissues, instruments, contact pairs, solver and motion. Only what it declares exists in the
FMU and costs anything. Lengths are in metres, quaternions are w, x, y, z.
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Discriminator, Field, PrivateAttr, Tag, model_validator

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

NAME_PATTERN = r"^[A-Za-z][A-Za-z0-9_]{0,63}$"
RESERVED = ("energy", "solver")  # the FMU has variables of its own under these names

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
IDENTITY = (1.0, 0.0, 0.0, 0.0)
ORIGIN = (0.0, 0.0, 0.0)

# --- shapes -----------------------------------------------------------------------------------------------

Length = Annotated[float, Field(ge=1e-5, le=1)]
Lengths2 = Annotated[tuple[Length, ...], Field(min_length=2, max_length=2, strict=False)]
Lengths3 = Annotated[tuple[Length, ...], Field(min_length=3, max_length=3, strict=False)]


def _length(description: str) -> Any:
    return quantity("m", 1e-5, 1, description)


def _triangles(default: Any = ...) -> Any:
    return quantity("1", 2, 1_000_000, "wanted number of triangles", default)


def _seed() -> Any:
    return quantity("1", 0, 2**31 - 1, "number that picks one of the irregular triangulations", 0)


class Patch(Settings):
    """A rectangular sheet round the origin, outer side toward +z."""

    kind: Literal["patch"]
    size: Lengths2 = items("m", "side lengths along x and y")
    triangles: int = _triangles()
    curvature_radius: float | None = quantity(
        "m",
        -1000,
        1000,
        "radius of curvature: positive bulges toward +z, negative is a hollow, none is flat",
        None,
    )
    seed: int = _seed()
    irregular: bool = Field(True, description="irregular triangulation; false gives rows of equal triangles")


class Ellipsoid(Settings):
    """A closed organ round the origin."""

    kind: Literal["ellipsoid"]
    radii: Lengths3 = items("m", "half axes along x, y, z")
    triangles: int = _triangles()
    seed: int = _seed()


class AbdominalWall(Settings):
    """A flat sheet, outer side toward +z, with a hernia sac that hangs toward −z."""

    kind: Literal["abdominal_wall"]
    size: Lengths2 = items("m", "side lengths along x and y")
    triangles: int = _triangles()
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

    box: Annotated[tuple[Point, ...], Field(min_length=2, max_length=2)] = items("m", "least and greatest corner")

    @model_validator(mode="after")
    def _ordered(self) -> "FixedBox":
        low, high = self.box
        if any(a > b for a, b in zip(low, high, strict=True)):
            rule = "the first corner must be the least one along x, y and z"
            raise broken(("box",), rule, show(self.box), "Order the coordinates of the two corners")
        return self


def _fixed_form(value: object) -> str:
    return "word" if isinstance(value, str) else "table" if isinstance(value, dict | FixedBox) else "list"


VertexList = Annotated[tuple[Annotated[int, Field(ge=0, le=10_000_000)], ...], Field(min_length=1, strict=False)]
Fixed = Annotated[
    Annotated[Literal["boundary", "none"], Tag("word")]
    | Annotated[VertexList, Tag("list")]
    | Annotated[FixedBox, Tag("table")],
    Discriminator(_fixed_form),
]


class Tissue(_Body):
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
    damping: float = quantity("N.s/m", 0, 1e4, "damping of every spring along its direction", 0.0)
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


class Instrument(_Body):
    """A rigid body whose pose is the input."""

    name: Name = Field("instrument", description="name, first part of the names of its variables")
    offset: Point = items("m", "place of the mesh's origin in the body frame", ORIGIN)
    rotation: Quaternion = items("1", "rotation of the mesh into the body frame, quaternion w, x, y, z", IDENTITY)
    start_position: Point = items("m", "place of the body frame's origin in the world at the start", ORIGIN)
    start_orientation: Quaternion = items(
        "1", "rotation of the body frame into the world at the start, quaternion w, x, y, z", IDENTITY
    )


class Contact(Settings):
    """A pair of tissue and instrument that is watched for collision.

    In a validated scene `tissue`, `instrument` and `name` are always filled in.
    """

    name: str = Field("", pattern=NAME_PATTERN, description="name, first part of the names of its variables")
    tissue: str = Field("", pattern=NAME_PATTERN, description="name of the tissue; without it the only one")
    instrument: str = Field("", pattern=NAME_PATTERN, description="name of the instrument; without it the only one")
    stiffness: float = quantity("N/m", 1, 1e7, "stiffness of the whole contact")
    damping: float = quantity("N.s/m", 0, 1e4, "damping of the whole contact", 0.0)
    law: Literal["kelvin_voigt"] = Field("kelvin_voigt", description="force law over depth")
    response: Literal["hull", "oobb"] = Field(
        "hull", description="how depth is measured: support of the hull or of the box of an instrument's part"
    )
    pair_weight: Literal["length", "none"] = Field(
        "length",
        description="share of a pair in its region's force: by its length of contact, or each in full",
    )


class Solver(Settings):
    """Time steps and limits."""

    step: float = quantity("s", 1e-6, 1, "communication step", 0.001)
    stop_time: float = quantity("s", 1e-6, 1e6, "end of the default experiment", 1.0)
    gravity: Annotated[tuple[Coordinate, ...], Field(min_length=3, max_length=3)] = items(
        "m/s2", "acceleration of gravity", ORIGIN
    )
    safety: float = quantity("1", 0.01, 1, "share of the stable limit that a substep uses", 0.95)
    substeps: int = quantity("1", 0, 100_000, "substeps of a communication step, 0 to follow the stable limit", 0)
    max_substeps: int = quantity("1", 1, 100_000, "substeps of a communication step above which it is refused", 1000)
    detection_period: float = quantity("s", 1e-6, 1, "time between two collision detections", 0.001)
    max_pairs: int = quantity("1", 16, 1_000_000, "most intersecting triangle pairs of one contact", 1024)
    integrator: Literal["symplectic_euler"] = Field("symplectic_euler", description="scheme in time")

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
    tissue: tuple[Tissue, ...] = Field(min_length=1, strict=False, description="deformable surfaces")
    instrument: tuple[Instrument, ...] = Field((), strict=False, description="rigid bodies whose poses are inputs")
    contact: tuple[Contact, ...] = Field((), strict=False, description="pairs of tissue and instrument that may touch")
    _source: bytes = PrivateAttr(b"")
    _folder: Path = PrivateAttr(Path())
    _place: str = PrivateAttr("scene")

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

    @model_validator(mode="after")
    def _names_agree(self) -> "Scene":
        self.__dict__["contact"] = tuple(self._resolved(i) for i in range(len(self.contact)))
        pairs = [(c.tissue, c.instrument) for c in self.contact]
        for i, pair in enumerate(pairs):
            if pair in pairs[:i]:
                rule, found = "a tissue and an instrument may be one contact only", " and ".join(pair)
                raise broken(("contact", i), rule, found, f"Remove this or contact[{pairs.index(pair)}]")
        groups: dict[str, Sequence[Tissue | Instrument | Contact]] = {
            "tissue": self.tissue,
            "instrument": self.instrument,
            "contact": self.contact,
        }
        seen: dict[str, str] = {}
        for kind, group in groups.items():
            for i, thing in enumerate(group):
                if thing.name in RESERVED:
                    rule = f"{' and '.join(RESERVED)} are names of the FMU's own variables"
                    raise broken((kind, i, "name"), rule, show(thing.name), "Choose another name")
                if thing.name in seen:
                    rule = "every tissue, instrument and contact must have a name of its own"
                    found = f"{show(thing.name)}, also the name of {seen[thing.name]}"
                    raise broken((kind, i, "name"), rule, found, "Give it another name")
                seen[thing.name] = f"{kind}[{i}]"
        return self

    def _resolved(self, i: int) -> Contact:
        """Contact i with the names filled in that the file may leave out."""
        contact = self.contact[i]
        names = {"tissue": [t.name for t in self.tissue], "instrument": [t.name for t in self.instrument]}
        chosen = {}
        for kind, known in names.items():
            word = getattr(contact, kind)
            other = "instrument" if kind == "tissue" else "tissue"
            if not word and len(known) != 1:
                rule = f"a contact must name its {kind} unless the scene declares exactly one"
                way_out = (
                    f"Name one of {', '.join(known)}" if known else f"Declare an [[{kind}]], or remove the contact"
                )
                raise broken(("contact", i, kind), rule, f"{len(known)} declared", way_out)
            if word and word not in known:
                if word in names[other]:
                    rule = f"a contact joins tissue and instrument; {other}–{other} contact is not built yet"
                    raise broken(("contact", i, kind), rule, f"{show(word)}, which is a {other}", nearest(word, known))
                rule = f"the {kind} must be declared"
                raise broken(("contact", i, kind), rule, show(word), nearest(word, known, what=f"{kind}s"))
            chosen[kind] = word or known[0]
        alone = len(self.contact) == 1
        name = contact.name or ("contact" if alone else f"{chosen['instrument']}_{chosen['tissue']}")
        return contact.model_copy(update={**chosen, "name": name})


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
