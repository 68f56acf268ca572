"""``robodyn cache``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from robodyn_cli.cli.options import Told

if TYPE_CHECKING:
    from robodyn_cli.summaries.checks import CacheReport


EXAMPLES = (
    "cache",
    "cache --clear",
    "cache --json",
)


def command(
    clear: Annotated[bool, typer.Option("--clear", help="Remove all compiled code.")] = False,
    *,
    told: Told,
) -> int:
    """Show where compiled code is kept and how much there is, or remove it; return the exit code."""
    from robodyn_cli.kernels.cache import MOST_BYTES, cache_directory, contents, remove_all
    from robodyn_cli.results.summary import as_keys
    from robodyn_cli.summaries.checks import CacheReport

    console = told.console
    folder = cache_directory()
    removed = remove_all(folder) if clear and folder is not None else 0
    kept = contents(folder) if folder is not None else []
    size = sum(status.st_size for _, status in kept)
    directory = None if folder is None else str(folder)
    report = CacheReport("ok", directory, len(kept), size, MOST_BYTES, removed)
    console.data(as_keys(report))
    console.say(describe(report, clear))
    return 0


def describe(report: CacheReport, cleared: bool) -> str:
    """Return the report for the terminal."""
    if report.directory is None:
        return "compiled code is not kept"
    lines = [f"{report.directory}"]
    if cleared:
        lines.append(f"  removed  {_objects(report.removed)}")
    lines.append(f"  kept     {_objects(report.entries)}, {megabytes(report.bytes)} MB")
    lines.append(f"  at most  {megabytes(report.most_bytes)} MB; beyond that the oldest go first")
    return "\n".join(lines)


def _objects(count: int) -> str:
    return f"{count} object{'s' * (count != 1)}"


def megabytes(size: int) -> str:
    """Return a size in megabytes (2^20 bytes)."""
    amount = size / 2**20
    return f"{amount:.0f}" if amount == round(amount) else f"{amount:.2f}"
