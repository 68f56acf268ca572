"""``robodyn plot``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from robodyn_cli.cli.interrupts import tidy_up_first
from robodyn_cli.cli.options import StoredResults, Told
from robodyn_cli.cli.plot_options import NoTitles, PlotFormat, PlotNames, PlotStyle, PlotWidth

EXAMPLES = (
    "plot outputs/double_pendulum/simulate",
    "plot outputs/double_pendulum/simulate --plots joint_angles --format svg",
    "plot outputs/first outputs/second --out outputs/both",
    "plot outputs/double_pendulum/simulate --style paper --width 89mm --format pdf",
)


def command(
    results: StoredResults,
    out: Annotated[Path, typer.Option("--out", "-o", metavar="DIR", help="Where the plots go.")] = Path(
        "plots"
    ),
    plots: PlotNames = None,
    format_: PlotFormat = "png",
    style: PlotStyle = "screen",
    width: PlotWidth = None,
    no_titles: NoTitles = False,
    *,
    told: Told,
) -> int:
    """Draw stored results again; return the exit code."""
    from robodyn_cli.over.batch.stored import read_all
    from robodyn_cli.report.overlay import draw_again
    from robodyn_cli.report.registry import Drawings, doubts, not_drawn

    console = told.console
    tidy_up_first()
    with console.waiting(lambda: "drawing"):
        drawings, stored = Drawings(plots, format_, style, width, no_titles), read_all(results)
        files, missing = draw_again(stored, out, drawings)
    lacking = [f"no data for the plot {name}" for name in missing]
    for text in doubts(stored[0][1], drawings) if len(stored) == 1 else lacking:
        console.warn(text)
    for text in not_drawn(stored[0][1], drawings, files) if len(stored) == 1 else ():
        console.note(f"robodyn: {text}")
    console.data({"status": "ok", "files": [str(path) for path in files], "without_data": missing})
    console.say(f"{out}  ({', '.join(path.name for path in files)})")
    return 0
