"""Torsional spring and damper about an axis, between two bodies."""

from __future__ import annotations

import math
from collections.abc import Iterable

from robodyn_cli.expr.functions import atan2, sqrt
from robodyn_cli.forces.element import (
    Between,
    Effect,
    End,
    HalfTurn,
    Setting,
    between_key,
    idle_problems,
    opposite,
)
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, Direction, Name, Number, key
from robodyn_cli.spatial.algebra import Wrench, dot, rotation_to_z, vector, zeros


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
        Number(angle=True), default=0.0, unit="rad", doc="Angle theta0 at which the spring is free of torque."
    )
    damping: float = key(Number(minimum=0.0), default=0.0, unit="N m s/rad", doc="Damping c.")

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
