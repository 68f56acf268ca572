"""``robodyn statics``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from robodyn_cli.cli.options import SceneFile, SharedOptions, Strict
from robodyn_cli.cli.runner import run_scene
from robodyn_cli.cli.words import (
    holding_lines,
    mobility_lines,
    multiplier_lines,
    stated,
)
from robodyn_cli.summaries.facts import STIFFNESS

SMALLEST = 3  # values of the stiffness that are told


def describe(summary: Mapping[str, Any], verbose: bool = True, figures: Sequence[str] = ()) -> str:
    """Return the summary of a static analysis."""
    facts = summary["equilibrium"]
    lines = [f"{summary['title']}"]
    if summary["find"] == "balance":
        lines.append(f"  balanced           {facts['stability']}{_stiffness(summary, verbose)}")
        off = summary["error_estimate"].get("holding", {})
        lines += holding_lines(facts.get("holding", {}), off, summary["units"])
    else:
        lines.append(f"  held               by {', '.join(facts['actuated'])}; torques {facts['torques']}")
    lines += figures
    lines += multiplier_lines(summary)
    lines += mobility_lines(summary) if verbose else []
    return "\n".join(lines)


def _stiffness(summary: Mapping[str, Any], verbose: bool) -> str:
    """Return the reduced stiffness in words: in the unit of the coordinates that are free where they have one.

    Of many values the smallest are told, which say whether the balance is stable, unless all are asked for."""
    facts = summary["equilibrium"]
    if not facts["stiffness"]:
        return ""
    error = facts["stiffness_error"]
    told = facts["stiffness"] if verbose else facts["stiffness"][:SMALLEST]
    values = ", ".join(str(complex(*x)) if isinstance(x, list) else stated(x, error) for x in told)
    more = len(facts["stiffness"]) - len(told)
    free = [unit for name, unit in summary["units"].items() if name not in facts.get("holding", {})]
    kinds = {"rad" if unit == "1" else unit for unit in free}  # coordinates of an attitude have the unit 1
    unit = STIFFNESS(kinds.pop() if len(kinds) == 1 else "")
    return f"; reduced stiffness {values} {unit}" + (f" and {more} larger; -v tells all" if more else "")


EXAMPLES = (
    "statics configs/double_pendulum.yaml --no-plots",
    "statics configs/four_bar_deploy.yaml --set statics.find=hold",
    "statics configs/published/gripper_2f85.yaml --json",
)


def command(scene: SceneFile, shared: SharedOptions, strict: Strict = False) -> int:
    """Find torques or a balance at rest; return the exit code."""
    return run_scene(shared.job("statics", scene, strict), shared.console, describe)
