"""What ``--json`` prints of comparisons: the fields are the documented keys."""

from __future__ import annotations

from collections.abc import Sequence

from robodyn_cli.exit_codes import worst
from robodyn_cli.over.batch.trees import Compared
from robodyn_cli.record import record
from robodyn_cli.results.compare import Comparison, Difference
from robodyn_cli.results.summary import ABSENT, Absent


@record
class DatasetReport:
    """How one dataset compares, as reports have it: the worst sample where values were compared, else the detail."""

    path: str
    verdict: str
    error: float | Absent = ABSENT
    ratio: float | Absent = ABSENT
    value: float | Absent = ABSENT
    expected: float | Absent = ABSENT
    time: float | Absent | None = ABSENT
    column: str | Absent | None = ABSENT
    stated: float | Absent | None = ABSENT
    within_stated: bool | Absent | None = ABSENT
    detail: str | Absent = ABSENT

    @staticmethod
    def of(item: Difference) -> DatasetReport:
        if item.verdict not in ("equal", "differs"):
            return DatasetReport(item.path, item.verdict, detail=item.detail or ABSENT)
        return DatasetReport(
            item.path, item.verdict, item.error, item.ratio, item.value, item.expected, item.time,
            item.column or None, item.stated, item.within_stated,
        )  # fmt: skip


@record
class ComparisonReport:
    """What ``compare`` says of two results."""

    status: str
    rtol: float
    atol: float
    datasets: Sequence[DatasetReport]

    @staticmethod
    def of(found: Comparison, rtol: float, atol: float) -> ComparisonReport:
        return ComparisonReport(
            "ok" if found.agrees else "failed",
            rtol,
            atol,
            [DatasetReport.of(item) for item in found.differences],
        )


@record
class ResultReport:
    """How one result compares with its baseline; ``datasets`` : those that differ, worst first."""

    result: str
    verdict: str
    message: str | None
    datasets: Sequence[DatasetReport]

    @staticmethod
    def of(item: Compared) -> ResultReport:
        return ResultReport(
            item.name, item.verdict, item.message or None, [DatasetReport.of(one) for one in item.differing]
        )


@record
class TreeReport:
    """What ``compare`` says of two directories with results."""

    status: str
    exit_code: int
    rtol: float
    atol: float
    results: Sequence[ResultReport]

    @staticmethod
    def of(found: Sequence[Compared], rtol: float, atol: float) -> TreeReport:
        code = worst(item.exit_code for item in found)
        return TreeReport(
            "failed" if code else "ok", code, rtol, atol, [ResultReport.of(item) for item in found]
        )


@record
class BaselineReport:
    """How the result of a scene compares with the stored one in ``directory``, and whether that was replaced by it."""

    directory: str
    verdict: str
    message: str | None
    rtol: float
    atol: float
    datasets: Sequence[DatasetReport]
    updated: bool = False
