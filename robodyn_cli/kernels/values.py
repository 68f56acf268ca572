"""Values in registers, with operators that write LLVM IR: doubles and their lanes, integers, conditions."""

from __future__ import annotations

import struct
from typing import Protocol, Union

Operand = Union["Value", float]


class Emitter(Protocol):
    """What operators need of the function that they write into."""

    flags: str

    def name(self, text: str) -> str: ...
    def emit(self, text: str, width: int) -> Value: ...
    def emit_int(self, text: str) -> Int: ...
    def lift(self, x: Operand, width: int) -> Value: ...
    def splat(self, x: Value, width: int) -> Value: ...
    def compare_int(self, predicate: str, a: Int | int, b: Int | int) -> Condition: ...


def double_type(width: int) -> str:
    """Return the LLVM type of ``width`` doubles."""
    return "double" if width == 1 else f"<{width} x double>"


def int_type(width: int, bits: int = 64) -> str:
    """Return the LLVM type of ``width`` integers."""
    return f"i{bits}" if width == 1 else f"<{width} x i{bits}>"


def literal(x: float) -> str:
    """Return a double exactly, as LLVM wants it."""
    return "0x" + struct.pack(">d", float(x)).hex().upper()


class Value:
    """A double (or a vector of them) in a register."""

    __slots__ = ("f", "ref", "width")

    def __init__(self, f: Emitter, ref: str, width: int) -> None:
        self.f = f
        self.ref = ref
        self.width = width

    def _op(self, name: str, other: Operand, swap: bool = False) -> Value:
        f = self.f
        x = f.lift(other, self.width)
        y = f.splat(self, x.width) if self.width != x.width else self
        a, b = (x, y) if swap else (y, x)
        return f.emit(f"{name} {f.flags} {double_type(x.width)} {a.ref}, {b.ref}", x.width)

    def __add__(self, other: Operand) -> Value:
        return self._op("fadd", other)

    __radd__ = __add__

    def __sub__(self, other: Operand) -> Value:
        return self._op("fsub", other)

    def __rsub__(self, other: Operand) -> Value:
        return self._op("fsub", other, swap=True)

    def __mul__(self, other: Operand) -> Value:
        return self._op("fmul", other)

    __rmul__ = __mul__

    def __truediv__(self, other: Operand) -> Value:
        return self._op("fdiv", other)

    def __rtruediv__(self, other: Operand) -> Value:
        return self._op("fdiv", other, swap=True)

    def __neg__(self) -> Value:
        return self.f.emit(f"fneg {self.f.flags} {double_type(self.width)} {self.ref}", self.width)


class Int:
    """A 64-bit integer in a register."""

    __slots__ = ("f", "ref")

    def __init__(self, f: Emitter, ref: str) -> None:
        self.f = f
        self.ref = ref

    def _op(self, name: str, other: Int | int) -> Int:
        return self.f.emit_int(f"{name} i64 {self.ref}, {ref_of(other)}")

    def __add__(self, other: Int | int) -> Int:
        return self._op("add", other)

    __radd__ = __add__

    def __sub__(self, other: Int | int) -> Int:
        return self._op("sub", other)

    def __mul__(self, other: Int | int) -> Int:
        return self._op("mul", other)

    __rmul__ = __mul__

    def __and__(self, other: Int | int) -> Int:
        return self._op("and", other)

    def __or__(self, other: Int | int) -> Int:
        return self._op("or", other)


def ref_of(x: Int | int) -> str:
    """Return the operand text of an integer."""
    return x.ref if isinstance(x, Int) else str(int(x))  # before Python 3.11 an IntEnum writes its name


class Condition:
    """An i1, or a vector of them."""

    __slots__ = ("f", "ref", "width")

    def __init__(self, f: Emitter, ref: str, width: int) -> None:
        self.f = f
        self.ref = ref
        self.width = width

    def _op(self, name: str, other: Condition | str) -> Condition:
        right = other.ref if isinstance(other, Condition) else other
        return Condition(
            self.f, self.f.name(f"{name} {int_type(self.width, 1)} {self.ref}, {right}"), self.width
        )

    def __and__(self, other: Condition) -> Condition:
        return self._op("and", other)

    def __or__(self, other: Condition) -> Condition:
        return self._op("or", other)

    def __invert__(self) -> Condition:
        every = "true" if self.width == 1 else "<" + ", ".join(["i1 true"] * self.width) + ">"
        return self._op("xor", every)

    def any(self) -> Condition:
        """Return whether any lane holds."""
        if self.width == 1:
            return self
        return self.f.compare_int("ne", self.mask(), 0)

    def mask(self) -> Int:
        """Return the lanes as the low bits of an integer, lane 0 lowest."""
        if self.width == 1:
            return Int(self.f, self.f.name(f"zext i1 {self.ref} to i64"))
        bits = self.f.name(f"bitcast <{self.width} x i1> {self.ref} to i{self.width}")
        if self.width == 64:
            return Int(self.f, bits)
        return Int(self.f, self.f.name(f"zext i{self.width} {bits} to i64"))
