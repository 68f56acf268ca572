"""Limits that may differ by direction: a number > 0, either way, or [low, high]."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.schema.fields import Either, Number, Vector

Array = NDArray[np.float64]
Span = float | tuple[float, float]


SPAN = Either((Number(minimum=0.0, exclusive=True), Vector(2)))  # the kind of such a limit


def sides(limit: Span) -> tuple[float, float]:
    """Return the least and the largest value that a limit allows."""
    return limit if isinstance(limit, tuple) else (-limit, limit)


def either_way(limit: Span) -> float:
    """Return what a limit allows in both directions."""
    low, high = sides(limit)
    return min(-low, high)


def span_fault(limit: Span, with_zero: bool) -> str:
    """Return what is wrong with a limit, nothing if it is right. with_zero : it has to allow both directions."""
    low, high = sides(limit)
    if with_zero and not low < 0.0 < high:
        return f"must be [low, high] with low < 0 < high (value [{low:.6g}, {high:.6g}])"
    return "" if low < high else f"must be [low, high] with low < high (value [{low:.6g}, {high:.6g}])"


def span_text(limit: Span) -> str:
    """Return a limit in words: its number, or its range."""
    return f"{limit[0]:.6g} to {limit[1]:.6g}" if isinstance(limit, tuple) else f"{limit:.6g}"


def use_of(values: Array, limit: Span) -> Array:
    """Return the part of a limit that values (T,) use: 1 on it.

    Of the side on which a value lies; where zero is not allowed, of half of the range, from its middle.
    """
    low, high = sides(limit)
    if low < 0.0 < high:
        return np.asarray(values / np.where(values < 0.0, low, high))
    return np.asarray(np.abs(values - 0.5 * (low + high)) / (0.5 * (high - low)))
