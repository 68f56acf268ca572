"""Words about a controller: what it is, and how it has followed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from robodyn_cli.cli.words import error_text, number, stated, table
from robodyn_cli.summaries.control import OWN_GAINS, is_diagonal

MOST_ROWS = 12  # of a table
MOST_COLUMNS = 12  # of the matrix of gains
MOST_POLES = 12
ZERO = 1e-14  # of the largest gain of a row: rounding


def control_lines(control: Mapping[str, Any], verbose: bool = True) -> list[str]:
    """Return what a controller is."""
    sampled = (
        f", {control['updates']} samples every {number(control['period'])} s" if "period" in control else ""
    )
    if control.get("delay"):
        sampled += f", {number(control['delay'])} s late"
    lines = [f"  controller         {control['type']}{sampled}"]
    if verbose:
        lines += _design_lines(control)
    return lines


def _design_lines(control: Mapping[str, Any]) -> list[str]:
    """Return the gains, the poles of the loop, and the pose that a regulator is made for."""
    lines = []
    if gains := control.get("gains"):
        lines.append(gains_table(gains, control))
    if poles := control.get("poles"):
        unit = "per sample" if "period" in control else "1/s"
        shown = [pole_text(pole) for pole in poles if pole["imaginary"] >= 0.0]
        more = f", ... and {len(shown) - MOST_POLES} more" if len(shown) > MOST_POLES else ""
        off = max(pole["error"] for pole in poles)
        error = f" ({error_text(off)} off)" if off else ""
        lines.append(f"  poles of the loop  {', '.join(shown[:MOST_POLES])}{more} {unit}{error}")
        if control.get("delay"):
            lines.append(
                "                     of the design, without the delay; `linearise` has those with it"
            )
    if at := control.get("equilibrium"):
        pose, torques = (
            ", ".join(f"{name} {number(x)}" for name, x in list(at[key].items())[:MOST_COLUMNS])
            for key in ("q", "torques")
        )
        lines.append(f"  about              {pose}; held by {torques}")
    return lines


def gains_table(gains: Mapping[str, Mapping[str, float]], control: Mapping[str, Any]) -> str:
    """Return gains as a table with a line for each column of the matrix, whose rows are few: the driven joints."""
    errors, units, of = control.get("gain_errors"), control["row_units"], control["column_units"]
    rows, columns = list(gains), list(next(iter(gains.values())))
    if errors is None and is_diagonal(gains):
        return _diagonal(gains, units)
    shown, names = rows[:MOST_ROWS], columns[:MOST_COLUMNS]
    head = ["gain of", *(f"{row} [{units[row]}]" for row in shown)]
    lines = [head]
    for name in names:
        cells = [
            stated(gains[row][name], (None if errors is None else errors[row][name]) or None) for row in shown
        ]
        lines.append([f"{name} [{of[name]}]", *cells])
    hidden = ((len(columns) - len(names), "columns"), (len(rows) - len(shown), "rows"))
    left = [f"{count} {word}" for count, word in hidden if count]
    more = f"\n  ... and {' and '.join(left)} more in summary.json" if left else ""
    return "\n" + table(lines) + more


def _diagonal(gains: Mapping[str, Mapping[str, float]], units: Mapping[str, str]) -> str:
    """Return gains as a table with a line for each row: of its own coordinate, of the rate, of the integral."""
    n = len(gains)
    columns = list(next(iter(gains.values())))
    head = ["gains", "", *OWN_GAINS[: len(columns) // n]]
    lines = [
        [row, f"[{units[row]}]", *(number(entries[name]) for name in columns[k::n])]
        for k, (row, entries) in enumerate(gains.items())
    ]
    more = f"\n  ... and {n - MOST_ROWS} more in summary.json" if n > MOST_ROWS else ""
    return "\n" + table([head, *lines[:MOST_ROWS]]) + more


def pole_text(pole: Mapping[str, Any]) -> str:
    """Return a pole, or the pair of it and its conjugate."""
    real, imaginary = pole["real"], pole["imaginary"]
    if imaginary:
        return f"{number(real)} +- {number(imaginary)}i" if real else f"+- {number(imaginary)}i"
    return number(real)
