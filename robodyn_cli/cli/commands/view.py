"""``robodyn view``."""

from __future__ import annotations

import tempfile
import webbrowser
from pathlib import Path

from robodyn_cli.cli.commands.report import shown
from robodyn_cli.cli.interrupts import tidy_up_first
from robodyn_cli.cli.options import LiveKeys, NoPlan, StoredResults, Told

EXAMPLES = (
    "view outputs/four_bar_deploy/deploy",
    "view outputs/first outputs/second",
    "view outputs/four_bar_deploy/deploy --live robot.links.crank.mass=5:60",
)


def command(
    results: StoredResults,
    live: LiveKeys,
    no_plan: NoPlan = False,
    *,
    told: Told,
) -> int:
    """Open a page with stored results in the browser; return the exit code."""
    from robodyn_cli.report.page.page import write_page

    console = told.console
    tidy_up_first()
    with console.waiting(lambda: "drawing"):
        pages = shown(results, not no_plan, live)
        target = Path(tempfile.mkdtemp(prefix="robodyn-")) / "report.html"
        write_page(pages, target)
    opened = webbrowser.open(target.as_uri())
    if not opened:
        console.warn(f"no browser was found; open {target} in one")
    console.data({"status": "ok", "file": str(target), "opened": opened})
    console.say(str(target))
    return 0
