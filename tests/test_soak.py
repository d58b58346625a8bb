"""The long run: what it tells of steps that took too long, and that the native program can make it."""

import os

import numpy as np
import pytest
from fmu_fixture import tiny_fmu

from tissue_contact.fmu import native
from tissue_contact.fmu.native import Soak, soak
from tissue_contact.scenarios.soak import figures, stolen, there_and_back

LINUX = pytest.mark.skipif(native.host_platform() != "linux64", reason="needs Linux on x86-64")


def test_late_steps_are_told_by_what_held_them_up():
    """Three places, five repeats; the third place is always late, and so are three steps more."""
    ns = np.array([[1e5, 2e5, 1.5e6]] * 5)
    held_up = np.zeros((3, 5, 3), int)
    ns[0, 0] = ns[1, 1] = ns[2, 0] = 3e6
    held_up[0, 0, 0], held_up[2, 1, 1], held_up[1, 3, 1] = 1, 2, 5  # the last held up a step that was in time
    processor = np.minimum(ns, 1.2e6)
    processor[0, 0] = 1e5  # of a step that was preempted
    told = figures(Soak(ns.ravel(), *held_up.reshape(3, -1), processor.ravel(), locked=True), places=3)
    assert told["steps"] == 15 and told["steps over 1 ms"] == 8
    assert told["of them preempted"] == told["of them with a page fault"] == 1
    assert told["of them waiting"] == 0
    assert told["of them none of these"] == 6
    assert told["of them at places that take over 1 ms at their median"] == 5
    assert told["slowest place of the motion, median over the repeats"] == 1500.0
    assert told["step"]["maximum"] == 3000.0
    assert told["processor time of a step"]["maximum"] == 1200.0
    assert told["steps over 1 ms of processor time"] == 7


def test_the_motion_goes_on_where_it_ends():
    path = there_and_back()
    steps = np.abs(np.diff(np.concatenate([path, path[:1]]), axis=0))[:, :3]
    assert len(path) == 2000
    assert steps.max() < 1e-4  # at most 0.1 m/s: 13 mm in 0.3 s with a half cosine is 0.07


@LINUX
def test_a_long_run_tells_what_held_it_up(tmp_path):
    inputs = np.zeros((100, 2))
    core = max(os.sched_getaffinity(0))
    before = stolen(core)
    ran = soak(tiny_fmu(tmp_path), inputs, 1e-3, 30, core)
    assert stolen(core) >= before >= 0.0
    assert all(column.shape == (3000,) for column in ran[:5])
    assert (ran.step_ns > 0).all()
    assert max(column.max() for column in ran[1:4]) < 1e6  # differences, not sums since the start
    assert figures(ran, len(inputs))["steps"] == 3000
    # Beside the wall time of a step it has that of reading what held it up.
    assert (ran.processor_ns > 0).all() and np.median(ran.processor_ns) < np.median(ran.step_ns) + 2e4
