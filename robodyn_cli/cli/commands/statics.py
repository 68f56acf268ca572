"""``robodyn statics``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from robodyn_cli.cli.options import SceneFile, SharedOptions, Strict
from robodyn_cli.cli.runner import run_scene
from robodyn_cli.cli.words import (
    coordinate_table,
    error_text,
    holding_lines,
    mobility_lines,
    multiplier_lines,
    number,
)
from robodyn_cli.summaries.facts import LOAD, OWN


def describe(summary: Mapping[str, Any], verbose: bool = True) -> str:
    """Return the summary of a static analysis."""
    facts = summary["equilibrium"]
    lines = [f"{summary['title']}"]
    if summary["find"] == "balance":
        stiffness = ", ".join(
            str(complex(*x)) if isinstance(x, list) else number(x) for x in facts["stiffness"]
        )
        spread = f"; reduced stiffness {stiffness} N m/rad or N/m" if stiffness else ""
        lines.append(f"  balanced           {facts['stability']}{spread}")
        lines += holding_lines(facts.get("holding", {}), summary["units"])
    else:
        lines.append(f"  held               by {', '.join(facts['actuated'])}; torques {facts['torques']}")
    loads = ("torque or force", summary["torques_of_joints"], LOAD, 6)
    columns = [("position", summary["configuration"], OWN, 9), loads]
    lines.append(coordinate_table(summary["units"], columns))
    multipliers = summary.get("multipliers")
    if verbose and multipliers:
        listed = ", ".join(f"{k} {number(x)}" for k, x in multipliers.items())
        lines.append(f"  multipliers        {listed} (N or N m)")
    lines += multiplier_lines(summary)
    lines.append(f"  residual           {error_text(facts['residual'])} N m or N")
    lines += mobility_lines(summary) if verbose else []
    return "\n".join(lines)


EXAMPLES = (
    "statics configs/double_pendulum.yaml --no-plots",
    "statics configs/four_bar_deploy.yaml --set statics.find=hold",
    "statics configs/search/spring_balance.yaml --json",
)


def command(scene: SceneFile, shared: SharedOptions, strict: Strict = False) -> int:
    """Find torques or a balance at rest; return the exit code."""
    return run_scene(shared.job("statics", scene, strict), shared.console, describe)
