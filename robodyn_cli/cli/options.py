"""Arguments and options that several commands share, and their parsers."""

from __future__ import annotations

import math
import os
import stat
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from robodyn_cli.commands import PLOT_FORMATS
from robodyn_cli.errors import did_you_mean

if TYPE_CHECKING:
    from robodyn_cli.report.registry import Drawings


def utf8(value: str) -> str:
    """Return the value of an option as it is.

    Raises
    ------
    BadParameter : it is not text; Python has put marks in place of its bytes.
    """
    try:
        value.encode()
    except UnicodeEncodeError:
        raise typer.BadParameter(f"{os.fsencode(value)!r} is no text; allowed: text in UTF-8") from None
    return value


def number(
    allowed: str, fits: Callable[[float], bool], kind: Callable[[str], Any] = float
) -> Callable[[str], Any]:
    """Return the parser of a number: a function that takes a word. ``allowed`` describes the numbers for which
    ``fits`` is true. The function raises BadParameter for any other word.
    """

    def read(word: str) -> Any:
        try:
            value = kind(word)
        except ValueError:
            value = math.nan
        if not fits(value):
            raise typer.BadParameter(f"{word!r}; allowed: {allowed}")
        return value

    return read


def choice(*allowed: str) -> Callable[[str], str]:
    """Return the parser of one of some words: a function that raises BadParameter for any other."""

    def read(word: str) -> str:
        if word not in allowed:
            raise typer.BadParameter(f"{word!r}; allowed: {', '.join(allowed)}")
        return word

    return read


def file(path: Any) -> Any:
    """Return the path of a scene, or the paths of several.

    Raises
    ------
    BadParameter : one is a pipe or a device, which might never end.
    """
    for one in path if isinstance(path, (list, tuple)) else [path]:
        try:
            mode = os.stat(one).st_mode if one is not None else stat.S_IFREG
        except (OSError, ValueError):
            continue  # reported where the file is opened
        if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
            raise typer.BadParameter(f"{str(one)!r} is a pipe or a device; allowed: a file")
    return path


SceneFile = Annotated[
    Path, typer.Argument(metavar="SCENE.yaml", help="Scene to run.", callback=file, show_default=False)
]
SceneFiles = Annotated[
    list[str],
    typer.Argument(
        metavar="SCENE...|GLOB|DIR", help="Scenes, patterns, folders.", callback=file, show_default=False
    ),
]
StoredResult = Annotated[
    Path,
    typer.Argument(metavar="RESULT", help="Output directory of a run, or its result.h5.", show_default=False),
]
StoredResults = Annotated[
    list[Path],
    typer.Argument(
        metavar="RESULT...", help="Output directories of runs, or their result.h5.", show_default=False
    ),
]
OutDir = Annotated[
    Path | None,
    typer.Option("--out", "-o", metavar="DIR", help="Output directory. [default: outputs/<scene>/<command>]"),
]
Overrides = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        parser=utf8,
        help="Override a key of the scene, e.g. simulate.rtol=1e-12.",
    ),
]


def plot_list(words: str) -> tuple[str, ...]:
    """Return the names of plots in a list with commas.

    Raises
    ------
    BadParameter : there is no such plot.
    """
    from robodyn_cli.report.registry import PLOTS

    names, known = tuple(word.strip() for word in words.split(",")), PLOTS
    for name in names:
        if name not in known:
            hint = did_you_mean(name, known)
            raise typer.BadParameter(f"no plot {name!r}{hint}; allowed: {', '.join(known)}")
    return names


def drawings(no_plots: bool, plots: Any, format_: str) -> Drawings | None:
    """Return which plots a command draws; None for none."""
    if no_plots:
        return None
    from robodyn_cli.report.registry import Drawings

    return Drawings(plots, format_)


PlotNames = Annotated[
    Any,
    typer.Option("--plots", metavar="NAME,...", parser=plot_list, help="Draw these plots. [default: all]"),
]
PlotFormat = Annotated[
    str,
    typer.Option(
        "--format",
        metavar="KIND",
        parser=choice(*PLOT_FORMATS),
        help="Kind of file of plots: png, svg or pdf.",
    ),
]
NoPlan = Annotated[
    bool,
    typer.Option("--no-plan", help="Leave the plan of the scene out, which takes longest of large ones."),
]
NoPlots = Annotated[bool, typer.Option("--no-plots", help="Draw nothing.")]
Jobs = Annotated[
    int | None,
    typer.Option(
        "--jobs",
        "-j",
        metavar="N",
        parser=number("a whole number >= 1", lambda n: n >= 1, int),
        help="Processes at a time. [default: one per core]",
    ),
]

tolerance = number("a number >= 0", lambda x: 0.0 <= x < math.inf)
RelativeTolerance = Annotated[
    float,
    typer.Option(
        "--rtol", metavar="X", parser=tolerance, help="Allowed part of the column's largest magnitude."
    ),
]
AbsoluteTolerance = Annotated[
    float,
    typer.Option("--atol", metavar="X", parser=tolerance, help="Allowed in addition, in the dataset's unit."),
]
RTOL, ATOL = 1e-9, 1e-12


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


AsJson = Annotated[bool, typer.Option("--json", help="Print the summary as JSON, alone, on standard output.")]
ReportAsJson = Annotated[
    bool, typer.Option("--json", help="Print the report as JSON, alone, on standard output.")
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")]
NoErrorEstimate = Annotated[
    bool, typer.Option("--no-error-estimate", help="Skip the second integration that estimates the error.")
]
Strict = Annotated[
    bool, typer.Option("--strict", help="Take warnings about the scene and the result as errors.")
]
