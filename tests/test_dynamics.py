"""Springs, masses and dampers in time: closed forms, frequencies, stable limit, order, energies."""

import numpy as np
import pytest
from scenes import assembled, chain, disturbed, index, settled, write_mesh
from scipy.integrate import solve_ivp

from tissue_contact.errors import WorkError
from tissue_contact.simulate import Instance, rollout

K, M, SPACING = 40.0, 0.02, 0.01  # N/m, kg, m


def steps_of(instance: Instance, count: int, h: float, vertex: int) -> np.ndarray:
    """Displacement of a vertex along x after each step, the start first."""
    rest = instance.model.rest_x[vertex]
    path = [instance.state.x[vertex] - rest]
    for _ in range(count):
        instance.step(h)
        path.append(instance.state.x[vertex] - rest)
    return np.array(path)


@pytest.mark.parametrize("mode", [1, 2, 5, 8])
def test_frequencies_of_a_chain(mode):
    """omega_j = 2 sqrt(k/m) sin(j pi / (2 (n + 1))), seen through the scheme's own exact recursion."""
    masses, dt = 8, 1e-3
    instance = settled(chain(masses, K, M, SPACING, substeps=1), [])
    shape = np.sin(mode * np.pi * np.arange(masses + 2) / (masses + 1))
    instance.state.x[:] += 1e-4 * shape
    disturbed(instance)
    vertex = int(np.argmax(abs(shape)))
    q = steps_of(instance, 60, dt, vertex)
    # q(n+1) - 2 q(n) + q(n-1) = -(omega dt)^2 q(n) for symplectic Euler; the fit is over all the steps.
    second = q[2:] - 2 * q[1:-1] + q[:-2]
    omega = np.sqrt(-(second @ q[1:-1]) / (q[1:-1] @ q[1:-1])) / dt
    assert omega == pytest.approx(2 * np.sqrt(K / M) * np.sin(mode * np.pi / (2 * (masses + 1))), rel=1e-9)


def oscillator(damping: float, substeps: int, stop: float) -> float:
    """Displacement of one mass between two damped springs at the time stop, from 1 mm at rest."""
    instance = settled(chain(1, K, M, SPACING, damping, substeps=substeps, max_substeps=100000), [])
    instance.state.x[1] += 1e-3
    disturbed(instance)
    return steps_of(instance, 1, stop, 1)[-1]


@pytest.mark.parametrize("damping", [0.0, 0.2])
def test_observed_order_of_the_integrator(damping):
    """First order against x = x0 e^(-a t) (cos(w t) + a/w sin(w t)), a = c/m, w^2 = 2k/m - a^2."""
    stop = 0.037
    a = damping / M  # two springs of damping c: 2 c / (2 m)
    w = np.sqrt(2 * K / M - a * a)
    exact = 1e-3 * np.exp(-a * stop) * (np.cos(w * stop) + a / w * np.sin(w * stop))
    errors = np.array([abs(oscillator(damping, n, stop) - exact) for n in (200, 400, 800)])
    assert np.log2(errors[:-1] / errors[1:]) == pytest.approx([1, 1], abs=0.1)


def test_overdamped_mass_creeps_back_without_overshoot():
    """A damper far beyond critical, implicit, is stable at a substep that would blow up an explicit one."""
    damping = 50.0  # explicit damping would need dt < m/c = 0.4 ms
    instance = settled(chain(1, K, M, SPACING, damping, substeps=1), [])
    instance.state.x[1] += 1e-3
    disturbed(instance)
    q = steps_of(instance, 400, 5e-3, 1)
    assert (np.diff(q) <= 0).all() and q[-1] > 0
    # The slow root of m s^2 + 2 c s + 2 k = 0.
    rate = (damping - np.sqrt(damping**2 - 2 * K * M)) / M
    assert q[-1] == pytest.approx(1e-3 * np.exp(-rate * 2.0), rel=0.01)


def test_a_damped_chain_follows_an_independent_solver():
    masses, damping, stop = 5, 0.1, 0.05
    instance = settled(chain(masses, K, M, SPACING, damping, substeps=4000, max_substeps=4000), [])
    rng = np.random.default_rng(41)
    start = rng.normal(0, 1e-3, masses)
    instance.state.x[1:-1] += start
    disturbed(instance)
    instance.step(stop)
    stiffness = 2 * np.eye(masses) - np.eye(masses, k=1) - np.eye(masses, k=-1)

    def rate(_, y):
        x, v = np.split(y, 2)
        return np.concatenate([v, -(stiffness @ (K * x + damping * v)) / M])

    end = solve_ivp(rate, (0, stop), np.concatenate([start, 0 * start]), rtol=1e-10, atol=1e-14).y[:, -1]
    # First order in 12.5 us: about omega dt / 2 = 0.06 % of the amplitude.
    assert instance.state.x[1:-1] - instance.model.rest_x[1:-1] == pytest.approx(end[:masses], abs=3e-6)


def energy_after(substeps: int, steps: int) -> float:
    assembly = chain(8, K, M, SPACING, substeps=substeps)
    instance = settled(assembly, [])
    rng = np.random.default_rng(42)
    instance.state.x[1:-1] += rng.normal(0, 1e-4, 8)
    disturbed(instance)
    for _ in range(steps):
        instance.step(0.03)
    return float(
        instance.outputs[index(assembly, "energy.kinetic")] + instance.outputs[index(assembly, "energy.elastic")]
    )


def test_stable_limit_of_a_chain():
    """omega dt = 2 for the highest mode: just below it energy stays bounded, just above it grows without end."""
    omega = 2 * np.sqrt(K / M) * np.sin(8 * np.pi / 18)
    limit = 0.03 * omega / 2  # substeps at the limit: 1.32
    stable, unstable = int(np.ceil(limit)), int(np.floor(limit))
    assert (stable, unstable) == (2, 1)
    assert energy_after(stable, 2000) < 1e-4
    with pytest.raises(WorkError, match="from nowhere"):
        energy_after(unstable, 2000)


@pytest.mark.parametrize(
    ("stretch", "factor"), [(0.9, 1.0), (0.5, 1.0), (0.4, 1.5), (0.25, 3.0), (1e-3, 4.0), (0.0, 4.0)]
)
def test_a_crushed_spring_asks_for_shorter_substeps_from_then_on(stretch, factor):
    """Across it the stiffness is k (l/L - 1), counted up to a fifth of its length, and not let go when it is."""
    instance = settled(chain(8, K, M, SPACING, max_substeps=100_000, energy_gain=1e6), [])
    h, substeps = 10.0, index(instance._assembly, "solver.substeps")
    needed = h * np.sqrt(4 * K / M) / 2 / 0.95
    saved = instance.copy_state()
    instance.state.x[1] = stretch * SPACING
    disturbed(instance).step(h)
    assert instance.outputs[substeps] == np.ceil(needed * np.sqrt(factor))
    assert instance.state.crush[0] == pytest.approx(factor)
    instance.state.x[:], instance.state.vx[:] = instance.model.rest_x, 0.0
    disturbed(instance).step(h)
    assert instance.outputs[substeps] == np.ceil(needed * np.sqrt(instance.state.crush[0]))
    instance.restore_state(saved)
    instance.step(h)
    assert instance.outputs[substeps] == np.ceil(needed)


MESH = """
    [solver]
    {solver}
    [[tissue]]
    shape = {{ kind = "ellipsoid", radii = [0.02, 0.015, 0.012], triangles = 600, seed = 5 }}
    areal_density = {density}
    stiffness = {stiffness}
    bending_stiffness = {bending}
    support_stiffness = {support}
    fixed = "none"
"""


def shaken(text: str, steps: int = 300) -> Instance:
    instance = settled(assembled(text), [])
    rng = np.random.default_rng(43)
    for v in (instance.state.vx, instance.state.vy, instance.state.vz):
        v[:] = rng.normal(0, 0.02, v.size)
    disturbed(instance)
    for _ in range(steps):
        instance.step(1e-3)
    return instance


@pytest.mark.parametrize(
    ("stiffness", "bending", "support", "density"),
    [(200, 0, 0, 1.0), (5000, 100, 0, 1.0), (50, 0, 1e6, 0.2), (1e5, 1e4, 1e7, 5.0)],
)
def test_automatic_substeps_are_stable_and_not_wasteful(stiffness, bending, support, density):
    values = {"stiffness": stiffness, "bending": bending, "support": support, "density": density}
    instance = shaken(MESH.format(solver="", **values))
    assembly = instance._assembly
    total = sum(instance.outputs[index(assembly, f"energy.{kind}")] for kind in ("kinetic", "elastic"))
    start = 3 * 0.5 * 0.02**2 * density * instance.model.node_area.sum()
    assert total < 1.5 * start
    chosen = int(instance.outputs[index(assembly, "solver.substeps")])
    with pytest.raises(WorkError):
        # A margin of 0.9 and a bound that holds however the mesh is deformed: less than half as many must fail.
        shaken(MESH.format(solver=f"substeps = {max(1, int(chosen * 0.45))}", **values), 3000)


def test_refused_when_the_budget_does_not_allow_a_stable_step():
    text = MESH.format(solver="max_substeps = 5", stiffness=1e5, bending=0, support=0, density=1.0)
    instance = settled(assembled(text), [])
    with pytest.raises(WorkError, match=r"needs \d+ substeps and the scene allows 5.*max_substeps"):
        instance.step(1e-3)


def test_gravity_and_support_find_the_closed_form_of_rest():
    """A patch on an elastic foundation sinks by rho g / k."""
    assembly = assembled("""
        [solver]
        gravity = [0.0, 0.0, -9.81]
        [[tissue]]
        shape = { kind = "patch", size = [0.02, 0.02], triangles = 200 }
        areal_density = 2.0
        stiffness = 100.0
        support_stiffness = 2e4
        support_damping = 400.0
        fixed = "none"
        probes = [[0.001, 0.002, 0.0]]
    """)
    instance = settled(assembly, [])
    for _ in range(600):
        instance.step(1e-3)
    height = instance.outputs[index(assembly, "tissue.probe[1].position[3]")]
    assert height == pytest.approx(-2.0 * 9.81 / 2e4, rel=1e-6)
    balance = instance.outputs[index(assembly, "energy.balance")]
    # Released weight has all gone into the dampers; first order in the substep.
    assert abs(balance) < 0.02 * instance.outputs[index(assembly, "energy.dissipated")]


def test_stiffness_from_youngs_modulus_and_thickness():
    """k = E t (adjacent areas) / l^2: for equilateral triangles sqrt(3)/2 E t inside and half of it at a rim."""
    from tissue_contact import geometry, shapes

    modulus, thickness = 3000.0, 0.002
    assembly = assembled(f"""
        [[tissue]]
        shape = {{ kind = "patch", size = [0.02, 0.02], triangles = 200, irregular = false }}
        areal_density = 1.0
        youngs_modulus = {modulus}
        thickness = {thickness}
    """)
    surface = shapes.patch((0.02, 0.02), 200, irregular=False)
    areas = geometry.triangle_areas(surface)
    total = 0.0  # sum of k l^2 = E t (each area once for each of its three sides)
    for k, l0 in zip(assembly.model.spring_stiffness, assembly.model.spring_rest, strict=True):
        total += k * l0 * l0
    assert total == pytest.approx(modulus * thickness * 3 * areas.sum(), rel=1e-12)


def impact(zeta: float, folder, substeps: int) -> float:
    """Ratio of the speed after to the speed before of a free plate that meets a still box along its normal."""
    corner = 0.05 * np.array([[np.cos(a), np.sin(a), 0] for a in 2 * np.pi * np.arange(3) / 3])
    mesh = write_mesh(folder / "plate.obj", corner, np.array([[0, 1, 2]]))
    stiffness, density = 200.0, 2.0
    mass = density * 0.05**2 * 3 * np.sqrt(3) / 4
    damping = 2 * zeta * np.sqrt(stiffness * mass)
    assembly = assembled(
        f"""
        [solver]
        substeps = {substeps}
        max_substeps = {substeps}
        detection_period = 1e-6
        [[tissue]]
        mesh = "{mesh}"
        open_surface = true
        fixed = "none"
        areal_density = {density}
        stiffness = 1e5
        [[instrument]]
        shape = {{ kind = "box", size = [0.01, 0.01, 0.03], triangles = 12 }}
        [[contact]]
        response = "hull"
        stiffness = {stiffness}
        damping = {damping}
        """,
        folder,
    )
    instance = settled(assembly, [0, 0, 1e-3, 1, 0, 0, 0])
    instance.state.vz[:] = 0.5
    disturbed(instance)
    for _ in range(60):
        instance.step(2e-3)
    assert instance.outputs[index(assembly, "instrument.depth")] == 0.0
    assert np.ptp(instance.state.vz) < 1e-9, "a push at the middle does not tilt the plate"
    return -float(instance.state.vz.mean()) / 0.5


# model section 9: e = exp(-(zeta/s) atan2(2 zeta s, 2 zeta^2 - 1)), s = sqrt(1 - zeta^2)
@pytest.mark.parametrize(("zeta", "restitution"), [(0.1, 0.7441), (0.3, 0.4510), (0.6, 0.2488)])
def test_restitution_of_an_impact_on_a_kelvin_voigt_wall(zeta, restitution, tmp_path):
    s = np.sqrt(1 - zeta**2)
    assert np.exp(-zeta / s * np.arctan2(2 * zeta * s, 2 * zeta**2 - 1)) == pytest.approx(restitution, abs=5e-5)
    # The impact lasts pi / (omega s), some 20 ms; the substep of 5 us leaves an error of its share, about 1e-3.
    assert impact(zeta, tmp_path, 400) == pytest.approx(restitution, abs=2e-3)


def test_undamped_impact_gives_all_the_speed_back(tmp_path):
    assert impact(0.0, tmp_path, 400) == pytest.approx(1.0, abs=2e-3)


PRESS = """
    [[tissue]]
    shape = { kind = "patch", size = [0.04, 0.04], triangles = 1500, seed = 2 }
    areal_density = 1.0
    stiffness = 200.0
    support_stiffness = 1e5
    support_damping = 2000.0
    [[instrument]]
    shape = { kind = "capsule", radius = 0.0025, length = 0.03, triangles = 700 }
    start_position = [0.0, 0.0, 0.001]
    [[contact]]
    stiffness = 200.0
    damping = 0.1
    response = "hull"
"""


def press_poses(steps: int) -> np.ndarray:
    t = np.linspace(0, 1, steps + 1)
    poses = np.zeros((steps + 1, 7))
    poses[:, 2] = 0.001 - 0.005 * np.sin(np.pi * t) ** 2
    poses[:, 3] = 1.0
    return poses


def test_a_closed_cycle_takes_energy_and_gives_none():
    assembly = assembled(PRESS)
    outputs = rollout(assembly, press_poses(400), 1e-3).outputs
    work = outputs[:, index(assembly, "energy.work")]
    assert work.max() > 1e-4
    assert work[-1] > 0.1 * work.max(), "a soft tissue loses part of what is put in"


def test_result_does_not_depend_on_how_time_is_cut():
    """The same motion in steps of 1 ms and of 4 ms: equal to the order of the integrator and of the detection."""
    assembly = assembled(PRESS)
    fine = rollout(assembly, press_poses(400), 1e-3).outputs
    force, depth = index(assembly, "instrument.force[3]"), index(assembly, "instrument.depth")
    coarse = rollout(assembly, press_poses(400)[::4], 4e-3).outputs
    peak = fine[:, force].max()
    assert peak > 0.05
    # The ramp of 4 ms cuts the corners of the motion by up to 5 mm (pi 4 ms / 0.4 s)^2 / 4 = 1 um of some 0.4 mm.
    difference = np.sqrt(np.mean((coarse[:, force] - fine[::4, force]) ** 2))
    assert difference < 0.02 * peak
    assert coarse[:, depth].max() == pytest.approx(fine[:, depth].max(), rel=0.02)


def test_a_state_taken_in_contact_continues_bit_for_bit():
    assembly = assembled(PRESS)
    poses = press_poses(400)
    instance = settled(assembly, poses[0])
    for pose in poses[1:150]:
        instance.inputs[:] = pose
        instance.step(1e-3)
    assert instance.outputs[index(assembly, "instrument.depth")] > 0
    saved = instance.copy_state()
    ends = []
    for _ in range(2):
        instance.restore_state(saved)
        for pose in poses[150:200]:
            instance.inputs[:] = pose
            instance.step(1e-3)
        ends.append([*(block.tobytes() for block in instance.copy_state()), instance.outputs.tobytes()])
    assert ends[0] == ends[1]


def test_wrong_input_leaves_the_state_as_it_was():
    assembly = assembled(PRESS)
    instance = settled(assembly, [0, 0, -0.002, 1, 0, 0, 0])
    before = [block.tobytes() for block in instance.copy_state()]
    for slot, value, message in [
        (2, np.nan, "input slot 2 is nan"),
        (0, np.inf, "input slot 0 is inf"),
        (slice(3, 7), 0.0, "norm 0"),
    ]:
        kept = instance.inputs.copy()
        instance.inputs[slot] = value
        with pytest.raises(WorkError, match=message):
            instance.step(1e-3)
        instance.inputs[:] = kept
        assert [block.tobytes() for block in instance.copy_state()] == before
    instance.step(1e-3)


def test_an_unnormalised_quaternion_is_normalised():
    assembly = assembled(PRESS)
    turn = np.array([0.9, 0.1, -0.2, 0.3])
    plain = settled(assembly, [0, 0, -0.001, *(turn / np.linalg.norm(turn))]).outputs
    assert settled(assembly, [0, 0, -0.001, *(1000 * turn)]).outputs == pytest.approx(plain, rel=1e-9, abs=1e-12)


def test_a_quaternion_and_its_negative_are_one_orientation():
    """A tracker may change the sign from one sample to the next: that is no turn by 360 degrees."""
    assembly = assembled(PRESS)
    outputs = []
    for sign in (1.0, -1.0):
        instance = settled(assembly, [0, 0, -0.001, 0.9, 0.1, -0.2, 0.3])
        instance.inputs[:] = [0.0005, 0, -0.001, *(sign * np.array([0.88, 0.12, -0.2, 0.32]))]
        instance.step(1e-3)
        outputs.append(instance.outputs.copy())
    assert outputs[0][index(assembly, "instrument.force[3]")] > 1e-3, "in contact"
    assert outputs[1] == pytest.approx(outputs[0], rel=1e-9, abs=1e-12)
