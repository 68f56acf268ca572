"""Phrases that the summaries for the terminal share."""

from __future__ import annotations

import itertools
import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from robodyn_cli.cli.console import width
from robodyn_cli.summaries.facts import LOAD, UnitOf, rounded_up


def table(rows: Sequence[Sequence[str]], columns: int | None = None) -> str:
    """Return rows as aligned columns; the first row is the head, the first column is text.

    In a table that is wider than the terminal (``columns``) units stand below their headings, then the words of
    headings below one another; one that is too wide still is continued below, with the first column again.
    """
    room = columns or width(sys.stdout) or math.inf
    lines = [list(row) for row in rows]
    if _wide(_widths(lines)) > room:
        parted = [head.partition(" [") for head in rows[0]]
        lines[:1] = _below_one_another([[name, f"[{unit}" if unit else ""] for name, _, unit in parted])
    if _wide(_widths(lines)) > room:
        cells = _widths(rows[1:]) if len(rows) > 1 else [0] * len(rows[0])
        lines[: len(lines) - len(rows) + 1] = _below_one_another(
            [_folded(head, least) for head, least in zip(rows[0], cells)]
        )
    widths = _widths(lines)
    parts: list[list[int]] = [[]]
    for k in range(1, len(widths)):
        if parts[-1] and _wide([widths[j] for j in [0, *parts[-1], k]]) > room:
            parts.append([])
        parts[-1].append(k)
    written = [
        "  " + "  ".join([line[0].ljust(widths[0]), *(line[k].rjust(widths[k]) for k in part)]).rstrip()
        for part in parts
        for line in lines
    ]
    return "\n".join(line for line in written if line.strip())


def _below_one_another(heads: Sequence[Sequence[str]]) -> list[list[str]]:
    """Return lines of headings, of which each has lines of its own."""
    return [list(line) for line in itertools.zip_longest(*heads, fillvalue="")]


def _folded(head: str, least: int) -> list[str]:
    """Return a heading in lines as wide as its column or its longest word; a unit begins one of its own."""
    import textwrap

    name, _, unit = head.partition(" [")
    room = max([least, 1, *map(len, name.split())])
    return [*textwrap.wrap(name, room, break_on_hyphens=False), *([f"[{unit}"] if unit else [])]


NOTHING = 1e-12  # of the largest of its peers: less is what rounding leaves of zero


# of a table by coordinate: heading, values by coordinate, their unit by that of the coordinate, digits
ByCoordinate = Sequence[tuple[str, Mapping[str, float], UnitOf, int]]


def coordinate_table(units: Mapping[str, str], columns: ByCoordinate) -> str:
    """Return a table of values by coordinate, from the ``units`` of all coordinates."""
    names = list(dict.fromkeys(name for _, values, _, _ in columns for name in values))
    shown = [_coordinate_column(names, *column, units) for column in columns]
    return table(list(zip(["coordinate", *names], *shown)))


def _coordinate_column(
    names: Sequence[str],
    heading: str,
    values: Mapping[str, Any],
    unit_of: UnitOf,
    digits: int,
    units: Mapping[str, str],
) -> list[str]:
    """Return the heading of a column and its cells; units that differ between rows are printed beside each value.

    What is nothing beside values of the same unit is shown as 0.
    """
    own = {name: unit_of(units[name]) for name in names}
    largest: dict[str, float] = {}
    for name, x in values.items():
        if isinstance(x, float):
            largest[own[name]] = max(abs(x), largest.get(own[name], 0.0))
    cells = {
        name: number(0.0 if isinstance(x, float) and abs(x) <= NOTHING * largest[own[name]] else x, digits)
        for name, x in values.items()
    }
    shared = {own[name] for name in values if values[name] is not None} or {*own.values()}
    if len(shared) == 1:
        return [f"{heading} [{shared.pop()}]", *(cells.get(name, "-") for name in names)]
    return [heading, *(f"{cells[name]} {own[name]}" if name in cells else "-" for name in names)]


def _widths(rows: Sequence[Sequence[str]]) -> list[int]:
    return [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]


def _wide(widths: Sequence[int]) -> int:
    """Return the width of a table."""
    return sum(widths) + 2 * len(widths)


def number(x: Any, digits: int = 6) -> str:
    """Return a number for reading."""
    if x is None:
        return "-"
    return f"{x + 0.0:.{digits}g}" if isinstance(x, (int, float)) else str(x)  # -0.0 is 0


def error_text(error: float) -> str:
    """Return an error for reading, rounded up: what is printed is a bound too."""
    return f"{rounded_up(error):.1e}"


def stated(value: Any, error: Any = None) -> str:
    """Return a number with its error, where that is known, as all that shows results writes them."""
    from robodyn_cli.report.cells import Figure  # where a number is printed

    return typed(Figure(value, error).number)


def typed(text: str) -> str:
    """Return a figure as it is typed; not every terminal has a sign for plus or minus."""
    return text.replace("±", "+-")


def multiplier_lines(summary: Mapping[str, Any]) -> list[str]:
    """Return lines about loads that loops, or actuators, could share in another way."""
    multipliers, shared = summary.get("multipliers", {}), summary.get("mechanism", {})
    lines = []
    if shared.get("torques", "unique") != "unique":
        lines.append(f"  not unique         torques are those of {shared['torques']}")
    dependent = shared.get("multipliers", "unique") != "unique" or (
        "equilibrium" in summary and summary.get("mobility", {}).get("redundant_rows", 0) > 0
    )
    if dependent or str(multipliers.get("choice", "")).startswith("least norm"):
        rows = summary.get("assembly", {}).get("redundant_rows", ())
        which = f"redundant rows {', '.join(rows)}" if rows else "rows depend on each other"
        lines.append(
            f"  not unique         {which}: multipliers, and reactions that follow from them, are those of least norm"
        )
    return lines


def cost_lines(summary: Mapping[str, Any], verbose: bool = True) -> list[str]:
    """Return a line about steps and times, where all is told."""
    if not verbose:
        return []
    counters = summary.get("counters", {})
    times = summary.get("wall_time_s", {})
    steps = (
        f"{counters['steps']} steps, {counters.get('evaluations', 0)} evaluations; "
        if "steps" in counters
        else ""
    )
    parts = ", ".join(f"{k} {1e3 * v:.3g}" for k, v in times.items() if k != "total" and v >= 5e-5)
    told = " without an error estimate" if summary.get("error_estimate", {}) is None else ""
    return [f"  cost               {steps}ms: {parts}; in all {1e3 * times.get('total', 0.0):.4g}{told}"]


def holding_lines(
    torques: Mapping[str, float], off: Mapping[str, float | None], units: Mapping[str, str]
) -> list[str]:
    """Return a line about torques that keep a pose, beside those that the scene states, with their errors; ``units`` of
    coordinates."""
    held = ", ".join(
        f"{name} {stated(x, off.get(name))} {LOAD(units.get(name, ''))}" for name, x in torques.items()
    )
    return [f"  holding torques    {held}"] if held else []


def mobility_lines(summary: Mapping[str, Any]) -> list[str]:
    """Return a line about degrees of freedom."""
    facts = summary.get("mobility")
    if not facts:
        return []
    return [
        f"  mobility           {facts['actual']} (rank {facts['rank']} of {facts['rows']} rows over "
        f"{facts['coordinates']} coordinates); Gruebler's count {facts['count']} in space, {facts['planar_count']} "
        "without vanishing rows",
        *_rank_lines(facts),
    ]


def _rank_lines(facts: Mapping[str, Any]) -> Iterator[str]:
    """Yield a line about the singular values that decide the rank in one pose; none of a motion, which has many."""
    kept, dropped = facts.get("smallest_kept"), facts.get("largest_dropped")
    if kept is None and dropped is None:
        return
    told = {
        key: stated(facts.get(key), facts.get(f"{key}_error")) for key in ("smallest_kept", "largest_dropped")
    }
    text = "none counts" if kept is None else f"smallest that counts {told['smallest_kept']}"
    text += "" if dropped is None else f", largest that does not {told['largest_dropped']}"
    yield f"  singular values    {text} (over the largest; tolerance {facts['rank_tolerance']:g})"


def closure_text(closure: Mapping[str, float]) -> str:
    """Return residuals of the loops in words."""
    units = {"position": "m or rad", "velocity": "m/s or rad/s", "acceleration": "m/s^2 or rad/s^2"}
    return ", ".join(
        f"{key} {error_text(closure[key])} {unit}" for key, unit in units.items() if key in closure
    )


def motorisation_lines(summary: Mapping[str, Any]) -> list[str]:
    """Return the lines about margins of motorisation: of each driven joint the least ratio, where, and whether it
    suffices."""
    joints: Mapping[str, Mapping[str, Any]] = summary.get("motorisation", {})
    rows = [["driven joint", "ratio", "required", "at [s]", "position", "decides", "verdict"]]
    for name, one in joints.items():
        rows.append(
            [
                name,
                _ratio_words(one),
                number(one["required"], 4),
                _with_error(one, "time"),
                _with_error(one, "angle") if "angle" in one else "-",
                one["decides"] or "",
                "met" if one["met"] else "TOO LITTLE",
            ]
        )
    return [table(rows)] if joints else []


def _ratio_words(one: Mapping[str, Any]) -> str:
    if one["ratio"] is None:
        return "nothing resists" if one["met"] else "drives back"
    return stated(one["ratio"], one["errors"]["ratio"])


def margin_text(part: float, error: float | None) -> str:
    """Return the part of a limit that is left, with its error."""
    from robodyn_cli.report.figures import margin

    return typed(str(margin(part, error)))


def _with_error(figures: Mapping[str, Any], key: str) -> str:
    return stated(figures[key], figures["errors"].get(key))


def balance_lines(summary: Mapping[str, Any]) -> list[str]:
    """Return what is told of shaking forces and of a flywheel."""
    lines = []
    if shaking := summary.get("shaking"):
        moment = shaking.get("peak_moment")
        lines.append(
            f"  shaking            force up to {_with_error(shaking, 'peak_force')} N"
            + (
                ""
                if moment is None
                else f", moment up to {_with_error(shaking, 'peak_moment')} N m about {shaking['about']}"
            )
        )
    if wheel := summary.get("flywheel"):
        lines.append(
            f"  flywheel           {_with_error(wheel, 'inertia')} kg m^2 on "
            f"{wheel['joint']}, takes up {_with_error(wheel, 'energy')} J"
        )
    for name, one in (summary.get("fluctuation") or {}).items():
        lines.append(f"  fluctuation        {name}: {stated(one['coefficient'], one['error'])}")
    return lines
