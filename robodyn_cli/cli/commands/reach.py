"""``robodyn reach``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

import typer

from robodyn_cli.cli.offers import names_in
from robodyn_cli.cli.options import SceneFile, SharedOptions, Strict, utf8
from robodyn_cli.cli.runner import run_scene
from robodyn_cli.cli.words import coordinate_table, error_text, number, table
from robodyn_cli.scene.text.overrides import AskedSetting
from robodyn_cli.summaries.facts import OWN

ROUNDING = 1e-12  # rad or m


EXAMPLES = (
    "reach configs/mechanisms/puma_reach.yaml",
    "reach configs/mechanisms/puma_reach.yaml --branch lefty-elbow_up-flip",
    "reach configs/mechanisms/puma_reach.yaml --position 0.4,0.2,0.9 --rpy '0,90 deg,0.3'",
)


def command(
    scene: SceneFile,
    frame: Annotated[
        str | None,
        typer.Option(
            "--frame",
            metavar="NAME",
            parser=utf8,
            autocompletion=names_in("robot.points", "robot.frames", "robot.links"),
            help="What is to go there: point, frame or link.",
        ),
    ] = None,
    position: Annotated[
        str | None, typer.Option("--position", metavar="X,Y,Z", parser=utf8, help="Where, in the world [m].")
    ] = None,
    rpy: Annotated[
        str | None,
        typer.Option("--rpy", metavar="R,P,Y", parser=utf8, help="Its roll, pitch, yaw; `90 deg` goes too."),
    ] = None,
    branch: Annotated[
        str | None, typer.Option("--branch", metavar="NAME", parser=utf8, help="The branch to take.")
    ] = None,
    *,
    shared: SharedOptions,
    strict: Strict = False,
) -> int:
    """Run the command; return its exit code."""
    options = (
        (frame, f"reach.frame={frame}", f"--frame {frame}"),
        (position, f"reach.position=[{position}]", f"--position {position}"),
        (rpy, f"reach.orientation.rpy=[{rpy}]", f"--rpy {rpy}"),
        (branch, f"reach.branch={branch}", f"--branch {branch}"),
    )
    settings = [
        AskedSetting(text, option, names_key=False) for given, text, option in options if given is not None
    ]
    return run_scene(shared.job("reach", scene, strict, settings), shared.console, describe)


def describe(summary: Mapping[str, Any], verbose: bool = True) -> str:
    """Return the summary for the terminal."""
    branch = summary.get("branch")
    how = f"in closed form, branch {branch}" if branch else "by damped steps"
    lines = [
        f"{summary['title']}",
        f"  {summary['frame']:<18} brought to the pose {how}; error {error_text(summary['error'])} m or rad",
    ]
    chosen = {name: _position(q) for name, q in summary["configuration"].items()}
    lines.append(coordinate_table(summary["units"], [("position", chosen, OWN, 9)]))
    lines.append(f"  singular ratio     {number(summary['singular_ratio'], 3)} (0: a singular pose)")
    if summary["freedom"]:
        lines.append(f"  freedom left       {summary['freedom']}: there are infinitely many ways")
    listed = summary.get("branches") or []
    if listed and not verbose:
        reached = sum(facts["reached"] for facts in listed)
        lines.append(f"  branches           {reached} of {len(listed)} reach the pose; -v lists them")
    if listed and verbose:
        rows = [["branch", *listed[0]["configuration"], "reached", "within limits"]]
        for facts in listed:
            name = f"{facts['name']} (chosen)" if facts["chosen"] else facts["name"]
            q = [number(_position(x)) if facts["reached"] else "-" for x in facts["configuration"].values()]
            within = ("yes" if facts["within_limits"] else "no") if facts["reached"] else "-"
            rows.append([name, *q, "yes" if facts["reached"] else "no", within])
        lines.append(table(rows))
    if listed and not branch:
        lines.append("  that there are no other ways is not proved")
    return "\n".join(lines)


def _position(q: float) -> float:
    """Return a position for reading: what rounding makes of zero is 0."""
    return 0.0 if abs(q) < ROUNDING else q
