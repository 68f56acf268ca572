"""The motion of all joints that a trajectory leads to, also by polynomials that stand for it in time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.given.guided_motion import guided_motion
from robodyn_cli.given.loop_conditions import lead_of
from robodyn_cli.given.motion import Planned, by_columns, motion_near, plan_motion
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.course import Course, interpolated
from robodyn_cli.trajectories.joint_space import CourseTrajectory
from robodyn_cli.trajectories.motion import JointMotion


@record
class Interpolated(CourseTrajectory):
    """The motion of joints by quintics through positions, rates and accelerations.

    jumps : times at which accelerations jump; None to end steps at all points that the quintics go through.
    """

    columns: tuple[str, ...]
    duration: float
    through: Course
    jumps: tuple[float, ...] | None = None

    @property
    def joints(self) -> tuple[str, ...]:
        return self.columns

    def make_course(self) -> Course:
        return self.through

    @property
    def knots(self) -> tuple[float, ...]:
        return super().knots if self.jumps is None else self.jumps


def motion_at(problem: Problem, times: Array) -> JointMotion:
    """Return the motion of all joints at ``times`` (T,) that the scene's trajectory, and its loops, lead to.

    Raises
    ------
    GeometryError, SingularConfigurationError : it ends before. Others as ``plan_motion`` and ``guided_motion`` raise.
    """
    return _planned(problem, times).motion


def _planned(problem: Problem, times: Array) -> Planned:
    """Return the same with how it was found."""
    if not problem.model.closures:
        return plan_motion(problem, times)
    guided = guided_motion(problem, lead_of(problem), times)
    if guided.stopped is not None:
        raise guided.stopped
    return guided


class MotionAlong:
    """The motion of all joints at any times, followed once; from then on it is solved at new times, all at once, from
    what is known at those around them.

    What does not count there (see ``Planned.near``) is followed anew.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.known: Planned | None = None

    def __call__(self, times: Array) -> JointMotion:
        """Return the motion at ``times`` (T,), increasing, from the start of the motion to its end.

        Raises
        ------
        Those of ``motion_at``.
        """
        if self.known is None or not self._extend(self.known, times):
            self.known = _planned(self.problem, times)
        rows = np.searchsorted(self.known.times, times)
        motion = self.known.motion
        return JointMotion(*(np.asfortranarray(x[rows]) for x in (motion.q, motion.qd, motion.qdd)))

    def _extend(self, known: Planned, times: Array) -> bool:
        """Add the motion at those times that it is not known at; False where that is not possible."""
        new = times[~np.isin(times, known.times)]
        if new.size and known.near is not None:
            found = motion_near(self.problem.model, known, new)
            if found is None:
                return False
            every = np.concatenate([known.times, new])
            order = np.argsort(every, kind="stable")
            pairs = ((getattr(known.motion, name), getattr(found, name)) for name in ("q", "qd", "qdd"))
            motion = JointMotion(*(np.concatenate(pair)[order] for pair in pairs))
            self.known = Planned(every[order], motion, near=known.near)
        return not new.size or known.near is not None


def motion_along(problem: Problem, columns: Sequence[str] | None = None) -> Interpolated:
    """Return the motion of columns of q, by default all, close to that of ``motion_at`` at any time.

    Raises
    ------
    CapabilityError : the joints' rates jump on the way. Others as ``motion_at`` raises.
    """
    trajectory, names = problem.scene.trajectory, problem.model.q_names
    led = tuple(names if columns is None else columns)
    places = [names.index(name) for name in led]

    along = MotionAlong(problem)

    def motion(times: Array) -> tuple[Array, Array, Array]:
        q, v, a = by_columns(problem.model, along(times))
        return q[:, places], v[:, places], a[:, places]

    duration = float(trajectory.duration)
    path = "" if trajectory.point is None else f" along the path of {trajectory.point!r}"
    course = interpolated(motion, duration, trajectory.knots, f"the joints' motion{path}")
    return Interpolated(led, duration, course)
