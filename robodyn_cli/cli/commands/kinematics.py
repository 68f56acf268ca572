"""``robodyn kinematics``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from robodyn_cli.cli.options import SceneFile, SharedOptions, Strict
from robodyn_cli.cli.runner import run_scene
from robodyn_cli.cli.words import (
    error_text,
    mobility_lines,
    motorisation_lines,
    number,
    stated,
)


def describe(summary: Mapping[str, Any], verbose: bool = True, figures: Sequence[str] = ()) -> str:
    """Return the summary of a kinematic analysis."""
    lines = [
        f"{summary['title']}",
        f"  moved              {number(summary['termination'].get('time'))} s, {summary['samples']} samples",
    ]
    lines += figures
    lines += mobility_lines(summary) if verbose else []
    lines += _design_lines(summary)
    lines += motorisation_lines(summary)
    return "\n".join(lines)


def _design_lines(summary: Mapping[str, Any]) -> list[str]:
    """Return what kinematic design tells beside extremes."""
    design, lines = summary.get("design") or {}, []
    for name, one in (design.get("four_bars") or {}).items():
        margin = stated(one["margin"], one["margin_error"])
        lines.append(f"  four-bar           {name}: {one['type']} on {one['ground']}, margin {margin} m")
        for joint, ends in one["joints"].items():
            if ends["lower"] is not None:
                lines.append(
                    f"    {joint}: dead points at {stated(ends['lower'], ends['error'])} and "
                    f"{stated(ends['upper'], ends['error'])}{_nearest(ends['distance'], ends['distance_error'])}"
                )
    for name, points in (design.get("dead_points") or {}).items():
        lines.append(
            f"  dead points        {name}: at t = "
            f"{', '.join(stated(one['time'], one['time_error']) for one in points)} s"
        )
    for path, one in (design.get("unbounded") or {}).items():
        times = ", ".join(stated(time, one["error"]) for time in one["times"])
        when = "at all times" if one["throughout"] else f"at t = {times} s"
        lines.append(f"  unbounded          {path}: {when}")
    return lines


def _nearest(distance: float | None, error: float | None) -> str:
    """Return how near a motion comes to a dead point, or that it reaches it or goes beyond."""
    if distance is None:
        return ""
    if abs(distance) <= (error or 0.0):
        return f", reached by the motion within {error_text(error or 0.0)}"
    beyond = "gone beyond by" if distance < 0.0 else "motion within"
    return f", {beyond} {stated(abs(distance), error)}{' of one' if distance > 0.0 else ''}"


EXAMPLES = (
    "kinematics configs/mechanisms/four_bar_kinematics.yaml",
    "kinematics configs/mechanisms/kinematic_design.yaml",
    "kinematics configs/mechanisms/five_bar_circle.yaml --plots tip_path",
)


def command(scene: SceneFile, shared: SharedOptions, strict: Strict = False) -> int:
    """Move a mechanism by its driven joints; return the exit code."""
    return run_scene(shared.job("kinematics", scene, strict), shared.console, describe)
