"""The numbers of a scene with their places, by which compiled code finds them in its table."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection, Sequence
from typing import Any

from robodyn_cli.expr.fixed import Fixed, free, is_free, literal
from robodyn_cli.expr.formula import FormulaTree
from robodyn_cli.expr.formula_tree import FormulaNode, Num
from robodyn_cli.scene.types import Orientation, Scene
from robodyn_cli.schema.fields import Direction, Inline, Vector, key_name

# what enters the equations; durations, tolerances, starts and trajectories are read by programs that run once
SECTIONS = (
    "robot", "gravity", "parameters", "loops", "forces", "payloads", "couplers", "torques", "drives",
    "prescribed",
)  # fmt: skip
_ORIENTATION = frozenset(field.name for field in dataclasses.fields(Orientation))


def with_places(scene: Scene) -> Scene:
    """Return the scene with every number that enters the equations as a ``Fixed`` at its key.

    Keys are those of ``--set``, such as ``robot.links.link1.mass``; the numbers of a formula are counted behind its
    key. Zeros, directions, attitudes, and values that are what a key has by default, are structure.
    """
    sections = {name: _placed(getattr(scene, name), name) for name in SECTIONS}
    if scene.drives:
        sections["catalogue"] = _placed(scene.catalogue.used_by(scene.drives.values()), "catalogue")
    if scene.control is not None:
        numbers = {
            name: _placed(getattr(scene.control, name), f"control.{name}") for name in scene.control.numbers
        }
        sections["control"] = dataclasses.replace(scene.control, **numbers)
    return dataclasses.replace(scene, **sections)


def placed(value: Any, place: str) -> Any:
    """Return a record of the scene with its numbers as ``Fixed`` at their keys below ``place``."""
    return _placed(value, place)


def with_free(scene: Scene, places: Collection[str]) -> Scene:
    """Return the scene with the values at some places as numbers that are no structure, as ``with_places`` leaves it.

    Zeros, defaults and angles of attitudes can be such numbers; places that have none are passed over.
    """
    sections = {place.partition(".")[0] for place in places} & set(SECTIONS)
    freed = {name: _freed(getattr(scene, name), name, frozenset(places)) for name in sections}
    return dataclasses.replace(scene, **freed)


def free_places(scene: Scene) -> frozenset[str]:
    """Return the places of the numbers of a scene that ``with_free`` made so."""
    return frozenset(place for place, x in _literals(scene).items() if is_free(x))


def _freed(value: Any, place: str, places: frozenset[str]) -> Any:
    """Return a value of the scene with the numbers at some places inside it free."""
    if isinstance(value, float):
        return free(value, place) if place in places else value
    if isinstance(value, FormulaTree):
        inside = any(wanted.startswith(f"{place}#") for wanted in places)
        return _formula(value, place, lambda x, at: free(x, at) if at in places else x) if inside else value
    if isinstance(value, tuple) and len(value) == 2 and isinstance(value[0], str):  # an element by its kind
        return value[0], _freed(value[1], f"{place.rpartition('.')[0]}.{value[0]}", places)
    if not any(wanted.startswith((f"{place}.", f"{place}#")) for wanted in places):
        return value
    if isinstance(value, dict):
        return {name: _freed(x, f"{place}.{name}", places) for name, x in value.items()}
    if isinstance(value, tuple):
        return tuple(_freed(x, f"{place}.{getattr(x, 'name', k)}", places) for k, x in enumerate(value))
    if not dataclasses.is_dataclass(value) or isinstance(value, type):
        return value
    changed = {}
    for field in dataclasses.fields(value):
        own = getattr(value, field.name)
        new = _freed(own, _below(place, field), places)
        if new is not own:
            changed[field.name] = new
    return dataclasses.replace(value, **changed) if changed else value


def place_is_in(place: str, key: str) -> bool:
    """Tell whether a place is that of a key, or below it."""
    return place == key or place.startswith((f"{key}.", f"{key}#"))


def with_own_places(scene: Scene, keys: Sequence[str], prefix: str) -> Scene:
    """Return the scene with numbers at some keys as ``Fixed`` at places behind a prefix.

    So a model with another mass has a number of its own there, even where both masses happen to be equal.
    """

    def own(value: float, place: str) -> float:
        inside = any(place_is_in(place, name) for name in keys)
        return literal(value, f"{prefix}.{place}") if inside else value

    return dataclasses.replace(scene, **{name: _placed(getattr(scene, name), name, own) for name in SECTIONS})


def numbers_at_places(scene: Scene) -> dict[str, float]:
    """Return the numbers of a scene that enter the equations, by their places."""
    return {place: float(x) for place, x in _literals(with_places(scene)).items()}


def _literals(placed: Scene) -> dict[str, Fixed]:
    """Return the numbers of a scene that have places."""
    found: dict[str, Fixed] = {}

    def visit(value: Any) -> None:
        if isinstance(value, Fixed):
            found[value.args[0]] = value
        elif isinstance(value, FormulaTree):
            value.root.rebuilt(leaf)
        elif isinstance(value, dict):
            for x in value.values():
                visit(x)
        elif isinstance(value, tuple):
            for x in value:
                visit(x)
        elif dataclasses.is_dataclass(value):
            for field in dataclasses.fields(value):
                visit(getattr(value, field.name))

    def leaf(node: FormulaNode) -> FormulaNode:
        if isinstance(node, Num):
            visit(node.number)
        return node

    for name in SECTIONS:
        visit(getattr(placed, name))
    for name in placed.control.numbers if placed.control is not None else ():
        visit(getattr(placed.control, name))
    return found


def _placed(value: Any, place: str, number: Callable[[float, str], float] = literal) -> Any:
    """Return a value with its numbers as ``number`` gives them for their places."""
    if isinstance(value, float):
        return value if isinstance(value, Fixed) else number(value, place)
    if isinstance(value, FormulaTree):
        return _formula(value, place, number)
    if isinstance(value, dict):
        return {name: _placed(x, f"{place}.{name}", number) for name, x in value.items()}
    if isinstance(value, tuple):
        if len(value) == 2 and isinstance(value[0], str) and dataclasses.is_dataclass(value[1]):
            return value[0], _placed(value[1], f"{place.rpartition('.')[0]}.{value[0]}", number)
        return tuple(_placed(x, f"{place}.{getattr(x, 'name', k)}", number) for k, x in enumerate(value))
    if dataclasses.is_dataclass(value):
        return _record(value, place, number)
    return value


def _record(value: Any, place: str, number: Callable[[float, str], float]) -> Any:
    changed = {}
    for field in dataclasses.fields(value):
        own = getattr(value, field.name)
        turns = isinstance(value, Orientation) and field.name in _ORIENTATION
        if turns or _is_attitude(field):
            continue
        if (
            own is None
            or isinstance(own, (str, bool, int))
            or (isinstance(own, float) and own == field.default)
        ):
            continue
        new = _placed(own, _below(place, field), number)
        if new is not own:
            changed[field.name] = new
    return dataclasses.replace(value, **changed) if changed else value


def _below(place: str, field: dataclasses.Field[Any]) -> str:
    """Return the place of a field; its elements are keys of the record itself where it holds them by their kinds."""
    return place if isinstance(field.metadata.get("kind"), Inline) else f"{place}.{key_name(field)}"


def _is_attitude(field: dataclasses.Field[Any]) -> bool:
    """Tell whether a key is a direction or a list of angles."""
    kind = field.metadata.get("kind")
    return isinstance(kind, Direction) or (isinstance(kind, Vector) and field.metadata["unit"] == "rad")


def _formula(formula: FormulaTree, place: str, number: Callable[[float, str], float]) -> FormulaTree:
    count = 0

    def leaf(node: FormulaNode) -> FormulaNode:
        nonlocal count
        if not isinstance(node, Num):
            return node
        count += 1
        if isinstance(node.number, Fixed):
            return node
        return Num(number(node.number, f"{place}#{count}"))

    return dataclasses.replace(formula, root=formula.root.rebuilt(leaf))
