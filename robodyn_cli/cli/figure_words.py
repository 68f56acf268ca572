"""The main figures of a result in words: what its command is told by, or with --verbose all; and its errors."""

from __future__ import annotations

import math
from collections.abc import Sequence

from robodyn_cli.cli.words import table, typed
from robodyn_cli.report.cells import Figure, Table, is_number
from robodyn_cli.report.figures import declared, drive_figures, drive_verdicts, errors, headlines
from robodyn_cli.results.result import Result
from robodyn_cli.results.stated_errors import meaningful_until

MOST_ROWS = 12  # of a table where not all is told


def figure_lines(result: Result, verbose: bool) -> list[str]:
    """Return lines with the main figures of a result, each with its error."""
    lines: list[str] = []
    for one in declared(result) if verbose else headlines(result):
        if any(one.head):
            lines += _rows(one, verbose)
        else:
            lines += [f"  {words!s:<18} {typed(str(value))}" for words, value in one.rows]
    drives = [*drive_verdicts(result.summary), *(drive_figures(result.summary) if verbose else ())]
    for one in drives:
        lines.append(figure_table(one))
    if drives and "catalogue" in result.summary:
        lines.append(f"  catalogue          {result.summary['catalogue']}")
    return lines + _error_lines(result, verbose)


def _error_lines(result: Result, verbose: bool) -> list[str]:
    """Return lines about the errors of a result; behind a motion that is lost in its error, from when on."""
    listed, estimate = errors(result, verbose), result.summary.get("error_estimate", {})
    if estimate is None:
        listed.append("of the motion: not asked for")
    elif estimate.get("reason"):
        listed.append(f"of the motion: none, {estimate['reason']}")
    elif estimate.get("at_rounding"):
        listed.append("those of the motion are at rounding")
    if math.isfinite(until := meaningful_until(result.summary)):
        listed.append(f"not meaningful after t = {until:.4g} s")
    if verbose and (balance := result.summary.get("energy_balance")):
        listed.append(f"the balance of energy is that of {balance}")
    if not verbose:
        return [f"  {'errors':<18} {'; '.join(listed)}"] if listed else []
    return [f"  {'' if k else 'errors':<18} {text}" for k, text in enumerate(listed)]


def figure_table(one: Table) -> str:
    """Return a table of figures as a terminal shows it: a unit that all of a column have stands in its heading."""
    names, *columns = zip(*one.rows)
    heads, cells = [one.head[0]], []
    for head, column in zip(one.head[1:], columns):
        units = {cell.unit for cell in column if isinstance(cell, Figure) and cell.value is not None}
        if len(units) == 1:  # it stands in the heading
            heads.append(f"{head}{''.join(f' [{unit}]' for unit in units - {'', '1'})}")
            cells.append([typed(cell.number if isinstance(cell, Figure) else cell) for cell in column])
        else:
            heads.append(head)
            cells.append([typed(str(cell)) for cell in column])
    return table([heads, *zip(names, *cells)])


def _rows(one: Table, verbose: bool) -> list[str]:
    shown = one.rows if verbose else _largest(one.rows)
    lines = [figure_table(Table(one.head, shown))]
    if len(shown) < len(one.rows):
        lines.append(f"  ... and {len(one.rows) - len(shown)} more with smaller {one.head[1]}; -v tells all")
    return lines + (
        [f"  {head:<18} {text.replace('`', '')}" for head, text in one.told.items()] if verbose else []
    )


def _largest(rows: Sequence[Sequence[str | Figure]]) -> Sequence[Sequence[str | Figure]]:
    """Return the rows with the largest figures in their first column, in their own order."""
    firsts = [row[1].value if isinstance(row[1], Figure) else None for row in rows]
    sizes = [abs(x) if x is not None and is_number(x) else 0.0 for x in firsts]
    kept = sorted(range(len(rows)), key=lambda k: -sizes[k])[:MOST_ROWS]
    return [rows[k] for k in sorted(kept)]
