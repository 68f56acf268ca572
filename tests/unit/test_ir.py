"""The IR builder: what is written runs as written."""

from __future__ import annotations

import ctypes
import enum
import hashlib
import re
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from robodyn_cli.kernels import ir
from robodyn_cli.kernels.compiler import compile_module
from robodyn_cli.kernels.flow import ref_of
from robodyn_cli.kernels.ir import RELAXED, Function, Value, double_type, int_type, literal, module
from robodyn_cli.kernels.mathematics import polynomial, rough_exp2, rough_log2
from tests.kernels import SPECIAL, WIDTHS

widths = pytest.mark.parametrize("width", WIDTHS)
levels = pytest.mark.parametrize("level", [0, 1, 2])


def run(
    write: Callable[[Function], None], x: np.ndarray, size: int, level: int = 1, n: int = 0
) -> np.ndarray:
    """Run ``f(x, out, n)`` where ``write`` emits the body; returns ``out``."""
    f = Function("f", ["ptr %x", "ptr %out", "i64 %n"])
    write(f)
    f.ret()
    text = module([f])
    key = f"test ir {hashlib.sha256(text.encode()).hexdigest()}"
    call = compile_module(key, lambda: text, level).function("f", *[ctypes.c_void_p] * 2, ctypes.c_int64)
    x, out = np.array(x, dtype=float), np.full(size, -99.0)
    call(x.ctypes.data, out.ctypes.data, n)
    return out


def load(f: Function, width: int, place: int = 0) -> Value:
    return f.load(f.offset("%x", place), width)


@widths
@levels
def test_arithmetic_with_numbers_scalars_and_vectors(width: int, level: int) -> None:
    def body(f: Function) -> None:
        a, s = load(f, width), load(f, 1, 8)
        results = [a + s, s + a, a - s, s - a, 2.0 - a, a - 2.0, a * s, 3.0 * a, a / s, s / a, 1.0 / a, -a]
        for k, r in enumerate(results):
            f.store(f.splat(r, width), f.offset("%out", k * width))

    x = np.array([1.5, -2.0, 3.0, 0.25, 7.0, -0.5, 9.0, 1e3, 4.0])
    a, s = x[:width], x[8]
    got = run(body, x, 12 * width, level).reshape(12, width)
    expected = [a + s, s + a, a - s, s - a, 2 - a, a - 2, a * s, 3 * a, a / s, s / a, 1 / a, -a]
    np.testing.assert_allclose(got, np.array(expected), rtol=3e-16)


@widths
def test_lanes_travel_where_they_are_sent(width: int) -> None:
    def body(f: Function) -> None:
        a = load(f, width)
        last = width - 1
        f.store(f.broadcast(a, last), "%out")
        scalars = [f.lane(a, width - 1 - k) for k in range(max(1, width - 1))]
        f.store(f.pack(scalars, width), f.offset("%out", width))
        f.store(f.reduce("add", a), f.offset("%out", 2 * width))
        f.store(f.reduce("max", a), f.offset("%out", 2 * width + 1))
        f.store(
            f.constant([float(k) for k in range(width)] if width > 1 else 0.0, width),
            f.offset("%out", 2 * width + 2),
        )

    x = np.arange(1.0, width + 1) ** 2
    got = run(body, x, 3 * width + 2)
    backwards = x[::-1].copy()
    if width > 1:
        backwards[-1] = backwards[-2]  # lanes beyond what is given repeat the last
    np.testing.assert_array_equal(got[:width], np.full(width, x[-1]))
    np.testing.assert_array_equal(got[width : 2 * width], backwards)
    np.testing.assert_array_equal(got[2 * width : 2 * width + 2], [x.sum(), x.max()])
    np.testing.assert_array_equal(got[2 * width + 2 :], np.arange(width))


PREDICATES = {
    "oeq": lambda a, b: a == b, "one": lambda a, b: (a < b) | (a > b), "olt": lambda a, b: a < b,
    "ole": lambda a, b: a <= b, "ogt": lambda a, b: a > b, "oge": lambda a, b: a >= b,
    "ult": lambda a, b: ~(a >= b), "ugt": lambda a, b: ~(a <= b), "une": lambda a, b: ~(a == b),
    "ord": lambda a, b: ~(np.isnan(a) | np.isnan(b)), "uno": lambda a, b: np.isnan(a) | np.isnan(b),
}  # fmt: skip


@widths
@pytest.mark.parametrize("predicate", PREDICATES)
def test_comparisons_and_masks_with_nan(predicate: str, width: int) -> None:
    def body(f: Function) -> None:
        a, b = load(f, width), load(f, width, width)
        c = f.compare(predicate, a, b)
        f.store(f.splat(f.select(c, 1.0, f.constant(0.0, width)), width), "%out")
        f.store(f.to_double(c.mask()), f.offset("%out", width))
        f.store(f.select(c.any(), f.constant(1.0), 0.0), f.offset("%out", width + 1))
        f.store(
            f.select(~c & f.compare("ord", a, a), 1.0, f.constant(0.0, width)), f.offset("%out", width + 2)
        )
        f.store(
            f.select(c | f.compare("uno", a, a), 1.0, f.constant(0.0, width)), f.offset("%out", 2 * width + 2)
        )

    pool = [np.nan, 0.0, 1.0, -1.0, np.inf, -0.0]
    rng = np.random.default_rng(0)
    for _ in range(12):
        a, b = rng.choice(pool, width), rng.choice(pool, width)
        with np.errstate(invalid="ignore"):
            expected = PREDICATES[predicate](a, b)
        got = run(body, np.concatenate([a, b]), 3 * width + 2)
        np.testing.assert_array_equal(got[:width], expected)
        assert got[width] == sum(1 << k for k in range(width) if expected[k])
        assert got[width + 1] == expected.any()
        np.testing.assert_array_equal(got[width + 2 : 2 * width + 2], ~expected & ~np.isnan(a))
        np.testing.assert_array_equal(got[2 * width + 2 :], expected | np.isnan(a))


@pytest.mark.parametrize("mask", [1, 2, 8, 0b1010000, 1 << 40, (1 << 62) + 16])
def test_lowest_bit(mask: int) -> None:
    got = run(
        lambda f: f.store(f.to_double(f.lowest_bit(f.int_argument("n"))), "%out"), np.zeros(1), 1, n=mask
    )
    assert got[0] == (mask & -mask).bit_length() - 1


@levels
@pytest.mark.parametrize("n", [0, 1, 5])
@pytest.mark.parametrize(("start", "step", "down"), [(0, 1, False), (2, 1, False), (0, 2, False), (1, 3, False),
                                                     (0, 1, True), (2, 1, True)])  # fmt: skip
def test_counted_loops(start: int, step: int, down: bool, n: int, level: int) -> None:
    def body(f: Function) -> None:
        place = f.int_slot()
        f.store_int(0, place)
        with f.count(f.int_argument("n"), start=start, step=step, down=down) as k:
            f.store(f.to_double(k), f.offset("%out", f.load_int(place)))
            f.bump(place)

    seen = list(range(start, n, step))
    expected = seen[::-1] if down else seen
    got = run(body, np.zeros(1), 8, level, n)
    assert got.tolist() == [float(k) for k in expected] + [-99.0] * (8 - len(expected))


@levels
def test_nested_loops_branches_and_state_in_slots(level: int) -> None:
    def body(f: Function) -> None:
        total, odd = f.slot(), f.int_slot()
        f.store(0.0, total)
        f.store_int(0, odd)
        n = f.int_argument("n")
        with f.count(n) as i, f.count(n) as j, f.when(f.compare_int("sgt", i, j)):
            f.store(f.load(total) + f.to_double(i * j), total)
            with f.when(f.compare_int("eq", (i + j) & 1, 1)):
                f.bump(odd, 2)
        f.store(f.load(total), "%out")
        f.store(f.to_double(f.load_int(odd)), f.offset("%out", 1))
        f.store(f.to_double(f.select_int(f.compare_int("slt", n, 5), n - 1, n | 1)), f.offset("%out", 2))
        f.store(f.to_double(f.to_int(f.constant(-2.75))), f.offset("%out", 3))

    for n in (0, 4, 7):
        pairs = [(i, j) for i in range(n) for j in range(i)]
        expected = [
            sum(i * j for i, j in pairs),
            2 * sum((i + j) % 2 for i, j in pairs),
            n - 1 if n < 5 else n | 1,
            -2,
        ]
        assert run(body, np.zeros(1), 4, level, n).tolist() == expected


@levels
@widths
def test_strict_arithmetic_is_not_reordered(width: int, level: int) -> None:
    """The remainder of a sum (Knuth's two-sum) and of a product survives, and so does cancellation."""

    def body(f: Function) -> None:
        a, b = load(f, width), load(f, width, width)
        with f.strict():
            s = a + b
            v = s - a
            f.store((a - (s - v)) + (b - v), "%out")
            p = a * b
            f.store(f.fma(a, b, -p), f.offset("%out", width))
            f.store((a + 1e16) - 1e16, f.offset("%out", 2 * width))
        assert f.flags == RELAXED

    rng = np.random.default_rng(5)
    a, b = rng.standard_normal(width), rng.standard_normal(width) * 1e-5
    got = run(body, np.concatenate([a, b]), 3 * width, level).reshape(3, width)
    pairs = list(zip(a.tolist(), b.tolist()))
    np.testing.assert_array_equal(
        got[0], [float(Fraction(x) + Fraction(y) - Fraction(x + y)) for x, y in pairs]
    )
    np.testing.assert_array_equal(
        got[1], [float(Fraction(x) * Fraction(y) - Fraction(x * y)) for x, y in pairs]
    )
    assert np.all(got[:2] != 0.0)
    np.testing.assert_array_equal(got[2], (a + 1e16) - 1e16)


@widths
def test_min_and_max_pass_on_nan(width: int) -> None:
    def body(f: Function) -> None:
        a, b = load(f, width), load(f, width, width)
        f.store(f.max(a, b), "%out")
        f.store(f.min(a, b), f.offset("%out", width))
        f.store(f.reduce("maximum", a), f.offset("%out", 2 * width))

    for x in SPECIAL:
        a, b = np.full(width, 0.5), np.full(width, 0.25)
        a[-1] = x
        got = run(body, np.concatenate([a, b]), 2 * width + 1)
        np.testing.assert_array_equal(got[:width], np.maximum(a, b))
        np.testing.assert_array_equal(got[width : 2 * width], np.minimum(a, b))
        np.testing.assert_array_equal(got[2 * width], np.max(a))


@pytest.mark.parametrize("x", SPECIAL)
def test_literals_are_exact(x: float) -> None:
    got = run(lambda f: f.store(f.constant(x), "%out"), np.zeros(1), 1)
    assert got.tobytes() == np.array([x]).tobytes()
    assert literal(1.0) == "0x3FF0000000000000"


@pytest.mark.parametrize("degree", range(9))
def test_polynomials(degree: int) -> None:
    c = np.random.default_rng(degree).standard_normal(degree + 1)
    x = np.linspace(-1.5, 1.5, 8)
    got = run(lambda f: f.store(polynomial(f, c.tolist(), load(f, 8)), "%out"), x, 8)
    np.testing.assert_allclose(got, np.polynomial.polynomial.polyval(x, c), rtol=0, atol=1e-14)


@pytest.mark.parametrize("exponent", [-1 / 15, -1 / 5, 0.5, -0.5 * (1 / 8 - 0.75 * 0.04), 0.02, 1.0, -1.0])
def test_rough_powers_are_good_to_four_digits(exponent: float) -> None:
    x = 10.0 ** np.random.default_rng(1).uniform(-300, 300, 200)
    x = np.concatenate([x, [2.2250738585072014e-308, 1.0, 2.0, 1.7e308]])

    def body(f: Function) -> None:
        with f.count(len(x)) as k:
            power = rough_exp2(f, rough_log2(f, f.load(f.offset("%x", k))) * exponent)
            f.store(power, f.offset("%out", k))

    expected = np.clip(x**exponent, 2.0**-1000, 2.0**1000)  # far beyond any factor of a step
    np.testing.assert_allclose(run(body, x, len(x)), expected, rtol=2e-4)


def test_names_of_types() -> None:
    assert (double_type(1), double_type(4)) == ("double", "<4 x double>")
    assert (int_type(1), int_type(8, 1)) == ("i64", "<8 x i1>")


def test_a_module_declares_each_function_once() -> None:
    pair = [Function("a", ["double %x"]), Function("b", ["double %x"], internal=True)]
    for f in pair:
        f.sqrt(f.argument("x"))
        f.ret()
    text = module(pair)
    assert text.count("declare double @llvm.sqrt.f64") == 1
    assert "define internal void @b" in text and "define void @a" in text


def test_otherwise_has_to_follow_its_when() -> None:
    function = Function("f", ["i64 %n"], result="i64")
    positive = function.compare_int("sgt", function.int_argument("n"), 0)
    with function.when(positive):
        function.ret(1)
    with function.otherwise():
        function.ret(2)
    with pytest.raises(ValueError, match="has to follow"), function.otherwise():
        pass


def test_loops_and_blocks_are_left_and_begun_again() -> None:
    """Collatz: the steps from n to 1, and -1 where there are more than a hundred."""
    function = Function("run", ["i64 %n"], result="i64")
    place, count = function.int_slot(), function.int_slot()
    function.store_int(function.int_argument("n"), place)
    function.store_int(0, count)
    with function.block() as given_up:
        with function.loop() as steps:
            n = function.load_int(place)
            steps.leave(function.compare_int("eq", n, 1))
            given_up.leave(unless=function.compare_int("sle", function.bump(count), 100))
            with function.when(function.compare_int("eq", n & 1, 0)):
                function.store_int(function.emit_int(f"sdiv i64 {n.ref}, 2"), place)
                steps.again()
            function.store_int(n * 3 + 1, place)
        function.ret(function.load_int(count))
    function.ret(-1)
    run = compile_module("collatz", lambda: module([function])).function(
        "run", ctypes.c_int64, result=ctypes.c_int64
    )
    assert [run(n) for n in (1, 2, 3, 6, 7, 27)] == [0, 1, 7, 8, 16, -1]


def test_labels_and_jumps_stay_where_code_is_written() -> None:
    package = Path(ir.__file__).parents[1]
    jumps = re.compile(r"\bf\\.(label|jump|branch|place)\(|\bbr (i1|label)\b")
    for path in package.rglob("*.py"):
        if path.parts[len(package.parts)] != "kernels":
            assert not jumps.search(path.read_text("utf-8")), path


def test_members_of_enumerations_are_written_as_numbers() -> None:
    """Before Python 3.11 the text of an ``IntEnum`` member is its name."""

    class Outcome(enum.IntEnum):
        DONE = 3
        __str__ = enum.Enum.__str__

    assert str(Outcome.DONE) == "Outcome.DONE" and ref_of(Outcome.DONE) == "3"
