"""Random formulas, compiled: they agree with 50 digits, with the interpreter, and with themselves at every width."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robodyn_cli.expr.calculus import jacobian
from robodyn_cli.expr.graph import Expr
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.kernels import compiler
from robodyn_cli.kernels.program import make_program
from tests.kernels import SPECIAL, WIDTHS, at_width
from tests.numeric import examples
from tests.property import formulas as fm

mp.mp.dps = fm.DIGITS


@pytest.fixture(autouse=True, scope="module")
def _keep_nothing() -> Iterator[None]:
    """Random programs do not belong in the cache, on disk or in memory."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROBODYN_CACHE", "off")
        patch.setattr(compiler, "_loaded", {})
        yield


def build(formulas: list[Any]) -> tuple[list[Any], list[Expr]]:
    """Return the formulas that have a graph, and the symbols."""
    _, symbols = fm.new_graph()
    found = []
    for formula in formulas:
        try:
            found.append((formula, fm.on_graph(formula, symbols)))
        except (ArithmeticError, ValueError):
            continue
    return found, symbols


several = st.lists(fm.formulas(), min_size=1, max_size=5)
width = st.sampled_from(WIDTHS)


@examples(60)
@given(several, st.lists(fm.points(), min_size=1, max_size=9), width, st.booleans())
def test_compiled_formulas_agree_with_50_digits(
    formulas: list[Any], points: list[list[float]], width: int, fused: bool
) -> None:
    found, _ = build(formulas)
    if not found:
        return
    program = make_program({"r": [e for _, e in found]}, ["x"])
    x = np.array(points)
    got = np.broadcast_to(at_width(program, width, x, fused=fused)["r"], (len(x), len(found)))
    for j, (formula, _) in enumerate(found):
        for i, point in enumerate(points):
            try:
                value, error = fm.with_error(formula, [mp.mpf(v) for v in point])
            except (fm.Undefined, ZeroDivisionError):
                continue
            if isinstance(value, mp.mpc) or error > 1e-9:
                continue
            assert abs(mp.mpf(float(got[i, j])) - value) <= 8 * error + 4 * fm.U * abs(value)


@examples(40)
@given(
    several,
    st.lists(st.lists(st.sampled_from(SPECIAL), min_size=3, max_size=3), min_size=2, max_size=9),
    width,
)
def test_extreme_numbers_do_not_depend_on_the_width(
    formulas: list[Any], points: list[list[float]], width: int
) -> None:
    """Whatever infinities and NaN come out come out alike: lanes neither mix nor leak."""
    found, _ = build(formulas)
    if not found:
        return
    program = make_program({"r": [e for _, e in found]}, ["x"])
    x = np.array(points)
    got = at_width(program, width, x)["r"]
    alone = np.concatenate([at_width(program, width, row[None])["r"] for row in x])
    np.testing.assert_array_equal(got, alone)


@examples(40)
@given(several, st.lists(fm.points(), min_size=1, max_size=9), st.sampled_from([0, 1, 2, 3]))
def test_interpreter_and_every_optimisation_level_agree_on_derivatives_too(
    formulas: list[Any], points: list[list[float]], level: int
) -> None:
    found, symbols = build(formulas)
    outputs = [e for _, e in found]
    outputs += [d for row in jacobian(outputs, symbols) for d in row.values()]
    if not outputs:
        return
    x = np.array(points)
    with np.errstate(all="ignore"):
        expected = np.array([np.broadcast_to(v, len(x)) for v in evaluate(outputs, {"x": x.T})]).T
    got = at_width(make_program({"r": outputs}, ["x"]), 8, x, level=level)["r"]
    usable = np.isfinite(expected) & (np.abs(expected) < 1e6)
    # where rounding decides on which side of a kink a point lies the two may differ: compare where it cannot
    nudged = [x * (1 + s * 1e-11) for s in (-1, 1)]
    with np.errstate(all="ignore"):
        for y in nudged:
            moved = np.array([np.broadcast_to(v, len(y)) for v in evaluate(outputs, {"x": y.T})]).T
            usable &= np.abs(moved - expected) <= 1e-7 * (1 + np.abs(expected))
    np.testing.assert_allclose(got[usable], expected[usable], rtol=1e-7, atol=1e-7)
