"""``robodyn inverse``."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from robodyn_cli.cli.options import SceneFile, SharedOptions, Strict
from robodyn_cli.cli.runner import run_scene
from robodyn_cli.cli.words import (
    Figures,
    balance_lines,
    cost_lines,
    drive_lines,
    error_text,
    figure_columns,
    meanings,
    motorisation_lines,
    multiplier_lines,
    table,
)
from robodyn_cli.summaries.inverse import JointFigures

# of the table of an inverse run: heading, key in the summary, quantity that the unit belongs to, digits
FIGURES = (
    ("peak torque", "peak_torque", "torque", 6),
    ("at t", "peak_torque_time", "time", 4),
    ("RMS torque", "rms_torque", "torque", 6),
    ("peak speed", "peak_speed", "speed", 4),
    ("peak power", "peak_power", "power", 4),
    ("energy", "energy", "energy", 4),
)


EXPLAINED = ("peak_power", "energy")  # figures whose headings do not say what they are
HEADLINES = 3  # of these, where not all is told
MOST_JOINTS = 12


def describe(summary: Mapping[str, Any], verbose: bool = True) -> str:
    """Return the summary of an inverse run."""
    lines = [f"{summary['title']}"]
    joints: Mapping[str, Mapping[str, Any]] = summary.get("joints", {})
    off = (summary.get("error_estimate") or {}).get("torque_rounding")
    if joints:
        errors = dict.fromkeys(("peak_torque", "rms_torque"), off or 0.0)
        shown = list(joints) if verbose else _most_loaded(joints)
        figures = FIGURES if verbose else FIGURES[:HEADLINES]
        columns = figure_columns([joints[name] for name in shown], figures, errors)
        lines.append(table(list(zip(["joint", *shown], *columns))))
        if len(shown) < len(joints):
            lines.append(f"  ... and {len(joints) - len(shown)} joints with smaller torques")
        lines += _errors([joints[name] for name in shown], figures)
        if verbose:
            lines += [
                f"  {key.replace('_', ' '):<18} {text}" for key, text in meanings(JointFigures, EXPLAINED)
            ]
    for label, key, unit in (
        ("path error", "ik_residual", "m"),
        ("attitude error", "attitude_residual", "rad"),
        ("round trip error", "round_trip", "relative, forward dynamics after inverse"),
    ):
        value = summary.get(key)
        if verbose and isinstance(value, float) and math.isfinite(value):
            lines.append(f"  {label:<18} {error_text(value)} {unit}")
    if off is not None:
        lines.append(f"  rounding           torques off by some {error_text(off)} N m or N")
    lines += drive_lines(summary)
    lines += balance_lines(summary)
    lines += motorisation_lines(summary)
    lines += _fastest(summary)
    lines += multiplier_lines(summary)
    lines += cost_lines(summary, verbose)
    return "\n".join(lines)


def _errors(rows: Sequence[Mapping[str, Any]], figures: Figures) -> list[str]:
    """Return a line with the largest error of each column that is due to what lies between the samples."""
    parts = []
    for heading, key, quantity, _ in figures:
        largest: dict[str, float] = {}
        for row in rows:
            unit = {**row["units"], "time": "s"}[quantity]
            off = (row.get("errors") or {}).get(key)
            if off is not None:
                largest[unit] = max(off, largest.get(unit, 0.0))
        if largest:
            parts.append(
                f"{heading} {', '.join(f'{error_text(off)} {unit}' for unit, off in largest.items())}"
            )
    return [f"  between samples    off by at most: {'; '.join(parts)}"] if parts else []


def _most_loaded(joints: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Return the joints with the largest torques, in their own order."""
    found = sorted(joints, key=lambda name: -abs(joints[name].get("peak_torque") or 0.0))[:MOST_JOINTS]
    return [name for name in joints if name in found]


def _fastest(summary: Mapping[str, Any]) -> list[str]:
    """Return the lines about a path in the least time."""
    least_time: Mapping[str, Any] | None = summary.get("fastest")
    if not least_time:
        return []
    parts = sorted(least_time["binding"].items(), key=lambda item: -item[1])
    binding = ", ".join(f"{name} {100.0 * part:.3g} %" for name, part in parts) or "none"
    return [
        f"  least time         {least_time['duration']:.9g} s, +- {error_text(least_time['duration_error'])} s",
        f"  binding limits     {binding} of the time",
    ]


EXAMPLES = (
    "inverse configs/2r_circle.yaml",
    "inverse configs/2r_circle.yaml --set trajectory.ik.branch=elbow_down --out outputs/elbow_down",
    "inverse configs/mechanisms/five_bar_circle.yaml --json",
)


def command(scene: SceneFile, shared: SharedOptions, strict: Strict = False) -> int:
    """Compute the torques of a motion; return the exit code."""
    return run_scene(shared.job("inverse", scene, strict), shared.console, describe)
