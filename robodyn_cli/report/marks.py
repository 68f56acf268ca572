"""What a drawing says about the course of a run: a failure, a lock, the growth of the multipliers."""

from __future__ import annotations

import math
import textwrap
from typing import TYPE_CHECKING, Any

from robodyn_cli.report import style
from robodyn_cli.report.ticks import number
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


def lock(result: Result) -> dict[str, Any]:
    """Return what the run reported about its lock; empty if it did not lock."""
    found = result.summary.get("lock")
    return found if isinstance(found, dict) else {}


def lock_time(result: Result) -> float | None:
    """Return the time of the lock in seconds, or None."""
    time = lock(result).get("time")
    return float(time) if isinstance(time, int | float) and math.isfinite(time) else None


def mark_lock(axes: list[Axes], result: Result) -> None:
    """Mark the time of the lock by a vertical line with its value, on all of ``axes``."""
    time = lock_time(result)
    if time is None:
        return
    for ax in axes:
        ax.axvline(time, color=style.ALARM, linewidth=1.0, linestyle=(0, (4, 2)), zorder=1.5)
    first = axes[0]
    low, high = first.get_xlim()
    late = time > low + 0.6 * (high - low)
    kind = str(lock(result).get("kind") or "lock").replace("_", " ")
    first.annotate(
        f"{kind} at {number(time, 6)} s",
        (time, 1.0),
        xycoords=("data", "axes fraction"),
        xytext=(-4 if late else 4, -3),
        textcoords="offset points",
        ha="right" if late else "left",
        va="top",
        color=style.ALARM,
        bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.0},
    )


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
