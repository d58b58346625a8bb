"""Force laws of a contact: free of branches, on plain numbers, so that they can be traced symbolically.

Depth d is positive inside [m], d' its rate [m/s]. Stiffness and force are those of a whole contact [N/m, N], or per
area [N/m³, Pa] where depth is read in a distance field.
"""

import numpy as np

from tissue_contact.kernels.compiled import kernel

KELVIN_VOIGT, HUNT_CROSSLEY = 0, 1  # what Model.contact_law says


@kernel
def kelvin_voigt(depth, rate, stiffness, damping):
    """Normal force [N] of a spring and damper in parallel that never pulls.

    F = max(0, k d + c d'), with stiffness k [N/m] and damping c [N·s/m]. It jumps by c d' at touch.
    Thesis section 3.6.4, equation 3.9.
    """
    return np.fmax(0.0, stiffness * depth + damping * rate)


@kernel
def hunt_crossley(depth, rate, stiffness, dissipation, exponent):
    """Normal force [N] of a stiffening spring with a damper that grows with depth, and never pulls.

    F = max(0, k d (d / 1 m)^(n - 1) (1 + lambda d')), with stiffness k [N/m], dissipation lambda [s/m] and exponent
    n >= 1. It does not jump at touch. The reference depth of 1 m keeps the unit of k whatever n is.
    Hunt and Crossley (1975), Coefficient of restitution interpreted as damping in vibroimpact.
    """
    return np.fmax(0.0, stiffness * np.fmax(0.0, depth) ** exponent * (1.0 + dissipation * rate))


@kernel
def coulomb(speed, normal_force, friction, slip_speed):
    """Size of the regularised friction force over the speed of sliding [N·s/m].

    b = mu F / sqrt(v² + e²), so that the force b v reaches mu F for speeds far above e and is smooth at rest. ``speed``
    v [m/s], ``normal_force`` F [N], ``friction`` mu [1], ``slip_speed`` e [m/s].
    """
    return friction * normal_force / np.sqrt(speed * speed + slip_speed * slip_speed)
