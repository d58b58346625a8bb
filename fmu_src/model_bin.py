"""``resources/model.bin``: a scene as flat arrays, read by ``c/scene.c``.

All numbers are little-endian and every part begins at a multiple of 8 bytes::

    magic "TCMODEL1"            8 bytes
    layout hash                 u64, must equal the one compiled into the library
    total size                  u64, bytes
    checksum                    u64, FNV-1a by 64-bit words over all that follows
    guid                        64 bytes, zero-padded
    variables, bytes of names   u64, u64
    sizes of the nine blocks    u64 each, in the order of `entry.BLOCKS`
    start time                  f64, s
    variables                   one per value reference: block u32, slot u32, start, min, max f64,
                                offset of the name u64
    names                       UTF-8, zero-terminated
    spans                       u64, begin and end of each field of Model, State, Scratch in its block
    what persists, at the start parameters, inputs, outputs, state_real f64; state_index u32
    model_real, model_index     f64, u32
"""

import struct
import sys

import numpy as np

from tissue_contact.assembly import Assembly
from tissue_contact.errors import WorkError
from tissue_contact.fmu import entry
from tissue_contact.kernels.layout import spans

MAGIC = b"TCMODEL1"

# Order of Variable.block as a number.
VARIABLE_BLOCKS = ("parameters", "inputs", "outputs")

# Log categories: name in C, name and description in FMI.
LOG_CATEGORIES = {
    "EVENTS": ("logEvents", "Instantiation, initialization and termination"),
    "DISCARD": ("logStatusDiscard", "A step that could not be done as asked, and what would help"),
    "ERROR": ("logStatusError", "A call that was refused, and why; on unless switched off"),
    "ALL": ("logAll", "All messages"),
}

_CHECKED_FROM = 32  # everything after the checksum


def checksum(content: bytes) -> int:
    """FNV-1a over little-endian 64-bit words; ``content`` holds a multiple of 8 bytes."""
    value = 0xCBF29CE484222325
    for word in np.frombuffer(content, "<u8").tolist():
        value = ((value ^ word) * 0x100000001B3) & 0xFFFFFFFFFFFFFFFF
    return value


def seal(content: bytes) -> bytes:
    """Set the total size and the checksum of a model.bin to what its content needs."""
    out = bytearray(content)
    struct.pack_into("<Q", out, 16, len(out))
    struct.pack_into("<Q", out, 24, checksum(bytes(out[_CHECKED_FROM:])))
    return bytes(out)


def _padded(content: bytes) -> bytes:
    return content + bytes(-len(content) % 8)


def write(assembly: Assembly, guid: str) -> bytes:
    """Content of model.bin.

    Raises
    ------
    WorkError
        The assembly contradicts itself (a slot outside its vector, a bundle that does not match its block).
    """
    if sys.byteorder != "little":
        raise WorkError("model.bin can only be written on a little-endian machine")
    blocks = {name: getattr(assembly, name) for name in entry.BLOCKS}
    for name, block in blocks.items():
        kind = np.uint32 if name.endswith("_index") else np.float64
        if block.dtype != kind or block.ndim != 1:
            raise WorkError(f"assembly.{name} must be a vector of {kind.__name__}, it is {block.dtype}{block.shape}")
    field_spans = np.concatenate([spans(getattr(assembly, bundle)) for bundle in entry.BUNDLES])
    for i, (bundle, field, block) in enumerate(entry.fields()):
        if field_spans[2 * i + 1] > blocks[block].size:
            raise WorkError(f"{bundle}.{field} ends beyond assembly.{block}")

    names, table = b"", b""
    for v in assembly.variables:
        if not 0 <= v.slot < blocks[v.block].size:
            raise WorkError(f"variable {v.name} has slot {v.slot}, {v.block} has {blocks[v.block].size}")
        block = VARIABLE_BLOCKS.index(v.block)
        table += struct.pack("<IIdddQ", block, v.slot, v.start, v.minimum, v.maximum, len(names))
        names += v.name.encode() + b"\0"
    names = _padded(names)
    head = MAGIC + struct.pack("<QQQ64s", entry.layout_hash(), 0, 0, guid.encode())
    head += struct.pack("<QQ", len(assembly.variables), len(names))
    head += struct.pack(f"<{len(blocks)}Q", *(block.size for block in blocks.values()))
    head += struct.pack("<d", assembly.start_time)
    persistent = ("parameters", "inputs", "outputs", "state_real", "state_index")
    arrays = [blocks[name] for name in (*persistent, "model_real", "model_index")]
    return seal(head + table + names + field_spans.tobytes() + b"".join(_padded(a.tobytes()) for a in arrays))
