"""The press that a study tries a scene with: along one axis, from where the instrument first meets the tissue."""

from dataclasses import dataclass

import numpy as np

from tissue_contact.assembly import Assembly
from tissue_contact.errors import InputError
from tissue_contact.kernels.collision import BODIES
from tissue_contact.kernels.layout import Real
from tissue_contact.kernels.slots import BODY_OUTPUTS, DEPTH, FORCE, POSE
from tissue_contact.simulate import Instance

HALVINGS = 40  # of the way in which the first touch lies


@dataclass(frozen=True, eq=False)
class Press:
    """A straight way of one instrument into the tissue.

    ``touch`` [m] is the way from the start pose to the first touch, ``reach`` [m] half of the thinnest part that
    touches, beyond which nothing should be pressed.
    """

    instrument: int
    axis: Real  # shape [3], unit vector into the tissue
    touch: float
    reach: float

    def put(self, instance: Instance, start: Real, way: float) -> None:
        """Set the inputs: the start pose, moved by a way [m] beyond the first touch."""
        instance.inputs[:] = start
        first = POSE * self.instrument
        instance.inputs[first : first + 3] += (self.touch + way) * self.axis

    def force(self, instance: Instance) -> float:
        """Force [N] with which the tissue pushes the instrument back along the axis."""
        first = BODY_OUTPUTS * self.instrument + FORCE
        return -float(instance.outputs[first : first + 3] @ self.axis)


def find_press(assembly: Assembly, instrument: int, axis: Real, place: str) -> Press:
    """The press of an instrument along an axis of the world.

    Raises
    ------
    InputError
        The instrument has no contact with a tissue, or does not meet it on this way; ``place`` names it.
    """
    model = assembly.model
    own = np.flatnonzero((model.contact_body == instrument) & (model.contact_response != BODIES))
    if own.size == 0:
        raise InputError(place, "the instrument must have a contact with a tissue", "none", "Declare a [[contact]]")
    reach = float(model.contact_reach[own].min())
    axis = axis / np.linalg.norm(axis)
    instance, depth = Instance(assembly), BODY_OUTPUTS * instrument + DEPTH
    here = Press(instrument, axis, 0.0, reach)

    def touches(way: float) -> bool:
        here.put(instance, assembly.inputs, way)
        instance.initialize()
        return bool(instance.outputs[depth] > 0.0)

    rest = np.column_stack([model.rest_x, model.rest_y, model.rest_z])
    start = assembly.inputs[POSE * instrument : POSE * instrument + 3]
    far = float(np.linalg.norm(rest - start, axis=1).max()) + float(model.body_radius[instrument])
    ways = np.arange(0.0, far + reach, 0.5 * reach)  # no part is jumped over
    hit = next((n for n, way in enumerate(ways) if touches(way)), None)
    if hit is None:
        rule = "the instrument must meet the tissue on its way along the axis"
        way_out = "Give another --axis, or another start_position in the scene"
        raise InputError(place, rule, f"nothing within {far:.3g} m along {axis.tolist()}", way_out)
    low, high = (0.0, 0.0) if hit == 0 else (float(ways[hit - 1]), float(ways[hit]))
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if touches(middle) else (middle, high)
    return Press(instrument, axis, high, reach)
