"""Discontinuities of formulas: the expressions at whose sign changes their values or slopes jump.

A method of high order evaluates a step at a few points and misses a jump between them, so steps must end at
discontinuities. Those that depend on time alone occur at times known beforehand (breakpoints); the others are event
functions.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from robodyn_cli.expr.calculus import jacobian
from robodyn_cli.expr.graph import Expr, Scalar, free_symbols, reachable
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.spatial.algebra import Array

GRID = 65_537  # times at which the sign of a switch that is not linear in time is examined


def switches(outputs: Iterable[Scalar]) -> list[Expr]:
    """Return the expressions at whose sign changes the outputs are not smooth, each once."""
    by_index: dict[int, Expr] = {}
    for node in reachable(outputs):
        value: Scalar | None = None
        if node.op in ("abs", "sign", "where"):
            value = node.args[0]
        elif node.op in ("min", "max"):
            a, b = (e.value if e.op == "const" else e for e in node.args)
            value = a - b
        while isinstance(value, Expr) and value.op == "neg":
            value = value.args[0]
        if isinstance(value, Expr) and value.op != "const":
            by_index[value.index] = value
    return list(by_index.values())


def is_of_time(switch: Expr, t: Expr) -> bool:
    """Tell whether a switch depends on time alone."""
    return all(symbol is t for symbol in free_symbols([switch]))


def switching_times(switch: Expr, t: Expr, duration: float) -> list[float]:
    """Return the times from 0 to duration at which an expression of time changes its sign or touches zero."""

    def values(times: Array) -> Array:
        with np.errstate(all="ignore"):
            y: Array = np.broadcast_to(evaluate([switch], {"t": [times]})[0], times.shape)
        return y

    slope = jacobian([switch], [t])[0].get(0, 0.0)
    if not isinstance(slope, Expr):
        root = -float(values(np.zeros(1))[0]) / slope if slope != 0.0 else -1.0
        return [root] if 0.0 <= root <= duration else []
    times = np.linspace(0.0, duration, GRID)
    side = np.sign(values(times))
    roots = set(times[side == 0.0].tolist())
    (crossing,) = np.nonzero(side[:-1] * side[1:] < 0.0)
    low, high = times[crossing], times[crossing + 1]
    while True:
        middle = 0.5 * (low + high)
        inside = (low < middle) & (middle < high)
        if not inside.any():
            break
        before = values(middle) * side[crossing] > 0.0
        low = np.where(inside & before, middle, low)
        high = np.where(inside & ~before, middle, high)
    roots.update(high.tolist())
    return sorted(roots)
