"""What a key of a scene is: its node, its unit, its place, and the number that ``KEY#n`` is."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from collections.abc import Mapping as TypingMapping

from robodyn_cli.errors import of_option
from robodyn_cli.scene.text.includes import child_kind, concrete
from robodyn_cli.scene.text.nodes import Mapping, Node, Path, Sequence, dotted, index_of, name_of
from robodyn_cli.scene.text.numbers import WrittenNumber, at_key, counted, number_at
from robodyn_cli.scene.types import Scene
from robodyn_cli.schema.fields import Inline, Kind, Section, key_name
from robodyn_cli.summaries.facts import for_coordinate


def unit_of(root: Node, key: str) -> str:
    """Return the unit that the description of a scene's keys gives to ``robot.links.link1.mass``; "" if none.

    root : tree of the scene, with the files that it includes. Of ``KEY#n`` it is that of the number as it is written;
    numbers of a formula have none that is known.
    """
    written = written_number(root, key)
    if written is not None:
        if written.inside:
            return written.unit
        key = ".".join((counted(key)[0], *map(str, written.path)))
    kind: Kind | None = Section(Scene)
    node: Node | None = root
    unit = ""
    for step in key.split("."):
        kind = concrete(kind, node) if kind is not None and node is not None else kind
        if isinstance(kind, Section):
            unit = _unit(kind.cls, step)
        kind = child_kind(kind, step)
        node = _child(node, step)
    return unit


def in_joint(unit: str, key: str, joint_units: TypingMapping[str, str], driven: Iterable[str] = ()) -> str:
    """Return the unit of a key, of two such as ``N m/rad or N/m`` the one of the joint that the key names.

    joint_units : ``rad`` or ``m`` by joint. driven : joints that a key is for where it names none. The unit is left as
    it is where the joints differ, or none is known.
    """
    *path, last = key.split(".")
    columns = unit.split(", ")
    if len(columns) == 2 and last in ("0", "1"):  # of rows of a table
        unit = columns[int(last)]
    named = [joint_units[step] for step in (*path, last) if step in joint_units]
    of = set(named or [joint_units[name] for name in driven if name in joint_units])
    return for_coordinate(unit, of.pop()) if len(of) == 1 else unit


def place_of(root: Node, key: str) -> Path:
    """Return the steps of a key, items of lists by their number, and where in a formula a number stands: one place has
    one, however the key is written."""
    base, _ = counted(key)
    path = at_key(root, Section(Scene), base)[2]
    written = written_number(root, key)
    if written is None:
        return path
    return (*path, *written.path, *((f"#{written.start}",) if written.inside else ()))


def named_place(root: Node, key: str) -> str:
    """Return a key with the items of lists by their names where they have some, as numbers of a scene are placed."""
    node: Node | None = root
    steps = []
    for step in place_of(root, key):
        below = _child(node, str(step))
        name = name_of(below) if isinstance(node, Sequence) and below is not None else ""
        steps.append(name or step)
        node = below
    return dotted(tuple(steps))


def written_number(root: Node, key: str) -> WrittenNumber | None:
    """Return the number that ``KEY#n`` is; None of other keys, and where there is none."""
    base, n = counted(key)
    if not n:
        return None
    node, kind, _ = at_key(root, Section(Scene), base)
    return number_at(node, kind, n)


def node_at(root: Node, key: str) -> Node | None:
    """Return the node of the scene's tree that a key names, None where the scene has none there."""
    return at_key(root, Section(Scene), counted(key)[0])[0]


def refuse_doubles(root: Node, keys: Iterable[str], option: str) -> None:
    """Refuse keys that name one place of a scene twice, perhaps by the number and by the name of a list's item, and a
    number beside the formula or constant in which it stands.

    Raises
    ------
    SceneError : with both keys. option : what gave them, named first.
    """
    seen: dict[Path, str] = {}
    for key in keys:
        place = place_of(root, key)
        for known, other in seen.items():
            if known in (place, _whole(place)) or place == _whole(known):
                also = "" if other == key else f", also as {other}"
                raise of_option(f"{option} {key}", f"is given twice{also}", key=key)
        seen[place] = key


def _whole(place: Path) -> Path:
    """Return the place of the text in which a number stands, of other places themselves."""
    return place[:-1] if str(place[-1]).startswith("#") else place


def _unit(cls: type, step: str) -> str:
    for field in dataclasses.fields(cls):
        if key_name(field) == step and not isinstance(field.metadata.get("kind"), Inline):
            return str(field.metadata.get("unit", ""))
    return ""


def _child(node: Node | None, step: str) -> Node | None:
    if isinstance(node, Mapping):
        return node.get(step)
    if isinstance(node, Sequence):
        index = index_of(node, step)
        return None if index is None else node.items[index]
    return None
