"""Energy of the tissue at one moment."""

from tissue_contact.kernels.compiled import inner
from tissue_contact.kernels.constraints import area_energy
from tissue_contact.kernels.forces import volume_pressure
from tissue_contact.kernels.slots import (
    AREA_STIFFNESS,
    AREAL_DENSITY,
    NONLINEARITY,
    STIFFNESS_SCALE,
    SUPPORT_STIFFNESS,
    TISSUE_PARAMETERS,
    VOLUME_STIFFNESS,
)
from tissue_contact.kernels.springs import spring_energy, stiffening_energy
from tissue_contact.kernels.sums import sum_of_squares


@inner
def tissue_energies(model, parameters, state):
    """Kinetic and elastic energy [J]; springs, area, volume, support and weight are the elastic part."""
    kinetic, elastic = 0.0, 0.0
    for n in range(model.tissue_rate.size):
        own = TISSUE_PARAMETERS * n
        density, support = parameters[own + AREAL_DENSITY], parameters[own + SUPPORT_STIFFNESS]
        first, last = model.tissue_spring_start[n], model.tissue_spring_start[n + 1]
        i, j, rest, stiffness = model.spring_i, model.spring_j, model.spring_rest, model.spring_stiffness
        scale, nonlinearity = parameters[own + STIFFNESS_SCALE], parameters[own + NONLINEARITY]
        elastic += spring_energy(first, last, i, j, rest, stiffness, scale, state.x, state.y, state.z)
        if nonlinearity > 0.0:
            elastic += stiffening_energy(
                first, last, i, j, rest, stiffness, scale, nonlinearity, state.x, state.y, state.z
            )
        if parameters[own + AREA_STIFFNESS] > 0.0:
            elastic += area_energy(
                model.tissue_triangle_start[n],
                model.tissue_triangle_start[n + 1],
                model.triangle_a,
                model.triangle_b,
                model.triangle_c,
                model.rest_area,
                parameters[own + AREA_STIFFNESS],
                state.x,
                state.y,
                state.z,
            )
        k = parameters[own + VOLUME_STIFFNESS]
        if k > 0.0:
            strain = volume_pressure(model, parameters, state, n) / k
            elastic += 0.5 * k * abs(model.tissue_volume[n]) * strain * strain
        first, last = model.tissue_vertex_start[n], model.tissue_vertex_start[n + 1]
        area, vx, vy, vz = model.node_area[first:last], state.vx[first:last], state.vy[first:last], state.vz[first:last]
        kinetic += 0.5 * density * sum_of_squares(area, vx, vy, vz)
        place = 0.0  # [m⁴], squares times areas
        for v in range(first, last if support > 0.0 else first):
            dx, dy, dz = state.x[v] - model.rest_x[v], state.y[v] - model.rest_y[v], state.z[v] - model.rest_z[v]
            place += model.node_area[v] * (dx * dx + dy * dy + dz * dz)
        elastic += 0.5 * support * place
    return kinetic, elastic + weight_energy(model, parameters, state)


@inner
def weight_energy(model, parameters, state):
    """Energy of the tissue's weight [J], 0 at rest."""
    g = model.gravity
    total = 0.0
    if g[0] == 0.0 and g[1] == 0.0 and g[2] == 0.0:
        return total
    for n in range(model.tissue_rate.size):
        density = parameters[TISSUE_PARAMETERS * n + AREAL_DENSITY]
        for v in range(model.tissue_vertex_start[n], model.tissue_vertex_start[n + 1]):
            dx, dy, dz = state.x[v] - model.rest_x[v], state.y[v] - model.rest_y[v], state.z[v] - model.rest_z[v]
            total -= density * model.node_area[v] * (g[0] * dx + g[1] * dy + g[2] * dz)
    return total
