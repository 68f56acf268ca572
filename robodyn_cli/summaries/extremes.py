"""The smallest, the largest and the last values of columns over a run, for those that were asked for."""

from __future__ import annotations

from collections.abc import Sequence

from robodyn_cli.record import record
from robodyn_cli.summaries.facts import ABSENT, COLUMN, RATE, Absent, UnitOf, fact


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
class Fluctuation:
    """How much the rate of a joint fluctuates over a run."""

    coefficient: float | None = fact(
        "coefficient of fluctuation of speed: largest less smallest rate over the middle of both; `null` where it "
        "stands still or turns back",
        errors=(".error",),
    )
    error: float | None = fact("error of the coefficient")
    mean: float = fact("middle of the largest and the smallest rate", RATE, errors=(".mean_error",))
    mean_error: float | None = fact("error of this rate", RATE)

    @staticmethod
    def of(rate: Extremes) -> Fluctuation:
        """Return the fluctuation of a rate with these extremes: C = (w_max - w_min) / ((w_max + w_min) / 2)."""
        low, high, (low_off, high_off) = (
            rate.smallest,
            rate.largest,
            (rate.errors.smallest, rate.errors.largest),
        )
        mean = 0.5 * (low + high)
        off = None if low_off is None or high_off is None else 0.5 * (low_off + high_off)
        if low <= 0.0 <= high:
            return Fluctuation(None, None, mean, off)
        coefficient = (high - low) / abs(mean)
        error = None if off is None else off * (2.0 + coefficient) / max(abs(mean) - off, 1e-300)
        return Fluctuation(coefficient, error, mean, off)


@record
class RunExtremes:
    """The extremes of a motion that was integrated, and what follows from them."""

    extremes: dict[str, Extremes] = fact(OF_COLUMNS, names=COLUMN)
    fluctuation: dict[str, Fluctuation] | Absent = fact("of joints in `simulate.fluctuation`", default=ABSENT)

    @staticmethod
    def of(extremes: dict[str, Extremes], turning: Sequence[str]) -> RunExtremes:
        """Return the records of extremes, with the fluctuation of joints whose rates are among them."""
        found = {name: Fluctuation.of(extremes[f"qd.{name}"]) for name in turning}
        return RunExtremes(extremes, found or ABSENT)
