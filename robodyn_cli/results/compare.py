"""Compare two results dataset by dataset."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from robodyn_cli.record import record
from robodyn_cli.results.result import Result, Variable, units_of
from robodyn_cli.results.stated_errors import beyond, stated_error
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.facts import rounded_up

# from what cannot be compared to what only the new result has
RANK = {"missing": 0, "shape": 0, "units": 0, "names": 0, "entries": 0, "differs": 1, "equal": 2, "extra": 3}
# what explains the other differences comes before them
FIRST = ("status", "events", "time")
# times that are one but for rounding, as of t = k h with other k and h
SAME_TIME = 4 * np.finfo(float).eps
# columns that a clock has measured: no two runs have the same ones
CLOCKED = ("seconds", "run_time_s", "compile_time_s")


@record
class Difference:
    """How one dataset compares with the baseline.

    ``verdict`` is ``"equal"`` (within tolerance), ``"differs"``, ``"missing"`` (only in the baseline),
    ``"extra"`` (only in the result), ``"shape"``, ``"units"``, ``"names"``, or ``"entries"`` of a dataset that holds
    no numbers. The other fields describe the worst sample: ``ratio`` is its error over what is allowed there,
    ``stated`` the sum of the errors that both results state there, None where one states none. ``within_stated`` tells
    whether no sample is farther off than that. ``unit`` is that of the column.
    """

    path: str
    verdict: str
    detail: str = ""
    ratio: float = 0.0
    error: float = 0.0
    value: float = math.nan
    expected: float = math.nan
    time: float | None = None
    column: str = ""
    stated: float | None = None
    within_stated: bool | None = None
    unit: str = ""

    @property
    def agrees(self) -> bool:
        """Whether this is no failure; what only the new result has is none."""
        return self.verdict in ("equal", "extra")

    @property
    def text(self) -> str:
        """The worst sample in words, beside what is allowed and what the results state of their errors."""
        if self.verdict in ("missing", "extra"):
            return "only in the baseline" if self.verdict == "missing" else "only in the result"
        if self.detail or self.error == 0.0:
            return self.detail
        column = f" of {self.column}" if self.column else ""
        time = f" at t = {self.time:.9g} s" if self.time is not None else ""
        unit = "" if self.unit in ("", "1") else f" {self.unit}"
        beside = f"{self.ratio:.3g} times the tolerance"
        if self.stated is None:
            beside += "; no error stated"
        else:
            side = "within" if self.within_stated else "beyond"
            beside += f"; {side} the stated errors, {rounded_up(self.stated):.2g}{unit}"
        worst = f"worst {rounded_up(self.error, 3):.3g}{unit}{column}{time}"
        return f"{worst}: {self.value:.12g}{unit} instead of {self.expected:.12g}{unit} ({beside})"


@record
class Comparison:
    """All differences, worst first; ``agrees`` tells whether every dataset of the baseline was met."""

    differences: tuple[Difference, ...]

    @property
    def agrees(self) -> bool:
        """Whether nothing differs; datasets that only the new result has are no failure."""
        return all(item.agrees for item in self.differences)

    @property
    def differing(self) -> tuple[Difference, ...]:
        """Those that are a failure, worst first."""
        return tuple(item for item in self.differences if not item.agrees)


@record
class _Tolerance:
    rtol: float
    atol: float
    relative_to: str = "peak"

    def allowed(self, b: Array) -> Array:
        """Return the error that is allowed at each sample of the baseline."""
        magnitude: Array = np.where(np.isfinite(b), np.abs(b), 0.0)
        if self.relative_to == "peak" and b.ndim:
            magnitude = magnitude.max(axis=0, keepdims=True)
        return self.atol + self.rtol * magnitude


def compare(
    result: Result, baseline: Result, *, rtol: float = 1e-9, atol: float = 1e-12, relative_to: str = "peak"
) -> Comparison:
    """Compare ``result`` with ``baseline``: |difference| <= atol + rtol * reference.

    The reference is the largest magnitude of the baseline's column (``relative_to="peak"``: a zero crossing
    is no trap) or the baseline's value at each sample (``"sample"``). Columns that a clock has measured are not
    compared. A status that is another one is a difference ``status``. Where the samples are at other times, which is a
    difference ``time``, those at common times are compared.
    """
    if relative_to not in ("peak", "sample"):
        raise ValueError(f"relative_to is {relative_to!r}; allowed are 'peak' and 'sample'")
    tolerance = _Tolerance(rtol, atol, relative_to)
    other_times = _other_times(result, baseline, tolerance)
    if other_times is not None:
        rows = _common(result.time, baseline.time)
        result, baseline = (_at(one, there) for one, there in zip((result, baseline), rows))
    differences = [Difference(path, "extra") for path in result.variables if path not in baseline.variables]
    if result.status != baseline.status:
        differences.append(Difference("status", "entries", f"{result.status} instead of {baseline.status}"))
    for path, expected in baseline.variables.items():
        if path not in result.variables:
            differences.append(Difference(path, "missing"))
            continue
        actual = result.variables[path]
        if path == "time" and other_times is not None:
            differences.append(other_times)
            continue
        reason = _mismatch(actual, expected)
        if reason is not None:
            differences.append(Difference(path, *reason))
        else:
            over_time = expected.dims[:1] == ("time",) and "time" in baseline
            times = baseline.time if over_time else None
            differences.append(
                _worst(path, actual, expected, tolerance, _stated(result, baseline, path), times)
            )
    differences += _others(result.others, baseline.others)
    differences += _events(result, baseline, _Tolerance(rtol, atol))
    return Comparison(tuple(sorted(differences, key=_sort_key)))


def _sort_key(item: Difference) -> tuple[int, int, float, str]:
    explains = item.path in FIRST and not item.agrees
    place = FIRST.index(item.path) if explains else len(FIRST)
    return place, RANK[item.verdict], -item.ratio, item.path


def _other_times(result: Result, baseline: Result, tolerance: _Tolerance) -> Difference | None:
    """Return how the times of two results differ; None where samples of one number are at one time, within the
    tolerance and the errors that are stated of it."""
    if "time" not in result or "time" not in baseline:
        return None
    own, wanted = (one.variables["time"] for one in (result, baseline))
    worst = Difference("time", "shape")
    if own.data.shape == wanted.data.shape:
        stated = _stated(result, baseline, "time")
        worst = _worst("time", own, wanted, tolerance, stated, wanted.data)
        allowed = np.fmax(tolerance.allowed(wanted.data), stated)
        with np.errstate(invalid="ignore"):
            apart = beyond(own.data - wanted.data, allowed)
        if worst.verdict == "equal" or not np.any(apart):
            return None
    one, other = (f"{len(x.time)} samples{_until(x.time)}" for x in (result, baseline))
    common = len(_common(result.time, baseline.time)[0])
    which = "there is no common time" if not common else f"compared at the {common} common times"
    return dataclasses.replace(worst, detail=f"{one} instead of {other}; {which}")


def _until(times: Array) -> str:
    return f" until {times[-1]:.9g} s" if len(times) else ""


def _common(one: Array, other: Array) -> tuple[Array, Array]:
    """Return the samples of both, as indices, that are at the same time but for rounding.

    Times of several samples of one result are left out: which of them belong together is not known.
    """
    places = []
    for times in (one, other):
        _, first, count = np.unique(times, return_index=True, return_counts=True)
        places.append(first[(count == 1) & np.isfinite(times[first])])
    a, b = one[places[0]], other[places[1]]
    if not a.size or not b.size:
        return places[0][:0], places[1][:0]
    after = np.clip(np.searchsorted(b, a), 1, max(b.size - 1, 1))
    nearest = np.where(
        np.abs(b[after - 1] - a) <= np.abs(b[np.minimum(after, b.size - 1)] - a), after - 1, after
    )
    nearest = np.minimum(nearest, b.size - 1)
    same = np.abs(b[nearest] - a) <= SAME_TIME * np.maximum(np.abs(a), np.abs(b[nearest]))
    return places[0][same], places[1][nearest[same]]


def _at(result: Result, samples: Array) -> Result:
    """Return a result with these samples alone."""
    variables = {
        path: dataclasses.replace(variable, data=variable.data[samples])
        if variable.dims[:1] == ("time",)
        else variable
        for path, variable in result.variables.items()
    }
    return dataclasses.replace(result, variables=variables)


def _others(
    result: Mapping[str, tuple[str, ...]], baseline: Mapping[str, tuple[str, ...]]
) -> list[Difference]:
    """Compare the datasets without numbers: entry by entry, equal or not."""
    differences = [Difference(path, "extra") for path in result if path not in baseline]
    for path, expected in baseline.items():
        actual = result.get(path)
        if actual is None:
            differences.append(Difference(path, "missing"))
        elif len(actual) != len(expected):
            differences.append(Difference(path, "shape", f"{len(actual)} entries instead of {len(expected)}"))
        elif actual != expected:
            k = next(k for k, (a, b) in enumerate(zip(actual, expected)) if a != b)
            differences.append(
                Difference(path, "entries", f"{actual[k]!r} instead of {expected[k]!r} as number {k}")
            )
        else:
            differences.append(Difference(path, "equal"))
    return differences


def _events(result: Result, baseline: Result, tolerance: _Tolerance) -> list[Difference]:
    """Compare the events: the same ones in the same order, and their times; nothing without events."""
    if not result.events and not baseline.events:
        return []
    actual, expected = ([f"{e.get('kind')} of {e.get('name')}" for e in r.events] for r in (result, baseline))
    for k, (a, b) in enumerate(zip(actual, expected)):
        if a != b:
            time = float(baseline.events[k]["time"])
            return [Difference("events", "shape", f"{a} instead of {b} as number {k}, at t = {time:.9g} s")]
    if len(actual) != len(expected):
        return [Difference("events", "shape", f"{len(actual)} events instead of {len(expected)}")]
    times = [np.array([float(e["time"]) for e in r.events]) for r in (result, baseline)]
    own, wanted = (Variable(x, ("event",), "s", "time of events") for x in times)
    stated = _stated(result, baseline, "events/time")
    worst = _worst("events/time", own, wanted, tolerance, stated, times[1])
    at = int(np.argmax(np.abs(times[0] - times[1])))
    return [dataclasses.replace(worst, column=expected[at])]


def _stated(result: Result, baseline: Result, path: str) -> Array:
    """Return the sum of the errors that both results state of a dataset; nan where one states none."""
    return stated_error(result, path) + stated_error(baseline, path)


def _mismatch(actual: Variable, expected: Variable) -> tuple[str, str] | None:
    """Return why two variables cannot be compared by value: (verdict, detail)."""
    if actual.data.shape != expected.data.shape:
        if len(actual.data) == len(expected.data) and actual.data.ndim == expected.data.ndim == 2:
            return "shape", f"{actual.data.shape[1]} columns instead of {expected.data.shape[1]}"
        return "shape", f"{actual.data.shape} instead of {expected.data.shape}"
    if actual.units != expected.units:
        return "units", f"{actual.units} instead of {expected.units}"
    if actual.column_units != expected.column_units:
        return "units", f"{', '.join(actual.column_units)} instead of {', '.join(expected.column_units)}"
    if actual.names != expected.names:
        return "names", f"{', '.join(actual.names)} instead of {', '.join(expected.names)}"
    return None


def _worst(
    path: str,
    actual: Variable,
    expected: Variable,
    tolerance: _Tolerance,
    stated: Array,
    times: Array | None,
) -> Difference:
    """Return how two datasets of one shape differ; ``times`` : of their rows [s], where they have some."""
    a, b = np.atleast_1d(actual.data), np.atleast_1d(expected.data)  # one number is a row of one
    if not a.size:
        return Difference(path, "equal")
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        error = np.abs(a - b)
        # Equal infinities subtract to NaN, and a NaN where the baseline has one is agreement.
        error[(a == b) | (np.isnan(a) & np.isnan(b))] = 0.0
        error[np.isnan(error)] = np.inf
        if any(clocked := [name in CLOCKED for name in expected.names]):
            error[..., clocked] = 0.0
        ratio = np.divide(error, tolerance.allowed(b))
    # 0/0: no tolerance, and no difference
    ratio[error == 0.0] = 0.0
    index = np.unravel_index(int(np.argmax(ratio)), ratio.shape)
    worst = float(ratio[index])
    bound = float(np.broadcast_to(stated, error.shape)[index])
    return Difference(
        path,
        "differs" if worst > 1.0 else "equal",
        ratio=worst,
        error=float(error[index]),
        value=float(a[index]),
        expected=float(b[index]),
        time=float(times[index[0]]) if times is not None else None,
        column=_column(expected, index),
        unit=_unit(expected, index),
        stated=None if np.isnan(bound) else bound,
        within_stated=None if np.isnan(bound) else not np.any(beyond(error, stated)),
    )


def _unit(variable: Variable, index: Sequence[Any]) -> str:
    """Return the unit of the column of an entry."""
    units = units_of(variable) if variable.data.ndim else [variable.units]
    return units[index[-1]] if variable.data.ndim > 1 else units[0]


def _column(variable: Variable, index: Sequence[Any]) -> str:
    """Return the name of the column of an entry; of what has neither columns nor time its row, ``run 12``."""
    if variable.names:
        return variable.names[index[-1]]
    first = variable.dims[0] if variable.dims else "time"
    return "" if first == "time" else f"{first} {index[0]}"
