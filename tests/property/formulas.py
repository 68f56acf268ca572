"""Random formulas, and three independent ways to read them: graph, 50 digits, error bound.

A formula is a nested tuple: ("sym", k), ("const", c) or (operation, argument, ...).
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import mpmath as mp
from hypothesis import strategies as st

from robodyn_cli.expr import functions as f
from robodyn_cli.expr.graph import Expr, Graph, reachable

DIGITS = 50
SYMBOLS = 3
KNOTS, VALUES = (-1.0, 0.25, 0.5, 2.0), (0.5, -1.0, 2.0, 1.0)

CONSTANTS = (0.0, 1.0, -1.0, 2.0, -2.0, 0.5, -0.5, 3.0, 0.1, -0.7)
SAFE = {
    # functions with a restricted domain meet an argument that stays inside it
    "sqrt": lambda x: ("add", ("mul", x, x), ("const", 1.0)),
    "log": lambda x: ("add", ("mul", x, x), ("const", 0.5)),
    "exp": lambda x: ("sin", x),
    "sinh": lambda x: ("sin", x),
    "cosh": lambda x: ("sin", x),
    "asin": lambda x: ("mul", ("const", 0.75), ("sin", x)),
    "acos": lambda x: ("mul", ("const", 0.75), ("cos", x)),
    "tan": lambda x: ("sin", x),
}
UNARY = (
    "neg",
    "sin",
    "cos",
    "tan",
    "asin",
    "acos",
    "atan",
    "sinh",
    "cosh",
    "tanh",
    "exp",
    "log",
    "sqrt",
    "abs",
)


def leaves(constants: tuple[float, ...] = CONSTANTS) -> st.SearchStrategy[Any]:
    symbol = st.tuples(st.just("sym"), st.integers(0, SYMBOLS - 1))
    constant = st.tuples(st.just("const"), st.sampled_from(constants))
    return st.one_of(symbol, symbol, constant)


def polynomials() -> st.SearchStrategy[Any]:
    """Sums, differences, products, signs and whole powers of symbols and dyadic constants."""

    def extend(inner: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
        return st.one_of(
            st.tuples(st.sampled_from(("add", "sub", "mul")), inner, inner),
            st.tuples(st.just("neg"), inner),
            st.tuples(st.just("power"), leaves((0.0, 1.0, -1.0, 2.0, 0.5)), st.sampled_from((0, 1, 2, 3, 5))),
            st.tuples(st.just("over"), inner, st.sampled_from((1.0, -1.0, 2.0, 0.25))),
        )

    return st.recursive(leaves((0.0, 1.0, -1.0, 2.0, -2.0, 0.5, 0.25, 4.0)), extend, max_leaves=12)


def formulas() -> st.SearchStrategy[Any]:
    """Formulas over every operation of the graph."""

    def guard(op: str, x: Any) -> Any:
        return (op, SAFE[op](x)) if op in SAFE else (op, x)

    def extend(inner: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
        return st.one_of(
            st.tuples(st.sampled_from(("add", "sub", "mul")), inner, inner),
            st.tuples(st.sampled_from(("add", "sub", "mul", "div", "min", "max", "atan2")), inner, inner),
            st.builds(guard, st.sampled_from(UNARY), inner),
            st.tuples(st.just("sign"), inner),
            st.tuples(st.just("table"), inner),
            st.tuples(st.just("where"), inner, inner, inner),
            st.tuples(st.just("over"), inner, st.sampled_from((2.0, -3.0, 0.1))),
            st.tuples(st.just("power"), inner, st.sampled_from((0, 1, 2, 3, 7, -1, -2))),
            st.tuples(
                st.just("real power"),
                inner.map(lambda x: ("add", ("mul", x, x), ("const", 0.5))),
                st.one_of(st.tuples(st.just("const"), st.sampled_from((0.5, 1.5, -0.25))), inner),
            ),
        )

    return st.recursive(leaves(), extend, max_leaves=10)


def points() -> st.SearchStrategy[list[float]]:
    return st.lists(st.floats(-2.0, 2.0).map(lambda x: round(x, 6)), min_size=SYMBOLS, max_size=SYMBOLS)


# -- on the graph -------------------------------------------------------------------------------------
def on_graph(formula: Any, symbols: list[Any]) -> Any:
    """Write the formula with operators and functions, as the algorithms do; ``symbols`` may be numbers."""
    op, *args = formula
    if op == "sym":
        return symbols[args[0]]
    if op == "const":
        return args[0]
    if op == "over":
        return on_graph(args[0], symbols) / args[1]
    if op == "power":
        return f.power(on_graph(args[0], symbols), float(args[1]))
    if op == "real power":
        return f.power(on_graph(args[0], symbols), on_graph(args[1], symbols))
    x = [on_graph(a, symbols) for a in args]
    if op == "table":
        return f.interpolate(x[0], KNOTS, VALUES)
    return {
        "add": lambda a, b: a + b,
        "sub": lambda a, b: a - b,
        "mul": lambda a, b: a * b,
        "div": lambda a, b: a / b,
        "neg": lambda a: -a,
        "abs": f.absolute,
        "min": f.minimum,
        "max": f.maximum,
        **{
            k: getattr(f, k)
            for k in ("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "exp")
        },
        **{k: getattr(f, k) for k in ("log", "sqrt", "sign", "atan2", "where")},
    }[op](*x)


def new_graph() -> tuple[Graph, list[Expr]]:
    graph = Graph()
    return graph, graph.symbols([f"x{k}" for k in range(SYMBOLS)], "x")


# -- exact and in 50 digits -----------------------------------------------------------------------------
def exact(formula: Any, x: list[Fraction]) -> Fraction:
    """Evaluate a polynomial in rational arithmetic."""
    op, *args = formula
    if op == "sym":
        return x[args[0]]
    if op == "const":
        return Fraction(args[0])
    if op == "power":
        return exact(args[0], x) ** args[1]
    if op == "over":
        return exact(args[0], x) / Fraction(args[1])
    values = [exact(a, x) for a in args]
    return {
        "add": lambda a, b: a + b,
        "sub": lambda a, b: a - b,
        "mul": lambda a, b: a * b,
        "neg": lambda a: -a,
    }[op](*values)


def exact_node(e: Any, x: list[Fraction]) -> Fraction:
    """Evaluate the graph of a polynomial in rational arithmetic."""
    if not isinstance(e, Expr):
        return Fraction(e)
    value: dict[int, Fraction] = {}
    for node in reachable([e]):
        a = [value[i.index] for i in node.args]
        if node.op == "sym":
            value[node.index] = x[node.value[2]]
        elif node.op == "const":
            value[node.index] = Fraction(node.value)
        else:
            value[node.index] = {
                "add": lambda a, b: a + b,
                "sub": lambda a, b: a - b,
                "mul": lambda a, b: a * b,
                "neg": lambda a: -a,
            }[node.op](*a)
    return value[e.index]


class Undefined(Exception):
    """The formula has no value here, or sits so near a kink or a pole that it cannot be compared."""


def _table(x: Any, order: int = 0) -> Any:
    if order:
        slopes = [(b - a) / (t - s) for a, b, s, t in zip(VALUES, VALUES[1:], KNOTS, KNOTS[1:])]
        return mp.mpf([0.0, *slopes, 0.0][sum(x >= k for k in KNOTS)])
    if x <= KNOTS[0]:
        return mp.mpf(VALUES[0])
    if x >= KNOTS[-1]:
        return mp.mpf(VALUES[-1])
    k = max(i for i in range(len(KNOTS) - 1) if x >= KNOTS[i])
    t = (x - KNOTS[k]) / (mp.mpf(KNOTS[k + 1]) - mp.mpf(KNOTS[k]))
    return (1 - t) * VALUES[k] + t * mp.mpf(VALUES[k + 1])


MP: dict[str, Any] = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": lambda a, b: a / b,
    "neg": lambda a: -a,
    "sin": mp.sin,
    "cos": mp.cos,
    "tan": mp.tan,
    "asin": mp.asin,
    "acos": mp.acos,
    "atan": mp.atan,
    "sinh": mp.sinh,
    "cosh": mp.cosh,
    "tanh": mp.tanh,
    "exp": mp.exp,
    "log": mp.log,
    "sqrt": mp.sqrt,
    "abs": abs,
    "sign": mp.sign,
    "atan2": mp.atan2,
    "min": min,
    "max": max,
    "where": lambda x, a, b: a if x > 0 else b,
    "pow": mp.power,
    "table": _table,
}
U = mp.mpf(2) ** -53
NEAR = mp.mpf("1e-3")  # distance from a kink below which a formula is not compared
LARGE = mp.mpf("1e8")  # beyond it rounding says little


def _kink(op: str, v: list[Any]) -> Any:
    """Return the distance from the operation's nearest kink, jump or pole."""
    if op in ("abs", "sign", "where"):
        return abs(v[0])
    if op in ("min", "max"):
        return abs(v[0] - v[1])
    if op == "atan2":
        return mp.hypot(*v) if v[1] > 0 else abs(v[0])
    if op == "table":
        return min(abs(v[0] - k) for k in KNOTS)
    if op == "div":
        return abs(v[1])
    return mp.inf


def with_error(formula: Any, x: list[Any]) -> tuple[Any, Any]:
    """Evaluate in 50 digits; beside it, a first-order bound of the error of double precision.

    Raises
    ------
    Undefined : within ``NEAR`` of a kink, a jump or a pole, or beyond ``LARGE``.
    """
    op, *args = formula
    if op == "sym":
        return x[args[0]], mp.mpf(0)
    if op == "const":
        return mp.mpf(args[0]), mp.mpf(0)
    if op == "over":
        op, args = "div", [args[0], ("const", args[1])]
    if op == "real power":
        op = "pow"
    if op == "power":
        base, error = with_error(args[0], x)
        n = args[1]
        if n < 0 and abs(base) < NEAR:
            raise Undefined
        value = base**n
        slope = abs(n * base ** (n - 1)) if n else mp.mpf(0)
        if abs(value) > LARGE:
            raise Undefined
        return value, slope * error + 16 * U * abs(value)
    pairs = [with_error(a, x) for a in args]
    v, e = [p[0] for p in pairs], [p[1] for p in pairs]
    if _kink(op, v) < NEAR:
        raise Undefined
    value = MP[op](*v)
    if abs(value) > LARGE:
        raise Undefined
    if op == "where":
        return value, e[1] if v[0] > 0 else e[2]
    error = 4 * U * abs(value)
    for k in range(len(v)):
        if e[k]:
            slope = mp.diff(lambda s, k=k: MP[op](*v[:k], s, *v[k + 1 :]), v[k])
            error += 2 * abs(slope) * e[k]
    return value, error


def plain(formula: Any, x: list[Any]) -> Any:
    """Evaluate in the working precision, without looking for kinks."""
    op, *args = formula
    if op == "sym":
        return x[args[0]]
    if op == "const":
        return mp.mpf(args[0])
    if op == "over":
        return plain(args[0], x) / mp.mpf(args[1])
    if op == "power":
        return plain(args[0], x) ** args[1]
    if op == "real power":
        op = "pow"
    return MP[op](*[plain(a, x) for a in args])


def in_digits(e: Any, x: list[Any]) -> Any:
    """Evaluate a graph node by node in the working precision."""
    if not isinstance(e, Expr):
        return mp.mpf(e)
    value: dict[int, Any] = {}
    for node in reachable([e]):
        if node.op == "sym":
            value[node.index] = x[node.value[2]]
        elif node.op == "const":
            value[node.index] = mp.mpf(node.value)
        elif node.op == "table":
            value[node.index] = _table(value[node.args[0].index], 2 - len(node.value[1]))
        else:
            value[node.index] = MP[node.op](*[value[a.index] for a in node.args])
    return value[e.index]
