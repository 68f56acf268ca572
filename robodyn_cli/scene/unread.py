"""What a description of a robot holds beside what is read: what acts on the motion is refused, the rest is counted.

Without an element that acts the robot would be another one, and nobody would see it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping

from robodyn_cli.errors import did_you_mean, listed
from robodyn_cli.record import record
from robodyn_cli.scene.text.nodes import Faults
from robodyn_cli.scene.urdf import drake
from robodyn_cli.scene.urdf.xml import XmlElement

SHAPES = ("visual", "collision")


@record
class Children:
    """The children of an element: what is read, and what no equation reads; the rest is refused.

    acting : what to do instead, for those that act on the motion. open : whether any other child says nothing of it.
    """

    read: tuple[str, ...]
    left: tuple[str, ...] = ()
    acting: tuple[tuple[str, str], ...] = ()
    open: bool = False


_ENDS = ("predecessor", "successor")
_OF_CONSTRAINT = tuple(f"{end}{part}" for end in ("parent", "child") for part in ("", "_origin", "_axis"))
# of what closes loops in dialects of URDF, see ``urdf/closures.py``
OF_CLOSURES = {
    "loop": Children((*_ENDS, "axis")),
    "coupling": Children((*_ENDS, "ratio")),
    "constraint": Children((*_OF_CONSTRAINT, *_ENDS)),
    "loop_joint": Children(("link1", "link2")),
    **dict.fromkeys(_ENDS, Children(("origin",))),
}


def refuse_acting(root: XmlElement, faults: Faults) -> None:
    """Report each element of Drake or Gazebo that acts on the motion and is not read."""
    for element, instead in (*_of_gazebo(root), *drake.refused(root)):
        name = element.attributes.get("name", "")
        called = f"<{element.tag}> {name!r}" if name else f"<{element.tag}>"
        with faults:
            raise element.error(
                f"{called} acts on the motion, and is not read; allowed: {instead} in the scene"
            )


def _of_gazebo(root: XmlElement) -> Iterator[tuple[XmlElement, str]]:
    """Yield the joints of Gazebo in a URDF, which have the meaning of SDF, and springs in joints."""
    for element in root.all("gazebo"):
        parts = (element, *element.all("model"))
        joints = (part for owner in parts for part in owner.children if part.tag in ("joint", "gearbox"))
        yield from ((joint, "'loops' or 'couplers'") for joint in joints)
        springs = (one for one in element.all("springStiffness") if one.content.strip(" 0.\n\t"))
        yield from ((spring, "'spring' of the joint") for spring in springs)


def left_out(root: XmlElement, elements: Mapping[str, Children], faults: Faults) -> Counter[str]:
    """Count what is left out by tag; what is not known or acts on the motion is reported.

    elements : by tag. Elements of other programs (with a ``:``) are left out, see ``refuse_acting``.
    """
    left: Counter[str] = Counter()
    pending = [root]
    while pending:
        owner = pending.pop()
        known = elements[owner.tag]
        acting = dict(known.acting)
        for child in owner.children:
            if child.tag in known.read:
                pending += [child] if child.tag in elements else []
            elif child.tag in known.left or ":" in child.tag or known.open:
                left[child.tag] += 0 if drake.is_read(child, owner) else 1
            else:
                problem = f"is not known{did_you_mean(child.tag, known.read)}; read: {listed(known.read)}"
                if child.tag in acting:
                    problem = f"acts on the motion, and is not read; allowed: {acting[child.tag]}"
                with faults:
                    raise child.error(f"<{child.tag}> in <{owner.tag}> {problem}")
    return +left
