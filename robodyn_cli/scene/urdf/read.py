"""Read a URDF: elements, structure, mimics, and the tree that stands for ``robot`` in a scene."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator
from collections.abc import Mapping as MappingOf

from robodyn_cli.errors import listed
from robodyn_cli.scene.dialects import Description, Packages, RobotTree
from robodyn_cli.scene.text.nodes import Faults, Mapping, Sequence
from robodyn_cli.scene.ties import Ties, motors_by_effort
from robodyn_cli.scene.urdf.closures import closures_of, couplings_of
from robodyn_cli.scene.urdf.elements import UrdfRobot, read_elements
from robodyn_cli.scene.urdf.extended import with_file_beside
from robodyn_cli.scene.urdf.meshes import missing_meshes
from robodyn_cli.scene.urdf.structure import (
    SINGLE,
    Relation,
    check_structure,
    moving_links,
    relations,
    with_rotors,
)
from robodyn_cli.scene.urdf.tree import robot_tree
from robodyn_cli.scene.urdf.xml import XmlElement


def read_urdf(root: XmlElement, faults: Faults, packages: Packages) -> Description | None:
    """Return the robot of a URDF, None where there are faults; see ``dialects``.

    Raises
    ------
    SceneError : what the file says is not allowed.
    """
    robot = with_rotors(read_elements(root, faults), faults)
    if not faults.found:
        check_structure(robot, faults)
    if faults.found:
        return None
    beside = with_file_beside(robot, faults)
    robot = beside.robot
    related = relations({joint.name: joint for joint in robot.joints})
    ties = Ties(
        (*closures_of(robot, faults), *beside.closures),
        couplings_of(robot, faults),
        beside.motors or motors_by_effort(dict(_efforts(robot, related))),
    )
    ties.check_names(faults)
    if faults.found:
        return None
    file = root.place.source.name
    tree = robot_tree(robot, related, ties, file, packages)
    notes = (*_notes(robot), *beside.notes, *_missing(robot, file, packages))
    files = (beside.file,) if beside.file else ()
    return Description(file, tree, _heading(robot, tree), notes, _warnings(robot), files)


def _efforts(robot: UrdfRobot, related: MappingOf[str, Relation]) -> Iterator[tuple[str, float | None]]:
    """Yield the joints with one coordinate that move, each with its effort."""
    for joint in robot.joints:
        if joint.type in SINGLE and (joint.name not in related or related[joint.name].joint):
            yield joint.name, joint.limits.get("effort")


def _visuals(root: Mapping) -> Iterator[Sequence]:
    """Yield the shapes of each link that has some."""
    links = root.get("links")
    for link in links.items if isinstance(links, Sequence) else ():
        shapes = link.get("visual") if isinstance(link, Mapping) else None
        if isinstance(shapes, Sequence):
            yield shapes


def _heading(robot: UrdfRobot, tree: RobotTree) -> tuple[str, ...]:
    """Return where the robot is from, what it holds and what is left out."""
    file = os.path.basename(robot.element.place.source.name)
    kinds = Counter(joint.type for joint in robot.joints)
    mass = sum(link.inertial.mass for link in robot.links if link.inertial is not None)
    drawn = sum(len(shapes.items) for shapes in _visuals(tree.root))
    shapes = sum(len(link.shapes) for link in robot.links)
    left = Counter({"visual and collision": shapes - drawn}) + robot.ignored
    texts = [
        f"{robot.name or 'Robot'}, from {file} by `robodyn import`. SI units, angles in radians.",
        f"{len(robot.links)} links of {mass:.6g} kg in all; joints: "
        + (", ".join(f"{n} {kind}" for kind, n in kinds.items()) or "none"),
        "Frames, centres of mass and inertias are those of the URDF: inertias are about the centre of mass.",
    ]
    if left:
        texts.append(
            "No part of the equations, so left out: " + ", ".join(f"{n} {what}" for what, n in left.items())
        )
    return tuple(texts)


def _notes(robot: UrdfRobot) -> tuple[str, ...]:
    massless = [link.name for link in robot.links if link.massless]
    left = ", ".join(f"{n} <{tag}>" for tag, n in robot.ignored.items())
    return (
        *((f"left out, for no equation reads it: {left}",) if left else ()),
        *((f"massless links: {listed(massless)}",) if massless else ()),
    )


def _missing(robot: UrdfRobot, urdf: str, packages: Packages) -> tuple[str, ...]:
    missing = missing_meshes(robot, urdf, packages)
    if not missing:
        return ()
    meshes = "a mesh is" if len(missing) == 1 else f"{len(missing)} meshes are"
    return (f"{meshes} not there, which matters for pictures only; the first: {missing[0]}",)


def _warnings(robot: UrdfRobot) -> tuple[str, ...]:
    moving = moving_links(robot)
    hollow = [link.name for link in robot.links if link.massless and link.shapes and link.name in moving]
    drag = [j.name for j in robot.joints if j.type in ("floating", "planar") and (j.damping or j.friction)]
    texts = {
        "links that have a shape but no mass, and move as if they weighed nothing": hollow,
        "damping and friction of joints with several coordinates, which are left out": drag,
        "limits whose lower is above their upper, which are left out": _crossed(robot),
    }
    return tuple(f"{title}: {listed(names)}" for title, names in texts.items() if names)


def _crossed(robot: UrdfRobot) -> list[str]:
    """List the joints whose limits are the wrong way round, with their lines."""
    crossed = []
    for joint in robot.joints:
        lower, upper = (joint.limits.get(k, 0.0) for k in ("lower", "upper"))
        limit = joint.element.one("limit", joint.name)
        if limit is not None and joint.type in SINGLE and joint.type != "continuous" and lower > upper:
            crossed.append(f"{joint.name} (line {limit.place.line}: lower {lower:g}, upper {upper:g})")
    return crossed
