"""Read YAML text into nodes: strict, bounded, with places.

Built on PyYAML's events rather than its documents: aliases, depth and size stay under our control, nothing
recurses on the input, and no tag can construct anything.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import Any

import yaml

from robodyn_cli.errors import SceneError, shown
from robodyn_cli.foreign import contents
from robodyn_cli.record import mutable_record
from robodyn_cli.scene.text.faults import Faults
from robodyn_cli.scene.text.nodes import (
    Node,
    Path,
    Scalar,
    Source,
    Value,
    dotted,
    located,
    mapping,
    resolve,
    sequence,
)

# reading takes a second or two per megabyte
MAX_BYTES = 10_000_000
MAX_DEPTH = 50
MAX_ALIASED_NODES = 100_000

_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_TAG = "tag:yaml.org,2002:"


def read_text(path: str, place: Node | None, key: str, shown_as: str) -> str:
    """Return the text of a UTF-8 file; errors are placed at ``place``, or at the file itself."""
    at: Node = place or Scalar(Source(shown_as, ".", positions=False), 1, 1, "", None)
    # a place in the file itself names it already
    what = "cannot be read" if at.source.name == shown_as else f"cannot read {shown_as!r}"
    try:
        data = contents(path, MAX_BYTES)
    except FileNotFoundError:
        raise located(at, key, f"{what}: there is no such file{_start_of_path(at, shown_as)}") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise located(at, key, f"{what}: {reason}") from None
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise located(at, key, f"{what}: it is not UTF-8 text (byte {error.start}, line {line})") from None


def _start_of_path(at: Node, shown_as: str) -> str:
    """Return where a relative path in an option starts, in words; nothing of other paths."""
    written = at.text if isinstance(at, Scalar) else ""
    in_option = not at.source.positions and at.source.name != shown_as
    if not in_option or not written or os.path.isabs(written):
        return ""
    return f"; a path in an option starts at the folder of the scene, {at.source.directory!r}"


def compose(
    text: str,
    source: Source,
    faults: Faults,
    path: Path = (),
    empty: bool = False,
) -> Node:
    """Return the tree of the one document in ``text``.

    Parameters
    ----------
    faults : takes the errors after which reading can go on: keys that appear twice, octal numbers.
    path : where the tree hangs in the scene, for messages.
    empty : whether null is a document too.

    Raises
    ------
    SceneError : broken syntax, several documents or none, tags, too many aliases, depth.
    """
    start: Node = Scalar(source, 1, 1, "", None)
    key = dotted(path)
    try:
        text.encode("utf-8")
    except UnicodeEncodeError as error:
        raise located(
            _at(source, text, error.start), key, "half a surrogate pair; allowed: Unicode text"
        ) from None
    builder = _Builder(source, path, faults)
    try:
        for event in _events(text):
            builder.take(event)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        what = ", ".join(part for part in (error.context, error.problem) if part)
        place = Scalar(source, mark.line + 1, mark.column + 1, "", None) if mark else start
        raise located(place, key, f"this is not YAML: {what}") from None
    except yaml.reader.ReaderError as error:
        match = yaml.reader.Reader.NON_PRINTABLE.search(text)
        place = _at(source, text, match.start()) if match else start
        character = shown(match.group()) if match else str(error.reason)
        raise located(place, key, f"character {character} is not allowed in YAML") from None
    if empty and builder.root is None:
        return start
    if not empty and (
        builder.root is None or (isinstance(builder.root, Scalar) and builder.root.value is None)
    ):
        raise located(start, key, "there is nothing in it; allowed: a map of keys and values")
    assert builder.root is not None
    return builder.root


def _events(text: str) -> Iterator[Any]:
    loader = _LOADER(text)
    try:
        while loader.check_event():
            yield loader.get_event()
    finally:
        loader.dispose()


def _at(source: Source, text: str, index: int) -> Node:
    line = text.count("\n", 0, index)
    return Scalar(source, line + 1, index - (text.rfind("\n", 0, index) + 1) + 1, "", None)


@mutable_record
class _Open:
    """A list or map that has not ended yet."""

    place: Scalar
    is_map: bool
    anchor: str | None
    children: list[Node]
    keys: dict[str, Scalar]


class _Builder:
    def __init__(self, source: Source, base: Path, faults: Faults) -> None:
        self.source = source
        self.base = base
        self.faults = faults
        self.root: Node | None = None
        self.stack: list[_Open] = []
        self.anchors: dict[str, Node | None] = {}  # None: the anchored node is still open
        self.aliased = 0

    def take(self, event: Any) -> None:
        """Add one event to the tree."""
        place = Scalar(self.source, event.start_mark.line + 1, event.start_mark.column + 1, "", None)
        if isinstance(event, yaml.ScalarEvent):
            node: Node = self.scalar(event, place)
            if event.anchor is not None:
                self.anchors[event.anchor] = node
            self.attach(node, place)
        elif isinstance(event, yaml.AliasEvent):
            self.attach(self.alias(str(event.anchor), place), place)
        elif isinstance(event, (yaml.SequenceStartEvent, yaml.MappingStartEvent)):
            self.open(event, place)
        elif isinstance(event, (yaml.SequenceEndEvent, yaml.MappingEndEvent)):
            self.close()
        elif isinstance(event, yaml.DocumentStartEvent) and self.root is not None:
            raise located(
                place, dotted(self.base), "a second document starts here; allowed: one document a file"
            )

    def open(self, event: Any, place: Scalar) -> None:
        is_map = isinstance(event, yaml.MappingStartEvent)
        if event.tag not in (None, "!", _TAG + ("map" if is_map else "seq")):
            raise self.bad_tag(event.tag, place)
        if len(self.stack) >= MAX_DEPTH:
            raise located(place, self.path(), f"nested more than {MAX_DEPTH} levels deep")
        if event.anchor is not None:
            self.anchors[event.anchor] = None
        self.stack.append(_Open(place, is_map, event.anchor, [], {}))

    def close(self) -> None:
        top = self.stack.pop()
        node: Node
        if top.is_map:
            keys = [k for k in top.children[::2] if isinstance(k, Scalar)]
            node = mapping(top.place, list(zip(keys, top.children[1::2])))
        else:
            node = sequence(top.place, top.children)
        if top.anchor is not None:
            self.anchors[top.anchor] = node
        self.attach(node, top.place)

    def attach(self, node: Node, place: Scalar) -> None:
        if not self.stack:
            self.root = node
            return
        top = self.stack[-1]
        if top.is_map and len(top.children) % 2 == 0:
            self.check_key(top, node, place)
        top.children.append(node)

    def check_key(self, top: _Open, node: Node, place: Scalar) -> None:
        if not isinstance(node, Scalar) or not node.text:
            raise located(place, self.path(), "a key must be a plain word, not a list, a map or nothing")
        if node.text in top.keys:
            first = top.keys[node.text]
            at = dotted((*self.steps(), node.text))
            what = f"key {shown(node.text)} appears twice; first on line {first.line}"
            self.faults.report(located(place, at, what))
        if node.text == "<<":
            what = "merge keys (<<) do not exist in YAML 1.2; repeat the keys, or use `include`"
            self.faults.report(located(place, self.path(), what))
        top.keys.setdefault(node.text, place)

    def steps(self) -> Path:
        """Return the path of the value that comes next."""
        path = list(self.base)
        for frame in self.stack:
            if not frame.is_map:
                path.append(len(frame.children))
            elif len(frame.children) % 2:
                key = frame.children[-1]
                path.append(key.text if isinstance(key, Scalar) else "?")
        return tuple(path)

    def path(self) -> str:
        return dotted(self.steps())

    def alias(self, name: str, place: Scalar) -> Node:
        if name not in self.anchors:
            raise located(place, self.path(), f"alias *{name} has no anchor &{name} before it")
        node = self.anchors[name]
        if node is None:
            raise located(
                place, self.path(), f"alias *{name} is used inside its own anchor, which never ends"
            )
        self.aliased += node.size
        if self.aliased > MAX_ALIASED_NODES:
            raise located(place, self.path(), f"aliases expand to more than {MAX_ALIASED_NODES} values")
        return node

    def scalar(self, event: Any, place: Scalar) -> Scalar:
        text: str = event.value
        value: Value = text
        kind = (event.tag or "").removeprefix(_TAG)
        try:
            if event.implicit[0] and event.tag != "!":
                value = resolve(text)
            elif event.tag not in (None, "!"):
                value = self.tagged(event.tag, kind, text, place)
        except ValueError as error:
            self.faults.report(located(place, self.path(), f"{error} (value {shown(text)})"))
        return Scalar(self.source, place.line, place.column, text, value)

    def tagged(self, tag: str, kind: str, text: str, place: Scalar) -> Value:
        types: dict[str, tuple[type, ...]] = {
            "str": (str,),
            "int": (int,),
            "float": (int, float),
            "bool": (bool,),
            "null": (type(None),),
        }
        if kind not in types or kind == tag:
            raise self.bad_tag(tag, place)
        if kind == "str":
            return text
        value = resolve(text)
        if not isinstance(value, types[kind]) or (kind != "bool" and isinstance(value, bool)):
            raise ValueError(f"the value does not fit its tag !!{kind}")
        return value

    def bad_tag(self, tag: str, place: Scalar) -> SceneError:
        tag = "!!" + tag.removeprefix(_TAG) if tag.startswith(_TAG) else tag
        return located(place, self.path(), f"tag {shown(tag)} is not allowed; a scene is plain data")
