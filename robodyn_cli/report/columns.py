"""Columns of a dataset: their names, and which may share an axis."""

from __future__ import annotations

from robodyn_cli.results.result import Variable


def column_names(variable: Variable) -> list[str]:
    """Return the names of the columns; their numbers where they have none."""
    return list(variable.names) or [str(index + 1) for index in range(variable.data.shape[-1])]


def units_of(variable: Variable) -> list[str]:
    """Return the units of each column."""
    return list(variable.column_units) or [variable.units] * variable.data.shape[-1]


def by_unit(variable: Variable) -> dict[str, list[int]]:
    """Return the columns that go into one panel: those of one unit."""
    groups: dict[str, list[int]] = {}
    for column, units in enumerate(units_of(variable)):
        groups.setdefault(units, []).append(column)
    return groups
