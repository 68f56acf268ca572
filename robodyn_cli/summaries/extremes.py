"""The smallest, the largest and the last values of columns over a run, for those that were asked for."""

from __future__ import annotations

from robodyn_cli.record import record
from robodyn_cli.summaries.facts import COLUMN, UnitOf, fact


@record
class UnitOfColumn(UnitOf):
    """The unit of a column over time, which the map around a field names."""

    def __call__(self, coordinate: str = "") -> str:
        return coordinate or str(self)

    def __str__(self) -> str:
        return "that of the column"


OF_COLUMN = UnitOfColumn("", "")


@record
class ExtremeErrors:
    """Errors of the extremes of a column; `null` where the second run has no such figure."""

    smallest: float | None = fact("of the smallest value", OF_COLUMN)
    smallest_time: float | None = fact("of its time", "s")
    largest: float | None = fact("of the largest value", OF_COLUMN)
    largest_time: float | None = fact("of its time", "s")
    final: float | None = fact("of the last value", OF_COLUMN)


@record
class Extremes:
    """The smallest and the largest value of a column over a run, between samples too, and the last one."""

    smallest: float = fact("smallest value", OF_COLUMN, errors=(".errors.smallest",), column="smallest")
    smallest_time: float = fact("when it is smallest", "s", errors=(".errors.smallest_time",), column="at")
    largest: float = fact("largest value", OF_COLUMN, errors=(".errors.largest",), column="largest")
    largest_time: float = fact("when it is largest", "s", errors=(".errors.largest_time",), column="at")
    final: float = fact("value at the end", OF_COLUMN, errors=(".errors.final",), column="final")
    errors: ExtremeErrors = fact("errors of these figures")
    unit: str = fact("unit of the values")


OF_COLUMNS = "of columns over time that `expect`, `--of` or `outputs.extremes` ask for"


@record
class RunExtremes:
    """The extremes of a motion that was integrated."""

    extremes: dict[str, Extremes] = fact(OF_COLUMNS, names=COLUMN)
