"""Words about the loop of a controller: its poles, and the margins of each loop opened in turn."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from robodyn_cli.cli.control_words import MOST_POLES, pole_text
from robodyn_cli.cli.words import error_text, number, table

MOST_LOOPS = 12  # that are listed
COLUMNS = (
    ("gain_margin", "gain_frequency", 1.0), ("gain_reduction", "reduction_frequency", 1.0),
    ("phase_margin", "phase_frequency", math.degrees(1.0)), ("delay_margin", "delay_frequency", 1e3),
    ("sensitivity_peak", "sensitivity_frequency", 1.0),
)  # fmt: skip


def loop_lines(summary: Mapping[str, Any]) -> list[str]:
    """Return the lines of a loop."""
    whole = summary["closed_loop"]
    sampled = "period" in whole
    shown = [pole_text(pole) for pole in whole["poles"] if pole["imaginary"] >= 0.0]
    more = f", ... and {len(shown) - MOST_POLES} more" if len(shown) > MOST_POLES else ""
    off = max((pole["error"] for pole in whole["poles"]), default=0.0)
    late = f", {number(whole['delay'])} s late" if whole.get("delay") else ""
    rate = f", sampled every {number(whole['period'])} s{late}" if sampled else ""
    lines = [
        f"  loop               {whole['stability']}{rate}; about {whole['about']}",
        f"  poles of the loop  {', '.join(shown[:MOST_POLES])}{more} {'per sample' if sampled else '1/s'}"
        f" ({error_text(off)} off)",
    ]
    if "held_back" in whole:
        told = ", ".join(f"{name} {number(x)}" for name, x in list(whole["held_back"].items())[:MOST_LOOPS])
        lines.append(
            f"  torque left        {told}: what the law gives less what holds this pose; it does not hold it, the loop "
            "rests elsewhere"
        )
    if "saturated" in whole:
        cut = ", ".join(whole["saturated"][:MOST_LOOPS])
        lines.append(
            f"  warning: the law saturates here ({cut}): the limits cut what it asks for, so it does not act; "
            "the poles are those with these torques as they are"
        )
    if "restless" in whole:
        moving = ", ".join(whole["restless"][:MOST_LOOPS])
        lines.append(
            f"  warning: states of the law do not rest here ({moving}): the linear law is that of an instant"
        )
    if whole["stability"] != "stable":
        return [*lines, "  no margin is left: the loop is not stable"]
    if len(summary["loop"]) > 1:
        where = _at(whole["sensitivity_frequency"])
        lines.append(f"  all loops at once  largest sensitivity {number(whole['sensitivity_peak'])}{where}")
    return [*lines, "", _margins(summary["loop"]), ""]


def _margins(loops: Mapping[str, Mapping[str, Any]]) -> str:
    head = ["loop", "gain up to", "gain down to", "phase [deg]", "delay [ms]", "sensitivity"]
    rows: list[Sequence[str]] = [head]
    for name, own in list(loops.items())[:MOST_LOOPS]:
        cells = [_cell(own, *column) for column in COLUMNS]
        rows += [
            [name, *cells],
            ["  +-", *(_error(own["errors"][key], factor) for key, _, factor in COLUMNS)],
        ]
        rows.append(["  at rad/s", *(number(own[at], 5) for _, at, _ in COLUMNS)])
    left = len(loops) - MOST_LOOPS
    more = f"\n  ... and {left} more in summary.json" if left > 0 else ""
    return table(rows) + more


def _cell(own: Mapping[str, Any], key: str, at: str, factor: float) -> str:
    value = own[key]
    return "no limit" if value is None else number(value * factor)


def _error(error: float | None, factor: float) -> str:
    return "?" if error is None else error_text(error * factor)


def _at(frequency: float | None) -> str:
    return "" if frequency is None else f" at {number(frequency, 5)} rad/s"
