"""From comparisons to what ``--json`` prints of them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from robodyn_cli.exit_codes import worst
from robodyn_cli.over.batch.trees import Compared
from robodyn_cli.results.compare import Comparison, Difference
from robodyn_cli.summaries.checks import ComparisonReport, DatasetReport, ResultReport, TreeReport
from robodyn_cli.summaries.facts import ABSENT


def datasets_of(items: Iterable[Difference]) -> list[DatasetReport]:
    """Return how datasets compare."""
    return [_dataset(item) for item in items]


def _dataset(item: Difference) -> DatasetReport:
    if item.verdict not in ("equal", "differs"):
        return DatasetReport(item.path, item.verdict, detail=item.detail or ABSENT)
    return DatasetReport(
        item.path, item.verdict, item.error, item.ratio, item.value, item.expected, item.time,
        item.column or None, item.stated, item.within_stated,
    )  # fmt: skip


def comparison_of(found: Comparison, rtol: float, atol: float) -> ComparisonReport:
    """Return what ``compare`` says of two results."""
    return ComparisonReport("ok" if found.agrees else "failed", rtol, atol, datasets_of(found.differences))


def trees_of(found: Sequence[Compared], rtol: float, atol: float) -> TreeReport:
    """Return what ``compare`` says of two directories with results."""
    code = worst(item.exit_code for item in found)
    results = [
        ResultReport(item.name, item.verdict, item.message or None, datasets_of(item.differing))
        for item in found
    ]
    return TreeReport("failed" if code else "ok", code, rtol, atol, results)
