"""One derivative, and how it was found."""

from __future__ import annotations

from robodyn_cli.record import record

EXACT, DIFFERENCES = "exact", "differences"


@record
class Slope:
    """d output / d key in SI units, its estimated error, and the method; nan with a ``reason`` where there is none."""

    value: float
    error: float
    method: str
    reason: str = ""
