"""Run an .fmu through a small native program: to time it without Python, to watch it, and for other platforms."""

import importlib.metadata
import os
import platform as host
import shutil
import struct
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple
from urllib.parse import quote

import numpy as np
from fmpy import read_model_description

from tissue_contact import cache
from tissue_contact.errors import InputError, WorkError
from tissue_contact.files import publish
from tissue_contact.fmu import compile
from tissue_contact.kernels.layout import Real

AARCH64_LIBRARIES = Path("/usr/aarch64-linux-gnu")  # of Debian's libc6-arm64-cross


def host_platform() -> str:
    """FMI's name of the platform that this process runs on; it need not be one that FMUs are built for."""
    machine = host.machine().lower()
    if sys.platform == "darwin":
        return "darwin64"
    system = {"linux": "linux", "win32": "win"}.get(sys.platform, sys.platform)
    return f"{system}64" if machine in {"x86_64", "amd64"} else f"{machine}-{system}"


def _wine() -> str | None:
    debian = "/usr/lib/wine/wine64"  # not on the path
    return shutil.which("wine64") or shutil.which("wine") or (debian if Path(debian).exists() else None)


def runner(platform: str) -> list[str] | None:
    """Command that runs a program of a platform here, empty for this machine's own; None if there is none."""
    if platform == host_platform():
        return []
    if platform == "win64":
        wine = _wine()
        return [wine] if wine else None
    if platform == "aarch64-linux":
        qemu = shutil.which("qemu-aarch64")
        return [qemu, "-L", str(AARCH64_LIBRARIES)] if qemu and AARCH64_LIBRARIES.is_dir() else None
    return None


def driver(platform: str, watched: bool = False) -> bytes:
    """The program of ``c/driver.c`` for a platform, with or without ``c/watch.c``, from the cache or compiled now."""
    target = compile.target(platform)
    names = ["driver", "watch"] if watched else ["driver"]
    sources = [compile.C_FILES / file for file in ("watch.h", "windows.c", *(f"{name}.c" for name in names))]
    version = cache.digest(sources, importlib.metadata.version("ziglang"))
    kept = cache.folder() / f"driver-{platform}-{version}"
    if not kept.exists():
        with tempfile.TemporaryDirectory() as name:
            directory = Path(name)
            flags = [*compile.C_FLAGS, compile.UNUSED, "-isystem", "fmi", "-s"]
            flags += ["-DTC_WATCHED", "-rdynamic"] if watched else []  # the FMU is to find the driver's malloc
            flags += {".so": ["-ldl"], ".dll": ["-Wl,--entry=mainCRTStartup"]}.get(target.suffix, [])
            files = compile.copy_sources(names, directory)
            made = compile.link(target.machines[0].zig, flags, files, "driver", directory)
            publish(kept, made)
    return kept.read_bytes()


def drive(
    fmu_path: Path,
    inputs: Real,
    h: float,
    platform: str | None = None,
    starts: Mapping[str, float] | None = None,
    prefix: Sequence[str] | None = None,
    watched: bool = False,
) -> tuple[Real, np.ndarray]:
    """Step an .fmu with given inputs.

    Parameters
    ----------
    fmu_path : Path
        The .fmu.
    inputs : array, shape [steps, n_inputs]
        Values of all inputs before every step, in the order of modelDescription.xml. Row 0 is also set in
        Initialization Mode.
    h : float
        Communication step size, s.
    platform : str, optional
        Which binary to run; this machine's by default. ``win64`` runs under wine, ``aarch64-linux`` under
        qemu.
    starts : mapping, optional
        Variable name -> value, set before initialization.
    prefix : sequence of str, optional
        Command that runs the program instead of `runner`'s.
    watched : bool
        Fail at the first allocation, lock or system call within a step. Linux on x86-64 only.

    Returns
    -------
    outputs : array, shape [steps, n_outputs]
        Values of all outputs after every step, in the order of modelDescription.xml.
    step_ns : array of uint64, shape [steps]
        Wall time of every fmi2DoStep, ns.

    Raises
    ------
    InputError
        The platform cannot be run here, the .fmu has no binary for it, or the inputs have a wrong shape.
    WorkError
        A call to the FMU failed; the message holds the log.
    """
    result = _run(fmu_path, inputs, h, platform, starts, prefix, watched=watched)
    step_ns = np.frombuffer(result, "<u8", len(inputs))
    return np.frombuffer(result, "<f8", offset=step_ns.nbytes).reshape(len(inputs), -1), step_ns


class Soak(NamedTuple):
    """A long run on one core; arrays of uint64, shape [steps]."""

    step_ns: np.ndarray  # wall time of every fmi2DoStep, ns
    preemptions: np.ndarray  # how often it was taken off its core within it
    waits: np.ndarray  # how often it gave its core away
    faults: np.ndarray  # pages that were not there
    processor_ns: np.ndarray  # processor time: of the wall time what nobody else had of the core, ns
    locked: bool  # the memory was, so that no page may go
    outputs: np.ndarray  # after the steps of the last repeat, shape [len(inputs), n_outputs] of float64


def soak(fmu_path: Path, inputs: Real, h: float, repeats: int, core: int) -> Soak:
    """Step an .fmu through the same inputs again and again, kept on one core, and note what held it up. Linux only.

    Arguments and errors as for `drive`.
    """
    result = np.frombuffer(_run(fmu_path, inputs, h, repeats=repeats, core=core), "<u8")
    steps = repeats * len(inputs)
    step_ns, preemptions, waits, faults, processor_ns = result[: 5 * steps].reshape(5, steps)
    outputs = result[5 * steps + 1 :].view("<f8").reshape(len(inputs), -1)
    return Soak(step_ns, preemptions, waits, faults, processor_ns, bool(result[5 * steps]), outputs)


def _run(
    fmu_path: Path,
    inputs: Real,
    h: float,
    platform: str | None = None,
    starts: Mapping[str, float] | None = None,
    prefix: Sequence[str] | None = None,
    watched: bool = False,
    repeats: int = 1,
    core: int | None = None,
) -> bytes:
    """What the driver writes; arguments and errors as for `drive` and `soak`."""
    platform = platform or host_platform()
    command = runner(platform) if prefix is None else list(prefix)
    if command is None:
        way_out = "Install wine64, or qemu-user with libc6-arm64-cross"
        raise InputError("platform", "must be one that runs here", platform, way_out)
    about = read_model_description(str(fmu_path))
    references = {v.name: v.valueReference for v in about.modelVariables}
    in_refs = [v.valueReference for v in about.modelVariables if v.causality == "input"]
    out_refs = [v.valueReference for v in about.modelVariables if v.causality == "output"]
    inputs = np.ascontiguousarray(inputs, "<f8")
    if inputs.ndim != 2 or inputs.shape[1] != len(in_refs):
        rule = f"must have the shape [steps, {len(in_refs)}]"
        raise InputError("inputs", rule, inputs.shape, "Give one column for every input of modelDescription.xml")
    given = starts or {}
    unknown = [name for name in given if name not in references]
    if unknown:
        raise InputError("starts", "must name variables of the FMU", unknown[0], "See modelDescription.xml")

    counts = repeats * len(inputs), len(inputs), len(given), len(in_refs), len(out_refs)
    job = struct.pack("<6Q2d", *counts, 0 if core is None else 1 + core, _start_time(about), h)
    job += b"".join(struct.pack("<Qd", references[name], value) for name, value in given.items())
    job += struct.pack(f"<{len(in_refs) + len(out_refs)}Q", *in_refs, *out_refs) + inputs.tobytes()
    with tempfile.TemporaryDirectory() as name:
        directory = Path(name)
        with zipfile.ZipFile(fmu_path) as archive:
            archive.extractall(directory / "fmu")
        library = f"fmu/binaries/{platform}/{about.coSimulation.modelIdentifier}{compile.target(platform).suffix}"
        if not (directory / library).exists():
            raise InputError(str(fmu_path), f"must hold a binary for {platform}", "none", "Build it for that platform")
        program = directory / "driver.exe"
        program.write_bytes(driver(platform, watched))
        program.chmod(0o755)
        (directory / "job").write_bytes(job)
        resources = (directory / "fmu/resources").as_posix()
        drive_letter = "/Z:" if platform == "win64" and os.name != "nt" else ""  # wine's name of the root directory
        location = f"file://{drive_letter}{'' if resources.startswith('/') else '/'}{quote(resources, safe='/:')}"
        arguments = [f"./{library}", location, about.guid, "job", "result"]
        run = subprocess.run(
            [*command, str(program), *arguments],
            cwd=directory,
            env=_environment(),
            capture_output=True,
            text=True,
        )
        if run.returncode != 0:
            raise WorkError(f"the FMU failed on {platform} (exit code {run.returncode}):\n{run.stderr.strip()}")
        return (directory / "result").read_bytes()


def _start_time(about) -> float:  # fmpy's ModelDescription
    experiment = about.defaultExperiment
    return float(experiment.startTime) if experiment and experiment.startTime else 0.0


def _environment() -> dict[str, str]:
    # A Windows installation of its own, silent and without the parts that would ask for a download.
    wine = {
        "WINEPREFIX": str(cache.folder() / "wine"),
        "WINEDEBUG": "-all",
        "WINEDLLOVERRIDES": "mscoree=;mshtml=;winemenubuilder.exe=",
    }
    return wine | os.environ
