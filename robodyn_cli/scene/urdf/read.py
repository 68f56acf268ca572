"""Read a URDF file: XML, elements, structure, mimics, and the tree that stands for ``robot`` in a scene."""

from __future__ import annotations

from collections.abc import Mapping

from robodyn_cli.record import record
from robodyn_cli.scene.text.faults import Faults
from robodyn_cli.scene.text.nodes import Source
from robodyn_cli.scene.urdf.elements import UrdfRobot, missing_meshes, read_elements
from robodyn_cli.scene.urdf.structure import SINGLE, Relation, check_structure, moving_links, relations
from robodyn_cli.scene.urdf.tree import RobotTree, robot_tree
from robodyn_cli.scene.urdf.xml import parse_xml

NO_PACKAGES: Mapping[str, str] = {}


@record
class Urdf:
    """A URDF file that was read, under the name ``file``.

    notes : what the file leaves open. warnings : what makes its equations doubtful; without the file's name.
    """

    file: str
    robot: UrdfRobot
    tree: RobotTree
    notes: tuple[str, ...]
    warnings: tuple[str, ...]


def read_urdf(text: str, source: Source, faults: Faults, packages: Mapping[str, str] = NO_PACKAGES) -> Urdf:
    """Return the robot of a URDF text.

    Parameters
    ----------
    faults : takes all errors but the last, which is raised.
    packages : folders of packages of meshes, by name.

    Raises
    ------
    SceneError : the file is no URDF, or what it says is not allowed.
    """
    robot, relation = _checked(text, source, faults)
    tree = robot_tree(robot, relation, source.name, packages)
    notes = (*_notes(robot), *_missing(robot, source.name, packages))
    return Urdf(source.name, robot, tree, notes, _warnings(robot))


def _checked(text: str, source: Source, faults: Faults) -> tuple[UrdfRobot, dict[str, Relation]]:
    own = Faults()
    robot = None
    found: dict[str, Relation] = {}
    with own:
        robot = read_elements(parse_xml(text, source), own)
    if robot is not None and not own.found:
        check_structure(robot, own)
    if robot is not None and not own.found:
        with own:
            found = relations({joint.name: joint for joint in robot.joints})
    if robot is None or own.found:
        for error in own.found[:-1]:
            faults.report(error)
        raise own.found[-1]
    return robot, found


def _notes(robot: UrdfRobot) -> tuple[str, ...]:
    massless = [link.name for link in robot.links if link.massless]
    return (f"massless links: {', '.join(massless)}",) if massless else ()


def _missing(robot: UrdfRobot, urdf: str, packages: Mapping[str, str]) -> tuple[str, ...]:
    missing = missing_meshes(robot, urdf, packages)
    if not missing:
        return ()
    what = "a mesh is" if len(missing) == 1 else f"{len(missing)} meshes are"
    return (f"{what} not there, which matters for pictures only; the first: {missing[0]}",)


def _warnings(robot: UrdfRobot) -> tuple[str, ...]:
    moving = moving_links(robot)
    hollow = [link.name for link in robot.links if link.massless and link.shapes and link.name in moving]
    drag = [j.name for j in robot.joints if j.type in ("floating", "planar") and (j.damping or j.friction)]
    texts = {
        "links that have a shape but no mass, and move as if they weighed nothing": hollow,
        "damping and friction of joints with several coordinates, which are left out": drag,
        "limits whose lower is above their upper, which are left out": _crossed(robot),
    }
    return tuple(f"{what}: {', '.join(names)}" for what, names in texts.items() if names)


def _crossed(robot: UrdfRobot) -> list[str]:
    """List the joints whose limits are the wrong way round, with their lines."""
    found = []
    for joint in robot.joints:
        lower, upper = (joint.limits.get(k, 0.0) for k in ("lower", "upper"))
        limit = joint.element.one("limit", joint.name)
        if limit is not None and joint.type in SINGLE and joint.type != "continuous" and lower > upper:
            found.append(f"{joint.name} (line {limit.place.line}: lower {lower:g}, upper {upper:g})")
    return found
