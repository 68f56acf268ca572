"""Checks of the robot that look at more than one key."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection, Iterable, Sequence
from typing import Any

from robodyn_cli.joints.base import Joint as JointKind
from robodyn_cli.joints.registry import joint_types
from robodyn_cli.scene.checks.check import Check
from robodyn_cli.scene.points import BASE, BUILT_IN, spot_problem
from robodyn_cli.scene.robot_types import DH, Joint, Orientation, Robot
from robodyn_cli.scene.text.nodes import Path, nearest
from robodyn_cli.scene.types import Scene
from robodyn_cli.schema.fields import describe

ROBOT: Path = ("robot",)
_DRIVE = ("gear_ratio", "rotor_inertia")
# keys that some kinds of joint have beside an axis
_OF_SOME = ("pitch", "axis2")
Axis = tuple[float, ...]


def moving(robot: Robot) -> tuple[str, ...]:
    """Return the names of the joints that have a coordinate."""
    return tuple(joint.name for joint in robot.joints if joint_types[joint.type].nv > 0)


def columns(robot: Robot, quasi: bool | None = None, velocities: bool = False) -> tuple[str, ...]:
    """Return the columns of q (or v) of the joints; of those with quasi-velocities, or of the others, if asked."""
    names: list[str] = []
    for joint in robot.joints:
        kind = joint_types[joint.type]
        if kind.nv and quasi in (None, kind.quasi):
            names += kind.coordinates(joint.name, kind.v_names if velocities else kind.names)
    return tuple(names)


def column_units(robot: Robot, velocities: bool = False) -> dict[str, str]:
    """Return the units of the columns of q, or those of the joints that the columns of v are rates of, by name."""
    units: dict[str, str] = {}
    for joint in robot.joints:
        kind = joint_types[joint.type]
        names, own = (kind.v_names, kind.v_units) if velocities else (kind.names, kind.units)
        units |= zip(kind.coordinates(joint.name, names), own)
    return units


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
    owners = {joint.link: joint for joint in robot.joints}
    for path, link in zip(links, robot.links):
        owner = owners.get(link.name)
        ambiguous = robot.convention == "standard" and owner is not None and owner.has_dh
        if ambiguous and link.com is not None and link.com_frame is None:
            message = "key 'com_frame' is missing: with standard D-H the link frame is not at the joint"
            with check:
                check.fail(path, f"{message}; allowed: joint, link")
        if link.visual:
            from robodyn_cli.scene.checks.carried import check_shapes

            check_shapes(link, check, path)
    _check_orientations(robot, check)
    _check_points(robot, check)
    return robot


def _check_orientations(robot: Robot, check: Check) -> None:
    places: dict[Path, Orientation | None] = {(*ROBOT, "base"): robot.base}
    places |= {(*ROBOT, "joints", k, "origin"): joint.origin for k, joint in enumerate(robot.joints)}
    for k, link in enumerate(robot.links):
        places |= {(*ROBOT, "links", k, "visual", n, "origin"): x.origin for n, x in enumerate(link.visual)}
    places |= {(*ROBOT, "frames", name): frame for name, frame in robot.frames.items()}
    for path, given in places.items():
        if given is not None and not given.plain:
            from robodyn_cli.scene.checks.orientation import check_orientation

            check_orientation(given, check, path)


def _connect(robot: Robot, check: Check, joints: list[Path], links: list[Path]) -> Robot:
    """Fill in which link each joint moves and which it hangs on; refuse what is not a tree."""
    names = dict.fromkeys(link.name for link in robot.links)
    parents = {BASE: None, **names}
    moved: dict[str, str] = {}
    connected: list[Joint] = []
    failures = len(check.found)
    for k, joint in enumerate(robot.joints):
        with check:
            link = _moved_link(joint, k, robot, names, check, joints[k])
            if link in moved:
                check.fail((*joints[k], "link"), f"link {link!r} is moved by joint {moved[link]!r} already")
            moved[link] = joint.name
            parent = joint.parent or (connected[-1].link if connected else BASE)
            check.known(str(parent), parents, "link", (*joints[k], "parent"))
            connected.append(dataclasses.replace(joint, link=link, parent=parent))
    if len(check.found) > failures:
        return robot
    for path, name in zip(links, names):
        with check:
            if name not in moved:
                _refuse_other_joints(check, path, name)
                check.fail(path, f"no joint moves link {name!r}; each link needs one joint")
    if len(check.found) > failures:
        return robot
    _check_tree(connected, check, joints)
    return dataclasses.replace(robot, joints=tuple(connected))


def _refuse_other_joints(check: Check, path: Path, name: str) -> None:
    """Refuse joints of a scene that stand in the place of those of the file with the link that none of them moves."""
    joints, link = (nearest(check.root, one) for one in ((*ROBOT, "joints"), path))
    if joints.source.name != link.source.name:
        check.fail(
            (*ROBOT, "joints"),
            f"this list stands in the place of the joints of {link.source.name}, and none of its joints moves link "
            f"{name!r}; allowed: all joints, or a map of changes by name, as in joints: {{NAME: {{type: floating}}}}",
        )


def _moved_link(joint: Joint, k: int, robot: Robot, names: Collection[str], check: Check, path: Path) -> str:
    """Return the link that the k-th joint moves: by default the one at the same place in the list."""
    if joint.link is None:
        if k >= len(robot.links):
            check.fail(path, f"joint {joint.name!r} moves no link: there are only {len(robot.links)} links")
        return robot.links[k].name
    if joint.link == BASE:
        check.fail((*path, "link"), "a joint cannot move 'base'")
    check.known(joint.link, names, "link", (*path, "link"))
    return joint.link


def _check_tree(connected: list[Joint], check: Check, joints: list[Path]) -> None:
    """Refuse links that hang on each other and not on the base."""
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


def _check_placement(robot: Robot, joint: Joint, check: Check, path: Path) -> None:
    kind = joint_types[joint.type]
    _check_keys(joint, kind, check, path)
    variable = kind.dh_variable
    if variable and getattr(joint, variable) is not None:
        message = f"{variable!r} of a {joint.type} joint is its coordinate; give a constant part as 'offset'"
        check.fail((*path, variable), message, at_key=True)
    if joint.has_dh:
        if robot.convention is None:
            message = f"is missing, and joint {joint.name!r} has D-H parameters; allowed: standard, modified"
            check.fail((*ROBOT, "convention"), message)
        if joint.axis is not None:
            message = f"does not go with the D-H parameter {_dh_given(joint)!r}; give one or the other"
            check.fail((*path, "axis"), message, at_key=True)
    elif "axis" in kind.needs and joint.axis is None:
        dh = "D-H parameters (a, alpha, d, theta) or " if kind.by_dh else ""
        check.fail(path, f"joint {joint.name!r} needs {dh}an 'axis'")
    if joint.axis2 is not None:
        _check_second_axis(joint.axis or (0.0, 0.0, 1.0), joint.axis2, check, path)


def _dh_given(joint: Joint) -> str:
    return next(name for name in DH if getattr(joint, name) is not None)


def _check_keys(joint: Joint, kind: JointKind, check: Check, path: Path) -> None:
    """Check the keys that only some kinds of joint take."""
    if joint.has_dh and not kind.by_dh:
        described = _listed(name for name in joint_types if joint_types[name].by_dh)
        message = (
            f"D-H parameters describe {described} joints; place a {joint.type} joint by 'origin' and 'axis'"
        )
        check.fail((*path, _dh_given(joint)), message, at_key=True)
    taken = (*kind.needs, *kind.takes)
    if joint.axis is not None and "axis" not in taken and kind.nv > 0:
        message = f"a {joint.type} joint has no axis; turn its frame by 'origin'"
        check.fail((*path, "axis"), message, at_key=True)
    for name in _OF_SOME:
        if name in kind.needs and getattr(joint, name) is None:
            field = next(f for f in dataclasses.fields(Joint) if f.name == name)
            allowed = describe(field.metadata["kind"], field.metadata["unit"])
            message = f"joint {joint.name!r} is {joint.type}: key {name!r} is missing; allowed: {allowed}"
            check.fail(path, message)
        if name not in taken and getattr(joint, name) is not None:
            kinds = _listed(x for x in joint_types if name in (*joint_types[x].needs, *joint_types[x].takes))
            check.fail((*path, name), f"is for {kinds} joints only", at_key=True)


def _listed(names: Iterable[str]) -> str:
    *most, last = names
    return f"{', '.join(most)} and {last}" if most else last


def _check_second_axis(axis: Axis, axis2: Axis, check: Check, path: Path) -> None:
    cosine = sum(a * b for a, b in zip(axis, axis2)) / (math.hypot(*axis) * math.hypot(*axis2))
    if abs(cosine) > 1e-9:
        check.fail((*path, "axis2"), f"must be at right angles to the axis (cosine {cosine:.3g})")


def _check_drive(joint: Joint, check: Check, path: Path) -> None:
    kind = joint_types[joint.type]
    _check_ratios(joint, kind, check, path)
    for name, force in joint.forces:
        here = (*path, *name.split("."))
        for where, message in force.problems():
            with check:
                check.fail((*here, *where), message)
        with check:
            _check_freedom(joint, kind, name, force, check, here)
    for name in _not_taken(joint, kind):
        with check:
            if check.has((*path, name)):
                message = f"joint {joint.name!r} is {joint.type}: it takes no {name!r}"
                check.fail((*path, name), message, at_key=True)


def _check_ratios(joint: Joint, kind: JointKind, check: Check, path: Path) -> None:
    """Gear ratios are not zero; joints with several coordinates have ratios and rotors by coordinate."""
    ratios = joint.gear_ratio if isinstance(joint.gear_ratio, dict) else {"": joint.gear_ratio}
    for name, ratio in ratios.items():
        with check:
            if ratio == 0.0:
                check.fail((*path, "gear_ratio", *([name] if name else [])), "must not be zero")
    names = [one.name for one in kind.freedoms if not one.in_space]
    for key in _DRIVE:
        given = getattr(joint, key)
        with check:
            if isinstance(given, dict):
                if names in ([], [""]):
                    check.fail((*path, key), f"joint {joint.name!r} is {joint.type}: allowed: a number")
                for name in given:
                    check.known(name, names, "coordinate", (*path, key, name), at_key=True)
            elif len(names) > 1 and check.has((*path, key)):
                check.fail((*path, key), _by_coordinate(joint, key, names))


def _check_freedom(joint: Joint, kind: JointKind, key: str, force: Any, check: Check, path: Path) -> None:
    """A force in a joint names the coordinate that it acts on where there are several, and suits it."""
    freedoms = {one.name: one for one in kind.freedoms}
    name, _, coordinate = key.partition(".")
    if not freedoms:
        return  # see _not_taken
    if not coordinate and "" not in freedoms:
        check.fail(path, _by_coordinate(joint, name, list(freedoms)))
    if coordinate and "" in freedoms:
        message = f"joint {joint.name!r} is {joint.type}: write the keys of {name!r} without a coordinate"
        check.fail(path, message, at_key=True)
    check.known(coordinate, freedoms, "coordinate", path, at_key=True)
    for where, message in force.problems_along(freedoms[coordinate].in_space):
        with check:
            check.fail((*path, *where), message)


def _by_coordinate(joint: Joint, key: str, names: Sequence[str]) -> str:
    return (
        f"joint {joint.name!r} is {joint.type}: {key!r} belongs to one of its coordinates; allowed: a map by "
        f"coordinate, such as {{{names[0]}: ...}}, of {', '.join(names)}"
    )


def _not_taken(joint: Joint, kind: JointKind) -> tuple[str, ...]:
    """Return the keys that make no sense for a kind of joint."""
    axis = ("axis",) if kind.nv == 0 else ()
    offset = () if kind.dh_variable else ("offset",)
    # no motor turns a body about all axes at once; a ball may have an inertia of its own, the same about all
    drive = (
        ()
        if any(not one.in_space for one in kind.freedoms)
        else _DRIVE[: 1 if len(kind.freedoms) == 1 else 2]
    )
    if kind.nv == 0:
        drive = (*drive, *(name for name, _ in joint.forces))
    return (*axis, *offset, *drive)


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
    for name, point in robot.points.items():
        with check:
            if point.motion is not None and point.link != BASE:
                check.fail(
                    (*ROBOT, "points", name, "motion"),
                    f"only points on 'base' move by formulas (this one is on {point.link!r}); let a prescribed joint "
                    "move it",
                )


def check_joints(scene: Scene, names: Iterable[tuple[str, Path]], check: Check, at_key: bool) -> None:
    """Refuse names that are no joints, and joints without a coordinate."""
    joints = dict.fromkeys(moving(scene.robot))
    fixed = [joint.name for joint in scene.robot.joints if joint.name not in joints]
    for name, path in names:
        with check:
            if name in fixed:
                message = f"joint {name!r} is fixed: it has no coordinate; allowed: {', '.join(joints)}"
                check.fail(path, message, at_key)
            check.known(name, joints, "joint", path, at_key)
