"""Formulas: values, names, units, and every way of writing a bad one."""

from __future__ import annotations

import math

import numpy as np
import pytest

from robodyn_cli.errors import NumericalError, SceneError
from robodyn_cli.expr import rebuild
from robodyn_cli.expr.formula import MAX_LENGTH, FormulaTree, parse
from robodyn_cli.expr.graph import Graph


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1", 1.0),
        ("1e-9", 1e-9),
        (".5", 0.5),
        ("5.", 5.0),
        ("2E3", 2000.0),
        ("1 - 2 - 3", -4.0),
        ("8 / 4 / 2", 1.0),
        ("2 + 3*4", 14.0),
        ("(2 + 3)*4", 20.0),
        ("2*3^2", 18.0),
        ("2**3", 8.0),
        ("2^3^2", 512.0),
        ("-2^2", -4.0),
        ("2^-2", 0.25),
        ("--2", 2.0),
        ("+-+2", -2.0),
        ("2 - -3", 5.0),
        ("pi/2", math.pi / 2),
        ("e", math.e),
        ("2*pi*0.3", 2 * math.pi * 0.3),
        ("-90 deg", -math.pi / 2),
        ("45deg", math.pi / 4),
        ("(1+2) deg", math.radians(3)),
        ("(360/7) deg", math.radians(360 / 7)),
        ("2*45 deg + 1", math.pi / 2 + 1),
        ("sin(30 deg)", 0.5),
        ("atan2(1, -1)", 0.75 * math.pi),
        ("min(3, 1, 2)", 1.0),
        ("max(3, 1, 2, 9)", 9.0),
        ("abs(-3)", 3.0),
        ("sign(-3)", -1.0),
        ("sqrt(16)", 4.0),
        ("log(exp(2))", 2.0),
        ("step(0)", 1.0),
        ("step(-1e-9)", 0.0),
        ("tanh(0) + sinh(0) + cosh(0)", 1.0),
        ("asin(1) + acos(1) + atan(0) + tan(0) + cos(0)", math.pi / 2 + 1),
        ("if(1 < 2, 3, 4)", 3.0),
        ("if(2 <= 2, 3, 4)", 3.0),
        ("if(2 < 2, 3, 4)", 4.0),
        ("if(2 > 2, 3, 4)", 4.0),
        ("if(2 >= 2, 3, 4)", 3.0),
        ("if(1 >= 2, 3, 4)", 4.0),
        ("if(1 <= 0, 3, if(1 > 0, 5, 6))", 5.0),
        (" 1\n + 2\t", 3.0),
    ],
)
def test_constants(text: str, value: float) -> None:
    formula = parse(text)
    assert formula.names == frozenset()
    assert formula.constant == pytest.approx(value, rel=1e-15, abs=1e-300)
    assert formula.evaluate({}) == formula.constant


def test_quarter_turn_in_degrees_is_exact() -> None:
    assert parse("-90 deg").constant == -math.pi / 2
    assert parse("180 deg").constant == math.pi


@pytest.mark.parametrize(
    ("text", "column", "words"),
    [
        ("", 1, "end of the formula"),
        ("1 +", 4, "end of the formula"),
        ("(1", 3, "')' is needed"),
        ("1)", 2, "unexpected ')'"),
        ("1 2", 3, "operator"),
        ("2 t", 3, "operator"),
        ("1 $ 2", 3, "unexpected '$'"),
        ("1 == 2", 3, "unexpected '='"),
        ("é", 1, "unexpected 'é'"),
        ("a < b", 3, "allowed only as the first argument"),
        ("if(a, 1, 2)", 5, "needs a comparison"),
        ("if(a < b, 1)", 12, "',' is needed"),
        ("0 < t < 1", 3, "allowed only as the first argument"),
        ("sine(1)", 1, "did you mean 'sin'"),
        ("1 + sqr(2)", 5, "did you mean 'sqrt'"),
        ("sin()", 1, "takes 1 argument"),
        ("sin(1, 2)", 1, "takes 1 argument"),
        ("atan2(1)", 1, "takes 2 arguments"),
        ("min(1)", 1, "2 or more"),
        ("sin", 1, ""),
        ("deg", 1, "after a number"),
        ("45 deg deg", 8, "once"),
        ("360/7 deg", 7, "ambiguous"),
        ("2^2 deg", 5, "ambiguous"),
        ("1/0", 2, "division by zero"),
        ("t/(1-1)", 2, "division by zero"),
        ("sqrt(-1)", 1, "no value"),
        ("log(0)", 1, "no value"),
        ("(-8)^(1/3)", 5, "no value"),
        ("10^400", 3, "no value"),
        ("1e200*1e200", 6, "finite"),
        ("1e999", 1, "too large"),
        ("__import__('os')", 12, "unexpected"),
        ("open(1)", 1, "unknown function 'open'"),
        ("eval(1)", 1, "unknown function 'eval'"),
        ("t.real", 1, "unknown name 't.real'"),
        ("q.a.b", 1, "unknown name 'q.a.b'"),
        ("().__class__", 3, "unexpected '.'"),
        ("()", 2, "unexpected ')'"),
        ("lambda: 1", 7, "unexpected ':'"),
        ("x[0]", 2, "unexpected '['"),
        ("'a'", 1, "unexpected"),
    ],
)
def test_refused(text: str, column: int, words: str) -> None:
    with pytest.raises(SceneError) as caught:
        # names are looked up when a formula is resolved; all else is refused while it is parsed
        parse(text).resolve((), ())
    assert f"column {column}:" in caught.value.message
    assert words in caught.value.message
    assert repr(text) in caught.value.message


@pytest.mark.parametrize("text", ["(" * 5000, "-" * 5000, "sin(" * 2000, "2^" * 3000 + "1", "if(1<" * 1500])
def test_deep_nesting_is_refused(text: str) -> None:
    with pytest.raises(SceneError, match="levels deep"):
        parse(text)


def test_length_is_limited_but_long_sums_are_not_deep() -> None:
    with pytest.raises(SceneError, match=f"at most {MAX_LENGTH}"):
        parse("1" * (MAX_LENGTH + 1))
    terms = MAX_LENGTH // 2
    assert parse("+".join("t" * terms)).evaluate({"t": 2.0}) == 2.0 * terms


def test_names_are_made_canonical() -> None:
    formula = parse("1.96 - k*theta1 + q.phi - 0.2*qd.theta1 + t*p.k")
    assert formula.names == {"k", "theta1", "q.phi", "qd.theta1", "t", "p.k"}
    assert formula.constant is None
    resolved = formula.resolve(["theta1", "phi"], ["k"])
    assert resolved.names == {"p.k", "q.theta1", "q.phi", "qd.theta1", "t"}
    env = {"p.k": 0.1, "q.theta1": 2.0, "q.phi": 3.0, "qd.theta1": 5.0, "t": 7.0}
    assert resolved.evaluate(env) == pytest.approx(1.96 - 0.2 + 3.0 - 1.0 + 0.7, rel=1e-15)
    assert resolved.resolve(["theta1", "phi"], ["k"]) == resolved


@pytest.mark.parametrize(
    ("text", "variables", "words"),
    [
        ("1 + tehta1", ("t", "q", "qd"), "column 5: unknown name 'tehta1' (did you mean 'theta1'?)"),
        ("theta1", ("t",), "'theta1' is not allowed here; allowed: t, k"),
        ("q.theta1", ("t",), "not allowed here"),
        ("qd.theta1", ("t", "q"), "not allowed here"),
        ("t", ("q",), "'t' is not allowed here"),
        ("q.nothing", ("t", "q"), "unknown name 'q.nothing'"),
        ("p.theta1", ("t", "q"), "unknown name 'p.theta1'"),
        ("q.k", ("t", "q"), "unknown name 'q.k'"),
        ("theta1.k", ("t", "q"), "unknown name 'theta1.k'"),
    ],
)
def test_names_that_are_refused(text: str, variables: tuple[str, ...], words: str) -> None:
    with pytest.raises(SceneError) as caught:
        parse(text).resolve(["theta1", "phi"], ["k"], variables)
    assert words in caught.value.message


EXPRESSIONS = [
    "1.96 - 0.1*q.a",
    "sin(t)^2 + cos(q.a)*exp(-t) - tan(q.a/3) / (1 + t)",
    "if(t < 0.5, q.a, -q.a) + if(t >= 0.5, 1, 2) + if(q.a <= t, 3, 4) + if(q.a > t, 5, 6)",
    "step(t - 0.5)*max(q.a, t, 0.2) - min(q.a, t) + abs(-t) + sign(q.a - 0.4)",
    "atan2(q.a, 1 + t) + sqrt(1 + t) + log(2 + t) + sinh(t) - cosh(q.a) + tanh(t)",
    "asin(t/9) + acos(q.a/9) + atan(t) + t deg - (q.a*2) deg",
    "2^t + t^3 + t^-1 + (1+t)^0.5 + q.a**2",
]


@pytest.mark.parametrize("text", EXPRESSIONS)
def test_floats_arrays_and_graph_agree(text: str) -> None:
    formula = parse(text).resolve(["a"])
    t = np.array([0.1, 0.3, 0.5, 0.7, 0.9])
    a = np.array([0.9, 0.3, 0.5, 0.2, 0.4])
    many = formula.evaluate({"t": t, "q.a": a})
    single = [formula.evaluate({"t": float(x), "q.a": float(y)}) for x, y in zip(t, a)]
    assert all(isinstance(x, float) for x in single)
    np.testing.assert_allclose(many, single, rtol=1e-14)
    graph = Graph()
    symbols = graph.symbols(["t", "a"], "x")
    outputs = [formula.evaluate({"t": symbols[0], "q.a": symbols[1]})]
    np.testing.assert_allclose(rebuild.evaluate(outputs, {"x": [t, a]})[0], many, rtol=1e-14)


def test_comparison_reaches_the_graph_as_where() -> None:
    graph = Graph()
    x = graph.symbol("x", "q")
    a, b = graph.symbol("a", "q"), graph.symbol("b", "q")
    env = {"q.x": x, "q.a": a, "q.b": b}
    strict = parse("if(x > 1, a, b)").resolve(["x", "a", "b"]).evaluate(env)
    assert strict.op == "where"
    assert strict.args[1:] == (a, b)
    inclusive = parse("if(x >= 1, a, b)").resolve(["x", "a", "b"]).evaluate(env)
    assert inclusive.args[1:] == (b, a)


def test_only_the_branch_that_counts_is_evaluated() -> None:
    formula = parse("if(t > 0, sin(t)/t, 1)")
    assert formula.evaluate({"t": 0.0}) == 1.0
    with np.errstate(all="raise"):
        values = formula.evaluate({"t": np.array([0.0, 1.0])})
    np.testing.assert_array_equal(values, [1.0, math.sin(1.0)])


@pytest.mark.parametrize("text", ["1/t", "log(t)", "t^-1", "10^(1000 + t)"])
def test_no_value_at_run_time(text: str) -> None:
    with pytest.raises(NumericalError, match=r"has no value at t = 0\.0"):
        parse(text).evaluate({"t": 0.0})


def test_degrees_mark_angles_but_not_inside_functions() -> None:
    angle = parse("1 rad").dims
    assert angle is not None and parse("45 deg").dims == angle == parse("sin(1) + 45 deg").dims
    assert parse("2*sin(45 deg)").dims is None and parse("pi/2").dims is None
    assert parse("1 + t deg").dims is None and list(parse("1 + t deg").unit_words) == ["deg"]


def test_formulas_compare_by_meaning_of_the_tree() -> None:
    assert parse("t + 1") == parse(" t+1.0 ")
    assert parse("t + 1") != parse("1 + t")
    assert parse("a - (b - c)") != parse("a - b - c")
    assert FormulaTree.number(2) == parse("2") == parse("1+1")
    assert FormulaTree.number(2).constant == 2.0
    assert len({parse("t+1"), parse("t + 1")}) == 1


@pytest.mark.parametrize(
    "text",
    [
        "max({0})", "min({0})", "max(max({1}), max({2}))", "{3}",
    ],
)  # fmt: skip
def test_a_formula_that_switches_at_very_many_places_is_refused(text: str) -> None:
    """Each place is watched in a run and compiled; the time for that grows faster than their number."""

    def terms(first: int, last: int) -> str:
        return ", ".join(f"{k}*t" for k in range(first, last))

    def written(count: int) -> str:
        half = count // 2
        ifs = " + ".join(f"if(t > {k}, 1, t)" for k in range(count))
        return text.format(terms(0, count), terms(0, half), terms(half, count), ifs)

    with pytest.raises(SceneError, match="switches at more than 100 places"):
        parse(written(120))
    assert parse(written(90)).names == {"t"}
    assert parse("max(" + ", ".join(str(k) for k in range(900)) + ")").constant == 899.0
