"""Exact derivatives of expressions, as expressions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.functions import cos, cosh, exp, log, power, sign, sin, sinh, sqrt, where
from robodyn_cli.expr.graph import Expr, Scalar, is_nonzero, reachable
from robodyn_cli.expr.rebuild import apply

SparseRow = dict[int, Scalar]


# derivative of a function of one argument a, from a and the function's own node y
_SLOPES: dict[str, Callable[[Expr, Expr], Scalar]] = {
    "neg": lambda a, y: -1.0,
    "sin": lambda a, y: cos(a),
    "cos": lambda a, y: -sin(a),
    "tan": lambda a, y: 1.0 + y * y,
    "asin": lambda a, y: 1.0 / sqrt(1.0 - a * a),
    "acos": lambda a, y: -1.0 / sqrt(1.0 - a * a),
    "atan": lambda a, y: 1.0 / (1.0 + a * a),
    "sinh": lambda a, y: cosh(a),
    "cosh": lambda a, y: sinh(a),
    "tanh": lambda a, y: 1.0 - y * y,
    "exp": lambda a, y: exp(a),
    "log": lambda a, y: 1.0 / a,
    "sqrt": lambda a, y: 0.5 / y,
    "abs": lambda a, y: sign(a),
}


def partials(node: Expr) -> list[tuple[Expr, Scalar]]:
    """Return (argument, d node / d argument) for each argument on which the node depends smoothly.

    Where a function switches (abs, sign, knots of a table) the derivative is that of one side.

    Raises
    ------
    CapabilityError : the operation has no derivative.
    """
    op, args = node.op, node.args
    a = args[0]
    if op in _SLOPES:
        return [(a, _SLOPES[op](a, node))]
    # constants as numbers, or they would not be folded
    value: list[Any] = [e.value if e.op == "const" else e for e in args]
    if op == "add":
        return [(a, 1.0), (args[1], 1.0)]
    if op == "sub":
        return [(a, 1.0), (args[1], -1.0)]
    if op == "mul":
        return [(a, value[1]), (args[1], value[0])]
    if op == "div":
        inverse = 1.0 / args[1]
        return [(a, inverse), (args[1], -(node * inverse))]
    if op == "atan2":
        y, x = value
        r2 = x * x + y * y
        return [(a, x / r2), (args[1], -(y / r2))]
    if op == "pow":
        return _partials_of_power(node, *value)
    if op == "table":
        knots, rows, held = node.value
        slopes = tuple(
            tuple(float(i) * x for x in rows[i]) if i > 1 else rows[i] for i in range(1, len(rows))
        )
        if not slopes:
            return []
        return [(a, node.graph.piecewise(a, knots, slopes, None if held is None else (0.0, 0.0)))]
    if op == "sign":
        return []
    raise CapabilityError(f"the operation {op} has no derivative")


def _partials_of_power(node: Expr, base: Any, exponent: Any) -> list[tuple[Expr, Scalar]]:
    found = [(node.args[0], exponent * power(base, exponent - 1.0))] if isinstance(base, Expr) else []
    if isinstance(exponent, Expr):
        # 0 ** x is 0 where it is differentiable
        found.append((node.args[1], node * log(base) if is_nonzero(base) else 0.0))
    return found


def branches(node: Expr) -> tuple[Scalar, Expr, Expr] | None:
    """Return (x, a, b) of a node that is a where x > 0 and b elsewhere, None for any other.

    Its derivative is that of the branch taken. A sum of both derivatives weighted with 0 and 1 would be wrong where
    the other branch's derivative is infinite.
    """
    if node.op == "where":
        return node.args[0], node.args[1], node.args[2]
    if node.op in ("min", "max"):
        a, b = node.args
        x, y = (e.value if e.op == "const" else e for e in node.args)
        return (y - x if node.op == "min" else x - y), a, b
    return None


def jacobian(outputs: Sequence[Scalar], inputs: Sequence[Expr]) -> list[SparseRow]:
    """Return d outputs / d inputs as sparse rows {column: entry}; zeros that are structural do not appear.

    Forward mode over the shared graph: each node carries its sparse gradient once.
    """
    return gradients(outputs, {x.index: {k: 1.0} for k, x in enumerate(inputs)})


def gradients(outputs: Sequence[Scalar], seeds: Mapping[int, SparseRow]) -> list[SparseRow]:
    """Return the sparse gradients of outputs by the chain rule, from those of some nodes (by index)."""
    gradient: dict[int, SparseRow] = dict(seeds)
    for node in reachable(outputs):
        if not node.args or node.index in gradient:
            continue
        arguments = [a for a in node.args if gradient.get(a.index)]
        if not arguments:
            continue
        row: SparseRow = {}
        split = branches(node)
        if split is not None:
            x, a, b = split
            of_a, of_b = gradient.get(a.index, {}), gradient.get(b.index, {})
            row = {k: where(x, of_a.get(k, 0.0), of_b.get(k, 0.0)) for k in {**of_a, **of_b}}
        for argument, partial in partials(node) if split is None else ():
            inner = gradient.get(argument.index)
            if not inner:
                continue
            for column, entry in inner.items():
                term = partial * entry
                row[column] = row[column] + term if column in row else term
        gradient[node.index] = {k: e for k, e in row.items() if is_nonzero(e)}
    return [dict(gradient.get(e.index, {})) if isinstance(e, Expr) else {} for e in outputs]


def directional(
    outputs: Sequence[Scalar], inputs: Sequence[Expr], direction: Sequence[Scalar]
) -> list[Scalar]:
    """Return (d outputs / d inputs) times ``direction``."""
    tangent: dict[int, Scalar] = {x.index: d for x, d in zip(inputs, direction)}
    for node in reachable(outputs):
        if not node.args or node.index in tangent:
            continue
        if not any(a.index in tangent for a in node.args):
            continue
        total: Scalar = 0.0
        split = branches(node)
        if split is not None:
            x, a, b = split
            total = where(x, tangent.get(a.index, 0.0), tangent.get(b.index, 0.0))
        for argument, partial in partials(node) if split is None else ():
            if argument.index in tangent:
                total = total + partial * tangent[argument.index]
        tangent[node.index] = total
    return [tangent.get(e.index, 0.0) if isinstance(e, Expr) else 0.0 for e in outputs]


def substitute(outputs: Sequence[Scalar], replacement: dict[int, Scalar]) -> list[Scalar]:
    """Return the outputs with nodes (by index) replaced, rebuilt and folded again."""
    new: dict[int, Scalar] = dict(replacement)
    for node in reachable(outputs):
        if node.index in new:
            continue
        if not node.args:
            new[node.index] = node if node.op == "sym" else node.value
        else:
            new[node.index] = apply(node, [new[a.index] for a in node.args])
    return [new[e.index] if isinstance(e, Expr) else e for e in outputs]
