"""YAML text to nodes (strict, bounded, with places), and a tree to canonical YAML 1.2, which is stored with results and
can be loaded again.

Reading is built on PyYAML's events rather than its documents: aliases, depth and size stay under our control, nothing
recurses on the input, and no tag can construct anything.
"""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Iterator
from typing import Any

import yaml

from robodyn_cli.errors import SceneError, shown
from robodyn_cli.foreign import contents
from robodyn_cli.record import mutable_record
from robodyn_cli.scene.text import nodes

# reading takes a second or two per megabyte
MAX_BYTES = 10_000_000
MAX_DEPTH = 50
TOO_DEEP = f"nested more than {MAX_DEPTH} levels deep"
MAX_ALIASED_NODES = 100_000
IS_XML = "this is XML; allowed: a scene in YAML, which names a URDF, SDF or MJCF as robot: FILE"

_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_TAG = "tag:yaml.org,2002:"
_XML = re.compile(r"[\s\ufeff]*<[?!A-Za-z]")


def read_text(path: str, place: nodes.Node | None, key: str, shown_as: str) -> str:
    """Return the text of a UTF-8 file; errors are placed at ``place``, or at the file itself."""
    at: nodes.Node = place or nodes.Scalar(nodes.Source(shown_as, ".", positions=False), 1, 1, "", None)
    # a place in the file itself names it already
    fault = "cannot be read" if at.source.name == shown_as else f"cannot read {shown_as!r}"
    try:
        data = contents(path, MAX_BYTES)
    except FileNotFoundError:
        raise nodes.located(
            at, key, f"{fault}: there is no such file{_start_of_path(at, shown_as)}"
        ) from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise nodes.located(at, key, f"{fault}: {reason}") from None
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise nodes.located(
            at, key, f"{fault}: it is not UTF-8 text (byte {error.start}, line {line})"
        ) from None


def _start_of_path(at: nodes.Node, shown_as: str) -> str:
    """Return where a relative path in an option starts, in words; nothing of other paths."""
    written = at.text if isinstance(at, nodes.Scalar) else ""
    in_option = not at.source.positions and at.source.name != shown_as
    if not in_option or not written or os.path.isabs(written):
        return ""
    return f"; a path in an option starts at the folder of the scene, {at.source.directory!r}"


def compose(
    text: str,
    source: nodes.Source,
    faults: nodes.Faults,
    path: nodes.Path = (),
    empty: bool = False,
) -> nodes.Node:
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
    start: nodes.Node = nodes.Scalar(source, 1, 1, "", None)
    key = nodes.dotted(path)
    if not path and _XML.match(text):
        raise nodes.located(start, key, IS_XML)
    try:
        text.encode("utf-8")
    except UnicodeEncodeError as error:
        raise nodes.located(
            _at(source, text, error.start), key, "half a surrogate pair; allowed: Unicode text"
        ) from None
    builder = _Builder(source, path, faults)
    try:
        for event in _events(text):
            builder.take(event)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        reason = ", ".join(part for part in (error.context, error.problem) if part)
        line = "".join(text.splitlines()[mark.line : mark.line + 1]) if mark else ""
        if mark and line[mark.column : mark.column + 1] == "\t":
            reason = "a tab begins a token here; allowed: spaces to indent a line"
        place = nodes.Scalar(source, mark.line + 1, mark.column + 1, "", None) if mark else start
        # a limit of newer parsers, which read ahead of the events that are counted here
        if "nesting depth" in reason:
            raise nodes.located(place, key, TOO_DEEP) from None
        raise nodes.located(place, key, f"this is not YAML: {reason}") from None
    except yaml.reader.ReaderError as error:
        match = yaml.reader.Reader.NON_PRINTABLE.search(text)
        place = _at(source, text, match.start()) if match else start
        character = shown(match.group()) if match else str(error.reason)
        raise nodes.located(place, key, f"character {character} is not allowed in YAML") from None
    if empty and builder.root is None:
        return start
    if not empty and (
        builder.root is None or (isinstance(builder.root, nodes.Scalar) and builder.root.value is None)
    ):
        raise nodes.located(start, key, "there is nothing in it; allowed: a map of keys and values")
    assert builder.root is not None
    return builder.root


def _events(text: str) -> Iterator[Any]:
    loader = _LOADER(text)
    try:
        while loader.check_event():
            yield loader.get_event()
    finally:
        loader.dispose()


def _at(source: nodes.Source, text: str, index: int) -> nodes.Node:
    line = text.count("\n", 0, index)
    return nodes.Scalar(source, line + 1, index - (text.rfind("\n", 0, index) + 1) + 1, "", None)


@mutable_record
class _Open:
    """A list or map that has not ended yet."""

    place: nodes.Scalar
    is_map: bool
    anchor: str | None
    children: list[nodes.Node]
    keys: dict[str, nodes.Scalar]


class _Builder:
    def __init__(self, source: nodes.Source, base: nodes.Path, faults: nodes.Faults) -> None:
        self.source = source
        self.base = base
        self.faults = faults
        self.root: nodes.Node | None = None
        self.stack: list[_Open] = []
        self.anchors: dict[str, nodes.Node | None] = {}  # None: the anchored node is still open
        self.aliased = 0

    def take(self, event: Any) -> None:
        """Add one event to the tree."""
        place = nodes.Scalar(self.source, event.start_mark.line + 1, event.start_mark.column + 1, "", None)
        if isinstance(event, yaml.ScalarEvent):
            node: nodes.Node = self.scalar(event, place)
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
            raise nodes.located(
                place, nodes.dotted(self.base), "a second document starts here; allowed: one document a file"
            )

    def open(self, event: Any, place: nodes.Scalar) -> None:
        is_map = isinstance(event, yaml.MappingStartEvent)
        if event.tag not in (None, "!", _TAG + ("map" if is_map else "seq")):
            raise self.bad_tag(event.tag, place)
        if len(self.stack) >= MAX_DEPTH:
            raise nodes.located(place, self.path(), TOO_DEEP)
        if event.anchor is not None:
            self.anchors[event.anchor] = None
        self.stack.append(_Open(place, is_map, event.anchor, [], {}))

    def close(self) -> None:
        top = self.stack.pop()
        node: nodes.Node
        if top.is_map:
            keys = [k for k in top.children[::2] if isinstance(k, nodes.Scalar)]
            node = nodes.mapping(top.place, list(zip(keys, top.children[1::2])))
        else:
            node = nodes.sequence(top.place, top.children)
        if top.anchor is not None:
            self.anchors[top.anchor] = node
        self.attach(node, top.place)

    def attach(self, node: nodes.Node, place: nodes.Scalar) -> None:
        if not self.stack:
            self.root = node
            return
        top = self.stack[-1]
        if top.is_map and len(top.children) % 2 == 0:
            self.check_key(top, node, place)
        top.children.append(node)

    def check_key(self, top: _Open, node: nodes.Node, place: nodes.Scalar) -> None:
        if not isinstance(node, nodes.Scalar) or not node.text:
            raise nodes.located(
                place, self.path(), "a key must be a plain word, not a list, a map or nothing"
            )
        if node.text in top.keys:
            first = top.keys[node.text]
            at = nodes.dotted((*self.steps(), node.text))
            fault = f"key {shown(node.text)} appears twice; first on line {first.line}"
            self.faults.report(nodes.located(place, at, fault))
        if node.text == "<<":
            fault = "merge keys (<<) do not exist in YAML 1.2; repeat the keys, or use `include`"
            self.faults.report(nodes.located(place, self.path(), fault))
        top.keys.setdefault(node.text, place)

    def steps(self) -> nodes.Path:
        """Return the path of the value that comes next."""
        path = list(self.base)
        for frame in self.stack:
            if not frame.is_map:
                path.append(len(frame.children))
            elif len(frame.children) % 2:
                key = frame.children[-1]
                path.append(key.text if isinstance(key, nodes.Scalar) else "?")
        return tuple(path)

    def path(self) -> str:
        return nodes.dotted(self.steps())

    def alias(self, name: str, place: nodes.Scalar) -> nodes.Node:
        if name not in self.anchors:
            raise nodes.located(place, self.path(), f"alias *{name} has no anchor &{name} before it")
        node = self.anchors[name]
        if node is None:
            raise nodes.located(
                place, self.path(), f"alias *{name} is used inside its own anchor, which never ends"
            )
        self.aliased += node.size
        if self.aliased > MAX_ALIASED_NODES:
            raise nodes.located(place, self.path(), f"aliases expand to more than {MAX_ALIASED_NODES} values")
        return node

    def scalar(self, event: Any, place: nodes.Scalar) -> nodes.Scalar:
        text: str = event.value
        value: nodes.Value = text
        kind = (event.tag or "").removeprefix(_TAG)
        try:
            if event.implicit[0] and event.tag != "!":
                value = nodes.resolve(text)
            elif event.tag not in (None, "!"):
                value = self.tagged(event.tag, kind, text, place)
        except ValueError as error:
            self.faults.report(nodes.located(place, self.path(), f"{error} (value {shown(text)})"))
        return nodes.Scalar(self.source, place.line, place.column, text, value)

    def tagged(self, tag: str, kind: str, text: str, place: nodes.Scalar) -> nodes.Value:
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
        value = nodes.resolve(text)
        if not isinstance(value, types[kind]) or (kind != "bool" and isinstance(value, bool)):
            raise ValueError(f"the value does not fit its tag !!{kind}")
        return value

    def bad_tag(self, tag: str, place: nodes.Scalar) -> SceneError:
        tag = "!!" + tag.removeprefix(_TAG) if tag.startswith(_TAG) else tag
        return nodes.located(place, self.path(), f"tag {shown(tag)} is not allowed; a scene is plain data")


WIDTH = 110

# text that YAML reads back as itself without quotes, in block and in flow style
_PLAIN = re.compile(r"[A-Za-z_][A-Za-z0-9_./-]*( [A-Za-z0-9_./(*+=-]+)*\)?")
# characters that YAML wants escaped; compiled on first use, because that takes milliseconds
_ESCAPED = "[^\x20-\x7e\xa0-\u2027\u202a-\ud7ff\ue000-\ufefe\uff00-\ufffd\U00010000-\U0010ffff]"


def emit(node: nodes.Node) -> str:
    """Return the YAML text of a tree: keys in the order of the file, numbers with all their digits."""
    return "\n".join(block(node)) + "\n"


def block(node: nodes.Node) -> list[str]:
    """Return the lines of a node in block style; what is simple and short stays on one line."""
    if isinstance(node, nodes.Mapping) and node.entries:
        lines = []
        for key, value in node.entries:
            name = _text(key.text)
            line = _short(value, len(name) + 2)
            if line is not None:
                lines.append(f"{name}: {line}")
            else:
                lines.append(f"{name}:")
                lines.extend("  " + line for line in block(value))
        return lines
    if isinstance(node, nodes.Sequence) and node.items:
        lines = []
        for item in node.items:
            line = _short(item, 2)
            inner = [line] if line is not None else block(item)
            lines.append(f"- {inner[0]}")
            lines.extend("  " + line for line in inner[1:])
        return lines
    return [flow(node)]


def _short(node: nodes.Node, used: int) -> str | None:
    """Return flow style where it fits beside ``used`` characters and holds at most two levels, else None."""
    if isinstance(node, (nodes.Mapping, nodes.Sequence)):
        if node.size > WIDTH or _depth(node) > 2:
            return None
        line = flow(node)
        return line if used + len(line) <= WIDTH else None
    return flow(node)


def _depth(node: nodes.Node) -> int:
    if isinstance(node, nodes.Mapping):
        return 1 + max((_depth(value) for _, value in node.entries), default=0)
    if isinstance(node, nodes.Sequence):
        return 1 + max((_depth(item) for item in node.items), default=0)
    return 0


def flow(node: nodes.Node) -> str:
    """Return a value as YAML on one line."""
    if isinstance(node, nodes.Mapping):
        return "{" + ", ".join(f"{_text(k.text)}: {flow(v)}" for k, v in node.entries) + "}"
    if isinstance(node, nodes.Sequence):
        return "[" + ", ".join(flow(item) for item in node.items) + "]"
    assert isinstance(node, nodes.Scalar)
    return _scalar(node.value)


def _scalar(value: nodes.Value) -> str:
    if value is None:
        return "null"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        if math.isfinite(value):
            return repr(value)
        return ".nan" if math.isnan(value) else (".inf" if value > 0 else "-.inf")
    return _text(value)


def _text(value: str) -> str:
    if _PLAIN.fullmatch(value) and isinstance(nodes.resolve(value), str):
        return value
    # JSON strings are YAML strings, except for characters that YAML wants escaped and JSON does not
    quoted = json.dumps(value, ensure_ascii=False)
    if quoted.isascii() and quoted.isprintable():
        return quoted
    return re.sub(_ESCAPED, lambda match: f"\\u{ord(match.group()):04x}", quoted)
