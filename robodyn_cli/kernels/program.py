"""The instruction list of a kernel, independent of how it is compiled.

A Program is the part of a graph that some outputs need, renumbered from zero, so that equal scenes give equal
programs whatever else was built in the graph. Its digest is the key of the cache of compiled code. Numbers of the scene
are not in it: the code reads them from a table, so scenes that differ in such numbers alone share their code.
"""

from __future__ import annotations

import hashlib
import math
import zlib
from collections.abc import Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.errors import unknown_data
from robodyn_cli.expr.fixed import Fixed
from robodyn_cli.expr.graph import Expr, Scalar, reachable
from robodyn_cli.record import record

PARAMETERS = "p"  # group of inputs that are the same for all samples
TRIGONOMETRIC = frozenset({"sin", "cos"})
NUMBERS = "numbers"  # of the inputs of a program: its table
EXACT = frozenset({"literal", "neg", "abs"})  # how numbers come about that rounding does not put off
OFF = 4.0 * 2.0**-53  # part of a number: what a few operations leave
LEAVES = frozenset({"sym", "const", "number"})


class Instruction(NamedTuple):
    """One operation on earlier instructions.

    value : a constant's value, a symbol's (group, position), or the first of its entries in the table of numbers.
    """

    op: str
    args: tuple[int, ...]
    value: Any = None


@record
class Program:
    """Straight-line code with named outputs.

    outputs : per output array, the instruction of each entry, or a float where it is constant.
    numbers : the table that the code reads, beside the digest.
    """

    instructions: tuple[Instruction, ...]
    outputs: dict[str, tuple[int | float, ...]]
    numbers: tuple[float, ...] = ()

    @cached_property
    def operations(self) -> int:
        """Number of arithmetic operations and function calls."""
        return sum(i.op not in LEAVES for i in self.instructions)

    @cached_property
    def table(self) -> NDArray[np.float64]:
        """The numbers as an array; one entry where there are none, for an address."""
        return np.array(self.numbers or (0.0,), dtype=np.float64)

    @cached_property
    def inputs(self) -> dict[str, int]:
        """Input arrays and one more than the highest position read of each."""
        sizes: dict[str, int] = {}
        for i in self.instructions:
            if i.op == "sym":
                group, position = i.value
                sizes[group] = max(sizes.get(group, 0), position + 1)
        return sizes

    @property
    def sizes(self) -> dict[str, int]:
        """Sizes of the outputs."""
        return {name: len(entries) for name, entries in self.outputs.items()}

    @property
    def has_tables(self) -> bool:
        """Whether values are looked up in tables, whose numbers lanes share."""
        return any(i.op == "table" for i in self.instructions)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the canonical text of the program."""
        # Python writes floats with as many digits as they have
        lines = [*map(tuple.__repr__, self.instructions), repr(self.outputs)]
        return hashlib.sha256("\n".join(lines).encode()).hexdigest()


def make_program(outputs: dict[str, Sequence[Scalar]], known: Sequence[str]) -> Program:
    """Collect what the outputs need into a Program.

    Parameters
    ----------
    outputs : named arrays of expressions or numbers.
    known : symbol groups that the kernel has inputs for.

    Raises
    ------
    SceneError : the outputs depend on something that the scene does not say (an unknown mass or inertia).
    """
    nodes = reachable([e for array in outputs.values() for e in array])
    symbols = [node.value for node in nodes if node.op == "sym"]
    if missing := [name for name, group, _ in symbols if group not in known]:
        raise unknown_data(missing)
    collected = _Collected(nodes)
    entries = {name: tuple(collected.entry(e) for e in array) for name, array in outputs.items()}
    return Program(tuple(collected.instructions), entries, tuple(collected.numbers))


class _Collected:
    """The instructions of a program and its table of numbers, in the order of the nodes."""

    def __init__(self, nodes: Sequence[Expr]) -> None:
        self.instructions: list[Instruction] = []
        self.numbers: list[float] = []
        self._place = [-1] * (1 + nodes[-1].index if nodes else 0)  # instructions by index of the node
        self._read: dict[int, int] = {}  # instructions by identity of the number
        place, add = self._place, self.instructions.append
        for node in nodes:
            op, args = node.op, node.args
            if len(args) == 2:  # most have, and no value
                first, second = args
                given = place[first.index], place[second.index]
                place[node.index] = len(self.instructions)
                add(tuple.__new__(Instruction, (op, given, None)))  # a call of the class takes twice as long
                continue
            value = node.value
            if op == "const" and isinstance(value, Fixed):
                place[node.index] = self._number(value)
                continue
            if op == "sym":
                value = value[1:]
            elif op == "table":
                knots, rows, held = value
                value = (len(self.numbers), len(knots), len(rows) - 1, held is not None)
                self.numbers += [*knots, *(x for row in rows for x in row), *(held or ())]
            place[node.index] = len(self.instructions)
            add(Instruction(op, tuple([place[a.index] for a in args]), value))

    def entry(self, e: Scalar) -> int | float:
        if isinstance(e, Expr):
            return self._place[e.index]
        return self._number(e) if isinstance(e, Fixed) else float(e)

    def _number(self, x: Fixed) -> int:
        if id(x) not in self._read:
            self._read[id(x)] = len(self.instructions)
            self.instructions.append(Instruction("number", (), len(self.numbers)))
            self.numbers.append(x)
        return self._read[id(x)]


def off_by_rounding(x: float, draw: int) -> float:
    """Return 1 + a part between OFF / 4 and 7/4 OFF, of either sign, for a number that was computed.

    It follows from the rank alone, without order. Parts of one size might cancel in a quotient or a product.
    """
    if not (draw and isinstance(x, Fixed)) or x.op in EXACT:
        return 1.0
    number = zlib.crc32(b"%d %d" % (draw, x.rank))
    return 1.0 + math.copysign(OFF * (0.25 + 1.5 * (number % 1021) / 1020), (number >> 16 & 1) - 0.5)
