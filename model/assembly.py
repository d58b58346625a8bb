"""What assembly makes of a scene, ready to step in Python or to be written into an FMU."""

from dataclasses import dataclass

import numpy as np

from tissue_contact.kernels.layout import Index, Model, Real, Scratch, State
from tissue_contact.variables import Variable


@dataclass(frozen=True, eq=False)
class Assembly:
    """Flat arrays of one scene with the table of its variables.

    ``model``, ``state`` and ``scratch`` are views of the blocks beside them; ``state`` is the state at the start.
    ``parameters``, ``inputs`` and ``outputs`` hold start values, in the slots that ``variables`` names; a slot
    without a variable keeps its value.
    """

    name: str
    description: str
    model: Model
    model_index: Index
    model_real: Real
    state: State
    state_index: Index
    state_real: Real
    scratch: Scratch
    scratch_index: Index
    scratch_real: Real
    parameters: Real
    inputs: Real
    outputs: Real
    variables: tuple[Variable, ...]
    start_time: float
    stop_time: float
    step_size: float
    source: bytes  # the scene file as it was read


def start_values(size: int, variables: tuple[Variable, ...], block: str) -> Real:
    """Start vector of one block, shape [size]."""
    values = np.zeros(size)
    for variable in variables:
        if variable.block == block:
            values[variable.slot] = variable.start
    return values
