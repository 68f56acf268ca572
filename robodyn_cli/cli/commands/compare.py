"""``robodyn compare``."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from robodyn_cli.cli.console import Console
from robodyn_cli.cli.options import ATOL, RTOL, AbsoluteTolerance, RelativeTolerance, Told
from robodyn_cli.errors import FAILED

if TYPE_CHECKING:
    from robodyn_cli.over.batch.stored import Compared
    from robodyn_cli.results.result import Result

PLURAL = {"equal": "agree", "differs": "differ"}
LEGEND = "≠ differs by more than both errors, ≈ within them; without ± one of the two states no error"
WORDS = {"missing": "only in the baseline", "extra": "only in the results"}


EXAMPLES = (
    "compare outputs/first outputs/second",
    "compare outputs baseline",
    "compare outputs/first outputs/second outputs/third --figures",
)


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
    more: Annotated[
        list[Path] | None,
        typer.Argument(metavar="MORE", help="Further results, with --figures.", show_default=False),
    ] = None,
    rtol: RelativeTolerance = RTOL,
    atol: AbsoluteTolerance = ATOL,
    figures: Annotated[
        bool,
        typer.Option("--figures", help="The figures of all, with their differences to those of RESULT."),
    ] = False,
    latex: Annotated[bool, typer.Option("--latex", help="Figures as a table for LaTeX.")] = False,
    csv: Annotated[bool, typer.Option("--csv", help="Figures as CSV, with all digits.")] = False,
    *,
    told: Told,
) -> int:
    """Compare two stored results, or all results below two directories; return 1 where they differ."""
    from robodyn_cli.errors import CapabilityError
    from robodyn_cli.over.batch.stored import is_tree

    console = told.console
    asked = [name for name, wanted in (("--latex", latex), ("--csv", csv), ("MORE", more)) if wanted]
    if figures:
        if latex and csv:
            raise CapabilityError("--latex and --csv: allowed: one form at a time")
        return _figures(
            [result, baseline, *(more or ())], "latex" if latex else "csv" if csv else "", console
        )
    if asked:
        raise CapabilityError(f"{asked[0]}: allowed with --figures alone")
    if is_tree(result) or is_tree(baseline):
        return _trees(result, baseline, rtol, atol, console)
    return _two(result, baseline, rtol, atol, console)


def _figures(results: list[Path], form: str, console: Console) -> int:
    from robodyn_cli.cli.words import table
    from robodyn_cli.over.batch.variants import csv_text, latex_text_of, text_rows, variants
    from robodyn_cli.results.summary import as_keys, jsonable

    with console.waiting(lambda: "comparing"):
        report = variants(results)
    console.data(jsonable(as_keys(report)))
    if form:
        console.say(csv_text(report) if form == "csv" else latex_text_of(report))
        return 0
    rows = text_rows(report)
    equal = len(report.figures) - len(rows) + 1
    if len(rows) == 1:
        console.say(f"{equal} figures are equal in all results")
        return 0
    console.say(table(rows))
    console.say(LEGEND + (f"; {equal} more are equal in all" if equal else ""))
    return 0


def _two(result: Path, baseline: Path, rtol: float, atol: float, console: Console) -> int:
    from robodyn_cli.over.batch.reports import comparison_of
    from robodyn_cli.over.batch.stored import read_stored
    from robodyn_cli.results.compare import compare
    from robodyn_cli.results.summary import as_keys, jsonable

    new, old = read_stored(result), read_stored(baseline)
    comparison = compare(new, old, rtol=rtol, atol=atol)
    console.data(jsonable(as_keys(comparison_of(comparison, rtol, atol))))
    longer = _only_longer(new, old)
    shown = [item for item in comparison.differences if item.path not in longer]
    width = max((len(item.path) for item in shown), default=0)
    for item in shown:
        console.say(f"{item.verdict:<8} {item.path:<{width}}  {item.text}".rstrip())
    if longer:
        samples = f"{len(new.time)} samples instead of {len(old.time)}"
        console.say(f"{len(longer)} more datasets over time have {samples}")
    bad, count = len(comparison.differing), len(comparison.differences)
    console.say(f"{count} datasets: {f'{bad} differ' if bad else 'all agree'} (rtol {rtol:g}, atol {atol:g})")
    return 0 if comparison.agrees else FAILED


def _only_longer(one: Result, other: Result) -> list[str]:
    """Return the datasets over time that differ in the number of samples alone, as ``time`` itself does."""
    if "time" not in one or "time" not in other or len(one.time) == len(other.time):
        return []
    paths = []
    for path, variable in one.variables.items():
        beside = other.variables.get(path)
        if path == "time" or beside is None or not variable.dims[:1] == beside.dims[:1] == ("time",):
            continue
        if variable.data.shape[1:] == beside.data.shape[1:]:
            paths.append(path)
    return paths


def _trees(result: Path, baseline: Path, rtol: float, atol: float, console: Console) -> int:
    from robodyn_cli.over.batch.reports import trees_of
    from robodyn_cli.over.batch.stored import compare_trees
    from robodyn_cli.results.summary import as_keys, jsonable

    with console.waiting(lambda: "comparing"):
        comparisons = compare_trees(result, baseline, rtol=rtol, atol=atol)
    report = trees_of(comparisons, rtol, atol)
    console.data(jsonable(as_keys(report)))
    for item in comparisons:
        _tell(item, console)
    count = Counter(item.verdict for item in comparisons)
    tally = ", ".join(f"{count[verdict]} {PLURAL.get(verdict, verdict)}" for verdict in count)
    console.say(f"{len(comparisons)} results: {tally} (rtol {rtol:g}, atol {atol:g})")
    return report.exit_code


def _tell(item: Compared, console: Console) -> None:
    """Print how one of many results compares; those that agree are only counted."""
    if item.verdict == "equal":
        return
    console.say(f"{item.verdict:<10}  {item.name}  {WORDS.get(item.verdict, '')}".rstrip())
    for line in item.lines:
        console.say(f"{'':<12}{line}")
