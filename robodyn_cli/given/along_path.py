"""The motion of all joints that a trajectory leads to, also by polynomials that stand for it in time."""

from __future__ import annotations

from collections.abc import Sequence

from robodyn_cli.equations.problem import Problem
from robodyn_cli.given.motion import by_columns, plan_motion
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.course import Course
from robodyn_cli.trajectories.interpolation import interpolated
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
    if not problem.model.closures:
        return plan_motion(problem, times).motion
    from robodyn_cli.given.guided_motion import guided_motion
    from robodyn_cli.given.loop_conditions import lead_of

    found = guided_motion(problem, lead_of(problem), times)
    if found.stopped is not None:
        raise found.stopped
    return found.motion


def motion_along(problem: Problem, columns: Sequence[str] | None = None) -> Interpolated:
    """Return the motion of columns of q, by default all, close to that of ``motion_at`` at any time.

    Raises
    ------
    CapabilityError : the joints' rates jump on the way. Others as ``motion_at`` raises.
    """
    trajectory, names = problem.scene.trajectory, problem.model.q_names
    led = tuple(names if columns is None else columns)
    places = [names.index(name) for name in led]

    def motion(times: Array) -> tuple[Array, Array, Array]:
        q, v, a = by_columns(problem.model, motion_at(problem, times))
        return q[:, places], v[:, places], a[:, places]

    duration = float(trajectory.duration)
    path = "" if trajectory.point is None else f" along the path of {trajectory.point!r}"
    course = interpolated(motion, duration, trajectory.knots, f"the joints' motion{path}")
    return Interpolated(led, duration, course)
