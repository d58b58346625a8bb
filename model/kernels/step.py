"""TOY, to be replaced: the signatures are final."""
from numba import njit


@njit(cache=True, error_model="numpy")
def initialize(model, parameters, state, inputs, outputs, scratch):
    for i in range(state.pose.size):
        state.pose[i] = inputs[i]
    outputs[0] = state.x[0] * parameters[0]
    return 0


@njit(cache=True, error_model="numpy")
def step(model, parameters, state, inputs, h, outputs, scratch):
    for i in range(state.pose.size):
        state.pose[i] = inputs[i]
    for i in range(state.x.size):
        state.x[i] += h * state.vx[i]
    outputs[0] = state.x[0] * parameters[0] + inputs[0]
    return 0
