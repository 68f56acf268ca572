"""Datasets that the commands on mechanisms have in common."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.loops.base import Row
from robodyn_cli.results.result import Result
from robodyn_cli.run.observation.observe import loop_columns

Array = NDArray[np.float64]


def add_rows(result: Result, rows: Sequence[Row], arrays: Mapping[str, Array]) -> None:
    """Add what was evaluated of the loops' rows (T, m), by path, to a result."""
    columns = loop_columns(rows)
    for path, data in arrays.items():
        column = columns[path]
        result.add(path, data, units=column.units, long_name=column.long_name, names=column.names)
