"""Derivatives by dual numbers: the same values to the last bit, and what difference quotients and casadi find."""

import math

import casadi as ca
import numpy as np
import pytest
from numba import njit
from scenes import assembled, index
from scipy.spatial.transform import Rotation
from test_laws import LAWS, traced

from tissue_contact.assembly import Assembly
from tissue_contact.errors import WorkError
from tissue_contact.identify.sensitivity import sensitivities
from tissue_contact.kernels.dual import duals
from tissue_contact.simulate import rollout

H = 1e-3  # s
SCENE = """
    [solver]
    {solver}
    [[tissue]]
    shape = {{ kind = "patch", size = [0.03, 0.03], triangles = 200, seed = 3 }}
    areal_density = 2.0
    stiffness = 150.0
    damping = 0.01
    drag = 50.0
    support_stiffness = 2e5
    support_damping = 200.0
    {tissue}
    [[instrument]]
    shape = {{ kind = "capsule", radius = 0.003, length = 0.03, triangles = 300 }}
    {instrument}
    [[contact]]
    friction = 0.3
    {contact}
"""
FIXED = "substeps = 20\n"
FIELD = "stiffness_per_area = 2e7\ndamping_per_area = 5e3"
HULL = 'response = "hull"\nstiffness = 200.0\ndamping = 0.05'
STIFFENING = 'law = "hunt_crossley"\nexponent = {}\ndissipation = 5.0\n'
CASES = {
    "field": {"contact": FIELD},
    "hull": {"contact": HULL},
    "field, Hunt-Crossley": {"contact": STIFFENING.format(2.0) + "stiffness_per_area = 1e10"},
    "hull, Hunt-Crossley": {"contact": STIFFENING.format(1.5) + 'response = "hull"\nstiffness = 2e4'},
    "automatic substeps": {"contact": FIELD, "solver": ""},
    "implicit Euler": {"contact": FIELD, "solver": FIXED + 'integrator = "implicit_euler"'},
    "projective dynamics": {"contact": FIELD, "solver": FIXED + 'integrator = "projective_dynamics"'},
    "fast motion resolved": {
        "contact": FIELD,
        "solver": 'integrator = "projective_dynamics"\nmotion_limit = 1e-4',
    },
    "Runge-Kutta": {"contact": HULL, "solver": 'substeps = 40\nintegrator = "runge_kutta_4"'},
    "explicit Euler": {"contact": FIELD, "solver": 'substeps = 100\nintegrator = "explicit_euler"'},
    "surface": {"contact": FIELD, "tissue": "nonlinearity = 500.0\narea_stiffness = 50.0"},
    "thesis": {"contact": HULL.replace("hull", "oobb_literal")},
    "primitive": {"contact": HULL.replace("hull", "primitive")},
    "grasp": {
        "contact": FIELD,
        "instrument": "[instrument.grasp]\nstiffness = 50.0\ndamping = 0.01\nslip_force = 0.01\nradius = 0.004",
    },
}


def scene(case: str) -> Assembly:
    return assembled(SCENE.format(**{"solver": FIXED, "tissue": "", "instrument": ""} | CASES[case]))


def pressing(assembly: Assembly, steps: int = 20) -> np.ndarray:
    """Inputs of a probe that presses, slides and turns; jaws close on the way."""
    t = np.arange(steps + 1) / 20
    place = np.outer(t, [0.002, 0.001, -0.003]) + [0.001, 0.0005, -0.0001]
    turn = Rotation.from_euler("zy", np.outer(t, [40, 10]), degrees=True).as_quat(scalar_first=True)
    jaws = np.where(t < 0.2, 1.0, 0.0)[:, None]
    return np.hstack([place, turn, jaws])[:, : assembly.inputs.size]


def tuned(assembly: Assembly) -> dict[str, int]:
    """Slots of the parameters that are not zero, by their names without the object's."""
    found = [v for v in assembly.variables if v.block == "parameters" and assembly.parameters[v.slot] > 0]
    return {v.name.partition(".")[2]: v.slot for v in found}


@pytest.mark.parametrize("case", CASES)
def test_values_are_those_of_the_rollout_to_the_last_bit(case):
    assembly = scene(case)
    inputs, parameters = pressing(assembly), assembly.parameters * 1.01
    slots = list(tuned(assembly).values())
    outputs, derivatives = sensitivities(assembly, inputs, H, parameters, slots)
    assert np.array_equal(outputs, rollout(assembly, inputs, H, parameters).outputs)
    assert outputs[:, index(assembly, "instrument.force[3]")].max() > 0.01
    assert derivatives.shape == (*outputs.shape, len(slots))
    assert np.isfinite(derivatives).all()
    assert (abs(derivatives).max(axis=(0, 1)) > 0).all()


def errors_of_quotients(case: str, steps: int) -> dict[str, np.ndarray]:
    """By parameter: greatest error of central differences over relative steps of 1e-2 to 1e-9, a share of the greatest.

    Left out are outputs that a parameter moves by less than 1e-9 of their size, or of 1e-6: their quotients are
    rounding.
    """
    assembly = scene(case)
    inputs, parameters, slots = pressing(assembly, steps), assembly.parameters, tuned(assembly)
    outputs, derivatives = sensitivities(assembly, inputs, H, parameters, list(slots.values()))
    found = {}
    for (name, slot), exact in zip(slots.items(), np.moveaxis(derivatives, -1, 0), strict=True):
        size = abs(exact).max(axis=0)
        moved = size * parameters[slot] > 1e-9 * np.maximum(abs(outputs).max(axis=0), 1e-6)
        errors = []
        for step in 10.0 ** -np.arange(2, 10):
            one = step * parameters[slot] * np.eye(parameters.size)[slot]
            up, down = (rollout(assembly, inputs, H, parameters + sign * one).outputs for sign in (1, -1))
            quotient = (up - down) / (2 * one[slot])
            errors.append((abs(quotient - exact).max(axis=0)[moved] / size[moved]).max())
        found[name] = np.array(errors)
    return found


@pytest.mark.parametrize("case", CASES)
def test_quotients_come_close_and_leave_again_as_their_step_shrinks(case):
    """Down with the square of the step, or with a kink that it no longer meets, then up with rounding."""
    # The force of the thesis turns with the motion and has no potential: what differs a little soon differs altogether.
    found = errors_of_quotients(case, steps=4 if case == "thesis" else 8)
    assert {"stiffnessScale", "arealDensity", "supportStiffness"} < set(found)
    for name, errors in found.items():
        best = errors.min()
        # Dampers of contacts are solved to a residual, in one iteration more or less for either side of a quotient.
        assert best < 1e-5, (name, errors)
        assert errors[0] > 10 * best and errors[-1] > 10 * best, (name, errors)


def test_force_of_a_press_grows_by_the_depth():
    """F = k d on a held tissue: dF/dk = d, and nothing else tells the stiffness."""
    assembly = assembled("""
        [[tissue]]
        shape = { kind = "patch", size = [0.04, 0.04], triangles = 512 }
        areal_density = 1.0
        stiffness = 100.0
        fixed = { box = [[-1, -1, -1], [1, 1, 1]] }
        [[instrument]]
        shape = { kind = "box", size = [0.01, 0.01, 0.03], triangles = 48 }
        [[contact]]
        stiffness = 100.0
        response = "oobb"
    """)
    depth = np.linspace(0.0005, 0.002, 4)
    inputs = np.tile([0.0003, 0.0002, 0.0, 1.0, 0.0, 0.0, 0.0], (4, 1))
    inputs[:, 2] = -depth
    slots = tuned(assembly)
    _, derivatives = sensitivities(
        assembly, inputs, H, assembly.parameters, [slots["stiffness"], slots["stiffnessScale"]]
    )
    force, energy = (index(assembly, name) for name in ("instrument.force[3]", "energy.contact"))
    assert derivatives[:, force, 0] == pytest.approx(depth, rel=1e-9)
    assert derivatives[:, energy, 0] == pytest.approx(0.5 * depth**2, rel=1e-9)
    assert (derivatives[:, force, 1] == 0.0).all()


def test_what_stops_a_rollout_is_told_in_the_same_words():
    assembly = scene("field")
    inputs = pressing(assembly)
    inputs[7, 3:] = 0.0  # no orientation
    slot = tuned(assembly)["stiffnessPerArea"]
    high = assembly.parameters.copy()
    high[slot] = 1e30
    for parameters in (assembly.parameters, high):
        with pytest.raises(WorkError) as expected:
            rollout(assembly, inputs, H, parameters)
        with pytest.raises(WorkError) as got:
            sensitivities(assembly, inputs, H, parameters, [slot])
        assert str(got.value) == str(expected.value)


# What the kernels do with numbers, as they and as casadi write it; a and b are positive.
FUNCTIONS = {
    "sums": (lambda a, b: 2 + a - (b - 3.0) + (1 - a) * 0.5, None),
    "products": (lambda a, b: -a * b * a * 3, None),
    "quotients": (lambda a, b: a / b + 1.0 / a - b / 7, None),
    "powers": (lambda a, b: a**b + a**0.5 + 2.0**b, None),
    "sizes": (lambda a, b: abs(a - b) + abs(-a), lambda a, b: ca.fabs(a - b) + a),
    "greatest": (lambda a, b: max(0.0, a, b) * a, lambda a, b: ca.fmax(a, b) * a),
    "least": (lambda a, b: min(a, b, 1e9) * b, lambda a, b: ca.fmin(a, b) * b),
    "roots": (lambda a, b: math.sqrt(a) * np.sqrt(b), lambda a, b: ca.sqrt(a) * ca.sqrt(b)),
    "turns": (lambda a, b: math.sin(a) * math.cos(b), lambda a, b: ca.sin(a) * ca.cos(b)),
    "angle": (lambda a, b: math.atan2(a, b), ca.atan2),
    "branches": (lambda a, b: (a if a > b else 0.0) + (1.0 if a == b else b), lambda a, b: ca.if_else(a > b, a, 0) + b),
    "whole": (lambda a, b: a * int(b) * math.ceil(b), lambda a, b: a * ca.floor(b) * ca.ceil(b)),
}


def along(function, arguments: int):
    """The function of numbers and tangents, shape [arguments, 2]; the result is a tuple of both."""
    compiled = njit(error_model="numpy")(function) if function.__name__ == "<lambda>" else function
    if arguments == 2:
        return njit(lambda d: compiled(duals(d)[0], duals(d)[1]))
    if arguments == 4:
        return njit(lambda d: compiled(duals(d)[0], duals(d)[1], duals(d)[2], duals(d)[3]))
    return njit(lambda d: compiled(duals(d)[0], duals(d)[1], duals(d)[2], duals(d)[3], duals(d)[4]))


def agree(ours, symbolic: ca.Function, numbers: list[float], where: object) -> None:
    """Value and derivatives of a function on duals are those of casadi."""
    value, *exact = (float(number) for part in symbolic(*numbers) for number in part.elements())
    for k, of_one in enumerate(exact):
        tangents = np.arange(len(numbers)) == k
        got = ours(np.array([numbers, tangents], float).T.copy())
        assert got == pytest.approx((value, of_one), rel=1e-10, abs=1e-290), (where, k, numbers)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_arithmetic_differentiates_as_casadi_does(name):
    seed = 81
    rng = np.random.default_rng(seed)
    function, written = FUNCTIONS[name]
    a, b = ca.SX.sym("a"), ca.SX.sym("b")
    value = (written or function)(a, b)
    symbolic, ours = ca.Function(name, [a, b], [value, ca.gradient(value, ca.vertcat(a, b))]), along(function, 2)
    for trial in range(100):
        # below 10, where a power stays a number
        agree(ours, symbolic, list(10 ** rng.uniform([-6, -3], [6, 1])), (seed, trial))


DECADES = {
    "depth": (-8, -1), "rate": (-6, 1), "stiffness": (0, 10), "damping": (-3, 4), "dissipation": (-3, 1),
    "exponent": (0, 0.5), "speed": (-8, 1), "normal_force": (-6, 2), "friction": (-3, 0), "slip_speed": (-6, 0),
}  # fmt: skip


@pytest.mark.parametrize("name", LAWS)
def test_laws_differentiate_as_casadi_does(name):
    seed = 82
    rng = np.random.default_rng(seed)
    law, arguments = LAWS[name]
    symbolic, ours = traced(name), along(law, len(arguments))
    for trial in range(300):
        numbers = [10 ** rng.uniform(*DECADES[argument]) for argument in arguments]
        if "rate" in arguments:
            numbers[1] *= rng.choice([-1, 1])
        agree(ours, symbolic, numbers, (seed, trial))


def test_division_by_zero_is_infinite_and_stops_nothing():
    assert along(lambda a, b: 1.0 / b, 2)(np.array([[1.0, 0.0], [0.0, 1.0]])) == (np.inf, -np.inf)


def test_a_length_of_nothing_has_no_slope():
    ours = along(lambda x, y: math.sqrt(x * x + y * y), 2)
    assert ours(np.array([[0.0, 1.0], [0.0, 2.0]])) == (0.0, 0.0)
