"""The YAML tree: immutable nodes that remember the file, line and column they come from; plain scalars without the
readings of YAML 1.1; and the errors of a scene, collected.

``1e-9`` is a number, ``010`` is ten, ``1:30`` and ``yes`` are text, only ``true`` and ``false`` are booleans.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator
from types import TracebackType
from typing import Any

from robodyn_cli.errors import SceneError, shown
from robodyn_cli.record import record

Value = None | bool | int | float | str

_INT = re.compile(r"[-+]?[0-9]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_INFINITE = re.compile(r"[-+]?\.(inf|Inf|INF)")
_NAN = re.compile(r"\.(nan|NaN|NAN)")
_BASED = re.compile(r"[-+]?0[oOxX][0-9a-fA-F]+")
IN_PYTHON = "<dict>"  # stands for the file of a scene that a program in Python has given as a map
_WORDS: dict[str, Value] = {"true": True, "false": False, "null": None, "~": None, "": None}

# Python does not convert very long integers; as floats they are infinite, and the reader refuses those
_LONGEST_INT = 300


def resolve(text: str) -> Value:
    """Return the value of a plain scalar.

    Raises
    ------
    ValueError : an octal or hexadecimal number.
    """
    if text in _WORDS:
        return _WORDS[text]
    first = text[0]
    if not (first.isdigit() or first in "+-."):
        return text
    if _INT.fullmatch(text):
        return int(text) if len(text) <= _LONGEST_INT else float(text)
    if _FLOAT.fullmatch(text):
        return float(text)
    if _INFINITE.fullmatch(text):
        return -math.inf if first == "-" else math.inf
    if _NAN.fullmatch(text):
        return math.nan
    if _BASED.fullmatch(text):
        raise ValueError(
            "octal and hexadecimal numbers are not read; write a decimal number, or quote a text"
        )
    return text


Path = tuple[str | int, ...]


@record
class Source:
    """The origin of a text.

    name : shown in errors.
    directory : relative paths inside start here.
    real : resolved path, to recognise a file that includes itself; empty for text that is no file.
    parent : the source that includes this one.
    positions : whether line and column mean something (not for the text of an option).
    names_key : whether the name says already which key it is about. above : the key below which it names others.
    """

    name: str
    directory: str
    real: str = ""
    parent: Source | None = None
    positions: bool = True
    names_key: bool = False
    above: str = ""

    def chain(self) -> Iterator[Source]:
        """Yield this source and those that include it, innermost first."""
        source: Source | None = self
        while source is not None:
            yield source
            source = source.parent


@record
class Node:
    """Base of the nodes; line and column count from 1."""

    source: Source
    line: int
    column: int

    @property
    def size(self) -> int:
        """Number of nodes in this subtree, shared ones counted wherever they are used."""
        return 1


@record
class Scalar(Node):
    """A scalar: the text as written, and the value that YAML 1.2 gives it."""

    text: str
    value: Value


@record
class Sequence(Node):
    items: tuple[Node, ...]
    count: int

    @property
    def size(self) -> int:
        return self.count


@record
class Mapping(Node):
    entries: tuple[tuple[Scalar, Node], ...]
    count: int

    @property
    def size(self) -> int:
        return self.count

    def get(self, key: str) -> Node | None:
        """Return the value under ``key``."""
        return next((value for k, value in self.entries if k.text == key), None)

    def key(self, key: str) -> Scalar | None:
        """Return the node of the key itself."""
        return next((k for k, _ in self.entries if k.text == key), None)

    def replaced(self, key: Scalar, value: Node) -> Mapping:
        """Return the map with the value under a key replaced, or a new entry at its end."""
        if self.key(key.text) is None:
            return mapping(self, [*self.entries, (key, value)])
        return mapping(self, [(k, value if k.text == key.text else v) for k, v in self.entries])

    def without(self, key: str) -> Mapping:
        """Return the map without a key."""
        return mapping(self, [(k, v) for k, v in self.entries if k.text != key])


def sequence(place: Node, items: Iterable[Node]) -> Sequence:
    """Return a list at the place of another node."""
    nodes = tuple(items)
    return Sequence(place.source, place.line, place.column, nodes, 1 + sum(x.size for x in nodes))


def mapping(place: Node, entries: list[tuple[Scalar, Node]]) -> Mapping:
    """Return a map at the place of another node."""
    count = 1 + sum(1 + v.size for _, v in entries)
    return Mapping(place.source, place.line, place.column, tuple(entries), count)


def scalar(place: Node, value: Value) -> Scalar:
    """Return a scalar at the place of another node."""
    return Scalar(place.source, place.line, place.column, "" if value is None else str(value), value)


def plain(place: Node, value: Any) -> Any:
    """Return the node of a number, a text, a list or a map at the place of another node, nodes in it as they are.

    Whole numbers are written without a point.
    """
    if isinstance(value, Node):
        return value
    if isinstance(value, dict):
        return mapping(place, [(scalar(place, k), plain(place, x)) for k, x in value.items()])
    if isinstance(value, (list, tuple)):
        return sequence(place, [plain(place, x) for x in value])
    if isinstance(value, float) and value.is_integer() and abs(value) < 1e6:
        value = int(value)
    return scalar(place, value)


def find(root: Node, path: Path) -> Node | None:
    """Return the node at ``path``, if there is one; items of lists by their number or their name."""
    node: Node | None = root
    for step in path:
        if isinstance(node, Mapping):
            node = node.get(str(step))
        elif isinstance(node, Sequence) and (index := index_of(node, str(step))) is not None:
            node = node.items[index]
        else:
            return None
    return node


def name_of(item: Node) -> str:
    """Return the ``name`` of an item of a list, empty where it has none."""
    name = item.get("name") if isinstance(item, Mapping) else None
    return name.text if isinstance(name, Scalar) else ""


def index_of(node: Sequence, step: str) -> int | None:
    """Return the index of the item that a step of a key means, by its number or its ``name``; None for none."""
    if step.isdecimal() and step.isascii() and len(step) < 10:
        return int(step) if int(step) < len(node.items) else None
    names = [name_of(item) for item in node.items]
    return names.index(step) if step and step in names else None


def nearest(root: Node, path: Path) -> Node:
    """Return the node at ``path``, or the nearest one above it."""
    return next((node for k in range(len(path), 0, -1) if (node := find(root, path[:k]))), root)


def dotted(path: Path) -> str:
    """Return a path as in messages and in ``--set``: ``robot.joints.0.a``."""
    return ".".join(str(step) for step in path)


def located(node: Node, key: str, message: str, **details: Any) -> SceneError:
    """Return the error at a node: ``FILE:LINE:COL: key.path: message``, on one line."""
    return SceneError(_one_line(message), **place_of(node, key), **details)


def place_of(node: Node, key: str) -> dict[str, Any]:
    """Return what an error at a node says of its place: what it is about, ``FILE:LINE:COL`` or the option, and the key,
    each on one line; and the details ``file``, ``line``, ``column`` and ``key``."""
    source = node.source
    place = f"{source.name}:{node.line}:{node.column}" if source.positions else source.name
    shown_key = "" if source.names_key else key.removeprefix(source.above)
    return {
        "about": tuple(_one_line(part) for part in (place, shown_key) if part),
        "file": source.name,
        "line": node.line if source.positions else None,
        "column": node.column if source.positions else None,
        "key": key,
    }


def _one_line(text: str) -> str:
    return " ".join(text.split("\n"))


SHORT_LIST, LONGEST_LIST = 7, 50  # entries and letters of a list that is quoted


def describe_node(node: Node) -> str:
    """Return what a node is, as quoted in messages."""
    if isinstance(node, Scalar):
        if node.value is None:
            return "nothing"
        if isinstance(node.value, str):
            return shown(node.value)
        return node.text if len(node.text) <= 60 else node.text[:57] + "..."
    if isinstance(node, Sequence):
        words = ", ".join(describe_node(item) for item in node.items[:SHORT_LIST])
        if (
            0 < len(node.items) < SHORT_LIST
            and len(words) < LONGEST_LIST
            and all(isinstance(item, Scalar) for item in node.items)
        ):
            return f"[{words}]"
        return f"a list of {len(node.items)}" if node.items else "an empty list"
    return "a map" if isinstance(node, Mapping) and node.entries else "an empty map"


# reading ends after so many
MOST = 1000


class TooMany(Exception):
    """There are too many errors; raised to end the reading of the scene."""


class Faults:
    """A list of errors, and a ``with`` block that ends at its first error and adds it to the list; one of which
    ``details`` say that it ``follows`` from another is left out.

    found : the errors, in the order in which they were found.
    lost : keys without a value because a file to be included has an error.
    """

    def __init__(self) -> None:
        self.found: list[SceneError] = []
        self.lost: list[str] = []

    def report(self, error: SceneError) -> None:
        """Add an error.

        Raises
        ------
        TooMany : there are ``MOST`` errors now.
        """
        self.found.append(error)
        if len(self.found) >= MOST:
            raise TooMany

    def __enter__(self) -> None:
        pass

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool:
        if not isinstance(error, SceneError):
            return False
        if not error.details.get("follows"):
            self.report(error)
        return True

    @property
    def keys(self) -> list[str]:
        """Return the keys with faults."""
        return [key for key in (*map(key_of, self.found), *self.lost) if key]

    def add_unrelated(self, errors: Iterable[SceneError], sections: bool = False) -> None:
        """Add the errors that do not follow from those found: about the same key, or a key above or below it.

        sections : errors about other keys of a section follow too, since they may miss the one that could not be read.
        """
        known = self.keys
        within = {
            above for above, _, last in (key.rpartition(".") for key in known) if above and not last.isdigit()
        }
        within = within if sections else set()
        self.found += [
            e
            for e in errors
            if key_of(e).rpartition(".")[0] not in within
            and not any(_related(key_of(e), key) for key in known)
        ]

    def in_order(self) -> list[SceneError]:
        """Return the errors file by file and line by line, each once."""
        files = list(dict.fromkeys(str(e.details.get("file")) for e in self.found))

        def place(e: SceneError) -> tuple[int, int, int]:
            line, column = e.details.get("line") or 0, e.details.get("column") or 0
            return files.index(str(e.details.get("file"))), line, column

        return sorted({e.message: e for e in self.found}.values(), key=place)


def key_of(error: SceneError) -> str:
    """Return the key that an error is about, as a dotted path."""
    return str(error.details.get("key", ""))


def _related(a: str, b: str) -> bool:
    return a == b or (a != "" and b.startswith(a + ".")) or a.startswith(b + ".")


# angles at or below these keys place something
POSES = frozenset({"origin", "frames", "rpy", "angle", "alpha"})


def doubts_of_angle(value: float, node: Scalar, path: Path) -> list[str]:
    """Return a doubt about a plain number of more than a turn that places something: radians that look like degrees."""
    if not (path[:2] == ("initial", "q") or POSES.intersection(path)):
        return []
    text = (
        f"the angle {node.text} is in radians, {abs(value) / math.tau:.3g} turns; for degrees write "
        f"{node.text} deg, for radians put it in quotes"
    )
    return [located(node, dotted(path), text).message]
