"""The press scenario on every platform that runs here: the same forces as on Linux, the same bits as in Python.

All of it with ``--whole``, as an emulator takes a tenth of a second for a step.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from tissue_contact.assemble import assemble
from tissue_contact.assembly import Assembly
from tissue_contact.fmu.build import build
from tissue_contact.fmu.native import drive, host_platform, runner
from tissue_contact.scenarios.run import communication_points
from tissue_contact.scenarios.scenario import read_scenario
from tissue_contact.simulate import rollout

AGREEMENT = 1e-9  # of the peak force
SHORT = 400  # steps: touched, pressed and slid


class Press(NamedTuple):
    assembly: Assembly
    fmu: Path
    inputs: NDArray[np.float64]  # before every step, shape [steps, 7]
    step: float

    def outputs(self, platform: str) -> NDArray[np.float64]:
        """After every step, driven by a native program of the platform."""
        return drive(self.fmu, self.inputs, self.step, platform)[0]


@pytest.fixture(scope="module")
def press(tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest) -> Press:
    scenario = read_scenario("press")
    assembly = assemble(scenario.scene)
    times, steps = communication_points(scenario.duration, scenario.scene.solver.step)
    sampled = scenario.stimulus.sample(times[1:])
    inputs = np.column_stack(
        [sampled.get(v.name, np.full(len(steps), v.start)) for v in assembly.variables if v.block == "inputs"]
    )
    platforms = {host_platform(), *(p for p in ("win64", "aarch64-linux") if runner(p) is not None)}
    fmu = build(assembly, tmp_path_factory.mktemp("press") / "press.fmu", sorted(platforms))
    return Press(assembly, fmu, inputs if request.config.getoption("--whole") else inputs[:SHORT], steps[0])


def forces(press: Press, platform: str) -> NDArray[np.float64]:
    """Force [N] on the instrument and its mean over the step, shape [steps, 6]."""
    names = [v.name for v in press.assembly.variables if v.block == "outputs"]
    wanted = [f"instrument.{kind}[{k}]" for kind in ("force", "meanForce") for k in (1, 2, 3)]
    return press.outputs(platform)[:, [names.index(name) for name in wanted]]


def agree(press: Press, platform: str) -> None:
    here, there = forces(press, host_platform()), forces(press, platform)
    peak = np.abs(here).max()
    assert peak > 0.1  # the probe does touch
    assert np.abs(here - there).max() <= AGREEMENT * peak


def test_the_native_fmu_gives_the_bits_of_python(press: Press) -> None:
    inputs = np.vstack([press.inputs[:1], press.inputs])  # the native program initializes with its first row
    again = rollout(press.assembly, inputs, press.step).outputs[1:]
    np.testing.assert_array_equal(press.outputs(host_platform()), again)


@pytest.mark.wine
def test_windows_gives_the_same_forces(press: Press) -> None:
    if runner("win64") is None:
        pytest.skip("wine64 is not installed")
    agree(press, "win64")


@pytest.mark.qemu
def test_aarch64_gives_the_same_forces(press: Press) -> None:
    if runner("aarch64-linux") is None:
        pytest.skip("qemu-aarch64 or libc6-arm64-cross is not installed")
    agree(press, "aarch64-linux")
