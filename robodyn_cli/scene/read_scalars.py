"""Read scalars of a tree (numbers, words, names, formulas) and values by joint; complaints name file, line and key."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import re
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from robodyn_cli.errors import SceneError, did_you_mean, shown
from robodyn_cli.expr import formula as fm
from robodyn_cli.record import record
from robodyn_cli.scene.text.nodes import (
    Faults,
    Mapping,
    Node,
    Path,
    Scalar,
    describe_node,
    dotted,
    doubts_of_angle,
    located,
    place_of,
)
from robodyn_cli.schema.fields import (
    Boolean,
    Choice,
    Collection,
    CsvFile,
    Formula,
    Integer,
    Kind,
    MeshFile,
    Name,
    Number,
    Text,
    Vector,
    describe,
)
from robodyn_cli.summaries.facts import for_coordinate, of_angle

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_-]*")
_IN_FORMULAS = ("joint", "parameter")
BROKEN: Any = object()  # in place of a value that could not be read


@record
class Names:
    """What formulas may refer to."""

    joints: tuple[str, ...] = ()
    parameters: tuple[str, ...] = ()
    fixed: tuple[str, ...] = ()  # joints without a coordinate, for a better message
    rates: tuple[str, ...] = ()  # columns of v, where they differ from those of q
    types: dict[str, str] = dataclasses.field(default_factory=dict)  # of the joints
    states: tuple[str, ...] = ()  # of the controller
    coordinates: dict[str, str] = dataclasses.field(default_factory=dict)  # rad, m or 1 by column of q or v


class ScalarReader:
    """Reads scalars; ``names`` are those that formulas may use, ``faults`` collects errors."""

    def __init__(self, names: Names, faults: Faults) -> None:
        self.names = names
        self.faults = faults
        self.doubts: list[str] = []
        self.coordinate, self.joint = "", ""  # unit and joint that values which depend on these are of
        # looked up for each formula: as sets, but in the order of the scene
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
            Formula: self.formula,
            CsvFile: self.text,
            MeshFile: self.text,
        }

    @contextlib.contextmanager
    def of_coordinate(self, unit: str, joint: str = "") -> Iterator[None]:
        """Read values of a coordinate in ``rad`` or ``m`` in this block; of other units, of a joint of either kind."""
        before = self.coordinate, self.joint
        self.coordinate, self.joint = unit, joint
        try:
            yield
        finally:
            self.coordinate, self.joint = before

    def value(self, kind: Kind, node: Node, path: Path, unit: str = "") -> Any:
        """Return the value of ``node`` as ``kind`` asks; report a fault and return BROKEN where it cannot be read."""
        with self.faults:
            return self.handlers[type(kind)](kind, node, path, unit)
        return BROKEN

    def wrong(self, kind: Kind, node: Node, path: Path, unit: str, fault: str = "") -> SceneError:
        """Return the error of a value that ``kind`` does not allow."""
        allowed = describe(kind, for_coordinate(unit, self.coordinate))
        if isinstance(node, Scalar) and node.value is None and not fault:
            return located(node, dotted(path), f"has no value; allowed: {allowed}")
        if isinstance(node, Scalar) and type(node.value) in (int, float):
            fault = fault or "is a number"
        fault = fault or "is not allowed here"
        return located(node, dotted(path), f"{fault} (value {describe_node(node)}); allowed: {allowed}")

    @staticmethod
    def unknown(kind: Kind, node: Scalar, path: Path, hint: str) -> SceneError:
        """Return the error of a word that is none of the choices."""
        return located(
            node, dotted(path), f"unknown choice {shown(node.text)}{hint}; allowed: {describe(kind)}"
        )

    def number(self, kind: Number, node: Node, path: Path, unit: str) -> float:
        value = self.plain_number(kind, node, path, unit)
        self.check_range(kind, value, node, path, unit)
        return value

    def plain_number(self, kind: Kind, node: Node, path: Path, unit: str) -> float:
        """Return a finite number in SI units, from a number or from text that is a constant formula."""
        if not isinstance(node, Scalar) or node.value is None or isinstance(node.value, bool):
            raise self.wrong(kind, node, path, unit)
        if not isinstance(node.value, str):
            value = self.finite(node, path)
            if abs(value) > math.tau and of_angle(for_coordinate(unit, self.coordinate)):
                self.doubts += doubts_of_angle(value, node, path)
            return value
        tree = self.parse(kind, node, path, unit)
        if tree.constant is None:
            name = sorted(tree.names)[0]
            raise self.wrong(kind, node, path, unit, f"is not a number: {name!r} is part of it")
        self.check_unit(kind, tree, node, path, unit)
        return tree.constant

    def check_unit(self, kind: Kind, tree: fm.FormulaTree, node: Scalar, path: Path, unit: str) -> None:
        """Refuse a constant of another kind than its key; a key without a unit, such as a parameter, takes any."""
        if tree.dims is None or not unit:
            return
        from robodyn_cli.expr import units

        unit = for_coordinate(unit, self.coordinate)
        if fault := units.fault(tree.dims, unit, node.text):
            at = min(tree.unit_words.values()) - 1
            read = units.match(node.text, at)
            word = node.text[at : read[1]] if read is not None else node.text
            of = f" joint {self.joint!r}" if self.joint else ""
            raise self.wrong(kind, node, path, unit, f"{word!r} does not fit{of}: {fault}")

    def finite(self, node: Scalar, path: Path) -> float:
        value = float(node.value) if isinstance(node.value, (int, float)) else math.nan
        if not math.isfinite(value):
            raise located(
                node, dotted(path), f"is not finite (value {describe_node(node)}); allowed: a finite number"
            )
        return value

    def check_range(self, kind: Number | Integer, value: float, node: Node, path: Path, unit: str) -> None:
        low, high = kind.minimum, kind.maximum
        if low is not None and low == high and value != low:
            raise self.wrong(kind, node, path, unit, "is not known here")
        strict = isinstance(kind, Number) and kind.exclusive
        if low is not None and (value < low or (strict and value == low)):
            raise self.wrong(kind, node, path, unit, "is too small")
        if high is not None and (value > high or (strict and value == high)):
            raise self.wrong(kind, node, path, unit, "is too large")

    def entries_of(
        self, kind: Collection, node: Node, path: Path, unit: str
    ) -> Sequence[tuple[Scalar, Node]]:
        """Return the entries of a map; one whose value is left empty has none."""
        if isinstance(node, Scalar) and node.value is None and not kind.minimum:
            return ()
        if not isinstance(node, Mapping):
            raise self.wrong(kind, node, path, unit)
        if len(node.entries) < kind.minimum:
            raise self.wrong(kind, node, path, unit, entries(len(node.entries)))
        return node.entries

    def integer(self, kind: Integer, node: Node, path: Path, unit: str) -> int:
        value = self.plain_number(kind, node, path, unit or "1")
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
        fault = "is not text; put it in quotes" if isinstance(node, Scalar) and node.value is not None else ""
        raise self.wrong(kind, node, path, unit, fault)

    def name(self, kind: Name, node: Node, path: Path, unit: str) -> str:
        if not isinstance(node, Scalar) or node.value is None:
            raise self.wrong(kind, node, path, unit)
        try:
            self.check_name(kind.of, node, path)
        except SceneError as error:
            if not isinstance(node.value, str):
                raise
            # keep a bad name: it still distinguishes entries, and the rest of the list can be checked
            self.faults.report(error)
        return node.text

    def check_name(self, of: str, node: Scalar, path: Path) -> None:
        """Refuse what cannot be a name, and words that mean something else in formulas."""
        if not _NAME.fullmatch(node.text):
            fault = (
                f"{shown(node.text)} cannot be the name of a {of}" if of else f"{shown(node.text)} is no name"
            )
            raise located(
                node, dotted(path), f"{fault}; allowed: letters, digits, _ and -, not first a digit"
            )
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

    def formula(self, kind: Formula, node: Node, path: Path, unit: str) -> fm.FormulaTree:
        if not isinstance(node, Scalar) or node.value is None or isinstance(node.value, bool):
            raise self.wrong(kind, node, path, unit)
        if not isinstance(node.value, str):
            return fm.FormulaTree.number(self.finite(node, path))
        tree = self.parse(kind, node, path, unit)
        self.check_unit(kind, tree, node, path, unit)
        self.check_moving(tree, node, path)
        try:
            tree = tree.resolve(self.joints, self.parameters, kind.variables, self.rates, self.names.states)
        except SceneError as error:
            raise located(node, dotted(path), error.message) from None
        if tree.unit_words and tree.constant is None:
            self.check_quantities(kind, tree, node, path, unit)
        return dataclasses.replace(tree, where=place_of(node, dotted(path)))

    def check_quantities(self, kind: Kind, tree: fm.FormulaTree, node: Scalar, path: Path, unit: str) -> None:
        """Refuse a formula whose units do not go with one another, with what is known of its names, or with its key."""
        from robodyn_cli.expr import units
        from robodyn_cli.expr.quantities import quantity_of, unit_of_name

        known = {name: units.of(unit_of_name(name, self.names.coordinates)) for name in tree.names}
        unit = for_coordinate(unit, self.coordinate)
        try:
            quantity = quantity_of(tree.root, {name: x.dims for name, x in known.items() if x is not None})
        except SceneError as error:
            raise located(node, dotted(path), f"formula {shown(tree.text)}: {error.message}") from None
        if not unit or not quantity.kinds:
            return
        forms = [form for form in map(units.of, units.forms(unit)) if form is not None]
        faults = [units.fault(dims, unit, f"the formula {shown(tree.text)}") for dims in quantity.kinds]
        if all(faults) and not any(quantity.fits(form.dims) for form in forms):
            raise self.wrong(kind, node, path, unit, faults[0])

    def check_moving(self, tree: fm.FormulaTree, node: Node, path: Path) -> None:
        """Refuse the names of joints without a coordinate."""
        for name in tree.names:
            if name.endswith(")"):
                continue
            parts = name.split(".")
            joint = parts[1] if len(parts) > 1 else name
            if joint in self.names.fixed:
                message = f"joint {joint!r} is fixed: it has no coordinate for a formula"
                raise located(node, dotted(path), f"{message} (value {describe_node(node)})")

    def parse(self, kind: Kind, node: Scalar, path: Path, unit: str) -> fm.FormulaTree:
        try:
            return fm.parse(node.text)
        except SceneError as error:
            allowed = describe(kind, for_coordinate(unit, self.coordinate))
            raise located(node, dotted(path), f"{error.message}; allowed: {allowed}") from None


def entries(count: int) -> str:
    """Return in words how many entries there are."""
    return f"has {count} {'entry' if count == 1 else 'entries'}" if count else "has no entry"


def units_of_entries(kind: Vector, unit: str, count: int) -> list[str]:
    """Return the unit of each entry of a list: of ``s, N m`` that of its column or, of six entries, of its half."""
    columns = unit.split(", ")
    if len(columns) != 2:
        return [unit] * count
    return [columns[k // 3 if kind.size == 6 else min(k, 1)] for k in range(count)]
