"""Motions that are found before anything asks for them: least times, sequences with paths, joints along a path."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError, RobodynError, SceneError
from robodyn_cli.fastest.resolve import timed_path
from robodyn_cli.given.along import Interpolated, motion_along
from robodyn_cli.given.motion import led_by
from robodyn_cli.record import record
from robodyn_cli.scene.types import Scene
from robodyn_cli.trajectories.base import Lacks, Trajectory
from robodyn_cli.trajectories.course import Course
from robodyn_cli.trajectories.fastest import FastestTrajectory
from robodyn_cli.trajectories.led import (
    follow_trajectory,
    given_by_formulas,
    position_columns,
    velocity_columns,
)
from robodyn_cli.trajectories.legs import Scaling, one_after_another
from robodyn_cli.trajectories.sequence import SequenceTrajectory


def motion_in_time(scene: Scene) -> Any:
    """Return the scene's trajectory with times that follow from the dynamics, a sequence with the motion of the joints.

    Raises
    ------
    SceneError : segments that do not meet. CapabilityError : a path within a mechanism with loops. Others as
    ``timed_path`` and the inverse kinematics raise.
    """
    if isinstance(scene.trajectory, SequenceTrajectory):
        return _joined(scene, scene.trajectory, None)
    if len(parts := scene.trajectory.parts()) > 1 or parts[0][1]:
        return _with_stops(scene, scene.trajectory, None)
    return timed_path(scene, scene.trajectory)


def with_motion_found(scene: Scene) -> Scene:
    """Return the scene with the motion of the joints that its path leads; positions of them are where they may start.

    Raises
    ------
    CapabilityError : the joints' rates jump on the way. Others as ``motion_in_time`` raises.
    """
    formulas = given_by_formulas(scene.prescribed)
    led = {name: x for name, x in scene.prescribed.items() if name not in formulas}
    columns = position_columns(led)
    trajectory = _of_joints(scene, scene.trajectory, columns)
    rates = velocity_columns(led)
    initial = dataclasses.replace(
        scene.initial,
        q={name: x for name, x in scene.initial.q.items() if name not in columns},
        qd={name: x for name, x in scene.initial.qd.items() if name not in rates},
    )
    prescribed = {**formulas, **follow_trajectory(trajectory, scene.simulate.duration)}
    return dataclasses.replace(scene, trajectory=trajectory, prescribed=prescribed, initial=initial)


def _of_joints(scene: Scene, trajectory: Any, columns: Sequence[str] | None, begin: float = 0.0) -> Any:
    """Return a trajectory of the scene in joint space, where a path leads joints with the motion of ``columns`` of q.

    columns : None for all. begin : when it begins [s].
    """
    if isinstance(trajectory, SequenceTrajectory):
        return _joined(scene, trajectory, columns, begin)
    if isinstance(trajectory, FastestTrajectory):
        if len(parts := trajectory.parts()) > 1 or parts[0][1]:
            return _with_stops(scene, trajectory, columns, begin)
        if trajectory.way.lacks is Lacks.JOINTS:
            way = motion_along(Problem(led_by(scene, trajectory.way)), columns)
            jumps = trajectory.way.knots or ()
            trajectory = dataclasses.replace(trajectory, path=dataclasses.replace(way, jumps=jumps))
        return timed_path(scene, trajectory, begin)
    if trajectory.lacks is Lacks.JOINTS:
        return motion_along(Problem(led_by(scene, trajectory)), columns)
    return trajectory


@record
class _Stopping(SequenceTrajectory):
    """A path in the least time that stops on the way."""

    scaling: Scaling | None = None


def _with_stops(
    scene: Scene, trajectory: FastestTrajectory, columns: Sequence[str] | None, begin: float = 0.0
) -> SequenceTrajectory:
    """Return a path in the least time from each stop to the next, and at rest there as long as it stays."""
    found: list[Any] = []
    ways: list[Scaling | float] = []
    for part, dwell in trajectory.parts():
        own = _begun(part, _end(found[-1], scene)) if found else part
        found.append(_of_joints(scene, own, columns, begin + sum(x.duration for x in found)))
        last = found[-1]
        ways.append(last.scaling)
        if dwell:
            ways.append(dwell)
            q = last.motion(np.array([last.duration]), position_columns(last.joints), scene.parameters).q
            course = Course(np.array([0.0, dwell]), [q])
            found.append(Interpolated(position_columns(last.joints), dwell, course))
    return _Stopping("sequence", tuple(found), scaling=one_after_another(ways))


def _joined(
    scene: Scene, sequence: SequenceTrajectory, columns: Sequence[str] | None, begin: float = 0.0
) -> SequenceTrajectory:
    """Return a sequence, which begins at a time [s], with the motion of the joints in each segment."""
    if sequence.repeat > 1 and any(x.changes for x in scene.payloads) and sequence.least_time:
        raise CapabilityError(
            "a sequence in the least time that is repeated does not go with payloads that are gripped or released"
        )
    segments: list[Any] = []
    for k, segment in enumerate(sequence.segments):
        if (scene.loops or scene.couplers) and _leads_point(segment):
            raise CapabilityError(
                "leads a point, and with loops or couplers a sequence leads joints; allowed here: motions of joints",
                key=f"trajectory.segments.{k}",
            )
        own = _begun(segment, _end(segments[-1], scene)) if segments else segment
        try:
            segments.append(_of_joints(scene, own, columns, begin + sum(x.duration for x in segments)))
        except RobodynError as error:
            raise _within(f"trajectory.segments.{k}", error) from None
    joined = dataclasses.replace(sequence, segments=tuple(segments))
    for path, message in joined.meeting_problems(scene.parameters):
        raise SceneError(message, key=".".join(str(x) for x in ("trajectory", *path)))
    return joined


def _within(place: str, error: RobodynError) -> RobodynError:
    """Return an error about a segment, taken for the scene's trajectory, with its place in the sequence."""
    key = str(error.details.get("key", "trajectory"))
    error.details["key"] = place + key.removeprefix("trajectory")
    error.about = (place, *error.about)
    return error


def _leads_point(segment: Trajectory) -> bool:
    way = segment.way if isinstance(segment, FastestTrajectory) else segment
    return bool(way.lacks is Lacks.JOINTS)


def _end(trajectory: Any, scene: Scene) -> dict[str, float]:
    """Return where a motion of joints ends, by column of q; joints that it does not lead are where they start."""
    columns = position_columns(trajectory.joints)
    (q,) = trajectory.motion(np.array([trajectory.duration]), columns, scene.parameters).q
    return {**scene.initial.q, **dict(zip(columns, q.tolist()))}


def _begun(segment: Any, q: Mapping[str, float]) -> Any:
    """Return a segment whose inverse kinematics, where it chooses no branch itself, begins at positions ``q``."""
    if isinstance(segment, FastestTrajectory) and segment.path is not None:
        return dataclasses.replace(segment, path=_begun(segment.path, q))
    ik = segment.ik
    if ik is None or ik.branch is not None or ik.guess:
        return segment
    return dataclasses.replace(segment, ik=dataclasses.replace(ik, guess=dict(q)))
