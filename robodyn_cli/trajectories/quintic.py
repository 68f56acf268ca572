"""Joint motion through way points, quintic between them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, JointMap, ListOf, Number, Section, key
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.base import (
    Problems,
    SceneNames,
    attitude_problems,
    joint_problems,
    led_joints,
    time_problems,
)
from robodyn_cli.trajectories.motion import JointMotion
from robodyn_cli.trajectories.quintic_spline import QuinticSpline


@record
class WayPoint:
    """A time and what the joints do there."""

    t: float = key(Number(minimum=0.0), unit="s", doc="Time.")
    q: dict[str, float] = key(JointMap(Number(angle=True)), unit="rad or m", doc="Positions of all joints.")
    qd: dict[str, float] = key(
        JointMap(Number(angle=True), coordinates="v"),
        default=None,
        unit="rad/s or m/s",
        doc="Rates of all joints.",
    )
    qdd: dict[str, float] = key(
        JointMap(Number(angle=True), coordinates="v"),
        default=None,
        unit="rad/s^2 or m/s^2",
        doc="Accelerations of all joints.",
    )


@record
class QuinticTrajectory:
    """Quintic polynomials through way points; the duration is that of the last point.

    Rates and accelerations at the first and the last point are zero unless they are given. At an inner point
    they are kept where given and otherwise chosen so that the jerk is least, which makes the motion four
    times continuously differentiable there.
    """

    type: str = key(Choice(("quintic",)), doc="Kind of trajectory.")
    points: tuple[WayPoint, ...] = key(ListOf(Section(WayPoint), minimum=2), doc="Way points, times from 0.")

    def problems(self, scene: SceneNames) -> Problems:
        """Report what single keys cannot tell."""
        yield from attitude_problems("quintic polynomial", scene)
        needed = led_joints(self.joints, scene)
        for k, point in enumerate(self.points):
            yield from joint_problems(tuple(point.q), scene.joints, ("points", k, "q"), needed)
            for name in ("qd", "qdd"):
                if getattr(point, name):
                    yield from joint_problems(
                        tuple(getattr(point, name)), scene.joints, ("points", k, name), needed
                    )
        yield from time_problems(
            [p.t for p in self.points], [("points", k, "t") for k in range(len(self.points))]
        )

    @property
    def joints(self) -> tuple[str, ...]:
        """The joints whose motion it gives."""
        return tuple(self.points[0].q)

    @property
    def duration(self) -> float:
        """Time of the last way point [s]."""
        return self.points[-1].t

    def motion(self, times: Array, joints: Sequence[str], parameters: Mapping[str, float]) -> JointMotion:
        """Return the motion of ``joints`` at ``times`` (T,)."""
        q = np.array([[p.q[name] for name in joints] for p in self.points])
        given = []
        for key_name in ("qd", "qdd"):
            values: list[list[float]] = []
            for k, point in enumerate(self.points):
                stated = getattr(point, key_name)
                free = 0.0 if k in (0, len(self.points) - 1) else np.nan
                values.append([stated.get(name, free) for name in joints])
            given.append(np.array(values))
        spline = QuinticSpline(np.array([p.t for p in self.points]), q, *given)
        return JointMotion(*spline(np.asarray(times)))
