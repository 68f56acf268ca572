"""Exact time derivatives of formulas."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from robodyn_cli.errors import NumericalError
from robodyn_cli.expr.calculus import directional
from robodyn_cli.expr.formula import Formula
from robodyn_cli.expr.graph import Expr, Graph
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.motion import column_order


def time_derivatives(
    formulas: Sequence[Formula], times: Array, parameters: Mapping[str, float], names: Sequence[str]
) -> tuple[Array, Array, Array]:
    """Return values, rates and accelerations (T, n) of formulas in t.

    The derivatives are those of the expressions, not differences. Where the slope jumps (``abs``, ``if``,
    ``min``, ...) they are those of one side, without the impulse of the jump itself.

    Parameters
    ----------
    formulas : in canonical names, of ``t`` and ``p.NAME`` only.
    names : what each formula describes, for errors.

    Raises
    ------
    NumericalError : a value or derivative that is not finite, with its time.
    """
    t, env = time_symbol(parameters)
    whose = [f"{name} = {formula.text!r}" for name, formula in zip(names, formulas)]
    return with_rates([formula.evaluate(env) for formula in formulas], t, times, whose)


def with_rates(x: Sequence[Any], t: Expr, times: Array, whose: Sequence[str]) -> tuple[Array, Array, Array]:
    """Return values, rates and accelerations (T, n) of expressions in t; ``whose`` : what each is, for errors.

    Raises
    ------
    NumericalError : see ``sampled``.
    """
    xd = directional(list(x), [t], [1.0])
    found = sampled([x, xd, directional(xd, [t], [1.0])], times, [whose] * 3)
    return found[0], found[1], found[2]


def time_symbol(parameters: Mapping[str, float]) -> tuple[Expr, dict[str, Any]]:
    """Return the symbol t on a graph of its own, and what formulas in t are evaluated with."""
    t = Graph().symbol("t", "t")
    return t, {"t": t, **{f"p.{name}": value for name, value in parameters.items()}}


def sampled(orders: Sequence[Sequence[Any]], times: Array, whose: Sequence[Sequence[str]]) -> list[Array]:
    """Return values, rates and accelerations (T, n) of expressions in t.

    Parameters
    ----------
    orders : expressions of the three. whose : what each describes, for errors.

    Raises
    ------
    NumericalError : one that is not finite, with its time.
    """
    with np.errstate(all="ignore"):  # what is not finite is reported below, with its time
        columns = evaluate([x for entries in orders for x in entries], {"t": [times]})
    found = []
    for what, entries, names in zip(("value", "rate", "acceleration"), orders, whose):
        array = column_order(columns[: len(entries)], len(times))
        columns = columns[len(entries) :]
        bad = np.argwhere(~np.isfinite(array))
        if bad.size:
            sample, column = bad[0]
            raise NumericalError(f"{names[column]} has no finite {what} at t = {times[sample]:g} s")
        found.append(array)
    return found
