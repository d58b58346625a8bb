"""Force laws of a contact: free of branches, on plain numbers, so that they can be traced symbolically."""

import numpy as np

from tissue_contact.kernels.compiled import kernel


@kernel
def kelvin_voigt(depth, rate, stiffness, damping):
    """Normal force [N] of a spring and damper in parallel that never pulls.

    F = max(0, k d + c d'), with depth d [m], rate of penetration d' [m/s], stiffness k [N/m] and damping c [N·s/m].
    Thesis section 3.6.4, equation 3.9.
    """
    return np.fmax(0.0, stiffness * depth + damping * rate)
