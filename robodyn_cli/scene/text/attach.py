"""Robots made of parts: links and whole robots attached to a robot, and names with prefixes.

All of it happens to trees, before they are read: a robot that was put together is like one that was written in one
piece, and every node still knows the file and line that it comes from.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable

from robodyn_cli.errors import did_you_mean, shown, unknown_name
from robodyn_cli.scene.text.nodes import (
    Mapping,
    Node,
    Path,
    Scalar,
    Sequence,
    describe_node,
    dotted,
    located,
    mapping,
    name_of,
    scalar,
    sequence,
)
from robodyn_cli.schema.fields import ATTACH, INCLUDE, PREFIX

GROUND = "base"
OF_LINK = ("mass", "com", "com_frame", "inertia", "visual")
OF_ROBOT = (INCLUDE, PREFIX, "to", "origin")
KEYS = ("link", "to", "origin", "joint", *OF_LINK, INCLUDE, PREFIX)
DH = ("a", "alpha", "d", "theta")
MOTORS = "actuated"

_PREFIX = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
Include = Callable[[Node, Path], Node]
Rename = Callable[[str], str]


def with_attachments(robot: Mapping, path: Path, include: Include) -> Mapping:
    """Return a robot with what its key ``attach`` adds; ``include`` returns the robot that a map with that key names.

    Raises
    ------
    SceneError : an item that is neither a link nor a robot, or does not fit.
    """
    items = robot.get(ATTACH)
    robot = robot.without(ATTACH)
    if items is None or (isinstance(items, Scalar) and items.value is None):
        return robot
    if not isinstance(items, Sequence):
        raise located(items, dotted((*path, ATTACH)), "must be a list of links and robots to attach")
    for k, item in enumerate(items.items):
        robot = _attached(robot, item, (*path, ATTACH, k), include)
    return robot


def _attached(robot: Mapping, item: Node, path: Path, include: Include) -> Mapping:
    if not isinstance(item, Mapping) or (item.get("link") is None) == (item.get(INCLUDE) is None):
        raise located(
            item, dotted(path), "allowed: a map with either 'link', a new link, or 'include', a robot"
        )
    whole = item.get(INCLUDE) is not None
    allowed = OF_ROBOT if whole else tuple(key for key in KEYS if key not in (INCLUDE, PREFIX))
    for key, _ in item.entries:
        if key.text not in allowed:
            hint = did_you_mean(key.text, allowed)
            fault = f"unknown key {shown(key.text)} beside '{INCLUDE if whole else 'link'}'{hint}"
            raise located(key, dotted((*path, key.text)), f"{fault}; allowed: {', '.join(allowed)}")
    return _with_robot(robot, item, path, include) if whole else _with_link(robot, item, path)


def _with_link(robot: Mapping, item: Mapping, path: Path) -> Mapping:
    """Return the robot with another link, on a fixed joint unless ``joint`` says more."""
    name, joint = item.get("link"), item.get("joint")
    assert name is not None
    if isinstance(name, Scalar) and name.text in map(name_of, _items(robot, "links")):
        raise located(
            name, dotted((*path, "link")), f"the robot has a link {name.text!r} already; choose another name"
        )
    entries = [(scalar(item, "name"), name)]
    link = mapping(item, entries + [(k, v) for k, v in item.entries if k.text in OF_LINK])
    own = [(scalar(item, "parent"), _parent(robot, item, path)), (scalar(item, "link"), name)]
    own += [(k, v) for k, v in item.entries if k.text == "origin"]
    if joint is None:
        named = scalar(name, f"{name.text}_joint" if isinstance(name, Scalar) else "joint")
        fixed = [(scalar(item, "name"), named), (scalar(item, "type"), scalar(item, "fixed"))]
        return _extended(robot, {"joints": [mapping(item, fixed + own)], "links": [link]})
    if not isinstance(joint, Mapping):
        raise located(joint, dotted((*path, "joint")), "must be a map of the keys of a joint")
    for key, _ in own:
        if (twice := joint.key(key.text)) is not None:
            message = (
                "is given beside the joint already; allowed: once"
                if key.text == "origin"
                else "is not a key here"
            )
            raise located(twice, dotted((*path, "joint", key.text)), message)
    return _extended(robot, {"joints": [mapping(joint, [*joint.entries, *own])], "links": [link]})


def _with_robot(robot: Mapping, item: Mapping, path: Path, include: Include) -> Mapping:
    """Return the robot with another one, whose ground is a massless link fixed to the first."""
    name = item.get(INCLUDE)
    assert name is not None
    part = include(mapping(item, [(scalar(item, INCLUDE), name)]), path)
    if not isinstance(part, Mapping):
        raise located(part, dotted(path), "an included file must contain a robot")
    prefix = prefix_of(item, path)
    joints, links, ground = [], [], _parent(robot, item, path)
    base = part.get("base")
    for role, origin in (("mount", item.get("origin")), ("base_frame", base)):
        if role == "mount" or origin is not None:
            frame = scalar(item, prefix + role)
            placed = {"name": scalar(item, f"{prefix}{role}_joint"), "type": scalar(item, "fixed"), "parent": ground,
                      "link": frame} | ({} if origin is None else {"origin": origin})  # fmt: skip
            joints.append(_map(item, placed))
            links.append(_map(item, {"name": frame, "mass": scalar(item, 0)}))
            ground = frame
    part = with_prefix(_explicit(part), prefix, str(ground.text) if isinstance(ground, Scalar) else GROUND)
    robot = _one_convention(robot, part, item, path)
    if robot.get(MOTORS) is not None or part.get(MOTORS) is not None:
        motors = [motor for one in (robot, part) for motor in _motors(one)]
        robot = robot.replaced(scalar(item, MOTORS), sequence(item, motors))
    robot = _extended(
        robot, {"joints": [*joints, *_items(part, "joints")], "links": [*links, *_items(part, "links")]}
    )
    robot = _extended(robot, {key: _items(part, key) for key in ("couplers", "loops")})
    for group in ("points", "frames"):
        robot = _joined(robot, part, group)
    return robot


def prefix_of(node: Mapping, path: Path) -> str:
    """Return the prefix of names that a map asks for, empty for none."""
    prefix = node.get(PREFIX)
    if prefix is None:
        return ""
    if not isinstance(prefix, Scalar) or not _PREFIX.fullmatch(prefix.text):
        message = (
            f"{describe_node(prefix)} cannot begin a name; allowed: letters, digits and _, such as 'left_'"
        )
        raise located(prefix, dotted((*path, PREFIX)), message)
    return prefix.text


def _parent(robot: Mapping, item: Mapping, path: Path) -> Node:
    """Return the name of the link that an item is attached to."""
    parent = item.get("to") or scalar(item, GROUND)
    links = [GROUND, *(name for name in map(name_of, _items(robot, "links")) if name)]
    if isinstance(parent, Scalar) and parent.text not in links:
        raise located(parent, dotted((*path, "to")), unknown_name("link", parent.text, links))
    return parent


def _motors(robot: Mapping) -> list[Node]:
    """Return the joints of a robot that have motors: all that are not fixed, where it does not say."""
    if robot.get(MOTORS) is not None:
        return [*_items(robot, MOTORS)]
    moving = []
    for joint in _items(robot, "joints"):
        kind = joint.get("type") if isinstance(joint, Mapping) else None
        if isinstance(joint, Mapping) and isinstance(kind, Scalar) and kind.text != "fixed":
            moving += [name] if (name := joint.get("name")) is not None else []
    return moving


def _one_convention(robot: Mapping, part: Mapping, item: Mapping, path: Path) -> Mapping:
    """Return the robot with the D-H convention of the part, where the part needs one."""
    theirs, ours = part.get("convention"), robot.get("convention")
    if theirs is None or not _has_dh(part):
        return robot
    if (
        isinstance(ours, Scalar)
        and isinstance(theirs, Scalar)
        and ours.text != theirs.text
        and _has_dh(robot)
    ):
        message = (
            f"has {theirs.text} D-H parameters, and the robot that it is attached to has {ours.text} ones"
        )
        allowed = "allowed: one convention, or parts placed by 'origin' and 'axis'"
        raise located(item, dotted(path), f"{message}; {allowed}")
    return robot.replaced(scalar(theirs, "convention"), theirs)


def _has_dh(robot: Mapping) -> bool:
    joints = _items(robot, "joints")
    return any(isinstance(joint, Mapping) and any(joint.get(key) for key in DH) for joint in joints)


# -- names -------------------------------------------------------------------------------------------------
def with_prefix(robot: Mapping, prefix: str, ground: str = GROUND) -> Mapping:
    """Return a robot with a prefix before all its names; what was the ground is the link ``ground``."""

    def link(name: str) -> str:
        return ground if name == GROUND else prefix + name

    def own(name: str) -> str:
        return prefix + name

    group = robot.get("points")
    points = {k.text for k, _ in group.entries} if isinstance(group, Mapping) else ()

    def place(reference: str) -> str:
        of, dot, name = reference.partition(".")
        return f"{link(of)}.{name}" if dot and name not in points else own(name or of)

    changes: dict[str, Callable[[Node], Node]] = {
        "joints": lambda node: _each(node, {"name": own, "parent": link, "link": link}),
        "links": lambda node: _each(node, {"name": own}),
        MOTORS: lambda node: _named(node, own),
        "couplers": lambda node: _each(node, {"name": own, "terms": own}),
        "loops": lambda node: _each(node, {"name": own, "between": place}),
        "points": lambda node: _places(node, own, link),
        "frames": lambda node: _places(node, own, link),
    }
    kept = [(k, v) for k, v in robot.entries if k.text != "base" or ground == GROUND]
    return mapping(robot, [(k, changes[k.text](v) if k.text in changes else v) for k, v in kept])


def _each(items: Node, renames: dict[str, Rename]) -> Node:
    """Return a list of maps with names replaced by the keys they stand at, or those of the keys of a map there."""
    if not isinstance(items, Sequence):
        return items
    return sequence(items, [_renamed(item, renames) for item in items.items])


def _renamed(item: Node, renames: dict[str, Rename]) -> Node:
    if not isinstance(item, Mapping):
        return item
    return mapping(
        item, [(k, _named(v, renames[k.text]) if k.text in renames else v) for k, v in item.entries]
    )


def _named(node: Node, rename: Rename) -> Node:
    if isinstance(node, Mapping):
        return mapping(node, [(_text(k, rename), v) for k, v in node.entries])
    if isinstance(node, Sequence):
        return sequence(node, [_named(item, rename) for item in node.items])
    return _text(node, rename) if isinstance(node, Scalar) and node.value is not None else node


def _text(node: Scalar, rename: Rename) -> Scalar:
    name = rename(node.text)
    return dataclasses.replace(node, text=name, value=name)


def _places(group: Node, own: Rename, link: Rename) -> Node:
    if not isinstance(group, Mapping):
        return group
    return mapping(group, [(_text(k, own), _renamed(v, {"link": link})) for k, v in group.entries])


# -- lists -------------------------------------------------------------------------------------------------
def _explicit(robot: Mapping) -> Mapping:
    """Return a robot whose joints all say which link they move and hang on: the rules count within its own lists."""
    names = [item.get("name") if isinstance(item, Mapping) else None for item in _items(robot, "links")]
    joints: list[Node] = []
    before: Node = scalar(robot, GROUND)
    for k, joint in enumerate(_items(robot, "joints")):
        if isinstance(joint, Mapping):
            link = joint.get("link") or (names[k] if k < len(names) else None)
            if joint.get("parent") is None:
                joint = joint.replaced(scalar(joint, "parent"), before)
            if link is not None:
                joint, before = joint.replaced(scalar(joint, "link"), link), link
        joints.append(joint)
    place = robot.get("joints")
    return robot if place is None else robot.replaced(scalar(place, "joints"), sequence(place, joints))


def _items(robot: Mapping, key: str) -> tuple[Node, ...]:
    node = robot.get(key)
    return node.items if isinstance(node, Sequence) else ()


def _extended(robot: Mapping, more: dict[str, list[Node] | tuple[Node, ...]]) -> Mapping:
    """Return a robot with further items in its lists."""
    for key, items in more.items():
        if items:
            place = robot.get(key) or robot
            robot = robot.replaced(scalar(place, key), sequence(place, [*_items(robot, key), *items]))
    return robot


def _joined(robot: Mapping, part: Mapping, key: str) -> Mapping:
    """Return a robot with the named places of a part beside its own."""
    ours, theirs = robot.get(key), part.get(key)
    if not isinstance(theirs, Mapping):
        return robot
    known = ours.entries if isinstance(ours, Mapping) else ()
    names = [k.text for k, _ in known]
    for name, _ in theirs.entries:
        if name.text in names:
            raise located(
                name, dotted(("robot", key, name.text)), "appears twice; give the attached robot a 'prefix'"
            )
    return robot.replaced(scalar(theirs, key), mapping(theirs, [*known, *theirs.entries]))


def _map(place: Node, entries: dict[str, Node]) -> Mapping:
    return mapping(place, [(scalar(place, key), value) for key, value in entries.items()])
