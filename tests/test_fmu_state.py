"""Saved and serialized states."""

import subprocess
import sys
from ctypes import byref, c_size_t, c_void_p
from pathlib import Path

import pytest
from fmu_fixture import FORCE, GAIN, POSITION, PULL, SPARE, STEPS, WISH, tiny_fmu
from fmu_importer import ERROR, OK, Instance, Unpacked

ALL = (PULL, WISH, POSITION, FORCE, STEPS, GAIN, SPARE)


def advance(instance, steps=20):
    """Steps from where it is; outputs of each."""
    out = []
    for k in range(steps):
        instance.set({PULL: 0.1 * k})
        assert instance.step(instance.time(), 0.01) == OK, instance.text
        out.append(instance.get(*ALL))
    return out


def test_restored_state_repeats_bit_for_bit(instance):
    instance.set({GAIN: 7.5})
    instance.start(0.1)
    advance(instance)
    state = instance.save()
    kept, time = instance.get(*ALL), instance.time()
    first = advance(instance)
    instance.set({GAIN: 3.0})
    assert instance.restore(state) == OK
    assert instance.get(*ALL) == kept
    assert instance.time() == time
    assert advance(instance) == first
    assert instance.drop(state) == OK


def test_state_can_be_overwritten(instance):
    instance.start()
    state = instance.save()
    first = state.value
    advance(instance)
    kept = instance.get(*ALL)
    assert instance.call("fmi2GetFMUstate", byref(state)) == OK
    assert state.value == first
    advance(instance)
    assert instance.restore(state) == OK
    assert instance.get(*ALL) == kept
    instance.drop(state)


def test_drop_clears_the_pointer(instance):
    state = instance.save()
    assert instance.drop(state) == OK
    assert state.value is None
    assert instance.drop(state) == OK
    assert instance.call("fmi2FreeFMUstate", None) == OK


def test_null_pointers(instance):
    state = instance.save()
    assert instance.restore(c_void_p()) == ERROR
    assert instance.call("fmi2GetFMUstate", None) == ERROR
    assert instance.call("fmi2SerializedFMUstateSize", c_void_p(), byref(c_size_t())) == ERROR
    assert instance.call("fmi2SerializedFMUstateSize", state, None) == ERROR
    assert instance.call("fmi2SerializeFMUstate", state, None, c_size_t(10**6)) == ERROR
    assert instance.call("fmi2DeSerializeFMUstate", None, c_size_t(0), byref(c_void_p())) == ERROR
    instance.drop(state)


def test_state_in_initialization_mode_keeps_outputs_in_step_with_inputs(instance):
    assert (instance.setup(), instance.enter()) == (OK, OK)
    instance.set({PULL: 1.0})
    state = instance.save()  # before the outputs were asked for
    instance.exit()
    assert instance.step(0.0, 0.1) == OK
    assert instance.restore(state) == OK
    instance.drop(state)
    assert instance.value(FORCE) == 2.0
    assert instance.exit() == OK


def test_serialized_state_works_in_another_instance(fmu, instance):
    instance.set({GAIN: 9.0})
    instance.start()
    advance(instance)
    state = instance.save()
    content = instance.serialize(state)
    instance.drop(state)
    future = advance(instance)
    other = Instance(fmu, name="other")
    status, moved = other.deserialize(content)
    assert status == OK, other.text
    assert other.restore(moved) == OK
    other.drop(moved)
    assert advance(other) == future
    other.free()


CONTINUE = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from fmu_importer import Instance, Unpacked
from test_fmu_state import advance
made = Instance(Unpacked(sys.argv[2], sys.argv[3]))
status, state = made.deserialize(Path(sys.argv[4]).read_bytes())
assert status == 0 and made.restore(state) == 0
print(repr(advance(made)))
"""


def test_serialized_state_works_in_a_new_process(fmu_path, instance, tmp_path):
    instance.start()
    advance(instance)
    state = instance.save()
    (tmp_path / "state").write_bytes(instance.serialize(state))
    instance.drop(state)
    future = advance(instance)
    arguments = [Path(__file__).parent, fmu_path, tmp_path / "unpacked", tmp_path / "state"]
    run = subprocess.run(
        [sys.executable, "-c", CONTINUE, *map(str, arguments)], capture_output=True, text=True, check=False
    )
    assert run.stdout.strip() == repr(future), run.stderr


def test_altered_state_is_refused_whatever_was_altered(instance):
    instance.start()
    state = instance.save()
    content = instance.serialize(state)
    instance.drop(state)
    for at in range(0, len(content), 5):
        altered = bytearray(content)
        altered[at] ^= 0x10
        instance.messages.clear()
        status, moved = instance.deserialize(bytes(altered))
        assert status == ERROR, f"byte {at} altered unnoticed"
        assert moved.value is None
        assert instance.text


@pytest.mark.parametrize("kept", [0, 1, 7, 64, -8, -1])
def test_truncated_state_is_refused(instance, kept):
    state = instance.save()
    content = instance.serialize(state)
    instance.drop(state)
    assert instance.deserialize(content[:kept])[0] == ERROR
    assert "truncated" in instance.text


def test_too_small_a_vector_is_refused(instance):
    state = instance.save()
    content = bytearray(len(instance.serialize(state)) - 1)
    buffer = (type(c_size_t()) * len(content))()
    assert instance.call("fmi2SerializeFMUstate", state, buffer, c_size_t(len(content))) == ERROR
    instance.drop(state)


def test_state_of_another_scene_is_refused(instance, tmp_path):
    foreign = Instance(Unpacked(tiny_fmu(tmp_path, vertices=3, name="other"), tmp_path / "unpacked"))
    state = foreign.save()
    content = foreign.serialize(state)
    assert instance.deserialize(content)[0] == ERROR
    assert "another FMU" in instance.text
    assert instance.restore(state) == ERROR
    assert instance.drop(state) == ERROR
    assert instance.call("fmi2GetFMUstate", byref(state)) == ERROR
    foreign.drop(state)
    foreign.free()


def test_stop_time_belongs_to_the_experiment(fmu):
    made = Instance(fmu).start(0.0, 0.05)
    state = made.save()
    content = made.serialize(state)
    made.drop(state)
    made.free()
    longer = Instance(fmu).start(0.0, 10.0)
    _, moved = longer.deserialize(content)
    assert longer.restore(moved) == OK
    longer.drop(moved)
    assert longer.step(0.0, 1.0) == OK
    longer.free()
