"""XML read into elements that know their line and column; what could harm or hide something is refused.

expat alone keeps the place of an element and lets us refuse document types, with which entities are defined (bombs,
files of the machine), and deep nesting, on which readers recurse.

Names of a URDF file as names of a scene: letters, digits and _, each once.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable
from typing import Any
from xml.parsers import expat

from robodyn_cli.errors import SceneError, shown
from robodyn_cli.expr.formula import RESERVED
from robodyn_cli.record import mutable_record
from robodyn_cli.scene.text.nodes import Scalar, Source, located

MAX_DEPTH = 50
_NUMBER = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")


@mutable_record
class XmlElement:
    """An element of XML: its tag, attributes, children and text, and its place."""

    tag: str
    attributes: dict[str, str]
    place: Scalar
    children: list[XmlElement]
    content: str = ""

    def all(self, tag: str) -> list[XmlElement]:
        """Return the children with a tag."""
        return [child for child in self.children if child.tag == tag]

    def one(self, tag: str, owner: str) -> XmlElement | None:
        """Return the child with a tag, None if there is none; ``owner`` names this element in messages.

        Raises
        ------
        SceneError : there are several.
        """
        elements = self.all(tag)
        if len(elements) > 1:
            raise elements[1].error(f"{owner} has a second <{tag}>; allowed: one")
        return elements[0] if elements else None

    def text(self, name: str, owner: str) -> str:
        """Return an attribute that must be there."""
        value = self.attributes.get(name, "").strip()
        if not value:
            raise self.error(f"{owner}: <{self.tag}> needs the attribute {name!r}")
        return value

    def numbers(
        self, name: str, owner: str, size: int, default: tuple[float, ...] | None = None
    ) -> list[float]:
        """Return the ``size`` numbers of an attribute, separated by blanks; without a default it must be there."""
        if name not in self.attributes and default is not None:
            return list(default)
        given = self.attributes.get(name)
        return self._finite(given, size, f"{owner}: {name} of <{self.tag}>")

    def number(self, name: str, owner: str, default: float | None = None) -> float:
        """Return the number of an attribute; without a default it must be there."""
        return self.numbers(name, owner, 1, None if default is None else (default,))[0]

    def values(self, owner: str, size: int) -> list[float]:
        """Return the ``size`` numbers of its text, separated by blanks."""
        return self._finite(self.content, size, f"{owner}: <{self.tag}>")

    def value(self, tag: str, owner: str, default: float) -> float:
        """Return the number that is the text of the child with a tag."""
        child = self.one(tag, owner)
        return default if child is None else child.values(owner, 1)[0]

    def _finite(self, text: str | None, size: int, label: str) -> list[float]:
        values = [float(word) if _NUMBER.fullmatch(word) else math.nan for word in (text or "").split()]
        if len(values) == size and all(math.isfinite(x) for x in values):
            return values
        wanted = "a finite number" if size == 1 else f"{size} finite numbers, separated by blanks"
        given = "missing" if text is None else shown(text.strip())
        hint = "; '${' is an expression of xacro, which must run first" if "${" in given else ""
        raise self.error(f"{label} is {given}; allowed: {wanted}{hint}")

    def error(self, message: str) -> SceneError:
        """Return the error at the place of this element."""
        return located(self.place, "", message)


def parse_xml(text: str, source: Source) -> XmlElement:
    """Return the root element of a text; comments end at their first ``-->``, as robots' readers take them.

    Raises
    ------
    SceneError : broken XML, a document type (entities), nesting deeper than ``MAX_DEPTH``.
    """
    return _Parser(source).parse(text)


def _without_comments(text: str) -> str:
    """Return XML with blanks in the place of comments, in which expat allows no ``--``; lines stay where they are."""
    parts, at = [], 0
    while (start := text.find("<!", at)) >= 0:
        opening, closing = ("<!--", "-->") if text.startswith("<!--", start) else ("<![CDATA[", "]]>")
        end = text.find(closing, start + len(opening)) if text.startswith(opening, start) else start + 2
        if end < 0:
            break  # it is not closed, which expat tells
        end += len(closing) if text.startswith(opening, start) else 0
        comment = opening == "<!--"
        parts += [text[at:start], re.sub(r"[^\n]", " ", text[start:end]) if comment else text[start:end]]
        at = end
    return "".join([*parts, text[at:]])


class _Parser:
    def __init__(self, source: Source) -> None:
        self.source = source
        self.open: list[XmlElement] = []
        self.root: XmlElement | None = None
        self.expat: Any = expat.ParserCreate("utf-8")
        self.expat.StartElementHandler = self.start
        self.expat.EndElementHandler = self.end
        self.expat.CharacterDataHandler = self.characters
        self.expat.buffer_text, self.expat.buffer_size = True, 1 << 20  # so that long texts grow in few steps
        self.expat.StartDoctypeDeclHandler = self.refuse_document_type

    def parse(self, text: str) -> XmlElement:
        try:
            self.expat.Parse(_without_comments(text).encode("utf-8"), True)
        except expat.ExpatError as error:
            place = Scalar(self.source, error.lineno, error.offset + 1, "", None)
            raise located(place, "", f"this is not XML: {expat.ErrorString(error.code)}") from None
        assert self.root is not None  # expat refuses a text without an element
        return self.root

    def here(self) -> Scalar:
        return Scalar(self.source, self.expat.CurrentLineNumber, self.expat.CurrentColumnNumber + 1, "", None)

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        element = XmlElement(tag, attributes, self.here(), [])
        if len(self.open) >= MAX_DEPTH:
            raise element.error(f"elements are nested more than {MAX_DEPTH} deep")
        if self.open:
            self.open[-1].children.append(element)
        else:
            self.root = element
        self.open.append(element)

    def end(self, tag: str) -> None:
        self.open.pop()

    def characters(self, text: str) -> None:
        self.open[-1].content += text

    def refuse_document_type(self, *declared: Any) -> None:
        message = "a document type (<!DOCTYPE>) can define entities that grow without end or read other files"
        raise located(self.here(), "", f"{message}; allowed: XML without one")


GROUND = "base"


def scene_names(names: Iterable[str], taken: Iterable[str]) -> dict[str, str]:
    """Return the scene's name for each name of the URDF: itself where it is allowed and not ``taken``.

    Other characters become ``_``; a name that is taken then gets a number.
    """
    renamed: dict[str, str] = {}
    taken = frozenset(taken)
    used = set(taken)
    wanted = {name: _allowed(name) for name in names}
    # names that stay as they are come first: none of them makes way for a name that changes anyway
    numbers: Counter[str] = Counter()  # up to which those of each name are used
    for name in sorted(wanted, key=lambda name: wanted[name] != name or name in taken):
        new = wanted[name]
        while new in used:
            numbers[wanted[name]] += 1
            new = f"{wanted[name]}_{numbers[wanted[name]] + 1}"
        used.add(new)
        renamed[name] = new
    return renamed


def joint_names(names: Iterable[str]) -> dict[str, str]:
    """Return names of joints, which formulas use."""
    return scene_names(names, RESERVED)


def link_names(names: Iterable[str]) -> dict[str, str]:
    """Return names of links; ``base`` is the ground in scenes."""
    return scene_names(names, (GROUND,))


def _allowed(name: str) -> str:
    new = re.sub(r"[^A-Za-z0-9_]", "_", name)
    return f"_{new}" if not new or new[0].isdigit() else new
