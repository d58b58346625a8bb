"""Where a substep starts from: places and velocities at its beginning, in scratch.start."""

from tissue_contact.kernels.compiled import inner


@inner
def _keep(values, out, first):
    """Copy values to the places from first on; one array at a time is copied in vectors."""
    for v in range(values.size):
        out[first + v] = values[v]


@inner
def keep_start(state, scratch):
    """Note places and velocities of the tissue."""
    n, start = state.x.size, scratch.start
    _keep(state.x, start, 0)
    _keep(state.y, start, n)
    _keep(state.z, start, 2 * n)
    _keep(state.vx, start, 3 * n)
    _keep(state.vy, start, 4 * n)
    _keep(state.vz, start, 5 * n)


@inner
def place(state, scratch, dt):
    """x = x0 + dt v, with x0 as it was noted."""
    n, start = state.x.size, scratch.start
    for v in range(n):
        state.x[v] = start[v] + dt * state.vx[v]
        state.y[v] = start[n + v] + dt * state.vy[v]
        state.z[v] = start[2 * n + v] + dt * state.vz[v]


@inner
def back_to_start(state, scratch):
    """Put the tissue back to the places and velocities that were noted."""
    n, start = state.x.size, scratch.start
    for v in range(n):
        state.x[v], state.y[v], state.z[v] = start[v], start[n + v], start[2 * n + v]
        state.vx[v], state.vy[v], state.vz[v] = start[3 * n + v], start[4 * n + v], start[5 * n + v]
