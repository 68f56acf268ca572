"""Numbers as they stand in a scene: ``KEY#n`` is the n-th one written at or below a key, in the order of the file.

A number of YAML is one, and so is each number in the text of a formula or a constant (``1.96 - 0.1*theta1`` has two,
``-90 deg`` has one). It is read and replaced as it is written: signs, ``deg`` and powers around it stay.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator

from robodyn_cli.errors import SceneError
from robodyn_cli.record import record
from robodyn_cli.scene.text.includes import child_kind, concrete
from robodyn_cli.scene.text.nodes import (
    Mapping,
    Node,
    Path,
    Scalar,
    Sequence,
    index_of,
    sequence,
)
from robodyn_cli.schema.fields import Either, Formula, Kind, Number, Vector

_COUNTED = re.compile(r"(.+)#([1-9][0-9]{0,5})")
SHOWN = 8  # numbers that a refusal lists


@record
class WrittenNumber:
    """A number as it is written.

    path : steps that lead to its scalar. text : of the scalar. start, end : where it stands in the text. value : as it
    is written. inside : whether it is a part of a formula or of a constant such as ``90 deg``.
    """

    path: Path
    text: str
    start: int
    end: int
    value: float
    inside: bool

    @property
    def unit(self) -> str:
        """The unit behind the number, where the text is this number and nothing else; "" without one."""
        from robodyn_cli.expr import units

        behind = self.text[self.end :].strip(" )")
        return behind if not self.text[: self.start].strip(" -+(") and units.of(behind) is not None else ""

    def doubled(self, text: str) -> str:
        """Return the unit behind the number, where a text that is to stand in its place has one too; "" elsewhere."""
        from robodyn_cli.expr import units

        behind = units.match(self.text, self.end) if self.inside else None
        own = any(units.match(text, x.end) for x in _in_text(text, ())) if behind else False
        return self.text[self.end : behind[1]].strip() if behind and own else ""

    def replaced(self, text: str) -> str:
        """Return the text of the scalar with another number here."""
        plain = text if text[:1].isdigit() or text[:1] == "." else f"({text})"
        return self.text[: self.start] + plain + self.text[self.end :]


def counted(key: str) -> tuple[str, int]:
    """Return KEY and n of ``KEY#n``; n is 0 of a key without a count."""
    match = _COUNTED.fullmatch(key)
    return (match.group(1), int(match.group(2))) if match else (key, 0)


def numbers_in(node: Node | None, kind: Kind | None, path: Path = ()) -> Iterator[WrittenNumber]:
    """Yield the numbers at and below a node, in their order; kind : what the node is, as far as it is known."""
    if node is None:
        return
    if isinstance(node, Scalar):
        if isinstance(node.value, (int, float)) and not isinstance(node.value, bool):
            yield WrittenNumber(path, node.text, 0, len(node.text), float(node.value), False)
        elif isinstance(node.value, str) and _has_formulas(kind):
            yield from _in_text(node.value, path)
        return
    kind = concrete(kind, node) if kind is not None else None
    if isinstance(node, Sequence):
        for k, item in enumerate(node.items):
            yield from numbers_in(item, below(kind, str(k)), (*path, k))
    elif isinstance(node, Mapping):
        for key, value in node.entries:
            yield from numbers_in(value, below(kind, key.text), (*path, key.text))


def below(kind: Kind | None, step: str) -> Kind | None:
    """Return what stands under a step of a path; the items of a vector are numbers."""
    if isinstance(kind, Vector):
        return Number()
    return child_kind(kind, step)


def _has_formulas(kind: Kind | None) -> bool:
    """Tell whether a text may be a formula or a constant."""
    if isinstance(kind, Either):
        return any(_has_formulas(one) for one in kind.kinds)
    return isinstance(kind, (Number, Formula))


def _in_text(text: str, path: Path) -> Iterator[WrittenNumber]:
    from robodyn_cli.expr import units
    from robodyn_cli.expr.formula_parser import tokens

    try:
        found = tokens(text)
    except SceneError:
        return
    inside = 0  # of a unit: the 2 of m^2 is no number of its own
    for token in found:
        start = token.column - 1
        end = start + len(token.text)
        if token.kind == "number" and start >= inside:
            yield WrittenNumber(path, text, start, end, float(token.text), True)
        unit = units.match(text, end) if token.kind == "number" or token.text == ")" else None
        inside = unit[1] if unit is not None else inside


def number_at(node: Node | None, kind: Kind | None, n: int) -> WrittenNumber | None:
    """Return the n-th number at or below a node, None where there are fewer."""
    return next(itertools.islice(numbers_in(node, kind), n - 1, None), None)


def why_none(node: Node | None, kind: Kind | None, n: int) -> str:
    """Return why there is no n-th number."""
    found = [x.text[x.start : x.end] for x in itertools.islice(numbers_in(node, kind), SHOWN)]
    if not found:
        return f"has no numbers, so there is no #{n}"
    count = sum(1 for _ in numbers_in(node, kind))
    more = ", ..." if count > len(found) else ""
    of = "1 number" if count == 1 else f"{count} numbers"
    return f"has {of} ({', '.join(found)}{more}), so there is no #{n}; allowed: #1 to #{count}"


def with_leaf(node: Node, path: Path, leaf: Node) -> Node:
    """Return a tree with another node at a path that it has."""
    if not path:
        return leaf
    step, rest = path[0], path[1:]
    if isinstance(node, Sequence):
        items = list(node.items)
        items[int(step)] = with_leaf(items[int(step)], rest, leaf)
        return sequence(node, items)
    assert isinstance(node, Mapping)
    key = node.key(str(step))
    assert key is not None
    value = node.get(str(step))
    assert value is not None
    return node.replaced(key, with_leaf(value, rest, leaf))


def at_key(root: Node, kind: Kind, key: str) -> tuple[Node | None, Kind | None, Path]:
    """Return the node that a key without a count names, None for none; what it is; its path, lists by index."""
    node: Node | None = root
    found: Kind | None = kind
    path: list[str | int] = []
    for step in key.split("."):
        found = concrete(found, node) if found is not None and node is not None else found
        found = below(found, step)
        index = index_of(node, step) if isinstance(node, Sequence) else None
        path.append(step if index is None else index)
        if isinstance(node, Mapping):
            node = node.get(step)
        else:
            node = node.items[index] if isinstance(node, Sequence) and index is not None else None
    return node, found, tuple(path)
