"""What keys that vary between runs are to a scene: numbers of its table, its start, options, or structure."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from robodyn_cli.errors import SceneError
from robodyn_cli.expr.fixed import Fixed
from robodyn_cli.expr.formula import FormulaTree
from robodyn_cli.expr.formula_tree import Num
from robodyn_cli.model.model import Model
from robodyn_cli.model.places import with_places
from robodyn_cli.record import record
from robodyn_cli.scene.load import Family
from robodyn_cli.scene.text.overrides import AskedSetting
from robodyn_cli.scene.types import Scene
from robodyn_cli.scene.units import in_joint, named_place, unit_of, written_number
from robodyn_cli.spatial.algebra import Array

NO_VALUE = "it has no value in the scene; give it one by --set"
NUMBER, START, OPTION, STRUCTURE = "number", "start", "option", "structure"
OPTIONS = ("duration",)
# values that a key is tried with until two are allowed, to see what they change
TRIED = (0.8137, 1.2871, 0.1019, 0.0123, 7.31, 113.7, -0.8137, -1.2871, 1013.0, 1e5, 3.0, 5.0, -7.31, -113.7)
UNREAD = frozenset(
    {"text", "sources", "expect", "study", "search", "title"}
)  # what equations do not know of a scene
PROPORTIONAL = 1e-15  # roundings of units, as those of 500 mm
MOST_KNOWN = 10_000  # values that are known to be allowed, one by one
CORNERS = 6  # keys of one element whose extremes are checked together; more: run by run


@record
class Key:
    """A key that varies, and what it is.

    place : of its number in the scene, the column of a start, the name of an option, or of structure the key with
    names of items. special : values that are
    structure, because a key that is zero, or what it is by default, leaves terms out. scale : times its values is what
    stands at the place; other than 1 of ``KEY#n`` with a unit or a sign. element : checked together.
    """

    name: str
    sort: str
    place: str = ""
    special: tuple[float, ...] = ()
    scale: float = 1.0

    @property
    def element(self) -> str:
        named = self.place if self.sort in (NUMBER, STRUCTURE) else self.name
        return named.rpartition(".")[0]


def setting(key: str, value: float, asked: str = "") -> str:
    """Return the option of ``--set`` that gives a key a value; it reads back as the same number.

    asked : what errors about it name, where another option asks for the key.
    """
    whole = value.is_integer() and abs(value) < 2**53
    text = f"{key}={int(value)}" if whole else f"{key}={value!r}"
    return AskedSetting(text, asked) if asked else text


def settings(keys: Sequence[str], values: Iterable[float], asked: str = "") -> list[str]:
    """Return the options of ``--set`` that give keys their values, as of ``setting``."""
    return [setting(key, float(x), asked) for key, x in zip(keys, values)]


def understand(family: Family, name: str, asked: str = "") -> Key:
    """Return what a key is, from what changes in the scene with it; asked : as of ``setting``.

    Raises
    ------
    SceneError : the scene has no such key, or it takes no numbers.
    """
    return _found(family, name, asked)[0]


def _found(family: Family, name: str, asked: str) -> tuple[Key, float | None]:
    """Return what a key is, and its value in the scene as it stands; looked for once in a family."""
    known = family.found.get(name)
    if known is None:
        known = family.found[name] = _tried(family, name, asked)
    return known


def _tried(family: Family, name: str, asked: str) -> tuple[Key, float | None]:
    scenes: list[tuple[float, Scene]] = []
    refused: SceneError | None = None
    for value in TRIED:
        try:
            scenes.append((value, with_places(family.scene([setting(name, value, asked)]))))
        except SceneError as error:
            refused = refused or error
        if len(scenes) == 2:
            break
    if not scenes:
        assert refused is not None
        raise refused
    # one alone is allowed of whole numbers, or in a narrow range
    key = _sort(name, scenes) if len(scenes) == 2 else None
    return key or Key(name, STRUCTURE, named_place(family.root, name)), _own_value(family, *scenes[0])


def value_of(family: Family, name: str, asked: str = "") -> float | None:
    """Return the number that a key has in the scene as it stands, in SI units; None where it has none.

    Of ``KEY#n`` it is the number as it is written. asked : as of ``setting``.

    Raises
    ------
    SceneError : the scene has no such key, or it takes no numbers.
    """
    if (written := written_number(family.root, name)) is not None:
        return written.value
    return _found(family, name, asked)[1]


def _own_value(family: Family, value: float, other: Scene) -> float | None:
    """Return the number of a key in the scene as it stands, beside the scene in which it has another value."""
    changes = list(_differences(with_places(family.own), other, (), None))
    if not changes:  # it has this very value
        return value
    numbers = [c.one for c in changes if isinstance(c.two, (int, float)) and float(c.two) == value]
    return float(numbers[0]) if numbers and isinstance(numbers[0], (int, float)) else None


def _sort(name: str, scenes: Sequence[tuple[float, Scene]]) -> Key | None:
    """Return what a key is, from scenes with two values of it, whose numbers know their places; None of structure."""
    (x, one), (y, two) = scenes
    changes = list(_differences(one, two, (), None))
    scale = _scale(changes[0], x, y) if len(changes) == 1 else None
    if scale is None:
        return None
    change = changes[0]
    if isinstance(change.one, Fixed) and change.one.op == "literal":
        special = (0.0,) if change.default is None else (0.0, change.default / scale)
        return Key(name, NUMBER, change.one.args[0], special, scale)
    if change.path[:2] in (("initial", "q"), ("initial", "qd")):
        return Key(name, START, ".".join(change.path[1:]), (), scale)
    if change.path[0] == "simulate" and change.path[-1] in OPTIONS:
        return Key(name, OPTION, change.path[-1], (), scale)
    return None


def _scale(change: _Change, x: float, y: float) -> float | None:
    """Return what a value is multiplied by, of which x and y make a leaf what it is; None where that is not so."""
    one, two = change.one, change.two
    if not isinstance(one, (int, float)) or not isinstance(two, (int, float)) or not one:
        return None
    scale = float(one) / x
    return scale if abs(float(two) - scale * y) <= PROPORTIONAL * abs(scale * y) else None


@record
class _Change:
    """Two values of one leaf of a scene; path : of names; default : of its key, where that is a number."""

    path: tuple[str, ...]
    one: Any
    two: Any
    default: float | None


def _differences(one: Any, two: Any, path: tuple[str, ...], default: Any) -> Iterator[_Change]:
    """Yield the leaves in which two values of one shape differ."""
    if one is two or (not isinstance(one, Fixed) and _same(one, two)):
        return
    parts, others = _parts(one), _parts(two)
    if parts is None or others is None or [k for k, _, _ in parts] != [k for k, _, _ in others]:
        yield _Change(path, one, two, default if isinstance(default, float) else None)
        return
    for (name, a, own), (_, b, _) in zip(parts, others):
        yield from _differences(a, b, (*path, name), own)


def _same(one: Any, two: Any) -> bool:
    return type(one) is type(two) and bool(
        isinstance(one, (str, int, bool, float, type(None))) and one == two
    )


def _parts(x: Any) -> list[tuple[str, Any, Any]] | None:
    """Return the parts of a value, (name, part, default); None where it has none."""
    if isinstance(x, FormulaTree) and isinstance(x.root, Num):
        return [("", x.root.number, None)]
    if isinstance(x, FormulaTree):
        return [("", x.root, None)]
    if dataclasses.is_dataclass(x):
        return [
            (f.name, getattr(x, f.name), f.default) for f in dataclasses.fields(x) if f.name not in UNREAD
        ]
    if isinstance(x, Mapping):
        return [(str(name), part, None) for name, part in x.items()]
    if isinstance(x, (tuple, list)):
        return [(str(k), part, None) for k, part in enumerate(x)]
    return None


class Allowed:
    """What values a scene allows its keys.

    What a scene asks of numbers (bounds, an order, a sum) holds between two values where it holds at both, and links
    keys of one element alone. So scenes are read with the extremes of each element, of all elements at once where that
    is allowed, and every row where one is refused. Each value is read of keys that are structure: whole numbers, say,
    are none between two of them. asked : as of ``setting``.
    """

    def __init__(self, family: Family, keys: Sequence[Key], asked: str = "") -> None:
        self.family, self.keys, self.asked = family, keys, asked
        self.names = [key.name for key in keys]
        self._low, self._high = np.full(len(keys), np.inf), np.full(len(keys), -np.inf)  # known to be allowed
        self._each: set[tuple[int, float]] = set()  # the same of keys that are structure

    def refusals(self, values: Array) -> dict[int, SceneError]:
        """Return the rows of values (N, keys) that the scene does not allow, with the errors."""
        refused: dict[int, SceneError] = {}
        if self._box_holds(values):
            return refused
        for k, row in enumerate(values):
            if (error := self._refusal(row)) is not None:
                refused[k] = error
        return refused

    def _box_holds(self, values: Array) -> bool:
        """Tell whether all values between the extremes are allowed, as far as that can be told at once."""
        inside = ((self._low <= values) & (values <= self._high)).all()
        if not inside and not np.isfinite(values).all():
            return False
        if not self._each_is_allowed(values):
            return False
        if inside:
            return True
        low = np.minimum(values.min(axis=0, initial=np.inf), self._low)
        high = np.maximum(values.max(axis=0, initial=-np.inf), self._high)
        elements: dict[str, list[int]] = {}
        for k, key in enumerate(self.keys):
            elements.setdefault(key.element, []).append(k)
        if any(len(columns) > CORNERS for columns in elements.values()):
            return False
        # refused with all elements at once, a scene may allow each of them
        if not self._corners_hold(values[0], [list(elements.values())], low, high) and not self._corners_hold(
            values[0], [[columns] for columns in elements.values()], low, high
        ):
            return False
        self._low, self._high = low, high
        return True

    def _corners_hold(
        self, row: Array, groups: Iterable[Sequence[Sequence[int]]], low: Array, high: Array
    ) -> bool:
        """Tell whether a row is allowed with the extremes of elements, given by their columns: of all in a group at
        once."""
        read: set[bytes] = set()  # elements whose keys do not vary have the same rows
        for elements in groups:
            corners = [list(itertools.product(*zip(low[own], high[own]))) for own in elements]
            for n in range(max(map(len, corners), default=0)):
                there = row.copy()
                for columns, own in zip(elements, corners):
                    there[columns] = own[n % len(own)]
                if there.tobytes() not in read and self._refusal(there) is not None:
                    return False
                read.add(there.tobytes())
        return True

    def _each_is_allowed(self, values: Array) -> bool:
        """Tell whether all values of keys that are structure are allowed."""
        for k, key in enumerate(self.keys):
            if key.sort != STRUCTURE:
                continue
            for x in np.unique(values[:, k]).tolist():
                if (k, x) in self._each:
                    continue
                row = values[0].copy()
                row[k] = x
                if self._refusal(row) is not None:
                    return False
                if len(self._each) < MOST_KNOWN:
                    self._each.add((k, x))
        return True

    def _refusal(self, row: Array) -> SceneError | None:
        try:
            self.family.scene(settings(self.names, row, self.asked))
        except SceneError as error:
            return error
        return None


def key_unit(family: Family, key: Key, model: Model) -> str:
    """Return the unit of a key; nothing where it is not known."""
    written = written_number(family.root, key.name)
    if key.sort == START and written is not None and written.inside:
        return written.unit
    if key.sort == START:
        group, _, column = key.place.partition(".")
        names, units, rate = (
            (model.q_names, model.q_units, "") if group == "q" else (model.v_names, model.v_units, "/s")
        )
        return units[names.index(column)] + rate
    scene, named = family.own, named_place(family.root, key.name)
    driven = scene.control.joints if scene.control is not None and named.startswith("control.") else ()
    return in_joint(unit_of(family.root, key.name), named, dict(zip(model.v_names, model.v_units)), driven)
