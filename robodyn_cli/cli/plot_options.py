"""Options of what is drawn, and how."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from typing import Annotated, Any

import typer

from robodyn_cli.cli.offers import begun_by, listed_of, one_of
from robodyn_cli.commands import COMMANDS, PLOT_FORMATS, PLOT_STYLES
from robodyn_cli.errors import nearest_word, of_option


def plot_list(words: str) -> tuple[str, ...]:
    """Return the names of plots in a list with commas.

    Raises
    ------
    BadParameter : there is no such plot.
    """
    from robodyn_cli.report.registry import PLOTS

    names, known = tuple(word.strip() for word in words.split(",")), list(PLOTS)
    for name in names:
        if name not in known:
            near = [one for one in known if nearest_word(name, [one, *one.split("_")])]
            raise typer.BadParameter(f"no plot {name!r}; {_these(near, known)}")
    return names


def _these(near: list[str], known: list[str]) -> str:
    return f"did you mean {' or '.join(map(repr, near))}?" if near else f"allowed: {', '.join(known)}"


def drawn_by(command: str, names: Iterable[str]) -> None:
    """Check that a command draws plots.

    Raises
    ------
    SceneError : it never draws one of them.
    """
    from robodyn_cli.report.registry import plots_of

    known = plots_of(command, asked=True)
    if other := [name for name in names if name not in known]:
        raise of_option(
            f"--plots {','.join(other)}", f"`{command}` does not draw that; allowed: {', '.join(known)}"
        )


# by name, without what draws them
KNOWN = dict.fromkeys(place.partition(":")[2] for row in COMMANDS.values() for place in row.plots)

NoPlots = Annotated[bool, typer.Option("--no-plots", help="Draw nothing.")]
PlotNames = Annotated[
    Any,
    typer.Option(
        "--plots",
        metavar="NAME,...",
        parser=plot_list,
        autocompletion=listed_of(begun_by(KNOWN)),
        help="Draw these plots. [default: all]",
    ),
]
PlotFormat = Annotated[
    str,
    one_of("--format", *PLOT_FORMATS, metavar="KIND", help="Kind of file of plots: png, svg or pdf."),
]


PlotStyle = Annotated[
    str,
    one_of(
        "--style",
        *PLOT_STYLES,
        metavar="NAME",
        help="Of plots: screen; paper (3.5 in, no titles, fine pixels); slides (5 in).",
    ),
]
NARROWEST, WIDEST = 2.5, 20.0  # of plots [in]


def plot_width(word: str) -> float:
    """Return a width [in] of ``3.5in``, ``8.9 cm``, ``89 mm`` or ``252 pt``."""
    found = re.fullmatch(r"\s*(\d+(?:\.\d*)?|\.\d+)\s*(in|cm|mm|pt)\s*", str(word))
    inches = (
        float(found[1]) / {"in": 1.0, "cm": 2.54, "mm": 25.4, "pt": 72.0}[found[2]] if found else math.nan
    )
    if not NARROWEST <= inches <= WIDEST:
        allowed = f"{NARROWEST:g} to {WIDEST:g} in, as 3.5in, 8.9cm, 89mm or 252pt"
        raise typer.BadParameter(f"{word!r}; allowed: {allowed}")
    return inches


PlotWidth = Annotated[
    Any, typer.Option("--width", metavar="WIDTH", parser=plot_width, help="Width of plots, as 3.5in or 89mm.")
]
NoTitles = Annotated[
    bool, typer.Option("--no-titles", help="No title and notes above plots; they stay in the metadata.")
]
