"""From what a controller is asked to follow to the motion of the joints that it follows."""

from __future__ import annotations

import dataclasses
from typing import Any

from robodyn_cli.equations.problem import Problem
from robodyn_cli.given.along_path import Interpolated, motion_along
from robodyn_cli.ready.doors import along, at_rest
from robodyn_cli.ready.prepare import prepare
from robodyn_cli.scene.types import Scene
from robodyn_cli.trajectories.base import Lacks
from robodyn_cli.trajectories.course import held


def with_joint_reference(scene: Scene) -> Scene:
    """Return the scene whose controller follows a motion in joint space, where it follows any.

    In a mechanism with loops that is a motion of all joints where the law needs one, or where other joints than the
    driven ones lead: the loops give the rest.

    Raises
    ------
    GeometryError, SingularConfigurationError : from the inverse kinematics of the path, or from the loops.
    CapabilityError : the motion is not smooth.
    """
    controller = scene.control
    loops = bool(scene.loops or scene.couplers)
    ahead = loops and controller.type == "feed_forward"
    if controller.reference is None:
        return _with_reference(scene, _start_held(scene)) if ahead else scene
    followed = along(dataclasses.replace(scene, control=None, trajectory=controller.reference))
    reference: Any = followed.trajectory
    of_others = loops and any(name not in reference.joints for name in controller.joints)
    if not controller.at_point and (ahead or of_others or reference.lacks is Lacks.JOINTS):
        reference = dataclasses.replace(motion_along(Problem(followed)), jumps=reference.knots or ())
    return _with_reference(scene, reference)


def _with_reference(scene: Scene, reference: Any) -> Scene:
    return dataclasses.replace(scene, control=dataclasses.replace(scene.control, reference=reference))


def _start_held(scene: Scene) -> Interpolated:
    """Return the pose at the start, in which all joints stay."""
    setup = prepare(at_rest(scene))
    duration = scene.simulate.duration
    course = held(setup.assembled.q, duration)
    return Interpolated(setup.problem.model.q_names, duration, course, ())
