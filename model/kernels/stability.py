"""How long a substep may be: stable limits of the schemes (model section 2) and the motion between two detections."""

import math

from tissue_contact.kernels.collision import BODIES, FIELD
from tissue_contact.kernels.compiled import inner
from tissue_contact.kernels.constraints import largest_growth
from tissue_contact.kernels.contact import contact_slots
from tissue_contact.kernels.forces import volume_pressure
from tissue_contact.kernels.grasp import grasp_load, grasp_slots
from tissue_contact.kernels.laws import KELVIN_VOIGT
from tissue_contact.kernels.near import MOTION
from tissue_contact.kernels.slots import (
    AREA_STIFFNESS,
    AREAL_DENSITY,
    CONTACT_DAMPING,
    CONTACT_EXPONENT,
    CONTACT_FRICTION,
    CONTACT_STIFFNESS,
    DAMPING_SCALE,
    DRAG,
    GRASP_DAMPING,
    GRASP_STIFFNESS,
    NONLINEARITY,
    STIFFNESS_SCALE,
    SUPPORT_DAMPING,
    SUPPORT_STIFFNESS,
    TISSUE_PARAMETERS,
    VOLUME_STIFFNESS,
)
from tissue_contact.kernels.springs import stretch_range

# what Model.integrator says
SYMPLECTIC_EULER, EXPLICIT_EULER, IMPLICIT_EULER, RUNGE_KUTTA_4, PROJECTIVE_DYNAMICS = range(5)

# |z| of the largest half disc of the left half plane within the region of stability of the classical Runge–Kutta
# scheme is 2.6; it reaches -2.785 along the real axis and 2.828 along the imaginary one.
RUNGE_KUTTA_RADIUS = 2.6

CRUSH_MAX = 4.0  # of a spring crushed to a fifth; a passage at nothing no step resolves, and none is soon past it


@inner
def _of_tissue(model, parameters, state, n):
    """Stiffness [N/m³] and damping [N·s/m³] per area of a tissue's fastest motion, but for contacts and holds."""
    own = TISSUE_PARAMETERS * n
    least, greatest = stretch_range(
        model.tissue_spring_start[n],
        model.tissue_spring_start[n + 1],
        model.spring_i,
        model.spring_j,
        model.spring_rest,
        state.x,
        state.y,
        state.z,
    )
    strain = max(1.0 - least, greatest - 1.0)
    scale = parameters[own + STIFFNESS_SCALE] * (1.0 + 3.0 * parameters[own + NONLINEARITY] * strain * strain)
    # Across a spring crushed to L of its length l the stiffness is k (l/L - 1), more than k below a half. What it once
    # was stays counted: steps that grow and shrink in turn near their limit pump energy into the tissue.
    crush = CRUSH_MAX if least * (1.0 + CRUSH_MAX) < 1.0 else 1.0 / least - 1.0
    state.crush[n] = max(1.0, state.crush[n], crush)
    stiffness = scale * state.crush[n] * model.tissue_rate[n] + parameters[own + SUPPORT_STIFFNESS]
    growth = 1.0
    if parameters[own + AREA_STIFFNESS] > 0.0 or parameters[own + VOLUME_STIFFNESS] > 0.0:
        growth = largest_growth(
            model.tissue_triangle_start[n],
            model.tissue_triangle_start[n + 1],
            model.triangle_a,
            model.triangle_b,
            model.triangle_c,
            model.rest_edges,
            state.x,
            state.y,
            state.z,
        )
    if parameters[own + AREA_STIFFNESS] > 0.0:
        stiffness += growth * parameters[own + AREA_STIFFNESS] * model.tissue_area_rate[n]
    if parameters[own + VOLUME_STIFFNESS] > 0.0:
        stiffness += growth * growth * parameters[own + VOLUME_STIFFNESS] * model.tissue_volume_rate[n]
        stiffness += math.sqrt(growth) * abs(volume_pressure(model, parameters, state, n)) * model.tissue_volume_bend[n]
    damping = parameters[own + DRAG] + parameters[own + SUPPORT_DAMPING]
    return stiffness, damping + parameters[own + DAMPING_SCALE] * model.tissue_damping_rate[n]


@inner
def contact_slope(model, parameters, state, k, travel):
    """Stiffness and damping of a contact, per unit of its share or area, where it may be deepest.

    ``travel`` [m] is how much deeper it may become until it is asked again. The damping is that of the depth's rate and
    of sliding: friction at rest has the slope mu F/e.
    """
    own = contact_slots(model, k)
    stiffness, damping = parameters[own + CONTACT_STIFFNESS], parameters[own + CONTACT_DAMPING]
    depth, n = state.deepest[k] + travel, 1.0
    if model.contact_response[k] == FIELD:
        depth = min(depth, model.contact_depth[k])
    if model.contact_law[k] != KELVIN_VOIGT:
        n = parameters[own + CONTACT_EXPONENT]
        damping *= stiffness * depth**n
    sticking = parameters[own + CONTACT_FRICTION] * stiffness * depth**n / model.contact_slip_speed[k]
    return n * stiffness * depth ** (n - 1.0), damping + sticking


@inner
def stable_substep(model, parameters, state, scratch, scheme, h):
    """Largest stable substep [s] of a scheme in a step h [s], over all the tissues.

    omega² is bounded by the springs' largest eigenvalue plus support, constraints, contacts and holds: a contact of
    shares as if one vertex had to bear all of it for every part of the instrument, or what it bears now if that is
    more; a distance field by its stiffness per area. Dampers, implicit in symplectic Euler, only raise its limit.
    """
    limit = math.inf
    if scheme in (IMPLICIT_EULER, PROJECTIVE_DYNAMICS):
        return limit
    for n in range(model.tissue_rate.size):
        own = TISSUE_PARAMETERS * n
        density = parameters[own + AREAL_DENSITY]
        stiffness, damping = _of_tissue(model, parameters, state, n)
        for k in range(model.contact_tissue.size):
            if model.contact_response[k] == BODIES or model.contact_tissue[k] != n:
                continue
            load = 1.0
            if model.contact_response[k] != FIELD:
                i = model.contact_body[k]
                parts = int(model.body_part_start[i + 1]) - int(model.body_part_start[i])
                load = max(parts / model.tissue_node_area_min[n], state.touch_load[k])
            spring, damper = contact_slope(model, parameters, state, k, travel(model, scratch, k, h))
            stiffness += spring * load
            damping += damper * load
        for g in range(model.grasp_body.size):
            if model.grasp_tissue[g] == n:
                slots, load = grasp_slots(model, g), density * grasp_load(model, parameters, state, g)
                stiffness += parameters[slots + GRASP_STIFFNESS] * load
                damping += parameters[slots + GRASP_DAMPING] * load
        square, rate = stiffness / density, damping / density
        if square == 0.0 and (rate == 0.0 or scheme == SYMPLECTIC_EULER):
            continue
        if scheme == SYMPLECTIC_EULER:
            limit = min(limit, 2.0 / math.sqrt(square))
        elif scheme == EXPLICIT_EULER:
            # 2 zeta/omega for zeta < 1 and more than 2/(2 zeta omega) beyond; every mode has the drag at least.
            drag = (parameters[own + DRAG] + parameters[own + SUPPORT_DAMPING]) / density
            limit = min(limit, drag / square if square > 0.0 else math.inf, 2.0 / rate if rate > 0.0 else 0.0)
        else:
            limit = min(limit, RUNGE_KUTTA_RADIUS / max(math.sqrt(square), rate))
    return limit


@inner
def travel(model, scratch, k, h):
    """Way [m] that the bodies of contact k go in a time h [s], rotation included."""
    return h * (
        _speed(model, scratch, model.contact_body[k])
        + (_speed(model, scratch, model.contact_other[k]) if model.contact_response[k] == BODIES else 0.0)
    )


@inner
def _speed(model, scratch, body):
    """Greatest speed [m/s] of a point of a body."""
    m = scratch.motion[6 * body : 6 * body + 6]
    speed = math.sqrt(m[0] * m[0] + m[1] * m[1] + m[2] * m[2])
    return speed + model.body_radius[body] * math.sqrt(m[3] * m[3] + m[4] * m[4] + m[5] * m[5])


@inner
def motion_rate(model, state, scratch, with_tissue):
    """How often in a second the objects of a contact move as far as two continuous detections may lie apart [1/s]."""
    rate = 0.0
    for k in range(model.contact_body.size):
        speed = travel(model, scratch, k, 1.0)
        if with_tissue and model.contact_response[k] != BODIES:
            speed += state.tissue_speed[model.contact_tissue[k]]
        rate = max(rate, speed / (MOTION * model.contact_reach[k]))
    return rate
