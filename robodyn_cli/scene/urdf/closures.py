"""Closed loops and couplings that dialects of URDF hold beside the tree, as loops and couplers of the robot.

- URDF+ (arXiv 2411.19753): ``<loop>`` and ``<coupling>`` between a predecessor and a successor link;
- the constraints proposed for ROS: ``<constraint>`` between a parent and a child link;
- Isaac Sim: ``<loop_joint>`` between ``<link1>`` and ``<link2>``;
- the Extended URDF (arXiv 2504.04767) has its loops in a YAML file beside, see ``extended.py``.

A frame at each end is given in its link's frame. All published frames of ``<loop>`` have the axes of their links, so
that no file decides in which frame its ``<axis>`` is meant: here it is the loop's frame, as for joints.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from robodyn_cli.errors import did_you_mean, shown, unknown_name
from robodyn_cli.scene.text.nodes import Faults
from robodyn_cli.scene.ties import Closure, Coupling, LoopEnd
from robodyn_cli.scene.urdf.drake import DRAKE, constraint
from robodyn_cli.scene.urdf.elements import X_AXIS, UrdfJoint, UrdfPose, UrdfRobot, pose_of
from robodyn_cli.scene.urdf.structure import SINGLE
from robodyn_cli.scene.urdf.xml import XmlElement

# what a dialect calls a closure, by the kind of the scene's loops
_OF_LOOP = {"continuous": "revolute", **{x: x for x in ("revolute", "prismatic", "planar", "fixed")}}
_OF_CONSTRAINT = {"spherical": "spherical", "revolute": "revolute", "fixed": "fixed", "LINK": "fixed"}
_OF_LOOP_JOINT = {"spherical": "spherical"}


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
    if len(twice := element.all("link1")) == 2 and not element.all("link2"):
        raise twice[1].error(
            f"{owner} has a second <link1> and no <link2>, as an example in Isaac Sim's manual; allowed: <link2> here"
        )
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
