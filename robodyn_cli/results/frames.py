"""Results as objects of xarray and pandas, units with every column."""

from __future__ import annotations

import importlib.util
from typing import TYPE_CHECKING, Any

from robodyn_cli.errors import CapabilityError
from robodyn_cli.results.export import SAMPLES, tables
from robodyn_cli.results.result import Result, Variable

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
    labels = {name: list(found) for name, (_, found) in seen.items() if found and name not in variables}
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

    found = tables(result)
    name = table or (SAMPLES if SAMPLES in found else next(iter(found), SAMPLES))
    if name not in found:
        raise CapabilityError(f"the result has no table {name!r}; allowed: {', '.join(found) or 'none'}")
    columns = {column.label: column.data for column in found[name]}
    index = columns.pop("time", None) if name == SAMPLES else None
    frame = pandas.DataFrame(columns, index=index)
    frame.index.name = "time" if index is not None else name
    frame.attrs = {**_about(result), "units": {column.label: column.units for column in found[name]}}
    return frame


def _attributes(variable: Variable) -> dict[str, Any]:
    found: dict[str, Any] = {"units": variable.units, "long_name": variable.long_name}
    return {**found, "column_units": list(variable.column_units)} if variable.column_units else found


def _about(result: Result) -> dict[str, Any]:
    return dict(result.head)


def _require(package: str) -> None:
    if importlib.util.find_spec(package) is None:
        raise CapabilityError(f"this needs the package {package}: pip install 'robodyn[{package}]'")
