"""Joints that mimic others: relations between coordinates, or constants where what they mimic does not move."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from robodyn_cli.errors import did_you_mean
from robodyn_cli.record import record
from robodyn_cli.scene.urdf.elements import Mimic, UrdfJoint

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
    followers = [joint for joint in joints.values() if joint.mimic is not None and joint.type != "fixed"]
    for joint in followers:
        _refuse(joints, joint)
    return {joint.name: _relation(joints, joint) for joint in followers}


def _refuse(joints: Mapping[str, UrdfJoint], joint: UrdfJoint) -> None:
    """Refuse what a joint cannot mimic."""
    assert joint.mimic is not None
    leader = joint.mimic.joint
    problem = ""
    if joint.type not in SINGLE:
        raise joint.mimic.element.error(
            f"joint {joint.name!r} mimics another, but is {joint.type}; allowed: a joint with one coordinate"
        )
    if leader not in joints:
        problem = f"{leader!r}, a joint that is not there{did_you_mean(leader, joints)}"
    elif joints[leader].type not in (*SINGLE, "fixed"):
        problem = f"{leader!r}, which is {joints[leader].type}"
    else:
        names = list(_chain(joints, joint))
        if names[-1] in names[:-1]:
            problem = f"itself ({' -> '.join(names)})"
    if problem:
        moving = [name for name, other in joints.items() if other.type in SINGLE and name != joint.name]
        listed = ", ".join(moving[:MOST_LISTED]) or "none, since no other joint turns or slides"
        listed += ", ..." if len(moving) > MOST_LISTED else ""
        raise joint.mimic.element.error(f"joint {joint.name!r} mimics {problem}; allowed: {listed}")


def _chain(joints: Mapping[str, UrdfJoint], joint: UrdfJoint) -> Iterator[str]:
    """Yield a joint, what it mimics, what that mimics and so on; the last one comes twice in a circle."""
    seen: set[str] = set()
    name = joint.name
    while name in joints:
        yield name
        mimic = joints[name].mimic
        if name in seen or mimic is None:
            return
        seen.add(name)
        name = mimic.joint


def _relation(joints: Mapping[str, UrdfJoint], joint: UrdfJoint) -> Relation:
    assert joint.mimic is not None
    behind: list[Mimic] = []
    for name in _chain(joints, joint):
        mimic = joints[name].mimic
        if joints[name].type == "fixed":
            value = 0.0
            break
        if mimic is None:
            return Relation(joint.mimic.joint, joint.mimic.multiplier, joint.mimic.offset)
        if mimic.multiplier == 0.0:
            value = mimic.offset
            break
        behind.append(mimic)
    for mimic in reversed(behind):
        value = mimic.multiplier * value + mimic.offset
    return Relation(None, 0.0, value)
