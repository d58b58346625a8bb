"""How every kernel is compiled: one place for the options that the ahead-of-time route depends on.

Kernels allocate nothing, raise nothing and divide as C does (``error_model="numpy"``: no exception for a zero divisor).
"""

from numba import njit

kernel = njit(cache=True, error_model="numpy")

# For kernels that only kernels call: without the entries for Python and C they compile in half the time.
inner = njit(cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)

# For kernels that are called once for every point of a contact, where a call would cost as much as the work.
pointwise = njit(cache=True, error_model="numpy", no_cfunc_wrapper=True, forceinline=True)
