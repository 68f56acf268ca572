"""A path that is run through as fast as the limits of the drives allow.

The path is given here; how fast it is run through follows from the robot's inverse dynamics, so that a command makes a
``Timed...`` trajectory of it before anything asks for its motion.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from robodyn_cli.expr.graph import Expr
from robodyn_cli.record import record
from robodyn_cli.registry import Registry
from robodyn_cli.schema.fields import Choice, Integer, JointMap, ListOf, Number, OrFile, Section, Tagged, key
from robodyn_cli.schema.spans import Span
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.base import (
    Ik,
    Lacks,
    Problems,
    SceneNames,
    TaskSpaceTrajectory,
    Trajectory,
    limit_key,
    limit_problems,
    position_problems,
    with_joint_limits,
)
from robodyn_cli.trajectories.course import Course
from robodyn_cli.trajectories.joint_space import CourseTrajectory, JointSpaceTrajectory
from robodyn_cli.trajectories.led import position_columns
from robodyn_cli.trajectories.legs import Scaling
from robodyn_cli.trajectories.motion import PointMotion, PoseMotion
from robodyn_cli.trajectories.path import PathTrajectory
from robodyn_cli.trajectories.registry import PACKAGE, PLACES

# whose path can be taken; `fastest` has that of another one itself
path_types: Registry[type] = Registry(PACKAGE, {name: PLACES[name] for name in PLACES if name != "fastest"})
BOUNDS = ("speed", "acceleration", "effort")


@record
class PathPoint:
    """A position that the path goes through."""

    q: dict[str, float] = key(JointMap(Number()), unit="rad or m", doc="Positions of all joints.")


@record
class ThroughPoints(CourseTrajectory):
    """The natural cubic spline through positions, over the polyline's length; two: a straight line."""

    points: tuple[PathPoint, ...]

    @property
    def joints(self) -> tuple[str, ...]:
        return tuple(self.points[0].q)

    @property
    def duration(self) -> float:
        """Length of the parameter."""
        return self.course.duration

    def make_course(self) -> Course:
        q = np.array([[p.q[name] for name in self.joints] for p in self.points])
        s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(q, axis=0), axis=1))])
        if len(q) == 2:
            return Course(s, [q[:1], np.diff(q, axis=0) / s[1]])
        from scipy.interpolate import CubicSpline  # takes long to import: only where it is used

        return Course(s, CubicSpline(s, q, bc_type="natural").c[::-1])


@record
class FastestTrajectory(Trajectory):
    """A path in the least time, from rest to rest, under limits of speed, acceleration and effort of the joints.

    The path is a spline through ``points``, or that of another trajectory, whose own times are dropped.
    """

    lacks, least_time = Lacks.TIMES, True

    type: str = key(Choice(("fastest",)), doc="Kind of trajectory.")
    points: tuple[PathPoint, ...] = key(
        ListOf(Section(PathPoint), minimum=2),
        default=(),
        doc="Positions that the joints go through without a stop, on a cubic spline; two: a straight line.",
    )
    path: Any = key(
        OrFile(Tagged(lambda: path_types)),
        default=None,
        doc="A trajectory whose path is taken, in joint or task space; it must not stand still on the way.",
    )
    speed: dict[str, Span] = limit_key("speed", "rad/s or m/s", spans=True)
    acceleration: dict[str, Span] = limit_key("acceleration", "rad/s^2 or m/s^2", spans=True)
    effort: dict[str, Span] = limit_key("torque or force of the drive", "N m or N", spans=True)
    tolerance: float = key(
        Number(minimum=1e-7, maximum=0.1),
        default=1e-4,
        doc="Error of the duration, in parts of it: the path is divided further until the estimate is below.",
    )
    intervals: int | None = key(
        Integer(minimum=4, maximum=100_000),
        default=None,
        doc="Into how many parts the path is divided; by default as many as `tolerance` needs.",
    )

    def problems(self, scene: SceneNames) -> Problems:
        """Report what single keys cannot tell."""
        if bool(self.points) == (self.path is not None):
            yield (), "needs a path: either 'points' or 'path'"
            return
        if scene.quasi:
            yield (
                (),
                f"joint {scene.quasi[0]!r} has no limits along a path; allowed: joints of one axis or slides",
            )
        for k, point in enumerate(self.points):
            needed = tuple(self.points[0].q) if scene.some else scene.columns
            yield from position_problems(point.q, scene, ("points", k, "q"), needed)
        for k, (one, two) in enumerate(zip(self.points, self.points[1:])):
            if one.q == two.q:
                yield (
                    ("points", k + 1, "q"),
                    "is the position of the way point before it; leave one of them out",
                )
        if self.path is not None and not self.path.in_time:
            yield (
                ("path",),
                "is a sequence with motions of a point or in the least time; allowed: motions of joints",
            )
        elif self.path is not None:
            problems = list(self.path.problems(scene))
            for where, message in problems:
                yield ("path", *where), message
            place = self.path.relative_to
            if not problems and place is not None and scene.moves(place):
                yield ("path", "relative_to"), f"{place!r} moves; allowed: places that stay where they are"
        yield from self._limit_problems(scene)

    def _limit_problems(self, scene: SceneNames) -> Problems:
        yield from limit_problems(self._limits, scene)
        whole = self.completed(scene)
        if not whole.effort and not whole.acceleration:
            yield (), "needs limits: 'effort' or 'acceleration', here or in the joints' `limits`"

    def completed(self, scene: SceneNames) -> FastestTrajectory:
        """Return the trajectory with the limits of the joints where it gives none of its own."""
        limits = with_joint_limits(self._limits, scene, spans=True)
        path = None if self.path is None else self.path.completed(scene)
        return dataclasses.replace(self, path=path, **limits)

    @property
    def _limits(self) -> dict[str, dict[str, Span]]:
        return {name: getattr(self, name) for name in BOUNDS}

    def parts(self) -> list[tuple[FastestTrajectory, float]]:
        """Return the trajectory from each stop of its path to the next, and the time at rest behind it [s]."""
        if not isinstance(self.path, PathTrajectory):
            return [(self, 0.0)]
        return [(dataclasses.replace(self, path=way), dwell) for way, dwell in self.path.ways()]

    @cached_property
    def way(self) -> Any:
        """The path as a trajectory over its own parameter."""
        if self.points:
            return ThroughPoints(self.points)
        return self.path.at_constant_speed()


@record
class Timed(Trajectory):
    """A path with its time law."""

    least_time = True

    way: Any
    scaling: Scaling

    @property
    def duration(self) -> float:
        """Time of the whole path [s]."""
        return self.scaling.law.duration

    @property
    def knots(self) -> tuple[float, ...]:
        return tuple(self.scaling.law.knots[1:-1].tolist())


@record
class TimedJoints(Timed, JointSpaceTrajectory):
    """A path in joint space with its time law."""

    @property
    def joints(self) -> tuple[str, ...]:
        return position_columns(self.way.joints)

    def expressions(self, t: Expr, env: Mapping[str, Any]) -> Mapping[str, Any]:
        (s,) = self.scaling.law.expressions(t)
        columns: Mapping[str, Any] = self.way.expressions(s, {**env, "t": s})
        return columns

    def described(self, column: str) -> str:
        return str(self.way.described(column))


@record
class TimedPath(Timed, TaskSpaceTrajectory):
    """A path in task space with its time law."""

    point: str
    relative_to: str | None
    ik: Ik

    def target(self, times: Array, parameters: Mapping[str, float]) -> PointMotion | PoseMotion:
        """Return what is asked of the point at ``times`` (T,)."""
        law = self.scaling.law
        s, sd, sdd = law(times)[:, 0], law(times, 1), law(times, 2)
        along = self.way.target(s, parameters)
        linear = along.p, along.pd * sd, along.pdd * sd**2 + along.pd * sdd
        if isinstance(along, PoseMotion):
            return PoseMotion(*linear, along.R, along.w * sd, along.wd * sd**2 + along.w * sdd)
        return PointMotion(*linear)


def timed(way: Any, scaling: Scaling) -> TimedJoints | TimedPath:
    """Return a path with its time law."""
    if way.lacks is Lacks.JOINTS:
        return TimedPath(way, scaling, way.point, way.relative_to, way.ik)
    return TimedJoints(way, scaling)


def names_of(limits: Mapping[str, Mapping[str, Span]], columns: Sequence[str]) -> list[tuple[str, str]]:
    """Return the limits as (kind, column of v) in the order of kinds and columns."""
    return [(kind, name) for kind in BOUNDS for name in columns if name in limits.get(kind, {})]
