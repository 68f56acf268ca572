"""What an object file for a processor of 32 bits holds: its sections, and what it calls.

Format: System V ABI, chapter 4, "Object Files" (ELF), little-endian.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator

from robodyn_cli.record import record

WRITABLE, KEPT, CODE = 1, 2, 4  # flags of sections; kept: in the memory of the processor
SYMBOLS, EMPTY = 2, 8  # types of sections; empty: zero at the start, in no file
SYMBOL = struct.Struct("<IIIBBH")


@record
class ElfSection:
    """A section: its name, its kind (text, rodata, data, bss; empty where the processor does not have it), its size in
    bytes, and what it holds."""

    name: str
    kind: str
    size: int
    content: bytes


def sections_of(code: bytes) -> list[ElfSection]:
    """Return the sections of an object file."""
    return [
        ElfSection(_text(code, name), kind, size, content) for name, kind, size, content, _, _ in _rows(code)
    ]


def undefined_symbols(code: bytes) -> list[str]:
    """Return the names of what an object file takes from others."""
    rows = list(_rows(code))
    names = set()
    for _, _, _, content, sort, link in rows:
        if sort == SYMBOLS:
            strings = rows[link][3]
            names |= {
                strings[name : strings.index(b"\0", name)].decode()
                for name, _, _, _, _, section in SYMBOL.iter_unpack(content)
                if name and not section
            }
    return sorted(names)


def _rows(code: bytes) -> Iterator[tuple[int, str, int, bytes, int, int]]:
    """Give the place of each section's name, its kind, size, content, type and the section that it refers to."""
    first, size, count = _header(code)
    names = struct.unpack_from("<H", code, 50)[0]
    start = struct.unpack_from("<I", code, first + names * size + 16)[0]
    for k in range(count):
        name, sort, flags, _, at, length, link = struct.unpack_from("<7I", code, first + k * size)
        kind = ""
        if flags & KEPT:
            kind = (
                "text"
                if flags & CODE
                else "rodata"
                if not flags & WRITABLE
                else "bss"
                if sort == EMPTY
                else "data"
            )
        yield start + name, kind, length, b"" if sort == EMPTY else code[at : at + length], sort, link


def _header(code: bytes) -> tuple[int, int, int]:
    """Return where the table of sections begins, the size of a row, and how many there are."""
    return struct.unpack_from("<I", code, 32)[0], *struct.unpack_from("<HH", code, 46)


def _text(code: bytes, at: int) -> str:
    return code[at : code.index(b"\0", at)].decode()
