"""The tree of a URDF robot: names once, one root, every link moved by one joint.

Joints that mimic others: relations between coordinates, or constants where what they mimic does not move.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Mapping

from robodyn_cli.errors import did_you_mean, listed, plural_of, shown, unknown_name
from robodyn_cli.record import record
from robodyn_cli.scene.text.nodes import Faults
from robodyn_cli.scene.urdf.drake import rotors_of
from robodyn_cli.scene.urdf.elements import Mimic, UrdfJoint, UrdfLink, UrdfRobot


def check_structure(robot: UrdfRobot, faults: Faults) -> None:
    """Report names that appear twice, links that are not there or are moved twice, several roots, and loops."""
    with faults:
        if not robot.links:
            raise robot.element.error("the robot has no <link>; allowed: one or more")
    _unique("link", robot.links, faults)
    _unique("joint", robot.joints, faults)
    names = dict.fromkeys(link.name for link in robot.links)
    moved: dict[str, UrdfJoint] = {}
    for joint in robot.joints:
        with faults:
            for tag, name in (("parent", joint.parent), ("child", joint.child)):
                if name not in names:
                    hint = did_you_mean(name, names)
                    fault = f"joint {joint.name!r}: its {tag} {shown(name)} is no link of this file{hint}"
                    raise joint.element.error(fault)
            if joint.child in moved:
                other = moved[joint.child].name
                raise joint.element.error(
                    f"joint {joint.name!r} moves link {joint.child!r}, which joint {other!r} moves already; "
                    "allowed: one joint for each link (a closed loop is made with 'loops' in the scene)"
                )
            moved[joint.child] = joint
    if not faults.found:
        with faults:
            _one_root(robot, moved)


def _unique(kind: str, items: Iterable[UrdfLink | UrdfJoint], faults: Faults) -> None:
    seen: set[str] = set()
    for item in items:
        with faults:
            if item.name in seen:
                raise item.element.error(
                    f"{kind} {item.name!r} appears twice; names of {plural_of(kind)} must differ"
                )
            seen.add(item.name)


def _one_root(robot: UrdfRobot, moved: dict[str, UrdfJoint]) -> None:
    roots = [link for link in robot.links if link.name not in moved]
    if len(roots) > 1:
        names = listed([repr(link.name) for link in roots])
        raise roots[1].element.error(
            f"no joint moves the links {names}; allowed: one root, to which all others lead"
        )
    grounded = {link.name for link in roots}
    for link in robot.links:
        chain: dict[str, None] = {}
        name = link.name
        while name not in grounded:
            if name in chain:
                links = list(chain)
                loop = " -> ".join([*links[links.index(name) :], name])
                raise moved[name].element.error(
                    f"the joints form a loop of links ({loop}); allowed: a tree (a closed loop is made with 'loops' "
                    "in the scene)"
                )
            chain[name] = None
            name = moved[name].parent
        grounded.update(chain)


def root_of(robot: UrdfRobot) -> UrdfLink:
    """Return the link that no joint moves, of a robot that is a tree."""
    moved = {joint.child for joint in robot.joints}
    return next(link for link in robot.links if link.name not in moved)


def moving_links(robot: UrdfRobot) -> set[str]:
    """Return the links that a joint with a coordinate moves, directly or by way of others."""
    above = {joint.child: joint for joint in robot.joints}
    moves: dict[str, bool] = {}
    for link in robot.links:
        chain = []
        name = link.name
        while name not in moves and name in above:
            chain.append(name)
            name = above[name].parent
        moved = moves.get(name, False)
        for name in reversed(chain):
            moved = moved or above[name].type != "fixed"
            moves[name] = moved
    return {name for name, moving in moves.items() if moving}


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
        allowed = listed(moving) or "none, since no other joint turns or slides"
        raise joint.mimic.element.error(f"joint {joint.name!r} mimics {problem}; allowed: {allowed}")


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


def with_rotors(robot: UrdfRobot, faults: Faults) -> UrdfRobot:
    """Return the robot with the rotors of its motors; an effort of 0 says that a joint has none."""
    rotors = rotors_of(robot.element, faults)
    kinds = {joint.name: joint.type for joint in robot.joints}
    moving = [name for name, kind in kinds.items() if kind in SINGLE]
    for name, (element, _) in rotors.items():
        with faults:
            if name not in moving:
                raise element.error(f"a rotor: {unknown_name('joint with one coordinate', name, moving)}")
    joints = (
        dataclasses.replace(joint, rotor=rotors[joint.name][1])
        if joint.name in rotors and joint.limits.get("effort", 1.0) > 0.0
        else joint
        for joint in robot.joints
    )
    return dataclasses.replace(robot, joints=tuple(joints)) if rotors else robot
