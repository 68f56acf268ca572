"""Types and values of C, and what they are in LLVM IR."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from typing import Any

from robodyn_cli.record import record

# "i32", "i8", "double", "float", "void"; ("ptr", of), ("array", of, count), ("struct", name)
CType = str | tuple[Any, ...]
RANKS = ("i8", "i32", "float", "double")
SIZES = {"i8": 1, "i32": 4, "float": 4, "double": 8}
Structs = Mapping[str, Mapping[str, CType]]  # members in their order, by name


@record
class CValue:
    """A value, or the place of one: its type and its text in IR.

    place : whether the text is the address where it is. known : the number where it is a constant.
    """

    type: CType
    text: str
    place: bool = False
    known: float | int | None = None


def is_real(kind: CType) -> bool:
    return kind in ("float", "double")


def ir_type(kind: CType) -> str:
    """Return a type as IR."""
    if isinstance(kind, str):
        return kind
    if kind[0] == "array":
        return f"[{kind[2]} x {ir_type(kind[1])}]"
    return "ptr" if kind[0] == "ptr" else f"%{kind[1]}"


def size_of(kind: CType, structs: Structs) -> int:
    """Return the bytes that a type takes; its members need no room between them."""
    if isinstance(kind, str):
        return SIZES[kind]
    if kind[0] == "array":
        return int(kind[2]) * size_of(kind[1], structs)
    if kind[0] != "struct":
        raise NotImplementedError("the size of an address is that of the processor")
    members = structs[kind[1]].values()
    most = max(alignment(x, structs) for x in members)
    return -(-sum(size_of(x, structs) for x in members) // most) * most


def alignment(kind: CType, structs: Structs) -> int:
    """Return what the address of a type is a multiple of."""
    if isinstance(kind, str):
        return SIZES[kind]
    if kind[0] == "array":
        return alignment(kind[1], structs)
    return max(alignment(x, structs) for x in structs[kind[1]].values()) if kind[0] == "struct" else 4


def common(a: CType, b: CType) -> CType:
    """Return the type in which an operation of two takes place."""
    if isinstance(a, str) and isinstance(b, str):
        return max(a, b, "i32", key=RANKS.index)
    return a


def constant(kind: CType, number: float) -> CValue:
    """Return a number of a type."""
    if is_real(kind):
        value = float(number)
        if kind == "float":
            value = _single(value)
        (bits,) = struct.unpack("<Q", struct.pack("<d", value))
        return CValue(kind, f"0x{bits:016X}", known=value)
    return CValue(kind, str(int(number)), known=int(number))


def _single(value: float) -> float:
    try:
        return float(struct.unpack("<f", struct.pack("<f", value))[0])
    except OverflowError:
        return float("inf") if value > 0 else -float("inf")


def listed(kind: CType, values: Sequence[CValue]) -> str:
    """Return constants of a type as the array that IR has."""
    return f"[{', '.join(f'{ir_type(kind)} {x.text}' for x in values)}]"


def bytes_of(word: str) -> bytes:
    """Return the bytes of a string literal, with its zero."""
    return word[1:-1].encode().decode("unicode_escape").encode("latin-1") + b"\0"
