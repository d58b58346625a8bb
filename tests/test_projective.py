"""Projective dynamics: its factor against scipy, its steps against implicit Euler, whose equations it solves."""

import itertools

import numpy as np
import pytest
from scenes import assembled, disturbed, index, vector, write_mesh
from scipy.sparse import coo_matrix, diags
from scipy.sparse.linalg import spsolve

from tissue_contact import assemble
from tissue_contact.errors import InputError
from tissue_contact.fmu.build import build
from tissue_contact.fmu.native import drive, host_platform
from tissue_contact.kernels import factor, slots
from tissue_contact.kernels.compiled import kernel
from tissue_contact.scenarios.bench import cut_cells
from tissue_contact.simulate import Instance, rollout

SEED = 18
SCENE = """
    [solver]
    integrator = "{integrator}"
    {solver}
    [[tissue]]
    shape = {{ kind = "patch", size = [0.03, 0.03], triangles = {triangles}, curvature_radius = 0.1, seed = 3 }}
    areal_density = 1.0
    stiffness = 100.0
    preload = {preload}
    drag = 20.0
    {tissue}
    [[instrument]]
    shape = {{ {shape} }}
    start_position = [0.0005, 0.0003, 0.0005]
    {instrument}
    [[contact]]
    {contact}
"""
BALL = 'kind = "sphere", radius = 0.003, triangles = 200'
FIELD = "stiffness_per_area = 1e7\ndamping_per_area = 2e3"
HULL = 'response = "hull"\nstiffness = 200.0\ndamping = 0.1'


def scene(integrator: str = "projective_dynamics", **parts: str | int):
    given = {
        "solver": "",
        "triangles": 600,
        "preload": 0.1,
        "tissue": "",
        "shape": BALL,
        "instrument": "",
        "contact": FIELD,
    }
    return assembled(SCENE.format(integrator=integrator, **(given | parts)))


def pressed(steps: int = 100, depth: float = 0.002, aside: float = 0.001) -> np.ndarray:
    """Poses of a press, a slide and a way out, shape [steps + 1, 7]."""
    t = np.linspace(0.0, 1.0, steps + 1)
    z = 0.0005 - (depth + 0.0005) * np.sin(np.pi * t) ** 2
    zero = np.zeros_like(t)
    return np.column_stack([0.0005 + aside * t, zero + 0.0003, z, zero + 1.0, zero, zero, zero])


@kernel
def _solve(model, parameters, scratch, dt, right):
    factor.ready(model, parameters, scratch, dt)
    scratch.right[: right.size] = right
    factor.forward(model, scratch)
    factor.backward(model, scratch)


@pytest.mark.parametrize("dt", [1e-5, 1e-3, 0.1])
def test_the_factor_solves_the_matrix_of_the_springs(dt):
    instance = Instance(scene(tissue="support_stiffness = 1e4\nsupport_damping = 50.0\ndamping = 0.01"))
    m = instance.model
    i, j, free = m.spring_i.astype(int), m.spring_j.astype(int), m.node_free > 0.0
    k = dt * dt * m.spring_stiffness / factor.SOFTER + dt * m.spring_damping
    laplacian = coo_matrix((np.concatenate([k, k, -k, -k]), (np.r_[i, j, i, j], np.r_[i, j, j, i])), (len(free),) * 2)
    matrix = (laplacian + diags(m.node_area * (1.0 + dt * (20.0 + 50.0 + dt * 1e4)))).tocsr()[free][:, free]
    print("seed", SEED)
    right = np.random.default_rng(SEED).standard_normal((len(free), 4))
    _solve(instance._model, instance.parameters, instance._scratch, dt, right[m.factor_vertex].ravel())
    found = np.empty_like(right)
    found[m.factor_vertex] = instance.scratch.right[: 4 * len(m.factor_vertex)].reshape(-1, 4)
    expected = spsolve(matrix.tocsc(), right[free])
    # rounding, over the condition of the matrix, at most some 1e4 here
    assert found[free] == pytest.approx(expected, rel=1e-9, abs=1e-10 * abs(expected).max())


CASES = {
    "field": {},
    "stiff field": {"contact": "stiffness_per_area = 1e9\ndamping_per_area = 1e4"},
    "hull": {"contact": HULL},
    "friction": {"contact": FIELD + "\nfriction = 0.5"},
    "hunt_crossley": {"contact": 'law = "hunt_crossley"\nstiffness_per_area = 5e9\nexponent = 1.5\ndissipation = 2.0'},
    "damped springs": {"tissue": "damping = 0.005"},
    "support": {"tissue": "support_stiffness = 1e5\nsupport_damping = 500.0"},
    "much preload": {"preload": 0.3},
    "weight": {"solver": "gravity = [0.0, 0.0, -1.0]"},
}


@pytest.mark.parametrize("name", CASES)
def test_iterated_it_gives_what_implicit_euler_gives(name):
    """Both solve the same equations: iterations without end end at the same motion.

    Under tension, as without it nothing but its mass holds a sheet across its plane, and iterations go on for long.
    """
    parts = CASES[name]
    solver = parts.get("solver", "")
    slow = rollout(scene("implicit_euler", **parts), pressed(), 1e-3)
    assembly = scene(**(parts | {"solver": solver + "\niterations = 60"}))
    fast = rollout(assembly, pressed(), 1e-3)
    force = vector(assembly, "instrument.force")
    peak = np.linalg.norm(slow.outputs[:, force], axis=1).max()
    assert peak > 0.005
    # Newton's iteration ends at 1e-6 of the first residual of a step, and a hundred steps add up
    assert abs(fast.outputs[:, force] - slow.outputs[:, force]).max() < 1e-4 * peak
    for what in ("energy.work", "energy.dissipated", "energy.elastic"):
        column = index(assembly, what)
        assert fast.outputs[:, column] == pytest.approx(
            slow.outputs[:, column], abs=2e-3 * slow.outputs[:, column].max()
        )


def test_more_iterations_err_less():
    force = vector(scene(), "instrument.force")
    exact = rollout(scene("implicit_euler"), pressed(), 1e-3).outputs[:, force]
    errors = []
    for iterations in (1, 2, 4, 8):
        found = rollout(scene(solver=f"iterations = {iterations}"), pressed(), 1e-3).outputs[:, force]
        errors.append(np.linalg.norm(found - exact) / np.linalg.norm(exact))
    assert errors[0] < 0.3 and all(b < 0.7 * a for a, b in itertools.pairwise(errors)), errors


def test_more_contact_than_compliances_are_kept_for_is_solved_as_well():
    parts = {"shape": 'kind = "box", size = [0.02, 0.02, 0.01]', "tissue": "support_stiffness = 1e5"}
    assembly = scene(solver="iterations = 60", **parts)
    found, exact = (rollout(a, pressed(), 1e-3).outputs for a in (assembly, scene("implicit_euler", **parts)))
    force = vector(assembly, "instrument.force")
    peak = int(np.argmax(np.linalg.norm(exact[:, force], axis=1)))
    instance = Instance(assembly)
    instance.inputs[:] = pressed()[peak]
    instance.initialize()
    instance.step(1e-3)
    assert instance.scratch.touched_count[0] > instance.scratch.slot_row.size == 96
    # as in the test above; more vertices, more of what Newton's iteration leaves: a dense solve differs as much from it
    assert abs(found[:, force] - exact[:, force]).max() < 1e-3 * np.linalg.norm(exact[peak, force])


def test_a_sheet_pinched_between_two_bodies_is_pressed_by_both():
    """Their pushes are opposite, and as stiff together as the two."""
    parts = {
        "instrument": """
            [[rigid]]
            name = "bone"
            shape = { kind = "sphere", radius = 0.01, triangles = 400 }
            position = [0.0, 0.0, -0.0205]
        """,
        "contact": """
            between = ["tissue", "instrument"]
            stiffness_per_area = 2e8
            damping_per_area = 1e4
            side = "both"
            [[contact]]
            between = ["tissue", "bone"]
            stiffness_per_area = 2e8
            damping_per_area = 1e4
        """,
    }

    def held(*integrator, **more):
        assembly = scene(*integrator, preload=0, **parts, **more)
        path = pressed(200, depth=0.0009, aside=0.0)[:101]
        path = np.concatenate([path, np.repeat(path[-1:], 50, axis=0)])
        return rollout(assembly, path, 1e-3).outputs[:, vector(assembly, "instrument.force")]

    exact, found = held("implicit_euler"), held(solver="iterations = 60")
    peak = np.linalg.norm(exact, axis=1).max()
    assert peak > 0.01
    assert abs(found - exact).max() < 1e-3 * peak


@pytest.mark.parametrize("contact", [FIELD, FIELD + "\nfriction = 0.5", HULL])
def test_kept_compliances_and_conjugate_gradients_solve_the_same_system(contact, monkeypatch):
    many = scene(contact=contact)
    monkeypatch.setattr(assemble, "KEPT_ROWS", 1)
    few = scene(contact=contact)
    assert (many.scratch.slot_row.size, few.scratch.slot_row.size) == (96, 1)
    force = vector(many, "instrument.force")
    a, b = (rollout(assembly, pressed(), 1e-3).outputs[:, force] for assembly in (many, few))
    # three iterations in each of a hundred steps, to `projective.SETTLED`, some larger and some smaller
    assert np.linalg.norm(a - b) < 1e-5 * np.linalg.norm(a)


def test_iterations_end_when_the_contacts_have_settled():
    """Between one iteration and all of them errors are between."""

    def forces(iterations, tolerance):
        assembly = scene(solver=f"iterations = {iterations}\ntolerance = {tolerance}")
        return rollout(assembly, pressed(), 1e-3).outputs[:, vector(assembly, "instrument.force")]

    exact = rollout(scene("implicit_euler"), pressed(), 1e-3).outputs[:, vector(scene(), "instrument.force")]
    found = [forces(1, 0.0), *(forces(8, tolerance) for tolerance in (0.03, 0.003, 0.0))]
    errors = [np.linalg.norm(f - exact) / np.linalg.norm(exact) for f in found]
    assert all(b < 0.9 * a for a, b in itertools.pairwise(errors)), errors


def test_iterations_go_on_while_what_is_not_touched_moves():
    """Contacts have nothing to settle there, and one iteration would let energy appear."""

    def shaken(tolerance):
        instance = Instance(scene(solver=f"iterations = 3\ntolerance = {tolerance}", preload=0))
        instance.inputs[:] = [0.0, 0.0, 0.01, 1.0, 0.0, 0.0, 0.0]
        instance.initialize()
        state = disturbed(instance).state
        print("seed", SEED)
        for v in (state.vx, state.vy, state.vz):
            v[:] = 1e-3 * instance.model.node_free * np.random.default_rng(SEED).standard_normal(v.size)
        for _ in range(5):
            instance.step(1e-3)
        return instance.outputs.copy(), np.concatenate([state.x, state.y, state.z])

    all_made, ended = shaken(0.0), shaken(0.01)
    assert np.array_equal(all_made[0], ended[0]) and np.array_equal(all_made[1], ended[1])


def test_a_state_given_back_goes_on_bit_by_bit_whatever_was_touched_since(monkeypatch):
    """What the factor and the compliances are kept for must not tell what was before."""
    monkeypatch.setattr(assemble, "KEPT_ROWS", 40)
    assembly = scene(triangles=4000)
    path = pressed(60, aside=0.015)
    there, elsewhere = Instance(assembly), Instance(assembly)
    for instance in (there, elsewhere):
        instance.inputs[:] = path[0]
        instance.initialize()

    def follow(instance, poses):
        touched, outputs = set(), []
        for row in poses:
            instance.inputs[:] = row
            instance.step(1e-3)
            touched |= set(instance.scratch.touched[: int(instance.scratch.touched_count[0])])
            outputs.append(instance.outputs.copy())
        return np.array(outputs), touched

    _, before = follow(there, path[1:31])
    saved = there.copy_state()
    first, after = follow(there, path[31:])
    assert len(before - after) > 10 and len(after - before) > 10
    assert len(before | after) > there.scratch.slot_row.size, "not all are kept"
    for instance in (there, elsewhere):
        instance.restore_state(saved)
        assert follow(instance, path[31:])[0].tobytes() == first.tobytes()


def test_the_fmu_steps_as_python_does(tmp_path):
    assembly = scene()
    fmu = build(assembly, tmp_path / "projective.fmu", [host_platform()])
    expected = rollout(assembly, pressed(), 1e-3).outputs[1:]
    force = vector(assembly, "instrument.force")
    assert np.linalg.norm(expected[:, force], axis=1).max() > 0.005
    assert np.array_equal(drive(fmu, pressed()[1:], 1e-3)[0], expected)


def _inverses(instance) -> np.ndarray:
    """Inverse of the diagonal of the factor [1/kg], shape [rows]."""
    m = instance.model
    within = np.arange(len(m.factor_vertex)) - m.factor_column[m.factor_panel]
    return instance.scratch.factor[4 * (m.factor_start[m.factor_panel] + within) + within]


def test_a_changed_parameter_and_another_step_make_another_factor():
    instance = Instance(scene())
    instance.inputs[:] = pressed()[0]
    instance.initialize()
    instance.step(1e-3)
    first = _inverses(instance)
    instance.parameters[slots.STIFFNESS_SCALE] = 2.0
    instance.step(1e-3)
    second = _inverses(instance)
    assert (second < first).all()
    instance.step(5e-4)
    assert (_inverses(instance) > second).all()


def test_right_sides_of_another_step_do_not_matter():
    """Nor those of columns that a panel lacks, which are read times zero."""
    fresh, spoiled = (Instance(scene(triangles=16)) for _ in range(2))
    assert np.diff(fresh.model.factor_column)[-1] < 4, "the last panel reaches beyond all rows"
    for instance in (fresh, spoiled):
        instance.inputs[:] = pressed()[0]
        instance.initialize()
    for pose in pressed()[1:61]:
        spoiled.scratch.right[:] = spoiled.scratch.unit_right[:] = np.nan
        for instance in (fresh, spoiled):
            instance.inputs[:] = pose
            instance.step(1e-3)
        assert np.array_equal(fresh.outputs, spoiled.outputs)
    assert fresh.scratch.touched_count[0] > 0


@pytest.mark.parametrize("effect", ["nonlinearity = 1.0", "area_stiffness = 10.0"])
def test_what_the_matrix_does_not_know_is_refused(effect):
    with pytest.raises(InputError, match=rf"no other forces.*{effect.split()[0]}.*implicit_euler"):
        scene(tissue=effect)


@pytest.mark.parametrize(("key", "value"), [("iterations", 2), ("tolerance", 0.01), ("motion_limit", 1e-4)])
def test_its_settings_belong_to_projective_dynamics(key, value):
    with pytest.raises(InputError, match=f"{key} has no meaning for integrator implicit_euler"):
        scene("implicit_euler", solver=f"{key} = {value}")


def test_one_iteration_is_stable_where_springs_in_one_line_bear_it(tmp_path):
    """Of cells four times as long as wide the springs across bear most: one needs all of its own stiffness.

    With two thirds of the Laplacian in the place of three quarters the sheet gains energy until it is refused.
    """
    x, y = (c.ravel() for c in np.meshgrid(np.linspace(-0.02, 0.02, 11), np.linspace(-0.02, 0.02, 41), indexing="ij"))
    surface = np.column_stack([x, y, -2.0 * (x * x + y * y)])
    write_mesh(tmp_path / "stretched.obj", surface, cut_cells(10, 40))

    def force(solver):
        assembly = assembled(f"""
            [solver]
            {solver}
            [[tissue]]
            mesh = "stretched.obj"
            open_surface = true
            areal_density = 1.0
            youngs_modulus = 1e5
            thickness = 0.002
            drag = 20.0
            [[instrument]]
            shape = {{ {BALL} }}
            start_position = [0.0005, 0.0003, 0.0005]
            [[contact]]
            {FIELD}
        """, tmp_path)  # fmt: skip
        return rollout(assembly, pressed(1000, depth=0.004), 1e-3).outputs[:, vector(assembly, "instrument.force")]

    exact = force('integrator = "symplectic_euler"')
    found = force('integrator = "projective_dynamics"\niterations = 1')
    assert np.linalg.norm(found - exact) < 0.05 * np.linalg.norm(exact)  # 3 % is what one iteration leaves out


# --- fast motion ------------------------------------------------------------------------------------------


def struck(steps: int = 60) -> np.ndarray:
    """Poses of a ball that comes to 2 mm of depth within 6 ms, at up to 0.8 m/s, stays and leaves as fast."""
    path = pressed(12)
    return np.concatenate([path[:7], np.repeat(path[6:7], steps - 12, axis=0), path[7:]])


def test_fast_motion_is_resolved():
    force = vector(scene(), "instrument.force")
    substeps = index(scene(), "solver.substeps")
    exact = rollout(scene("symplectic_euler", solver="safety = 0.1"), struck(), 1e-3).outputs[:, force]
    found = {}
    for limit in (0.0, 1e-4):
        run = rollout(scene(solver=f"motion_limit = {limit}"), struck(), 1e-3).outputs
        found[limit] = np.linalg.norm(run[:, force] - exact) / np.linalg.norm(exact)
        resolved = run[:, substeps] > 4  # continuous detection alone asks for up to four
        assert resolved.any() == (limit > 0.0)
        assert not resolved.all()
    # in steps that are resolved in part the schemes differ, and before and after none are
    assert found[1e-4] < 0.2 * found[0.0], found


def test_what_is_slow_is_not_resolved():
    one, other = (
        rollout(scene(solver=f"motion_limit = {limit}", preload=0), pressed(400), 1e-3).outputs for limit in (0.0, 1e-4)
    )
    assert np.array_equal(one, other)


def test_motion_that_is_too_fast_is_resolved_until_it_is_calm():
    """Else what symplectic Euler leaves swinging is sudden motion to the step after it."""
    force, balance = vector(scene(), "instrument.force"), index(scene(), "energy.balance")
    path = np.concatenate([pressed(100), *2 * [pressed(100)[1:]]])
    exact = rollout(scene("symplectic_euler", solver="safety = 0.1", preload=0), path, 1e-3).outputs[:, force]
    error, off = {}, {}
    for limit in (0.0, 8e-5):  # a press is at 0.08 m/s at most
        run = rollout(scene(solver=f"motion_limit = {limit}", preload=0), path, 1e-3).outputs
        error[limit] = np.linalg.norm(run[:, force] - exact)
        off[limit] = np.abs(run[:, balance]).max()
    assert error[8e-5] < 0.8 * error[0.0], error  # 0.66; 1.21 where every step begins with projective dynamics
    assert off[8e-5] < 0.3 * off[0.0], off  # 0.14; 2.7


def test_where_symplectic_euler_is_over_the_budget_shorter_substeps_resolve_fast_motion():
    force, substeps = vector(scene(), "instrument.force"), index(scene(), "solver.substeps")
    exact = rollout(scene("symplectic_euler", solver="safety = 0.1"), struck(), 1e-3).outputs[:, force]
    found = {}
    for limit in (0.0, 1e-4):
        run = rollout(scene(solver=f"max_substeps = 8\nmotion_limit = {limit}"), struck(), 1e-3).outputs
        found[limit] = np.linalg.norm(run[:, force] - exact) / np.linalg.norm(exact)
        assert run[:, substeps].max() == (8 if limit > 0.0 else 1)
    assert found[1e-4] < 0.8 * found[0.0], found  # eight in the place of one: 0.51 and 0.73


@pytest.mark.parametrize("solver", ["max_substeps = 1", "substeps = 2", "max_substeps = 2\nsubsteps = 2"])
def test_where_nothing_can_be_resolved_steps_stay_as_they_are(solver):
    """For want of substeps, or as the scene says how many there are."""
    one, other = (
        rollout(scene(solver=f"{solver}\nmotion_limit = {limit}"), struck(), 1e-3).outputs for limit in (0.0, 1e-4)
    )
    assert np.array_equal(one, other)


def test_a_step_is_resolved_in_the_fmu_as_in_python_and_anew_from_a_state_given_back(tmp_path):
    assembly = scene(solver="motion_limit = 1e-4")
    fmu = build(assembly, tmp_path / "resolved.fmu", [host_platform()])
    path = struck()
    expected = rollout(assembly, np.concatenate([path[:1], path]), 1e-3).outputs[1:]  # the FMU starts at row 0 as well
    assert np.array_equal(drive(fmu, path, 1e-3)[0], expected)
    instance = Instance(assembly)
    instance.inputs[:] = path[0]
    instance.initialize()
    for row, outputs in zip(path, expected, strict=True):
        saved = instance.copy_state()
        for _ in range(2):
            instance.restore_state(saved)
            instance.inputs[:] = row
            instance.step(1e-3)
            assert np.array_equal(instance.outputs, outputs)
