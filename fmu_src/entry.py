"""The two native entries of the kernels, generated from the layout.

An entry takes the blocks of the three bundles as raw pointers, slices them into the fields by the spans, and
calls the same `step` or `initialize` that Python calls. ``python -m tissue_contact.fmu.entry DIRECTORY
KERNELS`` writes their LLVM IR; it runs as a process of its own because numba reads the target's instruction
set from the environment once, when it is imported.
"""

import hashlib
import importlib.util
import json
import sys
from pathlib import Path

import numpy as np

from tissue_contact import status
from tissue_contact.kernels.layout import Model, Scratch, State, blocks

NAMES = ("tc_initialize", "tc_step")

BUNDLES = {"model": Model, "state": State, "scratch": Scratch}

# Blocks in the order of `Sizes` in c/instance.h and of ``sizes`` in an entry.
BLOCKS = (
    "model_index",
    "model_real",
    "state_index",
    "state_real",
    "scratch_index",
    "scratch_real",
    "parameters",
    "inputs",
    "outputs",
)

# Arguments of an entry with their C types; an entry returns a status code.
ARGUMENTS = {
    "model_index": "uint32_t *",
    "model_real": "double *",
    "state_index": "uint32_t *",
    "state_real": "double *",
    "scratch_index": "uint32_t *",
    "scratch_real": "double *",
    "spans": "uint64_t *",
    "sizes": "uint64_t *",
    "parameters": "double *",
    "inputs": "double *",
    "outputs": "double *",
    "h": "double",
}

# Blocks that the first figure of a status's detail is a slot of.
SLOT_BLOCK = {
    status.NONFINITE_INPUT: "inputs",
    status.PARAMETER_RANGE: "parameters",
    status.NONFINITE_OUTPUT: "outputs",
}


def fields() -> list[tuple[str, str, str]]:
    """Bundle, field and block of every field, in the order of the spans."""
    return [
        (bundle, field, f"{bundle}_{'index' if kind is np.uint32 else 'real'}")
        for bundle, kind_of in BUNDLES.items()
        for field, kind in blocks(kind_of).items()
    ]


def layout_hash() -> int:
    """64-bit hash of all that model.bin and the native library must agree on."""
    agreed = [fields(), [tuple(s) for s in status.STATUSES], BLOCKS, list(ARGUMENTS.items())]
    return int.from_bytes(hashlib.sha256(json.dumps(agreed).encode()).digest()[:8], "little")


def source() -> str:
    """Python source of the entries: functions ``tc_initialize`` and ``tc_step``, not yet compiled."""
    at = {name: i for i, name in enumerate(BLOCKS)}
    views = [f"    {name}_ = carray({name}, (n[{at[name]}],))" for name in ("parameters", "inputs", "outputs")]
    first = {bundle: 2 * [owner for owner, _, _ in fields()].index(bundle) for bundle in BUNDLES}
    bundles = [
        f"    {bundle}_ = join_{bundle}({bundle}_index, {bundle}_real, pointer_at(spans, {first[bundle]}))"
        for bundle in BUNDLES
    ]
    body = "\n".join([f"    n = carray(sizes, ({len(BLOCKS)},))", *views, *bundles])
    arguments = ", ".join(ARGUMENTS)
    return (
        f"def tc_initialize({arguments}):\n{body}\n"
        "    return initialize(model_, parameters_, state_, inputs_, outputs_, scratch_)\n\n\n"
        f"def tc_step({arguments}):\n{body}\n"
        "    return step(model_, parameters_, state_, inputs_, h, outputs_, scratch_)\n"
    )


def emit(directory: Path, kernels: Path) -> None:
    """Write ``NAME.ll`` for every entry and ``names.json``, which maps an entry to its function in the IR.

    ``kernels`` is the Python file that holds the functions ``initialize`` and ``step``.
    """
    from numba import carray, cfunc, types

    from tissue_contact.kernels.bundle import join_model, join_scratch, join_state, pointer_at

    spec = importlib.util.spec_from_file_location("kernels_of_entry", kernels)
    assert spec is not None and spec.loader is not None  # as every file that ends in .py has
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    numba_types = {
        "uint32_t *": types.CPointer(types.uint32),
        "uint64_t *": types.CPointer(types.uint64),
        "double *": types.CPointer(types.float64),
        "double": types.float64,
    }
    signature = types.int32(*[numba_types[c] for c in ARGUMENTS.values()])
    scope = {
        "carray": carray,
        "initialize": module.initialize,
        "step": module.step,
        "pointer_at": pointer_at,
        "join_model": join_model,
        "join_state": join_state,
        "join_scratch": join_scratch,
    }
    exec(source(), scope)
    names = {}
    for name in NAMES:
        entry = cfunc(signature, error_model="numpy")(scope[name])
        (directory / f"{name}.ll").write_text(entry.inspect_llvm(), "utf-8")
        # The function under the C callback wrapper: int32 f(int32 *status, void **exception, arguments...).
        names[name] = entry.native_name.replace("cfunc.", "", 1)
    (directory / "names.json").write_text(json.dumps(names), "utf-8")


if __name__ == "__main__":
    emit(Path(sys.argv[1]), Path(sys.argv[2]))
