"""Kernels that are simple enough to know every answer, for the tests of the FMU around them.

The state is one vertex at x that drifts with vx; input 0 pulls it, input 1 asks for a status, parameter 0 is
a gain. state.pairs counts the steps.
"""

import math

from numba import njit


@njit(error_model="numpy")
def _outputs(parameters, state, inputs, outputs):
    outputs[0] = parameters[0] * state.x[0]
    outputs[1] = parameters[0] * inputs[0]
    outputs[2] = state.pairs[0]


@njit(error_model="numpy")
def initialize(model, parameters, state, inputs, outputs, scratch):
    """Vertex at the first input plus the model's rest place."""
    if inputs[1] != 0.0:
        scratch.detail[0] = 1.0
        scratch.detail[1] = inputs[1]
        return int(inputs[1])
    state.x[0] += model.rest_x[0] + inputs[0]
    _outputs(parameters, state, inputs, outputs)
    return 0


@njit(error_model="numpy")
def step(model, parameters, state, inputs, h, outputs, scratch):
    """X += h (vx + sin(input 0)), and a count of steps; fails half-way if input 1 asks for it."""
    state.x[0] += h * (state.vx[0] + math.sin(inputs[0]))
    for i in range(state.y.size):
        state.y[i] = 0.5 * state.y[i] + h * model.rest_y[i] / (1.0 + state.x[0] * state.x[0])
    if h > 0.0:
        state.pairs[0] += 1
    _outputs(parameters, state, inputs, outputs)
    if inputs[1] != 0.0:
        scratch.detail[0] = 1.0
        scratch.detail[1] = inputs[1]
        return int(inputs[1])
    return 0
