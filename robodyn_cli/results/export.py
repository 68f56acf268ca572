"""Results as objects of xarray and pandas, units with every column.

Results as files of other programs: CSV, Parquet, MATLAB, NumPy. Units go with every column.
"""

from __future__ import annotations

import csv
import importlib.util
import io
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from robodyn_cli.errors import CapabilityError
from robodyn_cli.foreign import file_stem, spreadsheet_cell
from robodyn_cli.record import record
from robodyn_cli.results.atomic import output_errors, write_bytes, written
from robodyn_cli.results.result import Result, Variable, column_names, units_of
from robodyn_cli.spatial.algebra import Array

if TYPE_CHECKING:
    import pandas
    import xarray


def to_xarray(result: Result) -> xarray.Dataset:
    """Return all datasets of a result as one Dataset: ``ds["points/tip"].sel(axis="z", time=slice(2, 4))``.

    Variables are called by their paths and have ``units`` and ``long_name``; time and the names of columns are
    coordinates. Where two datasets use one name for different lengths or names of columns, the second one's dimension
    gets a number: ``vertex_2``.

    Raises
    ------
    CapabilityError : xarray is not installed.
    """
    _require("xarray")
    import xarray

    seen: dict[str, tuple[int, tuple[str, ...]]] = {}  # length and labels of each dimension
    variables: dict[str, Any] = {}
    for path, variable in result.variables.items():
        dims = [
            _dimension(seen, dim, length, variable.names if axis == variable.data.ndim - 1 else ())
            for axis, (dim, length) in enumerate(zip(variable.dims, variable.data.shape))
        ]
        variables[path] = (dims, variable.data, _attributes(variable))
    labels = {name: list(own) for name, (_, own) in seen.items() if own and name not in variables}
    return xarray.Dataset(variables, coords=labels, attrs=_about(result))


def _dimension(
    seen: dict[str, tuple[int, tuple[str, ...]]], name: str, length: int, labels: tuple[str, ...]
) -> str:
    """Return the name of a dimension of a length and labels, a new one where the name stands for another already."""
    labels = labels if len(set(labels)) == len(labels) else ()  # labels that repeat are no index
    number, here = 1, name
    while here in seen:
        known_length, known = seen[here]
        if known_length == length and (not labels or not known or labels == known):
            break
        number += 1
        here = f"{name}_{number}"
    seen[here] = (length, labels or seen.get(here, (0, ()))[1])
    return here


def to_pandas(result: Result, table: str | None = None) -> pandas.DataFrame:
    """Return a table of a result as a DataFrame with columns ``q.theta1``, ``points/tip.x``.

    ``attrs["units"]`` has the units by column.

    Parameters
    ----------
    table : name of a first dimension: ``samples`` (everything over time, the index is the time in seconds), ``branch``,
        ``run``; default: the samples, or the first table where there are none.

    Raises
    ------
    CapabilityError : pandas is not installed, or there is no such table.
    """
    _require("pandas")
    import pandas

    by_name = tables(result)
    name = table or (SAMPLES if SAMPLES in by_name else next(iter(by_name), SAMPLES))
    if name not in by_name:
        raise CapabilityError(f"the result has no table {name!r}; allowed: {', '.join(by_name) or 'none'}")
    columns = {column.label: column.data for column in by_name[name]}
    index = columns.pop("time", None) if name == SAMPLES else None
    frame = pandas.DataFrame(columns, index=index)
    frame.index.name = "time" if index is not None else name
    frame.attrs = {**_about(result), "units": {column.label: column.units for column in by_name[name]}}
    return frame


def _attributes(variable: Variable) -> dict[str, Any]:
    attributes: dict[str, Any] = {"units": variable.units, "long_name": variable.long_name}
    if variable.column_units:
        attributes["column_units"] = list(variable.column_units)
    if variable.held is not None:
        attributes |= {"held_period": variable.held.period, "held_offset": list(variable.held.offset)}
    return attributes


def _about(result: Result) -> dict[str, Any]:
    return dict(result.head)


def _require(package: str) -> None:
    if importlib.util.find_spec(package) is None:
        raise CapabilityError(f"this needs the package {package}: pip install 'robodyn[{package}]'")


SAMPLES = "samples"  # name of the table of everything over time
EVENTS = "events"  # of the CSV file of what happened
MATLAB_NAME = 63  # characters of a name that MATLAB takes


@record
class ExportColumn:
    """A column of a table: path and name in the result, units, meaning, values (K,)."""

    label: str
    units: str
    meaning: str
    data: Array


def export(result: Result, kind: str, directory: Path) -> list[Path]:
    """Write a result into files of a kind of ``KINDS`` in a directory, each whole or not at all; return them.

    Raises
    ------
    CapabilityError : a package is missing. OutputError : it cannot be written.
    """
    if kind == "parquet" and importlib.util.find_spec("pyarrow") is None:
        raise CapabilityError(
            "Parquet needs the package pyarrow: pip install 'robodyn[parquet]'; csv, mat and npz need nothing more"
        )
    with output_errors(directory):
        directory.mkdir(parents=True, exist_ok=True)
    return KINDS[kind](result, directory)


def tables(result: Result) -> dict[str, list[ExportColumn]]:
    """Return all datasets as tables by their first dimension, that of time as ``samples``.

    A column is called ``PATH.NAME``: ``q.theta1``, ``points/tip.x``, ``skeleton/crank.0.x``.
    """
    by_name: dict[str, list[ExportColumn]] = {}
    lengths: dict[str, int] = {}
    for path, variable in result.variables.items():
        if not variable.dims:
            continue
        name = SAMPLES if variable.dims[0] == "time" else file_stem(variable.dims[0])
        # one name may stand for dimensions of different lengths
        if lengths.setdefault(name, len(variable.data)) != len(variable.data):
            name = file_stem(f"{name}_{path}")
            lengths[name] = len(variable.data)
        by_name.setdefault(name, []).extend(_columns(path, variable))
    return by_name


def _columns(path: str, variable: Variable) -> list[ExportColumn]:
    data = variable.data
    if data.ndim == 1:
        return [ExportColumn(path, variable.units, variable.long_name, data)]
    names, units = column_names(variable), units_of(variable)
    columns = []
    for place in np.ndindex(*data.shape[1:]):
        *above, last = place
        label = ".".join([path, *(str(k) for k in above), names[last]])
        index = (slice(None), *place)
        columns.append(ExportColumn(label, units[last], variable.long_name, data[index]))
    return columns


def _csv(result: Result, directory: Path) -> list[Path]:
    """Write each table with a head of ``label [units]``, numbers with all their digits, and the events."""
    paths = []
    for name, columns in tables(result).items():
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow([spreadsheet_cell(f"{column.label} [{column.units}]") for column in columns])
        writer.writerows(map(repr, row) for row in np.column_stack([c.data for c in columns]).tolist())
        paths.append(_write(directory / f"{name}{'_' * (name == EVENTS)}.csv", text))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["time [s]", "name", "kind", "details"])
    for event in result.events:
        more = {key: value for key, value in event.items() if key not in ("time", "name", "kind")}
        labels = [spreadsheet_cell(event.get(key, "")) for key in ("name", "kind")]
        writer.writerow([repr(event["time"]), *labels, json.dumps(more)])
    return [*paths, _write(directory / f"{EVENTS}.csv", text)]


def _write(path: Path, text: io.StringIO) -> Path:
    write_bytes(path, text.getvalue().encode())
    return path


def _parquet(result: Result, directory: Path) -> list[Path]:
    """Write each table with units and meanings as metadata of its fields."""
    import pyarrow
    import pyarrow.parquet

    about = {"title": result.title, "command": result.command, "status": result.status}
    paths = []
    for name, columns in tables(result).items():
        fields = [
            pyarrow.field(c.label, pyarrow.float64(), metadata={"units": c.units, "long_name": c.meaning})
            for c in columns
        ]
        table = pyarrow.table([c.data for c in columns], schema=pyarrow.schema(fields, metadata=about))
        path = directory / f"{name}.parquet"
        with written(path) as temporary:
            pyarrow.parquet.write_table(table, temporary)
        paths.append(path)
    return paths


def _npz(result: Result, directory: Path) -> list[Path]:
    """Write the arrays by path; ``units``, ``names`` and ``about`` are JSON."""
    units = {p: list(v.column_units) or v.units for p, v in result.variables.items()}
    names = {p: list(v.names) for p, v in result.variables.items() if v.names}
    about = {
        "title": result.title,
        "command": result.command,
        "status": result.status,
        "events": result.events,
    }
    notes = {"units": units, "names": names, "about": about}
    arrays: dict[str, Any] = {p: v.data for p, v in result.variables.items()}
    arrays |= {key: np.array(json.dumps(value)) for key, value in notes.items()}
    target = directory / "result.npz"
    with written(target) as temporary, open(temporary, "wb") as stream:
        np.savez_compressed(stream, **arrays)
    return [target]


def _json(result: Result, directory: Path) -> list[Path]:
    """Write datasets by path with units, names and axes, the events, and what the result is; null is no number."""
    variables = {
        path: {
            "units": list(v.column_units) or v.units,
            "long_name": v.long_name,
            "dims": list(v.dims),
            "names": list(v.names),
            "data": _plain(v.data),
        }
        for path, v in result.variables.items()
    }
    contents = {**_about(result), "events": result.events, "variables": variables}
    target = directory / "result.json"
    write_bytes(target, json.dumps(contents, allow_nan=False, ensure_ascii=False).encode())
    return [target]


def _plain(x: Array) -> Any:
    """Return lists of numbers, None where there is none."""
    if x.dtype.kind != "f" or np.isfinite(x).all():
        return x.tolist()
    plain = x.astype(object)
    plain[~np.isfinite(x)] = None
    return plain.tolist()


def _mat(result: Result, directory: Path) -> list[Path]:
    """Write structures that follow the paths: ``data``, ``units`` and ``names`` with the same fields."""
    from scipy.io import savemat

    data: dict[str, Any] = {}
    units: dict[str, Any] = {}
    names: dict[str, Any] = {}
    for path, variable in result.variables.items():
        *groups, last = [matlab_name(part) for part in path.split("/")]
        column = variable.data[:, None] if variable.data.ndim == 1 else variable.data
        _place(data, groups, last, column)
        per_column = list(variable.column_units)
        _place(units, groups, last, _cells(per_column) if per_column else variable.units)
        _place(names, groups, last, _cells(list(variable.names)))
    about = {"title": result.title, "command": result.command, "status": result.status}
    target = directory / "result.mat"
    with written(target) as temporary, open(temporary, "wb") as stream:
        contents = {"data": data, "units": units, "names": names, "about": about}
        savemat(stream, contents, long_field_names=True, do_compression=True)
    return [target]


def _place(tree: dict[str, Any], groups: list[str], name: str, value: Any) -> None:
    for group in groups:
        tree = tree.setdefault(group, {})
    while name in tree:  # two names that MATLAB cannot tell apart
        name += "_"
    tree[name] = value


def _cells(texts: list[str]) -> Array:
    """Return texts as MATLAB has them: a cell array."""
    cells = np.empty((1, len(texts)), dtype=object)
    cells[0, :] = texts
    return cells


def matlab_name(text: str) -> str:
    """Return a name that MATLAB takes: letters, digits and underscores, a letter first."""
    name = re.sub(r"[^A-Za-z0-9_]", "_", text)
    return (name if name[:1].isalpha() else f"x{name}")[:MATLAB_NAME]


KINDS: dict[str, Callable[[Result, Path], list[Path]]] = {
    "csv": _csv,
    "parquet": _parquet,
    "mat": _mat,
    "npz": _npz,
    "json": _json,
}
