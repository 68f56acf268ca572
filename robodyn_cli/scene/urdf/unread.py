"""What a URDF holds beside the format: what acts on the motion is refused, what does not is counted.

Without such an element the robot would be another one, and nobody would see it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from robodyn_cli.scene.text.nodes import Faults
from robodyn_cli.scene.urdf.xml import XmlElement

SHAPES = ("visual", "collision")
_READ = {
    "link": ("inertial", *SHAPES),
    "joint": ("parent", "child", "origin", "axis", "limit", "dynamics", "mimic"),
}
# of dialects, see ``closures.py``
TIES = ("loop", "loop_joint", "constraint", "coupling")
DRAKE = "drake:"
_OF_DRAKE = {
    "ball_constraint": "'loops'",
    "weld_constraint": "'loops'",
    "distance_constraint": "'loops'",
    "tendon_constraint": "'couplers'",
    "linear_bushing_rpy": "'forces'",
    "linear_spring_damper": "'forces'",
    "gear_ratio": "'drives'",
    "rotor_inertia": "'drives'",
}
# of Drake's elements those for contact and for pictures
_DRAWN_BY_DRAKE = frozenset(
    {
        "accepting_renderer", "capsule", "collision_filter_group", "declare_convex", "diffuse_map", "ellipsoid",
        "illustration_properties", "perception_properties", "proximity_properties",
    }
)  # fmt: skip


def refuse_acting(root: XmlElement, faults: Faults) -> None:
    """Report each element of another dialect that acts on the motion."""
    for element, instead in (*_of_gazebo(root), *_of_drake(root)):
        name = element.attributes.get("name", "")
        called = f"<{element.tag}> {name!r}" if name else f"<{element.tag}>"
        with faults:
            raise element.error(
                f"{called} acts on the motion, and is not read; allowed: {instead} in the scene"
            )


def _of_gazebo(root: XmlElement) -> Iterator[tuple[XmlElement, str]]:
    """Yield the joints of Gazebo, which have the meaning of SDF."""
    for element in root.children:
        if element.tag == "gazebo":
            parts = (element, *element.all("model"))
            joints = (part for owner in parts for part in owner.children if part.tag in ("joint", "gearbox"))
            yield from ((joint, "'loops' or 'couplers'") for joint in joints)


def _of_drake(root: XmlElement) -> Iterator[tuple[XmlElement, str]]:
    """Yield Drake's own elements, wherever they stand."""
    pending = [root]
    while pending:
        element = pending.pop()
        tag = element.tag.removeprefix(DRAKE)
        if tag == element.tag:
            pending += reversed(element.children)
        elif tag not in _DRAWN_BY_DRAKE:
            yield element, _OF_DRAKE.get(tag, "'loops', 'couplers' or 'forces'")


def left_out(root: XmlElement) -> Counter[str]:
    """Count what is not read and says nothing about the motion, by tag."""
    beside = [child.tag for child in root.children if child.tag not in (*_READ, *TIES)]
    inside = [
        part.tag
        for owner in root.children
        for part in owner.children
        if owner.tag in _READ and part.tag not in _READ[owner.tag]
    ]
    return Counter((*beside, *inside))
