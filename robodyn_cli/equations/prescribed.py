"""Rows of joints whose motion is prescribed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from robodyn_cli.algorithms.constraints import coordinate_row
from robodyn_cli.expr.calculus import directional
from robodyn_cli.expr.graph import Expr, Scalar
from robodyn_cli.loops.base import Row
from robodyn_cli.model.model import Body, Model
from robodyn_cli.spatial import quaternion
from robodyn_cli.spatial.algebra import cross, dot, vector, zeros
from robodyn_cli.trajectories.formulas import evaluated, joint_expressions
from robodyn_cli.trajectories.led import POSITION, led_joints, position_columns


def prescribed_rows(
    model: Model,
    q: Sequence[Scalar],
    v: Sequence[Scalar],
    prescribed: Mapping[str, Any],
    env: Mapping[str, Any],
) -> list[Row]:
    """Return the rows of prescribed motions: one for a column, three or six for a joint with an attitude.

    Parameters
    ----------
    prescribed : formulas by column of q, or by form of an attitude. env : what they are evaluated with.
    """
    given, rows = evaluated(prescribed, env), []
    for name in led_joints(given):
        if name in given:
            kind = model.q_units[model.q_names.index(name)]
            rows.append(coordinate_row(f"prescribed.{name}", model, q, {name: 1.0}, given[name], kind))
        else:
            own = {key: x for key, x in given.items() if key.rpartition(".")[0] == name}
            rows += _rows_of_body(model.body_of(name), model.nv, q, v, own, env["t"])
    return rows


def attitude_functions(
    prescribed: Mapping[str, Any], parameters: Mapping[str, float], t: Expr
) -> dict[str, list[Scalar]]:
    """Return what the rows of attitudes depend on, with two derivatives, by joint (``prescribed.ball``).

    Where these functions of t are smooth, the rows are; the rows themselves are long, and their bounds wide.
    """
    env = {"t": t, **{f"p.{name}": value for name, value in parameters.items()}}
    given = evaluated(prescribed, env)
    functions: dict[str, list[Scalar]] = {}
    for joint in (name for name in led_joints(given) if name not in given):
        entries: list[Scalar] = []
        for name, value in given.items():
            if name.rpartition(".")[0] == joint:
                entries += value if isinstance(value, list) else [value]
        rates = directional(entries, [t], [1.0])
        functions[f"prescribed.{joint}"] = [*entries, *rates, *directional(rates, [t], [1.0])]
    return functions


def _rows_of_body(
    body: Body, nv: int, q: Sequence[Scalar], v: Sequence[Scalar], given: Mapping[str, Any], t: Expr
) -> list[Row]:
    """Return the rows of a joint whose body is led, by its attitude and, where it floats, its place."""
    name, count = body.joint_name, body.joint.nv
    motion = joint_expressions(given, position_columns(given), t)
    place = [given[f"{name}.{x}"] for x in POSITION if f"{name}.{x}" in given]
    attitude = vector(q[body.q + len(place) : body.q + body.joint.nq])
    w = vector(v[body.v + count - 3 : body.v + count])
    rows = []
    if place:
        R, u = quaternion.rotation(attitude), vector(v[body.v : body.v + 3])
        rate = directional(place, [t], [1.0])
        turned = R @ cross(w, u)
        for k, (x, xd, xdd) in enumerate(zip(place, rate, directional(rate, [t], [1.0]))):
            psi = zeros(nv)
            psi[body.v : body.v + 3] = R[k]
            rows.append(
                Row(f"prescribed.{name}.{POSITION[k]}", q[body.q + k] - x, psi, turned[k] - xdd, -xd, "m")
            )
    return rows + _attitude_rows(body, nv, (attitude, w), (motion.q[-4:], motion.v[-3:], motion.a[-3:]))


def _attitude_rows(body: Body, nv: int, state: tuple[Any, Any], target: tuple[Any, Any, Any]) -> list[Row]:
    """Return the rows of an attitude: with p = Q* q the turn left from the one that is asked for, eta = 2 vec(p).

    From p-dot = (p (0, w) - (0, W) p) / 2, w and W in body coordinates: Psi = p_0 1 + [p], eta_t = p x W - p_0 W,
    gamma = p_0-dot (w - W) + p-dot x (w + W) + p x W-dot - p_0 W-dot. A full turn, p = (-1, 0), is none.
    """
    (q, w), (Q, W, Wd) = state, (vector(x) for x in target)
    p = quaternion.product(quaternion.conjugate(Q), q)
    p0, x = p[0], p[1:]
    eta_t = cross(x, W) - p0 * W
    psi = zeros(3, nv)
    for k in range(3):
        unit = vector([1.0 if i == k else 0.0 for i in range(3)])
        psi[:, body.v + body.joint.nv - 3 + k] = cross(x, unit) + p0 * unit
    rate = 0.5 * (p0 * (w - W) + cross(x, w + W))
    gamma = -0.5 * dot(x, w - W) * (w - W) + cross(rate, w + W) + cross(x, Wd) - p0 * Wd
    names = [f"prescribed.{body.joint_name}.{x}" for x in ("wx", "wy", "wz")]
    return [Row(n, 2.0 * x[k], psi[k], gamma[k], eta_t[k], "rad") for k, n in enumerate(names)]
