"""A simulation whose prescribed joints follow a path: their motion along it, found before it begins."""

from __future__ import annotations

import dataclasses
from typing import Any

from robodyn_cli.equations.problem import Problem
from robodyn_cli.record import record
from robodyn_cli.run.fastest.resolve import with_time_law
from robodyn_cli.run.mechanism.motion import by_columns, plan_motion, with_led_point
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.course import Course
from robodyn_cli.trajectories.interpolation import interpolated
from robodyn_cli.trajectories.joint_space import CourseTrajectory
from robodyn_cli.trajectories.led import (
    follow_trajectory,
    given_by_formulas,
    position_columns,
    velocity_columns,
)


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


def with_motion_found(scene: Scene) -> Scene:
    """Return the scene with the motion of the joints that its path leads; positions of them are where they may start.

    Raises
    ------
    CapabilityError : the joints' rates jump on the way. Others as the inverse kinematics and ``with_time_law`` raise.
    """
    formulas = given_by_formulas(scene.prescribed)
    found = {name: x for name, x in scene.prescribed.items() if name not in formulas}
    columns = position_columns(found)
    bare = with_time_law(dataclasses.replace(scene, prescribed=formulas))
    trajectory: Any = bare.trajectory
    if not hasattr(trajectory, "expressions"):
        trajectory = _interpolated(bare, columns)
    rates = velocity_columns(found)
    initial = dataclasses.replace(
        scene.initial,
        q={name: x for name, x in scene.initial.q.items() if name not in columns},
        qd={name: x for name, x in scene.initial.qd.items() if name not in rates},
    )
    prescribed = {**formulas, **follow_trajectory(trajectory, scene.simulate.duration)}
    return dataclasses.replace(scene, trajectory=trajectory, prescribed=prescribed, initial=initial)


def _interpolated(scene: Scene, columns: tuple[str, ...]) -> Interpolated:
    """Return the motion of columns of q along the path, close to the inverse kinematics between its points too."""
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
