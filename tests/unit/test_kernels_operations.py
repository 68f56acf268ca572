"""Each operation in compiled code against numpy or 60 digits, at every lane width and on extreme numbers."""

from __future__ import annotations

from typing import Any

import mpmath as mp
import numpy as np
import pytest

from robodyn_cli.expr import functions as f
from robodyn_cli.expr.calculus import jacobian, jacobian_at
from robodyn_cli.expr.intervals import bounds
from robodyn_cli.expr.rebuild import evaluate
from tests.kernels import SPECIAL, WIDTHS, compiled, symbols, ulps

widths = pytest.mark.parametrize("width", WIDTHS)
RNG = np.random.default_rng(7)


def magnitudes(low: float, high: float, count: int) -> np.ndarray:
    """Numbers of both signs, evenly spread over the exponents."""
    return np.asarray(RNG.choice([-1.0, 1.0], count) * 10.0 ** RNG.uniform(low, high, count))


ONE = np.concatenate([SPECIAL, magnitudes(-308, 308, 60), magnitudes(-3, 3, 60)])
PAIRS = np.array(
    [(a, b) for a in SPECIAL for b in SPECIAL]
    + list(zip(magnitudes(-200, 200, 60), magnitudes(-200, 200, 60)))
    + list(zip(magnitudes(-2, 2, 60), magnitudes(-2, 2, 60)))
)


def same(got: np.ndarray, expected: np.ndarray) -> None:
    """Fail unless equal bit for bit, but for the sign of zero and the payload of NaN."""
    different = ~((got == expected) | (np.isnan(got) & np.isnan(expected)))
    assert not different.any(), (np.flatnonzero(different)[:5], got[different][:5], expected[different][:5])


@widths
@pytest.mark.parametrize("op", ["add", "sub", "mul", "div", "min", "max", "neg", "abs", "sign", "sqrt"])
def test_exact_operations(op: str, width: int) -> None:
    x, y = symbols(2)
    forms: dict[str, tuple[Any, Any]] = {
        "add": (x + y, np.add), "sub": (x - y, np.subtract), "mul": (x * y, np.multiply), "div": (x / y, np.divide),
        "min": (f.minimum(x, y), np.minimum), "max": (f.maximum(x, y), np.maximum), "neg": (-x, np.negative),
        "abs": (f.absolute(x), np.abs), "sign": (f.sign(x), np.sign), "sqrt": (f.sqrt(x), np.sqrt),
    }  # fmt: skip
    expression, oracle = forms[op]
    with np.errstate(all="ignore"):
        expected = oracle(PAIRS[:, 0]) if op in ("neg", "abs", "sign", "sqrt") else oracle(*PAIRS.T)
    same(compiled({"r": [expression]}, width, PAIRS)["r"][:, 0], expected)


@widths
def test_where_takes_the_second_branch_at_zero_and_at_nan(width: int) -> None:
    x, a, b = symbols(3)
    rows = np.array(
        [(s, 1.0, 2.0) for s in SPECIAL] + [(1.0, np.nan, 3.0), (-1.0, np.inf, 4.0), (-1.0, 5.0, np.nan)]
    )
    got = compiled({"r": [f.where(x, a, b)], "s": [f.step(x)]}, width, rows)
    same(got["r"][:, 0], np.where(rows[:, 0] > 0, rows[:, 1], rows[:, 2]))
    # a step is 1 wherever x is not below zero
    same(got["s"][:, 0], np.where(-rows[:, 0] > 0, 0.0, 1.0))


@pytest.mark.parametrize("x", [-2.0, -0.0, 0.0, 3.0, np.inf, -np.inf, np.nan])
@pytest.mark.parametrize("y", [-1.0, 0.0, 2.0, np.nan])
def test_switches_agree_with_the_same_functions_on_numbers(x: float, y: float) -> None:
    a, b = symbols(2)
    outputs = {"r": [f.where(a, b, 7.0), f.sign(a), f.absolute(a), f.step(a)]}
    numbers = [f.where(x, y, 7.0), f.sign(x), f.absolute(x), f.step(x)]
    same(compiled(outputs, 4, np.array([[x, y]]))["r"][0], np.array(numbers, dtype=float))
    arrays = [f.minimum(np.array(x), np.array(y)), f.maximum(np.array(x), np.array(y))]
    same(compiled({"r": [f.minimum(a, b), f.maximum(a, b)]}, 4, np.array([[x, y]]))["r"][0], np.array(arrays))


# function of the C library: (mpmath, largest error in units in the last place, points inside the domain)
LIBRARY: dict[str, tuple[Any, float, np.ndarray]] = {
    "exp": (mp.exp, 1.0, RNG.uniform(-744, 709, 80)),
    "log": (mp.log, 1.0, np.abs(magnitudes(-308, 308, 80))),
    "tan": (mp.tan, 1.5, magnitudes(-8, 8, 80)),
    "asin": (mp.asin, 1.0, RNG.uniform(-1, 1, 80)),
    "acos": (mp.acos, 1.0, RNG.uniform(-1, 1, 80)),
    "atan": (mp.atan, 1.0, magnitudes(-8, 8, 80)),
    "sinh": (mp.sinh, 2.0, magnitudes(-8, 2.8, 80)),
    "cosh": (mp.cosh, 2.0, magnitudes(-8, 2.8, 80)),
    "tanh": (mp.tanh, 2.5, magnitudes(-8, 1.2, 80)),
}


@widths
@pytest.mark.parametrize("name", LIBRARY)
def test_library_functions_to_about_one_unit(name: str, width: int) -> None:
    (x,) = symbols(1)
    exact, bound, points = LIBRARY[name]
    got = compiled({"r": [getattr(f, name)(x)]}, width, points[:, None])["r"][:, 0]
    with mp.workdps(40):
        worst = max(ulps(g, exact(mp.mpf(p))) for g, p in zip(got, points))
    assert worst <= bound


@pytest.mark.parametrize("name", LIBRARY)
def test_library_functions_at_extremes(name: str) -> None:
    (x,) = symbols(1)
    points = np.array([p for p in SPECIAL if name != "tan" or not 1e15 < abs(p) < np.inf])
    got = compiled({"r": [getattr(f, name)(x)]}, 8, points[:, None])["r"][:, 0]
    with np.errstate(all="ignore"):
        expected = getattr(f, name)(points)
    assert np.array_equal(np.isnan(got), np.isnan(expected))
    finite = ~np.isnan(expected)
    np.testing.assert_allclose(got[finite], expected[finite], rtol=1e-15, atol=1e-323)


@widths
@pytest.mark.parametrize("name", ["pow", "atan2"])
def test_functions_of_two_arguments(name: str, width: int) -> None:
    x, y = symbols(2)
    rows = PAIRS[:: 1 if width == 8 else 7]
    expression = f.power(x, y) if name == "pow" else f.atan2(x, y)
    got = compiled({"r": [expression]}, width, rows)["r"][:, 0]
    with np.errstate(all="ignore"):
        expected = np.power(*rows.T) if name == "pow" else np.arctan2(*rows.T)
    zero = (rows == 0.0).any(axis=1)  # the sign of zero decides there, and is not kept
    assert np.array_equal(np.isnan(got[~zero]), np.isnan(expected[~zero]))
    np.testing.assert_allclose(got[~zero], expected[~zero], rtol=1e-13, atol=1e-323)


@pytest.mark.parametrize("exponent", [-8, -3, -1, 0, 1, 2, 3, 7, 8, 9, 0.5, -0.5, 1.5, 1 / 3])
def test_constant_exponents(exponent: float) -> None:
    (x,) = symbols(1)
    points = np.abs(magnitudes(-20, 20, 50)) if exponent != int(exponent) else magnitudes(-20, 20, 50)
    r = f.power(x, exponent)
    got = np.broadcast_to(compiled({"r": [r]}, 8, points[:, None])["r"][:, 0], 50)
    with mp.workdps(40):
        worst = max(ulps(g, mp.power(mp.mpf(p), mp.mpf(exponent))) for g, p in zip(got, points))
    assert worst <= 8.0  # products of products


# -- sine and cosine ------------------------------------------------------------------------------------
def near_quarter_turns() -> np.ndarray:
    """Multiples of pi/2 up to 1e15, rounded, and their neighbours: the worst case of a reduction."""
    with mp.workdps(60):
        quarter = mp.pi / 2
        counts = [*range(1, 40), *(10**k for k in range(2, 15)), 6 * 10**14]
        # doubles that come closest to a multiple: convergents of the continued fraction of pi/2
        counts += [710, 208341 * 2, 1146408, 245850922, 411557987, 5371151992734, 8958937768937]
        exact = [float(k * quarter) for k in counts]
    return np.array([y for x in exact for y in (x, np.nextafter(x, 0.0), np.nextafter(x, np.inf), -x)])


ANGLES = {
    "small": magnitudes(-320, -1, 100),
    "ordinary": magnitudes(-1, 2, 200),
    "large": magnitudes(2, 15, 200),
    "next to quarter turns": near_quarter_turns(),
}


@widths
@pytest.mark.parametrize("fused", [True, False])
@pytest.mark.parametrize("kind", ANGLES)
def test_sine_and_cosine_to_a_few_units(kind: str, fused: bool, width: int) -> None:
    (x,) = symbols(1)
    points = ANGLES[kind]
    got = compiled({"s": [f.sin(x)], "c": [f.cos(x)]}, width, points[:, None], fused=fused)
    beyond = (
        np.zeros(len(points)) if fused else np.where(np.abs(points) > 1e6, np.spacing(np.abs(points)), 0.0)
    )
    with mp.workdps(60):
        for name, exact in (("s", mp.sin), ("c", mp.cos)):
            for g, p, rounded in zip(got[name][:, 0], points, beyond):
                value = exact(mp.mpf(p))
                # beyond 1e6 code without fused multiply-add takes a number next to x
                assert rounded or ulps(g, value) <= (1.5 if fused else 2.0), (name, p, g)
                assert abs(g - value) <= 2.0 * rounded + 2.0 * np.spacing(abs(g)), (name, p, g)


def test_sine_and_cosine_without_fused_multiply_add_at_many_angles() -> None:
    """To two units up to 1e6, next to quarter turns as well, in code that runs on a processor without it."""
    (x,) = symbols(1)
    turns = RNG.integers(1, 636_619, 30_000) * (np.pi / 2)
    beside = turns * (1.0 + 10.0 ** RNG.uniform(-16, -3, len(turns)) * RNG.choice([-1.0, 1.0], len(turns)))
    points = np.concatenate([RNG.uniform(-1e6, 1e6, 40_000), beside, magnitudes(-8, 6, 30_000)])
    got = compiled({"s": [f.sin(x)], "c": [f.cos(x)]}, 2, points[:, None], fused=False)
    with mp.workdps(40):
        for name, exact in (("s", mp.sin), ("c", mp.cos)):
            left = [
                float(mp.mpf(g) - exact(mp.mpf(p))) for g, p in zip(got[name][:, 0].tolist(), points.tolist())
            ]
            assert np.max(np.abs(left) / np.spacing(np.abs(got[name][:, 0]))) <= 2.0


@widths
@pytest.mark.parametrize("fused", [True, False])
def test_sine_and_cosine_of_what_is_no_angle(fused: bool, width: int) -> None:
    (x,) = symbols(1)
    points = np.array([[np.nan], [np.inf], [-np.inf], [0.0], [5e-324]])
    got = compiled({"r": [f.sin(x), f.cos(x)]}, width, points, fused=fused)["r"]
    assert np.isnan(got[:3]).all()
    assert np.array_equal(got[3:], [[0.0, 1.0], [5e-324, 1.0]])


@pytest.mark.parametrize("width", [1, 4])
@pytest.mark.parametrize("fused", [True, False])
def test_many_angles_of_one_level_and_nested_ones_keep_apart(fused: bool, width: int) -> None:
    xs = symbols(11)
    inner = [f.sin(x) for x in xs]
    outer = [f.cos(3.0 * s + x) for s, x in zip(inner, xs)]
    mixed = f.sin(f.cos(f.sin(xs[0])) + f.sin(xs[1]))
    rows = RNG.uniform(-4, 4, (21, 11))
    got = compiled({"r": [*inner, *outer, mixed]}, width, rows, fused=fused)["r"]
    expected = np.array(evaluate([*inner, *outer, mixed], {"x": rows.T})).T
    np.testing.assert_allclose(got, expected, rtol=0, atol=2e-15)


# -- tables ---------------------------------------------------------------------------------------------
TABLES = {
    "one step": ((0.0, 1.0), (2.0, -1.0)),
    "three": ((-1.0, 0.0, 4.0), (0.0, 5.0, 5.0)),
    "uneven": ((-1e3, -1.0, -1.0 + 1e-12, 0.3, 0.7, 1e6), (1.0, 2.0, -2.0, 0.0, 1e-300, 1e8)),
    "long": (tuple(np.cumsum(RNG.uniform(0.01, 1.0, 77)).tolist()), tuple(RNG.standard_normal(77).tolist())),
}


@widths
@pytest.mark.parametrize("order", [0, 1])
@pytest.mark.parametrize("name", TABLES)
def test_tables(name: str, order: int, width: int) -> None:
    knots, values = TABLES[name]
    (x,) = symbols(1)
    middle = [0.5 * (a + b) for a, b in zip(knots, knots[1:])]
    around = [np.nextafter(k, d) for k in knots for d in (-np.inf, np.inf)]
    points = np.array([*knots, *middle, *around, knots[0] - 5, knots[-1] + 5, -np.inf, np.inf, 1e300, 0.0])
    e = x.graph.interpolate(x, knots, values)
    e = jacobian([e], [x])[0][0] if order else e
    got = compiled({"r": [e]}, width, points[:, None])["r"][:, 0]
    expected = evaluate([e], {"x": [points]})[0]
    slope = np.abs(np.diff(values) / np.diff(knots)).max()
    scale = np.abs(values).max() + (slope * np.spacing(np.abs(knots).max()) if not order else slope)
    np.testing.assert_allclose(got, expected, rtol=0, atol=4e-16 * scale)
    at = len(knots)
    if not order:
        assert np.array_equal(got[:at], values), "exact at the knots"
        outside = np.clip(points, knots[0], knots[-1]) != points
        assert set(got[outside]) <= {values[0], values[-1]}


@widths
@pytest.mark.parametrize("held", [None, (7.0, -7.0)])
@pytest.mark.parametrize("order", [0, 1, 2])
def test_piecewise_polynomials(order: int, held: tuple[float, float] | None, width: int) -> None:
    rng = np.random.default_rng(4)
    knots, rows = np.cumsum(rng.uniform(0.2, 2.0, 9)), rng.standard_normal((4, 8))
    (x,) = symbols(1)
    e = x.graph.piecewise(x, tuple(knots.tolist()), tuple(tuple(r) for r in rows.tolist()), held)
    for _ in range(order):
        e = jacobian([e], [x])[0][0]
        held = held and (0.0, 0.0)
    points = np.array([*knots, *rng.uniform(knots[0] - 1.0, knots[-1] + 1.0, 200)])
    expected = []
    for at in points:
        k = min(max(int(np.sum(knots <= at)) - 1, 0), len(knots) - 2)
        p = np.polynomial.Polynomial(rows[:, k])
        expected.append((p.deriv(order) if order else p)(at - knots[k]))
        if held and not knots[0] <= at < knots[-1]:
            expected[-1] = held[int(at >= knots[-1])]
    got = compiled({"r": [e]}, width, points[:, None])["r"][:, 0]
    scale = np.abs(expected).max()
    np.testing.assert_allclose(got, expected, rtol=0, atol=1e-14 * scale)
    np.testing.assert_allclose(evaluate([e], {"x": [points]})[0], expected, rtol=0, atol=1e-14 * scale)
    low = np.sort(points)[:-5]
    high = np.sort(points)[5:]
    found = bounds(e, x, low, high)
    assert (found.low[:, None] <= np.array(expected) + 1e-12).all(
        where=(points >= low[:, None]) & (points <= high[:, None])
    )
    assert (found.high[:, None] >= np.array(expected) - 1e-12).all(
        where=(points >= low[:, None]) & (points <= high[:, None])
    )


@widths
def test_a_table_passes_on_nan(width: int) -> None:
    (x,) = symbols(1)
    got = compiled({"r": [f.interpolate(x, (0.0, 1.0), (3.0, 4.0))]}, width, np.array([[np.nan], [0.5]]))["r"]
    assert np.isnan(got[0, 0]) and got[1, 0] == 3.5


@widths
def test_several_tables_in_one_program_do_not_share_their_data(width: int) -> None:
    (x,) = symbols(1)
    tables = [f.interpolate(x, (0.0, 1.0, 2.0), (0.0, k, -k)) for k in (1.0, 2.0, 3.0)]
    rows = RNG.uniform(-1, 3, (10, 1))
    got = compiled({"r": tables}, width, rows)["r"]
    np.testing.assert_allclose(got, np.array(evaluate(tables, {"x": rows.T})).T, rtol=0, atol=2e-15)


def test_jacobian_at_a_point_is_that_of_the_expressions() -> None:
    x, y, z = symbols(3)
    s = f.sin(x) * f.sqrt(y)
    outputs: list[Any] = [
        s / z - f.atan2(x, z), f.power(y, 2.5) + f.power(x, 3.0) * f.exp(-z), f.where(x, s, f.log(y)), f.minimum(x, y * z),
        f.maximum(s, z), f.absolute(x - z) + f.tan(y) * f.tanh(z), x.graph.piecewise(y, (0.0, 1.0, 2.0), ((1.0, 2.0), (3.0, 0.5))),
        f.power(y, x), 2.0,
    ]  # fmt: skip
    exact = jacobian(outputs, [x, y, z])
    for point in ((0.7, 1.3, 2.0), (-0.4, 0.8, 0.3)):
        values = {x.value[1]: point}
        own = jacobian_at(outputs, [x, y, z], values)
        for row, entries in zip(own, exact):
            wide = np.array(evaluate([entries.get(k, 0.0) for k in range(3)], values), dtype=float)
            same(np.isnan(row), np.isnan(wide))
            np.testing.assert_allclose(row, wide, rtol=1e-14, atol=1e-14)
    with pytest.raises(ArithmeticError):
        jacobian_at([1.0 / x], [x], {x.value[1]: (0.0,)})
