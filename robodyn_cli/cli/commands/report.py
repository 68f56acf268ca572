"""``robodyn report``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from robodyn_cli.cli.interrupts import tidy_up_first
from robodyn_cli.cli.options import LiveKeys, NoPlan, StoredResults, Told
from robodyn_cli.errors import CapabilityError, RobodynError

if TYPE_CHECKING:
    from robodyn_cli.over.batch.stored import Stored
    from robodyn_cli.over.live.pages import Asked
    from robodyn_cli.report.page.page import Shown
    from robodyn_cli.results.result import Result

SUFFIXES = (".html", ".htm")


def page_file(word: str) -> Path:
    """Return the file of a page.

    Raises
    ------
    BadParameter : its name is not that of a page.
    """
    if not word.lower().endswith(SUFFIXES):
        raise typer.BadParameter(f"{word!r}; allowed: a name that ends with .html")
    return Path(word)


EXAMPLES = (
    "report outputs/four_bar_deploy/deploy --file four_bar.html",
    "report outputs/first outputs/second --file both.html",
    "report outputs/four_bar_deploy/deploy --file live.html --live robot.links.crank.mass=5:60",
)


def command(
    results: StoredResults,
    file: Annotated[
        Path,
        typer.Option(
            "--file", "-f", metavar="FILE.html", parser=page_file, help="Page to write.", show_default=False
        ),
    ],
    live: LiveKeys,
    no_plan: NoPlan = False,
    *,
    told: Told,
) -> int:
    """Write one page for a browser with stored results; return the exit code."""
    from robodyn_cli.report.page.page import write_page
    from robodyn_cli.results.summary import as_keys
    from robodyn_cli.summaries.checks import PageReport

    console = told.console
    tidy_up_first()
    with console.waiting(lambda: "drawing"):
        size = write_page(shown(results, not no_plan, live), file)
    console.data(as_keys(PageReport("ok", str(file), len(results), size)))
    console.say(f"{file}  ({size / 1024:.0f} KiB; it needs no network)")
    return 0


def shown(results: Sequence[Stored], planned: bool, live: Sequence[Asked] = ()) -> list[Shown]:
    """Return stored results for a page, with the plans of their scenes if ``planned``; live : keys with which they run
    there.

    Raises
    ------
    ResultFileError : a result cannot be read. CapabilityError : one has poses, but this version cannot read its scene;
    or a scene cannot run in a page. SceneError : no scene has a key.
    """
    from robodyn_cli.over.batch.stored import read_all
    from robodyn_cli.report.page.page import Shown
    from robodyn_cli.report.page.several import WHOLE
    from robodyn_cli.results.output_dir import path_ends

    paths, read = zip(*read_all(results))
    for path, result in zip(paths, read):
        _require_scene(path, result)
    parts: Sequence[Mapping[str, Any] | None] = [None] * len(read)
    if live:
        from robodyn_cli.over.live.pages import live_parts

        parts = live_parts(read, live)
    planned = planned and len(read) <= WHOLE
    return [
        Shown(label, result, plan_of(result) if planned else None, part)
        for label, result, part in zip(path_ends(paths), read, parts)
    ]


def _require_scene(path: Path, result: Result) -> None:
    """Refuse a result with poses of which this version cannot read the scene; say which result it is."""
    from robodyn_cli.report.drawing.build import has_poses, scene_of

    try:
        if has_poses(result):
            scene_of(result)
    except CapabilityError as error:
        raise CapabilityError(f"{path}: {error.message}") from error


def plan_of(result: Result) -> Mapping[str, Any] | None:
    """Return the plan of the scene that is stored in a result; None where its command has none."""
    from robodyn_cli.over.plan.plan import plan, subjects
    from robodyn_cli.scene.load import load_scene_text

    if result.command not in subjects:
        return None
    try:
        return plan(load_scene_text(result.scene_text), result.command)
    except RobodynError:  # an old scene that this version cannot read
        return None
