"""Springs and dampers: in joints, along the line between two points, and about an axis between two bodies."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any, ClassVar

from robodyn_cli.expr.functions import atan2, maximum, sqrt
from robodyn_cli.forces.element import (
    Between,
    Effect,
    End,
    HalfTurn,
    InJoint,
    LineOfAction,
    Setting,
    along,
    between_key,
    idle_problems,
    opposite,
)
from robodyn_cli.record import record
from robodyn_cli.schema.fields import (
    Choice,
    Direction,
    Either,
    Formula,
    ListOf,
    Name,
    Number,
    Section,
    Vector,
    key,
    role_key,
)
from robodyn_cli.spatial.algebra import Wrench, dot, rotation_to_z, vector, zeros


@record
class Spring(InJoint):
    """Torque ``tau = -k (q - q0)``; potential energy ``k (q - q0)^2 / 2``.

    On a rotation or translation in space it is a bushing with the same stiffness in all directions: ``-k phi``, phi the
    rotation vector from the attitude at rest, and ``k |phi|^2 / 2``.
    """

    term: ClassVar[str] = "passive"

    stiffness: float = key(Number(minimum=0.0), unit="N m/rad or N/m", doc="Stiffness k.")
    rest: Any = key(
        Either((Number(), Vector(3))),
        default=0.0,
        unit="rad or m",
        doc="Position q0 at which the torque is zero; in space a rotation vector or a displacement.",
    )
    role: str = role_key("spring")

    def problems_along(self, in_space: bool) -> Iterable[tuple[tuple[Any, ...], str]]:
        if in_space and not isinstance(self.rest, tuple) and self.rest != 0.0:
            yield ("rest",), "must be three numbers here, a rotation vector or a displacement"
        if not in_space and isinstance(self.rest, tuple):
            yield ("rest",), "must be one number here, the position of the coordinate"

    def torque(self, q: Any, qd: Any, gear_ratio: float, smooth: bool) -> Any:
        """Return the torque on the joint [N m or N] at position ``q`` and rate ``qd``."""
        return -self.stiffness * (q - self.rest)

    def potential(self, q: Any) -> Any:
        return 0.5 * self.stiffness * (q - self.rest) * (q - self.rest)


@record
class Damper(InJoint):
    """Torque ``tau = -c qd``; in a ball joint ``-c w``, against the angular velocity."""

    term: ClassVar[str] = "passive"
    dissipative: ClassVar[bool] = True

    damping: float = key(Number(minimum=0.0), unit="N m s/rad or N s/m", doc="Damping c.")
    role: str = role_key("friction")

    def problems_along(self, in_space: bool) -> Iterable[tuple[tuple[Any, ...], str]]:
        return ()

    def torque(self, q: Any, qd: Any, gear_ratio: float, smooth: bool) -> Any:
        """Return the torque on the joint [N m or N]."""
        return -self.damping * qd


@record
class LinearSpring(Between):
    """Tension ``k (l - l0) + c dl/dt`` along the line between two points; potential energy ``k (l - l0)^2 / 2``."""

    name: str = key(Name(of="force"), doc="Name.")
    type: str = key(Choice(("spring",)), doc="Kind of force.")
    between: tuple[str, ...] = between_key()
    stiffness: float = key(Number(minimum=0.0), default=0.0, unit="N/m", doc="Stiffness k.")
    length: float = key(
        Number(minimum=0.0), default=0.0, unit="m", doc="Length l0 at which the spring is free of force."
    )
    damping: float = key(Number(minimum=0.0), default=0.0, unit="N s/m", doc="Damping c.")
    role: str = role_key("spring")

    def problems(self) -> Iterable[tuple[tuple[str, ...], str]]:
        return idle_problems(self.stiffness, self.damping)

    def effect(self, ends: tuple[End, ...], setting: Setting) -> Effect:
        """Return forces, energy and power; the direction is lost where the points meet and ``length`` is not 0."""
        k, c = self.stiffness, self.damping
        if self.length == 0.0 and c == 0.0:
            # without a free length the force is linear in the distance and needs no direction
            d = ends[1].p - ends[0].p
            return Effect(along(d * k), 0.5 * k * dot(d, d))
        line = LineOfAction.of(ends)
        stretch = line.length - self.length
        loss = c * line.rate
        return Effect(line.pull(k * stretch + loss), 0.5 * k * stretch * stretch, -loss * line.rate)


ROWS = 100  # each bend of a table is an event of the simulation


@record
class LengthTable:
    """Tension over length; linear between rows, held beyond the ends."""

    table: tuple[tuple[float, ...], ...] = key(
        ListOf(Vector(2), minimum=2, maximum=ROWS),
        unit="m, N",
        doc="Rows of length and tension, lengths increasing.",
    )


@record
class RateTable:
    """Force over rate; linear between rows, held beyond the ends."""

    table: tuple[tuple[float, ...], ...] = key(
        ListOf(Vector(2), minimum=2, maximum=ROWS),
        unit="m/s, N",
        doc="Rows of rate and force, rates increasing.",
    )


@record
class NonlinearSpring(Between):
    """Tension ``F(l, dl/dt)`` along the line between two points, from tables or a formula.

    A table F(l) has the potential energy ``integral of F dl``, zero at the length of its first row; the power of
    damping, and of a formula, is counted as work.
    """

    switching: ClassVar[bool] = True

    name: str = key(Name(of="force"), doc="Name.")
    type: str = key(Choice(("nonlinear_spring",)), doc="Kind of force.")
    between: tuple[str, ...] = between_key()
    tension: Any = key(
        Either((Formula(("t", "q", "qd", "length", "rate")), Section(LengthTable))),
        default=None,
        unit="N",
        doc="Tension, positive where it pulls the points together: a formula, in which `length` [m] and `rate` [m/s] "
        "are those of the line, or a table over the length.",
    )
    damping: Any = key(
        Either((Number(minimum=0.0), Section(RateTable))),
        default=0.0,
        unit="N s/m",
        doc="Added to the tension: c dl/dt, or a table over the rate.",
    )
    role: str = role_key("spring")

    def problems(self) -> Iterable[tuple[tuple[Any, ...], str]]:
        """Yield what does not fit together."""
        if self.tension is None and self.damping == 0.0:
            yield (), "needs a 'tension' or a 'damping' that is not zero"
        for name in ("tension", "damping"):
            value = getattr(self, name)
            if not isinstance(value, (LengthTable, RateTable)):
                continue
            xs = [row[0] for row in value.table]
            for k, (before, x) in enumerate(zip(xs, xs[1:]), start=1):
                if not x > before:
                    yield (
                        (name, "table", k, 0),
                        f"must increase from row to row (value {x!r} after {before!r})",
                    )
            if name == "tension" and xs[0] < 0.0:
                yield (name, "table", 0, 0), f"is a length and must not be negative (value {xs[0]!r})"
            if name == "damping" and any(rate * force < 0.0 for rate, force in value.table):
                yield (name, "table"), "drives where it should brake: a force must have the sign of its rate"
            if name == "damping" and (0.0, 0.0) not in value.table:
                yield (name, "table"), "needs the row [0, 0]: without a rate there is no damping"

    def effect(self, ends: tuple[End, ...], setting: Setting) -> Effect:
        """Return forces, energy and power; the direction is lost where the points meet."""
        line = LineOfAction.of(ends)
        loss = (
            _table(self.damping.table, line.rate)
            if isinstance(self.damping, RateTable)
            else self.damping * line.rate
        )
        if isinstance(self.tension, LengthTable):
            elastic, stored = _table(self.tension.table, line.length), _area(self.tension.table, line.length)
            return Effect(line.pull(elastic + loss), stored, -loss * line.rate)
        if self.tension is not None:
            loss = loss + self.tension.evaluate({**setting.values, "length": line.length, "rate": line.rate})
        return Effect(line.pull(loss), 0.0, -loss * line.rate)


def _bends(table: Sequence[Sequence[float]]) -> list[tuple[float, float]]:
    """Return where the slope of a piecewise linear function changes, and by how much; it is 0 beyond the ends."""
    slopes = [0.0, *((b[1] - a[1]) / (b[0] - a[0]) for a, b in zip(table, table[1:])), 0.0]
    return [(row[0], after - before) for row, before, after in zip(table, slopes, slopes[1:])]


def _table(table: Sequence[Sequence[float]], x: Any) -> Any:
    """Return y_0 + sum of (change of slope) max(x - x_i, 0)."""
    return sum((bend * maximum(x - at, 0.0) for at, bend in _bends(table)), table[0][1])


def _area(table: Sequence[Sequence[float]], x: Any) -> Any:
    """Return the integral of ``_table`` from the first row to x."""
    first, y = table[0]
    parts = ((at, 0.5 * bend) for at, bend in _bends(table))
    return sum((half * maximum(x - at, 0.0) * maximum(x - at, 0.0) for at, half in parts), y * (x - first))


@record
class ConstantForce(Between):
    """Constant tension ``F`` along the line between two points; potential energy ``F l``."""

    name: str = key(Name(of="force"), doc="Name.")
    type: str = key(Choice(("constant_force",)), doc="Kind of force.")
    between: tuple[str, ...] = between_key()
    force: float = key(Number(), unit="N", doc="Tension; positive pulls the points together.")
    role: str = role_key("spring")

    def effect(self, ends: tuple[End, ...], setting: Setting) -> Effect:
        """Return forces and energy; the direction is lost where the points meet."""
        line = LineOfAction.of(ends)
        return Effect(line.pull(self.force), self.force * line.length)


@record
class TorsionalSpring(Between):
    """Torque ``-(k (theta - theta0) + c dtheta/dt)`` about an axis; potential energy ``k (theta - theta0)^2 / 2``.

    theta is the angle by which the second frame is turned against the first about ``axis``, zero where their axes
    coincide. Full turns are counted where all joints between the bodies turn about parallels of the axis. Where the
    bodies also turn about other axes, it is the angle between the projections of the frames' transverse axes onto the
    plane across the axis of the first, at most half a turn from ``rest``, and the moment is its gradient, which jumps
    at half a turn.
    """

    name: str = key(Name(of="force"), doc="Name.")
    type: str = key(Choice(("torsional_spring",)), doc="Kind of force.")
    between: tuple[str, ...] = between_key()
    axis: tuple[float, ...] = key(
        Direction(), default=(0.0, 0.0, 1.0), unit="1", doc="Axis, in the frame of each of the two places."
    )
    stiffness: float = key(Number(minimum=0.0), default=0.0, unit="N m/rad", doc="Stiffness k.")
    rest: float = key(
        Number(), default=0.0, unit="rad", doc="Angle theta0 at which the spring is free of torque."
    )
    damping: float = key(Number(minimum=0.0), default=0.0, unit="N m s/rad", doc="Damping c.")
    role: str = role_key("spring")

    def problems(self) -> Iterable[tuple[tuple[str, ...], str]]:
        return idle_problems(self.stiffness, self.damping)

    def effect(self, ends: tuple[End, ...], setting: Setting) -> Effect:
        """Return moments, energy and power.

        With the second frame's transverse axis x2 = (c, s, u) in the axes of the first (z along the axis) and w
        the relative angular velocity: theta = atan2(s, c), dtheta/dt = g . w,
        g = (-c u, -s u, c^2 + s^2) / (c^2 + s^2).
        """
        A = rotation_to_z(self.axis)
        first, second = (end.R @ A for end in ends)
        turned = setting.turn(self.axis)
        half_turns: tuple[HalfTurn, ...] = ()
        if turned is not None:
            deflection = turned - self.rest
            gradient = vector([0.0, 0.0, 1.0])
        else:
            x = first.T @ second[:, 0]
            c, s, u = x
            cr, sr = math.cos(self.rest), math.sin(self.rest)
            from_rest, along = s * cr - c * sr, c * cr + s * sr
            deflection = atan2(from_rest, along)  # half a turn to either side of rest
            square = c * c + s * s
            half_turns = (HalfTurn.of(deflection, from_rest, along, sqrt(square)),)
            gradient = vector([-c * u / square, -s * u / square, 1.0])
        direction = first @ gradient
        rate = dot(direction, ends[1].w - ends[0].w)
        loss = self.damping * rate
        moment = direction * -(self.stiffness * deflection + loss)
        actions = opposite(ends, Wrench(moment, zeros(3)))
        potential = 0.5 * self.stiffness * deflection * deflection
        return Effect(actions, potential, -loss * rate, half_turns if self.stiffness else ())
