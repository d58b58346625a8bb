"""Extremes: every one alone in a fixed table, and all of them in random scenes (`extremes`, a module of its own)."""

import json
import math
import os
import time
from collections import Counter
from pathlib import Path

import extremes
import numpy as np
import pytest
from extremes import RESPONSES, Broken, Player, case_of, run, run_many, status_of
from numba import njit
from scenes import assembled, index, write_mesh

from tissue_contact.errors import InputError, WorkError
from tissue_contact.kernels import slots
from tissue_contact.kernels.damping import count_damping, damp_contacts
from tissue_contact.kernels.predicates import side
from tissue_contact.kernels.symplectic import symplectic_euler
from tissue_contact.scene import parse_scene
from tissue_contact.simulate import Instance

SEEDS, BLOCKS = 300, 3
SCENE = """
    [solver]
    {solver}
    [[tissue]]
    {shape}
    areal_density = {density}
    {springs}
    {tissue}
    [[instrument]]
    {body}
    start_position = [0.0002, 0.0003, {height}]
    [[contact]]
    response = "{response}"
    {law}
"""
PATCH = 'shape = {{ kind = "patch", size = [0.03, 0.03], triangles = {} }}'
FLAT = "fixed = { box = [[-1, -1, -1], [1, 1, 1]] }"
CAPSULE = 'shape = { kind = "capsule", radius = 0.003, length = 0.03, triangles = 100 }'


def instance_of(
    response="distance_field", *, folder=None, stiffness=None, damping=None, law="", height=0.001, **parts
) -> Instance:
    """An instrument above a patch, or what ``parts`` say instead."""
    field = response == "distance_field"
    key, unit = ("_per_area", 1e4) if field else ("", 1.0)
    law += f"\nstiffness{key} = {stiffness if stiffness is not None else 200.0 * unit}"
    if damping is not None:
        law += f"\ndamping{key} = {damping}"
    given = {
        "solver": "", "shape": PATCH.format(128), "density": 1.0, "springs": "stiffness = 200.0", "body": CAPSULE,
        "tissue": "support_stiffness = 1e5\nsupport_damping = 1e3",
    }  # fmt: skip
    text = SCENE.format(response=response, law=law, height=height, **(given | parts))
    made = Instance(assembled(text, folder) if folder else assembled(text))
    made.initialize()
    return made


def push(instance: Instance, depths, h: float, limit: int = 400) -> dict[str, int]:
    """Move the instrument to depths, one a step; smaller steps where one is refused. What came of them."""
    outcomes: dict[str, int] = {}
    for depth in depths:
        start, left, pieces = instance.state.pose[2], 1.0, 1.0
        while left > 0.0 and limit > 0:
            limit -= 1
            share = min(left, 1.0 / pieces)
            instance.inputs[2] = start + (1.0 - left + share) * (-depth - start)
            saved = instance.copy_state()
            try:
                instance.step(h * share)
                left = left - share if left - share > 1e-9 else 0.0
                outcome = "done"
            except WorkError as error:
                outcome, pieces = status_of(error), 4.0 * pieces
                assert saved[1].tobytes() == instance.copy_state()[1].tobytes()
            outcomes[outcome] = outcomes.get(outcome, 0) + 1
            assert np.isfinite(instance.outputs).all() and np.isfinite(instance.copy_state()[1]).all()
    return outcomes


def force(instance: Instance) -> np.ndarray:
    return instance.outputs[:3]


def sane(instance: Instance) -> None:
    """Whatever was before, a step that is short enough and goes nowhere is done."""
    instance.inputs[:7] = instance.state.pose[:7]
    for h in (1e-4, 1e-6, 1e-9, 1e-12):
        try:
            instance.step(h)
            return
        except WorkError:
            continue
    pytest.fail("no step is done any more")


PRESS = [0.0, 0.0005, 0.001, 0.0015, 0.002]  # [m], depths


# --- every constant at its ends ----------------------------------------------------------------------------


@pytest.mark.parametrize("response", RESPONSES)
@pytest.mark.parametrize("stiffness", [1.0, 1e7])
def test_contact_stiffness(response, stiffness):
    instance = instance_of(response, stiffness=max(stiffness, 1e2) if response == "distance_field" else stiffness)
    assert push(instance, PRESS, 1e-3).get("done", 0) >= 1
    sane(instance)


def test_contact_stiffness_of_a_field_at_its_end():
    instance = instance_of(stiffness=1e12)
    assert set(push(instance, PRESS, 1e-3)) <= {"done", "substep_budget", "energy_gain"}
    sane(instance)


@pytest.mark.parametrize("stiffness", [1.0, 1e7])
@pytest.mark.parametrize("integrator", ["symplectic_euler", "explicit_euler", "implicit_euler", "runge_kutta_4"])
def test_tissue_stiffness(stiffness, integrator):
    instance = instance_of(springs=f"stiffness = {stiffness}", solver=f'integrator = "{integrator}"')
    push(instance, PRESS, 1e-3)
    sane(instance)


@pytest.mark.parametrize("response", RESPONSES)
@pytest.mark.parametrize("damping", [0.0, 1e4])
def test_contact_damping(response, damping):
    instance = instance_of(response, damping=damping)
    assert push(instance, PRESS, 1e-3).get("done", 0) >= 1
    sane(instance)


@pytest.mark.parametrize("damping", [0.0, 1e4])
@pytest.mark.parametrize("integrator", ["symplectic_euler", "implicit_euler", "runge_kutta_4"])
def test_tissue_damping(damping, integrator):
    instance = instance_of(springs=f"stiffness = 200.0\ndamping = {damping}", solver=f'integrator = "{integrator}"')
    push(instance, PRESS, 1e-3)
    sane(instance)


@pytest.mark.parametrize(("mass", "density"), [(1e-9, 1e-3), (1.0, 1e3)])
def test_vertex_mass(mass, density):
    # 128 triangles on a side length s have vertices of about s²/64 each.
    size = 8.0 * math.sqrt(mass / density)
    shape = f'shape = {{ kind = "patch", size = [{size}, {size}], triangles = 128 }}'
    instance = instance_of(shape=shape, density=density)
    free = instance.model.node_area[instance.model.node_free > 0]
    assert density * np.median(free) == pytest.approx(mass, rel=0.3)
    push(instance, PRESS, 1e-3)
    sane(instance)


@pytest.mark.parametrize("h", [1e-6, 1.0])
def test_step_length(h):
    instance = instance_of(damping=100.0, solver="max_substeps = 20000")
    assert push(instance, PRESS, h) == {"done": len(PRESS)}
    assert force(instance)[2] > 0.0


@pytest.mark.parametrize("h", [-1e-3, -5e-324, math.nan, math.inf, -math.inf, 1e300, 1.1e6, 5e-324])
def test_step_length_out_of_range(h):
    instance = instance_of()
    saved = instance.copy_state()
    with pytest.raises(WorkError, match=r"the communication step is .* s: it must be 0, or from"):
        instance.step(h)
    assert saved[1].tobytes() == instance.copy_state()[1].tobytes()
    sane(instance)


@pytest.mark.parametrize("response", RESPONSES)
@pytest.mark.parametrize("detection", ["continuous", "discrete"])
def test_instrument_speed_of_100_m_per_s(response, detection):
    instance = instance_of(response, damping=0.1, height=0.05, solver=f'detection = "{detection}"')
    push(instance, np.linspace(-0.05, 0.05, 11), 1e-4)
    sane(instance)


def test_instrument_speed_of_0():
    instance = instance_of(height=-0.001)
    for _ in range(20):
        instance.step(1e-3)
    assert force(instance)[2] > 0.0


@pytest.mark.parametrize("response", RESPONSES)
@pytest.mark.parametrize("way", [(0, 0, -1), (0, 0, 1), (1, 0, 0)])
def test_a_jump_of_1_m_in_one_step(response, way):
    """Done in as many substeps as it takes, or refused; and back again the tissue is not further off than it went."""
    instance = instance_of(response, damping=0.1, height=-0.001)
    for sign in (1.0, -1.0):
        instance.inputs[:3] = instance.state.pose[:3] + sign * np.array(way)
        try:
            instance.step(1e-3)
        except WorkError as error:
            assert status_of(error) in ("substep_budget", "energy_gain", "nonfinite_state")
            instance.inputs[:3] = instance.state.pose[:3]
    assert np.isfinite(instance.outputs).all()
    sane(instance)


@pytest.mark.parametrize("damping", [0.01, 1.0, 100.0, 1e4])
def test_dampers_of_a_touch_never_give_energy(damping, tmp_path):
    """Up to dt c/m far above 1, in a scene; `test_dampers_of_points_never_give_energy` takes the kernel alone."""
    write_mesh(tmp_path / "one.obj", TRIANGLE, np.array([[0, 1, 2]]))
    sheet = 'mesh = "one.obj"\nopen_surface = true'
    instance = instance_of(
        "oobb", shape=sheet, folder=tmp_path, tissue='support_stiffness = 1e5\nfixed = "none"', height=-0.001,
        damping=damping, solver="energy_gain = 1e6\nsubsteps = 1",
    )  # fmt: skip
    rng = np.random.default_rng(1)
    for k in range(100):
        if k % 10 == 0:
            instance.state.vz[:] = 0.01 * rng.normal(size=3)
            instance.parameters[slots.STIFFNESS_SCALE] = 1.0 + 1e-9 * (k + 1)  # what is stored is counted anew
        before = instance.state.dissipated[0]
        instance.step(1e-4)
        assert instance.state.dissipated[0] >= before - 1e-12


@njit
def _damped(model, parameters, state, scratch, dt):
    """A substep without any other force than those of the points noted in the scratch."""
    damp_contacts(model, parameters, state, scratch, 0.0, dt)
    symplectic_euler(model, parameters, state, scratch, dt)
    count_damping(model, parameters, state, scratch, dt)


@pytest.mark.parametrize("stiffness", [1e-2, 1.0, 1e2, 1e4, 1e6])  # dt c/m
@pytest.mark.parametrize("friction", [0.0, 0.3, 2.0])
def test_dampers_of_points_never_give_energy(stiffness, friction, tmp_path):
    """Points of any weights and directions on shared vertices: against the body, the motion only loses energy.

    Lumped to the vertices, one point of weights a over equal masses left u_i - a_i sum(u): of (1, 0) and a = (0.2, 0.8)
    that is (0.8, -0.8), 28 % more energy than before.
    """
    corners = np.array([[0, 0, 0], [0.03, 0, 0], [0, 0.03, 0], [0.03, 0.03, 0]])
    name = write_mesh(tmp_path / "two.obj", corners, np.array([[0, 1, 2], [2, 1, 3]]))
    instance = instance_of(
        shape=f'mesh = "{name}"\nopen_surface = true', folder=tmp_path, tissue='fixed = "none"',
        law=f"friction = {friction}\nslip_speed = 1e-4\nquadrature_spacing = 5.4e-3",
    )  # fmt: skip
    state, scratch, triangles = instance.state, instance.scratch, np.array([[0, 1, 2], [2, 1, 3]])
    print("seed", 71)
    rng, dt = np.random.default_rng(71), 1e-4
    mass = instance.model.node_area  # kg, at 1 kg/m²
    arguments = instance._model, instance.parameters, instance._state, instance._scratch, dt
    for count in [1, 1, 1, 2, 3, 5, 20] * 10:
        weights = rng.dirichlet([0.3, 0.3, 0.3], count)
        weights[0] = (0.2, 0.8, 0.0)
        direction = rng.normal(size=(count, 3))
        direction /= np.linalg.norm(direction, axis=1)[:, None]
        v = rng.normal(size=(3, 4)) * 10.0 ** rng.uniform(-6, 1)
        state.vx[:], state.vy[:], state.vz[:] = v
        scratch.fx[:], scratch.fy[:], scratch.fz[:] = 0.0, 0.0, 0.0
        scratch.loss[:], scratch.active[0] = 0.0, count
        scratch.active_contact[:count] = 0
        scratch.active_a[:count], scratch.active_b[:count], scratch.active_c[:count] = triangles[
            rng.integers(2, size=count)
        ].T
        scratch.active_wa[:count], scratch.active_wb[:count], scratch.active_wc[:count] = weights.T
        scratch.active_x[:count], scratch.active_y[:count], scratch.active_z[:count] = direction.T
        # some let go rather than pull, some never do
        scratch.active_tangential[:count] = rng.choice([1e-3, 1.0, 1e3], count) * abs(v).max() * mass[0] / dt
        scratch.active_normal[:count] = stiffness * mass[0] / dt
        before, taken = (mass * v**2).sum() / 2, state.dissipated[0]
        _damped(*arguments)
        after = (mass * np.array([state.vx, state.vy, state.vz]) ** 2).sum() / 2
        lost = state.dissipated[0] - taken
        forces = np.hypot.reduce([scratch.active_fx[:count], scratch.active_fy[:count], scratch.active_fz[:count]])
        rounding = 1e-12 * (before + dt * forces.sum() * abs(v).max())
        assert lost >= -rounding
        # what is counted leaves the motion, and implicit damping takes half of a square besides
        assert after <= before - lost + rounding
        if count == 1 and friction == 0.0:
            at = [scratch.active_a[0], scratch.active_b[0], scratch.active_c[0]]
            c, rate = scratch.active_normal[0], -direction[0] @ v[:, at] @ weights[0]
            exact = c * rate / (1.0 + c * dt * (weights[0] ** 2 / mass[at]).sum())
            force = scratch.active_fx[0] * direction[0, 0] + scratch.active_fy[0] * direction[0, 1]
            force += scratch.active_fz[0] * direction[0, 2]
            assert force == pytest.approx(max(-scratch.active_tangential[0], exact), rel=2e-3)
        state.dissipated[0] = 0.0


# --- places ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("response", RESPONSES)
@pytest.mark.parametrize("depth", [0.001, 0.01, 0.029])
def test_start_inside_the_tissue(response, depth):
    instance = instance_of(response, height=-depth, damping=0.1)
    assert np.isfinite(instance.outputs).all()
    push(instance, [depth] * 5, 1e-3)
    sane(instance)


@pytest.mark.parametrize("response", RESPONSES)
def test_depth_beyond_the_organ(response):
    """A shaft through an organ that is thinner than it is long; the far surface does not draw it on."""
    organ = 'shape = { kind = "ellipsoid", radii = [0.02, 0.02, 0.004], triangles = 400 }'
    instance = instance_of(response, shape=organ, height=0.006, damping=0.1, density=3.0)
    push(instance, np.linspace(-0.005, 0.05, 40), 1e-3)
    assert np.abs(instance.state.z).max() < 0.2  # an organ of 8 mm and a way of 5 cm
    sane(instance)


@pytest.mark.parametrize("response", RESPONSES)
@pytest.mark.parametrize("kind", ["capsule", "sphere", "box", "cylinder"])
@pytest.mark.parametrize("law", ["", 'law = "hunt_crossley"\nexponent = 2.0\ndissipation = 5.0'])
def test_a_flat_patch_never_attracts(response, kind, law):
    """Pushed along the normal of a rigid flat patch, an upright body is never drawn on without friction.

    Exact for every response as deep as the thinnest half extent: a touch pushes along the patch's normal, and up to
    that depth the nearest surface of the body is below its middle, so that its field looks down or aside. The oobb and
    its kin push along the normal at any depth.
    """
    shapes = {
        "capsule": CAPSULE,
        "sphere": 'shape = { kind = "sphere", radius = 0.003, triangles = 100 }',
        "box": 'shape = { kind = "box", size = [0.006, 0.006, 0.03] }',
        "cylinder": 'shape = { kind = "cylinder", radius = 0.003, length = 0.03, triangles = 100 }',
    }
    instance = instance_of(response, body=shapes[kind], tissue=FLAT, law=law)
    deepest = 0.003 if response == "distance_field" else 0.02
    for depth in [*np.linspace(-0.001, deepest, 40), *np.linspace(deepest, -0.001, 10)]:
        instance.inputs[2] = -depth
        instance.step(1e-3)
        assert force(instance)[2] >= -1e-12 * np.linalg.norm(force(instance))
    assert np.linalg.norm(force(instance)) == 0.0  # out of it again


# --- meshes ------------------------------------------------------------------------------------------------

SQUARE = np.array([[-0.01, -0.01, 0], [0.01, -0.01, 0], [0.01, 0.01, 0], [-0.01, 0.01, 0]])
TRIANGLE = np.array([[-0.01, -0.01, 0], [0.015, -0.01, 0], [0.0, 0.015, 0]])


def of_meshes(tmp_path, tissue, instrument, response="distance_field", **parts) -> Instance:
    """Instance of two mesh files; each given by vertices and triangles."""
    names = [write_mesh(tmp_path / f"{k}.obj", *mesh) for k, mesh in enumerate((tissue, instrument))]
    sheet = 'mesh = "{}"\nopen_surface = true'
    return instance_of(
        response, shape=sheet.format(names[0]), body=sheet.format(names[1]) + "\nmany_parts = true", folder=tmp_path,
        tissue='support_stiffness = 1e5\nfixed = "none"', **parts,
    )  # fmt: skip


@pytest.mark.parametrize("response", RESPONSES)
def test_one_triangle_against_one_triangle(response, tmp_path):
    upright = np.array([[-0.002, 0.0, 0.0], [0.002, 0.0, 0.0], [0.0, 0.0005, 0.01]])
    one = np.array([[0, 1, 2]])
    instance = of_meshes(tmp_path, (TRIANGLE, one), (upright, one), response, height=0.001, damping=0.1)
    push(instance, PRESS, 1e-3)
    sane(instance)


@pytest.mark.parametrize("response", RESPONSES)
@pytest.mark.parametrize("extra", [[0, 1, 2], [0, 0, 1], [0, 1, 1]], ids=["duplicate", "flat", "flat too"])
def test_zero_area_and_duplicate_triangles(response, extra, tmp_path):
    """They are taken out of a tissue as it is read; an instrument that is a soup may keep them."""
    mesh = (SQUARE, np.array([[0, 1, 2], [0, 2, 3], extra]))
    tool = (SQUARE * 0.2, np.array([[0, 1, 2], [0, 2, 3], extra]))
    instance = of_meshes(tmp_path, mesh, tool, response, height=0.001)
    assert len(instance.model.triangle_a) == 2
    push(instance, PRESS, 1e-3)
    sane(instance)


def test_a_mesh_without_any_area_is_refused(tmp_path):
    line = np.array([[0.0, 0, 0], [0.01, 0, 0], [0.02, 0, 0]])
    with pytest.raises(InputError, match="area"):
        of_meshes(tmp_path, (line, np.array([[0, 1, 2]])), (TRIANGLE, np.array([[0, 1, 2]])))


@pytest.mark.parametrize("response", RESPONSES)
def test_tissue_that_collapses_to_a_point(response):
    """Triangles may lose their area in the course of time; a state may even be set so."""
    instance = instance_of(response, height=-0.001, tissue='fixed = "none"\narea_stiffness = 10.0')
    for name in "xyz":
        getattr(instance.state, name)[:] = 0.0005
    try:
        instance.step(1e-6)
    except WorkError as error:
        assert status_of(error) == "energy_gain"
    assert np.isfinite(instance.outputs).all() and np.isfinite(instance.copy_state()[1]).all()


@pytest.mark.parametrize("response", RESPONSES)
def test_coplanar_contact(response):
    """A flat face on a flat patch, exactly in its plane: no contact, or one of depth 0."""
    body = 'shape = { kind = "box", size = [0.006, 0.006, 0.02] }'
    instance = instance_of(response, body=body, height=0.0, tissue=FLAT)
    for _ in range(5):
        instance.step(1e-3)
        assert np.abs(force(instance)).max() < 1e-9
    sane(instance)


@pytest.mark.parametrize("response", ["distance_field", "hull"])
def test_200_000_triangles(response):
    instance = instance_of(response, shape=PATCH.format(200_000).replace(" }", ", irregular = false }"), damping=0.1)
    assert len(instance.model.triangle_a) >= 195_000
    assert push(instance, [0.0005, 0.001], 1e-4).get("done", 0) >= 2
    assert force(instance)[2] > 0.0


def test_200_000_triangles_thrown_over_an_instrument_by_a_jump():
    instance = instance_of(shape=PATCH.format(200_000).replace(" }", ", irregular = false }"))
    instance.inputs[:3] = [0.0, 0.0, -0.02]
    try:
        instance.step(1e-3)
    except WorkError as error:
        assert status_of(error) in ("substep_budget", "energy_gain", "too_many_points")
    sane(instance)


# --- what is not a number, and what is too large -----------------------------------------------------------


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e300, -1.7e308, 1.1e6])
@pytest.mark.parametrize("slot", range(8))
def test_every_input_out_of_range(slot, value):
    """Positions, orientation and jaw, at a step and at the start."""
    body = CAPSULE + "\ngrasp = { radius = 0.004, stiffness = 100.0, slip_force = 1.0 }"
    instance = instance_of(body=body, height=-0.001)
    instance.step(1e-3)
    saved, outputs = instance.copy_state(), instance.outputs.copy()
    instance.inputs[slot] = value
    for call in (instance.initialize, lambda: instance.step(1e-3)):
        with pytest.raises(WorkError, match=f"input slot {slot} is .*: every input must be finite"):
            call()
        assert saved[1].tobytes() == instance.copy_state()[1].tobytes()
        assert outputs.tobytes() == instance.outputs.tobytes()
    instance.inputs[7] = 1.0
    sane(instance)


@pytest.mark.parametrize("scale", [1e-5, 1e-3, 1e3, 9e5, -1.0])
def test_unnormalised_quaternions_are_normalised(scale):
    plain, scaled = instance_of(height=-0.001), instance_of(height=-0.001)
    q = np.array([0.9, 0.1, -0.2, 0.3])
    q /= np.linalg.norm(q)
    plain.inputs[3:7], scaled.inputs[3:7] = q, scale * q
    plain.step(1e-3)
    scaled.step(1e-3)
    assert scaled.outputs == pytest.approx(plain.outputs, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("q", [(0, 0, 0, 0), (1e-7, 0, 0, 0), (1e-200, 0, 1e-200, 0), (5e-324, 0, 0, 0)])
def test_zero_quaternions_are_refused(q):
    instance = instance_of(height=-0.001)
    saved = instance.copy_state()
    instance.inputs[3:7] = q
    with pytest.raises(WorkError, match="a quaternion w,x,y,z needs a norm above 1e-6"):
        instance.step(1e-3)
    assert saved[1].tobytes() == instance.copy_state()[1].tobytes()
    sane(instance)


EVERYTHING = """
    [[tissue]]
    shape = { kind = "ellipsoid", radii = [0.02, 0.02, 0.01], triangles = 100 }
    areal_density = 1.0
    stiffness = 100.0
    nonlinearity = 1.0
    damping = 0.01
    area_stiffness = 1.0
    volume_stiffness = 100.0
    drag = 1.0
    support_stiffness = 1e5
    support_damping = 100.0
    [[instrument]]
    shape = { kind = "sphere", radius = 0.003, triangles = 60 }
    start_position = [0.0, 0.0, 0.0095]
    grasp = { radius = 0.004, stiffness = 100.0, damping = 0.1, slip_force = 1.0 }
    [[contact]]
    stiffness_per_area = 1e6
    law = "hunt_crossley"
    dissipation = 1.0
    friction = 0.5
"""


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, -1.0, 1e300])
def test_every_parameter_out_of_range(value):
    instance = Instance(assembled(EVERYTHING))
    instance.initialize()
    slots_of = [v.slot for v in instance._assembly.variables if v.block == "parameters"]
    assert len(slots_of) == slots.TISSUE_PARAMETERS + slots.CONTACT_PARAMETERS + slots.GRASP_PARAMETERS
    for slot in slots_of:
        saved, given = instance.copy_state(), instance.parameters[slot]
        instance.parameters[slot] = value
        for call in (instance.initialize, lambda: instance.step(1e-3)):
            with pytest.raises(WorkError, match=f"parameter slot {slot} is .*, outside its range"):
                call()
            assert saved[1].tobytes() == instance.copy_state()[1].tobytes()
        instance.parameters[slot] = given
        instance.step(1e-4)


@pytest.mark.parametrize("end", ["minimum", "maximum"])
def test_every_parameter_at_its_ends(end):
    assembly = assembled(EVERYTHING)
    for variable in assembly.variables:
        if variable.block == "parameters":
            instance = Instance(assembly)
            instance.initialize()
            instance.parameters[variable.slot] = getattr(variable, end)
            push(instance, [-0.009, -0.0085], 1e-3, 20)
            sane(instance)


# --- failures that were found ------------------------------------------------------------------------------


def test_substeps_that_do_not_fit_into_an_integer_are_refused():
    """A ceiling of 1e19 became the least of the integers, which is within any budget."""
    instance = instance_of(height=0.01, solver="max_substeps = 1000")
    instance.inputs[0] = 1e6
    with pytest.raises(WorkError, match=r"a stable step needs 1\.\d+e\+09 substeps"):
        instance.step(1e-3)
    with pytest.raises(WorkError, match="a stable step needs"):
        instance.inputs[0] = instance.state.pose[0]
        instance.step(1e6)
    explicit = instance_of(
        solver='integrator = "explicit_euler"', tissue="support_stiffness = 1e5\nsupport_damping = 1e3"
    )
    name = "tissue.supportDamping"
    (slot,) = [v.slot for v in explicit._assembly.variables if v.name == name]
    explicit.parameters[slot] = 0.0  # nothing damped: explicit Euler has no stable step at all
    with pytest.raises(WorkError, match="a stable step needs inf substeps"):
        explicit.step(1e-3)
    sane(instance)


def test_a_jump_does_not_allow_any_gain():
    """What a late detection may find is bounded by the body, not by how far it went: 1 m/s² s was 1e20 J."""
    instance = instance_of(
        "oobb", stiffness=200.0, height=1.0, solver='detection = "discrete"\nsubsteps = 1\nenergy_gain = 0.0'
    )
    instance.inputs[2] = -0.02
    instance.step(1e-3)
    balance = instance.outputs[index(instance._assembly, "energy.balance")]
    box = math.sqrt(2 * 0.006**2 + 0.03**2)
    assert -0.5 * 200.0 * box**2 <= balance < 0.0


def test_a_long_shaft_that_is_found_late_is_no_gain():
    """A thin shaft laid on a tissue between two detections has more area than the square of its depth."""
    lying = CAPSULE.replace("0.003", "0.001").replace("0.03,", "0.1,")
    q = "\nstart_orientation = [0.7071067811865476, 0.0, 0.7071067811865476, 0.0]"
    instance = instance_of(
        body=lying + q, height=0.002, tissue=FLAT, shape=PATCH.format(128).replace("0.03", "0.2"),
        solver='detection = "discrete"\ndetection_period = 1e-3\nsubsteps = 1\nenergy_gain = 0.0',
    )  # fmt: skip
    instance.inputs[2] = 0.0001
    instance.step(1e-3)
    assert force(instance)[2] > 0.0


@pytest.mark.parametrize("far", [1e110, 1e200, math.inf, math.nan])
def test_a_side_that_overflows_is_none(far):
    """Exact arithmetic of what overflows found nothing and took a hundred times as long: 30 s for a refused step."""
    expansion = np.zeros(256)
    assert side((0.0, 0.0, 0.0), (far, 0.0, 0.0), (0.0, far, 0.0), (far, far, far), expansion) in (-1, 0, 1)
    assert side((0.0, 0.0, far), (far, -far, 0.0), (0.0, far, 1.0), (far, far, -far), expansion) in (-1, 0, 1)
    assert not expansion.any()


@pytest.mark.parametrize("response", RESPONSES[1:])
@pytest.mark.parametrize("way", [(0, 0, -0.5), (0.5, 0, 0)], ids=["deep", "aside"])
def test_a_touch_of_long_ago_is_none(response, way):
    """Until the next detection a touch followed the instrument to a depth of a metre, and at rest it was another."""
    solver = 'detection = "discrete"\ndetection_period = 1.0\nsubsteps = 4'
    instance = instance_of(response, height=-0.001, solver=solver, tissue=FLAT)
    assert force(instance)[2] > 0.0
    instance.inputs[:3] += way
    for _ in range(3):
        instance.step(1e-4)
        assert not force(instance).any()
    sane(instance)


def test_a_tissue_that_runs_off_is_refused_at_once():
    """Its triangles met every cell of the instrument in every substep, for a minute, before the end of the step."""
    instance = instance_of("hull", height=-0.001, tissue='fixed = "none"', springs="stiffness = 1.0")
    instance.state.vz[::2] = 1e10
    saved = instance.copy_state()
    with pytest.raises(WorkError, match="non-finite state, or one beyond 1e6 m"):
        instance.step(1e-3)
    assert saved[1].tobytes() == instance.copy_state()[1].tobytes()


def chattering(gain: float) -> Instance:
    """The corners of a round tip's box stand proud of it: the tissue is kicked off and falls back with no work done."""
    return instance_of(
        "oobb", stiffness=400.0, damping=0.1, height=0.0005, shape=PATCH.format(512), solver=f"energy_gain = {gain}",
        tissue="support_stiffness = 1e5\nsupport_damping = 300.0",
    )  # fmt: skip


def pressed(instance: Instance) -> tuple[int, str]:
    """Press down to 2 mm and hold; how many steps were done, and what was said of the next."""
    for n in range(200):
        instance.inputs[2] = max(0.0005 - 5e-5 * n, -0.002)
        saved, outputs = instance.copy_state(), instance.outputs.copy()
        try:
            instance.step(1e-3)
        except WorkError as error:
            assert all(a.tobytes() == b.tobytes() for a, b in zip(saved, instance.copy_state(), strict=True))
            assert outputs.tobytes() == instance.outputs.tobytes()
            return n, str(error)
    return 200, ""


def test_slow_gain_over_many_steps_is_refused():
    """Every step was within its bound, and a hundred times the work came of them."""
    instance = chattering(1.0)
    done, text = pressed(instance)
    assert 10 < done < 100 and "have come from nowhere since the start" in text
    state = instance.state
    balance = instance.outputs[index(instance._assembly, "energy.balance")]
    assert -balance <= state.gained[0] <= state.put_in[0] + state.found[0] + state.stored[0]
    assert state.found[0] < 0.5 * 400.0 * 0.0035**2  # of one contact as deep as the capsule is thick, and half a mm
    instance.inputs[2] = 0.01
    for _ in range(5):
        instance.step(1e-3)  # what leaves the tissue gains nothing
    sane(instance)
    instance.inputs[2] = 0.0005
    instance.initialize()
    assert pressed(instance) == (done, text)  # the sum begins anew
    assert pressed(chattering(1e3)) == (200, "")


def test_bodies_get_back_no_more_than_was_put_in_and_one_late_find():
    """In turn the tool is pressed in, and gets in between two detections, which gives it energy from nowhere."""
    instance = instance_of(
        "hull", stiffness=2.0, damping=0.0, height=0.001, tissue="support_stiffness = 1e6\nsupport_damping = 1e4",
        solver='detection = "discrete"\ndetection_period = 0.004',
    )  # fmt: skip
    pressed = [-3, -3, -3, -3, -5, -8, -11, -14, -11, -8, -5, -3]
    heights = pressed + [9, 9, 9, 9, -8, -8, -8, -8, 9, 9, 9, 9]
    done = 0
    with pytest.raises(WorkError) as caught:
        for done in range(4000):
            instance.inputs[2] = 1e-4 * heights[done % len(heights)]
            instance.step(1e-3)
    state = instance.state
    assert status_of(caught.value) == "energy_returned" and done > 1000
    assert state.put_in[0] < state.returned[0] <= 1.01 * state.put_in[0] + state.found[0]
    assert state.gained[0] < state.put_in[0]  # which is no reason to refuse
    assert state.found[0] <= 0.5 * 2.0 * 0.01**2  # N/m and m, of a contact at most as deep
    instance.inputs[2] = state.pose[2]
    instance.step(1e-3)  # where it stands it may stay


def test_the_sum_of_gains_belongs_to_the_state():
    first = chattering(1.0)
    _, text = pressed(first)
    second = chattering(1.0)
    second.restore_state(first.copy_state())
    second.inputs[:] = first.inputs
    with pytest.raises(WorkError) as caught:
        second.step(1e-3)
    assert str(caught.value) == text


@pytest.mark.parametrize("factor", [0.1, 10.0])
def test_a_changed_parameter_puts_energy_in_and_takes_none_out(factor):
    instance = instance_of(height=-0.001, tissue="support_stiffness = 1e5\npreload = 0.1", solver="max_substeps = 5000")
    put_in, stored = instance.state.put_in[0], instance.state.stored[0]
    assert put_in == stored > 0.0
    instance.parameters[slots.STIFFNESS_SCALE] = factor
    instance.step(1e-9)
    springs = instance.outputs[index(instance._assembly, "energy.elastic")]
    assert instance.state.put_in[0] - put_in == pytest.approx(max(0.0, springs * (1.0 - 1.0 / factor)), rel=1e-6)


def test_a_step_of_0_tells_a_changed_parameter_from_energy_that_came_from_nowhere():
    instance = instance_of(height=-0.001, tissue="support_stiffness = 1e5\npreload = 0.1", solver="max_substeps = 5000")
    balance, springs = (index(instance._assembly, f"energy.{what}") for what in ("balance", "elastic"))
    before = instance.outputs[springs]
    instance.parameters[slots.STIFFNESS_SCALE] = 2.0
    instance.step(0.0)
    assert instance.outputs[springs] > 1.5 * before > 0.0
    assert abs(instance.outputs[balance]) < 1e-12 * before  # rounding


def test_what_falls_by_its_weight_is_no_gain():
    """Without damping the energy of a swinging tissue swings itself, and nothing but the weight has put it in."""
    instance = instance_of(
        height=0.02, tissue='support_stiffness = 1e5\nfixed = "none"', solver="gravity = [0.0, 0.0, -9.81]"
    )
    for _ in range(200):
        instance.step(1e-3)
    assert instance.state.put_in[0] > 0.0
    assert abs(instance.state.z).max() > 1e-6


GALLBLADDER = Path(__file__).parents[2] / "shared" / "meshes" / "lapgym_gallbladder_collision.stl"


@pytest.mark.shared_meshes
@pytest.mark.parametrize("preload", [0.15, 0.2])
def test_springs_that_preload_crushes_give_no_energy(preload):
    """Slivers of a gallbladder, undamped, reached 250 m/s and 27 times the energy that was stored at the start."""
    if not GALLBLADDER.is_file():
        pytest.skip(f"{GALLBLADDER.name} is not in shared/meshes beside the checkout")
    instance = Instance(assembled(f"""
        [[tissue]]
        mesh = {json.dumps(str(GALLBLADDER))}
        scale = 0.001
        fixed = "none"
        areal_density = 2.0
        youngs_modulus = 1e5
        thickness = 0.002
        preload = {preload}
        support_stiffness = 3e4
    """))  # fmt: skip
    instance.initialize()
    stored, fastest = instance.state.stored[0], 0.0
    balance = index(instance._assembly, "energy.balance")
    for _ in range(500):
        instance.step(1e-3)
        speed = np.sqrt(instance.state.vx**2 + instance.state.vy**2 + instance.state.vz**2)
        fastest = max(fastest, speed.max())
        assert abs(instance.outputs[balance]) < 0.05 * stored
    assert instance.state.crush[0] > 1.0
    assert 5.0 < fastest < 20.0  # m/s: what is stored is let go at once


# --- many at random ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("block", range(BLOCKS))
def test_random_scenes(block):
    """Seeds of `extremes`, which tells how to see one."""
    size = SEEDS // BLOCKS
    outcomes, failures, _ = run_many(range(block * size, (block + 1) * size), 1)
    assert not failures, "\n".join(f"seed {seed}: {text}" for seed, text in sorted(failures.items()))
    assert outcomes["done"] > 2 * size  # the scenes are not so wild that nothing is done


def test_a_seed_is_the_same_scene_and_the_same_calls(tmp_path):
    assert case_of(5, tmp_path) == case_of(5, tmp_path)
    assert run(5) == run(5)


def test_a_broken_promise_is_found(monkeypatch, tmp_path):
    """The watch sees an output that is not finite, a state that changes at a refusal, and a refusal without a fault."""
    case = case_of(1, tmp_path)
    scene = parse_scene(case.text.encode(), tmp_path)
    player = Player(1, scene, assembled(case.text.partition("\n")[2], tmp_path), case)
    player.call("initialize", 0.0)
    done = Instance.step

    def overflow(self, h):
        done(self, h)
        self.outputs[0] = math.inf

    def lazy(self, h):
        self.state.x[0] += 1.0
        raise WorkError("the communication step is -1 s: it must be 0, or from 1e-100 s to 1 s. The step was not begun")

    monkeypatch.setattr(Instance, "step", overflow)
    with pytest.raises(Broken, match="not finite"):
        player.call("step", 1e-6)
    monkeypatch.setattr(Instance, "step", lazy)
    with pytest.raises(Broken, match="the state changed"):
        player.call("step", -1.0)
    with pytest.raises(Broken, match="its faults are"):
        player.call("step", 1e-6)


def _die(seed):
    if seed == 3:
        os._exit(9)
    return Counter(["done"])


def _hang(seed):
    while seed == 3:
        time.sleep(1.0)
    return Counter(["done"])


def test_a_crash_of_one_seed_does_not_stop_the_others():
    """A worker that dies is named by its seed, and a new one takes its place."""
    outcomes, failures, _ = run_many(range(2, 5), 1, job=_die)
    assert list(failures) == [3] and "exit code 9" in failures[3]
    assert outcomes["done"] == 2


def test_a_hang_of_one_seed_does_not_stop_the_others(monkeypatch):
    monkeypatch.setattr(extremes, "STARTING", 20.0)
    outcomes, failures, _ = run_many(range(2, 5), 1, job=_hang, limit=2.0)
    assert failures == {3: "not done after 2 s"}
    assert outcomes["done"] == 2
