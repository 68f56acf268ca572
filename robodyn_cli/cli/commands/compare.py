"""``robodyn compare``."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from robodyn_cli.cli.console import Console
from robodyn_cli.cli.options import Quiet, ReportAsJson, StoredResult, number
from robodyn_cli.exit_codes import FAILED

if TYPE_CHECKING:
    from robodyn_cli.results.compare import Difference

tolerance = number("a number >= 0", lambda x: 0.0 <= x < math.inf)


def command(
    result: StoredResult,
    baseline: Annotated[
        Path,
        typer.Argument(metavar="BASELINE", help="What it is compared with, likewise.", show_default=False),
    ],
    rtol: Annotated[
        float,
        typer.Option(
            "--rtol", metavar="X", parser=tolerance, help="Allowed part of the column's largest magnitude."
        ),
    ] = 1e-9,
    atol: Annotated[
        float,
        typer.Option(
            "--atol", metavar="X", parser=tolerance, help="Allowed in addition, in the dataset's unit."
        ),
    ] = 1e-12,
    as_json: ReportAsJson = False,
    quiet: Quiet = False,
) -> int:
    """Compare two stored results; return 1 where they differ."""
    from robodyn_cli.results.compare import ComparisonReport, compare
    from robodyn_cli.results.summary import as_keys, jsonable
    from robodyn_cli.run.batch.stored import read_stored

    console = Console(as_json, quiet)
    found = compare(read_stored(result), read_stored(baseline), rtol=rtol, atol=atol)
    console.data(jsonable(as_keys(ComparisonReport.of(found, rtol, atol))))
    width = max((len(item.path) for item in found.differences), default=0)
    for item in found.differences:
        console.say(f"{item.verdict:<8} {item.path:<{width}}  {describe(item)}".rstrip())
    bad = sum(item.verdict not in ("equal", "extra") for item in found.differences)
    count = len(found.differences)
    console.say(f"{count} datasets: {f'{bad} differ' if bad else 'all agree'} (rtol {rtol:g}, atol {atol:g})")
    return 0 if found.agrees else FAILED


def describe(item: Difference) -> str:
    """Return the worst sample of a dataset in words."""
    if item.verdict in ("missing", "extra"):
        return "only in the baseline" if item.verdict == "missing" else "only in the result"
    if item.detail or item.error == 0.0:
        return item.detail
    column = f" of {item.column}" if item.column else ""
    time = f" at t = {item.time:.9g} s" if item.time is not None else ""
    return (
        f"worst {item.error:.3g}{column}{time}: {item.value:.12g} instead of {item.expected:.12g} "
        f"({item.ratio:.2g} of what is allowed)"
    )
