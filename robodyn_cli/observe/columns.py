"""Columns over time that a scene asks the extremes of, and their smallest, largest and last values.

Values between the samples are those of ``solve.extremes``: of polynomials, in pieces between the times at which
a motion jumps.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from robodyn_cli.errors import SceneError
from robodyn_cli.observe.observe import Observer
from robodyn_cli.observe.recorder import Recorder
from robodyn_cli.record import record
from robodyn_cli.results.result import Result, Variable, column_names, make_variable, units_of
from robodyn_cli.solve.extremes import Extreme, largest, smallest
from robodyn_cli.solve.quadrature import Breaks
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.facts import ExtremeErrors, Extremes

# columns that the length of some others is, by its name: all of a vector, force and moment of a wrench
LENGTHS = {"length": "xyz", "force": "f", "moment": "m"}


@record
class ChosenColumn:
    """A column of a dataset by its name, with its unit.

    places : of the column; none of a dataset that is a column itself. is_length : whether it is the length of those at
    the places, whose square is taken in its place: it has no kink where it is zero.
    """

    name: str
    path: str
    places: tuple[int, ...]
    unit: str
    is_length: bool = False

    def of(self, data: Mapping[str, Array]) -> Array:
        """Return its values (T,) from datasets by path; of a length the square."""
        block = data[self.path]
        if self.is_length:
            return np.asarray((block[:, list(self.places)] ** 2).sum(axis=1))
        return block[:, self.places[0]] if self.places else block


def chosen_columns(recorder: Recorder, names: Sequence[str]) -> list[ChosenColumn]:
    """Return those columns of a run that has been recorded which have these names."""
    described = {path: make_variable(path, blocks[0], **recorder.described(path)) for path, blocks in recorder.blocks.items()}
    return [column for name in names if (column := chosen(described, name)) is not None]


def chosen(variables: Mapping[str, Variable], name: str) -> ChosenColumn | None:
    """Return the column of a name, None where there is none."""
    if name in variables:
        return ChosenColumn(name, name, (), variables[name].units) if variables[name].data.ndim == 1 else None
    path, dot, column = name.partition(".")
    while dot:
        if path in variables:
            names, units = column_names(variables[path]), units_of(variables[path])
            places = [names.index(column)] if column in names else []
            is_length = not places and column in LENGTHS
            if is_length:
                places = [k for k, x in enumerate(names) if x[0] in LENGTHS[column]]
            if places:
                return ChosenColumn(name, path, tuple(places), units[places[0]], is_length)
        more, dot, column = column.partition(".")
        path = f"{path}.{more}"
    return None


class ColumnSamples:
    """Takes blocks of samples, and keeps some columns of what an observer sees in them."""

    def __init__(self, observer: Observer, columns: Sequence[ChosenColumn]) -> None:
        self.observer, self.columns = observer, columns
        self._times: list[Array] = []
        self._values: list[Array] = []

    @property
    def times(self) -> Array:
        """Times of the samples (T,) [s]."""
        return np.concatenate(self._times)

    def emit(self, t: Array, x: Array, p: Array) -> None:
        """Observe states x (T, nx) at times t (T,) with the parameters p."""
        self.observer.parameters = p
        data = self.observer.observe(t, x)
        self._times.append(t)
        self._values.append(np.column_stack([column.of(data) for column in self.columns]))

    def extremes(self, breaks: Breaks) -> dict[str, Extremes]:
        """Return the extremes of each column by name; breaks : see ``quadrature``."""
        return extremes(np.concatenate(self._times), np.concatenate(self._values), self.columns, breaks)

    def with_rivals(self, own: Mapping[str, Extremes]) -> dict[str, Extremes]:
        """Return extremes with errors of their times that cover what is as large within the errors of the values."""
        times, values = np.concatenate(self._times), np.concatenate(self._values)
        found = {}
        for column, y in zip(self.columns, values.T):
            x = own[column.name]
            e = x.errors
            y = np.sqrt(y) if column.is_length else y
            low = _with_rivals(times, -y, -x.smallest, e.smallest, x.smallest_time, e.smallest_time)
            high = _with_rivals(times, y, x.largest, e.largest, x.largest_time, e.largest_time)
            errors = dataclasses.replace(e, smallest_time=low, largest_time=high)
            found[column.name] = dataclasses.replace(x, errors=errors)
        return found


def _with_rivals(
    times: Array, y: Array, value: float, error: float | None, time: float, time_error: float | None
) -> float | None:
    """Return the error of the time of a largest value with how far other tops are that may be as large."""
    if error is None or time_error is None or len(y) < 3:
        return time_error
    left, middle, right = y[:-2], y[1:-1], y[2:]
    bend = left - 2.0 * middle + right
    with np.errstate(divide="ignore", invalid="ignore"):
        tops = np.where(bend < 0.0, middle - (right - left) ** 2 / (8.0 * bend), middle)
    tops = np.concatenate([y[:1], np.where((middle >= left) & (middle >= right), tops, -np.inf), y[-1:]])
    away = np.abs(times[tops >= value - 2.0 * error] - time)
    step = float(np.diff(times).max())
    return max(time_error, float(away.max(initial=0.0)) if away.max(initial=0.0) > 2.0 * step else 0.0)


def extremes(
    times: Array, values: Array, columns: Iterable[ChosenColumn], breaks: Breaks
) -> dict[str, Extremes]:
    """Return the extremes of columns with values (T, n) at times (T,) by name, with errors due to the samples."""
    low, high = smallest(times, values, breaks), largest(times, values, breaks)
    found = {}
    for k, column in enumerate(columns):
        ((least, least_off), (most, most_off)), last = (_at(x, k, column) for x in (low, high)), values[-1, k]
        times_of = (float(x[k]) for one in (low, high) for x in (one.time, one.time_error))
        least_time, least_time_off, most_time, most_time_off = times_of
        errors = ExtremeErrors(least_off, least_time_off, most_off, most_time_off, 0.0)
        final = float(np.sqrt(last) if column.is_length else last)
        found[column.name] = Extremes(least, least_time, most, most_time, final, errors, column.unit)
    return found


def _at(extreme: Extreme, k: int, column: ChosenColumn) -> tuple[float, float]:
    """Return the value of one column and its error; those of a length from its square."""
    value, error = float(extreme.value[k]), float(extreme.error[k])
    if not column.is_length:
        return value, error
    most, least = (math.sqrt(max(value + off, 0.0)) for off in (error, -error))
    length = math.sqrt(max(value, 0.0))
    return length, max(most - length, length - least)


def chosen_extremes(
    result: Result, names: Sequence[str], breaks: Breaks, closed: float
) -> dict[str, Extremes]:
    """Return the extremes of columns of a result by name; closed : how far positions are off at the samples.

    Raises
    ------
    SceneError : the result has no such column.
    """
    columns = [column for name in names if (column := chosen(result.variables, name)) is not None]
    refuse_missing(names, [column.name for column in columns], result.variables)
    data = {path: variable.data for path, variable in result.variables.items()}
    values = np.column_stack([column.of(data) for column in columns])
    found = extremes(result.time, values, columns, breaks)
    for column in columns:
        if column.path == "q":
            one = found[column.name]
            e = one.errors
            errors = ExtremeErrors(
                (e.smallest or 0.0) + closed, e.smallest_time, (e.largest or 0.0) + closed, e.largest_time, closed
            )
            found[column.name] = dataclasses.replace(one, errors=errors)
    return found


def refuse_missing(names: Sequence[str], known: Collection[str], paths: Iterable[str]) -> None:
    """Refuse names of columns that a run with datasets of these paths does not have.

    Raises
    ------
    SceneError
    """
    for name in names:
        if name not in known:
            raise SceneError(
                f"outputs.extremes: this run has no column {name!r}; allowed: columns of {', '.join(paths)}",
                key="outputs.extremes",
            )


def over_both(first: Extremes, later: Extremes) -> Extremes:
    """Return the extremes over two motions that follow one another."""
    values: dict[str, Any] = {"final": later.final}
    errors: dict[str, Any] = {"final": later.errors.final}
    for name, sign in (("smallest", -1.0), ("largest", 1.0)):
        ahead = sign * getattr(later, name) > sign * getattr(first, name)
        one, other = (later, first) if ahead else (first, later)
        off, beyond = getattr(one.errors, name), getattr(other.errors, name)
        gap = abs(getattr(one, name) - getattr(other, name))
        time = f"{name}_time"
        values |= {name: getattr(one, name), time: getattr(one, time)}
        if off is None or beyond is None:
            errors |= {name: None, time: None}
            continue
        time_off, apart = getattr(one.errors, time), abs(getattr(one, time) - getattr(other, time))
        if gap <= off + beyond:
            time_off = max(time_off, apart + getattr(other.errors, time))
        errors |= {name: max(off, beyond - gap), time: time_off}
    return dataclasses.replace(later, **values, errors=ExtremeErrors(**errors))
