"""Derivatives of figures of sampled arrays, along the derivatives of the arrays.

    d figure / dk = d figure(y + s dy/dk) / ds  at s = 0

Peaks, ranges and integrals are formulas of the samples, so central differences with extrapolation give this to
rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from robodyn_cli.over.batch.criteria import lookup_number
from robodyn_cli.over.sensitivity.asked import AskedSlopes
from robodyn_cli.over.sensitivity.differences import NARROWER, extrapolated
from robodyn_cli.over.sensitivity.slope import EXACT, Slope
from robodyn_cli.results.summary import as_keys
from robodyn_cli.spatial.algebra import Array

WIDEST = 5e-3  # part of the arrays by which they are changed at most
LEVELS = 4
ALL, ODD = 1, (-1, 2)  # which samples to take, see ``every_second``
ESTIMATES = ("error_estimate.",)
NOTHING = 1e-6  # part of a key, by which a change cannot be as large as all of an array
ROUNDING = 1e-15  # of a figure of many samples
SOLVED = 1e-12  # of arrays, in which the solution of their equations is exact


# the summary record for a key, by its number, changed by so much, from every n-th sample
Give = Callable[[int, float, int], Any]


def slopes_along(
    asked: AskedSlopes, numbers: Sequence[int], give: Give, arrays: Sequence[tuple[Array, Array]]
) -> dict[str, list[Slope]]:
    """Return the derivatives of those outputs that a summary record has, by some keys.

    Parameters
    ----------
    give : the record, for a key by its place among ``numbers``. arrays : what it follows from (T, n), with derivatives
        (T, n, K).
    """
    keys = as_keys(give(0, 0.0, 1))
    wanted = asked.task.outputs
    own = [
        name for name in wanted if not name.startswith(ESTIMATES) and lookup_number(keys, name) is not None
    ]
    found: dict[str, list[Slope]] = {name: [] for name in own}
    for k, number in enumerate(numbers):
        scale = abs(asked.values[number]) or 1.0
        step = _step([(y, change[..., k]) for y, change in arrays], scale)
        for name, slope in zip(own, _slopes(own, partial(give, k), step)):
            found[name].append(slope)
    return found


def _step(arrays: Sequence[tuple[Array, Array]], scale: float) -> float:
    """Return the largest change of a key of this size that changes no array much.

    Arrays that are zero but for rounding say nothing about it.
    """
    sizes = [
        (float(np.abs(y).max(initial=0.0)), float(np.abs(slope).max(initial=0.0))) for y, slope in arrays
    ]
    parts = [y / slope for y, slope in sizes if slope and y / slope > NOTHING * scale]
    return WIDEST * min([scale, *parts])


def _slopes(outputs: Sequence[str], give: Callable[[float, int], Any], step: float) -> list[Slope]:
    """Return the derivatives of outputs by one key, changed by at most ``step``.

    How they differ with every second sample tells how much of them is due to the samples, between which a peak may lie.
    """
    steps = np.array([step / NARROWER**level for level in range(LEVELS)])
    sides = np.array([[_numbers(outputs, give(way * x, 1)) for way in (1.0, -1.0)] for x in steps])
    raw = (sides[:, 0] - sides[:, 1]) / (2.0 * steps[:, None])
    size = np.where(
        np.any(raw, axis=0), np.abs(sides).max(axis=(0, 1)), 0.0
    )  # a figure that stays has no rounding
    values, errors = extrapolated(raw, ROUNDING * size / steps[:, None])
    there = np.array(
        [[_numbers(outputs, give(way * steps[1], every)) for way in (1.0, -1.0)] for every in ODD]
    )
    fine, coarse = there[:, 0] - there[:, 1]
    sampled = np.abs(coarse - fine) / (2.0 * steps[1])
    solved = SOLVED * np.maximum(np.abs(values), size * WIDEST / step)
    return [Slope(float(y), float(e), EXACT) for y, e in zip(values, errors + sampled + solved)]


def every_second(samples: int, every: int) -> slice:
    """Return which samples to take: all, or, of an odd number of them, each (-1) or every second one (2)."""
    if every == ALL or samples < 3:
        return slice(None)
    return slice((samples + 1) % 2, None, 1 if every == ODD[0] else 2)


def _numbers(outputs: Sequence[str], record: Any) -> list[float]:
    keys = as_keys(record)
    return [np.nan if (x := lookup_number(keys, name)) is None else x for name in outputs]
