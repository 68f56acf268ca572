"""Bounds of expressions over intervals of one symbol, many intervals at a time.

Each operation returns bounds of its result over all values of its arguments (Moore 1966, natural extension), and marks
the intervals in which it may not be smooth: a root of what may be zero, a quotient by what may be zero, the cut of
``atan2``. Bounds hold up to rounding, which is enough to find where a function changes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.expr.graph import Expr, Scalar, reachable
from robodyn_cli.expr.rebuild import apply
from robodyn_cli.record import record

Array = NDArray[np.float64]

Flags = NDArray[np.bool_]


@record
class Bounds:
    """Lower and upper bounds (n,), and whether an operation on the way may not be smooth there."""

    low: Array
    high: Array
    rough: Flags


def bounds(output: Scalar, symbol: Expr, low: Array, high: Array) -> Bounds:
    """Return the bounds of an expression of one symbol over the intervals from ``low`` to ``high`` (n,)."""
    none = np.zeros(len(low), dtype=bool)
    if not isinstance(output, Expr):
        return Bounds(np.full(len(low), float(output)), np.full(len(low), float(output)), none)
    known: dict[int, Bounds] = {}
    with np.errstate(all="ignore"):
        for node in reachable([output]):
            if node is symbol:
                bound = Bounds(low, high, none)
            elif node.op == "const":
                bound = Bounds(np.full(len(low), node.value), np.full(len(low), node.value), none)
            else:
                bound = _operation(node, [known[a.index] for a in node.args])
            known[node.index] = bound
    return known[output.index]


def _operation(node: Expr, args: list[Bounds]) -> Bounds:
    """Return the bounds of one operation; infinite where there are none."""
    rough = np.logical_or.reduce([a.rough for a in args])
    if node.op in INCREASING:
        low, high = (np.asarray(apply(node, [x])) for x in (args[0].low, args[0].high))
        touching = args[0].low <= SMOOTH_ABOVE.get(node.op, -np.inf)
        return _checked(low, high, rough | touching)
    if node.op == "mul" and node.args[0] is node.args[1]:
        low, high, own = _even(np.square, corner=False)(args[0])
        return _checked(low, high, rough | own)
    if node.op in OPERATIONS:
        low, high, own = OPERATIONS[node.op](*args)
        return _checked(low, high, rough | own)
    if node.op == "pow":
        return _power(args[0], args[1], rough)
    if node.op == "table":
        return _table(node, args[0], rough)
    unknown = np.full(len(rough), np.inf)
    return Bounds(-unknown, unknown, np.ones(len(rough), dtype=bool))


def _checked(low: Array, high: Array, rough: Flags) -> Bounds:
    """Return bounds that are infinite, and marked as not smooth, where they are undefined."""
    lost = np.isnan(low) | np.isnan(high)
    return Bounds(np.where(lost, -np.inf, low), np.where(lost, np.inf, high), rough | lost)


Parts = tuple[Array, Array, Any]

INCREASING = ("exp", "log", "sqrt", "tanh", "sinh", "atan", "asin")
# smooth inside their range, not at its end
SMOOTH_ABOVE = {"sqrt": 0.0, "log": 0.0, "asin": -1.0}


def _extremes(products: list[Array]) -> tuple[Array, Array]:
    return np.minimum.reduce(products), np.maximum.reduce(products)


def _mul(a: Bounds, b: Bounds) -> Parts:
    # zero times infinity is zero here
    products = [
        np.where((x == 0.0) | (y == 0.0), 0.0, x * y) for x in (a.low, a.high) for y in (b.low, b.high)
    ]
    return (*_extremes(products), False)


def _div(a: Bounds, b: Bounds) -> Parts:
    zero = (b.low <= 0.0) & (b.high >= 0.0)
    low, high = _extremes([x / y for x in (a.low, a.high) for y in (b.low, b.high)])
    return np.where(zero, -np.inf, low), np.where(zero, np.inf, high), zero


def _wave(a: Bounds, shift: float) -> Parts:
    """Bounds of sin(x + shift): extremes at the ends, or 1 and -1 where a crest or trough lies between."""
    x, y = a.low + shift, a.high + shift
    low, high = np.minimum(np.sin(x), np.sin(y)), np.maximum(np.sin(x), np.sin(y))
    turn, quarter = 2.0 * np.pi, 0.5 * np.pi
    crest = np.floor((y - quarter) / turn) > np.floor((x - quarter) / turn)
    trough = np.floor((y + quarter) / turn) > np.floor((x + quarter) / turn)
    whole = ~((y - x) < turn)
    return np.where(trough | whole, -1.0, low), np.where(crest | whole, 1.0, high), False


def _tan(a: Bounds) -> Parts:
    pole = np.floor(a.high / np.pi + 0.5) > np.floor(a.low / np.pi + 0.5)
    pole |= ~np.isfinite(a.high - a.low)
    return np.where(pole, -np.inf, np.tan(a.low)), np.where(pole, np.inf, np.tan(a.high)), pole


def _even(grow: Callable[[Array], Array], corner: bool) -> Callable[[Bounds], Parts]:
    """Bounds of a function that grows with |x|; ``corner``: its slope jumps at zero."""

    def parts(a: Bounds) -> Parts:
        inside = (a.low <= 0.0) & (a.high >= 0.0)
        low, high = grow(np.abs(a.low)), grow(np.abs(a.high))
        least = np.where(inside, grow(np.zeros(1))[0], np.minimum(low, high))
        return least, np.maximum(low, high), inside & corner

    return parts


def _atan2(y: Bounds, x: Bounds) -> Parts:
    # across the cut (x < 0, y = 0), and at the origin, any angle may come out
    cut = (x.low <= 0.0) & (y.low <= 0.0) & (y.high >= 0.0)
    low, high = _extremes([np.arctan2(v, u) for v in (y.low, y.high) for u in (x.low, x.high)])
    return np.where(cut, -np.pi, low), np.where(cut, np.pi, high), cut


def _sign(a: Bounds) -> Parts:
    return np.sign(a.low), np.sign(a.high), (a.low <= 0.0) & (a.high >= 0.0)


def _select(x: Bounds, a: Bounds, b: Bounds) -> Parts:
    first, second = x.low > 0.0, x.high <= 0.0
    low = np.where(first, a.low, np.where(second, b.low, np.minimum(a.low, b.low)))
    high = np.where(first, a.high, np.where(second, b.high, np.maximum(a.high, b.high)))
    return low, high, ~first & ~second


def _acos(a: Bounds) -> Parts:
    return np.arccos(a.high), np.arccos(a.low), (a.low <= -1.0) | (a.high >= 1.0)


def _meeting(a: Bounds, b: Bounds) -> Flags:
    return (a.low <= b.high) & (b.low <= a.high)


OPERATIONS: dict[str, Callable[..., Parts]] = {
    "add": lambda a, b: (a.low + b.low, a.high + b.high, False),
    "sub": lambda a, b: (a.low - b.high, a.high - b.low, False),
    "neg": lambda a: (-a.high, -a.low, False),
    "mul": _mul,
    "div": _div,
    "sin": lambda a: _wave(a, 0.0),
    "cos": lambda a: _wave(a, 0.5 * np.pi),
    "tan": _tan,
    "cosh": _even(np.cosh, corner=False),
    "abs": _even(np.abs, corner=True),
    "acos": _acos,
    "sign": _sign,
    "atan2": _atan2,
    "min": lambda a, b: (np.minimum(a.low, b.low), np.minimum(a.high, b.high), _meeting(a, b)),
    "max": lambda a, b: (np.maximum(a.low, b.low), np.maximum(a.high, b.high), _meeting(a, b)),
    "where": _select,
}


def _power(a: Bounds, b: Bounds, rough: Flags) -> Bounds:
    fixed = np.all(b.low == b.high) and len(b.low)
    exponent = float(b.low[0]) if fixed else np.nan
    if fixed and exponent == round(exponent):
        inside = (a.low <= 0.0) & (a.high >= 0.0)
        low, high = _extremes([a.low**exponent, a.high**exponent])
        if exponent < 0.0:
            return _checked(np.where(inside, -np.inf, low), np.where(inside, np.inf, high), rough | inside)
        return _checked(np.where(inside & (exponent % 2 == 0), 0.0, low), high, rough)
    # x^y = exp(y log x) for x > 0
    low, high = _extremes([x**y for x in (a.low, a.high) for y in (b.low, b.high)])
    return _checked(low, high, rough | (a.low <= 0.0))


def _table(node: Expr, a: Bounds, rough: Flags) -> Bounds:
    """Bounds of a table: those of Horner's scheme in each segment that the interval meets."""
    knots, rows, held = np.asarray(node.value[0], dtype=float), node.value[1], node.value[2]
    low, high = np.full(len(rough), np.inf), np.full(len(rough), -np.inf)

    def include(where: Flags, least: Any, most: Any) -> None:
        low[:] = np.where(where, np.minimum(low, least), low)
        high[:] = np.where(where, np.maximum(high, most), high)

    edges = knots.copy()
    if held is None:
        edges[[0, -1]] = -np.inf, np.inf
    else:
        include(a.low < knots[0], held[0], held[0])
        include(a.high >= knots[-1], held[1], held[1])
    for k in range(len(knots) - 1):
        left, right = np.maximum(a.low, edges[k]), np.minimum(a.high, edges[k + 1])
        s = np.stack([left, right]) - knots[k]
        least = most = np.full(len(rough), rows[-1][k], dtype=float)
        for row in reversed(rows[:-1]):
            least, most = _extremes([x * y + row[k] for x in (least, most) for y in s])
        include(left <= right, least, most)
    inside = np.searchsorted(knots, a.high, side="right") > np.searchsorted(knots, a.low)
    return Bounds(low, high, rough | inside)
