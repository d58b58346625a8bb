"""What the parts of a scene do together: fields, friction, grasps, rigid bodies, several tissues, closed cycles."""

import numpy as np
import pytest
from scenes import assembled, index, settled, vector
from scipy.spatial.transform import Rotation

from tissue_contact.assembly import Assembly
from tissue_contact.errors import InputError
from tissue_contact.simulate import Instance, rollout

HELD = "{ box = [[-1, -1, -1], [1, 1, 1]] }"  # every vertex


def path(steps: int, *columns: np.ndarray | float) -> np.ndarray:
    """Inputs of every moment from columns of numbers or of one number each."""
    return np.column_stack([np.broadcast_to(column, steps + 1) for column in columns])


BALL = f"""
    [[tissue]]
    shape = {{ kind = "patch", size = [0.03, 0.03], triangles = 1500 }}
    areal_density = 1.0
    stiffness = 100.0
    fixed = {HELD}
    [[instrument]]
    shape = {{ kind = "sphere", radius = 0.005, triangles = 400 }}
    [[contact]]
"""


@pytest.mark.parametrize(
    ("contact", "exponent"),
    [("stiffness_per_area = 1e7", 1.0), ('law = "hunt_crossley"\nstiffness_per_area = 1e10\nexponent = 2.0', 2.0)],
)
def test_a_ball_in_a_held_sheet(contact, exponent):
    """F = 2 pi k (R - d) d^(n+1) / (n + 1): the push k (R - r)^n (R - d)/r over the disc of r² < R² - (R - d)²."""
    k, radius, depth = (1e7 if exponent == 1.0 else 1e10), 0.005, 0.002
    assembly = assembled(BALL + contact + "\nquadrature_spacing = 2e-4")
    force = settled(assembly, [0, 0, -depth, 1, 0, 0, 0]).outputs[vector(assembly, "instrument.force")]
    # In a flat sheet at depth d below, phi = rho - R with rho² = r² + (R - d)², so dr r = d rho rho.
    exact = 2 * np.pi * k * (radius - depth) * depth ** (exponent + 1) / (exponent + 1)
    # Midpoints 0.2 mm apart on a disc of 4 mm radius: an error of the order of (0.2/4)² and of where the rim falls.
    assert force[2] == pytest.approx(exact, rel=0.01)
    assert abs(force[:2]).max() < 0.02 * exact


def test_friction_of_a_sliding_ball():
    """F_t = mu F_n v / sqrt(v² + e²), against the motion, at every speed."""
    friction, slip_speed = 0.4, 0.002
    text = BALL + f"stiffness_per_area = 1e7\nfriction = {friction}\nslip_speed = {slip_speed}"
    assembly = assembled(text)
    for speed in (5e-4, 2e-3, 2e-2):
        inputs = path(40, speed * 1e-3 * np.arange(41), 0.0, -1e-3, 1.0, 0.0, 0.0, 0.0)
        mean = rollout(assembly, inputs, 1e-3).outputs[1:, vector(assembly, "instrument.meanForce")].mean(axis=0)
        # The normals of a held sheet under a ball are inclined, which takes a part of the friction out of the plane.
        expected = friction * mean[2] * speed / np.hypot(speed, slip_speed)
        assert mean[0] == pytest.approx(-expected, rel=0.05), speed


GRASP = """
    [[tissue]]
    shape = { kind = "patch", size = [0.04, 0.04], triangles = 1200 }
    areal_density = 1.0
    stiffness = 100.0
    support_stiffness = 1e5
    support_damping = 3000.0
    [[instrument]]
    shape = { kind = "grasper", radius = 0.0025, length = 0.04, jaw_length = 0.012, triangles = 300 }
    [instrument.grasp]
    radius = 0.004
    stiffness = 500.0
    damping = 0.5
    slip_force = 0.3
    [[contact]]
    stiffness_per_area = 1e6
"""


def pulled(lift: float, steps: int = 500) -> tuple[Assembly, np.ndarray]:
    """Outputs as closed jaws lift a patch, hold it, and open in the last fifth."""
    assembly = assembled(GRASP)
    t = np.linspace(0, 1, steps + 1)
    height = lift * np.clip(t / 0.5, 0, 1)
    jaw = np.where((t > 0.02) & (t < 0.8), 0.0, 1.0)
    return assembly, rollout(assembly, path(steps, 0.0, 0.0, height, 1.0, 0.0, 0.0, 0.0, jaw), 1e-3).outputs


def test_jaws_hold_the_tissue_and_let_go():
    assembly, outputs = pulled(0.001)
    force, held = outputs[:, index(assembly, "instrument.force[3]")], outputs[:, index(assembly, "instrument.grasped")]
    assert held[0] == 0 and held[100] > 5 and (held[100:390] == held[100]).all() and held[-1] == 0
    assert -0.3 < force[300:390].min() < -0.005, "the tissue pulls back"
    assert force[-1] == 0.0
    balance, work = (outputs[:, index(assembly, f"energy.{name}")] for name in ("balance", "work"))
    assert abs(balance).max() < 0.01 * work.max(), "what the hold stored when it opened is dissipated"
    assert work[-1] > 0.0


def test_tissue_slips_from_the_jaws_at_the_slip_force():
    assembly, outputs = pulled(0.02)
    force, held = outputs[:, index(assembly, "instrument.force[3]")], outputs[:, index(assembly, "instrument.grasped")]
    # The spring is held to 0.3 N; the damper adds 0.5 N·s/m times 0.08 m/s.
    assert -0.3 - 0.5 * 0.08 <= force.min() < -0.2
    assert held[100] > held[390] == 0, "it slid out of the jaws before they opened"
    balance, work = (outputs[:, index(assembly, f"energy.{name}")] for name in ("balance", "work"))
    assert abs(balance).max() < 0.01 * work.max()


def test_tissue_at_rest_on_a_rigid_body():
    """Weight per area is depth times stiffness per area, and the body bears the whole of it."""
    density, stiffness = 2.0, 1e6
    assembly = assembled(f"""
        [solver]
        gravity = [0.0, 0.0, -9.81]
        [[tissue]]
        shape = {{ kind = "patch", size = [0.02, 0.02], triangles = 300 }}
        areal_density = {density}
        stiffness = 100.0
        drag = 500.0
        fixed = "none"
        [[rigid]]
        name = "bone"
        shape = {{ kind = "box", size = [0.04, 0.04, 0.01] }}
        position = [0.0, 0.0, -0.01]
        [[contact]]
        between = ["bone", "tissue"]
        stiffness_per_area = {stiffness}
        damping_per_area = 500.0
    """)
    instance = settled(assembly, [])
    for _ in range(400):
        instance.step(1e-3)
    depth = density * 9.81 / stiffness
    assert instance.outputs[index(assembly, "bone.depth")] == pytest.approx(depth, rel=1e-6)
    area = instance.model.node_area.sum()
    assert instance.outputs[index(assembly, "bone.force[3]")] == pytest.approx(-density * 9.81 * area, rel=1e-6)


CLASH = """
    [[instrument]]
    name = "left"
    shape = { kind = "capsule", radius = 0.0025, length = 0.06, triangles = 600 }
    [[instrument]]
    name = "right"
    shape = { kind = "box", size = [0.006, 0.004, 0.06], triangles = 200 }
    [[contact]]
    between = ["left", "right"]
    stiffness_per_area = 1e9
    damping_per_area = 1e5
    friction = 0.2
"""


def test_clashing_instruments_push_each_other_alike():
    """Forces and moments about any point are opposite; what was put in and not dissipated comes back."""
    assembly = assembled(CLASH)
    steps = 400
    t = np.linspace(0, 1, steps + 1)
    lean = np.array(
        [Rotation.from_euler("xyz", [80 + 10 * s, 5, 20 * s], degrees=True).as_quat(scalar_first=True) for s in t]
    )
    gap = 0.006 - 0.0025 * np.sin(np.pi * t) ** 2
    left = np.column_stack([0 * t, gap, 0.03 + 0 * t, lean])
    right = path(steps, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
    outputs = rollout(assembly, np.hstack([left, right]), 1e-3).outputs
    forces = [outputs[:, vector(assembly, f"{name}.force")] for name in ("left", "right")]
    torques = [outputs[:, vector(assembly, f"{name}.torque")] for name in ("left", "right")]
    peak = abs(forces[0]).max()
    assert peak > 0.5
    assert forces[0] + forces[1] == pytest.approx(0.0, abs=1e-12 * peak)
    about_origin = torques[0] + np.cross(left[:, :3], forces[0]) + torques[1] + np.cross(right[:, :3], forces[1])
    assert about_origin == pytest.approx(0.0, abs=1e-13 * peak)
    balance, work = (outputs[:, index(assembly, f"energy.{name}")] for name in ("balance", "work"))
    assert abs(balance).max() < 0.01 * work.max()
    assert work[-1] > 0.0


def test_an_instrument_against_a_bone():
    """A cylinder's flat end on a box: pressure over the whole end, k A d."""
    stiffness, radius, depth = 1e9, 0.003, 2e-4
    assembly = assembled(f"""
        [[instrument]]
        shape = {{ kind = "cylinder", radius = {radius}, length = 0.03, triangles = 800 }}
        [[rigid]]
        name = "bone"
        shape = {{ kind = "box", size = [0.04, 0.04, 0.01] }}
        position = [0.0, 0.0, -0.01]
        [[contact]]
        between = ["instrument", "bone"]
        stiffness_per_area = {stiffness}
    """)
    instance = settled(assembly, [0, 0, -depth, 1, 0, 0, 0])
    force = instance.outputs[index(assembly, "instrument.force[3]")]
    # The end is a polygon of facets round the circle, which lacks 2 % of its area, and the wall dips in by 0.2 mm,
    # whose points push sideways only.
    assert force == pytest.approx(stiffness * np.pi * radius**2 * depth, rel=0.03)
    assert instance.outputs[index(assembly, "bone.force[3]")] == pytest.approx(-force, rel=1e-12)


def test_two_tissues_do_not_feel_each_other_but_both_the_instrument():
    """Two patches side by side under one bar give twice the force of one alone."""
    patch = """
        [[tissue]]
        name = "{name}"
        shape = {{ kind = "patch", size = [0.02, 0.02], triangles = 400 }}
        position = [{x}, 0.0, 0.0]
        areal_density = 1.0
        stiffness = 100.0
        support_stiffness = 1e5
        support_damping = 1000.0
    """
    bar = """
        [[instrument]]
        shape = { kind = "box", size = [0.06, 0.006, 0.01] }
    """
    contact = '[[contact]]\nbetween = ["{name}", "instrument"]\nstiffness_per_area = 1e7\ndamping_per_area = 3e3\n'
    names, places = ("a", "b"), (-0.015, 0.015)
    press = path(200, 0.0, 0.0, 0.001 - 0.002 * np.linspace(0, 1, 201), 1.0, 0.0, 0.0, 0.0)
    forces = {}
    for chosen in (names[:1], names[1:], names):
        text = "".join(patch.format(name=n, x=places[names.index(n)]) for n in chosen)
        text += bar + "".join(contact.format(name=n) for n in chosen)
        assembly = assembled(text)
        forces[chosen] = rollout(assembly, press, 1e-3).outputs[:, index(assembly, "instrument.force[3]")]
    alone = forces[("a",)] + forces[("b",)]
    assert alone.max() > 0.01
    # The substeps of both are those of the stiffer one: an error of the first order in 0.05 ms.
    assert forces[names] == pytest.approx(alone, abs=2e-3 * alone.max())


@pytest.mark.parametrize(
    ("shape", "found"),
    [('{ kind = "patch", size = [0.02, 0.02], triangles = 100 }', "an open surface")],
)
def test_only_a_closed_surface_has_a_volume(shape, found):
    text = f"[[tissue]]\nshape = {shape}\nareal_density = 1.0\nstiffness = 100.0\nvolume_stiffness = 1e4\n"
    with pytest.raises(InputError, match=rf"tissue\[tissue\].volume_stiffness.*closed.*found {found}.*Remove"):
        assembled(text)


def test_volume_is_kept_as_stiffly_as_asked():
    """An organ that is pressed flat between bone and probe keeps its volume the better the stiffer it is asked to."""
    lost = []
    for stiffness in (1e3, 1e5):
        assembly = assembled(f"""
            [[tissue]]
            shape = {{ kind = "ellipsoid", radii = [0.015, 0.012, 0.01], triangles = 600 }}
            areal_density = 1.0
            stiffness = 100.0
            drag = 1000.0
            volume_stiffness = {stiffness}
            fixed = {{ box = [[-1, -1, -1], [1, 1, -0.005]] }}
            [[instrument]]
            shape = {{ kind = "sphere", radius = 0.01, triangles = 400 }}
            [[contact]]
            stiffness_per_area = 1e7
            damping_per_area = 3e3
        """)
        instance = settled(assembly, [0, 0, 0.011, 1, 0, 0, 0])
        for z in 0.011 - 0.005 * np.linspace(0, 1, 151)[1:]:
            instance.inputs[2] = z
            instance.step(1e-3)
        t = [instance.model.triangle_a, instance.model.triangle_b, instance.model.triangle_c]
        x = np.array([instance.state.x, instance.state.y, instance.state.z]).T
        volume = np.einsum("ij,ij->", x[t[0]], np.cross(x[t[1]], x[t[2]])) / 6
        lost.append(1 - volume / instance.model.tissue_volume[0])
    assert lost[0] > 0.02
    assert 0 < lost[1] < 0.2 * lost[0]


@pytest.mark.parametrize("scheme", ["symplectic_euler", "implicit_euler"])
def test_a_cavity_keeps_its_volume_as_an_organ_does(scheme):
    """The triangles of a flipped surface face inward, and its signed volume is negative."""
    moved = {}
    for flip in ("false", "true"):
        instance = Instance(assembled(f"""
            [solver]
            integrator = "{scheme}"
            gravity = [0.0, 0.0, -9.81]
            [[tissue]]
            shape = {{ kind = "ellipsoid", radii = [0.015, 0.012, 0.01], triangles = 100 }}
            flip = {flip}
            areal_density = 1.0
            stiffness = 100.0
            drag = 100.0
            support_stiffness = 1e4
            volume_stiffness = 1e5
        """))  # fmt: skip
        instance.initialize()
        for _ in range(100):
            instance.step(1e-3)
        moved[flip] = np.array([instance.state.x, instance.state.y, instance.state.z])
    # the same equations, but for the order of their sums
    assert moved["true"] == pytest.approx(moved["false"], abs=1e-9)
    assert moved["true"][2].mean() < -5e-4


CYCLE = """
    [solver]
    integrator = "{scheme}"
    [[tissue]]
    shape = {{ kind = "patch", size = [0.04, 0.04], triangles = 1000, seed = 2 }}
    areal_density = 1.0
    stiffness = 200.0
    support_stiffness = 1e5
    {tissue}
    [[instrument]]
    shape = {shape}
    [[contact]]
    {contact}
"""
CAPSULE = '{ kind = "capsule", radius = 0.0025, length = 0.03, triangles = 400 }'
HOOK = '{ kind = "hook", radius = 0.0025, length = 0.03, hook_length = 0.01, triangles = 300 }'
FIELD = "stiffness_per_area = 5e7\ndamping_per_area = 1e4"


@pytest.mark.parametrize(
    ("options", "bound"),
    [
        ({}, 0.01),
        ({"shape": HOOK}, 0.01),  # a sampled field
        ({"contact": FIELD + "\nfriction = 0.5"}, 0.01),
        ({"contact": 'law = "hunt_crossley"\nstiffness_per_area = 5e9\nexponent = 1.5\ndissipation = 2.0'}, 0.01),
        ({"tissue": "nonlinearity = 20.0\npreload = 0.02\nsupport_damping = 2000.0"}, 0.01),
        ({"tissue": "area_stiffness = 100.0\ndamping = 0.005\nsupport_damping = 1000.0"}, 0.01),
        ({"scheme": "runge_kutta_4"}, 1e-5),
        ({"scheme": "explicit_euler"}, 0.01),
        # One substep a millisecond dissipates by itself; it never makes energy.
        ({"scheme": "implicit_euler"}, 0.05),
    ],
    ids=["field", "sampled field", "friction", "hunt_crossley", "nonlinear", "area", "rk4", "explicit", "implicit"],
)
def test_a_closed_cycle_never_returns_more_than_was_put_in(options, bound):
    """Press, slide and leave: the balance stays within a share of the work done, and nothing is gained at the end."""
    values = {
        "scheme": "symplectic_euler", "tissue": "support_damping = 2000.0", "shape": CAPSULE, "contact": FIELD,
    } | options  # fmt: skip
    assembly = assembled(CYCLE.format(**values))
    t = np.linspace(0, 1, 301)
    height = 0.001 - 0.004 * np.sin(np.pi * t) ** 2
    outputs = rollout(assembly, path(300, 0.004 * t - 0.002, 0.0, height, 1.0, 0.0, 0.0, 0.0), 1e-3).outputs
    balance, work = (outputs[:, index(assembly, f"energy.{name}")] for name in ("balance", "work"))
    assert work.max() > 5e-5
    assert abs(balance).max() < bound * work.max()
    assert work[-1] > 0.0


def test_a_parameter_changed_in_contact_does_not_upset_the_balance():
    assembly = assembled(CYCLE.format(scheme="symplectic_euler", tissue="", shape=CAPSULE, contact=FIELD))
    instance = Instance(assembly)
    instance.inputs[:] = [0, 0, -0.001, 1, 0, 0, 0]
    instance.initialize()
    instance.step(1e-3)
    before = instance.outputs[index(assembly, "energy.balance")]
    instance.parameters[index(assembly, "contact.stiffnessPerArea", "parameters")] *= 2
    instance.step(1e-6)
    stored = instance.outputs[index(assembly, "energy.contact")]
    assert instance.outputs[index(assembly, "energy.balance")] == pytest.approx(before, abs=1e-3 * stored)
