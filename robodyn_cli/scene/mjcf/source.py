"""The text that MuJoCo's compiler is given: one file with what was included, without what no equation reads.

All of it was read within bounds before, so that the compiler opens no file and meets nothing that our reader refuses.
Each element has a line of its own, by which the compiler's messages lead back to the file and line of the user.
"""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Iterator
from xml.sax.saxutils import quoteattr

from robodyn_cli.errors import shown
from robodyn_cli.record import record
from robodyn_cli.scene.text.nodes import Faults, Source
from robodyn_cli.scene.text.yaml_text import MAX_BYTES, read_text
from robodyn_cli.scene.unread import Children, left_out
from robodyn_cli.scene.urdf.xml import MAX_DEPTH, XmlElement, parse_xml

# with all copies of <replicate>; the compiler's time and memory grow with the square
MOST_BODIES, MOST_ELEMENTS = 1000, 20_000
_ENDLESS = re.compile(r"[-+]?(nan|inf|infinity)(\(.*\))?")
_BODIES = "the bodies themselves"
_RIGID = "rigid bodies"
_IN_BODY = ("body", "frame", "replicate", "joint", "freejoint", "inertial", "geom", "site")
_BODY = Children(
    _IN_BODY,
    ("camera", "light"),
    (("composite", _BODIES), ("flexcomp", _RIGID), ("attach", _BODIES), ("plugin", "'forces' in the scene")),
)
_ACTUATORS = (
    "general", "motor", "position", "velocity", "intvelocity", "damper", "cylinder", "muscle", "adhesion", "dcmotor",
    "pid", "orientation",
)  # fmt: skip
_TIES = ("connect", "weld", "joint", "tendon")
_LEAVES = (*_ACTUATORS, *_TIES, "freejoint", "inertial", "geom", "site", "mesh", "flag", "pulley")
_PLUGIN = (("plugin", "a shape or a mass without one"),)
ELEMENTS: dict[str, Children] = {
    **dict.fromkeys(_LEAVES, Children((), (), _PLUGIN)),
    "mujoco": Children(
        ("compiler", "option", "default", "asset", "worldbody", "equality", "tendon", "actuator", "deformable"),
        ("size", "statistic", "visual", "custom", "keyframe", "sensor", "contact"),
        (("extension", "a file without plugins"),),
    ),
    "compiler": Children((), ("lengthrange",)),
    "option": Children(("flag",)),
    "default": Children(
        ("default", "joint", "geom", "site", "mesh", "equality", "tendon", *_ACTUATORS),
        ("material", "camera", "light", "pair", "flex"),
    ),
    "asset": Children(
        ("mesh",),
        ("texture", "material", "hfield", "skin"),
        (("model", "the model itself, in one file or by <include>"),),
    ),
    **dict.fromkeys(("worldbody", "body", "frame", "replicate"), _BODY),
    "deformable": Children((), ("skin",), (("flex", _RIGID),)),
    "equality": Children(_TIES, (), tuple((tag, _RIGID) for tag in ("flex", "flexvert", "flexstrain"))),
    "tendon": Children(("fixed", "spatial")),
    "fixed": Children(("joint",)),
    "spatial": Children(("site", "geom", "pulley")),
    "actuator": Children(_ACTUATORS, (), (("plugin", "'control' in the scene"),)),
}  # fmt: skip


@record
class MjcfText:
    """What the compiler is given; ``elements`` : by line. left : how many elements of each kind are left out.

    files : those that were included.
    """

    root: XmlElement
    text: str
    elements: tuple[XmlElement, ...]
    left: Counter[str]
    files: tuple[str, ...]

    def of(self, info: str) -> XmlElement:
        """Return the element of which the compiler says ``line N`` last, the file's root where it says nothing."""
        number = info.rpartition("line ")[2].split()[0:1]
        known = number and number[0].isdigit() and 0 < int(number[0]) <= len(self.elements)
        return self.elements[int(number[0]) - 1] if known else self.root


def source_text(root: XmlElement, faults: Faults) -> MjcfText | None:
    """Return the text for the compiler, None where something in it is refused, which is reported.

    Raises
    ------
    SceneError : an included file cannot be read; there are too many bodies or elements.
    """
    files = _Files(root)
    files.include(root, files.folder)
    left = left_out(root, ELEMENTS, faults)
    _check_number(root)
    lines = list(_lines(root)) if not faults.found else []
    elements = tuple(element for _, element in lines)
    for element in {id(element): element for element in elements}.values():
        with faults:
            _check_numbers(element)
    if not faults.found and not any(element.tag == "body" for element in elements):
        raise root.error("the file has no <body>; allowed: one or more")
    if faults.found:
        return None
    return MjcfText(root, "\n".join(line for line, _ in lines), elements, left, tuple(files.names))


def _check_numbers(element: XmlElement) -> None:
    """Raise the error of an element with a number that is not finite, with which the compiler may go on."""
    for key, text in element.attributes.items():
        if any(_ENDLESS.fullmatch(word) for word in text.lower().split()):
            raise element.error(f"{key} of <{element.tag}> is {shown(text)}; allowed: finite numbers")


class _Files:
    """The files that an MJCF includes: each once, from the folder of the first, or of the file that includes it."""

    def __init__(self, root: XmlElement) -> None:
        source = root.place.source
        self.folder = source.directory
        self.names: list[str] = []
        self.included = {os.path.realpath(source.name)}
        self.bytes = 0

    def include(self, element: XmlElement, folder: str, depth: int = 1) -> None:
        """Put the elements of files in the place of each <include>."""
        if depth > MAX_DEPTH:
            raise element.error(f"elements are nested more than {MAX_DEPTH} deep, with what is included")
        children = []
        for child in element.children:
            if child.tag == "include":
                inner, its = self.opened(child, folder)
                self.include(inner, its, depth + 1)
                children += inner.children
            else:
                self.include(child, folder, depth + 1)
                children.append(child)
        element.children = children

    def opened(self, element: XmlElement, folder: str) -> tuple[XmlElement, str]:
        """Return the root of an included file, and its folder.

        Raises
        ------
        SceneError : it cannot be read, was included before, or all files together are too large.
        """
        name = element.text("file", "include")
        tried = [os.path.normpath(os.path.join(at, name)) for at in (self.folder, folder)]
        path = next((path for path in tried if os.path.isfile(path)), tried[0])
        if (real := os.path.realpath(path)) in self.included:
            raise element.error(f"{path!r} is included already; allowed: each file once")
        self.included.add(real)
        text = read_text(path, element.place, "", path)
        self.bytes += len(text)
        if self.bytes > MAX_BYTES:
            raise element.error(f"the files included are larger than {MAX_BYTES // 1_000_000} MB in all")
        self.names.append(path)
        its = os.path.dirname(path) or "."
        return parse_xml(text, Source(path, its, real, element.place.source)), its


def _check_number(root: XmlElement) -> None:
    """Raise the error of a file with more bodies or elements than the compiler is given."""
    bodies = elements = 0
    pending = [(root, 1)]
    while pending:
        element, copies = pending.pop()
        elements += copies
        bodies += copies if element.tag == "body" else 0
        if elements > MOST_ELEMENTS or bodies > MOST_BODIES:
            most = f"{MOST_BODIES} bodies and {MOST_ELEMENTS} elements"
            raise element.error(
                f"there are more bodies or elements here than are read; allowed: {most}, with all copies of <replicate>"
            )
        if element.tag == "replicate":
            copies *= max(1, int(min(element.number("count", "replicate"), 1e9)))
        pending += ((child, copies) for child in reversed(list(_read_in(element))))


def _read_in(element: XmlElement) -> Iterator[XmlElement]:
    """Yield the children of an element that the compiler is given."""
    known = ELEMENTS[element.tag].read
    yield from (child for child in element.children if child.tag in known)


def _lines(element: XmlElement) -> Iterator[tuple[str, XmlElement]]:
    """Yield the lines of an element, each with the element that it is about."""
    # a material is for pictures, and its name means nothing without <asset>
    given = "".join(
        f" {key}={quoteattr(text)}" for key, text in element.attributes.items() if key != "material"
    )
    yield f"<{element.tag}{given}>", element
    for child in _read_in(element):
        yield from _lines(child)
    yield f"</{element.tag}>", element
