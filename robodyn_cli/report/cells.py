"""Small tables of text, and numbers in them with their errors."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any

from robodyn_cli.record import record
from robodyn_cli.summaries.rounding import within

DIGITS = 6  # of a number whose error is not known


@record
class Figure:
    """A number of a table, the error that is stated of it, and its unit; None with ``infinite`` is no limit."""

    value: Any
    error: Any = None
    unit: str = ""
    infinite: bool = False

    def __str__(self) -> str:
        return self.number + (spaced(self.unit) if is_number(self.value) else "")

    @property
    def number(self) -> str:
        """The number with its error, without its unit: ``12.28 ± 0.02``."""
        if not is_number(self.value):
            absent = "no limit" if self.infinite else "-"
            return absent if self.value is None else str(self.value)
        if not is_number(self.error):
            return f"{self.value + 0.0:.{DIGITS}g}"  # -0.0 is 0
        (kept,), off = within([float(self.value)], float(self.error))
        return f"{kept} ± {off}"


@record
class Table:
    """A table of text and figures; the first column names its rows. told : what its columns are, by their heads, where
    these do not say it."""

    head: Sequence[str]
    rows: Sequence[Sequence[str | Figure]]
    told: Mapping[str, str] = dataclasses.field(default_factory=dict)

    @property
    def meaning(self) -> str:
        """What the columns are, in a sentence."""
        return "; ".join(f"{head}: {doc}" for head, doc in self.told.items())


def figure(value: Any, error: Any = None, unit: str = "") -> str:
    """Return a number, its error where one is known, and its unit if it has one: ``12.2829956 ± 5e-7 s``."""
    return str(Figure(value, error, unit))


def spaced(unit: str) -> str:
    return f" {unit}" if unit not in ("", "1") else ""


def is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
