"""Columns of a dataset: their names and units, those of wrenches among them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from robodyn_cli.results.result import Variable
from robodyn_cli.spatial.algebra import Array


def column_names(variable: Variable) -> list[str]:
    """Return the names of the columns; their numbers where they have none."""
    return list(variable.names) or [str(index + 1) for index in range(variable.data.shape[-1])]


def units_of(variable: Variable) -> list[str]:
    """Return the units of each column; those of a wrench or a twist by the letters of its names."""
    if variable.column_units:
        return list(variable.column_units)
    both = variable.units.split(", ")
    if len(both) == 2 and variable.names:
        # force and moment, angular velocity and velocity
        return [both[1] if name[0] in "mv" else both[0] for name in variable.names]
    return [variable.units] * variable.data.shape[-1]


def by_unit(variable: Variable) -> dict[str, list[int]]:
    """Return the columns that go into one panel: those of one unit."""
    groups: dict[str, list[int]] = {}
    for column, units in enumerate(units_of(variable)):
        groups.setdefault(units, []).append(column)
    return groups


def magnitude(data: Array, names: Sequence[str], letter: str) -> Array:
    """Return the length (T,) of the force (``letter`` f) or of the moment (m) of a wrench (T, n).

    names : of its columns (``fx``, ``mz``), of which some may be missing.
    """
    columns = [k for k, name in enumerate(names) if name.startswith(letter)]
    return np.asarray(np.sqrt((data[:, columns] ** 2).sum(axis=1)))
