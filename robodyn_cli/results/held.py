"""Columns that a sampled controller holds between its updates: how that is declared, and what a line through samples of
them is."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from robodyn_cli.spatial.algebra import Array

NEAR = 1e-9  # of a period: a sample so near to an update shows what it has set
NOT_HELD = math.nan


class HeldColumns(NamedTuple):
    """When the columns of a dataset change: at ``offset`` + n ``period`` [s], an offset for each column, nan of one
    that is not held."""

    period: float
    offset: tuple[float, ...]

    def passed(self, t: Array, column: int) -> Array:
        """Return the number of the last update until times (T,)."""
        return np.asarray(np.floor((t - self.offset[column]) / self.period + NEAR))

    def hides(self, t: Array, column: int) -> bool:
        """Tell whether a column takes values between samples at times (T,) that none of them shows."""
        return self.is_held(column) and bool(np.any(np.diff(self.passed(t, column)) > 1.0))

    def is_held(self, column: int) -> bool:
        """Tell whether a column is held."""
        return not math.isnan(self.offset[column])

    def line(self, t: Array, y: Array, column: int) -> tuple[Array, Array]:
        """Return the corners of the line through samples y (T,) of a column at times t (T,).

        It is level up to the next update and behind the last one: a step where one lies between two samples. What lies
        between several is not known, and the line goes straight there.
        """
        if not self.is_held(column) or len(t) < 2:
            return t, y
        last = self.passed(t, column)
        first, behind = (x * self.period + self.offset[column] for x in (last[:-1] + 1.0, last[1:]))
        jumps = np.flatnonzero((np.diff(last) > 0.0) & (y[1:] != y[:-1]))
        places = np.repeat(jumps + 1, 2)
        times = np.column_stack([first[jumps], behind[jumps]]).ravel()
        times = np.clip(times, t[places - 1], t[places])
        times, values = (
            np.insert(t, places, times),
            np.insert(y, places, np.column_stack([y[jumps], y[jumps + 1]]).ravel()),
        )
        needed = np.ones(
            len(times), dtype=bool
        )  # corners alone: a long record is thinned by the number of its points
        needed[1:-1] = (values[1:-1] != values[:-2]) | (values[1:-1] != values[2:])
        return times[needed], values[needed]
