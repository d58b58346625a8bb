"""An FMU of a real scene, in contact: against the Python rollout, its state, reset, and instances side by side."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from fmu_fixture import PLATFORM
from fmu_importer import DISCARD, ERROR, OK, Instance, Unpacked
from scenes import assembled, index

from tissue_contact.fmu.build import build
from tissue_contact.simulate import rollout

H = 1e-3
SCENE = """
    [[tissue]]
    shape = { kind = "patch", size = [0.04, 0.04], triangles = 800, curvature_radius = 0.1, seed = 2 }
    areal_density = 1.0
    stiffness = 200.0
    damping = 0.001
    support_stiffness = 1e5
    support_damping = 1000.0
    [[instrument]]
    shape = { kind = "capsule", radius = 0.003, length = 0.03, triangles = 400 }
    start_position = [0.0, 0.0, 0.001]
    [[contact]]
    response = "hull"
    stiffness = 200.0
    damping = 0.1
"""


def poses(steps: int) -> np.ndarray:
    """Pressed 4 mm and slid while it turns; shape [steps + 1, 7]."""
    t = np.linspace(0, 1, steps + 1)
    out = np.zeros((steps + 1, 7))
    out[:, 0], out[:, 2] = 0.004 * t, 0.001 - 0.005 * np.sin(np.pi * t) ** 2
    out[:, 3], out[:, 6] = np.cos(0.3 * t), np.sin(0.3 * t)
    return out


PATH = poses(200)


@pytest.fixture(scope="module")
def assembly():
    return assembled(SCENE)


@pytest.fixture(scope="module")
def path(assembly, tmp_path_factory):
    return build(assembly, tmp_path_factory.mktemp("contact") / "contact.fmu", [PLATFORM])


@pytest.fixture(scope="module")
def real(path, tmp_path_factory):
    return Unpacked(path, tmp_path_factory.mktemp("contact"))


def inputs(k: int) -> dict[int, float]:
    return dict(enumerate(PATH[k].tolist()))


def begun(fmu: Unpacked, **options) -> Instance:
    made = Instance(fmu, **options)
    assert made.set(inputs(0)) == OK
    return made.start()


def run(instance: Instance, first: int, last: int, assembly) -> np.ndarray:
    """Outputs after steps first + 1 to last."""
    references = [k for k, v in enumerate(assembly.variables) if v.block == "outputs"]
    rows = []
    for k in range(first, last):
        assert instance.set(inputs(k + 1)) == OK
        assert instance.step(k * H, H) == OK, instance.text
        rows.append(instance.get(*references)[1])
    return np.array(rows)


def test_the_fmu_gives_the_bits_of_the_rollout(real, assembly):
    expected = rollout(assembly, PATH, H).outputs[1:]
    assert expected[:, index(assembly, "instrument.force[3]")].max() > 0.05
    instance = begun(real)
    assert run(instance, 0, 200, assembly).tobytes() == expected.tobytes()
    instance.free()


def test_a_state_taken_in_contact_continues_bit_for_bit(real, assembly):
    whole = begun(real)
    expected = run(whole, 0, 150, assembly)
    assert expected[99, index(assembly, "instrument.depth")] > 0
    whole.free()
    instance = begun(real)
    run(instance, 0, 100, assembly)
    state = instance.save()
    run(instance, 100, 130, assembly)
    assert instance.restore(state) == OK
    assert run(instance, 100, 150, assembly).tobytes() == expected[100:].tobytes()
    instance.drop(state)
    instance.free()


CONTINUE = """
import sys
sys.path.insert(0, {tests!r})
from pathlib import Path
from test_fmu_contact import *
assembly = assembled(SCENE)
fmu = Unpacked({fmu!r}, {folder!r})
instance = Instance(fmu)
status, state = instance.deserialize(Path({saved!r}).read_bytes())
assert status == OK, instance.text
assert instance.start().restore(state) == OK
Path({out!r}).write_bytes(run(instance, 100, 150, assembly).tobytes())
"""


def test_a_serialized_state_continues_in_a_new_process(path, real, assembly, tmp_path):
    instance = begun(real)
    run(instance, 0, 100, assembly)
    (tmp_path / "saved").write_bytes(instance.serialize(instance.save()))
    expected = run(instance, 100, 150, assembly)
    instance.free()
    names = {name: str(tmp_path / name) for name in ("saved", "out", "folder")}
    code = CONTINUE.format(tests=str(Path(__file__).parent), fmu=str(path), **names)
    subprocess.run([sys.executable, "-c", code], check=True)
    assert (tmp_path / "out").read_bytes() == expected.tobytes()


def test_two_instances_at_once_do_not_touch_each_other(real, assembly):
    alone = begun(real)
    expected = run(alone, 0, 120, assembly)
    alone.free()
    one, two = begun(real), begun(real)
    got = [run(one, 0, 60, assembly)]
    behind = run(two, 0, 30, assembly)
    got.append(run(one, 60, 120, assembly))
    behind = np.vstack([behind, run(two, 30, 120, assembly)])
    assert np.vstack(got).tobytes() == behind.tobytes() == expected.tobytes()
    one.free()
    two.free()


def test_reset_in_contact_begins_anew(real, assembly):
    instance = begun(real)
    expected = run(instance, 0, 80, assembly)
    assert instance.call("fmi2Reset") == OK
    assert instance.set(inputs(0)) == OK
    instance.start()
    assert run(instance, 0, 80, assembly).tobytes() == expected.tobytes()
    instance.free()


def reference(assembly, name: str) -> int:
    return [v.name for v in assembly.variables].index(name)


def test_parameters_act_and_are_bounded(real, assembly):
    plain = begun(real)
    soft = run(plain, 0, 100, assembly)
    plain.free()
    stiff = begun(real)
    assert stiff.set({reference(assembly, "contact.stiffness"): 400.0}) == OK
    force = index(assembly, "instrument.force[3]")
    assert run(stiff, 0, 100, assembly)[-1, force] > 1.02 * soft[-1, force]
    assert stiff.set({reference(assembly, "contact.stiffness"): -1.0}) == ERROR
    assert "contact.stiffness" in stiff.text
    stiff.free()


def test_a_step_beyond_the_budget_is_discarded_and_a_smaller_one_goes_on(real, assembly):
    instance = begun(real, logging_on=True)
    assert instance.set({reference(assembly, "contact.stiffness"): 1e7}) == OK
    assert instance.step(0.0, 1.0) == DISCARD
    assert "max_substeps" in instance.text
    assert instance.step(0.0, 1e-5) == OK, instance.text
    instance.free()


@pytest.mark.parametrize("slot", range(7))
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_non_finite_pose_is_refused_and_changes_nothing(real, assembly, slot, value):
    instance = begun(real)
    run(instance, 0, 100, assembly)
    before = instance.serialize(instance.save())
    assert instance.set({slot: value}) == ERROR
    assert assembly.variables[slot].name in instance.text
    assert instance.serialize(instance.save()) == before
    instance.free()


def test_a_zero_quaternion_is_refused_and_the_instance_goes_on(real, assembly):
    instance = begun(real)
    run(instance, 0, 100, assembly)
    assert instance.set({3: 0.0, 4: 0.0, 5: 0.0, 6: 0.0}) == OK
    assert instance.step(0.1, H) == ERROR
    assert "norm" in instance.text
    run(instance, 100, 110, assembly)
    instance.free()
