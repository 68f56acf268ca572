"""The kind of a joint of the scene, its place, and the forces in it by the coordinate on which each acts."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from robodyn_cli.forces.registry import force_types
from robodyn_cli.joints.base import Joint
from robodyn_cli.joints.registry import joint_types
from robodyn_cli.model.model import Body, FixedFrame, Force, JointForce
from robodyn_cli.scene import types as sc
from robodyn_cli.spatial.algebra import (
    Matrix,
    Transform,
    Vector,
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


def by_coordinate(kind: Joint, given: Any, default: float) -> tuple[Any, ...]:
    """Return one value for each velocity coordinate of a joint."""
    if isinstance(given, dict):
        return tuple(given.get(name, default) for name in kind.v_names)
    return (given,) * kind.nv


def joint_forces(
    joint: sc.Joint, kind: Joint, start: tuple[int, int], gear_ratios: Sequence[float]
) -> Iterator[JointForce]:
    """Yield the forces in a joint; limits without a stop exert none, springs in space are forces between bodies.

    start : places of the joint's first coordinates in q and v.
    """
    freedoms = {one.name: one for one in kind.freedoms}
    for key, element in joint.forces:
        name, _, coordinate = key.partition(".")
        one = freedoms[coordinate]
        if not element.acts or (one.in_space and name == "spring"):
            continue
        whole = f"{joint.name}.{coordinate}" if coordinate else joint.name
        q, v = (_shifted(place, first) for place, first in zip((one.q, one.v), start))
        ratio = 1.0 if one.in_space else gear_ratios[one.v]
        yield JointForce(name, element, whole, q, v, one.unit, ratio)


def _shifted(place: Any, by: int) -> Any:
    return slice(place.start + by, place.stop + by) if isinstance(place, slice) else place + by


def springs_in_space(scene: sc.Scene, bodies: Sequence[Body]) -> Iterator[Force]:
    """Yield the springs of ball joints and free bodies, as bushings between the frames before and behind the joint."""
    numbers = {body.joint_name: k for k, body in enumerate(bodies)}
    for joint in scene.robot.joints:
        freedoms = {one.name: one for one in joint_types[joint.type].freedoms}
        for key, spring in joint.forces:
            kind, _, coordinate = key.partition(".")
            if kind == "spring" and freedoms[coordinate].in_space:
                k = numbers[joint.name]
                turns = freedoms[coordinate].unit == "rad"
                none, all_ways = (0.0,) * 3, (spring.stiffness,) * 3
                element = force_types["bushing"](
                    name=f"{joint.name}.{key}",
                    type="bushing",
                    between=(f"{joint.parent}.origin", f"{joint.link}.origin"),
                    stiffness=(*none, *all_ways) if turns else (*all_ways, *none),
                )
                rest = vector(spring.rest if isinstance(spring.rest, tuple) else none)
                ends = _at_rest(bodies[k], rest, turns), FixedFrame(k, zeros(3), identity())
                yield Force(element.name, element, ends)


def _at_rest(body: Body, rest: Vector, turns: bool) -> FixedFrame:
    """Return the frame before a joint, turned or moved to where the body's frame is at rest."""
    at, R = body.X_tree.r, body.X_tree.E.T
    if turns:
        from robodyn_cli.spatial import quaternion

        return FixedFrame(body.parent, at, R @ quaternion.rotation(quaternion.from_rotation_vector(rest)))
    return FixedFrame(body.parent, at + R @ rest, R)
