"""All the forces of a scene at one moment: tissue, contacts, holds."""

from tissue_contact.kernels.collision import BODIES, FIELD
from tissue_contact.kernels.compiled import inner
from tissue_contact.kernels.constraints import add_area_forces, add_volume_forces, enclosed_volume
from tissue_contact.kernels.detection import detect
from tissue_contact.kernels.grasp import pull
from tissue_contact.kernels.near import find_near_samples, find_near_triangles, turn_sides
from tissue_contact.kernels.occupancy import ANYWHERE, loosen
from tissue_contact.kernels.pressure import press_bodies, press_tissue
from tissue_contact.kernels.response import respond
from tissue_contact.kernels.slots import (
    AREA_STIFFNESS,
    GATHER,
    GATHER_FORCE,
    NONLINEARITY,
    POSE,
    STIFFNESS_SCALE,
    TISSUE_PARAMETERS,
    VOLUME_STIFFNESS,
)
from tissue_contact.kernels.springs import add_springs, add_stiffening_springs
from tissue_contact.kernels.touch import find_touches
from tissue_contact.kernels.vectors import rotation, turned
from tissue_contact.status import OK


@inner
def pose_of(state, scratch, body, elapsed):
    """Rotation matrix and position of a body, elapsed [s] after the last communication point."""
    p, m = POSE * body, 6 * body
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
def motion_of(scratch, body):
    """Velocity [m/s] and angular velocity [rad/s] of a body, world frame."""
    m = scratch.motion[6 * body : 6 * body + 6]
    return (m[0], m[1], m[2]), (m[3], m[4], m[5])


@inner
def detect_all(model, state, scratch, elapsed, ahead):
    """Find what touches, or may touch until the next detection; the status.

    Since the last detection no vertex has gone farther than state.tissue_way. ``ahead`` is as for `near.margin_of`.
    """
    for n in range(model.tissue_rate.size):
        loosen(model, state, n, state.tissue_way[n])
    for k in range(model.contact_body.size):
        r, p = pose_of(state, scratch, model.contact_body[k], elapsed)
        kind = model.contact_response[k]
        if kind == BODIES:
            r2, p2 = pose_of(state, scratch, model.contact_other[k], elapsed)
            find_near_samples(model, state, k, r, p, r2, p2, ahead)
            continue
        known = state.tissue_way[model.contact_tissue[k]] < ANYWHERE
        if kind == FIELD:
            find_near_triangles(model, state, scratch, k, r, p, known, ahead)
        else:
            status = detect(model, state, scratch, k, r, p, known)
            if status != OK:
                return status
            find_touches(model, state, scratch, k, r)
    state.since_detection[0] = 0.0
    state.moved[0] = 0.0
    for n in range(model.tissue_rate.size):
        state.tissue_way[n] = 0.0
    return OK


@inner
def turn_all(model, state, scratch, elapsed):
    """Decide anew on which sides of the triangles that touch fields the bodies are; the rest is as it was found."""
    for k in range(model.contact_body.size):
        if model.contact_response[k] == FIELD and state.near_count[k] > 0:
            r, p = pose_of(state, scratch, model.contact_body[k], elapsed)
            turn_sides(model, state, scratch, k, r, p)


@inner
def tissue_forces(model, parameters, state, scratch):
    """Forces of the springs and of the resistance to a change of area and volume, in the place of all others."""
    for v in range(state.x.size):
        scratch.fx[v] = 0.0
        scratch.fy[v] = 0.0
        scratch.fz[v] = 0.0
    for n in range(model.tissue_rate.size):
        own = TISSUE_PARAMETERS * n
        first, last = model.tissue_spring_start[n], model.tissue_spring_start[n + 1]
        if parameters[own + NONLINEARITY] > 0.0:
            add_stiffening_springs(
                first,
                last,
                model.spring_i,
                model.spring_j,
                model.spring_rest,
                model.spring_stiffness,
                parameters[own + STIFFNESS_SCALE],
                parameters[own + NONLINEARITY],
                state.x,
                state.y,
                state.z,
                scratch.fx,
                scratch.fy,
                scratch.fz,
            )
        else:
            add_springs(
                first,
                last,
                model.spring_i,
                model.spring_j,
                model.spring_rest,
                model.spring_stiffness,
                parameters[own + STIFFNESS_SCALE],
                state.x,
                state.y,
                state.z,
                scratch.fx,
                scratch.fy,
                scratch.fz,
            )
        first, last = model.tissue_triangle_start[n], model.tissue_triangle_start[n + 1]
        if parameters[own + AREA_STIFFNESS] > 0.0:
            add_area_forces(
                first,
                last,
                model.triangle_a,
                model.triangle_b,
                model.triangle_c,
                model.rest_area,
                parameters[own + AREA_STIFFNESS],
                state.x,
                state.y,
                state.z,
                scratch.fx,
                scratch.fy,
                scratch.fz,
            )
        if parameters[own + VOLUME_STIFFNESS] > 0.0:
            add_volume_forces(
                first,
                last,
                model.triangle_a,
                model.triangle_b,
                model.triangle_c,
                volume_pressure(model, parameters, state, n),
                state.x,
                state.y,
                state.z,
                scratch.fx,
                scratch.fy,
                scratch.fz,
            )


@inner
def volume_pressure(model, parameters, state, tissue):
    """Pressure [Pa] within a closed organ, -k (V - V0)/|V0|."""
    volume = enclosed_volume(
        model.tissue_triangle_start[tissue],
        model.tissue_triangle_start[tissue + 1],
        model.triangle_a,
        model.triangle_b,
        model.triangle_c,
        state.x,
        state.y,
        state.z,
    )
    k = parameters[TISSUE_PARAMETERS * tissue + VOLUME_STIFFNESS]
    rest = model.tissue_volume[tissue]
    return -k * (volume - rest) / abs(rest)


@inner
def clear_contacts(state, scratch):
    """Forget what the bodies felt."""
    for k in range(scratch.contact.size):
        scratch.contact[k] = 0.0
    for k in range(state.deepest.size):
        state.deepest[k] = 0.0
    scratch.active[0] = 0


@inner
def contact_forces(model, parameters, state, scratch, elapsed, tau, split):
    """Add the forces of all contacts with tissue and of all holds; ``tau`` and ``split`` as for `response.respond`.

    Returns
    -------
    float
        The energy stored in them [J].
    """
    stored = 0.0
    for k in range(model.contact_body.size):
        body, kind = model.contact_body[k], model.contact_response[k]
        if kind == FIELD:
            if state.near_count[k] > 0:
                r, p = pose_of(state, scratch, body, elapsed)
                velocity, spin = motion_of(scratch, body)
                stored += press_tissue(model, parameters, state, scratch, k, r, p, velocity, spin, tau, split)
        elif kind != BODIES and state.touches[k] > 0:
            r, p = pose_of(state, scratch, body, elapsed)
            velocity, spin = motion_of(scratch, body)
            stored += respond(model, parameters, state, scratch, k, r, p, velocity, spin, tau, split)
    for g in range(model.grasp_body.size):
        if state.held[g] > 0:
            body = model.grasp_body[g]
            r, p = pose_of(state, scratch, body, elapsed)
            velocity, spin = motion_of(scratch, body)
            stored += pull(model, parameters, state, scratch, g, r, p, velocity, spin, tau, split)
    return stored


@inner
def body_forces(model, parameters, state, scratch, elapsed, tau):
    """Add the forces between rigid bodies; ``tau`` and the result as for `contact_forces`."""
    stored = 0.0
    for k in range(model.contact_body.size):
        if model.contact_response[k] == BODIES and state.near_count[k] > 0:
            body, other = model.contact_body[k], model.contact_other[k]
            r, p = pose_of(state, scratch, body, elapsed)
            r2, p2 = pose_of(state, scratch, other, elapsed)
            velocity, spin = motion_of(scratch, body)
            velocity2, spin2 = motion_of(scratch, other)
            stored += press_bodies(
                model, parameters, state, scratch, k, r, p, velocity, spin, r2, p2, velocity2, spin2, tau
            )
    return stored


@inner
def add_pulse(scratch, tau):
    """Add what the bodies feel, for a time tau [s], to their impulse within the step."""
    for b in range(scratch.contact.size // GATHER):
        for k in range(3):
            scratch.pulse[3 * b + k] += tau * scratch.contact[GATHER * b + GATHER_FORCE + k]
