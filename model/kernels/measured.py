"""The step with its parts done again, as often as three more parameters say: what a part costs is the difference.

Built into an FMU by the benchmark only. No time passes in the repeats, so they change neither motion nor outputs.
"""

from tissue_contact.kernels.compiled import kernel
from tissue_contact.kernels.forces import clear_contacts, contact_forces, detect_all, tissue_forces
from tissue_contact.kernels.occupancy import ANYWHERE
from tissue_contact.kernels.slots import BODY_OUTPUTS, POSE, SUBSTEPS
from tissue_contact.kernels.step import initialize
from tissue_contact.kernels.step import step as plain_step
from tissue_contact.kernels.symplectic import symplectic_euler

__all__ = ["initialize", "step"]

REPEATS = ("detection", "response", "tissue")  # the last parameters, in this order


@kernel
def step(model, parameters, state, inputs, h, outputs, scratch):
    """`tissue_contact.kernels.step.step`, then the repeats."""
    n = parameters.size - 3
    status = plain_step(model, parameters, state, inputs, h, outputs, scratch)
    substeps = int(outputs[BODY_OUTPUTS * (state.pose.size // POSE) + SUBSTEPS])
    for _ in range(int(parameters[n])):
        for k in range(state.tissue_way.size if substeps > 1 else 0):
            state.tissue_way[k] = ANYWHERE  # no more is known between two detections than in the step
        detect_all(model, state, scratch, 0.0, 0.0)
    for _ in range(int(parameters[n + 1]) * substeps):
        clear_contacts(state, scratch)
        contact_forces(model, parameters, state, scratch, 0.0, 0.0, False)
    for _ in range(int(parameters[n + 2]) * substeps):
        tissue_forces(model, parameters, state, scratch)
        symplectic_euler(model, parameters, state, scratch, 0.0)
    return status
