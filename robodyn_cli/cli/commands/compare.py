"""``robodyn compare``."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from robodyn_cli.cli.console import Console
from robodyn_cli.cli.options import ATOL, RTOL, AbsoluteTolerance, RelativeTolerance, Told
from robodyn_cli.errors import FAILED, of_option

if TYPE_CHECKING:
    from robodyn_cli.over.batch.stored import Compared
    from robodyn_cli.results.compare import Difference
    from robodyn_cli.results.result import Result

MOST_KEYS = 4  # of the scenes that are told
MOST_PATHS = 6  # of datasets that could not be compared for the same reason
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
            raise of_option("--latex and --csv", "allowed: one form at a time", CapabilityError)
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
    for line in [*_heads(new, old), *_lines(comparison.differences)]:
        console.say(line)
    bad, count = len(comparison.differing), len(comparison.differences)
    console.say(f"{count} datasets: {f'{bad} differ' if bad else 'all agree'} (rtol {rtol:g}, atol {atol:g})")
    return 0 if comparison.agrees else FAILED


def _heads(new: Result, old: Result) -> list[str]:
    """Return what tells two runs apart before any figure: their commands, and keys of their scenes."""
    from robodyn_cli.report.page.compared import scene_differences

    lines = []
    if new.command != old.command:
        lines.append(f"commands  {new.command} instead of {old.command}")
    keys = list(scene_differences((new, old)))
    told = [f"{one.name} {' instead of '.join(_given(value) for value in one.values)}" for one in keys]
    if new.title != old.title:
        count = f"; {len(told)} keys differ: --figures lists them" if told else ""
        lines.append(f"scenes    {new.title!r} instead of {old.title!r}{count}")
    elif told:
        more = (
            f" and {len(told) - MOST_KEYS} more keys: --figures lists them" if len(told) > MOST_KEYS else ""
        )
        lines.append(f"scenes    {', '.join(told[:MOST_KEYS])}{more}")
    return lines


def _given(value: str | None) -> str:
    return "not given" if value is None else str(value)


def _lines(differences: Sequence[Difference]) -> list[str]:
    """Return a line for each dataset that was compared, and one for all that could not be for the same reason."""
    compared = [item for item in differences if item.verdict in ("differs", "equal")]
    width = max((len(item.path) for item in compared), default=0)
    groups: dict[tuple[str, str, bool], list[Difference]] = {}
    for item in differences:
        alone = item.verdict in ("differs", "equal")
        groups.setdefault((item.verdict, item.path if alone else item.text, alone), []).append(item)
    lines = []
    for (verdict, _, alone), items in groups.items():
        paths = ", ".join(item.path for item in items[:MOST_PATHS])
        more = f" and {len(items) - MOST_PATHS} more" if len(items) > MOST_PATHS else ""
        lines.append(f"{verdict:<8} {paths + more:<{width if alone else 0}}  {items[0].text}".rstrip())
    return lines


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
