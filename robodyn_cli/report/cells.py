"""Small tables of text, and numbers in them with their errors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from robodyn_cli.record import record
from robodyn_cli.summaries.facts import rounded_up


@record
class Table:
    """A table of text; the first column names its rows. meaning : what its columns are, where heads do not say it."""

    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    meaning: str = ""


def figure(value: Any, error: Any = None, unit: str = "") -> str:
    """Return a number, its error where one is known, and its unit if it has one: ``12.2829956 ± 5e-13 s``."""
    if not is_number(value):
        return "-" if value is None else str(value)
    known = is_number(error)
    text = f"{value:.{_digits(abs(float(value)), float(error)) if known else 6}g}"
    return f"{text}{f' ± {rounded_up(float(error), 1):.1g}' if known else ''}{spaced(unit)}"


def spaced(unit: str) -> str:
    return f" {unit}" if unit not in ("", "1") else ""


def _digits(size: float, error: float) -> int:
    """Return how many digits of a number its error leaves: 6 to 10, for more are hard to read."""
    if size == 0.0 or not error > 0.0:
        return 10
    return min(10, max(6, math.ceil(math.log10(size / error))))


def is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
