"""Read an SDF: elements, structure, and the tree that stands for ``robot`` in a scene."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator

from robodyn_cli.errors import listed
from robodyn_cli.scene.dialects import Description, Packages
from robodyn_cli.scene.sdf.elements import SdfRobot, read_elements
from robodyn_cli.scene.sdf.frames import MODEL, WORLD
from robodyn_cli.scene.sdf.joints import SdfJoint
from robodyn_cli.scene.sdf.structure import SdfStructure, structure_of
from robodyn_cli.scene.sdf.tree import robot_tree
from robodyn_cli.scene.text.nodes import Faults
from robodyn_cli.scene.unread import refuse_acting
from robodyn_cli.scene.urdf.xml import XmlElement

_TURNS = ("revolute", "continuous", "ball", "universal", "revolute2", "screw")


def read_sdf(root: XmlElement, faults: Faults, packages: Packages) -> Description | None:
    """Return the robot of an SDF, None where there are faults; see ``dialects``.

    Raises
    ------
    SceneError : what the file says is not allowed.
    """
    refuse_acting(root, faults)
    robot = read_elements(root, faults)
    if not faults.found and not robot.links:
        raise root.error("the file has no <link>; allowed: one or more")
    structure = None if faults.found else structure_of(robot, faults)
    if structure is None:
        return None
    tree = robot_tree(robot, structure, packages, faults)
    if faults.found:
        return None
    heading, notes = _heading(robot), tuple(_notes(robot, structure))
    return Description(root.place.source.name, tree, heading, notes, tuple(_warnings(robot, structure)))


def _heading(robot: SdfRobot) -> tuple[str, ...]:
    file = os.path.basename(robot.element.place.source.name)
    kinds = Counter(joint.type for joint in robot.joints)
    mass = sum(link.inertial.mass for link in robot.links)
    return (
        f"{robot.name or 'Robot'}, from {file} by `robodyn import`. SI units, angles in radians.",
        f"{len(robot.links)} links of {mass:.6g} kg in all; joints: "
        + (", ".join(f"{n} {kind}" for kind, n in kinds.items()) or "none"),
        "The poses of the SDF are q = 0. Each link has the axes that it has there, and its origin where the joint that "
        "turns it is; inertias are about the centre of mass.",
    )


def _notes(robot: SdfRobot, structure: SdfStructure) -> Iterator[str]:
    loops = [move.joint.name for move in structure.closing]
    welded = [move.joint.name for move in structure.moves if move.end]
    backward = [move.joint.name for move in structure.moves if move.backward]
    left = ", ".join(f"{n} <{tag}>" for tag, n in robot.ignored.items())
    texts = {
        "left out, for no equation reads it": left,
        "links that no joint ties to the world, so free": listed(structure.floating),
        "joints that close loops": listed(loops),
        "joints that close loops and keep their coordinate, by a weld to a massless link": listed(welded),
        "joints taken from child to parent": listed(backward),
        "joints between what does not move, left out": listed([joint.name for joint in structure.static]),
        "static links": listed(structure.held),
    }
    yield from (f"{title}: {names}" for title, names in texts.items() if names)


def _warnings(robot: SdfRobot, structure: SdfStructure) -> Iterator[str]:
    moving = structure.moving
    assumed = [link.name for link in robot.links if link.assumed and link.name in moving]
    if assumed:
        yield (
            "links whose mass or moments of inertia are not all written, which SDF gives 1 kg and 1 kg m^2: "
            f"{listed(assumed)}"
        )
    weightless = [
        link.name for link in robot.links if link.weightless and link.inertial.mass and link.name in moving
    ]
    if weightless:
        yield (
            f"links without gravity, on which that of the scene acts (gravity: [0, 0, 0] stands for theirs): "
            f"{listed(weightless)}"
        )
    crossed = [joint.name for joint in robot.joints if any(axis.crossed for axis in joint.axes)]
    if crossed:
        yield f"limits that leave no room, which are left out: {listed(crossed)}"
    apart = [joint.name for joint in robot.joints if _is_apart(robot, joint)]
    if apart:
        yield (
            "joints whose parent frame is not where the joint is: an SDF joint is where its child's frame is, whatever "
            f"its parent frame is: {listed(apart)}"
        )
    pending = [robot.element]
    while pending:
        element = pending.pop()
        pending += reversed(element.children)
        if element.tag == "plugin" and "DetachableJoint" in element.attributes.get("name", ""):
            yield (
                f"the plugin on line {element.place.line} ties two links, and is not run; a loop of type fixed in the "
                "scene does that"
            )


def _is_apart(robot: SdfRobot, joint: SdfJoint) -> bool:
    """Tell whether a joint that turns names a <frame> as its parent that is not on its axis."""
    frames = robot.frames
    if (
        joint.type not in _TURNS
        or joint.parent in (WORLD, MODEL)
        or frames.frames[joint.parent].element.tag != "frame"
    ):
        return False
    at, own = frames.pose(frames.frames[joint.parent]), frames.pose(joint.frame)
    gap = own[:3, 3] - at[:3, 3]
    if len(joint.axes) == 1:
        axis = joint.axes[0]
        given = frames.pose(frames.frames[axis.expressed_in]) if axis.expressed_in else own
        u = given[:3, :3] @ list(axis.xyz)
        gap = gap - u * (u @ gap)
    return bool(gap @ gap > 1e-12 * (1.0 + own[:3, 3] @ own[:3, 3]))
