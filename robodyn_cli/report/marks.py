"""What a drawing says about the course of a run: a failure, moments that matter, the growth of the multipliers."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from robodyn_cli.report import style
from robodyn_cli.report.ticks import number
from robodyn_cli.results.moments import DECISIVE, Moment, lock
from robodyn_cli.results.result import Result

if TYPE_CHECKING:
    from matplotlib.axes import Axes


# Characters of a caption that fit on a line.
NOTE_WIDTH = 90


def failure_note(result: Result) -> list[str]:
    """Return the lines that say that and why a run failed; none if it did not."""
    if result.status != "failed":
        return []
    termination = result.summary.get("termination") or result.attributes.get("termination") or {}
    if not isinstance(termination, dict):
        termination = {"reason": str(termination)}
    reason = str(termination.get("reason") or "reason not recorded")
    time = termination.get("time")
    if not isinstance(time, int | float):
        time = result.time[-1] if result.time.size else math.nan
    return textwrap.wrap(f"Run failed at t = {number(float(time), 6)} s: {reason}", NOTE_WIDTH, max_lines=2)


def sharing_note(result: Result) -> str:
    """Return the part of a subtitle that says that loads in the loops could be shared in another way; else empty."""
    rows = result.variables.get("constraints/multipliers")
    if rows is None or "least norm" not in rows.long_name:
        return ""
    return ". Not unique, since rows depend on each other: those of least norm"


def torque_note(result: Result) -> str:
    """Return the same for torques that more actuators than needed share."""
    shared = result.summary.get("mechanism")
    torques = str(shared.get("torques", "unique")) if isinstance(shared, dict) else "unique"
    return "" if torques == "unique" else f". Not unique: those of {torques}"


# how moments look that come often; they are drawn at the upper edge of a panel
MARKERS = {"impact": "v", "contact": "s", "release": "^", "stick": "o", "slip": "D"}


def counted(found: Sequence[Moment]) -> dict[str, str]:
    """Return the label of each kind of moment that comes often, with how many there are."""
    kinds = [moment.kind for moment in found]
    return {
        kind: f"{kind}{'s' if kinds.count(kind) > 1 else ''} ({kinds.count(kind)})"
        for kind in MARKERS
        if kind in kinds
    }


def decisive_text(found: Sequence[Moment]) -> str:
    """Return the decisive moments with their times, for the line above a drawing."""
    return "; ".join(f"{m.text} at {number(m.time, 6)} s" for m in found if m.kind in DECISIVE)


def mark_moments(axes: Sequence[Axes], found: Sequence[Moment]) -> None:
    """Mark moments on axes over time, as far as their limits go: decisive ones by a line, others by a small mark."""
    for ax in axes:
        low, high = ax.get_xlim()
        inside = [moment for moment in found if low <= moment.time <= high]
        for moment in inside:
            if moment.kind in DECISIVE:
                ax.axvline(moment.time, color=style.ALARM, linewidth=1.0, linestyle=(0, (4, 2)), zorder=1.5)
        for kind in MARKERS:
            times = [moment.time for moment in inside if moment.kind == kind]
            if times:
                ax.vlines(
                    times,
                    0.0,
                    1.0,
                    transform=ax.get_xaxis_transform(),
                    color="#cfcfcf",
                    linewidth=0.5,
                    zorder=1,
                )
                ax.plot(times, [1.0] * len(times), transform=ax.get_xaxis_transform(), **marker_of(kind))


def marker_of(kind: str) -> dict[str, Any]:
    """Return the look of the mark of a kind of moment."""
    return {"marker": MARKERS[kind], "markersize": 4.5, "markerfacecolor": "white", "markeredgecolor": style.GREY,
            "linestyle": "none", "clip_on": False, "zorder": 4}  # fmt: skip


def loop_columns(result: Result, names: tuple[str, ...]) -> list[int]:
    """Return the columns of the multipliers that belong to loops, not to joints moved by prescription."""
    multipliers = lock(result).get("multipliers")
    rows = multipliers.get("rows") if isinstance(multipliers, dict) else None
    found = [column for column, name in enumerate(names) if name in rows] if isinstance(rows, list) else []
    return found or list(range(len(names)))


def growth_times(result: Result) -> list[tuple[float, float]]:
    """Return (factor, time) at which the multipliers passed multiples of their running median."""
    table = lock(result).get("growth_times")
    if table is None:
        # Without a lock the run still says which thresholds were passed.
        criteria = result.summary.get("criteria")
        table = criteria.get("growth_times") if isinstance(criteria, dict) else None
    if not isinstance(table, dict):
        return []
    return sorted(
        (float(factor), float(time)) for factor, time in table.items() if isinstance(time, int | float)
    )
