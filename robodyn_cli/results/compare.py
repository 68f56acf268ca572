"""Compare two results dataset by dataset."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence

import numpy as np

from robodyn_cli.record import record
from robodyn_cli.results.result import Result, Variable
from robodyn_cli.results.summary import ABSENT, Absent
from robodyn_cli.spatial.algebra import Array


@record
class Difference:
    """How one dataset compares with the baseline.

    ``verdict`` is ``"equal"`` (within tolerance), ``"differs"``, ``"missing"`` (only in the baseline),
    ``"extra"`` (only in the result), ``"shape"``, ``"units"``, ``"names"``, or ``"entries"`` of a dataset that holds
    no numbers. The other fields describe the worst sample: ``ratio`` is its error over what is allowed there.
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


@record
class Comparison:
    """All differences, worst first; ``agrees`` tells whether every dataset of the baseline was met."""

    differences: tuple[Difference, ...]

    @property
    def agrees(self) -> bool:
        """Whether nothing differs; datasets that only the new result has are no failure."""
        return all(item.verdict in ("equal", "extra") for item in self.differences)


@record
class DatasetReport:
    """How one dataset compares, as reports have it: the worst sample where values were compared, else the detail."""

    path: str
    verdict: str
    error: float | Absent = ABSENT
    ratio: float | Absent = ABSENT
    value: float | Absent = ABSENT
    expected: float | Absent = ABSENT
    time: float | Absent | None = ABSENT
    column: str | Absent | None = ABSENT
    detail: str | Absent = ABSENT

    @staticmethod
    def of(item: Difference) -> DatasetReport:
        if item.verdict in ("equal", "differs"):
            worst = item.error, item.ratio, item.value, item.expected, item.time, item.column or None
            return DatasetReport(item.path, item.verdict, *worst)
        return DatasetReport(item.path, item.verdict, detail=item.detail or ABSENT)


@record
class ComparisonReport:
    """What ``compare --json`` prints: the fields are the documented keys."""

    status: str
    rtol: float
    atol: float
    datasets: Sequence[DatasetReport]

    @staticmethod
    def of(found: Comparison, rtol: float, atol: float) -> ComparisonReport:
        rows = [DatasetReport.of(item) for item in found.differences]
        return ComparisonReport("ok" if found.agrees else "failed", rtol, atol, rows)


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
    is no trap) or the baseline's value at each sample (``"sample"``).
    """
    if relative_to not in ("peak", "sample"):
        raise ValueError(f"relative_to is {relative_to!r}; allowed are 'peak' and 'sample'")
    tolerance = _Tolerance(rtol, atol, relative_to)
    found = [Difference(path, "extra") for path in result.variables if path not in baseline.variables]
    for path, expected in baseline.variables.items():
        if path not in result.variables:
            found.append(Difference(path, "missing"))
            continue
        actual = result.variables[path]
        reason = _mismatch(actual, expected)
        if reason is not None:
            found.append(Difference(path, *reason))
        else:
            found.append(_worst(result, path, actual, expected, tolerance))
    found += _others(result.others, baseline.others)
    found += _events(result, baseline, _Tolerance(rtol, atol))
    rank = {
        "missing": 0,
        "shape": 0,
        "units": 0,
        "names": 0,
        "entries": 0,
        "differs": 1,
        "equal": 2,
        "extra": 3,
    }
    return Comparison(tuple(sorted(found, key=lambda item: (rank[item.verdict], -item.ratio, item.path))))


def _others(
    result: Mapping[str, tuple[str, ...]], baseline: Mapping[str, tuple[str, ...]]
) -> list[Difference]:
    """Compare the datasets without numbers: entry by entry, equal or not."""
    found = [Difference(path, "extra") for path in result if path not in baseline]
    for path, expected in baseline.items():
        actual = result.get(path)
        if actual is None:
            found.append(Difference(path, "missing"))
        elif len(actual) != len(expected):
            found.append(Difference(path, "shape", f"{len(actual)} entries instead of {len(expected)}"))
        elif actual != expected:
            k = next(k for k, (a, b) in enumerate(zip(actual, expected)) if a != b)
            found.append(
                Difference(path, "entries", f"{actual[k]!r} instead of {expected[k]!r} as number {k}")
            )
        else:
            found.append(Difference(path, "equal"))
    return found


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
    found, wanted = (Variable(x, ("event",), "s", "time of events") for x in times)
    worst = _worst(result, "events/time", found, wanted, tolerance)
    at = int(np.argmax(np.abs(times[0] - times[1])))
    return [dataclasses.replace(worst, time=float(times[1][at]), column=expected[at])]


def _mismatch(actual: Variable, expected: Variable) -> tuple[str, str] | None:
    """Return why two variables cannot be compared by value: (verdict, detail)."""
    if actual.data.shape != expected.data.shape:
        return "shape", f"{actual.data.shape} instead of {expected.data.shape}"
    if actual.units != expected.units:
        return "units", f"{actual.units} instead of {expected.units}"
    if actual.column_units != expected.column_units:
        return "units", f"{', '.join(actual.column_units)} instead of {', '.join(expected.column_units)}"
    if actual.names != expected.names:
        return "names", f"{', '.join(actual.names)} instead of {', '.join(expected.names)}"
    return None


def _worst(
    result: Result,
    path: str,
    actual: Variable,
    expected: Variable,
    tolerance: _Tolerance,
) -> Difference:
    a, b = actual.data, expected.data
    if not a.size:
        return Difference(path, "equal")
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        error = np.abs(a - b)
        # Equal infinities subtract to NaN, and a NaN where the baseline has one is agreement.
        error[(a == b) | (np.isnan(a) & np.isnan(b))] = 0.0
        error[np.isnan(error)] = np.inf
        ratio = np.divide(error, tolerance.allowed(b))
    # 0/0: no tolerance, and no difference
    ratio[error == 0.0] = 0.0
    index = np.unravel_index(int(np.argmax(ratio)), ratio.shape)
    worst = float(ratio[index])
    has_time = expected.dims[:1] == ("time",) and "time" in result
    return Difference(
        path,
        "differs" if worst > 1.0 else "equal",
        ratio=worst,
        error=float(error[index]),
        value=float(a[index]),
        expected=float(b[index]),
        time=float(result.time[index[0]]) if has_time else None,
        column=expected.names[index[-1]] if expected.names else "",
    )
