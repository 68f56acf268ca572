"""Describe in words the values that a kind allows, for error messages and for the reference."""

from __future__ import annotations

from robodyn_cli.schema import fields as kinds


def describe(kind: kinds.Kind, unit: str = "") -> str:
    """Return what ``kind`` allows, such as ``a number > 0 [m]``."""
    return _plain(kind) + (f" [{unit}]" if unit and unit != "1" else "")


def _plain(kind: kinds.Kind) -> str:
    if isinstance(kind, (kinds.Number, kinds.Integer)):
        strict = isinstance(kind, kinds.Number) and kind.exclusive
        noun = "a whole number" if isinstance(kind, kinds.Integer) else "a number"
        if kind.minimum is not None and kind.minimum == kind.maximum:
            return f"{kind.minimum:g}"
        bounds = []
        if kind.minimum is not None:
            bounds.append(f"{'>' if strict else '>='} {_bound(kind.minimum)}")
        if kind.maximum is not None:
            bounds.append(f"{'<' if strict else '<='} {_bound(kind.maximum)}")
        angle = " or an angle such as '45 deg'" if isinstance(kind, kinds.Number) and kind.angle else ""
        return " ".join([noun, " and ".join(bounds)]).strip() + angle
    if isinstance(kind, kinds.Boolean):
        return "true or false"
    if isinstance(kind, kinds.Text):
        return "text"
    if isinstance(kind, kinds.Name):
        return f"the name of a {kind.of}" if kind.of else "a name"
    if isinstance(kind, kinds.Choice):
        return ", ".join(kind.options)
    if isinstance(kind, kinds.Vector):
        count = f"{kind.size} numbers" if kind.size else "numbers"
        return f"a list of {count}" + (" or angles" if kind.angle else "")
    if isinstance(kind, kinds.Formula):
        return f"a number or a formula in {', '.join(kind.variables)} and parameters"
    if isinstance(kind, (kinds.ListOf, kinds.MapOf)):
        return _collection(kind)
    if isinstance(kind, kinds.Tagged):
        return f"a map whose {kind.tag!r} is one of {', '.join(kind.registry())}"
    if isinstance(kind, kinds.Either):
        return ", or ".join(_plain(k) for k in kind.kinds)
    if isinstance(kind, kinds.OrFile):
        other = " or URDF" if kind.robot else " or CSV" if kind.catalogue else ""
        return f"{_plain(kind.item)}, or the path of a YAML{other} file"
    if isinstance(kind, (kinds.Section, kinds.ByPart)):
        return "a map"
    if isinstance(kind, kinds.Inline):
        return f"the keys {', '.join(kind.registry())}"
    if isinstance(kind, kinds.Criteria):
        return "a map from keys of the summary to expected values"
    if isinstance(kind, kinds.Variations):
        return "a map from keys of the scene to values or distributions"
    if isinstance(kind, kinds.Settings):
        return "a map from keys of the scene to values"
    if isinstance(kind, kinds.CsvFile):
        return "the path of a CSV or HDF5 file"
    if isinstance(kind, kinds.MeshFile):
        return "the path of an STL, OBJ or DAE file"
    return "a value"


def _bound(x: float) -> str:
    return str(x) if isinstance(x, int) else f"{x:g}"


def _collection(kind: kinds.ListOf | kinds.MapOf) -> str:
    nouns = {
        kinds.Section: "maps",
        kinds.Number: "numbers",
        kinds.Name: "names",
        kinds.Formula: "formulas",
        kinds.Text: "texts",
        kinds.JointMap: "maps from names of joints to numbers",
    }
    item = next((noun for cls, noun in nouns.items() if isinstance(kind.item, cls)), "values")
    if isinstance(kind, kinds.MapOf):
        return f"a map from names{f' of {kind.of}s' if kind.of else ''} to {item}"
    if kind.minimum == kind.maximum and kind.minimum:
        return f"a list of {kind.minimum} {item}"
    if kind.maximum is not None:
        return f"a list of {kind.minimum} to {kind.maximum} {item}"
    return f"a list of {item}" + (f", at least {kind.minimum}" if kind.minimum else "")
