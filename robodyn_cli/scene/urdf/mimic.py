"""Joints that mimic others: relations between coordinates, or constants where what they mimic does not move."""

from __future__ import annotations

from collections.abc import Mapping

from robodyn_cli.errors import did_you_mean
from robodyn_cli.record import record
from robodyn_cli.scene.urdf.elements import UrdfJoint

MOST_LISTED = 10
SINGLE = ("revolute", "continuous", "prismatic")


@record
class Relation:
    """q = multiplier q_joint + offset of a joint that moves; ``joint`` None where q is the constant ``offset``."""

    joint: str | None
    multiplier: float
    offset: float


def relations(joints: Mapping[str, UrdfJoint]) -> dict[str, Relation]:
    """Return the relation of each joint that moves and mimics another, to a joint that moves.

    A fixed joint that mimics has no coordinate, so that nothing follows from it.

    Raises
    ------
    SceneError : a mimic of itself, of a joint that is not there, or of one with several coordinates.
    """
    found: dict[str, Relation] = {}
    for name, joint in joints.items():
        if joint.mimic is not None and joint.type != "fixed":
            _refuse(joints, joint)
            found[name] = _relation(joints, joint)
    return found


def _refuse(joints: Mapping[str, UrdfJoint], joint: UrdfJoint) -> None:
    """Refuse what a joint cannot mimic."""
    assert joint.mimic is not None
    error, what, leader = joint.mimic.element.error, f"joint {joint.name!r} mimics", joint.mimic.joint
    moving = [name for name, other in joints.items() if other.type in SINGLE and name != joint.name]
    allowed = f"allowed: {', '.join(moving[:MOST_LISTED])}{', ...' if len(moving) > MOST_LISTED else ''}"
    if joint.type not in SINGLE:
        raise error(f"{what} another, but is {joint.type}; allowed: a joint with one coordinate")
    if leader not in joints:
        raise error(f"{what} {leader!r}, a joint that is not there{did_you_mean(leader, moving)}; {allowed}")
    if joints[leader].type not in (*SINGLE, "fixed"):
        raise error(f"{what} {leader!r}, which is {joints[leader].type}; {allowed}")
    chain = [joint.name]
    while (mimic := joints[chain[-1]].mimic) is not None and mimic.joint in joints:
        if mimic.joint in chain:
            raise error(f"{what} itself ({' -> '.join([*chain, mimic.joint])}); {allowed}")
        chain.append(mimic.joint)


def _relation(joints: Mapping[str, UrdfJoint], joint: UrdfJoint) -> Relation:
    mimic = joint.mimic
    assert mimic is not None
    leader = joints[mimic.joint]
    if mimic.multiplier == 0.0 or leader.type == "fixed":
        return Relation(None, 0.0, mimic.offset)
    if leader.mimic is not None:
        beyond = _relation(joints, leader)
        if beyond.joint is None:
            return Relation(None, 0.0, mimic.multiplier * beyond.offset + mimic.offset)
    return Relation(leader.name, mimic.multiplier, mimic.offset)
