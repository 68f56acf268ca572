"""One derivative and how it was obtained; derivatives by central differences with Richardson's extrapolation, for what
has no exact ones.

    D(h) = (y(k + h) - y(k - h)) / 2 h = y' + c_2 h^2 + c_4 h^4 + ...

Each column of the table takes one more power out (Ridders 1982, "Accurate computation of F'(x) and F'(x) F''(x)", Adv.
Eng. Software 4). The entry is taken whose estimated error is smallest: how it differs from its neighbours, and what the
errors of the runs leave in it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.commands import COMMANDS
from robodyn_cli.over.many.structure import times_vary
from robodyn_cli.over.sensitivity.asked import AskedSlopes
from robodyn_cli.over.study.rows import Points, Task
from robodyn_cli.over.study.runs import run_points
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.deploy import GROWTH
from robodyn_cli.summaries.keys import leaf_of
from robodyn_cli.tools.progress import Progress, no_progress

EXACT, DIFFERENCES = "exact", "differences"


@record
class Slope:
    """d output / d key in SI units, its estimated error, and the method; nan with a ``reason`` where there is none."""

    value: float
    error: float
    method: str
    reason: str = ""

    def times(self, scale: float) -> Slope:
        """Return the derivative by a key of which ``scale`` times its values is what this one is by."""
        return Slope(scale * self.value, abs(scale) * self.error, self.method, self.reason)


def is_time_of_sample(command: str, output: str) -> bool:
    """Tell whether an output is the time of a sample on a grid, which stays or jumps when a key changes."""
    leaf = leaf_of(command, output)
    return leaf is not None and GROWTH in leaf.errors


def why_not(command: str, output: str) -> str:
    """Return why an output has no exact derivatives."""
    leaf = leaf_of(command, output)
    if leaf is not None and leaf.fact.about_run:
        return f"{output} tells how the run went, not what the mechanism does"
    return f"{output} has no exact derivatives"


WIDEST = 1e-2  # part of a key's value by which it is changed at most
NARROWER = 4.0  # from one change to the next
LEVELS = 5
POOR = 1e-2  # part of a derivative that its error is at most where steps are narrow enough
CONVERGES = 0.5  # times the distance of two differences before is that of the finest ones at most
ROUNDING = 2e-16  # of an output, which no run tells
SIDES = (1.0, -1.0)


def differences(
    asked: AskedSlopes, keys: Sequence[int], jobs: int, progress: Progress = no_progress
) -> dict[int, list[Slope]]:
    """Return the derivatives of all outputs by some keys, which are named by their numbers."""
    by_key: dict[int, list[Slope]] = {}
    # keys that may move times keep runs out of compiled code
    for moves in (False, True):
        if some := [k for k in keys if times_vary([asked.keys[k]]) == moves]:
            by_key.update(_together(asked, some, jobs, progress))
    return by_key


def _together(
    asked: AskedSlopes, keys: Sequence[int], jobs: int, progress: Progress
) -> dict[int, list[Slope]]:
    """Return the derivatives by some keys, from runs of one study, with narrower changes where all are too wide."""
    sides = _sides(asked, keys, keys, 0, jobs, progress)
    outputs = range(len(asked.task.outputs))
    if wide := [k for k in keys if any(sides[k].is_too_wide(output) for output in outputs)]:
        narrower = _sides(asked, keys, wide, LEVELS, jobs, progress)
        sides |= {k: sides[k].beside(narrower[k]) for k in wide}
    return {k: [own.slope(output) for output in outputs] for k, own in sides.items()}


def _sides(
    asked: AskedSlopes, keys: Sequence[int], varied: Sequence[int], first: int, jobs: int, progress: Progress
) -> dict[int, Sides]:
    """Return runs at changes of each varied key, one of those of a study, from so many levels below the widest on."""
    task = Task(
        asked.task.family, asked.task.command, tuple(asked.task.keys[k] for k in keys), asked.task.outputs
    )
    points = np.tile([asked.values[k] for k in keys], (len(varied), LEVELS, 2, 1))
    columns = [keys.index(k) for k in varied]
    for place, (k, column) in enumerate(zip(varied, columns)):
        widest = WIDEST * (abs(asked.values[k]) or 1.0)
        steps = widest / NARROWER ** np.arange(first, first + LEVELS)
        points[place, :, :, column] += np.outer(steps, SIDES)
    numbers = np.arange(points.size // len(keys))
    made = run_points(task, Points(numbers, points.reshape(-1, len(keys))), jobs, progress=progress)
    rows = np.empty_like(made.rows)
    rows[made.runs] = made.rows
    integrated = COMMANDS[task.command].streamed
    found = {}
    for place, (k, column, own) in enumerate(zip(varied, columns, numbers.reshape(-1, LEVELS, 2))):
        why = [made.reasons[run] for run in own.flat if run in made.reasons]
        scale = 0.0 if integrated else 1.0 / (abs(asked.values[k]) or 1.0)
        found[k] = Sides(points[place, :, :, column], rows[own], why[0] if why else "", scale)
    return found


@record
class Sides:
    """Runs on both sides of a key, from the widest step on: values and what they gave (L, 2); why one failed.

    smooth : where no steps of an integration are chosen, errors of figures, which the samples make, change with a key
    as much as the figures do: by this part of them. 0 : each run has errors of its own.
    """

    values: Array
    rows: NDArray[Any]
    reason: str
    smooth: float = 0.0

    def beside(self, narrower: Sides) -> Sides:
        """Return these runs with those at narrower steps behind them."""
        values, rows = (
            np.concatenate([getattr(x, name) for x in (self, narrower)]) for name in ("values", "rows")
        )
        return Sides(values, rows, self.reason or narrower.reason, self.smooth)

    def slope(self, output: int) -> Slope:
        """Return the derivative of one output."""
        raw, noise, common = self._differences(output)
        if len(raw) < 2:
            return Slope(math.nan, math.nan, DIFFERENCES, self.reason or "the output is no number nearby")
        value, error = extrapolated(raw, noise)
        return Slope(float(value), float(error) + common, DIFFERENCES)

    def is_too_wide(self, output: int) -> bool:
        """Tell whether the derivative of an output is not known well, and narrower steps would say more."""
        raw, noise, _ = self._differences(output)
        if len(raw) < 2:
            return len(raw) == 1
        value, error = extrapolated(raw, noise)
        return bool(error > POOR * abs(value) and noise[-1] * NARROWER < POOR * error)

    def _differences(self, output: int) -> tuple[Array, Array, float]:
        """Return central differences from the widest step on (L,), what the errors of the runs leave in them (L,), and
        an error that all share."""
        y, told = self.rows["outputs"][:, :, output], self.rows["errors"][:, :, output]
        good = ((self.rows["code"] == 0) & np.isfinite(y)).all(axis=1)
        # runs at wide steps may fail, but what is extrapolated follows without a gap
        first = len(y) - int(np.argmin([*good[::-1], False]))
        if first == len(y):
            return np.empty(0), np.empty(0), 0.0
        steps = self.values[first:, 0] - self.values[first:, 1]
        told = np.nan_to_num(told[first:])
        own = np.abs(told - told.mean()) if self.smooth else told
        noise = np.maximum(own, ROUNDING * np.abs(y[first:])).sum(axis=1)
        raw: Array = (y[first:, 0] - y[first:, 1]) / steps
        return raw, noise / steps, float(told.mean()) * self.smooth


def extrapolated(raw: Array, noise: Array) -> tuple[Array, Array]:
    """Return the best entry of the table that begins with central differences, and its estimated error.

    Parameters
    ----------
    raw : differences (levels, ...), each with a step ``NARROWER`` times smaller than the one before. noise : what the
        errors of the values leave in each.

    Where the finest differences do not come nearer to each other, an entry may agree with its neighbours by chance: it
    is known no better than it differs from these.
    """
    best, least, column = raw[-1], np.full(raw.shape[1:], np.inf), raw
    for power in range(1, len(raw)):
        factor = NARROWER ** (2 * power)
        finer = (factor * column[1:] - column[:-1]) / (factor - 1.0)
        for k, value in enumerate(finer):
            apart = np.maximum(np.abs(value - column[k]), np.abs(value - column[k + 1]))
            error = apart + noise[k + power] * factor / (factor - 1.0)
            best, least = np.where(error < least, value, best), np.minimum(error, least)
        column = finer
    if len(raw) > 2:
        last, before = np.abs(raw[-1] - raw[-2]), np.abs(raw[-2] - raw[-3])
        apart = np.maximum(np.abs(best - raw[-1]), np.abs(best - raw[-2]))
        wild = (last > CONVERGES * before) & (last > noise[-1] + noise[-2])
        least = np.where(wild, np.maximum(least, apart), least)
    return best, least
