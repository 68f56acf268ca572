"""Derivatives of figures of sampled arrays, along the derivatives of the arrays.

    d figure / dk = d figure(y + s dy/dk) / ds  at s = 0

Peaks, ranges and integrals are formulas of the samples, so central differences with extrapolation give this to rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from robodyn_cli.results.summary import as_keys
from robodyn_cli.run.batch.criteria import lookup_number
from robodyn_cli.run.sensitivity.differences import NARROWER, extrapolated
from robodyn_cli.run.sensitivity.slope import EXACT, Slope
from robodyn_cli.spatial.algebra import Array

WIDEST = 5e-3  # part of the arrays by which they are changed at most
LEVELS = 4
ESTIMATES = ("error_estimate.",)
NOTHING = 1e-6  # part of a key, by which a change cannot be as large as all of an array
ROUNDING = 1e-15  # of a figure of many samples
SOLVED = 1e-12  # of arrays, in which the solution of their equations is exact


def step_along(arrays: Iterable[tuple[Array, Array]], scale: float) -> float:
    """Return the largest change of a key of this size that changes no array (T, n) much, from pairs with derivatives.

    Arrays that are zero but for rounding say nothing about it.
    """
    sizes = [(float(np.abs(y).max(initial=0.0)), float(np.abs(slope).max(initial=0.0))) for y, slope in arrays]
    parts = [y / slope for y, slope in sizes if slope and y / slope > NOTHING * scale]
    return WIDEST * min([scale, *parts])


def known_outputs(outputs: Sequence[str], record: Any) -> list[str]:
    """Return the outputs that are numbers of a summary record, estimates of errors left out."""
    keys = as_keys(record)
    return [n for n in outputs if not n.startswith(ESTIMATES) and lookup_number(keys, n) is not None]


def figure_slopes(outputs: Sequence[str], give: Callable[[float], Any], step: float) -> list[Slope]:
    """Return the derivatives of figures by one key.

    Parameters
    ----------
    give : the summary record for a key changed by so much. step : the largest change.
    """
    steps = np.array([step / NARROWER**level for level in range(LEVELS)])
    sides = np.array([[_numbers(outputs, give(way * x)) for way in (1.0, -1.0)] for x in steps])
    raw = (sides[:, 0] - sides[:, 1]) / (2.0 * steps[:, None])
    size = np.where(np.any(raw, axis=0), np.abs(sides).max(axis=(0, 1)), 0.0)  # a figure that stays has no rounding
    values, errors = extrapolated(raw, ROUNDING * size / steps[:, None])
    solved = SOLVED * np.maximum(np.abs(values), size * WIDEST / step)
    return [Slope(float(y), float(e), EXACT) for y, e in zip(values, errors + solved)]


def _numbers(outputs: Sequence[str], record: Any) -> list[float]:
    keys = as_keys(record)
    return [np.nan if (x := lookup_number(keys, name)) is None else x for name in outputs]
