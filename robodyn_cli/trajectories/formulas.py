"""Exact time derivatives of formulas.

Joints that are led by their attitude: from formulas in t to quaternion, velocity and acceleration.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from robodyn_cli.errors import NumericalError
from robodyn_cli.expr.calculus import directional
from robodyn_cli.expr.formula import FormulaTree
from robodyn_cli.expr.graph import Expr, Graph
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.record import mutable_record
from robodyn_cli.spatial import quaternion
from robodyn_cli.spatial.algebra import Array, Vector, vector
from robodyn_cli.trajectories.led import POSITION
from robodyn_cli.trajectories.motion import column_order


def time_derivatives(
    formulas: Sequence[FormulaTree], times: Array, parameters: Mapping[str, float], names: Sequence[str]
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
    arrays = sampled([x, xd, directional(xd, [t], [1.0])], times, [whose] * 3)
    return arrays[0], arrays[1], arrays[2]


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
    arrays = []
    for quantity, entries, names in zip(("value", "rate", "acceleration"), orders, whose):
        array = column_order(columns[: len(entries)], len(times))
        columns = columns[len(entries) :]
        bad = np.argwhere(~np.isfinite(array))
        if bad.size:
            sample, column = bad[0]
            raise NumericalError(f"{names[column]} has no finite {quantity} at t = {times[sample]:g} s")
        arrays.append(array)
    return arrays


FORMS = {
    "quaternion": quaternion.unit,
    "rpy": quaternion.from_rpy,
    "rotation_vector": quaternion.from_rotation_vector,
}


@mutable_record
class JointExpressions:
    """Columns of q, v and v-dot as expressions of t."""

    q: list[Any]
    v: list[Any]
    a: list[Any]


def joint_expressions(given: Mapping[str, Any], columns: Sequence[str], t: Expr) -> JointExpressions:
    """Return the motion of the joints with these columns of q.

    Parameters
    ----------
    given : expressions of t by column, or for the attitude of a joint several under the name of its form, as
        ``ball.rpy``. Whatever form it has, v is the angular velocity in body coordinates; a floating joint's also
        the velocity of its body's origin, in body coordinates.
    """

    def rate(entries: Sequence[Any]) -> list[Any]:
        return directional(list(entries), [t], [1.0])

    motion = JointExpressions([], [], [])
    done: set[str] = set()
    for column in columns:
        joint = column.rpartition(".")[0]
        form = next((x for x in FORMS if f"{joint}.{x}" in given), None)
        if form is None:
            x = [given[column]]
            motion.q += x
            motion.v += rate(x)
            motion.a += rate(rate(x))
            continue
        if joint in done:
            continue
        done.add(joint)
        attitude = FORMS[form](vector(given[f"{joint}.{form}"]))
        v = quaternion.angular_velocity(attitude, vector(rate(list(attitude))))
        place = [given[f"{joint}.{x}"] for x in POSITION if f"{joint}.{x}" in given]
        if place:
            R = quaternion.rotation(attitude)
            along: Vector = R.T @ vector(rate(place))
            v = vector([*along, *v])
        motion.q += [*place, *attitude]
        motion.v += list(v)
        motion.a += rate(list(v))
    return motion


def evaluated(formulas: Mapping[str, Any], env: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of formulas; an attitude's are a tuple of them."""
    return {
        name: [one.evaluate(env) for one in given] if isinstance(given, tuple) else given.evaluate(env)
        for name, given in formulas.items()
    }


def texts(formulas: Mapping[str, Any], column: str) -> str:
    """Return the formulas that a column comes from, for messages."""
    if column in formulas:
        return f"{column} = {formulas[column].text!r}"
    joint = column.rpartition(".")[0]
    form = next(x for x in FORMS if f"{joint}.{x}" in formulas)
    entries: Sequence[FormulaTree] = formulas[f"{joint}.{form}"]
    return f"{joint}.{form} = [{', '.join(f.text for f in entries)}]"
