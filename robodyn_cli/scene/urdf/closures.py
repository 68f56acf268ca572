"""Closed loops and couplings that dialects of URDF hold beside the tree, as loops and couplers of the robot.

- URDF+ (arXiv 2411.19753): ``<loop>`` and ``<coupling>`` between a predecessor and a successor link;
- the constraints proposed for ROS: ``<constraint>`` between a parent and a child link;
- Isaac Sim: ``<loop_joint>`` between ``<link1>`` and ``<link2>``;
- the Extended URDF (arXiv 2504.04767) has its loops in a YAML file beside, see ``extended.py``.

A frame at each end is given in its link's frame. All published frames of ``<loop>`` have the axes of their links, so
that no file decides in which frame its ``<axis>`` is meant: here it is the loop's frame, as for joints.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from robodyn_cli.errors import did_you_mean, shown, unknown_name
from robodyn_cli.record import record
from robodyn_cli.scene.text.nodes import Faults, Node, located, plain
from robodyn_cli.scene.urdf.drake import DRAKE, constraint
from robodyn_cli.scene.urdf.elements import X_AXIS, UrdfJoint, UrdfPose, UrdfRobot, pose_of
from robodyn_cli.scene.urdf.structure import SINGLE
from robodyn_cli.scene.urdf.xml import XmlElement, scene_names

# what a dialect calls a closure, by the kind of the scene's loops
_OF_LOOP = {"continuous": "revolute", **{x: x for x in ("revolute", "prismatic", "planar", "fixed")}}
_OF_CONSTRAINT = {"spherical": "spherical", "revolute": "revolute", "fixed": "fixed", "LINK": "fixed"}
_OF_LOOP_JOINT = {"spherical": "spherical"}
WITH_AXES = ("revolute", "prismatic", "planar", "universal")


@record
class LoopEnd:
    """One end of a closure: a frame on a link, and the closure's axis in that frame."""

    link: str
    pose: UrdfPose = UrdfPose()
    axis: tuple[float, ...] = X_AXIS


@record
class Closure:
    """Two frames that a closure of some ``type`` joins; ``place`` : where it is written; ``length`` : of a bar."""

    place: Node
    name: str
    type: str
    ends: tuple[LoopEnd, LoopEnd]
    length: float = 0.0


@record
class Coupling:
    """The sum of coefficient times q over joints that move is ``value``; ``place`` : where it is written."""

    place: Node
    name: str
    terms: dict[str, float]
    value: float = 0.0


@record
class Ties:
    """What a robot has beside its tree."""

    closures: tuple[Closure, ...]
    couplings: tuple[Coupling, ...]

    @property
    def names(self) -> list[str]:
        return [*(x.name for x in self.couplings), *(x.name for x in self.closures)]

    def check_names(self, faults: Faults) -> None:
        """Report names that appear twice."""
        seen: set[str] = set()
        ties: list[Closure | Coupling] = [*self.couplings, *self.closures]
        for tie in ties:
            with faults:
                if tie.name in seen:
                    raise located(tie.place, "", f"{tie.name!r} names two loops or couplings; allowed: one")
                seen.add(tie.name)


def closures_of(robot: UrdfRobot, faults: Faults) -> tuple[Closure, ...]:
    """Return the closures among the elements of a robot; those with errors are reported and left out."""
    links = [link.name for link in robot.links]
    closures: list[Closure] = []
    for element in robot.element.children:
        with faults:
            if element.tag in _READERS:
                closures.append(_READERS[element.tag](element))
                for end in closures[-1].ends:
                    _known(element, end.link, links)
    return tuple(closures)


def _known(element: XmlElement, link: str, links: list[str]) -> None:
    if link not in links:
        name = element.attributes.get("name", "")
        hint = did_you_mean(link, links)
        raise element.error(f"{element.tag} {name!r}: {shown(link)} is no link of this file{hint}")


def _kind(element: XmlElement, owner: str, kinds: Mapping[str, str]) -> str:
    kind = element.text("type", owner)
    if kind not in kinds:
        raise element.error(f"{owner}: {unknown_name('type', kind, kinds)}")
    return kinds[kind]


def _owner(element: XmlElement) -> tuple[str, str]:
    name = element.text("name", f"a {element.tag}")
    return name, f"{element.tag} {name!r}"


def _child(element: XmlElement, tag: str, owner: str) -> XmlElement:
    child = element.one(tag, owner)
    if child is None:
        raise element.error(f"{owner} needs <{tag} link=...>")
    return child


def _axis(element: XmlElement | None, owner: str) -> tuple[float, ...]:
    axis = X_AXIS if element is None else tuple(element.numbers("xyz", owner, 3, X_AXIS))
    if element is not None and not any(axis):
        raise element.error(f"{owner}: the axis is zero; allowed: a direction")
    return axis


def _loop(element: XmlElement) -> Closure:
    """Read ``<loop>`` of URDF+."""
    name, owner = _owner(element)
    kind, axis = _kind(element, owner, _OF_LOOP), _axis(element.one("axis", owner), owner)
    ends = [_child(element, tag, owner) for tag in ("predecessor", "successor")]
    first, second = (LoopEnd(end.text("link", owner), pose_of(end, owner), axis) for end in ends)
    return Closure(element.place, name, kind, (first, second))


def _constraint(element: XmlElement) -> Closure:
    """Read ``<constraint>`` of ROS; a draft of URDF+ has other elements with the same name."""
    name, owner = _owner(element)
    if element.all("predecessor") or element.all("successor"):
        raise element.error(
            f"{owner} is one of a draft of URDF+, which is not read; allowed: <loop> and <coupling> of URDF+"
        )
    kind = _kind(element, owner, _OF_CONSTRAINT)
    ends = []
    for tag in ("parent", "child"):
        link = _child(element, tag, owner).text("link", owner)
        pose = pose_of(element, owner, f"{tag}_origin")
        axis = element.one(f"{tag}_axis", owner) or element.one("parent_axis", owner)
        ends.append(LoopEnd(link, pose, _axis(axis, owner)))
    return Closure(element.place, name, kind, (ends[0], ends[1]))


def _loop_joint(element: XmlElement) -> Closure:
    """Read ``<loop_joint>`` of Isaac Sim, whose links have the attributes of an origin."""
    name, owner = _owner(element)
    kind = _kind(element, owner, _OF_LOOP_JOINT)
    ends = []
    for tag in ("link1", "link2"):
        end = _child(element, tag, owner)
        zero = (0.0, 0.0, 0.0)
        pose = UrdfPose(*(tuple(end.numbers(key, owner, 3, zero)) for key in ("xyz", "rpy")))
        ends.append(LoopEnd(end.text("link", owner), pose))
    return Closure(element.place, name, kind, (ends[0], ends[1]))


def _drake(element: XmlElement) -> Closure:
    """Read a constraint of Drake, which has no name."""
    kind, ends, length = constraint(element)
    first, second = (LoopEnd(link, UrdfPose(point)) for link, point in ends)
    name = f"{element.tag.removeprefix(DRAKE)}_{first.link}_{second.link}"
    return Closure(element.place, name, kind, (first, second), length)


OF_DRAKE = {f"{DRAKE}{kind}_constraint": _drake for kind in ("ball", "distance", "weld")}
_READERS = {"loop": _loop, "constraint": _constraint, "loop_joint": _loop_joint, **OF_DRAKE}


def couplings_of(robot: UrdfRobot, faults: Faults) -> tuple[Coupling, ...]:
    """Return the couplings of URDF+, of a robot whose structure has been checked.

    ratio times the sum of q over the joints from the nearest common ancestor of both links to the predecessor is that
    sum to the successor.
    """
    above = {joint.child: joint for joint in robot.joints}
    couplings = []
    for element in robot.element.all("coupling"):
        with faults:
            couplings.append(_coupling(element, above, [link.name for link in robot.links]))
    return tuple(couplings)


def _coupling(element: XmlElement, above: Mapping[str, UrdfJoint], links: list[str]) -> Coupling:
    name, owner = _owner(element)
    chains: list[list[UrdfJoint]] = []
    for tag in ("predecessor", "successor"):
        link = _child(element, tag, owner).text("link", owner)
        _known(element, link, links)
        chains.append(list(_joints_to(link, above)))
    ratio = element.one("ratio", owner)
    factor = 1.0 if ratio is None else ratio.number("value", owner)
    pairs = [[(joint.name, joint.type) for joint in chain] for chain in chains]
    terms = chain_terms(pairs[0], pairs[1], factor)
    for joint in (*chains[0], *chains[1]):
        if joint.name in terms and joint.type not in SINGLE:
            raise element.error(
                f"{owner} sums the coordinates of joint {joint.name!r}, which is {joint.type}; allowed: joints "
                "with one coordinate"
            )
    terms = {name: x for name, x in terms.items() if x != 0.0}
    if len(terms) < 2:
        raise element.error(
            f"{owner} relates {len(terms)} joint(s) that move; allowed: two or more on the way between its links, and "
            "a ratio that is not zero"
        )
    return Coupling(element.place, name, terms)


def chain_terms(
    first: Sequence[tuple[str, str]], second: Sequence[tuple[str, str]], factor: float
) -> dict[str, float]:
    """Return the coefficients of: factor times the sum over a chain of joints, minus the sum over another.

    first, second : names and types of the joints from a link to the root. Those on both ways, and fixed ones, do not
    count.
    """
    terms: dict[str, float] = {}
    for chain, other, sign in ((first, second, factor), (second, first, -1.0)):
        shared = {name for name, _ in other}
        terms |= {name: sign for name, kind in chain if name not in shared and kind != "fixed"}
    return terms


def _joints_to(link: str, above: Mapping[str, UrdfJoint]) -> Iterator[UrdfJoint]:
    """Yield the joints from a link to the root."""
    while link in above:
        yield above[link]
        link = above[link].parent


# -- as the scene has them ---------------------------------------------------------------------------------
def loop_of(closure: Closure, name: str, links: Mapping[str, str]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return a closure as an entry of ``loops``, and the points that it joins.

    links : names of links in the scene. A point at the origin of its link's frame needs no name.
    """
    points: dict[str, Any] = {}
    between = []
    for end, role in zip(closure.ends, ("predecessor", "successor")):
        link, at = links[end.link], list(end.pose.xyz)
        if any(at):
            points[f"{name}_{role}"] = {"link": link, "at": at}
        between.append(f"{name}_{role}" if any(at) else f"{link}.origin")
    entry: dict[str, Any] = {"name": name, "type": closure.type, "between": between}
    turned = [end.pose.rotation for end in closure.ends]
    axes = [[float(x) for x in R @ list(end.axis)] for R, end in zip(turned, closure.ends)]
    if closure.type == "distance":
        entry["length"] = closure.length
    if closure.type in WITH_AXES:
        entry["axis"] = axes[0]
    if closure.type == "universal" or (closure.type in ("revolute", "planar") and axes[0] != axes[1]):
        entry["axis2"] = axes[1]
    if closure.type in ("prismatic", "fixed"):
        rpy = rpy_of((turned[0] @ turned[1].T).tolist())
        entry |= {"rpy": rpy} if any(rpy) else {}
    return entry, points


def tie_entries(ties: Ties, joints: Iterable[str], links: Mapping[str, str]) -> dict[str, Any]:
    """Return the keys ``couplers``, ``points`` and ``loops`` of a robot, those that have something.

    joints, links : their names in the scene.
    """
    names = scene_names(ties.names, joints)
    couplers: list[Node] = []
    loops: list[Node] = []
    points: dict[str, Node] = {}
    for tie in ties.couplings:
        value = {"value": tie.value} if tie.value else {}
        couplers.append(plain(tie.place, {"name": names[tie.name], "terms": tie.terms, **value}))
    for closure in ties.closures:
        loop, joined = loop_of(closure, names[closure.name], links)
        loops.append(plain(closure.place, loop))
        points |= {name: plain(closure.place, point) for name, point in joined.items()}
    entries: dict[str, Any] = {"couplers": couplers, "points": points, "loops": loops}
    return {key: entry for key, entry in entries.items() if entry}


def rpy_of(R: list[list[float]]) -> list[float]:
    """Return roll, pitch, yaw [rad] of a rotation, to rounding at a pitch of 90 degrees too."""
    yaw = math.atan2(R[1][0], R[0][0])
    c, s = math.cos(yaw), math.sin(yaw)
    pitch = math.atan2(-R[2][0], c * R[0][0] + s * R[1][0])
    roll = math.atan2(s * R[0][2] - c * R[1][2], c * R[1][1] - s * R[0][1])
    return [roll, pitch, yaw]
