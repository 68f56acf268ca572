"""``robodyn simulate``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

import typer

from robodyn_cli.cli.options import NO_ERROR_ESTIMATE, NoErrorEstimate, SceneFile, SharedOptions, Strict
from robodyn_cli.cli.runner import run_scene
from robodyn_cli.cli.words import (
    balance_lines,
    cost_line,
    drive_lines,
    error_lines,
    extreme_lines,
    motorisation_lines,
    number,
    table,
)

MOST_ROWS = 12  # of the table of tracking errors


def describe(summary: Mapping[str, Any]) -> str:
    """Return the summary of a simulation."""
    tolerances = ", ".join(f"{k} {v:.4g}" for k, v in summary.get("tolerances", {}).items())
    lines = [
        f"{summary['title']}",
        f"  simulated          {number(summary['termination'].get('time'))} s, {summary['samples']} samples, "
        f"{summary['integrator']} ({tolerances})",
        *error_lines(summary),
        *(_control_lines(summary["control"]) if "control" in summary else ()),
        *drive_lines(summary),
        *_happenings(summary),
        *extreme_lines(summary),
        *balance_lines(summary),
        *motorisation_lines(summary),
        cost_line(summary),
    ]
    return "\n".join(lines)


def _happenings(summary: Mapping[str, Any]) -> list[str]:
    """Return lines about latches and payloads, where there are some."""
    if "locks" not in summary and "payloads" not in summary:
        return []
    from robodyn_cli.cli.latch_words import latch_lines, payload_lines

    return [*latch_lines(summary), *payload_lines(summary)]


def _control_lines(control: Mapping[str, Any]) -> list[str]:
    """Return how a controller has followed: for each coordinate its largest error, and time at limits."""
    sampled = (
        f", {control['updates']} samples every {number(control['period'])} s" if "period" in control else ""
    )
    lines = [f"  controller         {control['type']}{sampled}"]
    if tracking := control.get("tracking"):
        lines += ["", _tracking_table(tracking, control.get("saturated", {})), ""]
    return lines


def _tracking_table(tracking: Mapping[str, Any], saturated: Mapping[str, float]) -> str:
    """Return the errors of coordinates as a table, those with the largest ones where there are many."""
    shown = list(tracking)
    if len(shown) > MOST_ROWS:
        shown = sorted(sorted(shown, key=lambda name: -tracking[name]["peak"])[:MOST_ROWS], key=shown.index)
    limited = any(time > 0.0 for time in saturated.values())
    rows = [["tracking", "largest error", "", "at [s]", "RMS", *(["at its limit [s]"] if limited else [])]]
    for name in shown:
        own = tracking[name]
        row = [name, number(own["peak"], 4), own["unit"], number(own["at"], 5), number(own["rms"], 4)]
        rows.append([*row, *([number(saturated.get(name), 4)] if limited else [])])
    more = len(tracking) - len(shown)
    rest = f"\n  ... and {more} with smaller errors in summary.json" if more else ""
    return table(rows) + rest


def command(
    scene: SceneFile,
    shared: SharedOptions,
    strict: Strict = False,
    no_error_estimate: NoErrorEstimate = False,
    resume: Annotated[
        bool,
        typer.Option("--resume", help="Go on with a long run that was killed, from its last written block."),
    ] = False,
) -> int:
    """Run the simulation, from its start or from where it was killed."""
    job = shared.job("simulate", scene, strict, NO_ERROR_ESTIMATE if no_error_estimate else (), resume=resume)
    return run_scene(job, shared.console, describe)
