"""Forces in joints, rotors and gears of the model, by the coordinate on which each acts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from robodyn_cli.forces.registry import force_types
from robodyn_cli.joints.base import Joint
from robodyn_cli.joints.registry import joint_types
from robodyn_cli.model.model import Body, FixedFrame, Force, JointForce
from robodyn_cli.scene import types as sc
from robodyn_cli.spatial.algebra import Vector, identity, vector, zeros


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
