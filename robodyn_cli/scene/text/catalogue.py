"""Catalogues of motors, gears and brakes: the one that comes with the program, and tables in CSV files."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path as FilePath

from robodyn_cli import motors
from robodyn_cli.errors import shown, unknown_name
from robodyn_cli.motors.drive import Brake
from robodyn_cli.motors.registry import gear_types, motor_types
from robodyn_cli.scene.text.nodes import (
    Mapping,
    Node,
    Scalar,
    Sequence,
    Source,
    dotted,
    located,
    mapping,
    resolve,
    scalar,
    sequence,
)
from robodyn_cli.schema.fields import Section, key_name

EXAMPLE = FilePath(motors.__file__).parent / "example_catalogue.yaml"
BRAKE = "brake"  # as the type of a line
Cells = list[Scalar]


def with_catalogue(root: Mapping) -> Mapping:
    """Return the tree of a scene with the example catalogue, where it has drives and names no other."""
    drives, own = root.get("drives"), root.get("catalogue")
    if not isinstance(drives, Mapping) or not (
        own is None or (isinstance(own, Scalar) and own.value is None)
    ):
        return root
    return root.replaced(scalar(drives, "catalogue"), scalar(drives, str(EXAMPLE)))


def catalogue_tree(text: str, source: Source) -> Mapping:
    """Return the tree of a catalogue in CSV: a header of keys, then a line for each motor, gear and brake.

    Columns are ``name``, ``type`` and the keys of the kinds, those of sections with a dot (``thermal.winding_time``).
    An empty cell leaves its key out. Rows of a table are written ``speed torque; speed torque``.

    Raises
    ------
    SceneError : a column that no kind has, or a line that does not fit the header.
    """
    lines = _lines(text, source)
    header = next(lines, None)
    start = Scalar(source, 1, 1, "", None)
    if header is None:
        raise located(
            start, "catalogue", "there is no header row; allowed: a row of keys, then rows of parts"
        )
    _check_header(header)
    groups: dict[str, list[tuple[Scalar, Node]]] = {"motors": [], "gears": [], "brakes": []}
    for cells in lines:
        if len(cells) != len(header):
            fault = f"has {len(cells)} cells; needed: {len(header)}, as the header has"
            raise located(cells[0], "catalogue", fault)
        name, group, part = _part(header, cells)
        if any(key.text == name.text for key, _ in groups[group]):
            raise located(name, dotted(("catalogue", group, name.text)), "appears twice; names must differ")
        groups[group].append((name, part))
    return mapping(start, [(scalar(start, key), mapping(start, parts)) for key, parts in groups.items()])


def _lines(text: str, source: Source) -> Iterator[Cells]:
    """Yield the cells of each line that is neither blank nor a comment."""
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        column, cells = 1, []
        for cell in line.split(","):
            at = column + len(cell) - len(cell.lstrip())
            cells.append(Scalar(source, number, at, cell.strip(), cell.strip() or None))
            column += len(cell) + 1
        yield cells


def _columns() -> list[str]:
    """Return the columns that a catalogue may have."""
    names = ["name", "type"]
    for cls in (*motor_types.values(), *gear_types.values(), Brake):
        for field in dataclasses.fields(cls):
            kind, name = field.metadata["kind"], key_name(field)
            inner = dataclasses.fields(kind.cls) if isinstance(kind, Section) else ()
            names += [f"{name}.{key_name(one)}" for one in inner] or [name]
    return list(dict.fromkeys(names))


def _check_header(header: Cells) -> None:
    allowed = _columns()
    for k, cell in enumerate(header):
        if cell.text not in allowed:
            raise located(cell, "catalogue", unknown_name("column", cell.text, allowed))
        if cell.text in [other.text for other in header[:k]]:
            raise located(cell, "catalogue", f"column {cell.text!r} appears twice")
    for needed in ("name", "type"):
        if needed not in [cell.text for cell in header]:
            raise located(header[0], "catalogue", f"column {needed!r} is missing")


def _part(header: Cells, cells: Cells) -> tuple[Scalar, str, Mapping]:
    """Return the name of a line's part, the group that it belongs to, and its keys."""
    given = {key.text: cell for key, cell in zip(header, cells) if cell.value is not None}
    place, kind = cells[0], given.get("type")
    types = [*motor_types, *gear_types, BRAKE]
    if "name" not in given or kind is None or kind.text not in types:
        column = "name" if "name" not in given else "type"
        value = "nothing" if column not in given else shown(given[column].text)
        allowed = "a name" if column == "name" else ", ".join(types)
        fault = f"no {column} of a part" if column == "name" else f"unknown type of part {place.text!r}"
        raise located(
            given.get(column, place), f"catalogue.{column}", f"{fault} (value {value}); allowed: {allowed}"
        )
    entries: dict[str, list[tuple[Scalar, Node]]] = {}
    for name, cell in given.items():
        if name != "name" and not (name == "type" and kind.text == BRAKE):
            section, _, inner = name.partition(".")
            entries.setdefault(section, []).append((scalar(cell, inner), _value(cell)))
    keys = [
        (scalar(parts[0][0], name), mapping(parts[0][0], parts) if parts[0][0].value else parts[0][1])
        for name, parts in entries.items()
    ]
    group = "motors" if kind.text in motor_types else "brakes" if kind.text == BRAKE else "gears"
    return given["name"], group, mapping(place, keys)


def _value(cell: Scalar) -> Node:
    if ";" not in cell.text:
        try:
            return dataclasses.replace(cell, value=resolve(cell.text))
        except ValueError:
            return cell
    rows: list[Sequence] = []
    for row in cell.text.split(";"):
        rows.append(sequence(cell, [_value(dataclasses.replace(cell, text=x, value=x)) for x in row.split()]))
    return sequence(cell, rows)
