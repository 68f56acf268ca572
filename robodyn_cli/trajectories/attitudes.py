"""Joints that are led by their attitude: from formulas in t to quaternion, velocity and acceleration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from robodyn_cli.expr.calculus import directional
from robodyn_cli.expr.formula import Formula
from robodyn_cli.expr.graph import Expr
from robodyn_cli.record import mutable_record
from robodyn_cli.spatial import quaternion
from robodyn_cli.spatial.algebra import Vector, vector
from robodyn_cli.trajectories.led import POSITION

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

    found = JointExpressions([], [], [])
    done: set[str] = set()
    for column in columns:
        joint = column.rpartition(".")[0]
        form = next((x for x in FORMS if f"{joint}.{x}" in given), None)
        if form is None:
            x = [given[column]]
            found.q += x
            found.v += rate(x)
            found.a += rate(rate(x))
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
        found.q += [*place, *attitude]
        found.v += list(v)
        found.a += rate(list(v))
    return found


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
    entries: Sequence[Formula] = formulas[f"{joint}.{form}"]
    return f"{joint}.{form} = [{', '.join(f.text for f in entries)}]"
