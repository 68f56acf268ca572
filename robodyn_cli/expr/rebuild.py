"""Apply the operations of nodes to new arguments: numbers, arrays or expressions."""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.expr import functions as f
from robodyn_cli.expr.graph import Expr, Graph, Scalar, reachable


def piecewise(x: Any, value: tuple[Any, ...]) -> Any:
    """Return a piecewise polynomial (knots, rows, held) of x, an expression or numbers; see ``Graph.piecewise``."""
    knots, rows, held = value
    if isinstance(x, Expr):
        return x.graph.piecewise(x, knots, rows, held)
    place = np.clip(np.searchsorted(knots, x, side="right") - 1, 0, len(knots) - 2)
    s = x - np.take(knots, place)
    y = np.take(rows[-1], place)
    with np.errstate(invalid="ignore"):  # far beyond the ends, where values are held
        for row in reversed(rows[:-1]):
            y = y * s + np.take(row, place)
    if held is not None:
        y = np.where(x < knots[0], held[0], np.where(x >= knots[-1], held[1], y))
    return y if np.ndim(x) else float(y)


APPLY: dict[str, Callable[..., Any]] = {
    "add": operator.add,
    "sub": operator.sub,
    "mul": operator.mul,
    "div": operator.truediv,
    "neg": operator.neg,
    "pow": f.power,
    "sin": f.sin,
    "cos": f.cos,
    "tan": f.tan,
    "asin": f.asin,
    "acos": f.acos,
    "atan": f.atan,
    "sinh": f.sinh,
    "cosh": f.cosh,
    "tanh": f.tanh,
    "exp": f.exp,
    "log": f.log,
    "sqrt": f.sqrt,
    "abs": f.absolute,
    "sign": f.sign,
    "round": f.nearest,
    "atan2": f.atan2,
    "min": f.minimum,
    "max": f.maximum,
    "where": f.where,
}


def apply(node: Expr, args: Sequence[Any]) -> Any:
    """Return the operation of ``node`` on ``args``."""
    if node.op == "table":
        return piecewise(args[0], node.value)
    return APPLY[node.op](*args)


def _operation(node: Expr) -> Callable[..., Any]:
    """Return the operation of a node as a function of two arguments, of which one may be idle, or of three."""
    if node.op == "table":
        return lambda x, _, table=node.value: piecewise(x, table)
    function = APPLY[node.op]
    return (lambda x, _: function(x)) if len(node.args) == 1 else function


class Evaluator:
    """Expressions to be evaluated on numbers many times; their order of evaluation is settled once.

    Values stand in a list in that order, so that an operation costs little more than its call.
    """

    def __init__(self, outputs: Sequence[Scalar]) -> None:
        nodes = reachable(outputs)
        place = {node.index: k for k, node in enumerate(nodes)}
        self._before: list[Any] = [float(node.value) if node.op == "const" else None for node in nodes]
        self._constants = [k for k, node in enumerate(nodes) if node.op == "const"]
        self._symbols = [(k, *node.value[1:]) for k, node in enumerate(nodes) if node.op == "sym"]
        self._steps: list[tuple[int, Callable[..., Any], int, int, int | None]] = []
        for k, node in enumerate(nodes):
            if node.args:
                a = [place[arg.index] for arg in node.args]
                self._steps.append(
                    (k, _operation(node), a[0], a[min(1, len(a) - 1)], a[2] if len(a) > 2 else None)
                )
        self.operations = len(self._steps)
        self._fixed: list[Any] = [None if isinstance(e, Expr) else float(e) for e in outputs]
        self._moving = [(k, place[e.index]) for k, e in enumerate(outputs) if isinstance(e, Expr)]

    def __call__(self, inputs: Mapping[str, Any]) -> list[Any]:
        """Return the values of the outputs; see ``evaluate``."""
        try:
            return self._evaluate(inputs, lambda x: x)
        except (ArithmeticError, ValueError):
            # plain numbers raise where arrays have an infinity or no value, which another branch may not use
            with np.errstate(all="ignore"):
                arrays = self._evaluate(inputs, np.atleast_1d)
            return [float(x[0]) if isinstance(x, np.ndarray) else x for x in arrays]

    def _evaluate(self, inputs: Mapping[str, Any], taken: Callable[[Any], Any]) -> list[Any]:
        value = self._before.copy()
        for k in self._constants:
            value[k] = taken(value[k])
        for k, group, position in self._symbols:
            value[k] = taken(inputs[group][position])
        for k, operation, a, b, c in self._steps:
            value[k] = operation(value[a], value[b]) if c is None else operation(value[a], value[b], value[c])
        out = self._fixed.copy()
        for k, there in self._moving:
            out[k] = value[there]
        return out


class Values:
    """Values of expressions at one point, each node evaluated once however many calls ask for it.

    Parameters
    ----------
    inputs : a number for each position by symbol group. A symbol of another group, and all that depends on it, has the
    value None.
    """

    def __init__(self, inputs: Mapping[str, Sequence[float]]) -> None:
        self._inputs = inputs
        self._value: dict[int, float | None] = {}

    def of(self, outputs: Sequence[Scalar]) -> list[float | None]:
        """Return the values of expressions of one graph, infinity or NaN where there is none."""
        with np.errstate(all="ignore"):
            return [self._of(e) if isinstance(e, Expr) else float(e) for e in outputs]

    def _of(self, e: Expr) -> float | None:
        value, stack = self._value, [e]
        while stack:
            node = stack[-1]
            if node.index not in value:
                waiting = [a for a in node.args if a.index not in value]
                if waiting:
                    stack += waiting
                    continue
                value[node.index] = self._result(node)
            stack.pop()
        return value[e.index]

    def _result(self, node: Expr) -> float | None:
        """Return the value of a node whose arguments have theirs."""
        if node.op == "sym":
            _, group, position = node.value
            return float(self._inputs[group][position]) if group in self._inputs else None
        if node.op == "const":
            return float(node.value)
        known = [self._value[a.index] for a in node.args]
        args = [x for x in known if x is not None]
        if len(args) < len(known):
            return None
        try:
            return float(apply(node, args))
        except (ArithmeticError, ValueError):  # plain numbers raise where arrays have an infinity or no value
            return float(apply(node, [np.atleast_1d(x) for x in args])[0])


def renamed(outputs: Sequence[Scalar], inputs: Mapping[str, Mapping[int, Scalar]]) -> list[Scalar]:
    """Return the outputs with expressions in the place of symbols, which may live in another graph.

    inputs : what replaces symbols, by group and position; others stay as they are.
    """
    new: dict[int, Scalar] = {}
    for node in reachable(outputs):
        if node.op == "sym":
            _, group, position = node.value
            new[node.index] = inputs.get(group, {}).get(position, node)
        elif node.op == "const":
            new[node.index] = node.value
        else:
            new[node.index] = apply(node, [new[a.index] for a in node.args])
    return [new[e.index] if isinstance(e, Expr) else e for e in outputs]


def moved(outputs: Sequence[Scalar], place: Callable[[str, int], tuple[str, int]]) -> list[Scalar]:
    """Return the outputs in a graph of their own, with their symbols at other places of the inputs.

    place : group and position of a symbol there, from those here; different ones for different symbols, so that
    nothing else changes.
    """
    graph, nodes = Graph(), reachable(outputs)
    new: dict[int, Scalar] = {
        node.index: graph.symbol(node.value[0], *place(*node.value[1:])) for node in nodes if node.op == "sym"
    }
    for node in nodes:
        if node.op == "const":
            new[node.index] = node.value
        elif node.op != "sym":
            new[node.index] = graph.like(node, [new[a.index] for a in node.args])
    return [new[e.index] if isinstance(e, Expr) else e for e in outputs]


def evaluate(outputs: Sequence[Scalar], inputs: Mapping[str, Any]) -> list[Any]:
    """Evaluate the outputs on numbers; the slow, compiler-free path and the oracle of the compiled one.

    Where there is no value the result is an infinity or NaN, as it is in compiled code.

    Parameters
    ----------
    outputs : expressions or numbers.
    inputs : arrays by symbol group; entry ``position`` of a group is its symbol's value (a float, or an array
        of samples; any numpy number type, ``longdouble`` included).
    """
    return Evaluator(outputs)(inputs)


class Interpreter:
    """Expressions as a sequence of numpy operations that drops each result after its last use.

    So the live arrays stay in the cache, which is three times as fast as keeping all.
    """

    def __init__(self, outputs: Sequence[Scalar]) -> None:
        self.outputs = [e if isinstance(e, Expr) else float(e) for e in outputs]
        kept = {e.index for e in self.outputs if isinstance(e, Expr)}
        seen: set[int] = set()
        self.steps: list[tuple[Expr, tuple[int, ...]]] = []
        for node in reversed(reachable(self.outputs)):
            last = {a.index for a in node.args} - seen - kept
            seen |= last
            self.steps.append((node, tuple(last)))
        self.steps.reverse()

    def __call__(self, inputs: Mapping[str, NDArray[Any]]) -> list[Any]:
        """Return the outputs from inputs by group; entry ``position`` of a group is a row of samples."""
        value: dict[int, Any] = {}
        for node, done in self.steps:
            if node.op == "sym":
                _, group, position = node.value
                value[node.index] = inputs[group][position]
            elif node.op == "const":
                # a plain number: arithmetic of a ``Fixed`` takes four times as long
                value[node.index] = float(node.value)
            else:
                value[node.index] = apply(node, [value[a.index] for a in node.args])
            for index in done:
                del value[index]
        return [value[e.index] if isinstance(e, Expr) else e for e in self.outputs]


def numbers(entries: Any, inputs: Mapping[str, Any]) -> NDArray[np.float64]:
    """Return the values of an array or list of expressions as numbers in its shape; ``inputs`` as for ``evaluate``."""
    array = np.asarray(entries, dtype=object)
    flat = np.array(evaluate(list(array.ravel()), inputs), dtype=float)
    return flat.reshape(array.shape)
