"""Collision response: the force of every touch (thesis 3.6, model sections 5 and 6).

Between two detections a touch keeps its place on the tissue, its share and its normal; depth and rate follow the
motion. So between detections the contact is a true spring, whose force is minus the gradient of its energy, and the
work per substep is small.
"""

from tissue_contact.kernels.collision import HULL, penetration, support
from tissue_contact.kernels.compiled import inner
from tissue_contact.kernels.laws import kelvin_voigt
from tissue_contact.kernels.slots import (
    AREAL_DENSITY,
    CONTACT_DAMPING,
    CONTACT_PARAMETERS,
    CONTACT_STIFFNESS,
    GATHER,
    GATHER_DEPTH,
    GATHER_FORCE,
    GATHER_POINT,
    GATHER_REGIONS,
    GATHER_SIZE,
    GATHER_TORQUE,
    TISSUE_PARAMETERS,
)
from tissue_contact.kernels.vectors import cross, dot, to_body


@inner
def _depth(model, state, contact, m, r, arm, inward):
    """Depth [m] of the touched part below the plane through the point arm, world axes, across inward."""
    point, normal = to_body(r, arm), to_body(r, inward)
    part = state.touch_part[m]
    if model.contact_response[contact] == HULL:
        x, y, z = model.hull_x, model.hull_y, model.hull_z
        v = support(normal, int(state.touch_support[m]), model.hull_edge_start, model.hull_neighbour, x, y, z)
        state.touch_support[m] = v
        return dot(normal, (x[v] - point[0], y[v] - point[1], z[v] - point[2]))
    return dot(penetration(point, normal, part, model.part_centre, model.part_axes, model.part_half), normal)


@inner
def respond(model, parameters, state, scratch, contact, r, p, velocity, spin, dt):
    """Add the contact forces of one pair of objects to the tissue's vertices and to its instrument.

    Parameters
    ----------
    contact : int
        Which declared contact.
    r, p : tuple of nine, tuple of three
        Pose of the instrument's body frame: rotation matrix, position [m].
    velocity, spin : tuple of three
        Its velocity [m/s] and angular velocity [rad/s], world frame.
    dt : float
        Substep [s]. The damper of the law acts on d' / (1 + dt c G), which is implicit damping of a single touch and
        never overshoots for many; G = max W_i / m_i over the vertices bounds the velocity [m/s] that a unit impulse
        gives. 0 gives the law itself.

    Notes
    -----
    Forces on the vertices go to scratch.fx, fy, fz; what the instrument feels is added to its row of scratch.contact;
    the work of the instrument and what the damper dissipates within dt are added to the state.

    Returns
    -------
    float
        Energy [J] stored in the springs of the law, sum of w k d^2 / 2.
    """
    first = contact * scratch.pair_triangle.size
    density = parameters[TISSUE_PARAMETERS * model.contact_tissue[contact] + AREAL_DENSITY]
    own = TISSUE_PARAMETERS * model.tissue_rate.size + CONTACT_PARAMETERS * contact
    stiffness, damping = parameters[own + CONTACT_STIFFNESS], parameters[own + CONTACT_DAMPING]
    eased = damping / (1.0 + dt * damping * state.touch_load[contact] / density)
    row = GATHER * model.contact_instrument[contact]
    gather = scratch.contact
    stored = 0.0
    for m in range(first, first + state.touches[contact]):
        t, w = state.touch_triangle[m], state.touch_share[m]
        a, b, c = model.triangle_a[t], model.triangle_b[t], model.triangle_c[t]
        wa, wb, wc = state.touch_a[m], state.touch_b[m], state.touch_c[m]
        inward = (state.touch_nx[m], state.touch_ny[m], state.touch_nz[m])
        arm = (
            wa * state.x[a] + wb * state.x[b] + wc * state.x[c] - p[0],
            wa * state.y[a] + wb * state.y[b] + wc * state.y[c] - p[1],
            wa * state.z[a] + wb * state.z[b] + wc * state.z[c] - p[2],
        )
        depth = _depth(model, state, contact, m, r, arm, inward)
        if not depth > 0.0:
            continue
        turning = cross(spin, arm)
        rate = dot(
            inward,
            (
                velocity[0] + turning[0] - (wa * state.vx[a] + wb * state.vx[b] + wc * state.vx[c]),
                velocity[1] + turning[1] - (wa * state.vy[a] + wb * state.vy[b] + wc * state.vy[c]),
                velocity[2] + turning[2] - (wa * state.vz[a] + wb * state.vz[b] + wc * state.vz[c]),
            ),
        )
        size = w * kelvin_voigt(depth, rate, stiffness, eased)
        stored += 0.5 * w * stiffness * depth * depth
        fx, fy, fz = size * inward[0], size * inward[1], size * inward[2]
        scratch.fx[a] += wa * fx
        scratch.fy[a] += wa * fy
        scratch.fz[a] += wa * fz
        scratch.fx[b] += wb * fx
        scratch.fy[b] += wb * fy
        scratch.fz[b] += wb * fz
        scratch.fx[c] += wc * fx
        scratch.fy[c] += wc * fy
        scratch.fz[c] += wc * fz
        moment = cross(arm, (fx, fy, fz))
        gather[row + GATHER_FORCE] -= fx
        gather[row + GATHER_FORCE + 1] -= fy
        gather[row + GATHER_FORCE + 2] -= fz
        gather[row + GATHER_TORQUE] -= moment[0]
        gather[row + GATHER_TORQUE + 1] -= moment[1]
        gather[row + GATHER_TORQUE + 2] -= moment[2]
        gather[row + GATHER_DEPTH] = max(gather[row + GATHER_DEPTH], depth)
        gather[row + GATHER_SIZE] += size
        gather[row + GATHER_POINT] += size * (p[0] + arm[0])
        gather[row + GATHER_POINT + 1] += size * (p[1] + arm[1])
        gather[row + GATHER_POINT + 2] += size * (p[2] + arm[2])
        state.work[0] += dt * (dot(velocity, (fx, fy, fz)) + dot(spin, moment))
        state.dissipated[0] += dt * (size - w * stiffness * depth) * rate
    gather[row + GATHER_REGIONS] += state.regions[contact]
    return stored
