"""From numba's IR to assembly text: simplified once, then optimised for one instruction set.

``python -m tissue_contact.fmu.machine_code IR ASSEMBLY EXPORTED NAME TRIPLE CPU`` does the second from file to file.
It runs as a process of its own because llvmlite lets one thread of a process into LLVM at a time.
"""

import re
import sys
from pathlib import Path

import llvmlite.binding as llvm

from tissue_contact.errors import WorkError

# What a compiled kernel may take from the C library of the target; anything else would need Python at run
# time.
ALLOWED_SYMBOLS = frozenset(
    ("memset", "memcpy", "memmove")
    + ("sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh")
    + ("sqrt", "cbrt", "hypot", "exp", "exp2", "expm1", "log", "log2", "log10", "log1p", "pow", "fmod")
    + ("floor", "ceil", "trunc", "round", "rint", "fabs", "fmin", "fmax", "copysign", "ldexp", "frexp")
)


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

    It is done once for all processors.

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


def assembly(ir: str, exported: str, name: str, triple: str, cpu: str) -> str:
    """Assembly of simplified IR for one instruction set; the function ``exported`` is called ``name``."""
    target_machine = _machine(triple, cpu)
    module = llvm.parse_assembly(ir)
    module.triple, module.data_layout = triple, str(target_machine.target_data)
    module.get_function(exported).name = name
    _optimise(module, target_machine, vectorise=True)
    return target_machine.emit_assembly(module)


if __name__ == "__main__":
    _, _source, _target, *_how = sys.argv
    Path(_target).write_text(assembly(Path(_source).read_text("utf-8"), *_how), "utf-8")
