"""One communication step, read from top to bottom: check, choose the substeps, run them, account, give outputs.

The entries `initialize` and `step` are what Python, the FMU and every study call.
"""

import math

from tissue_contact.kernels.compiled import inner, kernel
from tissue_contact.kernels.detection import detect
from tissue_contact.kernels.integration import advance, damp_springs, drift, undamped_limit
from tissue_contact.kernels.response import respond
from tissue_contact.kernels.slots import (
    AREAL_DENSITY,
    COMMON_OUTPUTS,
    CONTACT_DAMPING,
    CONTACT_PARAMETERS,
    CONTACT_POINT,
    CONTACT_STIFFNESS,
    CONTACTS,
    DAMPING_SCALE,
    DEPTH,
    DRAG,
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
    INSTRUMENT_OUTPUTS,
    MEAN_FORCE,
    PAIRS,
    POSE,
    REJECTED_PAIRS,
    STIFFNESS_SCALE,
    SUBSTEPS,
    SUPPORT_DAMPING,
    SUPPORT_STIFFNESS,
    TISSUE_PARAMETERS,
    TORQUE,
)
from tissue_contact.kernels.springs import add_springs, spring_energy
from tissue_contact.kernels.touch import find_touches
from tissue_contact.kernels.vectors import rotation, turn_between, turned
from tissue_contact.status import (
    NONFINITE_INPUT,
    NONFINITE_STATE,
    OK,
    PARAMETER_RANGE,
    SUBSTEP_BUDGET,
    ZERO_QUATERNION,
)

QUATERNION_NORM_MIN = 1e-6


@inner
def _check(parameters, inputs, scratch):
    """Refuse what no step can be made of; the instruments' poses, normalised, go to scratch.pose."""
    for k in range(inputs.size):
        if not math.isfinite(inputs[k]):
            scratch.detail[0], scratch.detail[1] = k, inputs[k]
            return NONFINITE_INPUT
    for k in range(parameters.size):
        if not (math.isfinite(parameters[k]) and parameters[k] >= 0.0):
            scratch.detail[0], scratch.detail[1] = k, parameters[k]
            return PARAMETER_RANGE
    for i in range(inputs.size // POSE):
        q = POSE * i + 3
        norm = math.sqrt(
            inputs[q] * inputs[q]
            + inputs[q + 1] * inputs[q + 1]
            + inputs[q + 2] * inputs[q + 2]
            + inputs[q + 3] * inputs[q + 3]
        )
        if not (norm >= QUATERNION_NORM_MIN and math.isfinite(norm)):
            scratch.detail[0], scratch.detail[1] = i, norm
            return ZERO_QUATERNION
        for k in range(3):
            scratch.pose[POSE * i + k] = inputs[POSE * i + k]
        for k in range(4):
            scratch.pose[q + k] = inputs[q + k] / norm
    return OK


@inner
def stable_substep(model, parameters, state):
    """Largest stable substep [s], over all the tissues.

    omega^2 is bounded by the springs' largest eigenvalue plus the support plus the contact stiffness, had one vertex
    to bear all of it for every part of the instrument, or what it bears now where pairs are not weighted. Where a
    contact is damped its stiffness counts twice: its damper, implicit by itself, is taken at the velocity before the
    springs' kick, and the limit omega dt = sqrt(2 (2 + z) / (1 + z)) falls to sqrt(2) for large z = dt c G.
    """
    limit = math.inf
    tissues = model.tissue_rate.size
    for n in range(tissues):
        own = TISSUE_PARAMETERS * n
        density = parameters[own + AREAL_DENSITY]
        square = parameters[own + STIFFNESS_SCALE] * model.tissue_rate[n] + parameters[own + SUPPORT_STIFFNESS]
        for k in range(model.contact_tissue.size):
            if model.contact_tissue[k] == n:
                pair = TISSUE_PARAMETERS * tissues + CONTACT_PARAMETERS * k
                i = model.contact_instrument[k]
                parts = int(model.instrument_part_start[i + 1]) - int(model.instrument_part_start[i])
                load = max(parts / model.tissue_node_area_min[n], state.touch_load[k])
                count = 2.0 if parameters[pair + CONTACT_DAMPING] > 0.0 else 1.0
                square += count * parameters[pair + CONTACT_STIFFNESS] * load
        limit = min(limit, undamped_limit(square / density))
    return limit


@inner
def _substeps(model, parameters, state, h, scratch):
    """Number of substeps of a step h, 0 where the budget does not allow it."""
    if model.substeps_fixed[0] > 0:
        return int(model.substeps_fixed[0])
    needed = math.ceil(h / (model.safety[0] * stable_substep(model, parameters, state)))
    if not needed <= model.substeps_max[0]:
        scratch.detail[0], scratch.detail[1] = needed, model.substeps_max[0]
        return 0
    return max(1, int(needed))


@inner
def _pose(state, scratch, i, elapsed):
    """Rotation matrix and position of instrument i, elapsed [s] after the last communication point."""
    p, m = POSE * i, 6 * i
    q = turned(
        (state.pose[p + 3], state.pose[p + 4], state.pose[p + 5], state.pose[p + 6]),
        (
            elapsed * scratch.motion[m + 3],
            elapsed * scratch.motion[m + 4],
            elapsed * scratch.motion[m + 5],
        ),
    )
    return rotation(q), (
        state.pose[p] + elapsed * scratch.motion[m],
        state.pose[p + 1] + elapsed * scratch.motion[m + 1],
        state.pose[p + 2] + elapsed * scratch.motion[m + 2],
    )


@inner
def _settle(state, scratch):
    """The poses of the inputs are those of the last communication point now."""
    for k in range(state.pose.size):
        state.pose[k] = scratch.pose[k]


@inner
def _detect_all(model, state, scratch, elapsed):
    for k in range(model.contact_instrument.size):
        r, p = _pose(state, scratch, model.contact_instrument[k], elapsed)
        status = detect(model, state, scratch, k, r, p)
        if status != OK:
            return status
        find_touches(model, state, scratch, k, r)
    state.since_detection[0] = 0.0
    return OK


@inner
def _respond_all(model, parameters, state, scratch, elapsed, dt):
    """Contact forces of all the pairs; the energy stored in them [J]."""
    for k in range(scratch.contact.size):
        scratch.contact[k] = 0.0
    stored = 0.0
    for k in range(model.contact_instrument.size):
        if state.touches[k] > 0:
            i = model.contact_instrument[k]
            r, p = _pose(state, scratch, i, elapsed)
            m = scratch.motion[6 * i : 6 * i + 6]
            stored += respond(model, parameters, state, scratch, k, r, p, (m[0], m[1], m[2]), (m[3], m[4], m[5]), dt)
    return stored


@inner
def _tissue_forces(model, parameters, state, scratch):
    for v in range(state.x.size):
        scratch.fx[v] = 0.0
        scratch.fy[v] = 0.0
        scratch.fz[v] = 0.0
    for n in range(model.tissue_rate.size):
        add_springs(
            model.tissue_spring_start[n],
            model.tissue_spring_start[n + 1],
            model.spring_i,
            model.spring_j,
            model.spring_rest,
            model.spring_stiffness,
            parameters[TISSUE_PARAMETERS * n + STIFFNESS_SCALE],
            state.x,
            state.y,
            state.z,
            scratch.fx,
            scratch.fy,
            scratch.fz,
        )


@inner
def _advance_all(model, parameters, state, scratch, dt):
    for n in range(model.tissue_rate.size):
        own = TISSUE_PARAMETERS * n
        first, last = model.tissue_vertex_start[n], model.tissue_vertex_start[n + 1]
        density = parameters[own + AREAL_DENSITY]
        drag = (parameters[own + DRAG] + parameters[own + SUPPORT_DAMPING]) / density
        damped = scratch.solve.size > 0 and parameters[own + DAMPING_SCALE] > 0.0
        advance(
            first,
            last,
            dt,
            0.0 if damped else dt,
            1.0 if damped else 1.0 / (1.0 + dt * drag),
            density,
            parameters[own + SUPPORT_STIFFNESS] / density,
            model.gravity,
            model.rest_x,
            model.rest_y,
            model.rest_z,
            model.node_area,
            model.node_free,
            model.node_mobility,
            scratch.fx,
            scratch.fy,
            scratch.fz,
            state.x,
            state.y,
            state.z,
            state.vx,
            state.vy,
            state.vz,
            scratch.loss,
            drag > 0.0 and not damped,
        )
        if damped:
            damp_springs(
                first,
                last,
                model.tissue_spring_start[n],
                model.tissue_spring_start[n + 1],
                dt,
                density,
                drag,
                model.spring_i,
                model.spring_j,
                model.spring_damping,
                parameters[own + DAMPING_SCALE],
                state.x,
                state.y,
                state.z,
                scratch.unit_x,
                scratch.unit_y,
                scratch.unit_z,
                model.node_area,
                model.node_free,
                model.node_mobility,
                state.vx,
                state.vy,
                state.vz,
                scratch.solve,
                scratch.loss,
            )
            drift(first, last, dt, state.x, state.y, state.z, state.vx, state.vy, state.vz)


@inner
def _tissue_energies(model, parameters, state):
    """Kinetic and elastic energy [J] of the tissue; springs, support and weight are the elastic part."""
    kinetic, elastic = 0.0, 0.0
    g = model.gravity
    for n in range(model.tissue_rate.size):
        own = TISSUE_PARAMETERS * n
        density, support = parameters[own + AREAL_DENSITY], parameters[own + SUPPORT_STIFFNESS]
        elastic += spring_energy(
            model.tissue_spring_start[n],
            model.tissue_spring_start[n + 1],
            model.spring_i,
            model.spring_j,
            model.spring_rest,
            model.spring_stiffness,
            parameters[own + STIFFNESS_SCALE],
            state.x,
            state.y,
            state.z,
        )
        for v in range(model.tissue_vertex_start[n], model.tissue_vertex_start[n + 1]):
            dx, dy, dz = state.x[v] - model.rest_x[v], state.y[v] - model.rest_y[v], state.z[v] - model.rest_z[v]
            square = state.vx[v] * state.vx[v] + state.vy[v] * state.vy[v] + state.vz[v] * state.vz[v]
            kinetic += 0.5 * density * model.node_area[v] * square
            elastic += model.node_area[v] * (
                0.5 * support * (dx * dx + dy * dy + dz * dz) - density * (g[0] * dx + g[1] * dy + g[2] * dz)
            )
    return kinetic, elastic


@inner
def _give(model, parameters, state, scratch, h, substeps, outputs):
    """Fill the outputs for the end of the step: elapsed h after the last communication point, still in the state."""
    contact = _respond_all(model, parameters, state, scratch, h, 0.0)
    instruments = state.pose.size // POSE
    for i in range(instruments):
        o, c = INSTRUMENT_OUTPUTS * i, GATHER * i
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
    o = INSTRUMENT_OUTPUTS * instruments
    kinetic, elastic = _tissue_energies(model, parameters, state)
    outputs[o + ENERGY_KINETIC] = kinetic
    outputs[o + ENERGY_ELASTIC] = elastic
    outputs[o + ENERGY_CONTACT] = contact
    outputs[o + ENERGY_DISSIPATED] = state.dissipated[0]
    outputs[o + ENERGY_WORK] = state.work[0]
    outputs[o + ENERGY_BALANCE] = (
        state.work[0] - state.dissipated[0] - (kinetic + elastic + contact - state.energy_start[0])
    )
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


@kernel
def initialize(model, parameters, state, inputs, outputs, scratch):
    """Put the instruments at the poses of the inputs, at rest, find their contacts and give the outputs.

    ``state`` must hold the start state; arguments and result as for `step`.
    """
    status = _check(parameters, inputs, scratch)
    if status != OK:
        return status
    _settle(state, scratch)
    scratch.motion[:] = 0.0
    status = _detect_all(model, state, scratch, 0.0)
    if status != OK:
        return status
    state.work[0] = 0.0
    state.dissipated[0] = 0.0
    state.energy_start[0] = 0.0
    _give(model, parameters, state, scratch, 0.0, 0.0, outputs)
    # What is stored before anything moved is where the balance starts from.
    state.energy_start[0] = -outputs[INSTRUMENT_OUTPUTS * (state.pose.size // POSE) + ENERGY_BALANCE]
    outputs[INSTRUMENT_OUTPUTS * (state.pose.size // POSE) + ENERGY_BALANCE] = 0.0
    return OK


@kernel
def step(model, parameters, state, inputs, h, outputs, scratch):
    """Advance the scene by one communication step.

    Parameters
    ----------
    model : Model
    parameters, inputs, outputs : float64 arrays
        Laid out by `slots`, in SI units.
    state : State
        Changed in place; after a status other than `OK` it is not to be used, the caller keeps a copy.
    h : float
        Step [s]. The instruments move evenly from their poses at the last communication point to those of
        ``inputs``. 0 refreshes the outputs and leaves the state as it is.
    scratch : Scratch

    Returns
    -------
    int
        A code of `tissue_contact.status`.
    """
    status = _check(parameters, inputs, scratch)
    if status != OK:
        return status
    scratch.motion[:] = 0.0
    scratch.pulse[:] = 0.0
    if h == 0.0:
        _give(model, parameters, state, scratch, 0.0, 0.0, outputs)
        return OK
    substeps = _substeps(model, parameters, state, h, scratch)
    if substeps == 0:
        return SUBSTEP_BUDGET
    for i in range(state.pose.size // POSE):
        p, m = POSE * i, 6 * i
        for k in range(3):
            scratch.motion[m + k] = (scratch.pose[p + k] - state.pose[p + k]) / h
        turn = turn_between(
            (state.pose[p + 3], state.pose[p + 4], state.pose[p + 5], state.pose[p + 6]),
            (scratch.pose[p + 3], scratch.pose[p + 4], scratch.pose[p + 5], scratch.pose[p + 6]),
        )
        scratch.motion[m + 3] = turn[0] / h
        scratch.motion[m + 4] = turn[1] / h
        scratch.motion[m + 5] = turn[2] / h
    scratch.loss[:] = 0.0
    dt = h / substeps
    for n in range(substeps):
        _tissue_forces(model, parameters, state, scratch)
        _respond_all(model, parameters, state, scratch, n * dt, dt)
        for i in range(state.pose.size // POSE):
            for k in range(3):
                scratch.pulse[3 * i + k] += dt * scratch.contact[GATHER * i + GATHER_FORCE + k]
        _advance_all(model, parameters, state, scratch, dt)
        state.since_detection[0] += dt
        # Half a substep of slack: the sum of the substeps only rounds to the period.
        if state.since_detection[0] >= model.detection_period[0] - 0.5 * dt:
            status = _detect_all(model, state, scratch, (n + 1) * dt)
            if status != OK:
                return status
    for v in range(state.x.size):
        state.dissipated[0] += scratch.loss[v]
        total = state.x[v] + state.y[v] + state.z[v] + state.vx[v] + state.vy[v] + state.vz[v]
        if not math.isfinite(total):
            scratch.detail[0], scratch.detail[1] = v, total
            return NONFINITE_STATE
    _give(model, parameters, state, scratch, h, substeps, outputs)
    _settle(state, scratch)
    return OK
