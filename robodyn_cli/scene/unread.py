"""What a description of a robot holds beside what is read: what acts on the motion is refused, the rest is counted.

Without an element that acts the robot would be another one, and nobody would see it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping

from robodyn_cli.errors import did_you_mean, listed, nearest_word
from robodyn_cli.record import record
from robodyn_cli.scene.text.nodes import Faults
from robodyn_cli.scene.urdf import drake
from robodyn_cli.scene.urdf.xml import XmlElement

SHAPES = ("visual", "collision")


@record
class Children:
    """The children of an element: what is read, and what no equation reads; the rest is refused.

    acting : what to do instead, for those (and attributes) that act on the motion. open : whether any other child or
    attribute says nothing of it. attributes : those that are read, None where somebody else looks at them.
    """

    read: tuple[str, ...]
    left: tuple[str, ...] = ()
    acting: tuple[tuple[str, str], ...] = ()
    open: bool = False
    attributes: tuple[str, ...] | None = None


_ENDS = ("predecessor", "successor")
_OF_CONSTRAINT = tuple(f"{end}{part}" for end in ("parent", "child") for part in ("", "_origin", "_axis"))
POSE = Children((), attributes=("xyz", "rpy", "quat_xyzw"))
TIES = ("loop", "coupling", "constraint", "loop_joint")
# of what closes loops in dialects of URDF, see ``urdf/closures.py``
OF_CLOSURES = {
    "loop": Children((*_ENDS, "axis"), attributes=("name", "type")),
    "coupling": Children((*_ENDS, "ratio"), attributes=("name", "type")),
    "constraint": Children((*_OF_CONSTRAINT, *_ENDS), attributes=("name", "type")),
    "loop_joint": Children(("link1", "link2"), attributes=("name", "type")),
    "ratio": Children((), attributes=("value",)),
    **dict.fromkeys(_ENDS, Children(("origin",), attributes=("link",))),
    **dict.fromkeys(("parent", "child"), Children((), attributes=("link",))),
    **dict.fromkeys(("link1", "link2"), Children((), attributes=("link", "xyz", "rpy"))),
    **dict.fromkeys(("parent_origin", "child_origin"), POSE),
    **dict.fromkeys(("parent_axis", "child_axis"), Children((), attributes=("xyz",))),
}
_VALUE = Children((), attributes=("value",))
# of Drake, in URDF and SDF, where ``drake.refused`` looks at the children
OF_DRAKE_ELEMENTS = {
    "drake:mimic": Children((), attributes=("joint", "multiplier", "offset")),
    **{f"drake:{tag}": _VALUE for tag in ("rotor_inertia", "gear_ratio", "screw_thread_pitch")},
    **{
        f"drake:{kind}_constraint{part}": known
        for kind in ("ball", "distance", "weld")
        for part, known in (
            ("", Children(("parent", "child"), attributes=())),
            *((f"_{body}", Children((), attributes=("name",))) for body in ("body_A", "body_B")),
            *((f"_{point}", _VALUE) for point in ("p_AP", "p_BQ", "distance")),
        )
    },
    "transmission": Children(("type", "joint", "actuator"), open=True, attributes=("name", "type")),
    "actuator": Children((), open=True, attributes=("name",)),
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
        left.update(_unread_attributes(owner, known, faults))
        for child in owner.children:
            if child.tag in known.read or drake.is_read(child, owner):
                pending += [child] if child.tag in elements else []
            elif child.tag in known.left or ":" in child.tag or (known.open and not _slip(child.tag, known)):
                left[child.tag] += 1
                if known.open and ":" not in child.tag:
                    _refuse_misplaced(child, owner, faults)
            else:
                with faults:
                    raise child.error(f"<{child.tag}> in <{owner.tag}> {_problem(child.tag, known)}")
    return +left


def _slip(tag: str, known: Children) -> bool:
    """Tell whether a tag is so near to one that is read, that it must be meant."""
    return nearest_word(tag, (*known.read, *known.left), 0.75) is not None


def _problem(tag: str, known: Children) -> str:
    instead = dict(known.acting).get(tag)
    if instead is not None:
        return f"acts on the motion, and is not read; allowed: {instead}"
    hint = did_you_mean(tag, (*known.read, *known.left))
    return f"is not known{hint}; read: {listed(known.read) or 'nothing'}"


def _unread_attributes(element: XmlElement, known: Children, faults: Faults) -> list[str]:
    """Return the attributes that are left out, as a start of the element; slips of the pen are reported, and where
    the element is not open all others."""
    if known.attributes is None:
        return []
    left = []
    for name, text in element.attributes.items():
        others = ":" in name and not name.startswith(drake.DRAKE)
        if name in known.attributes or name == "xmlns" or others:
            continue
        slip, instead = did_you_mean(name, known.attributes), dict(known.acting).get(name)
        acts = instead is not None and text.strip(" 0.")
        if not acts and (instead is not None or (known.open and not slip)):
            left.append(f"{element.tag} {name}=...")
            continue
        problem = f"is not known{slip}; read: {listed(known.attributes) or 'no attribute'}"
        if acts:
            problem = f"acts on the motion, and is not read; allowed: {instead}"
        with faults:
            raise element.error(f"{name!r} of <{element.tag}> {problem}")
    return left


def _refuse_misplaced(element: XmlElement, owner: XmlElement, faults: Faults) -> None:
    """Report what closes loops or couples joints, by its name, where nothing reads it: here, or within."""
    pending = [(element, owner)]
    while pending:
        child, above = pending.pop()
        pending += [(one, child) for one in child.children]
        word = child.tag.lower()
        # constraints of Gazebo are those of its contacts
        near = nearest_word(word, ("constraint", "coupling", "coupler"), 0.8) or word.endswith("_constraint")
        if drake.acts(child) and element.tag != "transmission":  # one without a rotor
            with faults:
                raise child.error(
                    f"<{child.tag}> in <{above.tag}> is not read; allowed: {drake.instead(child)} in the scene"
                )
        elif "mimic" in word or "loop" in word or (near and element.tag != "gazebo"):
            with faults:
                raise child.error(
                    f"<{child.tag}> in <{above.tag}> is not read, and may act on the motion; allowed: "
                    f"{listed([f'<{tag}>' for tag in TIES])} in <robot>, or 'loops' and 'couplers' in the scene"
                )
