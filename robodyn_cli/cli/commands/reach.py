"""``robodyn reach``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import typer

from robodyn_cli.cli.figure_words import figure_table
from robodyn_cli.cli.offers import names_in
from robodyn_cli.cli.options import SceneFile, SharedOptions, Strict, utf8
from robodyn_cli.cli.runner import run_scene
from robodyn_cli.cli.words import error_text, stated
from robodyn_cli.report.cells import Figure, Table
from robodyn_cli.scene.text.overrides import AskedSetting

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


def describe(summary: Mapping[str, Any], verbose: bool = True, figures: Sequence[str] = ()) -> str:
    """Return the summary for the terminal."""
    branch = summary.get("branch")
    how = f"in closed form, branch {branch}" if branch else "by damped steps"
    lines = [
        f"{summary['title']}",
        f"  {summary['frame']:<18} brought to the pose {how}; error {error_text(summary['error'])} m or rad",
        *figures,
    ]
    ratio = stated(summary["singular_ratio"], summary["singular_ratio_error"])
    lines.append(f"  singular ratio     {ratio} (0: a singular pose)")
    if summary["freedom"]:
        lines.append(f"  freedom left       {summary['freedom']}: there are infinitely many ways")
    listed = summary.get("branches") or []
    if listed and not verbose:
        reached = sum(facts["reached"] for facts in listed)
        lines.append(f"  branches           {reached} of {len(listed)} reach the pose; -v lists them")
    if listed and verbose:
        lines.append(_branches(summary))
    if listed and not branch:
        lines.append("  that there are no other ways is not proved")
    return "\n".join(lines)


def _branches(summary: Mapping[str, Any]) -> str:
    """Return the table of the ways to reach the pose."""
    listed, rows = summary["branches"], list[list[str | Figure]]()
    for facts in listed:
        name = f"{facts['name']} (chosen)" if facts["chosen"] else facts["name"]
        q: list[str | Figure] = ["-"] * len(facts["configuration"])
        if facts["reached"]:
            units, off = summary["units"], facts["errors"]
            q = [Figure(x, off[joint], units[joint]) for joint, x in facts["configuration"].items()]
        within = ("yes" if facts["within_limits"] else "no") if facts["reached"] else "-"
        rows.append([name, *q, "yes" if facts["reached"] else "no", within])
    return figure_table(Table(("branch", *listed[0]["configuration"], "reached", "within limits"), rows))
