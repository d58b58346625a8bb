"""One communication step, read from top to bottom: check, jaws, substeps, account, give outputs.

The entries `initialize` and `step` are what Python, the FMU and every study call.
"""

import math

from tissue_contact.kernels.collision import FIELD, LITERAL, PRIMITIVE, body_face, body_size
from tissue_contact.kernels.compiled import inner, kernel, pointwise
from tissue_contact.kernels.contact import contact_slots
from tissue_contact.kernels.damping import count_damping, damp_contacts
from tissue_contact.kernels.energy import weight_energy
from tissue_contact.kernels.explicit import explicit_euler, runge_kutta
from tissue_contact.kernels.factor import ready
from tissue_contact.kernels.forces import (
    add_pulse,
    body_forces,
    clear_contacts,
    contact_forces,
    detect_all,
    pose_of,
    tissue_forces,
    turn_all,
)
from tissue_contact.kernels.grasp import close, open_jaws, slide
from tissue_contact.kernels.implicit import implicit_euler
from tissue_contact.kernels.laws import KELVIN_VOIGT
from tissue_contact.kernels.near import is_by_motion
from tissue_contact.kernels.occupancy import ANYWHERE
from tissue_contact.kernels.outputs import give
from tissue_contact.kernels.projective import projective_dynamics
from tissue_contact.kernels.slots import (
    AREAL_DENSITY,
    BODY_OUTPUTS,
    CONTACT_EXPONENT,
    CONTACT_STIFFNESS,
    ENERGY_BALANCE,
    POSE,
    SUPPORT_STIFFNESS,
    TISSUE_PARAMETERS,
)
from tissue_contact.kernels.stability import (
    EXPLICIT_EULER,
    IMPLICIT_EULER,
    PROJECTIVE_DYNAMICS,
    RUNGE_KUTTA_4,
    SYMPLECTIC_EULER,
    motion_rate,
    stable_substep,
    travel,
)
from tissue_contact.kernels.sums import square, sum_of
from tissue_contact.kernels.symplectic import symplectic_euler
from tissue_contact.kernels.vectors import turn_between
from tissue_contact.status import (
    ENERGY_GAIN,
    ENERGY_RETURNED,
    ENERGY_SUM,
    NONFINITE_INPUT,
    NONFINITE_OUTPUT,
    NONFINITE_STATE,
    OK,
    PARAMETER_RANGE,
    STEP_SIZE,
    SUBSTEP_BUDGET,
    TOO_MANY_POINTS,
    ZERO_QUATERNION,
)

QUATERNION_NORM_MIN = 1e-6
INPUT_MAX = 1e6  # [m, 1] size of an input: beyond any scene, and no square or product of a few overflows
PLACE_MAX = 1e6  # [m] sum of the coordinates of a vertex
STEP_MIN, STEP_MAX = 1e-100, 1e6  # [s] between them no speed overflows and no time is lost
SWING = 10.0  # symplectic Euler at the share s of its stable limit lets the energy of a motion swing by 1 / (1 - s²)
HELD = 0.5  # of what may move between two detections, the rest is for tissue that gets faster within a substep
LATE = 1e-3  # [s] after which greatest speeds and sides are looked at anew within a step
CALM = 0.2  # of the way in a substep above which motion is resolved: once it is, that below which it no longer is
UNEXPLAINED = 0.01  # of what was put in that the bodies may get back without it: errors of the schemes
ROUNDING = 1e-12  # of the energies that a balance is the difference of, and [J], that rounding may gain


@inner
def _check(model, parameters, inputs, scratch):
    """Refuse what no step can be made of; the instruments' poses, normalised, go to scratch.pose."""
    for k in range(inputs.size):
        if not abs(inputs[k]) <= INPUT_MAX:  # holds for not-a-number too
            scratch.detail[0], scratch.detail[1] = k, inputs[k]
            return NONFINITE_INPUT
    for k in range(parameters.size):
        if not (math.isfinite(parameters[k]) and parameters[k] >= 0.0):
            scratch.detail[0], scratch.detail[1] = k, parameters[k]
            return PARAMETER_RANGE
    for i in range(model.instruments[0]):
        q = POSE * i + 3
        norm = math.sqrt(
            inputs[q] * inputs[q]
            + inputs[q + 1] * inputs[q + 1]
            + inputs[q + 2] * inputs[q + 2]
            + inputs[q + 3] * inputs[q + 3]
        )
        if not norm >= QUATERNION_NORM_MIN:
            scratch.detail[0], scratch.detail[1] = i, norm
            return ZERO_QUATERNION
        for k in range(3):
            scratch.pose[POSE * i + k] = inputs[POSE * i + k]
        for k in range(4):
            scratch.pose[q + k] = inputs[q + k] / norm
    return OK


@pointwise
def _runs_off(state, v):
    """Whether a vertex is too far away or is no number, and the figure that says so."""
    size = abs(state.x[v]) + abs(state.y[v]) + abs(state.z[v])
    total = size + state.vx[v] + state.vy[v] + state.vz[v]
    return (not size <= PLACE_MAX) | (not math.isfinite(total)), total


@inner
def _greatest_speed(vx, vy, vz):
    """Greatest speed [m/s] of some vertices."""
    a, b, c, d = 0.0, 0.0, 0.0, 0.0
    fours = vx.size // 4
    for k in range(fours):  # one maximum alone would wait for the one before
        a, b = max(a, square(vx, vy, vz, 4 * k)), max(b, square(vx, vy, vz, 4 * k + 1))
        c, d = max(c, square(vx, vy, vz, 4 * k + 2)), max(d, square(vx, vy, vz, 4 * k + 3))
    for v in range(4 * fours, vx.size):
        a = max(a, square(vx, vy, vz, v))
    return math.sqrt(max(a, b, c, d))


@inner
def _check_state(model, state, scratch):
    """Note the greatest speeds of tissues in contact, and refuse a tissue that runs off.

    Before a detection as well: triangles far away would meet every cell of a body.
    """
    for n in range(model.tissue_rate.size):
        if model.tissue_block_start[n + 1] == model.tissue_block_start[n]:
            continue
        first, last = model.tissue_vertex_start[n], model.tissue_vertex_start[n + 1]
        state.tissue_speed[n] = _greatest_speed(state.vx[first:last], state.vy[first:last], state.vz[first:last])
    any_lost = False
    for v in range(state.x.size):  # with no way out it runs in vectors
        any_lost |= _runs_off(state, v)[0]
    if any_lost:
        for v in range(state.x.size):
            lost, total = _runs_off(state, v)
            if lost:
                scratch.detail[0], scratch.detail[1] = v, total
                return NONFINITE_STATE
    return OK


@inner
def _is_due(model, state, scratch, dt):
    """Whether a detection comes after this substep ``dt`` [s], or by motion before the next one, which goes as fast."""
    rate = motion_rate(model, state, scratch, True) if model.continuous[0] == 1 else 0.0
    if is_by_motion(model):
        return state.moved[0] + 2.0 * dt * rate > HELD
    # Half a substep of slack: the sum of the substeps only rounds to the period.
    since, slack = state.since_detection[0] + dt, 0.5 * dt
    return since >= model.detection_period[0] - slack or (since + dt + slack) * rate >= 1.0


@inner
def _look(model, state, scratch, elapsed, dt, checked):
    """Find what may be touched from the time ``elapsed`` [s] of a step on, in substeps of ``dt`` [s]; the status.

    The state is checked before, if it is not ``checked``.
    """
    status = OK if checked else _check_state(model, state, scratch)
    if status != OK:
        return status
    ahead = dt * motion_rate(model, state, scratch, True) if is_by_motion(model) else 1.0
    return detect_all(model, state, scratch, elapsed, ahead)


@inner
def _note_motion(model, state, scratch, dt, known):
    """Add to what has moved since the last detection; how far is ``known`` where dt was gone with the speeds of now."""
    state.since_detection[0] += dt
    state.moved[0] += dt * motion_rate(model, state, scratch, True)
    for n in range(model.tissue_rate.size):
        state.tissue_way[n] += dt * state.tissue_speed[n] if known else ANYWHERE


@inner
def _check_outputs(outputs, scratch):
    """Refuse a step whose outputs overflow, though its state does not."""
    for k in range(outputs.size):
        if not math.isfinite(outputs[k]):
            scratch.detail[0], scratch.detail[1] = k, outputs[k]
            return NONFINITE_OUTPUT
    return OK


@inner
def _settle(state, scratch):
    """The poses of the inputs are those of the last communication point now."""
    for k in range(scratch.pose.size):
        state.pose[k] = scratch.pose[k]


@inner
def _move(model, state, scratch, h):
    """Velocities with which the instruments get to the poses of the inputs in a time h; rigid bodies stand still."""
    for i in range(model.instruments[0]):
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


@inner
def _work_jaws(model, parameters, state, scratch, inputs):
    """Close and open the jaws as the inputs say, at the last communication point."""
    for g in range(model.grasp_body.size):
        jaw = inputs[POSE * model.instruments[0] + model.grasp_grasper[g]]
        r, p = pose_of(state, scratch, model.grasp_body[g], 0.0)
        if state.closed[g] == 0 and jaw < model.grasp_close[g]:
            state.closed[g] = 1
            close(model, state, g, r, p)
        elif state.closed[g] == 1 and jaw > model.grasp_open[g]:
            state.closed[g] = 0
            open_jaws(model, parameters, state, g, r, p)


@inner
def _tune(model, parameters, state, scratch, outputs):
    """Where parameters were changed since the last step, take what that did to the stored energy as given."""
    changed = False
    for k in range(state.tuned.size):
        changed = changed or state.tuned[k] != parameters[k]
        state.tuned[k] = parameters[k]
    if changed:
        stored = give(model, parameters, state, scratch, 0.0, 0.0, 0, outputs)
        state.energy_start[0] += stored - state.stored[0]
        state.put_in[0] += max(0.0, stored - state.stored[0])
        state.stored[0] = stored


@inner
def _substeps(model, parameters, state, h, scheme, scratch):
    """Number of substeps of a scheme in a step h, 0 where the budget does not allow it."""
    if model.substeps_fixed[0] > 0:
        return int(model.substeps_fixed[0])
    needed = h / (model.safety[0] * stable_substep(model, parameters, state, scratch, scheme, h))
    if model.continuous[0] == 1:
        needed = max(needed, h * motion_rate(model, state, scratch, False))
    # Compared before it becomes an integer, which not every number fits into.
    if not needed <= model.substeps_max[0]:
        whole = math.ceil(needed) if needed < 1e15 else needed
        scratch.detail[0], scratch.detail[1] = whole, model.substeps_max[0]
        return 0
    substeps = max(1, math.ceil(needed))
    if scheme == PROJECTIVE_DYNAMICS:
        # a factor serves one length of substep: few lengths, few factors
        even = 1
        while even < substeps:
            even *= 2
        substeps = min(even, int(model.substeps_max[0]))
    return substeps


@inner
def _substep(model, parameters, state, scratch, scheme, elapsed, dt, longest, untold):
    """Advance all the tissues by dt, and count impulse, work and dissipation, but for those of an ``untold`` time.

    Returns
    -------
    bool
        Whether it was done: not by projective dynamics where a vertex moves too fast for a way of ``longest`` [m].
    """
    if scheme == RUNGE_KUTTA_4:
        runge_kutta(model, parameters, state, scratch, elapsed, dt)
    elif scheme in (IMPLICIT_EULER, PROJECTIVE_DYNAMICS):
        if scheme == IMPLICIT_EULER:
            implicit_euler(model, parameters, state, scratch, elapsed, dt)
        else:
            if not projective_dynamics(model, parameters, state, scratch, elapsed, dt, longest):
                return False
            if untold == 0.0:
                clear_contacts(state, scratch)
                contact_forces(model, parameters, state, scratch, elapsed + dt, dt, False)
        if untold == 0.0:
            add_pulse(scratch, dt)
    else:
        tissue_forces(model, parameters, state, scratch)
        clear_contacts(state, scratch)
        split = scheme != EXPLICIT_EULER
        contact_forces(model, parameters, state, scratch, elapsed, dt, split)
        if split:
            damp_contacts(model, parameters, state, scratch, elapsed, dt)
            symplectic_euler(model, parameters, state, scratch, dt)
            count_damping(model, parameters, state, scratch, dt)
        else:
            explicit_euler(model, parameters, state, scratch, dt)
        add_pulse(scratch, dt)
    for g in range(model.grasp_body.size):
        if state.held[g] > 0:
            r, p = pose_of(state, scratch, model.grasp_body[g], elapsed + dt)
            slide(model, parameters, state, g, r, p)
    return True


@inner
def _is_told_by_outputs(model, scheme):
    """Whether the forces at the end of a step, which the outputs need anyway, are those of its last substep.

    Not where holds slide in between, or where a detection in between may find what the tissue has not felt.
    """
    for k in range(model.contact_body.size):
        if model.contact_response[k] < FIELD:
            return False
    return scheme == PROJECTIVE_DYNAMICS and model.grasp_body.size == 0 and model.continuous[0] == 1


@inner
def _clash(model, parameters, state, scratch, elapsed, dt):
    """Count what rigid bodies do to each other within dt; the forces at its middle make the sums of second order."""
    clear_contacts(state, scratch)
    body_forces(model, parameters, state, scratch, elapsed + 0.5 * dt, dt)
    add_pulse(scratch, dt)


@inner
def _energy_at(model, parameters, k, size, depth):
    """Energy [J] of the spring of contact k at a depth [m] for a size, its share or its area."""
    own = contact_slots(model, k)
    n = 1.0 if model.contact_law[k] == KELVIN_VOIGT else parameters[own + CONTACT_EXPONENT]
    return size * parameters[own + CONTACT_STIFFNESS] * depth ** (n + 1.0) / (n + 1.0)


@inner
def _finds(model, parameters, state, scratch, h, dt):
    """Energy [J] that all contacts may find at once within a step h, and what they usually do.

    A late detection finds a contact at the depth of the thinnest part and of the motion until then, or at the present
    one. The depth of the thesis turns with the motion, and intersecting triangles are at once as deep as they reach:
    both may find all of the body, but usually do not. A field that is looked for as far as the motion goes is found
    within a substep. None is deeper than the body's size: tissue that flies off is no find. A field presses on both
    sides of a fold as large as the greatest face of the body's box; of raw pairs one usually counts, or a slide could
    find all of them again and again.
    """
    most, usual = 0.0, 0.0
    late = h if is_by_motion(model) else max(h, model.detection_period[0])
    for k in range(model.contact_body.size):
        body, response = model.contact_body[k], model.contact_response[k]
        way = travel(model, scratch, k, late)
        depth, size, one = max(model.contact_reach[k] + way, state.deepest[k]), 0.0, 1.0
        if response >= FIELD:
            limit = model.contact_depth[k]
            size = 2.0 * body_face(model, body)
            one = size
        else:
            limit = body_size(model, body)
            first = model.contact_touch_start[k]
            for m in range(first, first + state.touches[k]):
                size += state.touch_share[m]
            size = max(size, 1.0)
        whole = math.inf if response in (LITERAL, PRIMITIVE) else depth
        most += _energy_at(model, parameters, k, size, min(whole, limit))
        if model.continuous[0] == 1 and response >= FIELD:
            depth = travel(model, scratch, k, dt)
        usual += _energy_at(model, parameters, k, one, min(depth, limit))
    return most, usual


@inner
def _swing(model, parameters, state, scratch, h, dt):
    """Energy [J] that symplectic Euler lends a motion at the end of a step and takes back within its period.

    What it keeps of a linear motion is not the energy but that and dt/2 F·v.
    """
    tissue_forces(model, parameters, state, scratch)
    clear_contacts(state, scratch)
    contact_forces(model, parameters, state, scratch, h, 0.0, True)
    g = model.gravity
    power = 0.0
    for n in range(model.tissue_rate.size):
        own = TISSUE_PARAMETERS * n
        density, support = parameters[own + AREAL_DENSITY], parameters[own + SUPPORT_STIFFNESS]
        for v in range(model.tissue_vertex_start[n], model.tissue_vertex_start[n + 1]):
            area = model.node_area[v]
            power += state.vx[v] * (scratch.fx[v] + area * (density * g[0] - support * (state.x[v] - model.rest_x[v])))
            power += state.vy[v] * (scratch.fy[v] + area * (density * g[1] - support * (state.y[v] - model.rest_y[v])))
            power += state.vz[v] * (scratch.fz[v] + area * (density * g[2] - support * (state.z[v] - model.rest_z[v])))
    return max(0.0, -0.5 * dt * power)


@inner
def _check_energy(model, parameters, state, scratch, scheme, h, dt, stored, work, gained):
    """Refuse a step, and a sum of steps, that gains more energy from nowhere than can be explained.

    ``scheme`` and ``dt`` [s] are those of the step's last substep.

    A step: a swing of what was stored before it and of its ``work`` [J], and what late detections may find. All steps:
    what was put in, times a factor of the scene, what one late detection usually finds, at the fastest so far, and the
    swing of what is ``stored`` now [J]. A step that gains nothing is done, whatever was before, unless the bodies have
    got back more with it than was put in and what one late detection usually finds.
    """
    most, usual = _finds(model, parameters, state, scratch, h, dt)
    state.found[0] = max(state.found[0], usual)
    state.gained[0] += gained
    state.returned[0] += max(0.0, -work)
    size = abs(state.stored[0]) + abs(work)
    rounding = ROUNDING * (1.0 + size + abs(state.work[0]) + state.dissipated[0])
    allowed = max(SWING, model.energy_gain[0]) * size + most + rounding
    if not gained <= allowed:
        scratch.detail[0], scratch.detail[1] = gained, allowed
        return ENERGY_GAIN
    put_in, slack = state.put_in[0], state.found[0] + rounding
    allowed = model.energy_gain[0] * put_in + slack
    if gained > rounding and state.gained[0] > allowed and scheme == SYMPLECTIC_EULER:
        # An unstable motion is all swing, a stable one at the share s of its limit a share s at most.
        allowed += min(_swing(model, parameters, state, scratch, h, dt), model.safety[0] * stored)
    if gained > rounding and not state.gained[0] <= allowed:
        scratch.detail[0], scratch.detail[1] = state.gained[0], allowed
        return ENERGY_SUM
    allowed = (max(1.0, model.energy_gain[0]) + UNEXPLAINED) * put_in + slack
    if work < 0.0 and not state.returned[0] <= allowed:
        scratch.detail[0], scratch.detail[1] = state.returned[0], allowed
        return ENERGY_RETURNED
    return OK


@kernel
def initialize(model, parameters, state, inputs, outputs, scratch):
    """Put the instruments at the poses of the inputs, at rest, find their contacts and give the outputs.

    ``state`` must hold the start state; arguments and result as for `step`.
    """
    status = _check(model, parameters, inputs, scratch)
    if status != OK:
        return status
    _settle(state, scratch)
    if model.integrator[0] == PROJECTIVE_DYNAMICS:
        scratch.factor_key[0] = 0.0  # anew, whatever was before
        ready(model, parameters, scratch, model.step[0])
    scratch.motion[:] = 0.0
    for n in range(model.tissue_rate.size):
        state.tissue_way[n] = ANYWHERE
    status = _look(model, state, scratch, 0.0, 0.0, False)
    if status != OK:
        return status
    _work_jaws(model, parameters, state, scratch, inputs)
    state.work[0] = 0.0
    state.dissipated[0] = 0.0
    state.energy_start[0] = 0.0
    for k in range(state.tuned.size):
        state.tuned[k] = parameters[k]
    # What is stored before anything moved is where the balance starts from.
    state.stored[0] = give(model, parameters, state, scratch, 0.0, 0.0, 0, outputs)
    state.energy_start[0] = state.stored[0]
    state.put_in[0] = state.stored[0]
    state.gained[0] = 0.0
    state.returned[0] = 0.0
    state.found[0] = 0.0
    state.resolved[0] = 0.0
    outputs[BODY_OUTPUTS * (state.pose.size // POSE) + ENERGY_BALANCE] = 0.0
    return _check_outputs(outputs, scratch)


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
        ``inputs``. 0 refreshes the outputs and moves nothing.
    scratch : Scratch

    Returns
    -------
    int
        A code of `tissue_contact.status`.
    """
    status = _check(model, parameters, inputs, scratch)
    if status != OK:
        return status
    scratch.motion[:] = 0.0
    scratch.pulse[:] = 0.0
    if not (h == 0.0 or STEP_MIN <= h <= STEP_MAX):
        scratch.detail[0], scratch.detail[1] = h, STEP_MAX
        return STEP_SIZE
    _tune(model, parameters, state, scratch, outputs)
    if h == 0.0:
        give(model, parameters, state, scratch, 0.0, 0.0, 0, outputs)
        return _check_outputs(outputs, scratch)
    balance = BODY_OUTPUTS * (state.pose.size // POSE) + ENERGY_BALANCE
    before, work = state.work[0] - state.dissipated[0] - (state.stored[0] - state.energy_start[0]), state.work[0]
    dissipated, weight = state.dissipated[0], weight_energy(model, parameters, state)
    _work_jaws(model, parameters, state, scratch, inputs)
    _move(model, state, scratch, h)
    scheme, longest = model.integrator[0], model.motion_limit[0] if model.substeps_fixed[0] == 0 else 0.0
    substeps = _substeps(model, parameters, state, h, scheme, scratch)
    if substeps == 0:
        return SUBSTEP_BUDGET
    scratch.loss[:] = 0.0
    dt, n, done, untold = h / substeps, 0, 0, 0.0
    checked, age = True, 0.0  # at the end of the last step; since then, or since it was late
    # What symplectic Euler leaves swinging would be sudden motion to the step after it.
    fast = state.resolved[0] > 0.0 and _greatest_speed(state.vx, state.vy, state.vz) * dt > CALM * longest
    while n < substeps:
        if is_by_motion(model) and state.moved[0] + dt * motion_rate(model, state, scratch, True) > HELD:
            status = _look(model, state, scratch, n * dt, dt, checked)
            if status != OK:
                return status
        untold = dt if n + 1 == substeps and _is_told_by_outputs(model, scheme) else 0.0
        if fast or not _substep(model, parameters, state, scratch, scheme, n * dt, dt, longest, untold):
            fast = False
            parts = _substeps(model, parameters, state, dt, SYMPLECTIC_EULER, scratch)
            if 0 < parts * substeps <= model.substeps_max[0]:
                scheme, n, substeps, dt = SYMPLECTIC_EULER, n * parts, substeps * parts, dt / parts
            elif 2 * substeps <= model.substeps_max[0]:
                n, substeps, dt = 2 * n, 2 * substeps, 0.5 * dt
            else:
                longest = 0.0  # rather as before than not at all
            continue
        if scratch.active_a.size > 0 and scratch.active[0] > scratch.active_a.size:
            scratch.detail[0], scratch.detail[1] = scratch.active_a.size, scratch.active[0]
            return TOO_MANY_POINTS
        _clash(model, parameters, state, scratch, n * dt, dt)
        n, done, age = n + 1, done + 1, age + dt
        due = _is_due(model, state, scratch, dt)
        late = n == substeps or age >= LATE - 0.5 * dt
        checked = due or late
        if checked:
            status = _check_state(model, state, scratch)
            if status != OK:
                return status
        if late and is_by_motion(model):
            turn_all(model, state, scratch, n * dt)
        age = 0.0 if late else age
        _note_motion(model, state, scratch, dt, checked and scheme not in (EXPLICIT_EULER, RUNGE_KUTTA_4))
        if due and not is_by_motion(model):
            status = _look(model, state, scratch, n * dt, dt, True)
            if status != OK:
                return status
    state.dissipated[0] += sum_of(scratch.loss)
    stored = give(model, parameters, state, scratch, h, untold, done, outputs)
    work = state.work[0] - work
    state.put_in[0] += max(0.0, work) + max(0.0, weight - weight_energy(model, parameters, state))
    # Energy that dampers give comes from nowhere as well, though the balance counts it as taken.
    gained = before - outputs[balance] + max(0.0, dissipated - state.dissipated[0])
    status = _check_energy(model, parameters, state, scratch, scheme, h, dt, stored, work, gained)
    if status != OK:
        return status
    state.stored[0] = stored
    state.resolved[0] = 1.0 if scheme != model.integrator[0] else 0.0
    status = _check_outputs(outputs, scratch)
    if status == OK:
        _settle(state, scratch)
    return status
