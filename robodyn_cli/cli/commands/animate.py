"""``robodyn animate``."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from robodyn_cli.cli.interrupts import tidy_up_first
from robodyn_cli.cli.options import StoredResult, Told, number, quantity, utf8

positive = number("a number > 0", lambda x: 0.0 < x < math.inf)


EXAMPLES = (
    "animate outputs/four_bar_deploy/deploy --file four_bar.gif",
    "animate outputs/four_bar_deploy/deploy --file four_bar.mp4",
    "animate outputs/four_bar_deploy/deploy --file strip.png",
)


def command(
    result: StoredResult,
    file: Annotated[
        Path,
        typer.Option(
            "--file",
            "-f",
            metavar="FILE",
            help="Movie to write: .gif, .mp4, .webp, or .png for a strip of stills.",
            show_default=False,
        ),
    ],
    speed: Annotated[
        float | None,
        typer.Option(
            "--speed",
            metavar="X",
            parser=positive,
            help="Seconds of the run in a second of the movie. [default: 1, or what makes it 3 to 20 s long]",
        ),
    ] = None,
    fps: Annotated[
        float,
        typer.Option(
            "--fps",
            metavar="N",
            parser=number("a number > 0 and <= 100", lambda x: 0.0 < x <= 100.0, quantity("1/s")),
            help="Frames in a second.",
        ),
    ] = 25.0,
    follow: Annotated[
        str | None,
        typer.Option("--follow", metavar="POINT", parser=utf8, help="Named point that stays in the middle."),
    ] = None,
    *,
    told: Told,
) -> int:
    """Make a movie of a stored result; return the exit code."""
    from robodyn_cli.over.batch.stored import read_stored
    from robodyn_cli.report.movie.animate import animate
    from robodyn_cli.results.summary import as_keys

    console = told.console
    tidy_up_first()
    with console.waiting(lambda: "drawing"):
        report = as_keys(animate(read_stored(result, needed), file, speed, fps, follow, console.progress))
    console.data(report)
    console.say(describe(report))
    return 0


def needed(path: str) -> bool:
    """Tell whether a picture of the mechanism shows a dataset."""
    return path in ("time", "q", "qd") or path.startswith(("points/", "reactions/", "loop_reactions/"))


def describe(report: Mapping[str, Any]) -> str:
    """Return what was written, for the terminal."""
    size = f"{report['size'] / 1024:.0f} KiB"
    if "stills" in report:
        return f"{report['file']}  ({report['stills']} stills, {size})"
    moving = report["frames"] - report["held"]
    return (
        f"{report['file']}  ({moving} frames, then the last one for {report['held'] / report['fps']:.4g} s; "
        f"{report['duration']:.4g} s in all at {report['fps']:.4g} a second, speed {report['speed']:.4g}, {size})"
    )
