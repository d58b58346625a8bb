"""The long run: what it tells of steps that took too long, and that the native program can make it."""

import os

import numpy as np
import pytest
from fmu_fixture import tiny_fmu

from tissue_contact.errors import InputError, WorkError
from tissue_contact.fmu import native
from tissue_contact.fmu.native import Soak, soak
from tissue_contact.scenarios import bench
from tissue_contact.scenarios import soak as program
from tissue_contact.scenarios.soak import figures, stolen, there_and_back

LINUX = pytest.mark.skipif(native.host_platform() != "linux64", reason="needs Linux on x86-64")


def test_an_unknown_sheet_is_refused():
    for run in (lambda: program.main(level="6k"), lambda: bench.main(levels="6K,6k")):
        with pytest.raises(InputError, match="found 6k"):
            run()


def round_of(ns, held_up, processor, outputs=(1.0, 2.0)):
    """A round of the steps with the given times, held up as given."""
    return Soak(np.asarray(ns, float), *held_up, np.asarray(processor, float), True, np.array([outputs]))


def test_late_steps_are_told_by_what_held_them_up():
    """Two rounds of six steps; the last step is late in both, and so are three more in one of them."""
    first, second = np.full(6, 1e5), np.full(6, 2e5)
    first[[0, 1, 5]], second[[2, 5]] = 3e6, 1.5e6
    held_up = np.zeros((2, 3, 6), int)  # preempted, waiting, page faults
    held_up[0, 0, 0], held_up[1, 2, 2], held_up[0, 1, 3] = 1, 2, 5  # the last held up a step that was in time
    processor = np.minimum(first, 1.2e6)
    processor[0] = 1e5  # of a step that was preempted
    told = figures([round_of(first, held_up[0], processor), round_of(second, held_up[1], second)])
    assert told["rounds"] == 2 and told["steps a round"] == 6
    assert told["steps over 1 ms"] == 5
    assert told["of them preempted"] == told["of them with a page fault"] == 1
    assert told["of them waiting"] == 0
    assert told["of them none of these"] == 3
    assert told["steps over 1 ms in every round"] == 1
    assert told["step in its fastest round"]["maximum"] == 1500.0
    assert told["step in its fastest round"]["median"] == 150.0  # of 100, 100, 100, 200, 200 and 1500
    assert told["step"]["maximum"] == 3000.0
    assert told["processor time of a step"]["maximum"] == 1500.0
    assert told["steps over 1 ms of processor time"] == 4


def test_rounds_that_are_not_the_same_work_are_not_compared():
    held_up = np.zeros((3, 2), int)
    rounds = [round_of([1e5, 1e5], held_up, [1e5, 1e5], outputs) for outputs in ((1.0, 2.0), (1.0, 2.0 + 1e-15))]
    with pytest.raises(WorkError, match="differ in their outputs"):
        figures(rounds)


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
    assert len(ran.outputs) == len(inputs) and np.isfinite(ran.outputs).all()
    assert figures([ran, ran])["steps a round"] == 3000
    # Beside the wall time of a step it has that of reading what held it up.
    assert (ran.processor_ns > 0).all() and np.median(ran.processor_ns) < np.median(ran.step_ns) + 2e4
