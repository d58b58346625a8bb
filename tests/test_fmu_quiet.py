"""A step allocates nothing, takes no lock and makes no system call: watched in contact, for every integrator."""

import re
import zipfile
from pathlib import Path

import numpy as np
import pytest
from fmu_fixture import tiny_fmu
from scenes import assembled, index

from tissue_contact.errors import WorkError
from tissue_contact.fmu import compile, machine_code, native
from tissue_contact.fmu.build import build
from tissue_contact.fmu.exports import imported

H = 1e-3
LINUX = pytest.mark.skipif(native.host_platform() != "linux64", reason="needs Linux on x86-64")
OFFENCES = ("malloc", "calloc", "realloc", "free", "aligned_alloc", "pthread_mutex_lock", "system call 110")

# What a library may take from the C library: for its messages, and to read the scene when it is instantiated.
MESSAGES = {"snprintf", "vsnprintf", "strlen", "strcmp", "strncmp", "strcpy", "memcmp", "bcmp", "strchr"}
INSTANTIATION = {"malloc", "calloc", "free", "fopen", "fread", "fseek", "ftell", "fclose", "__ctype_b_loc"}
MATHEMATICS = machine_code.ALLOWED_SYMBOLS | {"sincos"}  # a sine and a cosine of one angle
RUN_TIME = {"__cxa_finalize", "__gmon_start__", "_ITM_deregisterTMCloneTable", "_ITM_registerTMCloneTable"}

SCENE = """
    [solver]
    {solver}
    max_substeps = 10000
    [[tissue]]
    shape = {{ kind = "patch", size = [0.03, 0.03], triangles = 200, curvature_radius = 0.1, seed = 3 }}
    areal_density = 1.0
    stiffness = 100.0
    damping = 0.001
    drag = 20.0
    support_stiffness = 1e4
    [[instrument]]
    shape = {{ kind = "sphere", radius = 0.003, triangles = 200 }}
    start_position = [0.0, 0.0, 0.0005]
    {grasp}
    [[contact]]
    friction = 0.3
    {contact}
"""
FIELD = "stiffness_per_area = 1e7\ndamping_per_area = 2e2"
HULL = 'response = "hull"\nstiffness = 100.0\ndamping = 0.1'
GRASP = "grasp = { radius = 0.004, stiffness = 100.0, damping = 0.1, slip_force = 0.05 }"
SOLVERS = {
    name: f'integrator = "{name}"'
    for name in ("symplectic_euler", "explicit_euler", "runge_kutta_4", "implicit_euler", "projective_dynamics")
}
SOLVERS["balanced"] = 'preset = "balanced"'  # which resolves what is fast


def press(steps: int) -> np.ndarray:
    """Poses of a press of 2 mm, a slide and a way out, shape [steps, 7]."""
    t = np.linspace(0.0, 1.0, steps)
    zero = np.zeros_like(t)
    return np.column_stack([0.002 * t, zero, 5e-4 - 2.5e-3 * np.sin(np.pi * t) ** 2, zero + 1.0, zero, zero, zero])


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    """The FMU of the tiny kernels, on a machine whose kernel can tell of system calls."""
    path = tiny_fmu(tmp_path_factory.mktemp("tiny"))
    try:
        native.drive(path, np.zeros((1, 2)), H, watched=True)
    except WorkError as error:
        if "syscall user dispatch" in str(error):
            pytest.skip(str(error))
        raise
    return path


@pytest.fixture(scope="module")
def offender(tiny, tmp_path_factory):
    """The tiny FMU with a library that does what a step must not do."""
    folder = tmp_path_factory.mktemp("offender")
    source = Path(__file__).with_name("offender.c").read_bytes()
    compile.copy_sources([], folder)
    (folder / "offender.c").write_bytes(source)
    target = ["-target", compile.target("linux64").machines[0].zig]
    flags = [*compile.C_FLAGS, "-isystem", "fmi", "-shared", "-fPIC"]
    compile.zig([*target, *flags, "offender.c", "-o", "offender.so"], folder)
    with zipfile.ZipFile(tiny) as old, zipfile.ZipFile(folder / "offender.fmu", "w") as new:
        for name in old.namelist():
            new.writestr(name, (folder / "offender.so").read_bytes() if name.endswith(".so") else old.read(name))
    return folder / "offender.fmu"


@LINUX
@pytest.mark.parametrize("number", range(len(OFFENCES) + 1))
def test_every_offence_is_noticed(offender, number):
    starts = {"contact.stiffness": float(number)}
    native.drive(offender, np.zeros((3, 2)), H, starts=starts)  # and none where nobody watches
    if number == 0:
        native.drive(offender, np.zeros((3, 2)), H, starts=starts, watched=True)
    else:
        with pytest.raises(WorkError, match=f"fmi2DoStep called {OFFENCES[number - 1]}$"):
            native.drive(offender, np.zeros((3, 2)), H, starts=starts, watched=True)


@LINUX
@pytest.mark.parametrize("contact", [FIELD, HULL], ids=["field", "hull"])
@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.usefixtures("tiny")
def test_a_step_in_contact_is_quiet(solver, contact, tmp_path):
    assembly = assembled(SCENE.format(solver=SOLVERS[solver], contact=contact, grasp=""))
    path = build(assembly, tmp_path / "quiet.fmu", ["linux64"])
    outputs, _ = native.drive(path, press(48), H, watched=True)
    touching = outputs[:, index(assembly, "instrument.force[3]")] > 0.0
    assert 10 < touching.sum() < 40  # it was in contact, came and left


@LINUX
@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.usefixtures("tiny")
def test_a_step_of_a_grasp_is_quiet(solver, tmp_path):
    assembly = assembled(SCENE.format(solver=SOLVERS[solver], contact=HULL, grasp=GRASP))
    path = build(assembly, tmp_path / "quiet.fmu", ["linux64"])
    step = np.arange(40)
    jaw = np.where((step > 15) & (step < 35), 0.0, 1.0)
    outputs, _ = native.drive(path, np.column_stack([press(40), jaw]), H, watched=True)
    held = outputs[:, index(assembly, "instrument.grasped")]
    assert held[10] == 0 < held[20] > held[-1]  # it took hold and lost it


@LINUX
def test_a_refused_step_is_quiet_but_for_the_logger(tiny):
    """The driver's logger makes system calls; the FMU none, on its way to it and back."""
    inputs = np.zeros((10, 2))
    inputs[5, 1] = 5.0
    with pytest.raises(WorkError, match="status 2 in step 5"):
        native.drive(tiny, inputs, H, watched=True)
    inputs[5, 1] = np.nan
    with pytest.raises(WorkError, match="it must be finite"):
        native.drive(tiny, inputs, H, watched=True)


def test_the_library_imports_nothing_that_locks():
    needed = imported(compile.shared_library("linux64"))
    assert "malloc" in needed  # of fmi2Instantiate: the names are those of the library
    assert needed <= MATHEMATICS | MESSAGES | INSTANTIATION | RUN_TIME


def test_no_atomic_instruction():
    """A lock need not be imported."""
    for text in compile.kernels_ir(compile.STEP_KERNELS, lambda _: None).values():
        assert not re.search(r"\b(atomicrmw|cmpxchg|fence|atomic|asm)\b", text)
    for name in compile.LIBRARY_SOURCES:
        assert not re.search(r"atomic|__sync|pthread|threads\.h|syscall", (compile.C_FILES / f"{name}.c").read_text())
