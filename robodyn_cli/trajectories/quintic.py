"""Joint motion through way points, quintic between them."""

from __future__ import annotations

import dataclasses

from robodyn_cli.schema.fields import Choice, ListOf, MapOf, Number, Section, key
from robodyn_cli.trajectories.base import Problems, SceneNames, joint_problems, time_problems


@dataclasses.dataclass(frozen=True)
class WayPoint:
    """A time and what the joints do there."""

    t: float = key(Number(minimum=0.0), unit="s", doc="Time.")
    q: dict[str, float] = key(
        MapOf(Number(angle=True), of="joint"), unit="rad or m", doc="Positions of all joints."
    )
    qd: dict[str, float] = key(
        MapOf(Number(angle=True), of="joint"), default=None, unit="rad/s or m/s", doc="Rates of all joints."
    )
    qdd: dict[str, float] = key(
        MapOf(Number(angle=True), of="joint"),
        default=None,
        unit="rad/s^2 or m/s^2",
        doc="Accelerations of all joints.",
    )


@dataclasses.dataclass(frozen=True)
class QuinticTrajectory:
    """Quintic polynomials through way points; the duration is that of the last point."""

    type: str = key(Choice(("quintic",)), doc="Kind of trajectory.")
    points: tuple[WayPoint, ...] = key(ListOf(Section(WayPoint), minimum=2), doc="Way points, times from 0.")

    def problems(self, scene: SceneNames) -> Problems:
        """Report what single keys cannot tell."""
        for k, point in enumerate(self.points):
            yield from joint_problems(tuple(point.q), scene.joints, ("points", k, "q"))
            for name in ("qd", "qdd"):
                if getattr(point, name):
                    yield from joint_problems(tuple(getattr(point, name)), scene.joints, ("points", k, name))
        yield from time_problems(
            [p.t for p in self.points], [("points", k, "t") for k in range(len(self.points))]
        )
