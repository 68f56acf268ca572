"""Write the tables of keys in docs/scene.md from the dataclasses that the reader uses.

    python docs/make_scene_reference.py            rewrite the tables
    python docs/make_scene_reference.py --check    exit 1 if a table is out of date

A table stands between ``<!-- keys: CLASS -->`` and ``<!-- end -->``, that of the units between ``<!-- units -->`` and
``<!-- end -->``; the text around them is written by hand.
"""

from __future__ import annotations

import dataclasses
import re
import sys
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

from robodyn_cli.errors import plural_of
from robodyn_cli.expr import units
from robodyn_cli.scene.types import Scene
from robodyn_cli.schema.fields import (
    REQUIRED,
    Choice,
    Criteria,
    Either,
    Inline,
    Kind,
    ListOf,
    MapOf,
    Name,
    OrFile,
    Section,
    Tagged,
    Text,
    Vector,
    describe,
    key_name,
)

PAGE = Path(__file__).parent / "scene.md"
TABLE = re.compile(r"(<!-- keys: (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)
UNITS = re.compile(r"(<!-- units -->\n).*?(<!-- end -->)", re.DOTALL)
HEADING = re.compile(r"^#+ (.+)$", re.MULTILINE)


def sections(cls: type = Scene, known: Collection[str] = ()) -> dict[str, type]:
    """Return every dataclass that a scene can contain, by name, outermost first; ``known`` ones left out."""
    found = {cls.__name__: cls}
    for field in dataclasses.fields(cls):
        for inner in _classes(field.metadata.get("kind")):
            if inner.__name__ not in found and inner.__name__ not in known:
                below = sections(inner, {*known, *found})
                found.update({k: v for k, v in below.items() if k not in found})
    return found


def _classes(kind: Kind | None) -> Iterator[type]:
    if isinstance(kind, Section):
        yield kind.cls
    elif isinstance(kind, (Tagged, Inline)):
        yield from kind.registry().values()
    elif isinstance(kind, (ListOf, MapOf, OrFile)):
        yield from _classes(kind.item)
    elif isinstance(kind, Either):
        for one in kind.kinds:
            yield from _classes(one)


def keys(cls: type) -> Iterator[str]:
    """Yield the YAML keys of a section."""
    for field in dataclasses.fields(cls):
        kind = field.metadata.get("kind")
        if isinstance(kind, Inline):
            yield from kind.registry()
        elif kind is not None:
            yield key_name(field)


def table(cls: type, anchors: dict[str, str]) -> str:
    """Return the table of a section's keys; ``anchors`` are the headings that describe other sections."""
    rows = ["| key | value | unit | default | meaning |", "|---|---|---|---|---|"]
    for field in dataclasses.fields(cls):
        kind = field.metadata.get("kind")
        if isinstance(kind, Inline):
            for name, element in kind.registry().items():
                first = (element.__doc__ or "").split("\n\n")[0].replace("``", "`")
                rows.append(_row(name, _link(element, anchors), "", "none", " ".join(first.split())))
        elif kind is not None:
            unit = field.metadata["unit"]
            rows.append(
                _row(key_name(field), _value(kind, anchors), unit, _default(field), field.metadata["doc"])
            )
    return "\n".join(rows) + "\n"


def _row(name: str, value: str, unit: str, default: str, doc: str) -> str:
    cells = [f"`{name}`", value, unit, default, doc]
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _link(cls: type, anchors: dict[str, str], what: str = "map") -> str:
    return f"{what}, see [{cls.__name__}](#{anchors.get(cls.__name__, '')})"


def _value(kind: Kind, anchors: dict[str, str]) -> str:
    if isinstance(kind, Choice):
        return ", ".join(f"`{option}`" for option in kind.options)
    if isinstance(kind, Section):
        return _link(kind.cls, anchors)
    if isinstance(kind, Criteria):
        return "map, see [expectations](#expectations)"
    if isinstance(kind, Tagged):
        kinds = ", ".join(f"[`{k}`](#{anchors.get(c.__name__, '')})" for k, c in kind.registry().items())
        return f"map with `{kind.tag}` {kinds}"
    if isinstance(kind, OrFile):
        formats = "YAML, URDF, SDF or MJCF" if kind.robot else "YAML"
        return f"{_value(kind.item, anchors)}; or the path of a {formats} file"
    if isinstance(kind, Either):
        return ", or ".join(_value(one, anchors) for one in kind.kinds)
    if isinstance(kind, Text):
        return "text"
    if isinstance(kind, Name):
        return f"name of a {kind.of}" if kind.of else "name"
    if isinstance(kind, Vector) and not kind.size:
        return "list of numbers"
    if isinstance(kind, ListOf) and isinstance(kind.item, (Section, Tagged, Vector)):
        bound = f"{kind.minimum} or more" if kind.minimum else "list"
        if kind.minimum == kind.maximum:
            bound = f"list of {kind.minimum}"
        return f"{bound}: {_value(kind.item, anchors)}"
    if isinstance(kind, MapOf) and isinstance(kind.item, (Section, Either)):
        return f"map from names of {plural_of(kind.of)} to: {_value(kind.item, anchors)}"
    return describe(kind).removeprefix("a ")


def _default(field: dataclasses.Field[Any]) -> str:
    if field.default is REQUIRED and field.default_factory is REQUIRED:
        return "required"
    value = field.default
    if value is REQUIRED or value is None or value in ((), ""):
        return "none"
    if dataclasses.is_dataclass(value):
        return "its own defaults"
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    if isinstance(value, tuple):
        return "`[" + ", ".join(f"{x:g}" for x in value) + "]`"
    return f"`{value}`" if isinstance(value, (int, str)) else f"`{value:g}`"


def units_table() -> str:
    """Return the table of all units that a number may have, by what they measure."""
    by_kind: dict[str, list[str]] = {}
    for word, unit in units.table().items():
        by_kind.setdefault(units.written(unit.dims), []).append(f"`{word}`")
    rows = [
        f"| {units.KINDS.get(unit, '')} [{unit}] | {', '.join(words)} |" for unit, words in by_kind.items()
    ]
    return "\n".join(["| of | units |", "|---|---|", *rows]) + "\n"


def slug(heading: str) -> str:
    """Return the anchor that GitHub gives a heading."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")


def rewritten(text: str) -> str:
    """Return the page with its tables made anew."""
    anchors = {}
    for match in TABLE.finditer(text):
        heading = HEADING.findall(text, 0, match.start())[-1]
        anchors[match.group(2)] = slug(heading)
    known = sections()
    text = UNITS.sub(lambda m: m.group(1) + units_table() + m.group(2), text)
    return TABLE.sub(lambda m: m.group(1) + table(known[m.group(2)], anchors) + m.group(3), text)


def main(arguments: list[str]) -> int:
    """Rewrite the page, or check it."""
    old = PAGE.read_text(encoding="utf-8")
    new = rewritten(old)
    if arguments == ["--check"]:
        return int(old != new)
    PAGE.write_text(new, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
