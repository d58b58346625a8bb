"""From the kernels and the C files to one native library per platform.

The kernels are generic (a scene is data), so a library serves every scene and is built once per version of
the sources and tools: it is kept in a cache, keyed by a hash of all that goes into it.
"""

import importlib.metadata
import json
import os
import re
import struct
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import fmpy

import tissue_contact.kernels
from tissue_contact import cache, status
from tissue_contact.errors import InputError, WorkError
from tissue_contact.files import publish
from tissue_contact.fmu import entry, machine_code, model_bin

C_FILES = Path(__file__).parent / "c"
LIBRARY_SOURCES = ("absent", "calls", "instance", "kernel", "log", "path", "scene", "state", "step", "values")
STEP_KERNELS = Path(tissue_contact.kernels.__file__).parent / "step.py"
FMI_HEADERS = Path(fmpy.__file__).parent / "c-code"


class Machine(NamedTuple):
    """One kind of processor under one operating system."""

    zig: str  # zig's name of the target
    triple: str  # LLVM's name of it
    levels: dict[str, str]  # suffix of the entries -> LLVM's name of the instruction set


class Target(NamedTuple):
    """One platform directory of an FMU; more than one machine makes a universal binary."""

    platform: str
    suffix: str
    machines: tuple[Machine, ...]


_X86_64 = {"baseline": "x86-64", "v3": "x86-64-v3"}

TARGETS = {
    target.platform: target
    for target in (
        Target("linux64", ".so", (Machine("x86_64-linux-gnu.2.17", "x86_64-unknown-linux-gnu", _X86_64),)),
        Target("win64", ".dll", (Machine("x86_64-windows-gnu", "x86_64-pc-windows-gnu", _X86_64),)),
        Target(
            "darwin64",
            ".dylib",
            (
                Machine("x86_64-macos.11.0", "x86_64-apple-macosx11.0.0", _X86_64),
                Machine("aarch64-macos.11.0", "arm64-apple-macosx11.0.0", {"baseline": "apple-m1"}),
            ),
        ),
        Target(
            "aarch64-linux",
            ".so",
            (Machine("aarch64-linux-gnu.2.17", "aarch64-unknown-linux-gnu", {"baseline": "generic"}),),
        ),
    )
}

ALL = tuple(TARGETS)

Progress = Callable[[str], None]


def _versions(*packages: str) -> list[str]:
    return [f"{package}=={importlib.metadata.version(package)}" for package in packages]


def kernels_hash(kernels: Path) -> str:
    """Hash of all that decides the IR of the kernels.

    Every Python file beside ``kernels`` counts, those beside the layout, and the status codes, constants in the IR.
    """
    beside, layout = kernels.parent.glob("*.py"), STEP_KERNELS.parent.glob("*.py")
    sources = {
        *beside,
        *layout,
        Path(status.__file__),
        *(Path(__file__).with_name(f"{name}.py") for name in ("compile", "entry", "machine_code")),
    }
    return cache.digest(sources, kernels.name, entry.source(), *_versions("numba", "llvmlite", "numpy"))


def library_hash(kernels: Path) -> str:
    """Hash of all that decides the bytes of a library: kernels, C files, layout and tool versions."""
    sources = [
        Path(__file__),
        *(p for p in C_FILES.iterdir() if p.suffix in {".c", ".h", ".def"}),
        *FMI_HEADERS.glob("fmi2*.h"),
    ]
    return cache.digest(sources, kernels_hash(kernels), header(), *_versions("ziglang"))


def header() -> str:
    """The generated C header ``layout.h``: layout, entry signature, status table, log categories."""
    fields = entry.fields()
    block_of = [entry.BLOCKS.index(block) for _, _, block in fields]
    detail = next(i for i, (bundle, field, _) in enumerate(fields) if (bundle, field) == ("scratch", "detail"))
    arguments = ", ".join(["int32_t *status", "void **exception"] + [f"{c} {n}" for n, c in entry.ARGUMENTS.items()])
    if [s.code for s in status.STATUSES] != list(range(len(status.STATUSES))):
        raise WorkError("the status table must be in the order of its codes, from 0 without a gap")
    rows = []
    for s in status.STATUSES:
        if s.message.count("%g") != 2 or s.message.count("%") != 2:
            raise WorkError(f"the message of status {s.name} must have exactly two %g: {s.message}")
        block = entry.SLOT_BLOCK.get(s.code)
        block_index = -1 if block is None else model_bin.VARIABLE_BLOCKS.index(block)
        message = json.dumps(s.message, ensure_ascii=False)
        rows.append(f'    {{"{s.name}", {str(s.discard).lower()}, {block_index}, {message}}},')
    categories = [f'{{LOG_{name}, "{text}"}}' for name, (text, _) in model_bin.LOG_CATEGORIES.items()]
    return "\n".join(
        [
            "/* Generated from the Python tables; do not edit. */",
            "#ifndef TC_LAYOUT_H",
            "#define TC_LAYOUT_H",
            "#include <stdint.h>",
            f"typedef int32_t TcEntry({arguments});",
            f"#define TC_LAYOUT_HASH UINT64_C(0x{entry.layout_hash():016x})",
            f'#define TC_MODEL_MAGIC "{model_bin.MAGIC.decode()}"',
            '#define TC_STATE_MAGIC "TCSTATE1"',
            f"#define TC_FIELDS {len(fields)}",
            f"#define TC_FIELD_BLOCKS {', '.join(map(str, block_of))}",
            f"#define TC_FIELD_DETAIL {detail}",
            "#define TC_STATUSES \\",
            *[f"{row} \\" for row in rows],
            "",
            f"#define TC_CATEGORIES {', '.join(categories)}",
            "#endif",
            "",
        ]
    )


def reason(trace: str) -> str:
    """What went wrong, and in which line of the source, out of a traceback of Python or numba."""
    lines = [line.rstrip() for line in re.sub(r"\x1b\[\d*m", "", trace).splitlines() if line.strip()]
    headings = [n for n, line in enumerate(lines) if re.match(r"[\w.]+(Error|Exception|Interrupt)\b", line)]
    told = lines[headings[-1] :] if headings else lines[-1:]
    # After its first "During" numba tells the way there, call by call.
    end = next((n for n, line in enumerate(told) if line.startswith("During")), len(told))
    repeated = "Failed in nopython mode pipeline"
    return "\n".join(line for line in told[:end] if repeated not in line) or "it ended without a word"


def kernels_ir(kernels: Path, progress: Progress) -> dict[str, str]:
    """Simplified LLVM IR of every entry. Cached.

    Raises
    ------
    WorkError
        numba refused a kernel, or it needs more than a C library; the message says what.
    """
    kept = cache.folder() / f"kernels-{kernels_hash(kernels)}.json"
    if not kept.exists():
        progress("compiling the kernels")
        with tempfile.TemporaryDirectory() as name:
            directory = Path(name)
            environment = os.environ | {
                "NUMBA_OPT": "0",
                "NUMBA_CPU_NAME": "x86-64",
                "NUMBA_CPU_FEATURES": "",
                # numba's own cache does not tell optimised from unoptimised code.
                "NUMBA_CACHE_DIR": str(directory / "numba"),
                "NUMBA_DISABLE_JIT": "0",
            }
            command = [sys.executable, "-m", "tissue_contact.fmu.entry", name, str(kernels)]
            run = subprocess.run(command, env=environment, capture_output=True, text=True)
            if run.returncode != 0:
                raise WorkError(f"the kernels do not compile ahead of time: {reason(run.stderr)}")
            functions = json.loads((directory / "names.json").read_text("utf-8"))
            made = {
                exported: machine_code.simplify((directory / f"{exported}.ll").read_text("utf-8"), function, exported)
                for exported, function in functions.items()
            }
        publish(kept, json.dumps(made).encode())
    return json.loads(kept.read_text("utf-8"))


def zig(arguments: Sequence[str], directory: Path) -> None:
    """Run ``zig cc`` in a directory.

    Raises
    ------
    WorkError
        With what the compiler said.
    """
    command = [sys.executable, "-m", "ziglang", "cc", *arguments]
    environment = {"ZIG_GLOBAL_CACHE_DIR": str(cache.folder() / "zig")} | os.environ
    run = subprocess.run(command, cwd=directory, env=environment, capture_output=True, text=True)
    if run.returncode != 0:
        raise WorkError(f"zig cc failed:\n{run.stderr.strip()}")


C_FLAGS = ("-std=c11", "-O2", "-g0", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-ffp-contract=off")
UNUSED = "-Wno-unused-command-line-argument"
_OF_WINDOWS = ("kernel32", *(f"api-ms-win-crt-{part}-l1-1-0"
                             for part in ("heap", "math", "private", "runtime", "stdio", "string")))  # fmt: skip


def link(target: str, flags: Sequence[str], inputs: Sequence[str], output: str, directory: Path) -> bytes:
    """What zig makes of C files and assembly in a directory, for one of its targets.

    Of mingw's runtime only the headers are taken: zig would build all of it, file by file.
    """
    how = ["-target", target, *flags]
    if "windows" in target:
        files = [*inputs, *copy_sources(["windows"], directory)]
        for file in files:
            zig([*how, "-c", file, "-o", f"{file}.obj"], directory)
        inputs = [f"{file}.obj" for file in files]
        how += ["-nostdlib", "-lcompiler_rt", *(f"-l{library}" for library in _OF_WINDOWS)]
    zig([*how, *inputs, "-o", output], directory)
    return (directory / output).read_bytes()


def copy_sources(names: Sequence[str], directory: Path) -> list[str]:
    """Copy C files and every header into a directory, so that no path of this machine gets into a binary."""
    for path in [*C_FILES.iterdir(), *FMI_HEADERS.glob("fmi2*.h")]:
        if path.suffix in {".h", ".def"} or path.stem in names:
            folder = directory / ("fmi" if path.parent == FMI_HEADERS else ".")
            folder.mkdir(exist_ok=True)
            (folder / path.name).write_bytes(path.read_bytes())
    return [f"{name}.c" for name in names]


def _assemble(ir: Path, machine: Machine, level: str, directory: Path) -> None:
    """Write the assembly of one entry, for one level of a machine, into a directory."""
    name = f"{ir.stem}_{level}"
    how = [str(directory / f"{name}.s"), ir.stem, name, machine.triple, machine.levels[level]]
    command = [sys.executable, "-m", machine_code.__name__, str(ir), *how]
    run = subprocess.run(command, capture_output=True, text=True)
    if run.returncode != 0:
        raise WorkError(f"no machine code of {name} for {machine.triple}: {reason(run.stderr)}")


def _link(machine: Machine, suffix: str, directory: Path) -> bytes:
    """The library made of the C files and of all assembly in a directory."""
    inputs = [path.name for path in sorted(directory.glob("*.s"))]
    (directory / "layout.h").write_text(header(), "utf-8")
    inputs = [*copy_sources(LIBRARY_SOURCES, directory), *inputs]
    flags = [*C_FLAGS, "-isystem", "fmi", "-fvisibility=hidden", "-shared", "-s"]
    flags.append(UNUSED)  # assembly files use only some of them
    if suffix == ".so":
        flags += ["-fPIC", "-Wl,-z,defs", "-lm"]
    if suffix == ".dylib":
        flags += ["-Wl,-install_name,@rpath/tissue_contact.dylib"]
    return link(machine.zig, flags, inputs, f"tissue_contact{suffix}", directory)


# Mach-O processor type -> alignment of its slice as a power of two.
_CPU_TYPES = {0x01000007: 12, 0x0100000C: 14}


def universal(slices: Sequence[bytes]) -> bytes:
    """Join Mach-O files for several processors into one universal file."""
    out = bytearray(struct.pack(">II", 0xCAFEBABE, len(slices)))
    at = len(out) + 20 * len(slices)
    body = bytearray()
    for part in slices:
        cpu, subtype = struct.unpack_from("<II", part, 4)
        alignment = _CPU_TYPES[cpu]
        begin = -(-(at + len(body)) // 2**alignment) * 2**alignment
        body += bytes(begin - at - len(body)) + part
        out += struct.pack(">IIIII", cpu, subtype, begin, len(part), alignment)
    return bytes(out + body)


def target(platform: str) -> Target:
    """The target of a platform; `InputError` if there is none."""
    if platform not in TARGETS:
        raise InputError("platform", f"must be one of {', '.join(ALL)}", platform, "Name a platform of that list")
    return TARGETS[platform]


def shared_libraries(
    platforms: Sequence[str], kernels: Path = STEP_KERNELS, progress: Progress = lambda _: None
) -> dict[str, bytes]:
    """Shared library of each platform, from the cache or compiled now, side by side on all cores.

    ``kernels`` is the Python file that holds ``initialize`` and ``step``.

    Raises
    ------
    InputError
        There is no such platform.
    WorkError
        A kernel or a C file does not compile or link.
    """
    kept = {t.platform: cache.folder() / f"{t.platform}-{library_hash(kernels)}{t.suffix}"
            for t in map(target, platforms)}  # fmt: skip
    missing = {platform: path for platform, path in kept.items() if not path.exists()}
    if missing:
        _compile(missing, kernels_ir(kernels, progress), progress)
    return {platform: path.read_bytes() for platform, path in kept.items()}


def _compile(missing: dict[str, Path], ir: dict[str, str], progress: Progress) -> None:
    """Compile the libraries of some platforms and put each where it is kept."""
    progress(f"compiling for {', '.join(missing)}")
    machines = [(machine, TARGETS[platform].suffix) for platform in missing for machine in TARGETS[platform].machines]
    with tempfile.TemporaryDirectory() as name, ThreadPoolExecutor(os.cpu_count()) as pool:
        sources = [Path(name) / f"{exported}.ll" for exported in ir]
        for source, text in zip(sources, ir.values(), strict=True):
            source.write_text(text, "utf-8")
        directories = [Path(name) / machine.triple for machine, _ in machines]
        for directory in directories:
            directory.mkdir()
        jobs = [(source, machine, level, directory)
                for source in sorted(sources, key=lambda s: -s.stat().st_size)  # the longest first
                for (machine, _), directory in zip(machines, directories, strict=True)
                for level in machine.levels]  # fmt: skip
        list(pool.map(_assemble, *zip(*jobs, strict=True)))
        slices = pool.map(_link, *zip(*machines, strict=True), directories)
        for platform, path in missing.items():
            parts = [next(slices) for _ in TARGETS[platform].machines]
            publish(path, parts[0] if len(parts) == 1 else universal(parts))


def shared_library(platform: str, kernels: Path = STEP_KERNELS, progress: Progress = lambda _: None) -> bytes:
    """The same for one platform."""
    return shared_libraries([platform], kernels, progress)[platform]
