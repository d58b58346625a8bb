"""One contact point: what its law gives, what the tissue and the body feel of it, what becomes of the energy.

Every response comes down to points: a place on the tissue, a share of the contact or an area, a depth, a direction and
the velocity of the body against the tissue. Only `press` knows the laws.
"""

import math

from tissue_contact.kernels.compiled import inner, pointwise
from tissue_contact.kernels.laws import KELVIN_VOIGT, coulomb, hunt_crossley, kelvin_voigt
from tissue_contact.kernels.slots import (
    CONTACT_DAMPING,
    CONTACT_EXPONENT,
    CONTACT_FRICTION,
    CONTACT_PARAMETERS,
    CONTACT_STIFFNESS,
    GATHER_DEPTH,
    GATHER_FORCE,
    GATHER_POINT,
    GATHER_SIZE,
    GATHER_TORQUE,
    TISSUE_PARAMETERS,
)
from tissue_contact.kernels.vectors import cross, dot


@inner
def contact_slots(model, contact):
    """Where the parameters of a contact begin."""
    return TISSUE_PARAMETERS * model.tissue_rate.size + CONTACT_PARAMETERS * contact


@inner
def contact_law(model, parameters, contact):
    """Law, stiffness, damping, exponent, friction and slip speed of a contact, as `press` wants them."""
    own = contact_slots(model, contact)
    return (
        model.contact_law[contact],
        parameters[own + CONTACT_STIFFNESS],
        parameters[own + CONTACT_DAMPING],
        parameters[own + CONTACT_EXPONENT],
        parameters[own + CONTACT_FRICTION],
        model.contact_slip_speed[contact],
    )


@pointwise
def press(law, depth, direction, velocity):
    """Force of the law and of friction on the tissue at one point of depth > 0, for a share or an area of 1.

    Parameters
    ----------
    law : tuple of six
        From `contact_law`.
    depth : float
        [m]
    direction : tuple of three
        In which the tissue is pushed; of about unit length, exactly minus the gradient of the depth.
    velocity : tuple of three
        Of the body against the tissue [m/s].

    Returns
    -------
    force, size, stored, power, tangent, viscous, sticking : tuple of three, floats
        Force, its normal part, energy in the law's spring, power that is dissipated, and the derivatives of the
        force by depth, by its rate and by the velocity of sliding.
    """
    kind, k, c, n, friction, slip_speed = law
    rate = dot(direction, velocity)
    if kind == KELVIN_VOIGT:
        elastic, stored, tangent, viscous = k * depth, 0.5 * k * depth * depth, k, c
        size = kelvin_voigt(depth, rate, k, c)
    else:
        power = depth ** (n - 1.0)
        elastic, stored, tangent = k * depth * power, k * depth * depth * power / (n + 1.0), n * k * power
        viscous = elastic * c
        size = hunt_crossley(depth, rate, k, c, n)
        tangent *= max(0.0, 1.0 + c * rate)
    dissipated = (size - elastic) * rate
    if size == 0.0:
        tangent, viscous = 0.0, 0.0
    fx, fy, fz = size * direction[0], size * direction[1], size * direction[2]
    sticking = 0.0
    if friction > 0.0 and size > 0.0:
        along = rate / dot(direction, direction)
        sx = velocity[0] - along * direction[0]
        sy = velocity[1] - along * direction[1]
        sz = velocity[2] - along * direction[2]
        square = sx * sx + sy * sy + sz * sz
        sticking = coulomb(math.sqrt(square), size, friction, slip_speed)
        fx += sticking * sx
        fy += sticking * sy
        fz += sticking * sz
        dissipated += sticking * square
    return (fx, fy, fz), size, stored, dissipated, tangent, viscous, sticking


@pointwise
def press_elastic(law, depth):
    """Spring part of a law, for a share or an area of 1: force, energy stored, and the damping of the depth's rate."""
    kind, k, c, n, _, _ = law
    if kind == KELVIN_VOIGT:
        return k * depth, 0.5 * k * depth * depth, c
    elastic = k * depth**n
    return elastic, elastic * depth / (n + 1.0), elastic * c


@pointwise
def scatter(fx, fy, fz, a, b, c, wa, wb, wc, force):
    """Give the corners of a triangle their parts of a force, by areal coordinates."""
    fx[a] += wa * force[0]
    fy[a] += wa * force[1]
    fz[a] += wa * force[2]
    fx[b] += wb * force[0]
    fy[b] += wb * force[1]
    fz[b] += wb * force[2]
    fx[c] += wc * force[0]
    fy[c] += wc * force[1]
    fz[c] += wc * force[2]


@inner
def note(scratch, a, b, c, wa, wb, wc, direction, normal, tangential):
    """Note a pressed point for what comes after all forces are known, where there is room; the place, or -1.

    For an implicit step ``normal`` and ``tangential`` are the derivatives of the point's impulse by the velocity [kg],
    dt (dt k + c) along ``direction`` and dt b across it. For `damping.damp_contacts` ``normal`` is the damping of the
    depth's rate [N·s/m] and ``tangential`` the elastic force [N].
    """
    m = int(scratch.active[0])
    scratch.active[0] = m + 1
    if m >= scratch.active_a.size:
        return -1
    scratch.active_a[m], scratch.active_b[m], scratch.active_c[m] = a, b, c
    scratch.active_wa[m], scratch.active_wb[m], scratch.active_wc[m] = wa, wb, wc
    scratch.active_x[m], scratch.active_y[m], scratch.active_z[m] = direction
    scratch.active_normal[m], scratch.active_tangential[m] = normal, tangential
    return m


@inner
def note_split(scratch, m, contact, arm):
    """Note for `damping.damp_contacts` the contact of point m and its arm from the origin of the body frame.

    The numbers of holds follow those of contacts.
    """
    if m >= 0:
        scratch.active_contact[m] = contact
        scratch.active_arm_x[m], scratch.active_arm_y[m], scratch.active_arm_z[m] = arm


@pointwise
def gather(out, row, p, arm, force, size, depth):
    """Add a force on a body, at the point p + arm of the world, to what it feels: out[row] and on.

    ``p`` is the origin of its body frame; ``size`` weights the point, ``depth`` is that of the point.
    """
    moment = cross(arm, force)
    out[row + GATHER_FORCE] += force[0]
    out[row + GATHER_FORCE + 1] += force[1]
    out[row + GATHER_FORCE + 2] += force[2]
    out[row + GATHER_TORQUE] += moment[0]
    out[row + GATHER_TORQUE + 1] += moment[1]
    out[row + GATHER_TORQUE + 2] += moment[2]
    out[row + GATHER_DEPTH] = max(out[row + GATHER_DEPTH], depth)
    out[row + GATHER_SIZE] += size
    out[row + GATHER_POINT] += size * (p[0] + arm[0])
    out[row + GATHER_POINT + 1] += size * (p[1] + arm[1])
    out[row + GATHER_POINT + 2] += size * (p[2] + arm[2])


@pointwise
def moving_point(velocity, spin, arm):
    """Velocity [m/s] of a point of a rigid body, arm from the origin of its frame."""
    turning = cross(spin, arm)
    return velocity[0] + turning[0], velocity[1] + turning[1], velocity[2] + turning[2]
