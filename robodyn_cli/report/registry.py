"""The plots: a function each in a file of ``plots/``, and in ``commands.py`` its place in the row of each command that
draws it.

Its name is the name of the PNG. Nothing is computed in a plot that the run should have reported.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robodyn_cli.commands import COMMANDS, PLOT_FORMATS
from robodyn_cli.record import record
from robodyn_cli.registry import Registry
from robodyn_cli.results.result import Result

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from robodyn_cli.report.format import FigureFormat


@record
class Plot:
    """A plot: whether a result has the data for it, and the function that draws it."""

    applies: Callable[[Result], bool]
    draw: Callable[[Result], Figure]


def plot(applies: Callable[[Result], bool]) -> Callable[[Callable[[Result], Any]], Plot]:
    """Make a plot of the function that draws it, for results that ``applies`` is true of."""
    return lambda draw: Plot(applies, draw)


# all of them
PLOTS: Registry[Plot] = Registry(
    "robodyn_cli.report.plots",
    {place.partition(":")[2]: place for row in COMMANDS.values() for place in row.plots},
)


@record
class Drawings:
    """Which plots are drawn, None for all that apply, and as which kind of file: one of ``PLOT_FORMATS``.

    style : one of ``PLOT_STYLES``. width : of figures [inch], None for that of the style. no_titles : leaves out title
    and notes above, as the style for papers does.
    """

    names: tuple[str, ...] | None = None
    suffix: str = "png"
    style: str = "screen"
    width: float | None = None
    no_titles: bool = False

    @property
    def form(self) -> FigureFormat:
        """The format of the figures."""
        from robodyn_cli.report.format import FORMATS

        form = FORMATS[self.style]
        width, titles = self.width or form.width, form.titles and not self.no_titles
        return dataclasses.replace(form, width=width, titles=titles)

    def among(self, possible: Sequence[str]) -> list[str]:
        """Return the plots to draw of those that are possible."""
        return [name for name in possible if self.names is None or name in self.names]


def plot_files() -> list[str]:
    """Return the file names that ``draw_all`` may write."""
    return [f"{name}.{suffix}" for suffix in PLOT_FORMATS for name in PLOTS]


def plots_of(command: str, asked: bool = False) -> list[str]:
    """Return the names of the plots of a command; asked : with those that are drawn where they are asked for."""
    row = COMMANDS.get(command)
    places = (*row.plots, *(row.plots_asked if asked else ())) if row else ()
    return [place.partition(":")[2] for place in places]


def applicable(result: Result, asked: bool = False) -> list[str]:
    """Return the names of the plots of the command, as ``plots_of`` does, that ``result`` has the data for."""
    if "time" in result and not result.time.size:
        return []
    return [name for name in plots_of(result.command, asked) if PLOTS[name].applies(result)]


def doubts(result: Result, drawings: Drawings) -> list[str]:
    """Return what is doubtful about the drawings of a run, a sentence each: plots asked for that there are no data for,
    samples that do not show the motion."""
    from robodyn_cli.results.sampling import is_sparse, sparse_words

    possible = applicable(result, asked=True)
    lacking = [f"no data for the plot {name}" for name in drawings.names or () if name not in possible]
    return [*lacking, *([f"{sparse_words(result)}: plots draw dots there"] if is_sparse(result) else [])]


def not_drawn(result: Result, drawings: Drawings, drawn: Sequence[Path]) -> list[str]:
    """Return the line about plots in which all is zero, which are not among the files ``drawn``: residuals of most
    loops are; none where plots are asked for by name."""
    files = {path.stem for path in drawn}
    names = [] if drawings.names else [name for name in applicable(result) if name not in files]
    if not names:
        return []
    return [f"not drawn, as all in them is zero or missing: {', '.join(names)} (--plots draws them)"]


def draw(result: Result, name: str) -> Figure:
    """Return the plot ``name`` of ``result``."""
    from robodyn_cli.report.style import styled

    with styled():
        return PLOTS[name].draw(result)


def draw_all(result: Result, directory: str | Path, drawings: Drawings | None = None) -> list[Path]:
    """Draw the plots that apply, but for those in which all is zero, or else those asked for, into ``directory``, each
    file atomically; return the files."""
    drawings = drawings or Drawings()
    names = drawings.among(applicable(result, asked=drawings.names is not None))
    if not names:
        return []
    from robodyn_cli.report.canvas import EMPTY, save
    from robodyn_cli.report.style import styled

    files = []
    with styled(drawings.form):
        for name in names:
            figure = PLOTS[name].draw(result)
            if drawings.names is not None or figure.get_label() != EMPTY:
                files.append(save(figure, Path(directory) / f"{name}.{drawings.suffix}"))
    return files
