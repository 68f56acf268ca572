"""A point that runs along a circle."""

from __future__ import annotations

import dataclasses

from robodyn_cli.schema.fields import Choice, ListOf, Number, Section, Text, Vector, key
from robodyn_cli.trajectories.base import Ik, Problems, SceneNames, point_problems


@dataclasses.dataclass(frozen=True)
class CircleTrajectory:
    """``p = center + radius (u cos phi + v sin phi)``, phi from ``start`` at constant rate over ``turns``."""

    type: str = key(Choice(("circle",)), doc="Kind of trajectory.")
    point: str = key(Text(), doc="The point that follows: a named point, or `link.end`.")
    center: tuple[float, ...] = key(
        ListOf(Number(), minimum=2, maximum=3), unit="m", doc="Centre (x, y) or (x, y, z)."
    )
    radius: float = key(Number(minimum=0.0, exclusive=True), unit="m", doc="Radius.")
    duration: float = key(Number(minimum=0.0, exclusive=True), unit="s", doc="Time of the whole motion.")
    start: float = key(Number(angle=True), default=0.0, unit="rad", doc="Angle phi at t = 0.")
    turns: float = key(Number(), default=1.0, unit="1", doc="Number of turns; negative: the other way round.")
    normal: tuple[float, ...] = key(
        Vector(3), default=(0.0, 0.0, 1.0), unit="1", doc="Normal of the circle's plane."
    )
    ik: Ik = key(Section(Ik), default=Ik(), doc="Options of the inverse kinematics.")

    def problems(self, scene: SceneNames) -> Problems:
        """Report what single keys cannot tell."""
        yield from point_problems(self.point, self.ik, scene)
        if not any(self.normal):
            yield ("normal",), "must not be zero (value [0, 0, 0])"
        if self.turns == 0.0:
            yield ("turns",), "must not be zero"
