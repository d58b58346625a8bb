"""Where a substep starts from: places and velocities at its beginning, in scratch.start."""

from tissue_contact.kernels.compiled import inner


@inner
def parts(values, n):
    """The six parts of n of an array that holds x, y and z of places, then those of velocities.

    An index into a part cannot be negative, which would be one from its end: looked at, it keeps loops from vectors.
    """
    return (
        values[:n],
        values[n : 2 * n],
        values[2 * n : 3 * n],
        values[3 * n : 4 * n],
        values[4 * n : 5 * n],
        values[5 * n : 6 * n],
    )


@inner
def _keep(values, out):
    """Copy values; one array at a time is copied in vectors."""
    for v in range(values.size):
        out[v] = values[v]


@inner
def keep_start(state, scratch):
    """Note places and velocities of the tissue."""
    x, y, z, vx, vy, vz = parts(scratch.start, state.x.size)
    _keep(state.x, x)
    _keep(state.y, y)
    _keep(state.z, z)
    _keep(state.vx, vx)
    _keep(state.vy, vy)
    _keep(state.vz, vz)


@inner
def place(state, scratch, dt):
    """x = x0 + dt v, with x0 as it was noted."""
    x, y, z, _, _, _ = parts(scratch.start, state.x.size)
    for v in range(state.x.size):
        state.x[v] = x[v] + dt * state.vx[v]
        state.y[v] = y[v] + dt * state.vy[v]
        state.z[v] = z[v] + dt * state.vz[v]


@inner
def back_to_start(state, scratch):
    """Put the tissue back to the places and velocities that were noted."""
    x, y, z, vx, vy, vz = parts(scratch.start, state.x.size)
    _keep(x, state.x)
    _keep(y, state.y)
    _keep(z, state.z)
    _keep(vx, state.vx)
    _keep(vy, state.vy)
    _keep(vz, state.vz)
