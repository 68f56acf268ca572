"""Exact derivatives of expressions, as expressions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.fixed import Fixed
from robodyn_cli.expr.functions import cos, cosh, exp, log, power, sign, sin, sinh, sqrt, where
from robodyn_cli.expr.graph import Expr, Scalar, is_nonzero, reachable
from robodyn_cli.expr.rebuild import apply, piecewise

SparseRow = dict[int, Scalar]
# derivatives of a number of the scene by keys of the scene, by column
NumberSlopes = Callable[[float], SparseRow]


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
    if node.op == "table":
        knots, rows, held = node.value
        slopes = _slopes_of_table(rows)
        if not slopes:
            return []
        a = node.args[0]
        return [(a, node.graph.piecewise(a, knots, slopes, None if held is None else (0.0, 0.0)))]
    return [(node.args[k], partial) for k, partial in rules(node.op, node.args, node)]


def rules(op: str, args: Sequence[Any], result: Any) -> list[tuple[int, Any]]:
    """Return (number of the argument, partial derivative) of an operation, of expressions or of numbers.

    Raises
    ------
    CapabilityError : the operation has no derivative.
    """
    if op in _SLOPES:
        return [(0, _SLOPES[op](args[0], result))]
    # constants as numbers, or they would not be folded
    value: list[Any] = [e.value if isinstance(e, Expr) and e.op == "const" else e for e in args]
    if op == "add":
        return [(0, 1.0), (1, 1.0)]
    if op == "sub":
        return [(0, 1.0), (1, -1.0)]
    if op == "mul":
        return [(0, value[1]), (1, value[0])]
    if op == "div":
        inverse = 1.0 / args[1]
        return [(0, inverse), (1, -(result * inverse))]
    if op == "atan2":
        y, x = value
        r2 = x * x + y * y
        return [(0, x / r2), (1, -(y / r2))]
    if op == "pow":
        return _partials_of_power(result, *value)
    if op in ("sign", "round"):
        return []
    raise CapabilityError(f"the operation {op} has no derivative")


def _slopes_of_table(rows: Sequence[tuple[float, ...]]) -> tuple[tuple[float, ...], ...]:
    """Return the coefficients of the slope of a piecewise polynomial."""
    return tuple(tuple(float(i) * x for x in rows[i]) if i > 1 else rows[i] for i in range(1, len(rows)))


def _partials_of_power(result: Any, base: Any, exponent: Any) -> list[tuple[int, Any]]:
    slopes = []
    if isinstance(base, (Expr, Fixed)):
        slopes.append((0, exponent * power(base, exponent - 1.0)))
    if isinstance(exponent, Expr):
        # 0 ** x is 0 where it is differentiable
        slopes.append((1, result * log(base) if is_nonzero(base) else 0.0))
    return slopes


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


def jacobian(
    outputs: Sequence[Scalar], inputs: Sequence[Expr], slopes: NumberSlopes | None = None
) -> list[SparseRow]:
    """Return d outputs / d inputs as sparse rows {column: entry}; zeros that are structural do not appear.

    Forward mode over the shared graph: each node carries its sparse gradient once.

    Parameters
    ----------
    slopes : as for ``gradients``, in columns behind those of the inputs.
    """
    return gradients(outputs, {x.index: {k: 1.0} for k, x in enumerate(inputs)}, slopes)


def gradients(
    outputs: Sequence[Scalar], seeds: Mapping[int, SparseRow], slopes: NumberSlopes | None = None
) -> list[SparseRow]:
    """Return the sparse gradients of outputs by the chain rule, from those of some nodes (by index).

    Parameters
    ----------
    slopes : gives those of the numbers of the scene that the expressions hold; constants where it is not given.
    """
    gradient: dict[int, SparseRow] = dict(seeds)
    for node in reachable(outputs):
        if node.op == "const" and slopes is not None:
            gradient[node.index] = slopes(node.value)
        if not node.args or node.index in gradient:
            continue
        row = _of_table(node, slopes) if node.op == "table" and slopes is not None else {}
        if not row and not any(gradient.get(a.index) for a in node.args):
            continue
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
    of_number: NumberSlopes = slopes or (lambda x: {})
    return [dict(gradient.get(e.index, {})) if isinstance(e, Expr) else of_number(e) for e in outputs]


def jacobian_at(
    outputs: Sequence[Scalar], inputs: Sequence[Expr], values: Mapping[str, Sequence[float]]
) -> NDArray[np.float64]:
    """Return d outputs / d inputs (m, n) at one point, as numbers: ``jacobian`` without its expressions.

    Parameters
    ----------
    values : of symbols, by group.

    Raises
    ------
    ArithmeticError, ValueError : a node has no value or no derivative there, which another branch may not use.
    """
    value: dict[int, float] = {}
    slope: dict[int, NDArray[np.float64]] = {x.index: row for x, row in zip(inputs, np.eye(len(inputs)))}
    for node in reachable(outputs):
        if not node.args:
            value[node.index] = float(
                values[node.value[1]][node.value[2]] if node.op == "sym" else node.value
            )
            continue
        args = [value[a.index] for a in node.args]
        y = value[node.index] = float(apply(node, args))
        moving = [k for k, a in enumerate(node.args) if a.index in slope]
        terms = [(k, x) for k, x in _partials_at(node, args, y, moving) if x != 0.0] if moving else []
        if terms:
            slope[node.index] = sum(x * slope[node.args[k].index] for k, x in terms)  # type: ignore[assignment]
    none = np.zeros(len(inputs))
    rows = [slope.get(e.index, none) if isinstance(e, Expr) else none for e in outputs]
    return np.array(rows).reshape(len(outputs), len(inputs))


def _partials_at(
    node: Expr, args: Sequence[float], result: float, moving: Sequence[int]
) -> list[tuple[int, float]]:
    """Return (number of the argument, partial derivative) at numbers, for those arguments that are ``moving``."""
    if node.op in ("where", "min", "max"):
        first = node.op == "where"
        taken = 1 if first and args[0] > 0.0 else 2 if first else int(args.index(result))
        return [(taken, 1.0)] if taken in moving else []
    if node.op == "pow":
        base, exponent = args
        return [(k, exponent * power(base, exponent - 1.0) if k == 0 else result * log(base)) for k in moving]
    if node.op == "table":
        knots, rows, held = node.value
        slopes = _slopes_of_table(rows)
        return [(0, piecewise(args[0], (knots, slopes, held and (0.0, 0.0))))] if slopes else []
    return [(k, float(x)) for k, x in rules(node.op, args, result) if k in moving]


def _of_table(node: Expr, slopes: NumberSlopes) -> SparseRow:
    """Return the derivatives of a piecewise polynomial by the keys that its knots and coefficients follow from.

    d/dc sum_i c_i (x - k)^i = sum_i dc_i (x - k)^i - p'(x) dk, segment by segment.
    """
    knots, rows, held = node.value
    of_knots, of_rows = [slopes(x) for x in knots], [[slopes(x) for x in row] for row in rows]
    of_held = None if held is None else [slopes(x) for x in held]
    columns = {k for each in (of_knots, *of_rows, of_held or []) for row in each for k in row}
    rates = _slopes_of_table(rows)
    entries: SparseRow = {}
    for k in columns:
        changed = [
            tuple(
                own.get(k, 0.0) - (rates[i][s] * of_knots[s].get(k, 0.0) if i < len(rates) else 0.0)
                for s, own in enumerate(row)
            )
            for i, row in enumerate(of_rows)
        ]
        ends = None if of_held is None else (of_held[0].get(k, 0.0), of_held[1].get(k, 0.0))
        entries[k] = node.graph.piecewise(node.args[0], knots, tuple(changed), ends)  # type: ignore[arg-type]
    return entries


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
