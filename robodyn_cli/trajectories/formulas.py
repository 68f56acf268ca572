"""Exact time derivatives of formulas."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from robodyn_cli.errors import NumericalError
from robodyn_cli.expr.calculus import directional
from robodyn_cli.expr.formula import Formula
from robodyn_cli.expr.graph import Graph
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.trajectories.motion import Array, column_order


def time_derivatives(
    formulas: Sequence[Formula], times: Array, parameters: Mapping[str, float], names: Sequence[str]
) -> tuple[Array, Array, Array]:
    """Return values, rates and accelerations (T, n) of formulas in t.

    The derivatives are those of the expressions, not differences. At a kink (``abs``, ``if``, ``min``, ...)
    they are those of one side: an acceleration without the jerk of the kink itself.

    Parameters
    ----------
    formulas : in canonical names, of ``t`` and ``p.NAME`` only.
    names : what each formula describes, for errors.

    Raises
    ------
    NumericalError : a value or derivative that is not finite, with its time.
    """
    graph = Graph()
    t = graph.symbol("t", "t")
    env = {"t": t, **{f"p.{name}": value for name, value in parameters.items()}}
    x = [formula.evaluate(env) for formula in formulas]
    xd = directional(x, [t], [1.0])
    xdd = directional(xd, [t], [1.0])
    with np.errstate(all="ignore"):  # what is not finite is reported below, with its time
        columns = evaluate([*x, *xd, *xdd], {"t": [times]})
    n, samples = len(formulas), len(times)
    found = [column_order(columns[k * n : (k + 1) * n], samples) for k in range(3)]
    for what, array in zip(("value", "rate", "acceleration"), found):
        bad = np.argwhere(~np.isfinite(array))
        if bad.size:
            sample, column = bad[0]
            raise NumericalError(
                f"{names[column]} = {formulas[column].text!r} has no finite {what} at t = {times[sample]:g} s"
            )
    return found[0], found[1], found[2]
