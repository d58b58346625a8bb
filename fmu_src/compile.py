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
from pathlib import Path
from typing import NamedTuple

import fmpy
import llvmlite.binding as llvm

import tissue_contact.kernels
from tissue_contact import cache, status
from tissue_contact.errors import InputError, WorkError
from tissue_contact.fmu import entry, model_bin

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

# What a compiled kernel may take from the C library of the target; anything else would need Python at run
# time.
ALLOWED_SYMBOLS = frozenset(
    ("memset", "memcpy", "memmove")
    + ("sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh")
    + ("sqrt", "cbrt", "hypot", "exp", "exp2", "expm1", "log", "log2", "log10", "log1p", "pow", "fmod")
    + ("floor", "ceil", "trunc", "round", "rint", "fabs", "fmin", "fmax", "copysign", "ldexp", "frexp")
)

Progress = Callable[[str], None]


def _versions(*packages: str) -> list[str]:
    return [f"{package}=={importlib.metadata.version(package)}" for package in packages]


def kernels_hash(kernels: Path) -> str:
    """Hash of all that decides the IR of the kernels. Every Python file beside ``kernels`` counts, and the layout's."""
    beside, layout = kernels.parent.glob("*.py"), STEP_KERNELS.parent.glob("*.py")
    sources = {*beside, *layout, Path(entry.__file__), Path(__file__)}
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


def publish(path: Path, content: bytes) -> None:
    """Write a file of the cache so that another process sees all of it or nothing."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as file:
        try:
            file.write(content)
            file.close()
            Path(file.name).replace(path)
        except BaseException:
            Path(file.name).unlink(missing_ok=True)
            raise


def _optimise(module: llvm.ModuleRef, machine: llvm.TargetMachine, vectorise: bool) -> None:
    tuning = llvm.create_pipeline_tuning_options(speed_level=3)
    tuning.loop_vectorization = tuning.slp_vectorization = tuning.loop_unrolling = vectorise
    builder = llvm.create_pass_builder(machine, tuning)
    passes = builder.getModulePassManager()
    passes.add_refprune_pass()
    passes.run(module, builder)


def _machine(triple: str, cpu: str) -> llvm.TargetMachine:
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    target = llvm.Target.from_triple(triple)
    return target.create_target_machine(cpu=cpu, opt=3, reloc="pic", codemodel="default")


def simplify(ir: str, function: str, exported: str) -> str:
    """Reduce numba's IR to the one function ``exported``: all inlined, no reference counts, any processor.

    It is 98 % of the work of optimisation and done once for all processors.

    Raises
    ------
    WorkError
        The code needs a symbol that a plain C library does not have; the message names it.
    """
    machine = _machine("x86_64-unknown-linux-gnu", "x86-64")
    # numba marks its counting of references noinline; within a kernel it is seen to be of no use.
    module = llvm.parse_assembly(re.sub(r"\bnoinline\b", "alwaysinline", ir))
    for part in [*module.functions, *module.global_variables]:
        if part.is_declaration:
            continue
        if part.name == function:
            part.name, part.linkage, part.visibility = exported, "external", "hidden"
        else:
            part.linkage = "internal"
    for _ in range(2):  # what the first leaves of the reference counts, the second removes
        _optimise(module, machine, vectorise=False)
    needed = {
        part.name
        for part in [*module.functions, *module.global_variables]
        if part.is_declaration and not part.name.startswith("llvm.")
    }
    foreign = sorted(needed - ALLOWED_SYMBOLS)
    if foreign:
        raise WorkError(
            f"{exported} needs {', '.join(foreign)}, which no C library has: a kernel allocates, prints, "
            "reshapes, or assigns one array to another. Kernels may only do arithmetic on the numbers of the "
            "arrays they are given"
        )
    return str(module)


def assembly(ir: str, exported: str, level: str, machine: Machine) -> str:
    """Assembly of simplified IR for one level of a machine; the function is called ``{exported}_{level}``."""
    target_machine = _machine(machine.triple, machine.levels[level])
    module = llvm.parse_assembly(ir)
    module.triple, module.data_layout = machine.triple, str(target_machine.target_data)
    module.get_function(exported).name = f"{exported}_{level}"
    _optimise(module, target_machine, vectorise=True)
    return target_machine.emit_assembly(module)


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
                exported: simplify((directory / f"{exported}.ll").read_text("utf-8"), function, exported)
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


def copy_sources(names: Sequence[str], directory: Path) -> list[str]:
    """Copy C files and every header into a directory, so that no path of this machine gets into a binary."""
    for path in [*C_FILES.iterdir(), *FMI_HEADERS.glob("fmi2*.h")]:
        if path.suffix in {".h", ".def"} or path.stem in names:
            folder = directory / ("fmi" if path.parent == FMI_HEADERS else ".")
            folder.mkdir(exist_ok=True)
            (folder / path.name).write_bytes(path.read_bytes())
    return [f"{name}.c" for name in names]


def _link(machine: Machine, suffix: str, ir: dict[str, str]) -> bytes:
    with tempfile.TemporaryDirectory() as name:
        directory = Path(name)
        (directory / "layout.h").write_text(header(), "utf-8")
        inputs = copy_sources(LIBRARY_SOURCES, directory)
        for level in machine.levels:
            for exported, text in ir.items():
                inputs.append(f"{exported}_{level}.s")
                (directory / inputs[-1]).write_text(assembly(text, exported, level, machine), "utf-8")
        flags = [*C_FLAGS, "-isystem", "fmi", "-fvisibility=hidden", "-shared", "-s"]
        flags.append("-Wno-unused-command-line-argument")  # assembly files use only some of them
        if suffix == ".so":
            flags += ["-fPIC", "-Wl,-z,defs", "-lm"]
        if suffix == ".dylib":
            flags += ["-Wl,-install_name,@rpath/tissue_contact.dylib"]
        output = f"tissue_contact{suffix}"
        zig(["-target", machine.zig, *flags, *inputs, "-o", output], directory)
        return (directory / output).read_bytes()


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


def shared_library(platform: str, kernels: Path = STEP_KERNELS, progress: Progress = lambda _: None) -> bytes:
    """Shared library of a platform, from the cache or compiled now.

    ``kernels`` is the Python file that holds ``initialize`` and ``step``.

    Raises
    ------
    InputError
        There is no such platform.
    WorkError
        A kernel or a C file does not compile or link.
    """
    chosen = target(platform)
    kept = cache.folder() / f"{platform}-{library_hash(kernels)}{chosen.suffix}"
    if not kept.exists():
        ir = kernels_ir(kernels, progress)
        progress(f"compiling for {platform}")
        slices = [_link(machine, chosen.suffix, ir) for machine in chosen.machines]
        publish(kept, slices[0] if len(slices) == 1 else universal(slices))
    return kept.read_bytes()
