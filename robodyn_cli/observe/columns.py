"""Columns over time that a scene asks the extremes of: their names, units and values, and extremes of given motions.

Those of given motions follow from their samples (``solve.extremes``), those of integrated ones from the steps
(``motion.between.extremes``).
"""

from __future__ import annotations

import dataclasses
import itertools
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
from robodyn_cli.summaries.extremes import ExtremeErrors, Extremes

Found = tuple[float, float, float, float]  # an extreme value, its error, its time [s], the error of that
AT_ONCE = 2**14  # samples that are observed
# how names of the columns begin of which one is the length: all of a vector, force and moment of a wrench
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

    def extremes(self, low: Found, high: Found, final: float) -> Extremes:
        """Return the extremes of its values, which are squares of a length; errors are those due to the samples."""
        (least, least_error, least_time, least_off), (most, most_error, most_time, most_off) = low, high
        if self.is_length:
            (least, least_error), (most, most_error), (final, _) = (
                _root(*x) for x in (low[:2], high[:2], (final, 0.0))
            )
        errors = ExtremeErrors(least_error, least_off, most_error, most_off, 0.0)
        return Extremes(least, least_time, most, most_time, final, errors, self.unit)

    def doubt(self, value: float, error: float) -> float:
        """Return what an error of a value is of what ``of`` gives."""
        return (2.0 * value + error) * error if self.is_length else error

    def stored(self, value: float) -> float:
        """Return what ``of`` gives for a value that is not negative."""
        return value**2 if self.is_length else value

    def of(self, data: Mapping[str, Array]) -> Array:
        """Return its values (T,) from datasets by path; of a length the square."""
        block = data[self.path]
        if self.is_length:
            return np.asarray((block[:, list(self.places)] ** 2).sum(axis=1))
        return block[:, self.places[0]] if self.places else block


def _root(square: float, error: float) -> tuple[float, float]:
    """Return the length of a square, and its error."""
    length, most, least = (math.sqrt(max(square + off, 0.0)) for off in (0.0, error, -error))
    return length, max(most - length, length - least)


def chosen_columns(recorder: Recorder, names: Sequence[str]) -> list[ChosenColumn]:
    """Return those columns of a run that has been recorded which have these names."""
    described = {
        path: make_variable(path, blocks[0], **recorder.described(path))
        for path, blocks in recorder.blocks.items()
    }
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


Block = tuple[Array, Array, Array]  # times (T,), states (T, nx), parameters (n,)


def values_of(observer: Observer, columns: Sequence[ChosenColumn], blocks: Iterable[Block]) -> Array:
    """Return the values (T, n) of columns at states, block by block; those with the same parameters at once."""
    parts = []
    of_motion = all(column.path in ("q", "qd") for column in columns)
    for _, group in itertools.groupby(blocks, lambda block: block[2].tobytes()):
        alike = list(group)
        t, x = (np.concatenate([block[k] for block in alike]) for k in (0, 1))
        observer.parameters = alike[0][2]
        for first in range(0, len(t), AT_ONCE):
            own = t[first : first + AT_ONCE], x[first : first + AT_ONCE]
            if of_motion:  # which needs no equations
                data = dict(zip(("q", "qd"), observer.system.split(observer.project(*own))))
            else:
                data = observer.observe(*own, singular=False)
            parts.append(np.column_stack([column.of(data) for column in columns]))
    return np.concatenate(parts)


def extremes(
    times: Array, values: Array, columns: Iterable[ChosenColumn], breaks: Breaks
) -> dict[str, Extremes]:
    """Return the extremes of columns with values (T, n) at times (T,) by name, with errors due to the samples."""
    low, high = smallest(times, values, breaks), largest(times, values, breaks)
    return {
        column.name: column.extremes(_at(low, k), _at(high, k), float(values[-1, k]))
        for k, column in enumerate(columns)
    }


def _at(extreme: Extreme, k: int) -> Found:
    value, error, time, off = (
        float(x[k]) for x in (extreme.value, extreme.error, extreme.time, extreme.time_error)
    )
    return value, error, time, off


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
                (e.smallest or 0.0) + closed,
                e.smallest_time,
                (e.largest or 0.0) + closed,
                e.largest_time,
                closed,
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
                f"this run has no column {name!r}; allowed: columns of {', '.join(paths)}",
                ("outputs.extremes",),
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
