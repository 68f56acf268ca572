"""``robodyn run``."""

from __future__ import annotations

import functools
import math
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from robodyn_cli.cli.console import Console
from robodyn_cli.cli.interrupts import tidy_up_first
from robodyn_cli.cli.options import (
    ATOL,
    RTOL,
    AbsoluteTolerance,
    Jobs,
    Overrides,
    RelativeTolerance,
    SceneFiles,
    SharedOptions,
    number,
    quantity,
)
from robodyn_cli.cli.worker import command_line
from robodyn_cli.errors import CapabilityError, of_option, worst
from robodyn_cli.threads import cores

if TYPE_CHECKING:
    from robodyn_cli.over.batch.entries import BatchEntry
    from robodyn_cli.report.registry import Drawings


EXAMPLES = (
    "run configs --no-plots",
    "run configs --no-plots --junit report.xml",
    "run configs --no-plots --baseline baseline",
)


def command(
    scenes: SceneFiles,
    jobs: Jobs = None,
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="DIR", help="Results go to DIR/<scene>/<command>.")
    ] = Path("outputs"),
    junit: Annotated[
        Path | None, typer.Option("--junit", metavar="FILE", help="Write a JUnit XML report.")
    ] = None,
    markdown: Annotated[
        Path | None, typer.Option("--markdown", metavar="FILE", help="Write a summary in Markdown.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Run again what is finished and unchanged.")] = False,
    overrides: Overrides = None,
    timeout: Annotated[
        float | None,
        typer.Option(
            "--timeout",
            metavar="SECONDS",
            parser=number("a number > 0 [s], as 90 or 1.5 min", lambda x: 0.0 < x < math.inf, quantity("s")),
            help="Time that each scene may take. [default: no limit]",
        ),
    ] = None,
    *,
    shared: SharedOptions,
    baseline: Annotated[
        Path | None,
        typer.Option(
            "--baseline", metavar="DIR", help="Stored results that those of the batch must agree with."
        ),
    ] = None,
    update: Annotated[
        bool, typer.Option("--update-baseline", help="Store what differs, or is new, in the baseline.")
    ] = False,
    rtol: RelativeTolerance = RTOL,
    atol: AbsoluteTolerance = ATOL,
) -> int:
    """Run the batch, print a line for each scene, write the reports; return the worst exit code."""
    from robodyn_cli.over.batch.reports import batch_of, tally, updates_of, write_reports
    from robodyn_cli.results.summary import as_keys, jsonable

    if update and baseline is None:
        raise of_option(
            "--update-baseline", "needs --baseline DIR, the directory of the stored results", CapabilityError
        )
    start, console = time.perf_counter(), shared.console
    entries: list[BatchEntry] = []
    tidy_up_first()
    try:
        from robodyn_cli.kernels.cache import cache_directory
        from robodyn_cli.over.batch.batch import Batch
        from robodyn_cli.over.batch.entries import listed, load
        from robodyn_cli.over.batch.reports import Baseline, note
        from robodyn_cli.over.batch.stored import gather

        cache_directory()  # says what is wrong with it once, for all scenes
        settings, drawn = overrides or (), shared.drawings()
        stored = None if baseline is None else Baseline(baseline, out, rtol, atol, update)
        entries += listed(gather(scenes, files=True))
        load(entries, out, settings)
        widths = max(len(e.name) for e in entries), max(len(e.command or "-") for e in entries)
        worker = functools.partial(command_line, drawn, settings)
        with console.waiting(lambda: f"{len(entries)} scene{'s' if len(entries) != 1 else ''}"):
            batch = Batch(entries, jobs or cores(), worker, _ends(drawn), force, timeout)
            for done, entry in enumerate(batch.run(), 1):
                if stored is not None:
                    stored.judge(entry)
                if not update:
                    note(entry)
                _tell(entry, widths, console)
                console.progress(done, len(entries), "done")
        if stored is not None and update:
            console.say(f"baseline {baseline}: {updates_of(entries, stored.replace_old(entries))}")
    finally:
        # an interrupted batch reports the scenes that have run
        write_reports(entries, junit, markdown)
    code = worst(e.exit_code for e in entries)
    console.say(f"{tally(entries)}; {time.perf_counter() - start:.2f} s")
    console.data(jsonable(as_keys(batch_of(entries, code))))
    return code


def _ends(drawn: Drawings | None) -> list[str]:
    """Return the ends of the names of files that a finished result has."""
    if drawn is None:
        return []
    return [f"{name}.{drawn.suffix}" for name in drawn.names or ("",)]


def _tell(entry: BatchEntry, widths: tuple[int, int], console: Console) -> None:
    """Print how a scene ended; ``widths`` : of the columns of names and commands."""
    if entry.replaced is not None:
        console.warn(f"{entry.directory} held results of another scene, {entry.replaced}")
    time_taken = "unchanged" if entry.unchanged else f"{entry.seconds:.2f} s"
    console.say(
        f"{entry.verdict:<7} {entry.name:<{widths[0]}}  {entry.command or '-':<{widths[1]}} {time_taken:>9}"
    )
    if console.verbose:
        for criterion in entry.criteria:
            console.say(f"        {'ok' if criterion.holds else 'failed':<7} {criterion}")
    for problem in entry.problems if entry.verdict != "ok" else entry.differences:
        console.say(f"        {problem}")
    if console.quiet and entry.verdict in ("error", "failed"):
        console.error(f"{entry.name}: {'; '.join(entry.problems)}")
