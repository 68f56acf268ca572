"""Read a tree into the dataclasses that describe it; every complaint names file, line, column and key."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any, TypeVar

from robodyn_cli.errors import SceneError, did_you_mean
from robodyn_cli.expr import formula as fm
from robodyn_cli.expr.expectation import Expectation, parse_expectation
from robodyn_cli.record import record
from robodyn_cli.scene.joint_values import joint_map
from robodyn_cli.scene.text.includes import concrete
from robodyn_cli.scene.text.nodes import (
    Mapping,
    Node,
    Path,
    Scalar,
    Sequence,
    describe_node,
    dotted,
    located,
    shown,
)
from robodyn_cli.schema.describe import describe
from robodyn_cli.schema.fields import (
    Boolean,
    Choice,
    Criteria,
    CsvFile,
    Either,
    Formula,
    Inline,
    Integer,
    JointMap,
    Kind,
    ListOf,
    MapOf,
    Name,
    Number,
    OrFile,
    Section,
    Tagged,
    Text,
    Vector,
)

T = TypeVar("T")

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_-]*")
_IN_FORMULAS = ("joint", "parameter")
_MAX_LISTED = 20
# what stands for a value that could not be read, where errors are collected
BROKEN: Any = object()


def _entries(node: Sequence) -> str:
    return f"has {len(node.items)} {'entry' if len(node.items) == 1 else 'entries'}"


@record
class Names:
    """What formulas may refer to."""

    joints: tuple[str, ...] = ()
    parameters: tuple[str, ...] = ()
    fixed: tuple[str, ...] = ()  # joints without a coordinate, for a better message
    rates: tuple[str, ...] = ()  # columns of v, where they differ from those of q
    types: dict[str, str] = dataclasses.field(default_factory=dict)  # of the joints


class Reader:
    """Reads one scene; ``names`` are those that formulas may use."""

    def __init__(self, names: Names) -> None:
        self.names = names
        # looked up once a formula: as sets, but in the order of the scene
        self.joints = dict.fromkeys(names.joints)
        self.rates = dict.fromkeys(names.rates or names.joints)
        self.parameters = dict.fromkeys(names.parameters)
        self.handlers: dict[type[Kind], Callable[[Any, Node, Path, str], Any]] = {
            Number: self.number,
            Integer: self.integer,
            Boolean: self.boolean,
            Text: self.text,
            Name: self.name,
            Choice: self.choice,
            Vector: self.vector,
            Formula: self.formula,
            ListOf: self.list_of,
            MapOf: self.map_of,
            JointMap: partial(joint_map, self),
            Section: self.section,
            Tagged: self.tagged,
            Either: self.either,
            OrFile: self.or_file,
            CsvFile: self.text,
            Criteria: self.criteria,
        }

    def read(self, cls: type[T], node: Node, path: Path = ()) -> T:
        """Return an instance of the dataclass ``cls``."""
        instance: T = self.section(Section(cls), node, path)
        return instance

    def value(self, kind: Kind, node: Node, path: Path, unit: str = "") -> Any:
        """Return what ``node`` says, as ``kind`` wants it."""
        return self.handlers[type(kind)](kind, node, path, unit)

    def report(self, error: SceneError) -> None:
        """Raise an error after which reading could go on."""
        raise error

    def wrong(self, kind: Kind, node: Node, path: Path, unit: str, what: str = "") -> SceneError:
        """Return the error of a value that ``kind`` does not allow."""
        allowed = describe(kind, unit)
        if isinstance(node, Scalar) and node.value is None and not what:
            return located(node, dotted(path), f"has no value; allowed: {allowed}")
        what = what or "is not allowed here"
        return located(node, dotted(path), f"{what} (value {describe_node(node)}); allowed: {allowed}")

    @staticmethod
    def unknown(kind: Kind, node: Scalar, path: Path, hint: str) -> SceneError:
        """Return the error of a word that is none of the choices."""
        return located(
            node, dotted(path), f"unknown choice {shown(node.text)}{hint}; allowed: {describe(kind)}"
        )

    # -- scalars --------------------------------------------------------------------------------------
    def number(self, kind: Number, node: Node, path: Path, unit: str) -> float:
        value = self.plain_number(kind, node, path, unit, kind.angle)
        self.check_range(kind, value, node, path, unit)
        return value

    def plain_number(self, kind: Kind, node: Node, path: Path, unit: str, angle: bool) -> float:
        """Return a finite number, from a number or from text that is a constant formula."""
        if not isinstance(node, Scalar) or node.value is None or isinstance(node.value, bool):
            raise self.wrong(kind, node, path, unit)
        if not isinstance(node.value, str):
            return self.finite(node, path)
        tree = self.parse(node, path, describe(kind, unit))
        if tree.constant is None:
            name = sorted(tree.names)[0]
            raise self.wrong(kind, node, path, unit, f"is not a number: {name!r} stands in it")
        if tree.degrees and not angle:
            raise self.wrong(kind, node, path, unit, "'deg' does not fit: this is not an angle")
        return tree.constant

    def finite(self, node: Scalar, path: Path) -> float:
        value = float(node.value) if isinstance(node.value, (int, float)) else math.nan
        if not math.isfinite(value):
            raise located(
                node, dotted(path), f"is not finite (value {describe_node(node)}); allowed: a finite number"
            )
        return value

    def check_range(self, kind: Number | Integer, value: float, node: Node, path: Path, unit: str) -> None:
        low, high = kind.minimum, kind.maximum
        strict = isinstance(kind, Number) and kind.exclusive
        if low is not None and (value < low or (strict and value == low)):
            raise self.wrong(kind, node, path, unit, "is too small")
        if high is not None and (value > high or (strict and value == high)):
            raise self.wrong(kind, node, path, unit, "is too large")

    def integer(self, kind: Integer, node: Node, path: Path, unit: str) -> int:
        value = self.plain_number(kind, node, path, unit, False)
        if not value.is_integer():
            raise self.wrong(kind, node, path, unit, "is not a whole number")
        self.check_range(kind, value, node, path, unit)
        return int(value)

    def boolean(self, kind: Boolean, node: Node, path: Path, unit: str) -> bool:
        if not isinstance(node, Scalar) or not isinstance(node.value, bool):
            raise self.wrong(kind, node, path, unit)
        return node.value

    def text(self, kind: Kind, node: Node, path: Path, unit: str) -> str:
        if isinstance(node, Scalar) and isinstance(node.value, str):
            return node.value
        what = "is not text; put it in quotes" if isinstance(node, Scalar) and node.value is not None else ""
        raise self.wrong(kind, node, path, unit, what)

    def name(self, kind: Name, node: Node, path: Path, unit: str) -> str:
        if not isinstance(node, Scalar) or node.value is None:
            raise self.wrong(kind, node, path, unit)
        self.check_name(kind.of, node, path)
        return node.text

    def check_name(self, of: str, node: Scalar, path: Path) -> None:
        """Refuse what cannot be a name, and words that mean something else in formulas."""
        if not _NAME.fullmatch(node.text):
            what = (
                f"{shown(node.text)} cannot be the name of a {of}" if of else f"{shown(node.text)} is no name"
            )
            raise located(node, dotted(path), f"{what}; allowed: letters, digits, _ and -, not first a digit")
        if of in _IN_FORMULAS and "-" in node.text:
            message = f"{shown(node.text)}: '-' is a sign in formulas; allowed: letters, digits, _"
            raise located(node, dotted(path), message)
        if of in _IN_FORMULAS and node.text in fm.RESERVED:
            raise located(
                node, dotted(path), f"{shown(node.text)} has a meaning in formulas; choose another name"
            )

    def choice(self, kind: Choice, node: Node, path: Path, unit: str) -> str:
        if not isinstance(node, Scalar):
            raise self.wrong(kind, node, path, unit)
        if node.text not in kind.options or not isinstance(node.value, str):
            hint = did_you_mean(node.text, kind.options)
            if not node.text:
                raise self.wrong(kind, node, path, unit)
            raise self.unknown(kind, node, path, hint)
        return node.text

    def formula(self, kind: Formula, node: Node, path: Path, unit: str) -> fm.Formula:
        if not isinstance(node, Scalar) or node.value is None or isinstance(node.value, bool):
            raise self.wrong(kind, node, path, unit)
        if not isinstance(node.value, str):
            return fm.Formula.number(self.finite(node, path))
        tree = self.parse(node, path, describe(kind, unit))
        for name in tree.names:
            parts = name.split(".")
            joint = parts[1] if len(parts) > 1 else name
            if joint in self.names.fixed:
                message = f"joint {joint!r} is fixed: it has no coordinate for a formula"
                raise located(node, dotted(path), f"{message} (value {describe_node(node)})")
        try:
            tree = tree.resolve(self.joints, self.parameters, kind.variables, self.rates)
        except SceneError as error:
            raise located(node, dotted(path), error.message) from None
        where = str(located(node, dotted(path), "").message).removesuffix(": ")
        return dataclasses.replace(tree, where=where)

    def parse(self, node: Scalar, path: Path, allowed: str) -> fm.Formula:
        try:
            return fm.parse(node.text)
        except SceneError as error:
            raise located(node, dotted(path), f"{error.message}; allowed: {allowed}") from None

    # -- collections ----------------------------------------------------------------------------------
    def vector(self, kind: Vector, node: Node, path: Path, unit: str) -> tuple[float, ...]:
        if not isinstance(node, Sequence):
            raise self.wrong(kind, node, path, unit)
        if kind.size and len(node.items) != kind.size:
            raise self.wrong(kind, node, path, unit, _entries(node))
        entry = Number(angle=kind.angle)
        return tuple(
            self.plain_number(entry, item, (*path, k), unit, kind.angle) for k, item in enumerate(node.items)
        )

    def list_of(self, kind: ListOf, node: Node, path: Path, unit: str) -> tuple[Any, ...]:
        if not isinstance(node, Sequence):
            raise self.wrong(kind, node, path, unit)
        if len(node.items) < kind.minimum or (kind.maximum is not None and len(node.items) > kind.maximum):
            raise self.wrong(kind, node, path, unit, _entries(node))
        return tuple(self.value(kind.item, item, (*path, k), unit) for k, item in enumerate(node.items))

    def entries_of(self, kind: Kind, node: Node, path: Path, unit: str) -> Iterable[tuple[Scalar, Node]]:
        """Return the entries of a map; one whose value is left empty has none."""
        if isinstance(node, Scalar) and node.value is None:
            return ()
        if not isinstance(node, Mapping):
            raise self.wrong(kind, node, path, unit)
        return node.entries

    def map_of(self, kind: MapOf, node: Node, path: Path, unit: str) -> dict[str, Any]:
        result = {}
        for key, item in self.entries_of(kind, node, path, unit):
            self.check_name(kind.of, key, (*path, key.text))
            result[key.text] = self.value(kind.item, item, (*path, key.text), unit)
        return result

    def criteria(self, kind: Criteria, node: Node, path: Path, unit: str) -> dict[str, Expectation]:
        """Return what is expected by key path; maps below a key are the same as dots in it."""
        result = {}
        for key, item in self.entries_of(kind, node, path, unit):
            here = (*path, key.text)
            if isinstance(item, Mapping):
                inner = self.criteria(kind, item, here, unit)
                result.update({f"{key.text}.{name}": expected for name, expected in inner.items()})
            elif isinstance(item, Scalar):
                try:
                    result[key.text] = parse_expectation(item.value)
                except SceneError as error:
                    self.report(located(item, dotted(here), error.message))
            else:
                self.report(self.wrong(kind, item, here, unit))
        return result

    def tagged(self, kind: Tagged, node: Node, path: Path, unit: str) -> Any:
        options = kind.registry()
        if not isinstance(node, Mapping):
            raise self.wrong(kind, node, path, unit)
        tag = node.get(kind.tag)
        if tag is None:
            message = f"key {kind.tag!r} is missing; allowed: {', '.join(options)}"
            raise located(node, dotted(path), message)
        self.choice(Choice(tuple(options)), tag, (*path, kind.tag), "")
        found = concrete(kind, node)
        assert isinstance(found, Section)
        return self.section(found, node, path)

    def either(self, kind: Either, node: Node, path: Path, unit: str) -> Any:
        found = concrete(kind, node)
        if found is None or (isinstance(node, Scalar) and node.value is None):
            raise self.wrong(kind, node, path, unit)
        if isinstance(found, Choice) and isinstance(node, Scalar) and node.text not in found.options:
            # speak of all that is allowed, not of the scalar form only
            hint = did_you_mean(node.text, found.options)
            raise self.unknown(kind, node, path, hint)
        return self.value(found, node, path, unit)

    def or_file(self, kind: OrFile, node: Node, path: Path, unit: str) -> Any:
        # files have been brought in before reading: what is still a scalar is no path
        if isinstance(node, Scalar):
            raise self.wrong(kind, node, path, unit)
        return self.value(kind.item, node, path, unit)

    # -- sections -------------------------------------------------------------------------------------
    def section(self, kind: Section, node: Node, path: Path, unit: str = "") -> Any:
        fields = {f.name: f for f in dataclasses.fields(kind.cls) if "kind" in f.metadata}
        inline = {
            name: (f.name, registry)
            for f in fields.values()
            if isinstance(f.metadata["kind"], Inline)
            for registry in (f.metadata["kind"].registry(),)
            for name in registry
        }
        holders = {f.name for f in fields.values() if isinstance(f.metadata["kind"], Inline)}
        allowed = [name for name in fields if name not in holders] + list(inline)
        if not isinstance(node, Mapping):
            keys = ", ".join(allowed[:_MAX_LISTED])
            what = "has no value" if isinstance(node, Scalar) and node.value is None else "is not a map"
            raise located(
                node, dotted(path), f"{what} (value {describe_node(node)}); allowed: a map with keys {keys}"
            )
        values: dict[str, Any] = {}
        elements: dict[str, list[tuple[str, Any]]] = {holder: [] for holder in holders}
        for key, item in node.entries:
            here = (*path, key.text)
            if key.text not in allowed:
                hint = did_you_mean(key.text, allowed)
                what = f"unknown key {shown(key.text)}{hint}; allowed: {', '.join(allowed)}"
                self.report(located(key, dotted(here), what))
            elif key.text in inline:
                holder, registry = inline[key.text]
                found = self.value(Section(registry[key.text]), item, here)
                if found is not BROKEN:
                    elements[holder].append((key.text, found))
            elif not self.is_default(fields[key.text], item):
                field = fields[key.text]
                values[key.text] = self.value(field.metadata["kind"], item, here, field.metadata["unit"])
        self.check_missing(fields, holders, values, node, path)
        order = list(inline)
        for holder, pairs in elements.items():
            # in the order of the registry, so that the order of keys in the file makes no difference
            values[holder] = tuple(sorted(pairs, key=lambda pair: order.index(pair[0])))
        return self.make(kind.cls, values)

    def make(self, cls: type, values: dict[str, Any]) -> Any:
        """Return the section with these values."""
        return cls(**values)

    @staticmethod
    def is_default(field: dataclasses.Field[Any], node: Node) -> bool:
        """Tell whether a key is written as null where null means that it is absent."""
        return isinstance(node, Scalar) and node.value is None and field.default is None

    def check_missing(
        self,
        fields: dict[str, dataclasses.Field[Any]],
        holders: set[str],
        values: dict[str, Any],
        node: Node,
        path: Path,
    ) -> None:
        needed = [
            f.name
            for f in fields.values()
            if f.default is dataclasses.MISSING
            and f.default_factory is dataclasses.MISSING
            and f.name not in holders
        ]
        missing = [name for name in needed if name not in values]
        if missing:
            keys = ", ".join(repr(name) for name in missing)
            what = f"key{'s' * (len(missing) > 1)} {keys} {'are' if len(missing) > 1 else 'is'} missing"
            docs = fields[missing[0]].metadata
            meaning = f" ({missing[0]}: {describe(docs['kind'], docs['unit'])})"
            self.report(located(node, dotted(path), f"{what}{meaning}; needed here: {', '.join(needed)}"))
