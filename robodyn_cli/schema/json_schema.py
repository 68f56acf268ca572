"""The JSON Schema (draft 2020-12) of a section, from the description that its reader uses.

It allows everything that the reader allows. The reader alone checks what a schema cannot express: formulas, names that
must exist, ranges of numbers that are written as text.
"""

from __future__ import annotations

import dataclasses
from typing import Any

from robodyn_cli.schema import fields as kinds
from robodyn_cli.schema.fields import describe

DRAFT = "https://json-schema.org/draft/2020-12/schema"
NAME = r"^[A-Za-z_][A-Za-z0-9_-]*$"
# joints and parameters are used in formulas, where '-' is a sign
NAME_IN_FORMULAS = r"^[A-Za-z_][A-Za-z0-9_]*$"
# names of the coordinates of joints with several, and the forms of an attitude
COORDINATE = r"^(q[wxyz]|[vw]?[xyz]|theta[12]?|d|xyz|rpy|quaternion|rotation_vector)$"
# a constant expression holds a digit or a constant, which catches most typing errors
EXPRESSION = {"type": "string", "pattern": r"[0-9]|\bpi\b|\be\b"}

Schema = dict[str, Any]


def json_schema(cls: type, title: str = "") -> Schema:
    """Return the schema of the dataclass ``cls``; nested sections are definitions of their own."""
    maker = _Maker()
    return {
        "$schema": DRAFT,
        **({"title": title} if title else {}),
        "$ref": maker.reference(cls),
        "$defs": dict(sorted(maker.definitions.items())),
    }


def _doc(cls: type) -> str:
    text = (cls.__doc__ or "").split("\n\n")[0]
    # a dataclass without words of its own is described by its signature
    return "" if text.startswith(f"{cls.__name__}(") else " ".join(text.replace("``", "`").split())


class _Maker:
    def __init__(self) -> None:
        self.definitions: dict[str, Schema] = {}

    def reference(self, cls: type, tag: tuple[str, str] | None = None, included: bool = False) -> str:
        """Return the reference of a section's definition, made on first use.

        Parameters
        ----------
        tag : key and value that tell the section from others. included : whether a file may complete it.
        """
        name = cls.__name__ + ("Included" if included else "")
        if name not in self.definitions:
            self.definitions[name] = {}  # sections may contain themselves
            self.definitions[name] = self.section(cls, tag, included)
        return f"#/$defs/{name}"

    def by_part(self, cls: type, parts: tuple[str, ...]) -> Schema:
        """Return a section, or a map of such sections."""
        one: Schema = {"$ref": self.reference(cls)}
        if not parts:
            return one
        each = {"type": "object", "properties": dict.fromkeys(parts, one), "additionalProperties": False}
        return {"anyOf": [one, each]}

    def section(self, cls: type, tag: tuple[str, str] | None, included: bool) -> Schema:
        properties: Schema = {}
        required = []
        for field in dataclasses.fields(cls):
            kind = field.metadata.get("kind")
            if isinstance(kind, kinds.Inline):
                for key, element in kind.registry().items():
                    properties[key] = {**self.by_part(element, kind.parts), "description": _doc(element)}
            elif kind is not None:
                properties[kinds.key_name(field)] = self.field(field)
                no_default = field.default is dataclasses.MISSING
                if no_default and field.default_factory is dataclasses.MISSING:
                    required.append(kinds.key_name(field))
        if tag:
            properties[tag[0]] = {"const": tag[1]}
        if included:
            properties[kinds.INCLUDE] = {
                "type": "string",
                "description": "Path of a file whose keys are taken over.",
            }
            if kinds.ATTACH in properties:
                for name in ("joints", "links"):
                    by_name = {"type": "object", "additionalProperties": {"type": "object"}}
                    words = {
                        "description": f"{properties[name]['description']} Or changes of the file's, by name."
                    }
                    properties[name] = {"anyOf": [properties[name], by_name]} | words
                properties[kinds.PREFIX] = {
                    "type": "string",
                    "description": "Prefix of all names of the file.",
                }
            required = [kinds.INCLUDE]
        schema: Schema = {"type": "object", "properties": properties, "additionalProperties": False}
        if _doc(cls):
            schema["description"] = _doc(cls)
        if required:
            schema["required"] = required
        return schema

    def field(self, field: dataclasses.Field[Any]) -> Schema:
        """Return the schema of one key with its words, unit and default."""
        unit, doc = field.metadata["unit"], field.metadata["doc"]
        kind = field.metadata["kind"]
        schema = dict(self.kind(kind))
        if field.default is None:
            schema = {"anyOf": [schema, {"type": "null"}]}
        allowed = describe(kind, unit)
        schema["description"] = f"{doc} {allowed[0].upper()}{allowed[1:]}.".strip()
        if isinstance(field.default, (bool, int, float, str)) and field.default != "":
            schema["default"] = field.default
        elif isinstance(field.default, tuple) and all(isinstance(x, (int, float)) for x in field.default):
            schema["default"] = list(field.default)
        return schema

    # -- kinds ----------------------------------------------------------------------------------------
    def kind(self, kind: kinds.Kind) -> Schema:
        if isinstance(kind, (kinds.Number, kinds.Integer)):
            return self.number(kind)
        if isinstance(kind, (kinds.Boolean, kinds.Text, kinds.CsvFile, kinds.MeshFile)):
            return {"type": "boolean" if isinstance(kind, kinds.Boolean) else "string"}
        if isinstance(kind, kinds.Name):
            return {"type": ["string", "boolean"], "pattern": _name_pattern(kind.of)}
        if isinstance(kind, kinds.Choice):
            return {"enum": list(kind.options)}
        if isinstance(kind, kinds.Vector):
            size = {"minItems": kind.size, "maxItems": kind.size} if kind.size else {}
            return {"type": "array", "items": self.number(kinds.Number()), **size}
        if isinstance(kind, kinds.Formula):
            return {"type": ["number", "string"]}
        if isinstance(kind, kinds.Criteria):
            value = {"type": ["number", "string", "boolean", "null", "object"]}
            return {**_few(kind), "additionalProperties": value}
        if isinstance(kind, kinds.Variations):
            return {**_few(kind), "additionalProperties": {"type": ["string", "array"]}}
        if isinstance(kind, kinds.Settings):
            return _few(kind)
        return self.composite(kind)

    def composite(self, kind: kinds.Kind) -> Schema:
        if isinstance(kind, kinds.ListOf):
            most = {"maxItems": kind.maximum} if kind.maximum is not None else {}
            least = {"minItems": kind.minimum} if kind.minimum else {}
            return {"type": "array", "items": self.kind(kind.item), **least, **most}
        if isinstance(kind, kinds.JointMap):
            item = self.kind(kind.item)
            several = {"type": "array", "items": item, "minItems": 2}
            by_name = {
                "type": "object",
                "propertyNames": {"pattern": COORDINATE},
                "additionalProperties": {"anyOf": [item, several]},
            }
            return {
                **_few(kind),
                "propertyNames": {"pattern": _name_pattern(kind.of)},
                "additionalProperties": {"anyOf": [item, several, by_name]},
            }
        if isinstance(kind, kinds.MapOf):
            return {
                **_few(kind),
                "propertyNames": {"pattern": _name_pattern(kind.of)},
                "additionalProperties": self.kind(kind.item),
            }
        if isinstance(kind, kinds.Section):
            return {"$ref": self.reference(kind.cls)}
        if isinstance(kind, kinds.Tagged):
            return self.tagged(kind)
        if isinstance(kind, kinds.Either):
            return {"anyOf": [self.kind(one) for one in kind.kinds]}
        if isinstance(kind, kinds.OrFile):
            formats = "YAML, URDF, SDF or MJCF" if kind.robot else "YAML or CSV" if kind.catalogue else "YAML"
            path = {"type": "string", "description": f"Path of a {formats} file, relative to this one."}
            return {"anyOf": [self.kind(kind.item), path, self.including(kind.item)]}
        raise TypeError(f"no JSON Schema of {type(kind).__name__}")

    def number(self, kind: kinds.Number | kinds.Integer) -> Schema:
        schema: Schema = {"type": "integer" if isinstance(kind, kinds.Integer) else "number"}
        strict = isinstance(kind, kinds.Number) and kind.exclusive
        if kind.minimum is not None:
            schema["exclusiveMinimum" if strict else "minimum"] = kind.minimum
        if kind.maximum is not None:
            schema["exclusiveMaximum" if strict else "maximum"] = kind.maximum
        return {"anyOf": [schema, EXPRESSION]}

    def tagged(self, kind: kinds.Tagged) -> Schema:
        """Return one branch per type; with ``if`` and ``then``, an editor reports errors for the given type only."""
        registry = kind.registry()
        branches = [
            {
                "if": {"properties": {kind.tag: {"const": name}}},
                "then": {"$ref": self.reference(cls, (kind.tag, name))},
            }
            for name, cls in registry.items()
        ]
        return {
            "type": "object",
            "properties": {kind.tag: {"enum": list(registry)}},
            "required": [kind.tag],
            "allOf": branches,
        }

    def including(self, kind: kinds.Kind) -> Schema:
        """Return the schema of a map that completes an included file."""
        if isinstance(kind, kinds.Section):
            return {"$ref": self.reference(kind.cls, included=True)}
        return {
            "type": "object",
            "properties": {kinds.INCLUDE: {"type": "string"}},
            "required": [kinds.INCLUDE],
        }


def _few(kind: kinds.Collection) -> Schema:
    """Return the type of a map, which may be left empty or null where no entry is needed."""
    if kind.minimum:
        return {"type": "object", "minProperties": kind.minimum}
    return {"type": ["object", "null"]}


def _name_pattern(of: str) -> str:
    return NAME_IN_FORMULAS if of in ("joint", "parameter") else NAME
