"""Which symbols a shared library exports, and which one for Linux needs: just enough of ELF, PE and Mach-O."""

import struct

from tissue_contact.errors import WorkError

# Names that zig's Mach-O linker makes in every library and cannot hide; bound by two-level names, they
# collide with nothing.
LINKER_NAMES = {"__dso_handle", "_mh_dylib_header"}


def _text(content: bytes, at: int) -> str:
    return content[at : content.index(b"\0", at)].decode()


def _elf(content: bytes, defined: bool) -> set[str]:
    sections_at, entry_size, count = struct.unpack_from("<Q10xHH", content, 40)
    sections = [struct.unpack_from("<IIQQQQIIQQ", content, sections_at + i * entry_size) for i in range(count)]
    names = set()
    for _, kind, _, _, offset, size, link, _, _, _ in sections:
        if kind != 11:  # SHT_DYNSYM
            continue
        strings_at = sections[link][4]
        for at in range(offset, offset + size, 24):
            name, info, _, section = struct.unpack_from("<IBBH", content, at)
            if (section != 0) == defined and info >> 4 in (1, 2):  # global or weak
                names.add(_text(content, strings_at + name))
    return names


def _pe(content: bytes) -> set[str]:
    header = struct.unpack_from("<I", content, 0x3C)[0]
    n_sections, optional_size = struct.unpack_from("<H12xH", content, header + 6)
    sections_at = header + 24 + optional_size
    sections = [struct.unpack_from("<4I", content, sections_at + 40 * i + 8) for i in range(n_sections)]

    def offset(address: int) -> int:
        for size, begin, raw_size, raw in sections:
            if begin <= address < begin + max(size, raw_size):
                return address - begin + raw
        raise WorkError("the DLL refers to an address outside its sections")

    exports = struct.unpack_from("<I", content, header + 24 + 112)[0]  # first data directory of PE32+
    if exports == 0:
        return set()
    count, _, names = struct.unpack_from("<III", content, offset(exports) + 24)
    pointers = struct.unpack_from(f"<{count}I", content, offset(names))
    return {_text(content, offset(pointer)) for pointer in pointers}


def _uleb(content: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = content[at]
        value |= (byte & 0x7F) << shift
        at, shift = at + 1, shift + 7
        if not byte & 0x80:
            return value, at


def _mach_o(content: bytes) -> set[str]:
    n_commands = struct.unpack_from("<I", content, 16)[0]
    trie = b""
    at = 32
    for _ in range(n_commands):
        command, size = struct.unpack_from("<II", content, at)
        if command in (0x22, 0x80000022):  # LC_DYLD_INFO, LC_DYLD_INFO_ONLY
            begin, length = struct.unpack_from("<II", content, at + 40)
            trie = content[begin : begin + length]
        elif command == 0x80000033:  # LC_DYLD_EXPORTS_TRIE
            begin, length = struct.unpack_from("<II", content, at + 8)
            trie = content[begin : begin + length]
        at += size
    names = set()
    open_nodes = [(0, "")] if trie else []
    while open_nodes:
        at, prefix = open_nodes.pop()
        size, at = _uleb(trie, at)
        if size:
            names.add(prefix.removeprefix("_"))  # the C prefix of the platform
        at += size
        children, at = trie[at], at + 1
        for _ in range(children):
            label = _text(trie, at)
            node, at = _uleb(trie, at + len(label) + 1)
            open_nodes.append((node, prefix + label))
    return names - LINKER_NAMES


def exported(content: bytes) -> set[str]:
    """Names that a 64-bit shared library exports; of a universal one, those of every slice together.

    Raises
    ------
    WorkError
        The content is none of ELF, PE and Mach-O.
    """
    if content[:4] == b"\x7fELF":
        return _elf(content, defined=True)
    if content[:2] == b"MZ":
        return _pe(content)
    if content[:4] == b"\xcf\xfa\xed\xfe":
        return _mach_o(content)
    if content[:4] == b"\xca\xfe\xba\xbe":
        count = struct.unpack_from(">I", content, 4)[0]
        slices = [struct.unpack_from(">2I", content, 8 + 20 * i + 8) for i in range(count)]
        return set().union(*(_mach_o(content[begin : begin + size]) for begin, size in slices))
    raise WorkError("the file is no shared library (neither ELF nor PE nor Mach-O)")


def imported(content: bytes) -> set[str]:
    """Names that a shared library for Linux takes from others."""
    return _elf(content, defined=False)
