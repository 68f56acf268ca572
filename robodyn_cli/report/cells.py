"""Small tables of text, and numbers in them with their errors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from robodyn_cli.record import record
from robodyn_cli.summaries.facts import rounded_up

MOST_DIGITS = 10  # of a number with its error; more are hard to read


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
    if not is_number(error):
        return f"{value:.6g}{spaced(unit)}"
    digits = _digits(abs(float(value)), float(error))
    text = f"{float(f'{value:.{digits}g}'):.{MOST_DIGITS}g}" if digits else "0"
    off = 0.0 if digits else abs(float(value))  # it is in the error
    return f"{text} ± {float(f'{rounded_up(float(error) + off, 1):.1g}'):g}{spaced(unit)}"


def spaced(unit: str) -> str:
    return f" {unit}" if unit not in ("", "1") else ""


def _digits(size: float, error: float) -> int:
    """Return how many digits of a number its error leaves, and one more; none where it is ten times the number."""
    if size == 0.0 or not error > 0.0:
        return MOST_DIGITS
    places = math.ceil(math.log10(size / error))
    return min(MOST_DIGITS, max(1, 2 + places)) if places > -1 else 0


def is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
