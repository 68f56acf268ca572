"""The expression graph: folding keeps values, equal nodes are one, derivatives and substitution are exact."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import mpmath as mp
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from robodyn_cli.expr import functions as f
from robodyn_cli.expr.calculus import directional, jacobian, substitute
from robodyn_cli.expr.graph import (
    COMMUTATIVE,
    Expr,
    Graph,
    count_operations,
    free_symbols,
    reachable,
)
from robodyn_cli.expr.rebuild import evaluate
from tests.numeric import examples
from tests.property import formulas as fm

mp.mp.dps = fm.DIGITS


def build(formula: Any, symbols: list[Any]) -> Any:
    try:
        return fm.on_graph(formula, symbols)
    except (ArithmeticError, ValueError):
        assume(False)


def reference(formula: Any, x: list[float]) -> tuple[Any, Any]:
    """Value and error bound, where they make sense."""
    try:
        value, error = fm.with_error(formula, [mp.mpf(v) for v in x])
    except (fm.Undefined, ZeroDivisionError):
        assume(False)
    assume(not isinstance(value, mp.mpc) and abs(value) < 1e6 and error < 1e-9)
    return value, error


def check_folded(nodes: list[Expr]) -> None:
    """Fail on a node that folding should not have left."""
    for node in nodes:
        assert all(a.index < node.index for a in node.args)
        values = [a.value for a in node.args if a.op == "const"]
        if node.args:
            assert len(values) < len(node.args) or node.op == "where", f"{node.op} of constants {values}"
        if node.op in ("add", "sub"):
            assert 0.0 not in values
            assert node.args[1].op != "neg"
            assert node.args[0].op != "neg"
        if node.op == "sub":
            assert node.args[1].op != "const"
            assert node.args[0] is not node.args[1]
        if node.op == "mul":
            assert not {0.0, 1.0, -1.0} & set(values)
            assert all(a.op != "neg" for a in node.args)
            inner = [b for a in node.args if a.op == "mul" for b in a.args if b.op == "const"]
            assert not inner, "a constant is hidden in an inner product"
        if node.op == "div":
            assert node.args[1].op != "const"
            assert node.args[0].op != "const" or node.args[0].value != 0.0
        if node.op == "neg":
            assert node.args[0].op not in ("neg", "sub", "const")
        if node.op in COMMUTATIVE:
            assert node.args[0].index <= node.args[1].index


def check_unique(graph: Graph) -> None:
    keys = [(n.op, n.value, *[a.index for a in n.args]) for n in graph.nodes]
    assert len(set(keys)) == len(keys)
    assert [n.index for n in graph.nodes] == list(range(len(graph.nodes)))


# -- values -------------------------------------------------------------------------------------------
@examples(400)
@given(fm.polynomials(), st.lists(st.fractions(-3, 3, max_denominator=12), min_size=3, max_size=3))
def test_folding_a_polynomial_keeps_its_value_exactly(formula: Any, x: list[Fraction]) -> None:
    _, symbols = fm.new_graph()
    assert fm.exact_node(fm.on_graph(formula, symbols), x) == fm.exact(formula, x)


@examples(400)
@given(fm.formulas(), fm.points())
def test_graph_and_its_evaluation_agree_with_50_digits(formula: Any, x: list[float]) -> None:
    value, error = reference(formula, x)
    _, symbols = fm.new_graph()
    e = build(formula, symbols)
    bound = 8 * error + mp.mpf("1e-40")
    assert abs(fm.in_digits(e, [mp.mpf(v) for v in x]) - value) <= bound
    assert abs(mp.mpf(float(evaluate([e], {"x": x})[0])) - value) <= bound + 2 * fm.U * abs(value)


@examples(100)
@given(fm.formulas(), fm.points(), fm.points())
def test_evaluation_takes_arrays_of_samples(formula: Any, x: list[float], y: list[float]) -> None:
    reference(formula, x), reference(formula, y)
    _, symbols = fm.new_graph()
    e = build(formula, symbols)
    both = np.broadcast_to(evaluate([e], {"x": [np.array(pair) for pair in zip(x, y)]})[0], 2)
    each = [evaluate([e], {"x": point})[0] for point in (x, y)]
    assert both == pytest.approx([float(v) for v in each], rel=1e-12, abs=1e-12)


# -- structure ----------------------------------------------------------------------------------------
@examples(400)
@given(fm.formulas())
def test_nothing_that_folding_removes_survives(formula: Any) -> None:
    graph, symbols = fm.new_graph()
    build(formula, symbols)
    check_unique(graph)
    check_folded(graph.nodes)


@examples(200)
@given(fm.formulas())
def test_nothing_that_folding_removes_survives_in_derivatives(formula: Any) -> None:
    _, symbols = fm.new_graph()
    e = build(formula, symbols)
    first = jacobian([e], symbols)
    second = jacobian(list(first[0].values()), symbols)
    along = directional([e], symbols, [1.0, 0.0, -2.0])
    entries = [*first[0].values(), *along, *[x for row in second for x in row.values()]]
    assert not [x for x in entries if isinstance(x, Expr) and x.op == "const"], (
        "a constant that is not a number"
    )
    check_folded(reachable(entries))


@examples(200)
@given(fm.formulas())
def test_equal_formulas_are_the_same_object(formula: Any) -> None:
    graph, symbols = fm.new_graph()
    first = build(formula, symbols)
    size = len(graph.nodes)

    def swapped(g: Any) -> Any:
        if not isinstance(g, tuple) or g[0] in ("sym", "const"):
            return g
        op, *args = g
        args = [swapped(a) for a in args]
        return (op, *reversed(args)) if op in ("add", "mul", "min", "max") else (op, *args)

    for again in (build(formula, symbols), build(swapped(formula), symbols)):
        assert again is first or (not isinstance(first, Expr) and again == first)
    assert len(graph.nodes) == size


@examples(100)
@given(fm.formulas(), fm.formulas())
def test_reachable_free_symbols_and_counts(one: Any, two: Any) -> None:
    _, symbols = fm.new_graph()
    outputs = [build(one, symbols), build(two, symbols)]
    nodes = reachable(outputs)
    assert len({n.index for n in nodes}) == len(nodes)
    position = {n.index: k for k, n in enumerate(nodes)}
    for node in nodes:
        assert all(position[a.index] < position[node.index] for a in node.args)
    used = {n.index for n in nodes if n.op == "sym"}
    assert {s.index for s in free_symbols(outputs)} == used
    assert count_operations(outputs) == sum(1 for n in nodes if n.args)
    for symbol in symbols:
        if symbol.index not in used:
            assert not any(jacobian(outputs, [symbol]))
            assert directional(outputs, [symbol], [1.0]) == [0.0, 0.0]


def test_graphs_do_not_mix() -> None:
    (x, *_), (y, *_) = fm.new_graph()[1], fm.new_graph()[1]
    with pytest.raises(ValueError, match="different graphs"):
        x + y
    with pytest.raises(TypeError, match="truth of an expression"):
        bool(x)
    with pytest.raises(TypeError):
        x + "1"


FOLDED = """
x*0 = 0.0
0*x = 0.0
x+0 = x
0+x = x
x-0 = x
x*1 = x
1*x = x
x/1 = x
x-x = 0.0
x+-x = 0.0
-(-x) = x
0/x = 0.0
x/x = 1.0
x**0 = 1.0
x**1 = x
(x+2)-2 = x
2*(0.5*x) = x
-(x-y) = y-x
(-x)*(-y) = x*y
(-x)*y = -(x*y)
x*(-1) = -x
-x-y = -(x+y)
y+x = x+y
y*x = x*y
x+x = 2*x
(2*x)*(3*y) = 6*(x*y)
(2*x)*y = 2*(x*y)
(1+x)+2 = x+3
x**2 = x*x
x**-1 = 1/x
sin(-x) = -sin(x)
cos(-x) = cos(x)
absolute(-x) = absolute(x)
atan(-x) = -atan(x)
x**0.5 = sqrt(x)
where(x,y,y) = y
where(x,2.0,2.0) = 2.0
-(2*x) = (-2)*x
-(1-x) = x-1
1-(-x) = x+1
1+(-x) = 1-x
3-(1+x) = 2-x
3-(1-x) = x+2
(1-x)+2 = 3-x
(1-x)-1 = -x
x/4 = 0.25*x
+x = x
x-(-y) = x+y
"""


@pytest.mark.parametrize("rule", FOLDED.strip().splitlines())
def test_folding_rules(rule: str) -> None:
    """Both sides are the same node, or the same number."""
    graph = Graph()
    names = {"x": graph.symbol("x", "x", 0), "y": graph.symbol("y", "x", 1)}
    names |= {k: getattr(f, k) for k in ("sin", "cos", "absolute", "atan", "sqrt", "where")}
    got, want = (eval(side, {}, names) for side in rule.split(" = "))
    assert got is want if isinstance(want, Expr) else (not isinstance(got, Expr) and got == want)


# -- derivatives and substitution ------------------------------------------------------------------------
X, Y, Z = (("sym", k) for k in range(3))
C = ("const", 0.7)
EACH = [
    *[(op, X) for op in ("neg", "sin", "cos", "tan", "atan", "sinh", "cosh", "tanh", "exp", "abs", "table")],
    *[(op, fm.SAFE[op](X)) for op in ("sqrt", "log", "asin", "acos")],
    *[(op, X, Y) for op in ("add", "sub", "mul", "div", "atan2", "min", "max")],
    *[(op, C, Y) for op in ("div", "atan2", "min", "max", "real power")],
    *[(op, X, C) for op in ("atan2", "min", "max")],
    ("mul", ("sign", X), Y),
    ("where", X, ("mul", Y, Z), Y),
    *[("power", X, n) for n in (0, 1, 2, 3, 7, 8, 9, 12, -1, -2, -9)],
    *[("real power", ("exp", X), p) for p in (("const", 0.5), ("const", 1.5), ("const", -0.25), Y)],
]


@pytest.mark.parametrize("x", [[1.3, 0.6, -0.4], [-0.8, 1.7, 0.9], [-1.6, -0.35, 0.2], [0.45, -1.2, 1.1]])
@pytest.mark.parametrize("formula", EACH, ids=str)
def test_each_operation(formula: Any, x: list[float]) -> None:
    """Value, slopes and second derivatives of every operation of the graph, away from kinks."""
    value, error = fm.with_error(formula, [mp.mpf(v) for v in x])
    _, symbols = fm.new_graph()
    e = fm.on_graph(formula, symbols)
    assert abs(mp.mpf(float(evaluate([e], {"x": x})[0])) - value) <= 8 * error + 2 * fm.U * abs(value)
    check_jacobian(formula, x)
    point = [mp.mpf(v) for v in x]
    first = [jacobian([e], symbols)[0].get(k, 0.0) for k in range(fm.SYMBOLS)]
    for j, row in enumerate(jacobian(first, symbols)):
        for k in range(fm.SYMBOLS):
            order = tuple((i == j) + (i == k) for i in range(fm.SYMBOLS))
            expected = mp.diff(lambda *v: fm.plain(formula, list(v)), tuple(point), order)
            assert float(fm.in_digits(row.get(k, 0.0), point)) == pytest.approx(
                float(expected), rel=1e-10, abs=1e-10
            )


@examples(150)
@given(fm.formulas(), fm.points())
def test_jacobian_and_directional_agree_with_50_digits(formula: Any, x: list[float]) -> None:
    reference(formula, x)
    check_jacobian(formula, x)


def check_jacobian(formula: Any, x: list[float]) -> None:
    _, symbols = fm.new_graph()
    e = build(formula, symbols)
    point = [mp.mpf(v) for v in x]
    row = jacobian([e], symbols)[0]
    slopes = []
    for k in range(fm.SYMBOLS):
        line = lambda s, k=k: fm.plain(formula, [*point[:k], s, *point[k + 1 :]])  # noqa: E731
        slopes.append(mp.diff(line, point[k], h=mp.mpf("1e-20")))
        assert fm.in_digits(row.get(k, 0.0), point) == pytest.approx(slopes[k], rel=1e-11, abs=1e-11)
    direction = [0.5, -2.0, 3.0]
    along = fm.in_digits(directional([e], symbols, direction)[0], point)
    expected = sum(d * s for d, s in zip(direction, slopes))
    assert float(along) == pytest.approx(float(expected), rel=1e-11, abs=1e-11)


@examples(150)
@given(fm.formulas(), fm.formulas(), st.integers(0, fm.SYMBOLS - 1), fm.points())
def test_substitute_is_building_with_the_replacement(outer: Any, inner: Any, k: int, x: list[float]) -> None:
    graph, symbols = fm.new_graph()
    e, replacement = build(outer, symbols), build(inner, symbols)
    put = [*symbols[:k], replacement, *symbols[k + 1 :]]
    try:
        got = substitute([e], {symbols[k].index: replacement})[0]
        reference(outer, [*x[:k], float(reference(inner, x)[0]), *x[k + 1 :]])
        direct = fm.on_graph(outer, put)
    except (ArithmeticError, ValueError):
        assume(False)
    check_folded(graph.nodes)
    a, b = (fm.in_digits(g, [mp.mpf(v) for v in x]) for g in (got, direct))
    assert float(a) == pytest.approx(float(b), rel=1e-9, abs=1e-9)
    if symbols[k].index not in {s.index for s in free_symbols([replacement])}:
        assert symbols[k].index not in {s.index for s in free_symbols([got])}


@examples(150)
@given(fm.formulas(), fm.points())
def test_substituting_numbers_gives_a_number(formula: Any, x: list[float]) -> None:
    value, error = reference(formula, x)
    _, symbols = fm.new_graph()
    e = build(formula, symbols)
    got = substitute([e], {s.index: v for s, v in zip(symbols, x)})[0]
    assert not isinstance(got, Expr)
    assert abs(mp.mpf(float(got)) - value) <= 8 * error + 2 * fm.U * abs(value) + mp.mpf("1e-40")


def test_derivatives_at_the_knots_of_a_table_are_right_continuous() -> None:
    x = Graph().symbol("x", "x")
    slope = jacobian([f.interpolate(x, fm.KNOTS, fm.VALUES)], [x])[0][0]
    slopes = [0.0, -1.5 / 1.25, 3.0 / 0.25, -1.0 / 1.5, 0.0]
    for at, expected in [(-5.0, 0), (-1.0, 1), (0.0, 1), (0.25, 2), (0.3, 2), (0.5, 3), (2.0, 4), (9.0, 4)]:
        assert float(evaluate([slope], {"x": [at]})[0]) == pytest.approx(slopes[expected])


def test_numbers_stay_numbers() -> None:
    g = Graph()
    got = [g.add(7.0, 2.0), g.sub(7.0, 2.0), g.mul(7.0, 2.0), g.div(7.0, 2.0), g.neg(7.0), g.power(7.0, 2.0)]
    assert got == [9.0, 5.0, 14.0, 3.5, -7.0, 49.0]
    assert not g.nodes


def test_zero_to_a_power_has_no_slope() -> None:
    x = Graph().symbol("x", "x")
    e = f.power(0.0, x + 1.0)
    assert evaluate([e], {"x": [0.5]})[0] == 0.0
    assert jacobian([e], [x]) == [{}]
    assert directional([e], [x], [1.0]) == [0.0]


def test_names_of_nodes() -> None:
    graph = Graph()
    x = graph.symbol("x", "q")
    assert (repr(x), repr(graph.constant(2.5))) == ("<x>", "2.5")
    assert repr(f.sin(x)) == f"<sin #{f.sin(x).index}>"


def test_the_branch_that_is_not_taken_does_not_spoil_a_derivative() -> None:
    x = Graph().symbol("x", "x")
    e = f.where(x, f.sqrt(x), 2.0 * x) + f.minimum(3.0 * x, f.sqrt(x + 2.0))
    at = {"x": [np.array([-2.0, 0.0, 4.0])]}
    slopes = [5.0, 5.0, 0.25 + 0.5 / math.sqrt(6.0)]
    with np.errstate(all="ignore"):
        assert evaluate([jacobian([e], [x])[0][0]], at)[0] == pytest.approx(slopes)
        assert evaluate(directional([e], [x], [1.0]), at)[0] == pytest.approx(slopes)


def test_step_and_where_at_zero() -> None:
    x = Graph().symbol("x", "x")
    for at, stepped, chosen in [(-1.0, 0.0, 3.0), (0.0, 1.0, 3.0), (1.0, 1.0, 2.0)]:
        assert evaluate([f.step(x)], {"x": [at]})[0] == stepped == f.step(at)
        assert evaluate([f.where(x, 2.0, 3.0)], {"x": [at]})[0] == chosen == f.where(at, 2.0, 3.0)
        assert np.array_equal(f.where(np.array([at]), 2.0, 3.0), [chosen])


def test_evaluation_in_extended_precision() -> None:
    _, (x, y, z) = fm.new_graph()
    e = f.sin(x) * f.exp(y) - f.sqrt(z) / 4.0
    exact = mp.sin(1) * mp.exp(2) - mp.sqrt(3) / 4
    got = evaluate([e], {"x": [np.longdouble(1), np.longdouble(2), np.longdouble(3)]})[0]
    assert isinstance(got, np.longdouble)
    if np.finfo(np.longdouble).eps < 1e-18:
        assert abs(mp.mpf(str(np.format_float_positional(got, 25))) - exact) < 1e-17
    assert math.isclose(float(got), float(exact), rel_tol=1e-15)
