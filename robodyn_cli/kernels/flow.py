"""Values in registers, with operators that write LLVM IR, and the text of a function under construction, whose control
flow is written as ``with`` blocks.

    with f.when(condition):         with f.loop() as rounds:            with f.block() as search:
        ...                             ...                                 ...
    with f.otherwise():                 rounds.leave(condition)             search.leave(condition)
        ...                             rounds.again()                      ...

Labels and jumps stay in this package. What follows an unconditional ``leave``, ``again`` or ``ret`` in the same block
is never reached.
"""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Iterator
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


class Flow:
    """Lines of a function, and what decides which of them run."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.slots: list[str] = []
        self.counter = 0
        self._closed = False  # the last line jumps: what comes next needs a label to be reached
        self._when = (
            -1,
            "",
            False,
        )  # of the last ``when``: lines at its end, its label, whether it jumps there

    # -- lines ----------------------------------------------------------------------------------------
    def fresh(self, prefix: str = "v") -> str:
        self.counter += 1
        return f"{prefix}{self.counter}"

    def raw(self, text: str) -> None:
        if self._closed:
            self.place(self.label("unreached"))
        self.lines.append("  " + text)

    def name(self, text: str) -> str:
        """Emit an instruction and return the register that holds its result."""
        ref = "%" + self.fresh()
        self.raw(f"{ref} = {text}")
        return ref

    @contextlib.contextmanager
    def entry(self) -> Iterator[None]:
        """Emit at the start of the function, for addresses that all of it uses."""
        before, closed = self.lines, self._closed
        self.lines, self._closed = self.slots, False
        try:
            yield
        finally:
            self.lines, self._closed = before, closed

    # -- labels and jumps, for this package only ------------------------------------------------------
    def label(self, hint: str) -> str:
        return self.fresh(hint + ".")

    def place(self, label: str) -> None:
        self.lines.append(f"{label}:")
        self._closed = False

    def jump(self, label: str) -> None:
        if not self._closed:
            self.raw(f"br label %{label}")
            self._closed = True

    def branch(self, condition: Condition, yes: str, no: str) -> None:
        self.raw(f"br i1 {condition.ref}, label %{yes}, label %{no}")
        self._closed = True

    def ret(self, value: Int | int | None = None) -> None:
        """Return from the function."""
        self.raw("ret void" if value is None else f"ret i64 {ref_of(value)}")
        self._closed = True

    # -- blocks ---------------------------------------------------------------------------------------
    @contextlib.contextmanager
    def when(self, condition: Condition) -> Iterator[None]:
        """Emit the body so that it runs only if the condition holds."""
        yes, after = self.label("then"), self.label("after")
        self.branch(condition, yes, after)
        self.place(yes)
        yield
        jumps = not self._closed
        self.jump(after)
        self.place(after)
        self._when = (len(self.lines), after, jumps)

    @contextlib.contextmanager
    def otherwise(self) -> Iterator[None]:
        """Emit the body so that it runs only if the condition of the ``when`` right above does not hold.

        Raises
        ------
        ValueError : there is code in between.
        """
        lines, no, jumps = self._when
        if lines != len(self.lines):
            raise ValueError("'otherwise' has to follow its 'when'")
        after = self.label("after")
        del self.lines[-1 - jumps :]
        self._closed = not jumps
        self.jump(after)
        self.place(no)
        yield
        self.jump(after)
        self.place(after)

    @contextlib.contextmanager
    def block(self) -> Iterator[Block]:
        """Emit a body that can be left early."""
        block = Block(self, self.label("left"))
        yield block
        self.jump(block.end)
        self.place(block.end)

    @contextlib.contextmanager
    def loop(self) -> Iterator[LoopBlock]:
        """Emit a body that runs again and again until it is left."""
        loop = LoopBlock(self, self.label("loop"), self.label("left"))
        self.jump(loop.head)
        self.place(loop.head)
        yield loop
        self.jump(loop.head)
        self.place(loop.end)


class Block:
    """A part of the code that can be left early."""

    def __init__(self, f: Flow, end: str) -> None:
        self.f = f
        self.end = end

    def leave(self, condition: Condition | None = None, *, unless: Condition | None = None) -> None:
        """Go on behind the block: always, if a condition holds, or unless one holds."""
        self._go(self.end, condition, unless)

    def _go(self, label: str, condition: Condition | None, unless: Condition | None) -> None:
        f = self.f
        onward = f.label("onward")
        if condition is not None:
            f.branch(condition, label, onward)
        elif unless is not None:
            f.branch(unless, onward, label)
        else:
            f.jump(label)
            return
        f.place(onward)


class LoopBlock(Block):
    """A body that is repeated until it is left."""

    def __init__(self, f: Flow, head: str, end: str) -> None:
        super().__init__(f, end)
        self.head = head

    def again(self, condition: Condition | None = None) -> None:
        """Start over with the body: always, or if a condition holds."""
        self._go(self.head, condition, None)
