"""Checks of the robot that look at more than one key."""

from __future__ import annotations

import dataclasses
import math

from robodyn_cli.joints.registry import joint_types
from robodyn_cli.scene.checks.check import Check
from robodyn_cli.scene.points import BASE, BUILT_IN, has_dh, joint_of, spot_problem
from robodyn_cli.scene.text.nodes import Path
from robodyn_cli.scene.types import Joint, Robot

ROBOT: Path = ("robot",)
_DH = ("a", "alpha", "d", "theta")
# the D-H parameter that is the joint's own coordinate
_VARIABLE = {"revolute": "theta", "prismatic": "d"}
_ONE_AXIS = ("revolute", "prismatic", "helical", "cylindrical")
_TWO_AXES = ("universal", "planar")
_NO_AXIS = ("spherical", "floating")


def moving(robot: Robot) -> tuple[str, ...]:
    """Return the names of the joints that have a coordinate."""
    return tuple(joint.name for joint in robot.joints if joint_types[joint.type].nv > 0)


def columns(robot: Robot, quasi: bool | None = None, velocities: bool = False) -> tuple[str, ...]:
    """Return the columns of q (or v) of the joints; of those with quasi-velocities, or of the others, if asked."""
    found: list[str] = []
    for joint in robot.joints:
        kind = joint_types[joint.type]
        if kind.nv and quasi in (None, kind.quasi):
            found += kind.coordinates(joint.name, kind.v_names if velocities else kind.names)
    return tuple(found)


def check_robot(robot: Robot, check: Check) -> Robot:
    """Return the robot with every joint's link and parent filled in, as far as they could be."""
    joints = [(*ROBOT, "joints", k) for k in range(len(robot.joints))]
    links = [(*ROBOT, "links", k) for k in range(len(robot.links))]
    check.unique([j.name for j in robot.joints], "joint", [(*p, "name") for p in joints])
    check.unique([link.name for link in robot.links], "link", [(*p, "name") for p in links])
    for path, link in zip(links, robot.links):
        with check:
            if link.name == BASE:
                check.fail((*path, "name"), "'base' is the ground; choose another name")
    names = {link.name for link in robot.links}
    if len(names) == len(robot.links) and BASE not in names:
        with check:
            robot = _connect(robot, check, joints, links)
    for path, joint in zip(joints, robot.joints):
        with check:
            _check_placement(robot, joint, check, path)
        with check:
            _check_drive(joint, check, path)
    for path, link in zip(links, robot.links):
        owner = joint_of(robot, link.name)
        ambiguous = robot.convention == "standard" and owner is not None and has_dh(owner)
        if ambiguous and link.com is not None and link.com_frame is None:
            message = "key 'com_frame' is missing: with standard D-H the link frame is not at the joint"
            with check:
                check.fail(path, f"{message}; allowed: joint, link")
    _check_points(robot, check)
    return robot


def _connect(robot: Robot, check: Check, joints: list[Path], links: list[Path]) -> Robot:
    """Fill in which link each joint moves and which it hangs on; refuse what is not a tree."""
    names = [link.name for link in robot.links]
    moved: dict[str, str] = {}
    connected: list[Joint] = []
    failures = len(check.found)
    for k, joint in enumerate(robot.joints):
        with check:
            link = joint.link
            if link is None and k >= len(names):
                check.fail(
                    joints[k], f"joint {joint.name!r} moves no link: there are only {len(names)} links"
                )
            if link is None:
                link = names[k]
            elif link == BASE:
                check.fail((*joints[k], "link"), "a joint cannot move 'base'")
            check.known(link, names, "link", (*joints[k], "link"))
            if link in moved:
                check.fail((*joints[k], "link"), f"link {link!r} is moved by joint {moved[link]!r} already")
            moved[link] = joint.name
            parent = joint.parent or (connected[-1].link if connected else BASE)
            check.known(str(parent), [BASE, *names], "link", (*joints[k], "parent"))
            connected.append(dataclasses.replace(joint, link=link, parent=parent))
    if len(check.found) > failures:
        return robot
    for path, name in zip(links, names):
        with check:
            if name not in moved:
                check.fail(path, f"no joint moves link {name!r}; each link needs one joint")
    owner = {str(joint.link): joint for joint in connected}
    grounded = {BASE}
    for k, joint in enumerate(connected):
        chain: list[str] = []
        link = str(joint.link)
        while link not in grounded:
            if link in chain:
                loop = " -> ".join([*chain[chain.index(link) :], link])
                check.fail((*joints[k], "parent"), f"parents form a cycle: {loop}; close loops with 'loops'")
            chain.append(link)
            link = str(owner[link].parent)
        grounded.update(chain)
    return dataclasses.replace(robot, joints=tuple(connected))


def _check_placement(robot: Robot, joint: Joint, check: Check, path: Path) -> None:
    _check_kind(joint, check, path)
    variable = _VARIABLE.get(joint.type)
    if variable is not None and getattr(joint, variable) is not None:
        check.fail(
            (*path, variable),
            f"{variable!r} of a {joint.type} joint is its coordinate; give a constant part as 'offset'",
            at_key=True,
        )
    if has_dh(joint):
        if robot.convention is None:
            check.fail(
                (*ROBOT, "convention"),
                f"is missing, and joint {joint.name!r} has D-H parameters; allowed: standard, modified",
            )
        if joint.axis is not None:
            given = next(name for name in _DH if getattr(joint, name) is not None)
            check.fail(
                (*path, "axis"), f"does not go with the D-H parameter {given!r}; give one or the other", True
            )
    elif joint.type in _ONE_AXIS and joint.axis is None:
        dh = "D-H parameters (a, alpha, d, theta) or " if joint.type in _VARIABLE else ""
        check.fail(path, f"joint {joint.name!r} needs {dh}an 'axis'")
    for name in ("axis", "axis2"):
        if getattr(joint, name) is not None and not any(getattr(joint, name)):
            check.fail((*path, name), "must not be zero (value [0, 0, 0])")
    _check_second_axis(joint, check, path)


def _check_kind(joint: Joint, check: Check, path: Path) -> None:
    """Check the keys that only some kinds of joint take."""
    dh = next((name for name in _DH if getattr(joint, name) is not None), None)
    if dh is not None and joint.type not in (*_VARIABLE, "fixed"):
        message = (
            f"D-H parameters describe revolute, prismatic and fixed joints; place a {joint.type} joint by"
        )
        check.fail((*path, dh), f"{message} 'origin' and 'axis'", at_key=True)
    if joint.type in _NO_AXIS and joint.axis is not None:
        message = f"a {joint.type} joint has no axis; turn its frame by origin.rpy"
        check.fail((*path, "axis"), message, at_key=True)
    if joint.type == "helical" and joint.pitch is None:
        check.fail(
            path, f"joint {joint.name!r} is helical: key 'pitch' is missing; allowed: a number [m/rad]"
        )
    if joint.type != "helical" and joint.pitch is not None:
        check.fail((*path, "pitch"), "is for helical joints only", at_key=True)


def _check_second_axis(joint: Joint, check: Check, path: Path) -> None:
    if joint.axis2 is not None:
        if joint.type not in _TWO_AXES:
            check.fail((*path, "axis2"), f"is for {' and '.join(_TWO_AXES)} joints only", at_key=True)
        axis = joint.axis or (0.0, 0.0, 1.0)
        cosine = sum(a * b for a, b in zip(axis, joint.axis2)) / (
            math.hypot(*axis) * math.hypot(*joint.axis2)
        )
        if abs(cosine) > 1e-9:
            check.fail((*path, "axis2"), f"must be at right angles to the axis (cosine {cosine:.3g})")


def _check_drive(joint: Joint, check: Check, path: Path) -> None:
    if joint.gear_ratio == 0.0:
        check.fail((*path, "gear_ratio"), "must not be zero")
    for name, force in joint.forces:
        for where, message in getattr(force, "problems", tuple)():
            with check:
                check.fail((*path, name, *where), message)
    if joint_types[joint.type].nv == 0:
        forces = [name for name, _ in joint.forces]
        for name in ("axis", "offset", "gear_ratio", "rotor_inertia", *forces):
            with check:
                if check.has((*path, name)):
                    message = f"joint {joint.name!r} is {joint.type}: it takes no {name!r}"
                    check.fail((*path, name), message, at_key=True)
    elif joint.type not in _VARIABLE:
        several = joint_types[joint.type].nv > 1
        # which of several coordinates a spring or a gear belongs to is not said by the joint alone
        drive = ("gear_ratio", "rotor_inertia", *(name for name, _ in joint.forces)) if several else ()
        for name in ("offset", *drive):
            with check:
                if check.has((*path, name)):
                    message = f"joint {joint.name!r} is {joint.type}: it takes no {name!r}"
                    check.fail((*path, name), message, at_key=True)


def _check_points(robot: Robot, check: Check) -> None:
    names = [BASE, *[link.name for link in robot.links]]
    for group, points in (("points", robot.points), ("frames", robot.frames)):
        for name, point in points.items():
            path = (*ROBOT, group, name)
            with check:
                if name in BUILT_IN:
                    check.fail(
                        path, f"{name!r} is reserved, as in 'LINK.{name}'; choose another name", at_key=True
                    )
                check.known(point.link, names, "link", (*path, "link"))
                problem = spot_problem(robot, point.link, point.at) if isinstance(point.at, str) else None
                if problem is not None:
                    check.fail((*path, "at"), problem)
