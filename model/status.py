"""The status codes of a step and what they tell the user: one table for Python and C.

A kernel returns a code and may leave up to two figures in ``scratch.detail``; the message names them.
"""

from typing import NamedTuple

OK = 0
NONFINITE_INPUT = 1
ZERO_QUATERNION = 2
PARAMETER_RANGE = 3
TOO_MANY_PAIRS = 4
SUBSTEP_BUDGET = 5
NONFINITE_STATE = 6
ENERGY_GAIN = 7
STEP_SIZE = 8
NONFINITE_OUTPUT = 9
TOO_MANY_POINTS = 10
ENERGY_SUM = 11
ENERGY_RETURNED = 12


class Status(NamedTuple):
    """One outcome of a step.

    ``message`` is a printf format with exactly two ``%g``, filled from ``scratch.detail[0:2]``. ``discard`` says
    that the step could not be done but a smaller one could (fmi2Discard); every other code but ``OK`` is fmi2Error.
    """

    code: int
    name: str
    discard: bool
    message: str


STATUSES = (
    Status(OK, "ok", False, "the step was done (%g, %g)"),
    Status(
        NONFINITE_INPUT,
        "nonfinite_input",
        False,
        "input slot %g is %g: every input must be finite and between -1e6 and 1e6. The step was not begun; set the "
        "input and call again",
    ),
    Status(
        ZERO_QUATERNION,
        "zero_quaternion",
        False,
        "the orientation of instrument %g has norm %g: a quaternion w,x,y,z needs a norm above 1e-6. "
        "The step was not begun; the identity is 1,0,0,0",
    ),
    Status(
        PARAMETER_RANGE,
        "parameter_range",
        False,
        "parameter slot %g is %g, outside its range. The step was not begun",
    ),
    Status(
        TOO_MANY_PAIRS,
        "too_many_pairs",
        False,
        "collision detection found more than %g intersecting triangle pairs (contact %g): the state from before the "
        "step stays. Raise solver.max_pairs in the scene, or use a coarser instrument mesh",
    ),
    Status(
        SUBSTEP_BUDGET,
        "substep_budget",
        True,
        "a stable step needs %g substeps and the scene allows %g: the state from before the step stays. Take a "
        "smaller communication step, lower the stiffness, raise the density, or raise solver.max_substeps",
    ),
    Status(
        NONFINITE_STATE,
        "nonfinite_state",
        False,
        "the step would have left a non-finite state, or one beyond 1e6 m (first at tissue vertex %g, value %g): the "
        "state from before the step stays. Lower the stiffness or damping, or lower solver.safety",
    ),
    Status(
        ENERGY_GAIN,
        "energy_gain",
        True,
        "the step would have gained %g J from nowhere, and %g J are allowed: the state from before the step stays. "
        "Take a smaller communication step, or lower solver.safety or the stiffness",
    ),
    Status(
        STEP_SIZE,
        "step_size",
        False,
        "the communication step is %g s: it must be 0, or from 1e-100 s to %g s. The step was not begun",
    ),
    Status(
        NONFINITE_OUTPUT,
        "nonfinite_output",
        False,
        "the step would have left an output that is not finite (slot %g, value %g): the state from before the step "
        "stays. Lower the stiffness or damping, or move the instruments less far",
    ),
    Status(
        TOO_MANY_POINTS,
        "too_many_points",
        False,
        "the contacts press more than %g points at once (%g): the state from before the step stays. Raise "
        "solver.max_pairs in the scene, or a contact's quadrature_spacing",
    ),
    Status(
        ENERGY_SUM,
        "energy_sum",
        True,
        "with this step %g J would have come from nowhere since the start, and %g J are allowed, solver.energy_gain "
        "times what was put in, what one late detection may find and the swing of the scheme: the state from before "
        "the step stays. Use response distance_field, damp the tissue more, lower solver.safety, or raise "
        "solver.energy_gain",
    ),
    Status(
        ENERGY_RETURNED,
        "energy_returned",
        True,
        "with this step the bodies would have got back %g J since the start, and %g J are allowed, what was put in and "
        "what one late detection may find: the state from before the step stays. Use response distance_field, shorten "
        "solver.detection_period, damp the tissue more, or raise solver.energy_gain",
    ),
)
