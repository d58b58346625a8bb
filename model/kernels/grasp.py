"""Jaws that hold tissue (thesis 4.3, model section 7).

As the jaws close, the free vertices within their reach are anchored in the body frame, each with a share of the hold by
its area. An anchor pulls through a spring and a damper, so the reaction comes out in force and torque; beyond its share
of the slip force it slides after the tissue, and out of the reach of the jaws it lets go. Opening lets go of all.
"""

import math

from tissue_contact.kernels.compiled import inner
from tissue_contact.kernels.contact import gather, moving_point, note, note_split
from tissue_contact.kernels.slots import (
    AREAL_DENSITY,
    CONTACT_PARAMETERS,
    GATHER,
    GRASP_DAMPING,
    GRASP_PARAMETERS,
    GRASP_SLIP_FORCE,
    GRASP_STIFFNESS,
    TISSUE_PARAMETERS,
)
from tissue_contact.kernels.vectors import dot, to_body, to_world


@inner
def grasp_slots(model, g):
    """Where the parameters of the grasper of hold g begin."""
    own = TISSUE_PARAMETERS * model.tissue_rate.size + CONTACT_PARAMETERS * model.contact_body.size
    return own + GRASP_PARAMETERS * model.grasp_grasper[g]


@inner
def grasp_load(model, parameters, state, g):
    """Velocity [m/s] that a unit impulse of hold g gives to every vertex that it holds, at most [1/kg]."""
    if not state.held_area[g] > 0.0:
        return 0.0
    return 1.0 / (parameters[TISSUE_PARAMETERS * model.grasp_tissue[g] + AREAL_DENSITY] * state.held_area[g])


@inner
def close(model, state, g, r, p):
    """Anchor what lies within reach of the jaws of hold g; r, p are the pose of its body."""
    tissue, first = model.grasp_tissue[g], model.grasp_start[g]
    centre = (model.grasp_centre[3 * g], model.grasp_centre[3 * g + 1], model.grasp_centre[3 * g + 2])
    n = 0
    state.held_area[g] = 0.0
    for v in range(model.tissue_vertex_start[tissue], model.tissue_vertex_start[tissue + 1]):
        if model.node_free[v] == 0.0:
            continue
        q = to_body(r, (state.x[v] - p[0], state.y[v] - p[1], state.z[v] - p[2]))
        d = (q[0] - centre[0], q[1] - centre[1], q[2] - centre[2])
        if dot(d, d) <= model.grasp_radius[g] * model.grasp_radius[g]:
            state.anchor_vertex[first + n] = v
            state.anchor_x[first + n], state.anchor_y[first + n], state.anchor_z[first + n] = q
            state.held_area[g] += model.node_area[v]
            n += 1
    state.held[g] = n


@inner
def _stretch(state, m, r, p):
    """Arm of anchor m from the origin of its body frame, world axes, and the way from its vertex to it [m]."""
    v = state.anchor_vertex[m]
    arm = to_world(r, (state.anchor_x[m], state.anchor_y[m], state.anchor_z[m]))
    return arm, (p[0] + arm[0] - state.x[v], p[1] + arm[1] - state.y[v], p[2] + arm[2] - state.z[v])


@inner
def _stored(way, stiffness, slip):
    """Energy [J] of a hold stretched by a way [m]: a spring up to the slip force, constant force beyond."""
    most = slip / stiffness
    if way <= most:
        return 0.5 * stiffness * way * way
    return slip * (way - 0.5 * most)


@inner
def open_jaws(model, parameters, state, g, r, p):
    """Let go of all that hold g has; what its springs stored is dissipated."""
    own = grasp_slots(model, g)
    for m in range(model.grasp_start[g], model.grasp_start[g] + state.held[g]):
        _, e = _stretch(state, m, r, p)
        share = model.node_area[state.anchor_vertex[m]] / state.held_area[g]
        state.dissipated[0] += share * _stored(
            math.sqrt(dot(e, e)), parameters[own + GRASP_STIFFNESS], parameters[own + GRASP_SLIP_FORCE]
        )
    state.held[g] = 0
    state.held_area[g] = 0.0


@inner
def pull(model, parameters, state, scratch, g, r, p, velocity, spin, tau, split):
    """Add the forces of hold g to the tissue and to its body; arguments and result as for `response.respond`."""
    own = grasp_slots(model, g)
    k, c, slip = (
        parameters[own + GRASP_STIFFNESS],
        parameters[own + GRASP_DAMPING],
        parameters[own + GRASP_SLIP_FORCE],
    )
    viscous = 0.0 if split else c
    total = 0.0
    for m in range(model.grasp_start[g], model.grasp_start[g] + state.held[g]):
        v = state.anchor_vertex[m]
        arm, e = _stretch(state, m, r, p)
        way = math.sqrt(dot(e, e))
        share = model.node_area[v] / state.held_area[g]
        spring = share * (k if k * way <= slip else slip / way)
        speed = moving_point(velocity, spin, arm)
        u = (speed[0] - state.vx[v], speed[1] - state.vy[v], speed[2] - state.vz[v])
        fx = spring * e[0] + share * viscous * u[0]
        fy = spring * e[1] + share * viscous * u[1]
        fz = spring * e[2] + share * viscous * u[2]
        scratch.fx[v] += fx
        scratch.fy[v] += fy
        scratch.fz[v] += fz
        gather(
            scratch.contact,
            GATHER * model.grasp_body[g],
            p,
            arm,
            (-fx, -fy, -fz),
            math.sqrt(fx * fx + fy * fy + fz * fz),
            0.0,
        )
        slope = tau * (tau * spring + share * c)
        if split:
            place = note(scratch, v, v, v, 1.0, 0.0, 0.0, (1.0, 0.0, 0.0), share * c, 0.0)
            note_split(scratch, place, model.contact_body.size + g, arm)
        elif scratch.active_a.size > 0:
            note(scratch, v, v, v, 1.0, 0.0, 0.0, (1.0, 0.0, 0.0), slope, slope)
        total += share * _stored(way, k, slip)
        state.work[0] += tau * (speed[0] * fx + speed[1] * fy + speed[2] * fz)
        state.dissipated[0] += tau * share * viscous * dot(u, u)
    return total


@inner
def slide(model, parameters, state, g, r, p):
    """Move the anchors of hold g that pull beyond the slip force, and drop those that leave the reach of the jaws."""
    own = grasp_slots(model, g)
    k, slip = parameters[own + GRASP_STIFFNESS], parameters[own + GRASP_SLIP_FORCE]
    first = model.grasp_start[g]
    m = first
    while m < first + state.held[g]:
        v = state.anchor_vertex[m]
        _, e = _stretch(state, m, r, p)
        way = math.sqrt(dot(e, e))
        if k * way <= slip:
            m += 1
            continue
        share = model.node_area[v] / state.held_area[g]
        keep = slip / (k * way)
        q = to_body(
            r,
            (
                state.x[v] + keep * e[0] - p[0],
                state.y[v] + keep * e[1] - p[1],
                state.z[v] + keep * e[2] - p[2],
            ),
        )
        d = (
            q[0] - model.grasp_centre[3 * g],
            q[1] - model.grasp_centre[3 * g + 1],
            q[2] - model.grasp_centre[3 * g + 2],
        )
        state.dissipated[0] += share * slip * (1.0 - keep) * way
        if dot(d, d) <= model.grasp_radius[g] * model.grasp_radius[g]:
            state.anchor_x[m], state.anchor_y[m], state.anchor_z[m] = q
            m += 1
            continue
        state.dissipated[0] += share * 0.5 * slip * slip / k
        last = first + state.held[g] - 1
        state.anchor_vertex[m] = state.anchor_vertex[last]
        state.anchor_x[m], state.anchor_y[m], state.anchor_z[m] = (
            state.anchor_x[last],
            state.anchor_y[last],
            state.anchor_z[last],
        )
        state.held[g] -= 1
