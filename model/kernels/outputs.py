"""What a step tells: the outputs at one moment."""

from tissue_contact.kernels.compiled import inner
from tissue_contact.kernels.energy import tissue_energies
from tissue_contact.kernels.forces import add_pulse, body_forces, clear_contacts, contact_forces
from tissue_contact.kernels.slots import (
    BODY_OUTPUTS,
    COMMON_OUTPUTS,
    CONTACT_POINT,
    CONTACTS,
    DEPTH,
    ENERGY_BALANCE,
    ENERGY_CONTACT,
    ENERGY_DISSIPATED,
    ENERGY_ELASTIC,
    ENERGY_KINETIC,
    ENERGY_WORK,
    FORCE,
    GATHER,
    GATHER_DEPTH,
    GATHER_FORCE,
    GATHER_POINT,
    GATHER_REGIONS,
    GATHER_SIZE,
    GATHER_TORQUE,
    MEAN_FORCE,
    PAIRS,
    POSE,
    REJECTED_PAIRS,
    SUBSTEPS,
    TORQUE,
)


@inner
def give(model, parameters, state, scratch, h, tau, substeps, outputs):
    """Fill the outputs for the end of a step: elapsed h after the last communication point, still in the state.

    For a time ``tau`` [s] before it what the contacts do now is what they did: impulse, work and dissipation.

    Returns
    -------
    float
        Energy stored in tissue, contacts and holds [J].
    """
    clear_contacts(state, scratch)
    contact = contact_forces(model, parameters, state, scratch, h, tau, False)
    add_pulse(scratch, tau)
    contact += body_forces(model, parameters, state, scratch, h, 0.0)
    bodies = state.pose.size // POSE
    for i in range(bodies):
        o, c = BODY_OUTPUTS * i, GATHER * i
        for k in range(3):
            outputs[o + FORCE + k] = scratch.contact[c + GATHER_FORCE + k]
            outputs[o + TORQUE + k] = scratch.contact[c + GATHER_TORQUE + k]
            outputs[o + MEAN_FORCE + k] = (
                scratch.pulse[3 * i + k] / h if h > 0.0 else scratch.contact[c + GATHER_FORCE + k]
            )
            outputs[o + CONTACT_POINT + k] = (
                scratch.contact[c + GATHER_POINT + k] / scratch.contact[c + GATHER_SIZE]
                if scratch.contact[c + GATHER_SIZE] > 0.0
                else 0.0
            )
        outputs[o + DEPTH] = scratch.contact[c + GATHER_DEPTH]
        outputs[o + CONTACTS] = scratch.contact[c + GATHER_REGIONS]
    o = BODY_OUTPUTS * bodies
    kinetic, elastic = tissue_energies(model, parameters, state)
    stored = kinetic + elastic + contact
    outputs[o + ENERGY_KINETIC] = kinetic
    outputs[o + ENERGY_ELASTIC] = elastic
    outputs[o + ENERGY_CONTACT] = contact
    outputs[o + ENERGY_DISSIPATED] = state.dissipated[0]
    outputs[o + ENERGY_WORK] = state.work[0]
    outputs[o + ENERGY_BALANCE] = state.work[0] - state.dissipated[0] - (stored - state.energy_start[0])
    outputs[o + SUBSTEPS] = substeps
    outputs[o + REJECTED_PAIRS] = 0.0
    outputs[o + PAIRS] = 0.0
    for k in range(state.pairs.size):
        outputs[o + REJECTED_PAIRS] += state.rejected[k]
        outputs[o + PAIRS] += state.pairs[k]
    o += COMMON_OUTPUTS
    for k in range(model.probe_triangle.size):
        t = model.probe_triangle[k]
        a, b, c = model.triangle_a[t], model.triangle_b[t], model.triangle_c[t]
        wa, wb, wc = model.probe_weight[3 * k], model.probe_weight[3 * k + 1], model.probe_weight[3 * k + 2]
        outputs[o + 3 * k] = wa * state.x[a] + wb * state.x[b] + wc * state.x[c]
        outputs[o + 3 * k + 1] = wa * state.y[a] + wb * state.y[b] + wc * state.y[c]
        outputs[o + 3 * k + 2] = wa * state.z[a] + wb * state.z[b] + wc * state.z[c]
    o += 3 * model.probe_triangle.size
    for k in range(o, outputs.size):
        outputs[k] = 0.0
    for g in range(model.grasp_body.size):
        outputs[o + model.grasp_grasper[g]] += state.held[g]
    return stored
