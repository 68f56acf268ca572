"""Read a tree into the dataclasses that describe it; every complaint names file, line, column and key."""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Mapping as MappingOf
from functools import partial
from typing import Any

from robodyn_cli.errors import SceneError, did_you_mean, nearest_word, unknown_name
from robodyn_cli.expr.statements import Expectation, Variation, parse_expectation, parse_variation
from robodyn_cli.joints.registry import joint_types
from robodyn_cli.record import record
from robodyn_cli.scene.read_joints import coordinate_of, joint_map
from robodyn_cli.scene.read_scalars import BROKEN, Names, ScalarReader, entries, units_of_entries
from robodyn_cli.scene.robot_types import Joint
from robodyn_cli.scene.text import nodes
from robodyn_cli.scene.text.includes import concrete
from robodyn_cli.schema import fields as kinds
from robodyn_cli.summaries.facts import for_coordinate

_MAX_LISTED = 20
# squares of longer or shorter directions overflow or underflow
_LONGEST = 1e100


@record
class _Keys:
    """The keys of a section: its own fields, and those of registered classes by name (``friction``, ``spring``).

    inline : by key, the field that holds the instance, and its kind.
    """

    fields: dict[str, dataclasses.Field[Any]]
    inline: dict[str, tuple[str, kinds.Inline]]

    @staticmethod
    def of(cls: type) -> _Keys:
        """Return the keys of the dataclass ``cls``."""
        described = {kinds.key_name(f): f for f in dataclasses.fields(cls) if "kind" in f.metadata}
        holders = {name: f.metadata["kind"] for name, f in described.items()}
        holders = {name: kind for name, kind in holders.items() if isinstance(kind, kinds.Inline)}
        inline = {key: (name, kind) for name, kind in holders.items() for key in kind.registry()}
        return _Keys({name: f for name, f in described.items() if name not in holders}, inline)

    def field(self, key: str) -> str:
        """Return the field of a key."""
        return self.fields[key].name if key in self.fields else key

    @property
    def allowed(self) -> list[str]:
        """All keys."""
        return [*self.fields, *self.inline]

    @property
    def needed(self) -> list[str]:
        """The keys without a default."""
        return [
            name
            for name, field in self.fields.items()
            if field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING
        ]


def _is_default(field: dataclasses.Field[Any], node: nodes.Node) -> bool:
    """Tell whether a key is written as null where null means that it is absent."""
    return isinstance(node, nodes.Scalar) and node.value is None and field.default is None


class Reader(ScalarReader):
    """Reads one scene. A value that cannot be read is BROKEN, and so is a section that needs it.

    stand_ins : values in place of keys at the top of the scene that are broken or missing.
    """

    def __init__(self, names: Names, faults: nodes.Faults, stand_ins: MappingOf[str, Any]) -> None:
        super().__init__(names, faults)
        self.stand_ins = stand_ins
        self.handlers |= {
            kinds.Vector: self.vector,
            kinds.Direction: self.direction,
            kinds.ListOf: self.list_of,
            kinds.MapOf: self.map_of,
            kinds.JointMap: partial(joint_map, self),
            kinds.Section: self.section,
            kinds.LaterSection: self.section,
            kinds.Tagged: self.tagged,
            kinds.Either: self.either,
            kinds.ByPart: self.by_part,
            kinds.OrFile: self.or_file,
            kinds.Criteria: self.criteria,
            kinds.Variations: self.variations,
            kinds.Settings: self.settings,
        }

    # -- collections ----------------------------------------------------------------------------------
    def vector(self, kind: kinds.Vector, node: nodes.Node, path: nodes.Path, unit: str) -> tuple[float, ...]:
        if not isinstance(node, nodes.Sequence):
            raise self.wrong(kind, node, path, unit)
        if kind.size and len(node.items) != kind.size:
            raise self.wrong(kind, node, path, unit, entries(len(node.items)))
        units = units_of_entries(kind, unit, len(node.items))
        return tuple(
            self.plain_number(kinds.Number(), item, (*path, k), units[k]) for k, item in enumerate(node.items)
        )

    def direction(
        self, kind: kinds.Direction, node: nodes.Node, path: nodes.Path, unit: str
    ) -> tuple[float, ...]:
        vector = self.vector(kind, node, path, unit)
        length = math.hypot(*vector)
        if length == 0.0:
            raise nodes.located(node, nodes.dotted(path), "must not be zero (value [0, 0, 0])")
        if not 1.0 / _LONGEST < length < _LONGEST:
            message = f"has length {length:.3g}; allowed: a direction, such as [0, 0, 1]"
            raise nodes.located(node, nodes.dotted(path), message)
        return vector

    def list_of(self, kind: kinds.ListOf, node: nodes.Node, path: nodes.Path, unit: str) -> Any:
        if not isinstance(node, nodes.Sequence):
            raise self.wrong(kind, node, path, unit)
        if len(node.items) < kind.minimum or (kind.maximum is not None and len(node.items) > kind.maximum):
            raise self.wrong(kind, node, path, unit, entries(len(node.items)))
        items = tuple(self.value(kind.item, item, (*path, k), unit) for k, item in enumerate(node.items))
        return BROKEN if any(x is BROKEN for x in items) else items

    def map_of(self, kind: kinds.MapOf, node: nodes.Node, path: nodes.Path, unit: str) -> dict[str, Any]:
        result = {}
        for key, item in self.entries_of(kind, node, path, unit):
            with self.faults:
                self.check_name(kind.of, key, (*path, key.text))
            of = self.names.types.get(key.text) if kind.of == "joint" else None
            with self.of_coordinate(coordinate_of(joint_types.get(of or "")), key.text if of else ""):
                value = self.value(kind.item, item, (*path, key.text), unit)
            if value is not BROKEN:
                result[key.text] = value
        return result

    def criteria(
        self, kind: kinds.Criteria, node: nodes.Node, path: nodes.Path, unit: str
    ) -> dict[str, Expectation]:
        """Return what is expected by key path; maps below a key are the same as dots in it."""
        result = {}
        for key, item in self.entries_of(kind, node, path, unit):
            here = (*path, key.text)
            if isinstance(item, nodes.Mapping):
                inner = self.criteria(kind, item, here, unit)
                result.update({f"{key.text}.{name}": expected for name, expected in inner.items()})
            elif isinstance(item, nodes.Scalar):
                try:
                    result[key.text] = parse_expectation(item.value, nodes.dotted(here))
                except SceneError as error:
                    self.faults.report(nodes.located(item, nodes.dotted(here), error.message))
            else:
                self.faults.report(self.wrong(kind, item, here, unit))
        return result

    def variations(
        self, kind: kinds.Variations, node: nodes.Node, path: nodes.Path, unit: str
    ) -> dict[str, Variation]:
        """Return by key path what it varies over."""
        result = {}
        for key, item in self.entries_of(kind, node, path, unit):
            given: Any = None
            if isinstance(item, nodes.Scalar):
                given = item.value
            elif isinstance(item, nodes.Sequence) and all(isinstance(x, nodes.Scalar) for x in item.items):
                given = [x.value for x in item.items if isinstance(x, nodes.Scalar)]
            try:
                result[key.text] = parse_variation(given)
            except SceneError as error:
                self.faults.report(nodes.located(item, nodes.dotted((*path, key.text)), error.message))
        return result

    def settings(self, kind: kinds.Settings, node: nodes.Node, path: nodes.Path, unit: str) -> dict[str, str]:
        """Return by key path the value as ``--set`` writes it; maps below a key are the same as dots in it."""
        from robodyn_cli.scene.text.yaml_text import flow

        result = {}
        for key, item in self.entries_of(kind, node, path, unit):
            if isinstance(item, nodes.Mapping):
                inner = self.settings(kind, item, (*path, key.text), unit)
                result.update({f"{key.text}.{name}": value for name, value in inner.items()})
            else:
                result[key.text] = flow(item)
        return result

    def tagged(self, kind: kinds.Tagged, node: nodes.Node, path: nodes.Path, unit: str) -> Any:
        options = kind.registry()
        if not isinstance(node, nodes.Mapping):
            raise self.wrong(kind, node, path, unit)
        tag = node.get(kind.tag)
        if tag is None:
            message = f"key {kind.tag!r} is missing; allowed: {', '.join(options)}"
            raise nodes.located(node, nodes.dotted(path), message)
        self.choice(kinds.Choice(tuple(options)), tag, (*path, kind.tag), "")
        section = concrete(kind, node)
        assert isinstance(section, kinds.Section)
        return self.section(section, node, path)

    def either(self, kind: kinds.Either, node: nodes.Node, path: nodes.Path, unit: str) -> Any:
        form = concrete(kind, node)
        if form is None or (isinstance(node, nodes.Scalar) and node.value is None):
            raise self.wrong(kind, node, path, unit)
        if (
            isinstance(form, kinds.Choice)
            and isinstance(node, nodes.Scalar)
            and node.text not in form.options
        ):
            # the message names all forms, not the scalar one only
            hint = did_you_mean(node.text, form.options)
            raise self.unknown(kind, node, path, hint)
        return self.value(form, node, path, unit)

    def by_part(self, kind: kinds.ByPart, node: nodes.Node, path: nodes.Path, unit: str) -> Any:
        form = concrete(kind, node)
        assert form is not None
        return self.value(form, node, path, unit)

    def or_file(self, kind: kinds.OrFile, node: nodes.Node, path: nodes.Path, unit: str) -> Any:
        # files are included before reading: a scalar that is left is no path
        if isinstance(node, nodes.Scalar):
            raise self.wrong(kind, node, path, unit)
        return self.value(kind.item, node, path, unit)

    # -- sections -------------------------------------------------------------------------------------
    def section(self, kind: kinds.Section, node: nodes.Node, path: nodes.Path, unit: str = "") -> Any:
        """Return an instance of the section's dataclass, or BROKEN where a value that it needs is."""
        keys = _Keys.of(kind.cls)
        if not isinstance(node, nodes.Mapping):
            listed = ", ".join(keys.allowed[:_MAX_LISTED])
            fault = (
                "has no value" if isinstance(node, nodes.Scalar) and node.value is None else "is not a map"
            )
            fault = f"{fault} (value {nodes.describe_node(node)})"
            if isinstance(node, nodes.Sequence) and isinstance(kind, kinds.LaterSection) and kind.several:
                fault = f"is a list; a list goes under {kind.several!r}"
            raise nodes.located(node, nodes.dotted(path), f"{fault}; allowed: a map with keys {listed}")
        joint = self.joint_of(kind.cls, node)
        coordinate = coordinate_of(joint_types.get(self.names.types.get(joint, "")))
        with self.of_coordinate(coordinate, joint) if joint else contextlib.nullcontext():
            values = self.section_values(keys, node, path)
        self.check_missing(keys, values, node, path)
        known = {keys.field(name): value for name, value in values.items() if value is not BROKEN}
        if not path:
            known = {**self.stand_ins, **known}
        return kind.cls(**known) if all(keys.field(name) in known for name in keys.needed) else BROKEN

    def joint_of(self, cls: type, node: nodes.Mapping) -> str:
        """Return the joint that a section describes, or that its key ``joint`` names; empty without one."""
        name = node.get("name" if cls is Joint else "joint")
        return name.text if isinstance(name, nodes.Scalar) and name.text in self.names.types else ""

    def section_values(self, keys: _Keys, node: nodes.Mapping, path: nodes.Path) -> dict[str, Any]:
        """Return the values by field; keys that do not exist are faults."""
        values: dict[str, Any] = {}
        elements: dict[str, Any] = {}
        for key, item in node.entries:
            here = (*path, key.text)
            if key.text in keys.inline:
                elements[key.text] = self.value(keys.inline[key.text][1].at(key.text), item, here)
            elif key.text not in keys.fields:
                words = unknown_name("key", key.text, keys.allowed)
                if key.text.isdecimal():  # what is behind the comma in {mass: 1,5}
                    words += "; decimals have a point: 1.5, not 1,5"
                self.faults.report(nodes.located(key, nodes.dotted(here), words))
            elif not _is_default(field := keys.fields[key.text], item):
                values[key.text] = self.value(field.metadata["kind"], item, here, field.metadata["unit"])
        # in the order of the registry, so that the order of keys in the file makes no difference
        for name, (holder, _) in keys.inline.items():
            entry = elements.get(name, BROKEN)
            if isinstance(entry, dict):
                pairs = tuple((f"{name}.{part}", element) for part, element in entry.items())
            else:
                pairs = ((name, entry),) if entry is not BROKEN else ()
            if pairs:
                values[holder] = (*values.get(holder, ()), *pairs)
        return values

    def check_missing(
        self, keys: _Keys, values: dict[str, Any], node: nodes.Mapping, path: nodes.Path
    ) -> None:
        """Report the keys that must be there and are not; one that is misspelt has been reported already."""
        unknown = [key.text for key, _ in node.entries if key.text not in (*keys.fields, *keys.inline)]
        meant = [nearest_word(word, keys.allowed) for word in unknown]
        missing = [name for name in keys.needed if name not in values and name not in meant]
        if missing:
            listed = ", ".join(repr(name) for name in missing)
            fault = f"key{'s' * (len(missing) > 1)} {listed} {'are' if len(missing) > 1 else 'is'} missing"
            docs = keys.fields[missing[0]].metadata
            unit = for_coordinate(docs["unit"], self.coordinate)
            meaning = f" ({missing[0]}: {kinds.describe(docs['kind'], unit)})"
            needed = ", ".join(keys.needed)
            self.faults.report(
                nodes.located(node, nodes.dotted(path), f"{fault}{meaning}; needed here: {needed}")
            )
