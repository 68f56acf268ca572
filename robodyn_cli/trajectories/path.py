"""A frame that goes along lines, arcs, circles and splines and is turned on its way, under limits of its motion."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np

from robodyn_cli.record import record
from robodyn_cli.schema.fields import (
    Choice,
    Direction,
    Either,
    ListOf,
    Number,
    Orientation,
    Section,
    Tagged,
    Text,
    Vector,
    key,
)
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.spatial.orientation import orientation_problems, rotation_of
from robodyn_cli.trajectories.base import Ik, Problems, SceneNames, TaskSpaceTrajectory, relative_key
from robodyn_cli.trajectories.legs import polynomial
from robodyn_cli.trajectories.motion import PointMotion, PoseMotion
from robodyn_cli.trajectories.task.chain import ChainPlan, planned
from robodyn_cli.trajectories.task.segments import PathProblem, segment_types
from robodyn_cli.trajectories.task.stretch import LIMITS


@record
class PathStart:
    """Where a path begins."""

    position: tuple[float, ...] = key(Vector(3), unit="m", doc="Position of the frame.")
    orientation: Orientation | None = key(
        Section(Orientation),
        default=None,
        doc="How the frame is turned; without it, and without `facing`, only its origin is led.",
    )


@record
class PathFacing:
    """Where an axis of the frame looks, all the way."""

    to: Any = key(
        Either((Choice(("tangent",)), Vector(3))),
        unit="m",
        doc="`tangent`: along the path; or a point to look at.",
    )
    axis: str = key(Choice(("x", "y", "z")), default="x", doc="The axis that looks there.")
    up: tuple[float, ...] = key(
        Direction(),
        default=(0.0, 0.0, 1.0),
        unit="1",
        doc="Direction to which the axis after the next one (z after x, x after y, y after z) is as near as it can.",
    )


def _limit(doc: str, unit: str) -> Any:
    return key(Number(minimum=0.0, exclusive=True), default=None, unit=unit, doc=doc)


@record
class PathTrajectory(TaskSpaceTrajectory):
    """Segments one after another; the frame stops between them but where a `blend` says otherwise."""

    type: str = key(Choice(("path",)), doc="Kind of trajectory.")
    point: str = key(
        Text(), doc="The frame that follows: a named frame or point, or `link.end`, with its axes."
    )
    start: PathStart = key(Section(PathStart), doc="Where the path begins.")
    segments: tuple[Any, ...] = key(
        ListOf(Tagged(lambda: segment_types)), doc="The segments, in their order."
    )
    relative_to: str | None = relative_key()
    facing: PathFacing | None = key(
        Section(PathFacing), default=None, doc="Turns the frame along the path or towards a point."
    )
    law: str = key(
        Choice(("s_curve", "trapezoid", "quintic", "cubic")),
        default="s_curve",
        doc="Time law of the arc length from stop to stop.",
    )
    speed: float | None = _limit("Largest speed of the frame's origin.", "m/s")
    acceleration: float | None = _limit("Largest acceleration of it.", "m/s^2")
    jerk: float | None = _limit("Largest rate of its acceleration.", "m/s^3")
    angular_speed: float | None = _limit("Largest angular speed of the frame.", "rad/s")
    angular_acceleration: float | None = _limit("Largest angular acceleration of it.", "rad/s^2")
    angular_jerk: float | None = _limit("Largest rate of its angular acceleration.", "rad/s^3")
    ik: Ik = key(Section(Ik), default=Ik(), doc="Options of the inverse kinematics.")

    # -- checks ---------------------------------------------------------------------------------------
    def problems(self, scene: SceneNames) -> Problems:
        """Report what single keys cannot tell."""
        problems = list(self._problems(scene))
        yield from problems
        if problems:
            return
        try:
            self.plan  # noqa: B018 - what cannot be built says why
        except PathProblem as problem:
            yield problem.path, str(problem)

    def _problems(self, scene: SceneNames) -> Problems:
        yield from super().problems(scene)
        turned = self.start.orientation is not None
        if turned and self.facing is not None:
            yield ("facing",), "does not go with 'start.orientation'; allowed: one of them"
        yield from self._of_points()
        for path, given in self._orientations():
            for where, message in orientation_problems(given):
                yield (*path, *where), message
            if not turned:
                beside = "beside 'facing'" if self.facing is not None else "where 'start' has none"
                yield path, f"does not go {beside}; allowed: with start.orientation"
        if self.law in ("trapezoid", "cubic"):
            for name in ("jerk", "angular_jerk"):
                if getattr(self, name) is not None:
                    yield (name,), f"has no meaning with law {self.law}, whose accelerations jump"
        if not turned and self.facing is None:
            for name in LIMITS[3:]:
                if getattr(self, name) is not None:
                    yield (name,), "limits a turn, and the path leaves the orientation free"

    def _of_points(self) -> Problems:
        """Report orientations of a spline that do not belong to its points one by one."""
        for k, segment in enumerate(self.segments):
            own = segment.orientations
            if not own:
                continue
            if segment.orientation is not None:
                yield ("segments", k, "orientation"), "does not go with 'orientations'; allowed: one of them"
            if len(own) != len(segment.through):
                fault = (
                    f"are {len(own)}; allowed: one for each of the {len(segment.through)} points in 'through'"
                )
                yield ("segments", k, "orientations"), fault

    def _orientations(self) -> list[tuple[tuple[str | int, ...], Orientation]]:
        given = [(("start", "orientation"), self.start.orientation)]
        given += [(("segments", k, "orientation"), x.orientation) for k, x in enumerate(self.segments)]  # type: ignore[misc]
        for k, segment in enumerate(self.segments):
            given += [(("segments", k, "orientations", i), x) for i, x in enumerate(segment.orientations)]  # type: ignore[misc]
        return [(path, x) for path, x in given if x is not None]

    # -- motion ---------------------------------------------------------------------------------------
    @cached_property
    def plan(self) -> ChainPlan:
        """The path from stop to stop, with its times.

        Raises
        ------
        PathProblem
        """
        limits = {name: x for name in LIMITS if (x := getattr(self, name)) is not None}
        start, facing = self.start.orientation, self.facing
        R = None if start is None else np.array(rotation_of(start), dtype=float)
        return planned(np.array(self.start.position), R, facing, self.segments, self.law, limits)

    def at_constant_speed(self) -> PathTrajectory:
        """Return the path without its time law: the arc length of each way between stops is linear in time."""
        path = dataclasses.replace(self)
        for stretch in path.plan.stretches:
            stretch.law = dataclasses.replace(polynomial((0.0, 1.0), stretch.duration), rests=False)
        return path

    def ways(self) -> list[tuple[PathTrajectory, float]]:
        """Return the path from each stop to the next, and the time at rest behind it [s].

        Inverse kinematics of a later one begins where the one before it ends, not on a branch that ``ik`` names.
        """
        found: list[tuple[PathTrajectory, float]] = []
        start, ik, first = self.start, self.ik, 0
        for last, segment in enumerate(self.segments):
            if segment.blend is not None and last < len(self.segments) - 1:
                continue
            own = (*self.segments[first:last], dataclasses.replace(segment, dwell=0.0))
            found.append((dataclasses.replace(self, start=start, segments=own, ik=ik), segment.dwell))
            stretch = self.plan.stretches[len(found) - 1]
            end = stretch.motion(np.array([stretch.duration]))
            R = end.R[0].tolist() if isinstance(end, PoseMotion) and self.facing is None else None
            turned = None if R is None else Orientation(matrix=tuple(tuple(row) for row in R))
            start = PathStart(tuple(end.p[0].tolist()), turned)
            ik, first = dataclasses.replace(self.ik, branch=None, guess={}), last + 1
        return found

    @property
    def duration(self) -> float:
        """Time of the whole path [s]."""
        return float(self.plan.ends[-1])

    @property
    def knots(self) -> tuple[float, ...]:
        """Times at which an acceleration, or a rate of it, jumps."""
        times = [b + x for b, s in zip(self.plan.begins, self.plan.stretches) for x in s.breakpoints()]
        return tuple(sorted({float(x) for x in times if 0.0 < x < self.duration}))

    def target(self, times: Array, parameters: Mapping[str, float]) -> PointMotion | PoseMotion:
        """Return what is asked of the frame at ``times`` (T,), in the coordinates of ``relative_to``."""
        times, plan = np.asarray(times, dtype=float), self.plan
        which = np.clip(np.searchsorted(plan.begins, times, side="right") - 1, 0, len(plan.begins) - 1)
        parts = [
            (which == k, stretch, begin)
            for k, (stretch, begin) in enumerate(zip(plan.stretches, plan.begins))
        ]
        motions = [
            (here, stretch.motion(times[here] - begin)) for here, stretch, begin in parts if here.any()
        ]
        kind = type(motions[0][1])
        columns: dict[str, Array] = {}
        for here, motion in motions:
            for name, x in vars(motion).items():
                columns.setdefault(
                    name, np.empty((len(times), *x.shape[1:]), order="F" if x.ndim == 2 else "C")
                )
                columns[name][here] = x
        return kind(**columns)
