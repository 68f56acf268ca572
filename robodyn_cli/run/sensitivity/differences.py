"""Derivatives by central differences with Richardson's extrapolation, for what has no exact ones.

    D(h) = (y(k + h) - y(k - h)) / 2 h = y' + c_2 h^2 + c_4 h^4 + ...

Each column of the table takes one more power out (Ridders 1982, "Accurate computation of F'(x) and F'(x) F''(x)", Adv.
Eng. Software 4). The entry is taken whose estimated error is smallest: how it differs from its neighbours, and what the
errors of the runs leave in it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from robodyn_cli.run.sensitivity.asked import Asked
from robodyn_cli.run.sensitivity.slope import DIFFERENCES, Slope
from robodyn_cli.run.study.row import Row, Task
from robodyn_cli.run.study.runs import run_all
from robodyn_cli.spatial.algebra import Array

WIDEST = 1e-2  # part of a key's value by which it is changed at most
NARROWER = 4.0  # from one change to the next
LEVELS = 5
ROUNDING = 2e-16  # of an output, which no run tells


def differences(asked: Asked, key: int, jobs: int) -> list[Slope]:
    """Return the derivatives of all outputs by one key."""
    task, name, value = asked.task, asked.task.keys[key], asked.values[key]
    if "#" in name:  # no option sets a number of a formula
        reason = "a number of a formula varies in exact derivatives only; make it one of `parameters`"
        return [Slope(math.nan, math.nan, DIFFERENCES, reason)] * len(task.outputs)
    own = Task(task.family, task.command, (name,), task.outputs)
    steps = [WIDEST * (abs(value) or 1.0) / NARROWER**level for level in range(LEVELS)]
    points = [(value + sign * step,) for step in steps for sign in (1.0, -1.0)]
    rows = {row.values: row for some in run_all(own, points, jobs) for row in some}
    pairs = [(rows[high], rows[low]) for high, low in zip(points[::2], points[1::2])]
    return [_extrapolated(pairs, k) for k in range(len(task.outputs))]


def _extrapolated(pairs: Sequence[tuple[Row, Row]], output: int) -> Slope:
    """Return the derivative of one output from runs on both sides."""
    good = [
        (high, low) for high, low in pairs
        if not high.code and not low.code and all(math.isfinite(row.outputs[output]) for row in (high, low))
    ]  # fmt: skip
    # runs at wide steps may fail, but what is extrapolated follows without a gap
    good = [pair for pair in pairs[len(pairs) - len(good) :] if pair in good]
    if len(good) < 2:
        reason = next(
            (row.reason for pair in pairs for row in pair if row.code), "the output is no number there"
        )
        return Slope(math.nan, math.nan, DIFFERENCES, reason)
    value, error = _ridders(good, output)
    return Slope(value, error, DIFFERENCES)


def _ridders(pairs: Sequence[tuple[Row, Row]], output: int) -> tuple[float, float]:
    """Return the best entry of the table and its estimated error."""
    raw, noise = np.array([_difference(high, low, output) for high, low in pairs]).T
    best, least = float(raw[-1]), math.inf
    column: Array = raw
    for power in range(1, len(raw)):
        factor = NARROWER ** (2 * power)
        finer = (factor * column[1:] - column[:-1]) / (factor - 1.0)
        for k, value in enumerate(finer):
            apart = max(abs(value - column[k]), abs(value - column[k + 1]))
            error = apart + noise[k + power] * factor / (factor - 1.0)
            if error < least:
                best, least = float(value), float(error)
        column = finer
    return best, least


def _difference(high: Row, low: Row, output: int) -> tuple[float, float]:
    """Return a central difference, and what the errors of both runs leave in it."""
    step = high.values[0] - low.values[0]
    ends = [row.outputs[output] for row in (high, low)]
    told = [0.0 if math.isnan(row.errors[output]) else row.errors[output] for row in (high, low)]
    left = sum(max(error, ROUNDING * abs(y)) for error, y in zip(told, ends))
    return (ends[0] - ends[1]) / step, left / abs(step)
