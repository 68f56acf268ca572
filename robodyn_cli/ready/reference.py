"""From what a controller is asked to follow to the motion of the joints that it follows."""

from __future__ import annotations

import dataclasses
from typing import Any

from robodyn_cli.equations.problem import Problem
from robodyn_cli.given.along_path import Interpolated
from robodyn_cli.given.motion import by_columns, plan_motion, with_led_point, without_following
from robodyn_cli.ready.prepare import plant_of, prepare
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.course import held
from robodyn_cli.trajectories.interpolation import interpolated
from robodyn_cli.trajectories.motion import JointMotion


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
    if getattr(controller, "reference", None) is None:
        return _with_reference(scene, _start_held(scene)) if ahead else scene
    followed = dataclasses.replace(without_following(scene), control=None, trajectory=controller.reference)
    if getattr(controller.reference, "to_be_found", False):
        from robodyn_cli.ready.in_time import with_motion

        followed = with_motion(followed)
    reference: Any = followed.trajectory
    of_others = loops and any(name not in getattr(reference, "joints", ()) for name in controller.joints)
    if not controller.at_point and (ahead or of_others or hasattr(reference, "target")):
        reference = joint_motion(followed)
    return _with_reference(scene, reference)


def _with_reference(scene: Scene, reference: Any) -> Scene:
    return dataclasses.replace(scene, control=dataclasses.replace(scene.control, reference=reference))


def joint_motion(scene: Scene) -> Interpolated:
    """Return the motion of all joints that the scene's trajectory, and its loops, lead to."""
    problem = Problem(with_led_point(scene))
    trajectory: Any = scene.trajectory
    columns = problem.model.q_names

    def motion(times: Array) -> tuple[Array, Array, Array]:
        return by_columns(problem.model, _motion_of(problem, times))

    knots = getattr(trajectory, "knots", None)
    duration = float(trajectory.duration)
    course = interpolated(motion, duration, knots, "the motion that the controller follows")
    return Interpolated(columns, duration, course, tuple(knots or ()))


def _motion_of(problem: Problem, times: Array) -> JointMotion:
    if not problem.model.closures:
        return plan_motion(problem, times).motion
    from robodyn_cli.given.guided_motion import guided_motion
    from robodyn_cli.given.loop_conditions import lead_of

    found = guided_motion(problem, lead_of(problem), times)
    if found.stopped is not None:
        raise found.stopped
    return found.motion


def _start_held(scene: Scene) -> Interpolated:
    """Return the pose at the start, in which all joints stay."""
    setup = prepare(plant_of(scene))
    duration = scene.simulate.duration
    course = held(setup.assembled.q, duration)
    return Interpolated(setup.problem.model.q_names, duration, course, ())
