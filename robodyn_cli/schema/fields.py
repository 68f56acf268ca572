"""The YAML keys of a scene: one frozen dataclass per section, one ``key()`` per field; and in words what each allows.

The same description serves the reader (``scene/read.py``), the error messages and the reference in
``docs/scene.md``. Kinds carry no behaviour: the reader dispatches on them.
"""

from __future__ import annotations

import dataclasses
import importlib
from collections.abc import Callable, Mapping
from typing import Any

from robodyn_cli.errors import plural_of
from robodyn_cli.record import record
from robodyn_cli.summaries.facts import of_angle

REQUIRED: Any = dataclasses.MISSING
# keys that compose files (see ``OrFile``)
INCLUDE, PREFIX, ATTACH = "include", "prefix", "attach"


@record
class Kind:
    """Base of the kinds of value that a key can hold."""


@record
class Number(Kind):
    """A finite number; text such as ``"pi/2"`` or ``-90 deg`` is a constant expression, with units of the key's kind.

    ``minimum``/``maximum`` are inclusive unless ``exclusive``.
    """

    minimum: float | None = None
    maximum: float | None = None
    exclusive: bool = False


@record
class Integer(Kind):
    minimum: int | None = None
    maximum: int | None = None


@record
class Boolean(Kind):
    pass


@record
class Text(Kind):
    pass


@record
class Name(Kind):
    """An identifier ([A-Za-z_][A-Za-z0-9_-]*); ``of`` says what it names.

    Names of joints and parameters are used in formulas, where ``-`` is a sign, so they are made without it.
    """

    of: str = ""


@record
class Choice(Kind):
    options: tuple[str, ...] = ()


@record
class Vector(Kind):
    """A list of ``size`` numbers (``size`` 0: any length)."""

    size: int = 3


@record
class Direction(Vector):
    """A direction: a list of three numbers, not all zero, whose length does not matter."""


@record
class Formula(Kind):
    """A number or a formula over ``variables`` (of ``t``, ``q``, ``qd``) and the scene's parameters."""

    variables: tuple[str, ...] = ("t", "q", "qd")


@record
class Collection(Kind):
    """Lists and maps of at least ``minimum`` entries: 0 where they say what there is; empty ones ask for nothing."""

    minimum = 0


@record
class ListOf(Collection):
    item: Kind
    minimum: int = 1
    maximum: int | None = None


@record
class MapOf(Collection):
    """A map from names (``of`` says of what: joint, link, ...) to values."""

    item: Kind
    of: str = ""
    minimum: int = 1


@record
class JointMap(MapOf):
    """A map from joints to values: one ``item`` for a joint with one coordinate, a list or a map of them for others.

    coordinates : ``q`` or ``v``, whose columns the values are for. It is read as a flat map by column.
    word : may stand in place of all values of a joint, under whose name it is kept.
    """

    of: str = "joint"
    minimum: int = 0  # there may be no joint that moves
    coordinates: str = "q"
    word: str = ""


@record
class Criteria(Collection):
    """A map from key paths of a run's summary (``lock.time``) to what is expected there (``12.28 +- 0.01``)."""

    minimum: int = 1


@record
class Variations(Collection):
    """A map from key paths of the scene to what they vary over in a study (``normal(13, 5 %)``)."""

    minimum: int = 1


@record
class Settings(Collection):
    """A map from key paths of the scene to values, each of which is read as the text of ``--set`` (``0.8``)."""

    minimum: int = 1


@record
class Section(Kind):
    """A nested section described by another dataclass."""

    cls: type


class LaterSection(Section):
    """A section whose dataclass, at ``place`` as ``module:member``, is imported for scenes that have it alone.

    several : the key that takes a list of what this one takes one of.
    """

    place: str
    several: str

    def __init__(self, place: str, several: str = "") -> None:
        object.__setattr__(self, "place", place)
        object.__setattr__(self, "several", several)

    @property
    def cls(self) -> type:
        """The dataclass."""
        module, _, member = self.place.partition(":")
        cls: type = getattr(importlib.import_module(f"robodyn_cli.{module}"), member)
        return cls


@record
class Tagged(Kind):
    """A section whose dataclass is chosen by the value of its ``type`` key, from a registry."""

    registry: Callable[[], Mapping[str, type]]
    tag: str = "type"


@record
class Either(Kind):
    """The first of several kinds that fits the shape of the YAML node: scalar, list or map."""

    kinds: tuple[Kind, ...] = ()


@record
class ByPart(Kind):
    """A section, or a map from ``parts`` to such sections: the coordinates of a joint."""

    item: Section
    parts: tuple[str, ...]


@record
class OrFile(Kind):
    """A value given in place or as the path of a YAML file, relative to the file that names it.

    A map with the key ``include`` takes over the keys of that file, but for those that it gives itself. ``robot`` : the
    file may be a URDF, an SDF or an MJCF too; beside ``include`` a ``prefix`` goes before all names, ``attach`` adds
    parts. catalogue : the file may be a CSV table too, with a line for each motor, gear and brake.
    """

    item: Kind
    robot: bool = False
    catalogue: bool = False


@record
class Inline(Kind):
    """Optional keys of the section itself, one for each registered class; the value holds (key, instance) pairs.

    parts : names of parts of the section; a key may hold a map from these to instances instead, which gives pairs with
    the keys ``key.part``.
    """

    registry: Callable[[], Mapping[str, type]]
    parts: tuple[str, ...] = ()

    def at(self, key: str) -> Kind:
        """Return what a key may hold."""
        section = Section(self.registry()[key])
        return ByPart(section, self.parts) if self.parts else section


@record
class CsvFile(Kind):
    """The path of a CSV or HDF5 file; the loader puts its header in the key ``columns`` and its data in ``rows``."""

    columns: str = "columns"
    rows: str = "rows"


@record
class MeshFile(Kind):
    """The path of a mesh; the loader puts what pictures need of it into the key ``text``, as OBJ."""

    text: str = "obj"


def key_name(field: dataclasses.Field[Any]) -> str:
    """Return the YAML key of a field."""
    name: str = field.metadata.get("name") or field.name
    return name


def key(kind: Kind, *, default: Any = REQUIRED, unit: str = "", doc: str = "", name: str = "") -> Any:
    """Declare one YAML key as a dataclass field.

    Parameters
    ----------
    kind : what values are allowed.
    default : value when the key is absent; without one the key is required. For a map ``None`` means empty.
    unit : SI unit, shown in errors and in the reference.
    doc : one sentence for the reference.
    name : of the key, where Python keeps the word for itself; by default the field's.
    """
    metadata = {"kind": kind, "unit": unit, "doc": doc, "name": name}
    if default is REQUIRED:
        return dataclasses.field(metadata=metadata)
    if default is None and any(
        isinstance(k, Collection) and not isinstance(k, ListOf) for k in getattr(kind, "kinds", (kind,))
    ):
        return dataclasses.field(default_factory=dict, metadata=metadata)
    return dataclasses.field(default=default, metadata=metadata)


DRIVE, LOAD = "drive", "load"
# what a force is in a margin of motorisation: what drives, and the kinds of resistance
ROLES = (DRIVE, "inertia", "spring", "magnetic", "friction", "hysteresis", "harness", "adhesion", LOAD)


def role_key(default: str) -> Any:
    """Declare the key of the role of a force in a margin of motorisation."""
    return key(Choice(ROLES), default=default, doc="Role in a margin of `motorisation`.")


def like(cls: type, name: str) -> Any:
    """Declare a key as another section has it."""
    field = next(field for field in dataclasses.fields(cls) if field.name == name)
    return dataclasses.field(default=field.default, metadata=field.metadata)


@record
class Orientation:
    """How a frame is turned in the frame around it, in one of five forms; without any it is not turned."""

    rpy: tuple[float, ...] | None = key(
        Vector(3), default=None, unit="rad", doc="Roll, pitch, yaw about fixed axes."
    )
    quaternion: tuple[float, ...] | None = key(
        Vector(4), default=None, unit="1", doc="Unit quaternion, scalar first."
    )
    axis: tuple[float, ...] | None = key(
        Direction(), default=None, unit="1", doc="Axis of one rotation, by `angle`."
    )
    angle: float | None = key(Number(), default=None, unit="rad", doc="Angle of the rotation about `axis`.")
    matrix: tuple[tuple[float, ...], ...] | None = key(
        ListOf(Vector(3), minimum=3, maximum=3),
        default=None,
        unit="1",
        doc="Rotation matrix by rows; its columns are the new axes.",
    )
    x: tuple[float, ...] | None = key(Direction(), default=None, unit="1", doc="Direction of the new x axis.")
    y: tuple[float, ...] | None = key(Direction(), default=None, unit="1", doc="Direction of the new y axis.")
    z: tuple[float, ...] | None = key(Direction(), default=None, unit="1", doc="Direction of the new z axis.")

    @property
    def plain(self) -> bool:
        """Whether it is given by roll, pitch and yaw, or not at all."""
        others = (self.quaternion, self.axis, self.angle, self.matrix, self.x, self.y, self.z)
        return all(value is None for value in others)


@record
class Placement(Orientation):
    """Position ``p = xyz`` and orientation of a frame."""

    xyz: tuple[float, ...] = key(Vector(3), default=(0.0, 0.0, 0.0), unit="m", doc="Origin.")


def describe(kind: Kind, unit: str = "") -> str:
    """Return what ``kind`` allows, such as ``a number > 0 [m]``."""
    return _plain(kind, of_angle(unit)) + (f" [{unit}]" if unit and unit != "1" else "")


def _plain(kind: Kind, turns: bool = False) -> str:
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
        angle = " or an angle such as '45 deg'" if isinstance(kind, Number) and turns else ""
        return " ".join([noun, " and ".join(bounds)]).strip() + angle
    if isinstance(kind, Name):
        return f"the name of a {kind.of}" if kind.of else "a name"
    if isinstance(kind, Choice):
        return ", ".join(kind.options)
    if isinstance(kind, Vector):
        count = f"{kind.size} numbers" if kind.size else "numbers"
        return f"a list of {count}" + (" or angles" if turns else "")
    if isinstance(kind, Formula):
        return f"a number or a formula in {', '.join(kind.variables)} and parameters"
    if isinstance(kind, (ListOf, MapOf)):
        return _collection(kind)
    if isinstance(kind, Tagged):
        return f"a map whose {kind.tag!r} is one of {', '.join(kind.registry())}"
    if isinstance(kind, Either):
        return ", or ".join(_plain(k, turns) for k in kind.kinds)
    if isinstance(kind, OrFile):
        other = ", URDF, SDF or MJCF" if kind.robot else " or CSV" if kind.catalogue else ""
        return f"{_plain(kind.item, turns)}, or the path of a YAML{other} file"
    if isinstance(kind, (Section, ByPart)):
        return "a map"
    if isinstance(kind, Inline):
        return f"the keys {', '.join(kind.registry())}"
    return _SAID.get(type(kind), "a value")


_SAID = {
    Boolean: "true or false",
    Text: "text",
    Criteria: "a map from keys of the summary to expected values",
    Variations: "a map from keys of the scene to values or distributions",
    Settings: "a map from keys of the scene to values",
    CsvFile: "the path of a CSV or HDF5 file",
    MeshFile: "the path of an STL, OBJ or DAE file",
}


def _bound(x: float) -> str:
    return str(x) if isinstance(x, int) else f"{x:g}"


def _collection(kind: ListOf | MapOf) -> str:
    nouns = {
        Section: "maps",
        Number: "numbers",
        Name: "names",
        Formula: "formulas",
        Text: "texts",
        JointMap: "maps from names of joints to numbers",
    }
    item = next((noun for cls, noun in nouns.items() if isinstance(kind.item, cls)), "values")
    if isinstance(kind, MapOf):
        return f"a map from names{f' of {plural_of(kind.of)}' if kind.of else ''} to {item}"
    if kind.minimum == kind.maximum and kind.minimum:
        return f"a list of {kind.minimum} {item}"
    if kind.maximum is not None:
        return f"a list of {kind.minimum} to {kind.maximum} {item}"
    return f"a list of {item}" + (f", at least {kind.minimum}" if kind.minimum > 1 else "")
