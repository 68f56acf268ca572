"""From a path of a point, or one in the least time, to the motion of the joints that a controller follows."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from functools import cached_property
from typing import Any

from robodyn_cli.equations.control.reference import Sampled
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import SceneError
from robodyn_cli.expr.graph import Expr
from robodyn_cli.run.mechanism.motion import by_columns, plan_motion, with_led_point
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.course import Course
from robodyn_cli.trajectories.led import given_by_formulas


class JointPath:
    """The motion of the joints along a path of a point, as a trajectory in joint space."""

    knots: tuple[float, ...] | None = ()

    def __init__(self, scene: Scene) -> None:
        self.duration = float(scene.trajectory.duration)
        self._problem = Problem(scene)
        self.joints = self._problem.model.q_names
        self.type = scene.trajectory.type

    @cached_property
    def course(self) -> Course:
        """The joints over time, by inverse kinematics at so many instants that the rest can be interpolated."""

        def motion(times: Array) -> tuple[Array, Array, Array]:
            return by_columns(self._problem.model, plan_motion(self._problem, times).motion)

        return Sampled(motion, self.duration).course

    def expressions(self, t: Expr, env: Mapping[str, Any]) -> Mapping[str, Any]:
        """Return the columns of q by name, as expressions of t."""
        return dict(zip(self.joints, self.course.expressions(t)))


def with_joint_reference(scene: Scene) -> Scene:
    """Return the scene whose controller follows a motion in joint space, where it follows any.

    Raises
    ------
    SceneError : the path leads a mechanism with loops. GeometryError, SingularConfigurationError : from the inverse
    kinematics of the path.
    """
    controller = scene.control
    if getattr(controller, "reference", None) is None:
        return scene
    followed = dataclasses.replace(
        scene,
        control=None,
        trajectory=controller.reference,
        prescribed=given_by_formulas(scene.prescribed),
    )
    if controller.reference.type == "fastest":
        from robodyn_cli.run.fastest.resolve import with_time_law

        followed = with_time_law(followed)
    reference = followed.trajectory
    if hasattr(reference, "target") and not controller.at_point:
        if scene.loops or scene.couplers:
            raise SceneError(
                f"{scene.path}: control.reference: a path of a point does not lead the joints of a mechanism "
                "with loops here; allowed: a motion of its driven joints",
                file=scene.path, key="control.reference",
            )  # fmt: skip
        reference = JointPath(with_led_point(followed))
    return dataclasses.replace(scene, control=dataclasses.replace(controller, reference=reference))
