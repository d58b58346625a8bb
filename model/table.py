"""The variables of a scene's FMU, in the slots of `tissue_contact.kernels.slots`."""

from typing import Any

import numpy as np

from tissue_contact.kernels import slots
from tissue_contact.scene import Contact, Instrument, Scene
from tissue_contact.settings import Settings, setting
from tissue_contact.variables import Variable


class Sizes:
    """Lengths of the vectors of a scene, and where the parts of them begin."""

    def __init__(self, scene: Scene) -> None:
        bodies, graspers = len(scene.bodies), len(graspers_of(scene))
        self.inputs = slots.POSE * len(scene.instrument) + graspers
        self.contacts = slots.TISSUE_PARAMETERS * len(scene.tissue)
        self.grasps = self.contacts + slots.CONTACT_PARAMETERS * len(scene.contact)
        self.parameters = self.grasps + slots.GRASP_PARAMETERS * graspers
        self.common = slots.BODY_OUTPUTS * bodies
        self.probes = self.common + slots.COMMON_OUTPUTS
        self.held = self.probes + 3 * sum(len(t.probes) for t in scene.tissue)
        self.outputs = self.held + graspers


def graspers_of(scene: Scene) -> list[Instrument]:
    """The instruments that can hold tissue."""
    return [i for i in scene.instrument if i.grasp is not None]


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
    for j, grasper in enumerate(graspers_of(scene)):
        slot = slots.POSE * len(scene.instrument) + j
        table.append(Variable(f"{grasper.name}.jaw", "inputs", slot, "1", 1.0, 0.0, 1.0, "jaws, 0 closed, 1 open"))
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
        for key in ("drag", "nonlinearity", "area_stiffness", "volume_stiffness"):
            if getattr(tissue, key) > 0.0:
                add(tissue.name, camel(key), own + getattr(slots, key.upper()), tissue, key)
    for k, contact in enumerate(scene.contact):
        own = Sizes(scene).contacts + slots.CONTACT_PARAMETERS * k
        for key, slot in contact_keys(contact).items():
            add(contact.name, camel(key), own + slot, contact, key)
    for j, grasper in enumerate(graspers_of(scene)):
        own = Sizes(scene).grasps + slots.GRASP_PARAMETERS * j
        assert grasper.grasp is not None
        for key in ("stiffness", "damping", "slip_force"):
            add(grasper.name, camel(f"grasp_{key}"), own + getattr(slots, f"GRASP_{key.upper()}"), grasper.grasp, key)
    return table


def contact_keys(contact: Contact) -> dict[str, int]:
    """Keys of the scene that are tunable parameters of a contact, with their slots."""
    keys = {"stiffness_per_area" if contact.is_field else "stiffness": slots.CONTACT_STIFFNESS}
    if contact.law == "hunt_crossley":
        keys |= {"exponent": slots.CONTACT_EXPONENT, "dissipation": slots.CONTACT_DAMPING}
    else:
        keys["damping_per_area" if contact.is_field else "damping"] = slots.CONTACT_DAMPING
    if contact.friction > 0.0:
        keys["friction"] = slots.CONTACT_FRICTION
    return keys


def camel(key: str) -> str:
    """Name of a variable that is a key of the scene: stiffness_per_area is stiffnessPerArea."""
    first, *rest = key.split("_")
    return first + "".join(word.capitalize() for word in rest)


def _output_variables(scene: Scene) -> list[Variable]:
    table: list[Variable] = []
    zero = (0.0, 0.0, 0.0)

    def scalar(name: str, slot: int, unit: str, description: str) -> None:
        table.append(Variable(name, "outputs", slot, unit, 0.0, -np.inf, np.inf, description))

    def vector(name: str, slot: int, unit: str, description: str) -> None:
        table.extend(_vector(name, "outputs", slot, unit, zero, np.inf, description))

    sizes = Sizes(scene)
    for i, body in enumerate(scene.bodies):
        name, own = body.name, slots.BODY_OUTPUTS * i
        vector(f"{name}.force", own + slots.FORCE, "N", f"contact force on {name}, world frame")
        vector(
            f"{name}.torque", own + slots.TORQUE, "N.m", "its torque about the origin of the body frame, world frame"
        )
        vector(f"{name}.meanForce", own + slots.MEAN_FORCE, "N", f"impulse on {name} over the step, by the step")
        scalar(f"{name}.depth", own + slots.DEPTH, "m", "deepest penetration")
        vector(f"{name}.contactPoint", own + slots.CONTACT_POINT, "m", "mean point of collision, weighted by force")
        scalar(f"{name}.contacts", own + slots.CONTACTS, "1", "number of contact regions")
    own = sizes.common
    scalar("energy.kinetic", own + slots.ENERGY_KINETIC, "J", "kinetic energy of the tissue")
    scalar("energy.elastic", own + slots.ENERGY_ELASTIC, "J", "energy of the springs, area, volume, support and weight")
    scalar("energy.contact", own + slots.ENERGY_CONTACT, "J", "energy stored in contacts and holds")
    scalar("energy.dissipated", own + slots.ENERGY_DISSIPATED, "J", "energy taken by all the dampers so far")
    scalar("energy.work", own + slots.ENERGY_WORK, "J", "work of the instruments so far")
    scalar("energy.balance", own + slots.ENERGY_BALANCE, "J", "work less dissipated less change of stored energy")
    scalar("solver.substeps", own + slots.SUBSTEPS, "1", "substeps of the last step")
    scalar(
        "solver.rejectedPairs",
        own + slots.REJECTED_PAIRS,
        "1",
        "pairs of triangles, or triangles in a field, rejected as passed through",
    )
    scalar(
        "solver.pairs",
        own + slots.PAIRS,
        "1",
        "intersecting triangle pairs, or triangles or points near a field, that the response works on",
    )
    own = sizes.probes
    for tissue in scene.tissue:
        for k in range(len(tissue.probes)):
            vector(f"{tissue.name}.probe[{k + 1}].position", own, "m", "place of the probe point on the tissue")
            own += 3
    for j, grasper in enumerate(graspers_of(scene)):
        scalar(f"{grasper.name}.grasped", sizes.held + j, "1", "number of tissue vertices that the jaws hold")
    return table
