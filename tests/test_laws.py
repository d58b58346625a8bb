"""The force laws: closed forms, and that casadi can trace the very functions that the kernels run."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tissue_contact.kernels.laws import coulomb, hunt_crossley, kelvin_voigt

LAWS = {
    "kelvin_voigt": (kelvin_voigt, ("depth", "rate", "stiffness", "damping")),
    "hunt_crossley": (hunt_crossley, ("depth", "rate", "stiffness", "dissipation", "exponent")),
    "coulomb": (coulomb, ("speed", "normal_force", "friction", "slip_speed")),
}
RANGES = {
    "depth": (1e-5, 1e-2), "rate": (-0.5, 0.5), "stiffness": (1.0, 1e4), "damping": (0.0, 10.0),
    "dissipation": (0.0, 5.0), "exponent": (1.0, 3.0), "speed": (0.0, 0.5), "normal_force": (0.0, 5.0),
    "friction": (0.0, 1.0), "slip_speed": (1e-4, 1e-2),
}  # fmt: skip


def traced(name: str) -> ca.Function:
    """The law as casadi sees it, its own source run on symbols, and its gradient."""
    law, arguments = LAWS[name]
    ca.GlobalOptions.setNumpyMode(1)  # numpy's functions on symbols give symbols
    symbols = [ca.SX.sym(argument) for argument in arguments]
    force = law.py_func(*symbols)
    return ca.Function(name, symbols, [force, ca.gradient(force, ca.vertcat(*symbols))])


@pytest.mark.parametrize("name", LAWS)
def test_casadi_traces_the_law_that_the_kernels_run(name):
    seed = 71
    rng = np.random.default_rng(seed)
    law, arguments = LAWS[name]
    symbolic = traced(name)
    for trial in range(200):
        values = [rng.uniform(*RANGES[argument]) for argument in arguments]
        got, *exact = (float(number) for part in symbolic(*values) for number in part.elements())
        assert got == pytest.approx(law(*values), rel=1e-13, abs=1e-300), (seed, trial)
        # Exact derivatives: a difference quotient over 1e-6 of each argument agrees to about as much.
        for k, value in enumerate(values):
            step = 1e-6 * max(abs(value), 1e-3)
            near = [law(*values[:k], value + sign * step, *values[k + 1 :]) for sign in (1, -1)]
            if min(near) > 0.0:  # away from the corner where the force ends
                quotient = (near[0] - near[1]) / (2 * step)
                assert exact[k] == pytest.approx(quotient, rel=1e-4, abs=1e-6 * (abs(got) + 1)), (seed, trial, k)


@settings(max_examples=300, deadline=None)
@given(st.floats(0, 0.1), st.floats(-100, 100), st.floats(1, 1e7), st.floats(0, 1e4))
def test_kelvin_voigt_never_pulls(depth, rate, stiffness, damping):
    assert kelvin_voigt(depth, rate, stiffness, damping) == max(0.0, stiffness * depth + damping * rate)


@settings(max_examples=300, deadline=None)
@given(st.floats(0, 0.1), st.floats(-100, 100), st.floats(1, 1e7), st.floats(0, 1e3), st.floats(1, 3))
def test_hunt_crossley_never_pulls_and_does_not_jump(depth, rate, stiffness, dissipation, exponent):
    force = hunt_crossley(depth, rate, stiffness, dissipation, exponent)
    assert force == pytest.approx(max(0.0, stiffness * depth**exponent * (1 + dissipation * rate)), rel=1e-12)
    assert hunt_crossley(0.0, rate, stiffness, dissipation, exponent) == 0.0


@settings(max_examples=300, deadline=None)
@given(st.floats(0, 100), st.floats(0, 100), st.floats(0, 10), st.floats(1e-6, 1))
def test_friction_is_bounded_by_coulomb_and_reaches_it(speed, force, friction, slip_speed):
    size = coulomb(speed, force, friction, slip_speed) * speed
    assert 0.0 <= size <= friction * force * (1 + 1e-12) + 1e-300  # smaller numbers have fewer digits
    # mu F (1 - e²/(2 v²)): at ten times the slip speed no more than 0.5 % is missing.
    if speed >= 10 * slip_speed:
        assert size >= friction * force * (1 - 0.005) - 1e-300
