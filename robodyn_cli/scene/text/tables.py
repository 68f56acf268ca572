"""Tables in files: header and rows as nodes that know their place."""

from __future__ import annotations

from typing import Any

from robodyn_cli.errors import ResultFileError, shown
from robodyn_cli.registry import Registry
from robodyn_cli.scene.text.nodes import Node, Scalar, Sequence, Source, located, scalar, sequence
from robodyn_cli.scene.text.scalars import resolve

HDF5 = (".h5", ".hdf5")
# only the results know the HDF5 library, which is loaded where a scene names such a file
_readers: Registry[Any] = Registry("robodyn_cli.results.hdf5", {"table": "table:read_table"})


def is_hdf5(name: str) -> bool:
    """Tell whether a file is HDF5, by its name."""
    return name.lower().endswith(HDF5)


def hdf5_table(path: str, named: Scalar, source: Source, key: str) -> tuple[Sequence, Sequence]:
    """Return columns and rows of an HDF5 file; ``named`` : where the scene names it."""
    try:
        columns, rows = _readers["table"](path)
    except ResultFileError as error:
        raise located(named, key, error.message) from None
    place = Scalar(source, 1, 1, "", None)
    lines = [sequence(place, [scalar(place, x) for x in row]) for row in rows.tolist()]
    return sequence(place, [scalar(place, name) for name in columns]), sequence(place, lines)


def csv_table(text: str, source: Source, key: str) -> tuple[Sequence, Sequence]:
    """Return header and rows of a CSV text; blank lines and lines that start with ``#`` are skipped."""
    header: list[Node] = []
    rows: list[Node] = []
    start = Scalar(source, 1, 1, "", None)
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        cells: list[Node] = []
        column = 1
        for cell in line.split(","):
            place = Scalar(source, number, column + len(cell) - len(cell.lstrip()), "", None)
            cells.append(_cell(cell.strip(), place, bool(header), key))
            column += len(cell) + 1
        if header:
            rows.append(sequence(cells[0], cells))
        else:
            header = cells
    if not header:
        raise located(
            start, key, "there is no header row; allowed: a row of column names, then rows of numbers"
        )
    return sequence(header[0], header), sequence(start, rows)


def _cell(text: str, place: Scalar, is_number: bool, key: str) -> Scalar:
    if not is_number:
        return scalar(place, text)
    try:
        value = resolve(text)
    except ValueError:
        value = text
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise located(place, key, f"must be a number (value {shown(text)})")
    return scalar(place, value)
