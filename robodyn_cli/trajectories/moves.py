"""Motion of the joints from way point to way point as fast as limits allow: trapezoidal speed, or S-curves."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from robodyn_cli.expr.functions import cos, sin
from robodyn_cli.expr.graph import Expr
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, JointMap, ListOf, Number, Section, key
from robodyn_cli.spatial import quaternion
from robodyn_cli.spatial.algebra import Array, vector
from robodyn_cli.trajectories.base import (
    Problems,
    SceneNames,
    limit_key,
    limit_problems,
    position_problems,
    with_joint_limits,
)
from robodyn_cli.trajectories.course import Course
from robodyn_cli.trajectories.joint_space import JointSpaceTrajectory, attitude_places
from robodyn_cli.trajectories.led import with_attitudes
from robodyn_cli.trajectories.legs import Leg, TimeLaw, fastest, start_times, superposed

BOUNDS = ("speed", "acceleration", "jerk")
STILL = 1e-14  # rad or m: no way at all


@record
class StopPoint:
    """Where the joints go, and how long they stay."""

    q: dict[str, float] = key(JointMap(Number()), unit="rad or m", doc="Positions of all joints.")
    dwell: float = key(Number(minimum=0.0), default=0.0, unit="s", doc="Time at rest there.")
    duration: float | None = key(
        Number(minimum=0.0, exclusive=True),
        default=None,
        unit="s",
        doc="Time of the way there; by default as short as the limits allow.",
    )


@record
class Moves(JointSpaceTrajectory):
    """What motions from stop to stop share: between two stops the joints move in proportion, on a straight line."""

    bounds: ClassVar[tuple[str, ...]] = BOUNDS[:2]  # it may do without one of the speed

    type: str
    points: tuple[StopPoint, ...] = key(
        ListOf(Section(StopPoint), minimum=2), doc="Way points, in their order."
    )
    speed: dict[str, float] = limit_key("speed", "rad/s or m/s")
    acceleration: dict[str, float] = limit_key("acceleration", "rad/s^2 or m/s^2")
    blend: float = key(
        Number(minimum=0.0, maximum=1.0),
        default=0.0,
        unit="1",
        doc="Part of the braking before a way point during which the joints speed up towards the next one already; "
        "less where limits would be passed. 0: the joints stop at each.",
    )

    @property
    def _limits(self) -> dict[str, dict[str, float]]:
        return {name: getattr(self, name) for name in self.bounds}

    # -- checks ---------------------------------------------------------------------------------------
    def problems(self, scene: SceneNames) -> Problems:
        """Report what single keys cannot tell."""
        problems = list(self._problems(scene))
        yield from problems
        if not problems:
            yield from self.completed(scene)._time_problems()

    def _problems(self, scene: SceneNames) -> Problems:
        needed = tuple(self.points[0].q) if scene.some else scene.columns
        for k, point in enumerate(self.points):
            yield from position_problems(point.q, scene, ("points", k, "q"), needed)
        if self.points[0].duration is not None:
            yield (
                ("points", 0, "duration"),
                "the motion begins here; a duration goes with the way points behind",
            )
        yield from limit_problems(self._limits, scene)
        if self.blend:
            joint = next(iter(attitude_places(tuple(self.points[0].q))), None)
            if joint is not None:
                yield (
                    ("blend",),
                    f"joint {joint!r} turns about an axis of its own between two stops; allowed here: 0",
                )

    def _time_problems(self) -> Problems:
        moving = np.abs(self._ways).max(axis=0) > STILL
        for name in self.bounds[1:]:
            for part, moves in zip(self._parts, moving):
                if moves and part not in getattr(self, name):
                    fault = (
                        f"joint {part!r} has no limit of its {name}, so the time that it needs is not known"
                    )
                    yield (), f"{fault}; give `{name}` here, or in the joint's `limits`"
                    return
        for k, point in enumerate(self.points[1:]):
            least = self._least(k)
            length = 0.0 if least is None else least.course.duration
            if point.duration is not None and point.duration < length * (1.0 - 1e-12):
                fault = f"{point.duration:.6g} s is too short under the limits"
                yield ("points", k + 1, "duration"), f"{fault}; allowed: {length:.9g} s or more"
        if not self.duration > 0.0:
            yield ("points",), "nothing moves, and no time passes"

    def completed(self, scene: SceneNames) -> Moves:
        """Return the trajectory with the limits of the joints where it gives none of its own."""
        return dataclasses.replace(self, **with_joint_limits(self._limits, scene))

    # -- geometry -------------------------------------------------------------------------------------
    @property
    def joints(self) -> tuple[str, ...]:
        """The columns of q whose motion it gives."""
        return tuple(self.points[0].q)

    @cached_property
    def _q(self) -> Array:
        """Positions (N, n) at the way points."""
        return np.array([[p.q[name] for name in self.joints] for p in self.points])

    @cached_property
    def _attitudes(self) -> dict[str, Array]:
        """Rotation vectors (N - 1, 3) of joints with an attitude, from each way point to the next, in body axes."""
        vectors = {}
        for joint, places in attitude_places(self.joints).items():
            each = [vector(row) for row in self._q[:, places].tolist()]
            turns = [quaternion.product(quaternion.conjugate(a), b) for a, b in zip(each, each[1:])]
            vectors[joint] = np.array([quaternion.rotation_vector(x) for x in turns], dtype=float)
        return vectors

    @cached_property
    def _plain(self) -> list[int]:
        """Places of the columns of q that are no entries of quaternions."""
        taken = {k for places in attitude_places(self.joints).values() for k in places}
        return [k for k in range(len(self.joints)) if k not in taken]

    @cached_property
    def _parts(self) -> list[str]:
        """Names of the velocities that the limits are for; a floating joint's are along its way, not along its body."""
        quasi = {*self._attitudes}
        names = []
        for k in self._plain:
            joint, _, coordinate = self.joints[k].rpartition(".")
            names.append(f"{joint}.v{coordinate}" if joint in quasi else self.joints[k])
        return names + [f"{joint}.{x}" for joint in quasi for x in ("wx", "wy", "wz")]

    @cached_property
    def _ways(self) -> Array:
        """Changes (N - 1, m) of the parts from each way point to the next."""
        return np.concatenate([np.diff(self._q[:, self._plain], axis=0), *self._attitudes.values()], axis=1)

    # -- time -----------------------------------------------------------------------------------------
    def _limit(self, name: str) -> Array:
        given = self._limits.get(name, {})
        return np.array([given.get(part, math.inf) for part in self._parts])

    def _least(self, k: int, share: float = 1.0) -> TimeLaw | None:
        """Return the fastest law of the k-th way, with a share of the jerk; None where nothing moves."""
        way = np.abs(self._ways[k])
        moving = way > STILL
        if not moving.any():
            return None
        speed, acceleration, jerk = (float((self._limit(x)[moving] / way[moving]).min()) for x in BOUNDS)
        return fastest(speed, acceleration, share * jerk)

    @cached_property
    def _legs(self) -> list[Leg]:
        """The ways with their times; blended ones have half of the jerk where that makes the motion shorter."""
        blended = self.blend and "jerk" in self.bounds
        timings = [self._timed(share) for share in ((1.0, 0.5) if blended else (1.0,))]
        return min(timings, key=lambda legs: legs[-1].end)

    def _timed(self, share: float) -> list[Leg]:
        laws: list[tuple[TimeLaw | None, float]] = []
        for k, point in enumerate(self.points[1:]):
            law = self._least(k, share)
            if law is not None and point.duration is not None:
                law = self._least(k)
                law = law and law.stretched(max(point.duration, law.course.duration))
            laws.append((law, point.dwell + (0.0 if law is not None else point.duration or 0.0)))
        limits = [self._limit(name) for name in BOUNDS]
        return start_times(laws, self._ways, self.points[0].dwell, self.blend, limits)

    @property
    def duration(self) -> float:
        """Time of the whole motion [s]."""
        return self._legs[-1].end

    @cached_property
    def course(self) -> Course:
        """Columns of q that are no entries of quaternions."""
        return superposed(self._legs, self._ways[:, : len(self._plain)], self._q[0, self._plain])

    @property
    def knots(self) -> tuple[float, ...]:
        return tuple(self.course.knots[1:-1].tolist())

    def expressions(self, t: Expr, env: Mapping[str, Any]) -> Mapping[str, Any]:
        columns = dict(zip([self.joints[k] for k in self._plain], self.course.expressions(t)))
        for joint, places in attitude_places(self.joints).items():
            attitude = vector(self._q[0, places].tolist())
            for leg, turn in zip(self._legs, self._attitudes[joint]):
                angle = math.hypot(*turn)
                if leg.law is not None and angle > 0.0:
                    half = 0.5 * angle * leg.course.at_rest_outside().expressions(t)[0]
                    part = vector([cos(half), *(x / angle * sin(half) for x in turn.tolist())])
                    attitude = quaternion.product(attitude, part)
            columns |= {f"{joint}.{x}": value for x, value in zip(("qw", "qx", "qy", "qz"), attitude)}
        return with_attitudes(columns)


@record
class TrapezoidTrajectory(Moves):
    """From stop to stop in the least time under limits of speed and acceleration: the speed is a trapezoid.

    Accelerations jump; without a limit of the speed it is a triangle.
    """

    type: str = key(Choice(("trapezoid",)), doc="Kind of trajectory.")


@record
class SCurveTrajectory(Moves):
    """From stop to stop in the least time under limits of speed, acceleration and jerk: accelerations do not jump."""

    bounds: ClassVar[tuple[str, ...]] = BOUNDS

    type: str = key(Choice(("s_curve",)), doc="Kind of trajectory.")
    jerk: dict[str, float] = limit_key("rate of the acceleration", "rad/s^3 or m/s^3")
