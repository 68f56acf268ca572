"""``robodyn crosscheck``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from robodyn_cli.cli.console import Console
from robodyn_cli.cli.options import Overrides, Quiet, ReportAsJson, SceneFile, choice
from robodyn_cli.cli.runner import placed
from robodyn_cli.cli.words import error_text, table
from robodyn_cli.errors import FAILED

if TYPE_CHECKING:
    from robodyn_cli.summaries.checks import CrosscheckReport


def command(
    scene: SceneFile,
    engine: Annotated[
        str,
        typer.Option(
            "--with",
            metavar="ENGINE",
            parser=choice("pinocchio", "mujoco"),
            help="The other engine: pinocchio or mujoco.",
        ),
    ],
    asked: Annotated[
        str | None,
        typer.Option(
            "--command",
            metavar="NAME",
            parser=choice("inverse", "simulate"),
            help="What to compare: inverse or simulate; default: the scene's command.",
        ),
    ] = None,
    overrides: Overrides = None,
    as_json: ReportAsJson = False,
    quiet: Quiet = False,
) -> int:
    """Compare a scene with another engine; return the exit code, 1 where they differ beyond their errors."""
    from robodyn_cli.over.crosscheck.crosscheck import compared_command, crosscheck
    from robodyn_cli.results.summary import as_keys, jsonable
    from robodyn_cli.scene.load import load_scene

    console = Console(as_json, quiet)
    loaded = load_scene(scene, overrides or ())
    command = asked or compared_command(loaded)
    with console.waiting(lambda: f"comparing with {engine}"), placed(scene, overrides or (), command):
        report = crosscheck(loaded, engine, command)
    console.data(jsonable(as_keys(report)))
    console.say(describe(report))
    return 0 if report.agrees else FAILED


def describe(report: CrosscheckReport) -> str:
    """Return the comparison for the terminal."""
    rows = [["", "largest difference", "at", "here", "there", "error here", "error there"]]
    for one in report.compared:
        rows.append(
            [
                one.quantity, f"{one.difference:.2e}", f"{one.column}, t = {one.time:.6g} s", f"{one.ours:.12g}",
                f"{one.theirs:.12g}", error_text(one.our_error), error_text(one.their_error),
            ]
        )  # fmt: skip
    verdict = "agree within their errors" if report.agrees else "DIFFER beyond their errors"
    lines = [
        f"{report.title}: {report.command} here and in {report.engine} {report.version}: the answers {verdict}",
        table(rows),
    ]
    if report.by_own_formulas:
        lines.append(f"  by formulas of the check   {', '.join(report.by_own_formulas)}")
    if report.handed_over:
        lines.append(f"  handed over, not checked   {', '.join(report.handed_over)}")
    return "\n".join(lines)
