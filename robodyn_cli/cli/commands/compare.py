"""``robodyn compare``."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from robodyn_cli.cli.console import Console
from robodyn_cli.cli.options import ATOL, RTOL, AbsoluteTolerance, Quiet, RelativeTolerance, ReportAsJson
from robodyn_cli.exit_codes import FAILED

if TYPE_CHECKING:
    from robodyn_cli.run.batch.trees import Compared

PLURAL = {"equal": "agree", "differs": "differ"}
WORDS = {"missing": "only in the baseline", "extra": "only in the results"}


def command(
    result: Annotated[
        Path,
        typer.Argument(
            metavar="RESULT",
            help="Output directory of a run, its result.h5, or a directory with many.",
            show_default=False,
        ),
    ],
    baseline: Annotated[
        Path,
        typer.Argument(metavar="BASELINE", help="What it is compared with, likewise.", show_default=False),
    ],
    rtol: RelativeTolerance = RTOL,
    atol: AbsoluteTolerance = ATOL,
    as_json: ReportAsJson = False,
    quiet: Quiet = False,
) -> int:
    """Compare two stored results, or all results below two directories; return 1 where they differ."""
    from robodyn_cli.run.batch.trees import is_tree

    console = Console(as_json, quiet)
    if is_tree(result) or is_tree(baseline):
        return _trees(result, baseline, rtol, atol, console)
    return _two(result, baseline, rtol, atol, console)


def _two(result: Path, baseline: Path, rtol: float, atol: float, console: Console) -> int:
    from robodyn_cli.results.compare import compare
    from robodyn_cli.results.summary import as_keys, jsonable
    from robodyn_cli.run.batch.compare_records import ComparisonReport
    from robodyn_cli.run.batch.stored import read_stored

    found = compare(read_stored(result), read_stored(baseline), rtol=rtol, atol=atol)
    console.data(jsonable(as_keys(ComparisonReport.of(found, rtol, atol))))
    width = max((len(item.path) for item in found.differences), default=0)
    for item in found.differences:
        console.say(f"{item.verdict:<8} {item.path:<{width}}  {item.text}".rstrip())
    bad, count = len(found.differing), len(found.differences)
    console.say(f"{count} datasets: {f'{bad} differ' if bad else 'all agree'} (rtol {rtol:g}, atol {atol:g})")
    return 0 if found.agrees else FAILED


def _trees(result: Path, baseline: Path, rtol: float, atol: float, console: Console) -> int:
    from robodyn_cli.results.summary import as_keys, jsonable
    from robodyn_cli.run.batch.compare_records import TreeReport
    from robodyn_cli.run.batch.trees import compare_trees

    with console.waiting(lambda: "comparing"):
        found = compare_trees(result, baseline, rtol=rtol, atol=atol)
    report = TreeReport.of(found, rtol, atol)
    console.data(jsonable(as_keys(report)))
    for item in found:
        _tell(item, console)
    count = Counter(item.verdict for item in found)
    tally = ", ".join(f"{count[verdict]} {PLURAL.get(verdict, verdict)}" for verdict in count)
    console.say(f"{len(found)} results: {tally} (rtol {rtol:g}, atol {atol:g})")
    return report.exit_code


def _tell(item: Compared, console: Console) -> None:
    """Print how one of many results compares; those that agree are only counted."""
    if item.verdict == "equal":
        return
    console.say(f"{item.verdict:<10}  {item.name}  {WORDS.get(item.verdict, '')}".rstrip())
    for line in item.lines:
        console.say(f"{'':<12}{line}")
