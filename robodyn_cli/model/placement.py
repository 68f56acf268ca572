"""The kind of a joint of the scene, and its place: by D-H parameters, or by origin and axes."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

from robodyn_cli.joints.base import Joint
from robodyn_cli.joints.registry import joint_types
from robodyn_cli.scene import types as sc
from robodyn_cli.spatial.algebra import (
    Matrix,
    Transform,
    identity,
    rotation_about,
    rotation_rpy,
    rotation_to_z,
    vector,
    zeros,
)


def axis_frame(joint: sc.Joint) -> Matrix:
    """Return the body's axes (columns) in the joint's own frame, for a joint without D-H parameters.

    z is the joint's axis; x its second axis, where one is given (see ``rotation_to_z`` otherwise).
    """
    if joint.axis2 is None:
        return rotation_to_z(joint.axis) if joint.axis is not None else identity()
    from robodyn_cli.spatial.orientation import from_directions

    return from_directions({2: joint.axis or (0.0, 0.0, 1.0), 0: joint.axis2})


def joint_axes(joint: sc.Joint) -> Matrix:
    """Return the axes (columns, body coordinates) of the joint's own frame, that of ``com_frame: joint``."""
    return identity() if joint.has_dh else axis_frame(joint).T


def orientation(given: sc.Orientation) -> Matrix:
    """Return the rotation R (3, 3) of a frame, its axes as columns, from the form in which the scene gives it."""
    if given.plain:
        return rotation_rpy(given.rpy or (0.0, 0.0, 0.0))
    from robodyn_cli.spatial.orientation import rotation_of

    return rotation_of(given)


def joint_kind(joint: sc.Joint) -> Joint:
    """Return the kind of a joint of the scene, with the scene's values of the kind's own parameters (its fields)."""
    kind = joint_types[joint.type]
    if not dataclasses.is_dataclass(kind):
        return kind
    return dataclasses.replace(kind, **{f.name: getattr(joint, f.name) for f in dataclasses.fields(kind)})


def joint_placement(
    robot: sc.Robot, joint: sc.Joint, value_of: Callable[[str, float], Any]
) -> tuple[Transform, Transform, Transform]:
    """Return (X_tree from the parent's link frame, joint frame, link frame), the latter two from the body frame.

    The body frame has the joint's axis as z. With D-H parameters it is the frame right after the joint's own motion.
    A joint with a D-H variable moves by the scene's ``offset`` beside q.
    """
    kind = joint_kind(joint)
    X = Transform.identity()
    if joint.origin is not None:
        X = Transform.from_pose(orientation(joint.origin), vector(joint.origin.xyz))
    one = Transform.identity()

    def get(key: str, value: float) -> Any:
        return value_of(f"joints.{joint.name}.{key}", value)

    def slide(z: Any) -> Transform:
        return Transform(identity(), vector([0.0, 0.0, z]))

    def turn(angle: Any) -> Transform:
        return Transform(rotation_about(2, angle).T, zeros(3))

    offset = get("offset", joint.offset)
    if not joint.has_dh:
        R = axis_frame(joint)
        to_axis = Transform(R.T, zeros(3))
        back = Transform(R, zeros(3))
        shift = kind.transform(vector([offset])) if kind.dh_variable else one
        return shift @ to_axis @ X, back, back
    a, alpha = get("a", joint.a or 0.0), get("alpha", joint.alpha or 0.0)
    d, theta = get("d", joint.d or 0.0), get("theta", joint.theta or 0.0)
    if kind.dh_variable == "theta":
        theta = offset
    elif kind.dh_variable == "d":
        d = offset
    bend = Transform(rotation_about(0, alpha).T, zeros(3)) @ Transform(identity(), vector([a, 0.0, 0.0]))
    if robot.convention == "modified":
        # Rx(alpha) Tx(a) Rz(theta) Tz(d): what is constant about z comes before the joint, it commutes
        return turn(theta) @ slide(d) @ bend @ X, one, one
    # standard: Rz(theta) Tz(d) Tx(a) Rx(alpha); the link frame lies beyond the joint's motion
    if kind.dh_variable == "d":
        return slide(d) @ turn(theta) @ X, one, bend
    # a fixed joint is a revolute one held at theta
    return turn(theta) @ X, one, bend @ slide(d)
