"""Summaries of kinematics, statics and assembly in words, for the terminal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from robodyn_cli.cli.describe import multiplier_lines, number, table


def describe_kinematics(summary: Mapping[str, Any]) -> str:
    """Return the summary of a kinematic analysis."""
    lines = [
        f"{summary['title']}",
        f"  moved              {number(summary['termination'].get('time'))} s, {summary['samples']} samples",
    ]
    rows = [["joint", "smallest", "largest", "peak speed", "peak acceleration"]]
    for name, row in summary.get("joints", {}).items():
        keys = ("smallest", "largest", "peak_speed", "peak_acceleration")
        rows.append([name, *(number(row[key]) for key in keys)])
    lines.append(table(rows))
    points = [["point", "path length", "peak speed", "peak acceleration"]]
    for name, row in summary.get("points", {}).items():
        points.append(
            [name, *(number(row[key]) for key in ("path_length", "peak_speed", "peak_acceleration"))]
        )
    if len(points) > 1:
        lines.append(table(points))
    lines += mobility_lines(summary)
    ratio = summary.get("singular_ratio")
    if ratio:
        lines.append(f"  nearest dead point ratio {ratio['smallest']:.3g} at t = {number(ratio['time'])} s")
    angle = summary.get("transmission_angle")
    if angle:
        lines.append(
            f"  transmission       {number(angle['smallest_deg'], 5)} to {number(angle['largest_deg'], 5)} deg"
        )
    closure = summary.get("error_estimate", {}).get("closure")
    if closure:
        lines.append("  closure            " + closure_text(closure))
    return "\n".join(lines)


def mobility_lines(summary: Mapping[str, Any]) -> list[str]:
    """Return what is said about degrees of freedom."""
    found = summary.get("mobility")
    if not found:
        return []
    return [
        f"  mobility           {found['actual']} (rank {found['rank']} of {found['rows']} rows over "
        f"{found['coordinates']} coordinates); Gruebler's count {found['count']} in space, {found['planar_count']} "
        "without vanishing rows"
    ]


def closure_text(closure: Mapping[str, float]) -> str:
    """Return residuals of the loops in words."""
    units = {"position": "m", "velocity": "m/s", "acceleration": "m/s^2"}
    return ", ".join(f"{key} {closure[key]:.1e} {unit}" for key, unit in units.items() if key in closure)


def describe_assemble(summary: Mapping[str, Any]) -> str:
    """Return the summary of an assembly."""
    held = ", ".join(summary["held"]) or "none"
    lines = [
        f"{summary['title']}",
        f"  closed             held: {held}; solved: {', '.join(summary['solved'])}",
    ]
    rows = [["coordinate", "position", "rate", "acceleration"]]
    rates, accelerations = summary["rates"], summary["accelerations"]
    same = set(rates) == set(summary["configuration"])
    for name, q in summary["configuration"].items():
        rows.append(
            [
                name,
                number(q, 9),
                number(rates[name]) if same else "",
                number(accelerations[name]) if same else "",
            ]
        )
    lines.append(table(rows))
    lines.append("  residual           " + closure_text(summary["residual"]))
    if summary["redundant_rows"]:
        lines.append(f"  redundant rows     {', '.join(summary['redundant_rows'])}")
    lines += mobility_lines(summary)
    branches = summary.get("branches")
    if branches:
        names = list(branches[0]["configuration"])
        head = ["branch", *names, "orientation", "singular ratio"]
        listed = [head]
        for k, branch in enumerate(branches, start=1):
            sign = {1: "+", -1: "-", 0: "0"}.get(branch["orientation"], "?")
            chosen = f"{k} (chosen)" if branch["chosen"] else str(k)
            q = [number(x, 8) for x in branch["configuration"].values()]
            listed.append([chosen, *q, sign, number(branch["singular_ratio"], 3)])
        lines.append(table(listed))
        found = summary["branch_search"]
        lines.append(
            f"  search             {found['found']} branches found from {found['starts']} starts, of which "
            f"{found['closed']} closed; that there are no others is not proved"
        )
    return "\n".join(lines)


def describe_statics(summary: Mapping[str, Any]) -> str:
    """Return the summary of a static analysis."""
    facts = summary["equilibrium"]
    lines = [f"{summary['title']}"]
    if summary["find"] == "balance":
        stiffness = ", ".join(
            str(complex(*x)) if isinstance(x, list) else number(x) for x in facts["stiffness"]
        )
        spread = f"; reduced stiffness {stiffness} N m/rad or N/m" if stiffness else ""
        lines.append(f"  balanced           {facts['stability']}{spread}")
    else:
        lines.append(f"  held               by {', '.join(facts['actuated'])}; torques {facts['torques']}")
    rows = [["coordinate", "position", "torque or force"]]
    torques = summary["torques_of_joints"]
    for name, q in summary["configuration"].items():
        rows.append([name, number(q, 9), number(torques[name]) if name in torques else ""])
    lines.append(table(rows))
    multipliers = summary.get("multipliers")
    if multipliers:
        lines.append("  multipliers        " + ", ".join(f"{k} {number(x)}" for k, x in multipliers.items()))
    lines += multiplier_lines(summary)
    lines.append(f"  residual           {facts['residual']:.1e} N m or N")
    lines += mobility_lines(summary)
    return "\n".join(lines)
