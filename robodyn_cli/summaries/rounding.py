"""A number with its error as both are printed everywhere: on the terminal, on pages, in notebooks and comparisons."""

from __future__ import annotations

import math
from collections.abc import Sequence
from decimal import ROUND_HALF_UP, Decimal

from robodyn_cli.summaries.facts import rounded_up

DOUBLE = 15  # digits of a number behind its first


def within(values: Sequence[float], error: float) -> tuple[list[str], str]:
    """Return numbers that share an error with the digits that it leaves, and the error in one digit.

    The printed error covers what rounding takes away, so that the printed interval holds the one that is stated. One
    that is 0 leaves all digits. Halves are rounded away from zero, as the script of a page does (``stated`` in
    ``report/page/words.js``).
    """
    if not error > 0.0:
        return [f"{x + 0.0:.{DOUBLE}g}" for x in values], "0"
    last = max(math.floor(math.log10(error)), *(place_of(x) - DOUBLE for x in values))
    kept = [float(Decimal(x).quantize(Decimal(1).scaleb(last), ROUND_HALF_UP)) for x in values]
    off = rounded_up(error + max(abs(x - y) for x, y in zip(values, kept)), 1)
    return [_with_place(x, last) for x in kept], _with_place(off, place_of(off))


def place_of(x: float) -> int:
    """Return the power of ten of the first digit of a number."""
    return math.floor(math.log10(abs(x))) if x else -400


def _with_place(x: float, last: int) -> str:
    """Return a number whose last digit is that of ten to the power ``last``."""
    if x == 0.0:
        return "0"
    first = place_of(x)
    if (first >= -4 or last >= -4) and last < 4 and first < DOUBLE:
        return f"{x:.{max(0, -last)}f}"
    return f"{x:.{max(0, first - last)}e}".replace("e+00", "")
