"""Describe in words the values that a kind allows, for error messages and for the reference."""

from __future__ import annotations

from robodyn_cli.schema.fields import (
    Boolean,
    Choice,
    Criteria,
    CsvFile,
    Either,
    Formula,
    Inline,
    Integer,
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


def describe(kind: Kind, unit: str = "") -> str:
    """Return what ``kind`` allows, such as ``a number > 0 [m]``."""
    return _plain(kind) + (f" [{unit}]" if unit and unit != "1" else "")


def _plain(kind: Kind) -> str:
    if isinstance(kind, (Number, Integer)):
        strict = isinstance(kind, Number) and kind.exclusive
        noun = "a whole number" if isinstance(kind, Integer) else "a number"
        if kind.minimum is not None and kind.minimum == kind.maximum:
            return f"{kind.minimum:g}"
        bounds = []
        if kind.minimum is not None:
            bounds.append(f"{'>' if strict else '>='} {_bound(kind.minimum)}")
        if kind.maximum is not None:
            bounds.append(f"{'<' if strict else '<='} {_bound(kind.maximum)}")
        angle = " or an angle such as '45 deg'" if isinstance(kind, Number) and kind.angle else ""
        return " ".join([noun, " and ".join(bounds)]).strip() + angle
    if isinstance(kind, Boolean):
        return "true or false"
    if isinstance(kind, Text):
        return "text"
    if isinstance(kind, Name):
        return f"the name of a {kind.of}" if kind.of else "a name"
    if isinstance(kind, Choice):
        return ", ".join(kind.options)
    if isinstance(kind, Vector):
        count = f"{kind.size} numbers" if kind.size else "numbers"
        return f"a list of {count}" + (" or angles" if kind.angle else "")
    if isinstance(kind, Formula):
        return f"a number or a formula in {', '.join(kind.variables)} and parameters"
    if isinstance(kind, (ListOf, MapOf)):
        return _collection(kind)
    if isinstance(kind, Tagged):
        return f"a map whose {kind.tag!r} is one of {', '.join(kind.registry())}"
    if isinstance(kind, Either):
        return ", or ".join(_plain(k) for k in kind.kinds)
    if isinstance(kind, OrFile):
        return f"{_plain(kind.item)}, or the path of a YAML{' or URDF' if kind.robot else ''} file"
    if isinstance(kind, Section):
        return "a map"
    if isinstance(kind, Inline):
        return f"the keys {', '.join(kind.registry())}"
    if isinstance(kind, Criteria):
        return "a map from keys of the summary to what is expected there"
    if isinstance(kind, CsvFile):
        return "the path of a CSV file"
    return "a value"


def _bound(x: float) -> str:
    return str(x) if isinstance(x, int) else f"{x:g}"


def _collection(kind: ListOf | MapOf) -> str:
    nouns = {Section: "maps", Number: "numbers", Name: "names", Formula: "formulas", Text: "texts"}
    item = next((noun for cls, noun in nouns.items() if isinstance(kind.item, cls)), "values")
    if isinstance(kind, MapOf):
        return f"a map from names{f' of {kind.of}s' if kind.of else ''} to {item}"
    if kind.minimum == kind.maximum and kind.minimum:
        return f"a list of {kind.minimum} {item}"
    if kind.maximum is not None:
        return f"a list of {kind.minimum} to {kind.maximum} {item}"
    return f"a list of {item}" + (f", at least {kind.minimum}" if kind.minimum else "")
