"""What loop closures are made of: rows with eta, Psi and gamma, each written once.

Directions u and n are unit vectors, given in the coordinates of the last common ancestor, fixed in a body.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from robodyn_cli.loops.base import Attitude, LoopFrame, Row
from robodyn_cli.schema.fields import Direction, ListOf, Text, Vector, key
from robodyn_cli.spatial import algebra
from robodyn_cli.spatial.algebra import cross, dot, rotation_rpy, rotation_to_z


def between_key() -> Any:
    """Return the key of the two points that a closure joins."""
    return key(
        ListOf(Text(), minimum=2, maximum=2),
        doc="Two points: `link.end`, `link.origin`, `base.NAME` or a named point.",
    )


def axis_key(doc: str, **default: Any) -> Any:
    """Return the key of a direction (``default`` as in ``key``)."""
    return key(Direction(), unit="1", doc=doc, **default)


def attitude_key() -> Any:
    """Return the key of the attitude in which a closure holds two links."""
    return key(
        Vector(3),
        default=(0.0, 0.0, 0.0),
        unit="rad",
        doc="Attitude of the second link's frame in the first link's: roll, pitch, yaw.",
    )


def direction(frame: LoopFrame, axis: Sequence[float]) -> algebra.Vector:
    """Return the unit vector along ``axis``, which is given in the frame's own axes."""
    return (frame.R @ rotation_to_z(axis))[:, 2]


def across(frame: LoopFrame, axis: Sequence[float]) -> list[algebra.Vector]:
    """Return two unit vectors across ``axis`` and across each other."""
    R = frame.R @ rotation_to_z(axis)
    return [R[:, 0], R[:, 1]]


def coincident(name: str, first: LoopFrame, second: LoopFrame) -> list[Row]:
    """Return the rows x, y, z of p1 = p2: eta = p1 - p2, gamma = a1 - a2, eta_t = drift1 - drift2."""
    d, J, a = first.p - second.p, first.Jv - second.Jv, first.a - second.a
    drift = first.drift - second.drift
    return [Row(f"{name}.{axis}", d[k], J[k], a[k], drift[k]) for k, axis in enumerate("xyz")]


def offset(name: str, u: algebra.Vector, first: LoopFrame, second: LoopFrame) -> Row:
    """Return the row of no offset along u, which is fixed in the first body.

    With d = p1 - p2 and u' = w1 x u: eta = u.d, Psi = u^T (Jv1 - Jv2) + (u x d)^T Jw1,
    gamma = u.(a1 - a2) + (u x d).wd1 + 2 u'.(v1 - v2) + (w1 x u').d, eta_t = u.(drift1 - drift2).
    """
    d = first.p - second.p
    lever, rate = cross(u, d), cross(first.w, u)
    gamma = dot(u, first.a - second.a) + dot(lever, first.wd)
    gamma = gamma + 2.0 * dot(rate, first.v - second.v) + dot(cross(first.w, rate), d)
    psi = u @ (first.Jv - second.Jv) + lever @ first.Jw
    return Row(name, dot(u, d), psi, gamma, dot(u, first.drift - second.drift))


def on_line(name: str, axis: Sequence[float], first: LoopFrame, second: LoopFrame) -> list[Row]:
    """Return the rows across1, across2 of the second point on the line along ``axis`` through the first."""
    return [offset(f"{name}.across{k}", u, first, second) for k, u in enumerate(across(first, axis), start=1)]


def distance(name: str, length: float, first: LoopFrame, second: LoopFrame) -> Row:
    """Return the row of a constant distance L, in metres and without a root: eta = (d.d - L^2) / (2 L).

    With d = p1 - p2: Psi = d^T (Jv1 - Jv2) / L, gamma = (d.(a1 - a2) + |v1 - v2|^2) / L,
    eta_t = d.(drift1 - drift2) / L. The multiplier is the force in the bar, positive where it pushes the points apart.
    """
    d, v = first.p - second.p, first.v - second.v
    eta = (dot(d, d) - length * length) * (0.5 / length)
    gamma = (dot(d, first.a - second.a) + dot(v, v)) * (1.0 / length)
    eta_t = dot(d, first.drift - second.drift) * (1.0 / length)
    return Row(name, eta, (d @ (first.Jv - second.Jv)) * (1.0 / length), gamma, eta_t)


def perpendicular(
    name: str,
    u: algebra.Vector,
    n: algebra.Vector,
    first: LoopFrame,
    second: LoopFrame,
    attitude: Attitude | None = None,
) -> Row:
    """Return the row of u in the first body staying perpendicular to n in the second: eta = u.n.

    Psi = (u x n)^T (Jw1 - Jw2), gamma = (u x n).(wd1 - wd2) + d/dt(u x n).(w1 - w2).
    """
    lever = cross(u, n)
    rate = cross(cross(first.w, u), n) + cross(u, cross(second.w, n))
    gamma = dot(lever, first.wd - second.wd) + dot(rate, first.w - second.w)
    return Row(name, dot(u, n), lever @ (first.Jw - second.Jw), gamma, kind="moment", attitude=attitude)


def parallel(
    name: str, axis: Sequence[float], axis2: Sequence[float] | None, first: LoopFrame, second: LoopFrame
) -> list[Row]:
    """Return the rows axis1, axis2 of parallel axes: components of the second across the first.

    They vanish where the axes point opposite ways as well; the rows' attitude tells that apart.
    """
    e, f = first.R @ rotation_to_z(axis), second.R @ rotation_to_z(axis2 or axis)
    attitude = Attitude(e, f, second.Jw - first.Jw, of_axes=True)
    return [perpendicular(f"{name}.axis{k + 1}", e[:, k], f[:, 2], first, second, attitude) for k in range(2)]


def aligned(name: str, rpy: Sequence[float], first: LoopFrame, second: LoopFrame) -> list[Row]:
    """Return the rows turn_x, turn_y, turn_z of no relative rotation.

    With e the axes of the attitude wanted (``rpy`` in the first body) and f those of the second: e_y.f_z,
    e_z.f_x and e_x.f_y vanish. They do so half a turn away as well; the rows' attitude tells that apart.
    """
    e, f = first.R @ rotation_rpy(rpy), second.R
    attitude = Attitude(e, f, second.Jw - first.Jw)
    rows = []
    for k, axis in enumerate("xyz"):
        i, j = (k + 1) % 3, (k + 2) % 3
        rows.append(perpendicular(f"{name}.turn_{axis}", e[:, i], f[:, j], first, second, attitude))
    return rows
