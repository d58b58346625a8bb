"""How every kernel is compiled: one place for the options that the ahead-of-time route depends on.

Kernels allocate nothing, raise nothing and divide as C does (``error_model="numpy"``: no exception for a zero divisor).
"""

from numba import njit

from tissue_contact.kernels.deferred import inner_kernel

kernel = njit(cache=True, error_model="numpy")

# For kernels that only kernels call: compiled as a part of their callers, without the entries for Python and C.
inner = inner_kernel(error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)

# For kernels that are called once for every point of a contact, where a call would cost as much as the work.
pointwise = njit(cache=True, error_model="numpy", no_cfunc_wrapper=True, forceinline=True)
