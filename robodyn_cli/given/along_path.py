"""The motion of the joints along a path, by polynomials through what the inverse kinematics finds."""

from __future__ import annotations

from typing import Any

from robodyn_cli.equations.problem import Problem
from robodyn_cli.given.motion import by_columns, plan_motion, with_led_point
from robodyn_cli.record import record
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.course import Course
from robodyn_cli.trajectories.interpolation import interpolated
from robodyn_cli.trajectories.joint_space import CourseTrajectory


@record
class Interpolated(CourseTrajectory):
    """The motion of joints by quintics through positions, rates and accelerations.

    jumps : times at which accelerations jump; None to end steps at all points that the quintics go through.
    """

    joints: tuple[str, ...]
    duration: float
    through: Course
    jumps: tuple[float, ...] | None = None

    def make_course(self) -> Course:
        return self.through

    @property
    def knots(self) -> tuple[float, ...]:  # type: ignore[override]
        return super().knots if self.jumps is None else self.jumps


def motion_along(scene: Scene, columns: tuple[str, ...]) -> Interpolated:
    """Return the motion of columns of q along the path, close to the inverse kinematics between its points too.

    Raises
    ------
    CapabilityError : the joints' rates jump on the way. Others as the inverse kinematics raises.
    """
    problem = Problem(with_led_point(scene))
    trajectory: Any = scene.trajectory
    places = [problem.model.q_names.index(name) for name in columns]

    def motion(times: Array) -> tuple[Array, Array, Array]:
        q, v, a = by_columns(problem.model, plan_motion(problem, times).motion)
        return q[:, places], v[:, places], a[:, places]

    duration = float(trajectory.duration)
    what = f"the joints' motion along the path of {trajectory.point!r}"
    course = interpolated(motion, duration, getattr(trajectory, "knots", None), what)
    return Interpolated(columns, duration, course)
