"""``robodyn check``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from robodyn_cli.cli.options import StoredResult, Told, file
from robodyn_cli.errors import FAILED, SceneError

EXAMPLES = (
    "check outputs/four_bar_deploy/deploy",
    "check outputs/four_bar_deploy/deploy configs/four_bar_deploy.yaml",
    "check outputs/2r_circle/inverse --json",
)


def command(
    result: StoredResult,
    scene: Annotated[
        Path | None,
        typer.Argument(
            metavar="SCENE.yaml",
            callback=file,
            show_default=False,
            help="Scene with the criteria; default: the result's own.",
        ),
    ] = None,
    *,
    told: Told,
) -> int:
    """Judge a stored result; return 1 where an expectation does not hold."""
    from robodyn_cli.over.batch.criteria import judge
    from robodyn_cli.over.batch.reports import check_of
    from robodyn_cli.over.batch.stored import summary_and_scene
    from robodyn_cli.results.summary import as_keys
    from robodyn_cli.scene.load import load_scene, load_scene_text

    console = told.console
    summary, text = summary_and_scene(result)
    if scene is not None:
        expect = load_scene(scene).expect
    elif text is not None:
        expect = load_scene_text(text, str(result)).expect
    else:
        raise SceneError(
            f"{result}: there is no scene with it, only a summary; name the scene: check RESULT SCENE"
        )
    if not expect:
        raise SceneError(
            f"{scene or result}: there are no criteria; add 'expect' to the scene, or name one that has it"
        )
    outcomes = judge(expect, summary, f"{scene or result}: ")
    for outcome in outcomes:
        console.say(f"{'ok' if outcome.holds else 'failed':<7} {outcome}")
    report = check_of(outcomes)
    console.data(as_keys(report))
    return FAILED if report.failed else 0
