"""Time bookkeeping of fmi2DoStep."""

import math

import pytest
from fmu_fixture import POSITION, STEPS
from fmu_importer import ERROR, OK


def test_importer_that_accumulates_rounding(instance):
    instance.start(0.0, 1000.0)
    time, h = 0.0, 1e-3
    for _ in range(1_000_000):
        if instance.step(time, h) != OK:
            pytest.fail(instance.text)
        time += h
    assert time != 1000.0
    assert instance.time() == 1000.0


def test_importer_that_multiplies(instance):
    instance.start(0.5)
    for k in range(10_000):
        assert instance.step(0.5 + k * 0.1, 0.1) == OK
    assert instance.time() == 0.5 + 10_000 * 0.1


def test_time_does_not_drift_over_1e8_steps(instance):
    """The clock after 1e8 steps of 0.1 s, reached through a saved state instead of 1e8 calls."""
    import struct

    instance.start()
    assert instance.step(0.0, 0.1) == OK
    state = instance.save()
    content = bytearray(instance.serialize(state))
    instance.drop(state)
    clock = struct.pack("<3d2Q", 0.0, 0.0, 0.1, 1, 1)
    at = content.index(clock)
    content[at : at + 40] = struct.pack("<3d2Q", 0.0, 0.0, 0.1, 10**8, 10**8)
    content[at - 8 : at] = fnv(bytes(content[at:]))
    status, moved = instance.deserialize(bytes(content))
    assert status == OK, instance.text
    assert instance.restore(moved) == OK
    instance.drop(moved)
    assert instance.time() == 1e7
    accumulated = 9999999.98112945  # sum of 1e8 times 0.1 in double precision
    assert instance.step(accumulated, 0.1) == OK, instance.text
    assert instance.time() == 0.1 * (10**8 + 1)
    assert instance.step(instance.time() - 0.1, 0.1) == ERROR  # one step behind is no rounding


def fnv(content):
    from tissue_contact.fmu.model_bin import checksum

    return checksum(content).to_bytes(8, "little")


@pytest.mark.parametrize("start", [0.2, 0.0, 0.1 + 1e-5, -0.1, math.nan, math.inf, 1e300])
def test_wrong_communication_point(instance, start):
    instance.start()
    assert instance.step(0.0, 0.1) == OK
    kept = instance.get(POSITION, STEPS)
    assert instance.step(start, 0.1) == ERROR
    assert "currentCommunicationPoint" in instance.text
    assert instance.get(POSITION, STEPS) == kept
    assert instance.step(0.1, 0.1) == OK


@pytest.mark.parametrize("h", [-0.1, -0.0 - 1e-300, math.nan, math.inf, -math.inf])
def test_wrong_step_size(instance, h):
    instance.start()
    assert instance.step(0.0, h) == ERROR
    assert "communicationStepSize" in instance.text
    assert instance.time() == 0.0


def test_step_of_no_length_refreshes_and_counts_nothing(instance):
    instance.start(0.3)
    for _ in range(3):
        assert instance.step(0.3, 0.0) == OK
    assert instance.time() == 0.3
    assert instance.value(STEPS) == 0.0
    for k in range(1000):
        assert instance.step(0.3 + k * 0.1, 0.1) == OK
        assert instance.step(0.3 + (k + 1) * 0.1, 0.0) == OK
    assert instance.value(STEPS) == 1000.0
    assert instance.time() == 0.3 + 1000 * 0.1  # no rounding was added in between


def test_changing_step_size(instance):
    instance.start()
    time = 0.0
    for k in range(3000):
        h = (1e-3, 2.5e-4, 1e-6)[k % 3]
        assert instance.step(time, h) == OK, instance.text
        time += h
    assert instance.time() == pytest.approx(time, rel=1e-12)


def test_stop_time(instance):
    instance.start(0.0, 1.0)
    time = 0.0
    for _ in range(10):
        assert instance.step(time, 0.1) == OK
        time += 0.1
    assert instance.step(time, 0.1) == ERROR
    assert "stopTime" in instance.text
    assert instance.step(time, 0.0) == OK
    assert instance.value(STEPS) == 10.0


def test_last_step_ends_at_the_stop_time_but_for_rounding(instance):
    instance.start(0.0, 0.3)
    assert 0.2 + 0.1 > 0.3
    for k in range(3):
        assert instance.step(k * 0.1, 0.1) == OK, instance.text


def test_no_stop_time(instance):
    instance.start()
    assert instance.step(0.0, 1e6) == OK


@pytest.mark.parametrize(("start", "stop"), [(math.nan, None), (math.inf, None), (0.0, math.nan), (1.0, 0.5)])
def test_experiment_that_cannot_be(instance, start, stop):
    assert instance.setup(start, stop) == ERROR
    assert "Time" in instance.text
    assert instance.setup(0.0, 0.0) == OK


def test_start_time_of_the_description_without_an_experiment(instance):
    assert (instance.enter(), instance.exit()) == (OK, OK)
    assert instance.step(0.0, 0.1) == OK
