"""Write LLVM IR as if it were arithmetic: values with operators; control flow as ``with`` blocks (``flow``).

A ``Function`` collects the text of one function. Loop state lives in stack slots in the entry block, which LLVM
turns into registers. Vectors of doubles are lanes: ``width`` 1 is a plain double.

``flags`` are the fast-math flags of ordinary arithmetic. Right-hand sides may use ``RELAXED``: it lets LLVM
reorder sums but keeps NaN and infinities honest. Argument reduction, error estimates and anything that relies on
the exact order of operations is emitted inside ``strict()``.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.kernels.flow import (
    Block,
    Condition,
    Flow,
    Int,
    LoopBlock,
    Operand,
    Value,
    double_type,
    int_type,
    literal,
    ref_of,
)

RELAXED = "reassoc nsz arcp contract"
STRICT = ""
# Columns of samples lie far apart, so the processor does not prefetch many of them by itself. Prefetching the samples
# of a later block pays where they do not fit into the cache (measured on a busy machine: 30 joints, 10 000 samples,
# 0.18 us per sample instead of 0.6; derivatives of forward dynamics of 7 joints 0.34 us instead of 0.9; one block ahead
# is too late).
BLOCKS_AHEAD = 4

__all__ = [
    "BLOCKS_AHEAD",
    "RELAXED",
    "STRICT",
    "Block",
    "Condition",
    "Function",
    "Int",
    "LoopBlock",
    "Operand",
    "Value",
    "double_type",
    "int_type",
    "literal",
    "module",
    "ref_of",
]


class Function(Flow):
    """The text of one function under construction."""

    def __init__(
        self,
        name: str,
        arguments: Sequence[str],
        *,
        result: str = "void",
        internal: bool = False,
        attributes: str = "",
        flags: str = RELAXED,
    ) -> None:
        super().__init__()
        self.title = name
        self.arguments = list(arguments)
        self.result = result
        self.internal = internal
        self.attributes = attributes
        self.flags = flags
        self.declarations: set[str] = set()
        self.globals: list[str] = []

    # -- plumbing -------------------------------------------------------------------------------------
    def emit(self, text: str, width: int) -> Value:
        return Value(self, self.name(text), width)

    def emit_int(self, text: str) -> Int:
        return Int(self, self.name(text))

    def text(self) -> str:
        """Return the definition."""
        kind = "internal " if self.internal else ""
        head = f"define {kind}{self.result} @{self.title}({', '.join(self.arguments)}) {self.attributes} {{\nentry:\n"
        return head + "\n".join(self.slots + self.lines) + "\n}\n"

    @contextlib.contextmanager
    def arithmetic(self, flags: str) -> Iterator[None]:
        """Emit with other fast-math flags for a while."""
        before, self.flags = self.flags, flags
        try:
            yield
        finally:
            self.flags = before

    def strict(self) -> contextlib.AbstractContextManager[None]:
        """Emit exactly what is written, in that order."""
        return self.arithmetic(STRICT)

    # -- values ---------------------------------------------------------------------------------------
    def constant(self, x: float | Sequence[float], width: int = 1) -> Value:
        """Return a constant: one number in every lane, or a number for each lane."""
        if isinstance(x, (int, float)):
            if width == 1:
                return Value(self, literal(x), 1)
            return Value(self, "<" + ", ".join([f"double {literal(x)}"] * width) + ">", width)
        if len(x) == 1:
            return Value(self, literal(x[0]), 1)
        return Value(self, "<" + ", ".join(f"double {literal(c)}" for c in x) + ">", len(x))

    def integer(self, n: int) -> Int:
        """Return a constant integer."""
        return Int(self, str(n))

    def lift(self, x: Operand, width: int) -> Value:
        """Return ``x`` as a value of at least ``width`` lanes."""
        if isinstance(x, Value):
            return x if x.width >= width else self.splat(x, width)
        return self.constant(x, width)

    def argument(self, name: str) -> Value:
        return Value(self, f"%{name}", 1)

    def int_argument(self, name: str) -> Int:
        return Int(self, f"%{name}")

    def splat(self, x: Value, width: int) -> Value:
        """Return a scalar in every lane."""
        if x.width == width:
            return x
        one = self.name(f"insertelement {double_type(width)} poison, double {x.ref}, i32 0")
        zero = f"<{width} x i32> zeroinitializer"
        return self.emit(
            f"shufflevector {double_type(width)} {one}, {double_type(width)} poison, {zero}", width
        )

    def shuffle(self, a: Value, b: Value, picks: Sequence[int]) -> Value:
        """Return lanes of two vectors of one width, those of the second numbered from there on."""
        t = double_type(a.width)
        order = ", ".join(f"i32 {k}" for k in picks)
        return self.emit(
            f"shufflevector {t} {a.ref}, {t} {b.ref}, <{len(picks)} x i32> <{order}>", len(picks)
        )

    def lane(self, x: Value, k: int) -> Value:
        """Return lane k as a scalar."""
        return x if x.width == 1 else self.emit(f"extractelement {double_type(x.width)} {x.ref}, i32 {k}", 1)

    def broadcast(self, x: Value, k: int) -> Value:
        """Return lane k in every lane."""
        if x.width == 1:
            return x
        return self.shuffle(x, x, [k] * x.width)

    def pack(self, xs: Sequence[Value], width: int) -> Value:
        """Return scalars as the lanes of a vector; lanes beyond them repeat the last."""
        if width == 1:
            return xs[0]
        ref = "poison"
        for k in range(width):
            x = xs[min(k, len(xs) - 1)]
            ref = self.name(f"insertelement {double_type(width)} {ref}, double {x.ref}, i32 {k}")
        return Value(self, ref, width)

    def intrinsic(self, name: str, args: Sequence[Operand], flags: str = "") -> Value:
        """Call an LLVM intrinsic of doubles, lane by lane."""
        width = max(x.width for x in args if isinstance(x, Value))
        values = [self.lift(x, width) for x in args]
        full = f"llvm.{name}." + ("f64" if width == 1 else f"v{width}f64")
        t = double_type(width)
        self.declarations.add(f"declare {t} @{full}({', '.join([t] * len(args))})")
        return self.emit(f"call {flags} {t} @{full}({', '.join(f'{t} {v.ref}' for v in values)})", width)

    def fma(self, a: Operand, b: Operand, c: Operand) -> Value:
        """Return a * b + c, rounded once."""
        return self.intrinsic("fma", [a, b, c])

    def muladd(self, a: Operand, b: Operand, c: Operand) -> Value:
        """Return a * b + c, fused where the machine can."""
        return self.intrinsic("fmuladd", [a, b, c])

    def abs(self, a: Value) -> Value:
        return self.intrinsic("fabs", [a])

    def sqrt(self, a: Value) -> Value:
        return self.intrinsic("sqrt", [a])

    def max(self, a: Operand, b: Operand) -> Value:
        """Return the larger; NaN if either is NaN (so that a diverging run is seen).

        Zeros pass as equal whatever their sign: telling them apart would take four times as long.
        """
        return self.intrinsic("maximum", [a, b], "nsz")

    def min(self, a: Operand, b: Operand) -> Value:
        """Return the smaller; NaN if either is NaN."""
        return self.intrinsic("minimum", [a, b], "nsz")

    def reduce(self, kind: str, a: Value) -> Value:
        """Combine the lanes: ``add`` or ``maximum``."""
        if a.width == 1:
            return a
        t = double_type(a.width)
        if kind == "add":
            full = f"llvm.vector.reduce.fadd.v{a.width}f64"
            self.declarations.add(f"declare double @{full}(double, {t})")
            return self.emit(f"call reassoc double @{full}(double -0.0, {t} {a.ref})", 1)
        full = f"llvm.vector.reduce.f{kind}.v{a.width}f64"
        self.declarations.add(f"declare double @{full}({t})")
        return self.emit(f"call nsz double @{full}({t} {a.ref})", 1)

    # -- comparisons ----------------------------------------------------------------------------------
    def compare(self, predicate: str, a: Operand, b: Operand) -> Condition:
        """Compare: ``olt`` is false and ``ult`` true where an operand is NaN, and so on."""
        width = max(x.width for x in (a, b) if isinstance(x, Value))
        x, y = self.lift(a, width), self.lift(b, width)
        return Condition(self, self.name(f"fcmp {predicate} {double_type(width)} {x.ref}, {y.ref}"), width)

    def compare_int(self, predicate: str, a: Int | int, b: Int | int) -> Condition:
        return Condition(self, self.name(f"icmp {predicate} i64 {ref_of(a)}, {ref_of(b)}"), 1)

    def select(self, condition: Condition, a: Operand, b: Operand) -> Value:
        width = max([condition.width, *(x.width for x in (a, b) if isinstance(x, Value))])
        x, y = self.lift(a, width), self.lift(b, width)
        kind = int_type(condition.width, 1)
        t = double_type(width)
        return self.emit(f"select {kind} {condition.ref}, {t} {x.ref}, {t} {y.ref}", width)

    def select_address(self, condition: Condition, a: str, b: str) -> str:
        return self.name(f"select i1 {condition.ref}, ptr {a}, ptr {b}")

    def select_int(self, condition: Condition, a: Int | int, b: Int | int) -> Int:
        return self.emit_int(f"select i1 {condition.ref}, i64 {ref_of(a)}, i64 {ref_of(b)}")

    def lowest_bit(self, mask: Int) -> Int:
        """Return the number of the lowest set bit of a mask that is not zero."""
        self.declarations.add("declare i64 @llvm.cttz.i64(i64, i1)")
        return self.emit_int(f"call i64 @llvm.cttz.i64(i64 {mask.ref}, i1 true)")

    def to_double(self, n: Int) -> Value:
        return self.emit(f"sitofp i64 {n.ref} to double", 1)

    def to_int(self, x: Value) -> Int:
        """Return the integer part of a value known to be in range."""
        return self.emit_int(f"fptosi double {x.ref} to i64")

    # -- memory ---------------------------------------------------------------------------------------
    def slot(self, width: int = 1, count: int = 1) -> str:
        """Reserve stack space for ``count`` values; returns its address."""
        ref = "%" + self.fresh("slot")
        # an array type, not an array of a type: only then are entries turned into registers early
        kind = double_type(width) if count == 1 else f"[{count} x {double_type(width)}]"
        self.slots.append(f"  {ref} = alloca {kind}, align 64")
        return ref

    def int_slot(self) -> str:
        ref = "%" + self.fresh("slot")
        self.slots.append(f"  {ref} = alloca i64, align 8")
        return ref

    def load(self, address: str, width: int = 1, align: int = 8) -> Value:
        return self.emit(f"load {double_type(width)}, ptr {address}, align {align}", width)

    def store(self, x: Operand, address: str, align: int = 8) -> None:
        v = self.lift(x, 1)
        self.raw(f"store {double_type(v.width)} {v.ref}, ptr {address}, align {align}")

    def load_int(self, address: str) -> Int:
        return self.emit_int(f"load i64, ptr {address}, align 8")

    def store_int(self, n: Int | int, address: str) -> None:
        self.raw(f"store i64 {ref_of(n)}, ptr {address}, align 8")

    def load_index(self, address: str, index: Int | int) -> Int:
        """Load entry ``index`` of an array of 32-bit integers."""
        place = self.name(f"getelementptr i32, ptr {address}, i64 {ref_of(index)}")
        entry = self.name(f"load i32, ptr {place}, align 4")
        return self.emit_int(f"sext i32 {entry} to i64")

    def load_address(self, address: str) -> str:
        """Load an address from memory."""
        return self.name(f"load ptr, ptr {address}, align 8")

    def store_address(self, address: str, place: str) -> None:
        """Store an address in memory."""
        self.raw(f"store ptr {address}, ptr {place}, align 8")

    def offset(self, address: str, index: Int | int) -> str:
        """Return the address ``index`` doubles (or 64-bit integers) further on."""
        if isinstance(index, int) and index == 0:
            return address
        return self.name(f"getelementptr double, ptr {address}, i64 {ref_of(index)}")

    def table(self, name: str, numbers: Iterable[float]) -> str:
        """Keep numbers in the module's memory, under a name of their own, and return their address."""
        entries = [f"double {literal(x)}" for x in numbers]
        kind = f"[{len(entries)} x double]"
        self.globals.append(
            f"@{name} = private unnamed_addr constant {kind} [{', '.join(entries)}], align 64"
        )
        return f"@{name}"

    def integers(self, name: str, numbers: NDArray[np.int32]) -> str:
        """Keep 32-bit integers in the module's memory, under a name of their own, and return their address."""
        text = "\\" + numbers.astype("<i4").tobytes().hex("\\")
        kind = f"[{4 * len(numbers)} x i8]"
        self.globals.append(f'@{name} = private unnamed_addr constant {kind} c"{text}", align 64')
        return f"@{name}"

    def load_argument(self, name: str, kind: str, address: str) -> None:
        """Load a pointer or an integer into a register of that name, as if it were an argument."""
        self.raw(f"%{name} = load {kind}, ptr {address}, align 8")

    def copy(self, target: str, source: str, size: str) -> None:
        """Copy so many bytes; ``size`` : the register that says how many."""
        self.declarations.add("declare void @llvm.memcpy.p0.p0.i64(ptr, ptr, i64, i1)")
        self.raw(f"call void @llvm.memcpy.p0.p0.i64(ptr {target}, ptr {source}, i64 {size}, i1 false)")

    def prefetch(self, address: str, write: bool) -> None:
        """Ask for the memory at an address, which need not exist, before it is read (or written)."""
        self.declarations.add("declare void @llvm.prefetch.p0(ptr, i32, i32, i32)")
        self.raw(f"call void @llvm.prefetch.p0(ptr {address}, i32 {int(write)}, i32 2, i32 1)")

    def call(self, name: str, arguments: Sequence[str]) -> None:
        """Call a function that returns nothing; arguments with their types."""
        self.raw(f"call void @{name}({', '.join(arguments)})")

    def call_int(self, name: str, arguments: Sequence[str]) -> Int:
        """Call a function that returns an integer; arguments with their types."""
        return self.emit_int(f"call i64 @{name}({', '.join(arguments)})")

    def bump(self, address: str, by: int = 1) -> Int:
        """Add to a counter in memory and return its new value."""
        n = self.load_int(address) + by
        self.store_int(n, address)
        return n

    @contextlib.contextmanager
    def count(
        self, n: Int | int, *, start: Int | int = 0, step: int = 1, down: bool = False
    ) -> Iterator[Int]:
        """Emit the body in a loop over start, start+step, ... < n.

        ``down`` counts backwards over the same numbers (step 1 only).
        """
        if down and step != 1:
            raise ValueError("counting down goes by one")
        address = self.int_slot()
        self.store_int(start, address)
        with self.loop() as loop:
            k = self.load_int(address)
            loop.leave(unless=self.compare_int("slt", k, n))
            yield self.emit_int(f"add i64 {ref_of(n)}, {ref_of(start - 1)}") - k if down else k
            self.store_int(k + step, address)

    @contextlib.contextmanager
    def blocks(self, samples: Int, lanes: int) -> Iterator[Int]:
        """Emit the body in a loop over blocks of ``lanes`` samples, not more than there are; gives where each starts.

        The last block is moved back so that it ends with the samples; it repeats a few instead of needing masks.
        """
        with self.count(samples, step=lanes) as start:
            yield self.select_int(self.compare_int("sgt", start + lanes, samples), samples - lanes, start)


def module(functions: Sequence[Function]) -> str:
    """Return the text of a module."""
    declarations = sorted(set().union(*(f.declarations for f in functions)))
    constants = [g for f in functions for g in f.globals]
    return "\n".join([*declarations, *constants, *(f.text() for f in functions)])
