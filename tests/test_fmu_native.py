"""The native driver: here, under wine and under qemu, and what a long run tells."""

import shutil
import subprocess

import numpy as np
import pytest
from fmu_fixture import KERNELS, tiny_assembly

from tissue_contact.errors import InputError, WorkError
from tissue_contact.fmu import native
from tissue_contact.fmu.build import build
from tissue_contact.fmu.native import drive, runner
from tissue_contact.kernels.bundle import Bundle

H = 1e-3
LINUX = pytest.mark.skipif(native.host_platform() != "linux64", reason="needs Linux on x86-64")


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """The tiny FMU for all platforms that can be run somewhere; the name has a space."""
    output = tmp_path_factory.mktemp("with space") / "tiny.fmu"
    return build(tiny_assembly(vertices=37), output, ["linux64", "win64", "aarch64-linux"], kernels=KERNELS)


def stimulus(steps):
    """Inputs, shape [steps, 2]."""
    inputs = np.zeros((steps, 2))
    inputs[:, 0] = np.sin(0.01 * np.arange(steps))
    return inputs


def in_python(inputs, gain=2.0):
    """Outputs of the same kernels in Python."""
    from fmu_kernels.step import initialize, step

    a = tiny_assembly(vertices=37)
    a.parameters[0] = gain
    a.inputs[:] = inputs[0]
    model, state, scratch = Bundle(a.model), Bundle(a.state), Bundle(a.scratch)
    assert initialize(model, a.parameters, state, a.inputs, a.outputs, scratch) == 0
    out = np.empty((len(inputs), 3))
    for row, given in zip(out, inputs, strict=True):
        a.inputs[:] = given
        assert step(model, a.parameters, state, a.inputs, H, a.outputs, scratch) == 0
        row[:] = a.outputs
    return out


def test_driver_gives_the_bits_of_python(path):
    outputs, step_ns = drive(path, stimulus(1000), H, starts={"contact.stiffness": 3.5})
    np.testing.assert_array_equal(outputs, in_python(stimulus(1000), 3.5))
    assert step_ns.shape == (1000,)
    assert 0 < np.median(step_ns) < 1e6


@pytest.mark.wine
def test_windows_binary_gives_the_same_bits(path):
    if runner("win64") is None:
        pytest.skip("wine64 is not installed")
    outputs, step_ns = drive(path, stimulus(1000), H, "win64")
    np.testing.assert_array_equal(outputs, in_python(stimulus(1000)))
    assert step_ns.shape == (1000,)


@pytest.mark.qemu
def test_aarch64_binary_gives_the_same_bits(path):
    if runner("aarch64-linux") is None:
        pytest.skip("qemu-aarch64 or libc6-arm64-cross is not installed")
    outputs, _ = drive(path, stimulus(1000), H, "aarch64-linux")
    np.testing.assert_array_equal(outputs, in_python(stimulus(1000)))


@pytest.mark.qemu
@LINUX
@pytest.mark.parametrize("cpu", ["qemu64", "Nehalem", "Haswell", "max"])
def test_every_instruction_set_gives_the_same_bits(path, cpu):
    qemu = shutil.which("qemu-x86_64")
    if qemu is None:
        pytest.skip("qemu-x86_64 is not installed")
    outputs, _ = drive(path, stimulus(300), H, "linux64", prefix=[qemu, "-cpu", cpu])
    np.testing.assert_array_equal(outputs, in_python(stimulus(300)))


def test_failing_step_is_told_with_the_log(path):
    inputs = stimulus(10)
    inputs[5, 1] = 5.0
    with pytest.raises(WorkError, match=r"status 2 in step 5"):
        drive(path, inputs, H)
    inputs[5, 1] = np.nan
    with pytest.raises(WorkError, match=r"tool.wish = -?nan, it must be finite"):
        drive(path, inputs, H)


def test_wrong_arguments(path):
    with pytest.raises(InputError, match=r"shape \[steps, 2\]"):
        drive(path, np.zeros((5, 3)), H)
    with pytest.raises(InputError, match=r"no\.such"):
        drive(path, stimulus(2), H, starts={"no.such": 1.0})
    with pytest.raises(InputError, match="runs here"):
        drive(path, stimulus(2), H, "sparc-solaris")


def test_platform_that_is_not_in_the_fmu(tmp_path):
    only = build(tiny_assembly(), tmp_path / "x.fmu", ["darwin64"], kernels=KERNELS)
    with pytest.raises(InputError, match="must hold a binary"):
        drive(only, stimulus(2), H)


def test_driver_without_arguments_explains_itself(tmp_path):
    program = tmp_path / "driver"
    program.write_bytes(native.driver(native.host_platform()))
    program.chmod(0o755)
    run = subprocess.run([program], capture_output=True, text=True, check=False)
    assert run.returncode == 2
    assert "usage" in run.stderr
