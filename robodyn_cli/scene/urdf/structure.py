"""The tree of a URDF robot: names once, one root, every link moved by one joint."""

from __future__ import annotations

from collections.abc import Iterable

from robodyn_cli.errors import did_you_mean, shown
from robodyn_cli.scene.text.faults import Faults
from robodyn_cli.scene.urdf.elements import UrdfJoint, UrdfLink, UrdfRobot


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
                    what = f"joint {joint.name!r}: its {tag} {shown(name)} is no link of this file{hint}"
                    raise joint.element.error(what)
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


def _unique(what: str, items: Iterable[UrdfLink | UrdfJoint], faults: Faults) -> None:
    seen: set[str] = set()
    for item in items:
        with faults:
            if item.name in seen:
                raise item.element.error(f"{what} {item.name!r} appears twice; names of {what}s must differ")
            seen.add(item.name)


def _one_root(robot: UrdfRobot, moved: dict[str, UrdfJoint]) -> None:
    roots = [link for link in robot.links if link.name not in moved]
    if len(roots) > 1:
        listed = ", ".join(repr(link.name) for link in roots)
        raise roots[1].element.error(
            f"no joint moves the links {listed}; allowed: one root, to which all others lead"
        )
    grounded = {link.name for link in roots}
    for link in robot.links:
        chain: dict[str, None] = {}
        name = link.name
        while name not in grounded:
            if name in chain:
                names = list(chain)
                loop = " -> ".join([*names[names.index(name) :], name])
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
        found = moves.get(name, False)
        for name in reversed(chain):
            found = found or above[name].type != "fixed"
            moves[name] = found
    return {name for name, moving in moves.items() if moving}
