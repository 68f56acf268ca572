"""The tree of a formula: immutable nodes that evaluate on numbers, arrays and graph expressions."""

from __future__ import annotations

import dataclasses
import functools
import math
import operator
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, NoReturn

from robodyn_cli.errors import SceneError, shown
from robodyn_cli.expr import functions as fn
from robodyn_cli.expr.graph import Expr
from robodyn_cli.record import record

if TYPE_CHECKING:
    from robodyn_cli.expr.units import Dims

CONSTANTS: dict[str, float] = {"pi": math.pi, "e": math.e}
MANY = 1000

# name: (function, fewest arguments, most arguments)
FUNCTIONS: dict[str, tuple[Callable[..., Any], int, int]] = {
    **{
        name: (getattr(fn, name), 1, 1)
        for name in (
            "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh",
            "exp", "log", "sqrt", "sign", "step",
        )
    },
    "abs": (fn.absolute, 1, 1),
    "atan2": (fn.atan2, 2, 2),
    "min": (lambda *xs: functools.reduce(fn.minimum, xs), 2, MANY),
    "max": (lambda *xs: functools.reduce(fn.maximum, xs), 2, MANY),
}  # fmt: skip

# functions that jump or bend, each between two neighbours of its arguments
SWITCHING = ("abs", "sign", "step", "min", "max")

_BINARY: dict[str, Callable[[Any, Any], Any]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
}


# what stands before a dot: positions, rates, parameters; reference, states and torques of a controller
QUALIFIERS = ("q", "qd", "p", "ref", "refd", "refdd", "s", "tau")
# what formulas ask of points, as names of their own such as length(tip, base.origin): of how many points, and whether
# it is of positions or of rates
OF_POINTS = {"length": (2, "q"), "length_rate": (2, "qd"), "angle": (3, "q"), "speed": (1, "qd")}
# coordinates and velocities of a point in the world, which are written tip.x and named x(tip)
AXES = {"x": "q", "y": "q", "z": "q", "vx": "qd", "vy": "qd", "vz": "qd"}


NOWHERE: Mapping[str, Any] = {}  # what errors say of the place of what stands in no scene


def fail(text: str, column: int, message: str, where: Mapping[str, Any] = NOWHERE) -> NoReturn:
    """Raise the error of a formula; ``column`` counts from 1 inside the formula. where : its place in the scene."""
    raise SceneError(f"formula {shown(text)}, column {column}: {message}", **where)


class FormulaNode:
    """One node of the tree."""

    __slots__ = ()

    def value(self, env: Mapping[str, Any]) -> Any:
        """Return the node's value with names taken from ``env``."""
        raise NotImplementedError

    def rebuilt(self, leaf: Callable[[FormulaNode], FormulaNode]) -> FormulaNode:
        """Return the node with each name and each number replaced by what ``leaf`` gives, left to right.

        The number of an exponent stays: it decides of what kind a power is.
        """
        raise NotImplementedError


@record
class Num(FormulaNode):
    """A number; unit : of what it was written in, as powers of the bases, None where it was written without one."""

    number: float
    unit: Dims | None = dataclasses.field(default=None, compare=False, repr=False)

    def value(self, env: Mapping[str, Any]) -> Any:
        return self.number

    def rebuilt(self, leaf: Callable[[FormulaNode], FormulaNode]) -> FormulaNode:
        return leaf(self)


@record
class Identifier(FormulaNode):
    name: str

    def value(self, env: Mapping[str, Any]) -> Any:
        return env[self.name]

    def rebuilt(self, leaf: Callable[[FormulaNode], FormulaNode]) -> FormulaNode:
        return leaf(self)


@record
class Negative(FormulaNode):
    operand: FormulaNode

    def value(self, env: Mapping[str, Any]) -> Any:
        return -self.operand.value(env)

    def rebuilt(self, leaf: Callable[[FormulaNode], FormulaNode]) -> FormulaNode:
        return Negative(self.operand.rebuilt(leaf))


@record
class Chain(FormulaNode):
    """Operations of one precedence from left to right; flat, so that a long sum is not a deep tree."""

    first: FormulaNode
    rest: tuple[tuple[str, FormulaNode], ...]

    def value(self, env: Mapping[str, Any]) -> Any:
        result = self.first.value(env)
        for op, node in self.rest:
            result = _BINARY[op](result, node.value(env))
        return result

    def rebuilt(self, leaf: Callable[[FormulaNode], FormulaNode]) -> FormulaNode:
        return Chain(self.first.rebuilt(leaf), tuple((op, node.rebuilt(leaf)) for op, node in self.rest))


@record
class Power(FormulaNode):
    base: FormulaNode
    exponent: FormulaNode

    def value(self, env: Mapping[str, Any]) -> Any:
        return fn.power(self.base.value(env), self.exponent.value(env))

    def rebuilt(self, leaf: Callable[[FormulaNode], FormulaNode]) -> FormulaNode:
        exponent = self.exponent
        return Power(
            self.base.rebuilt(leaf), exponent if isinstance(exponent, Num) else exponent.rebuilt(leaf)
        )


@record
class Call(FormulaNode):
    function: str
    arguments: tuple[FormulaNode, ...]

    def value(self, env: Mapping[str, Any]) -> Any:
        return FUNCTIONS[self.function][0](*[x.value(env) for x in self.arguments])

    def rebuilt(self, leaf: Callable[[FormulaNode], FormulaNode]) -> FormulaNode:
        return Call(self.function, tuple(x.rebuilt(leaf) for x in self.arguments))


@record
class If(FormulaNode):
    """``if(left < right, yes, no)``, or the same with ``<=``, ``>``, ``>=``."""

    comparison: str
    left: FormulaNode
    right: FormulaNode
    yes: FormulaNode
    no: FormulaNode

    def value(self, env: Mapping[str, Any]) -> Any:
        difference = self.left.value(env) - self.right.value(env)
        if self.comparison in ("<", ">="):
            difference = -difference
        # where() asks "> 0"; the inclusive comparisons are the opposites of the strict ones
        yes, no = (self.yes, self.no) if self.comparison in ("<", ">") else (self.no, self.yes)
        if isinstance(difference, (float, int)):
            # only the branch taken: the other may not be defined here, as in if(t > 0, sin(t)/t, 1)
            return yes.value(env) if difference > 0 else no.value(env)
        if isinstance(difference, Expr):
            return fn.where(difference, yes.value(env), no.value(env))
        import numpy as np

        with np.errstate(all="ignore"):  # for the same reason, values of the other branch are discarded
            return fn.where(difference, yes.value(env), no.value(env))

    def rebuilt(self, leaf: Callable[[FormulaNode], FormulaNode]) -> FormulaNode:
        parts = [x.rebuilt(leaf) for x in (self.left, self.right, self.yes, self.no)]
        return If(self.comparison, *parts)
