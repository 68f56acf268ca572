"""The plots: one file each in ``plots/``, and in ``commands.py`` a word in the row of each command that draws it.

A plot is a module with ``applies(result) -> bool`` and ``draw(result) -> Figure``; its name is the name of
the PNG. Nothing is computed in a plot that the run should have reported.
"""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

from robodyn_cli.commands import COMMANDS, PLOT_FORMATS
from robodyn_cli.record import record
from robodyn_cli.results.result import Result

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# all of them
PLOTS: tuple[str, ...] = tuple(dict.fromkeys(name for row in COMMANDS.values() for name in row.plots))


@record
class Drawings:
    """Which plots are drawn, None for all that apply, and as which kind of file: one of ``PLOT_FORMATS``."""

    names: tuple[str, ...] | None = None
    suffix: str = "png"

    def among(self, possible: Sequence[str]) -> list[str]:
        """Return the plots to draw of those that are possible."""
        return [name for name in possible if self.names is None or name in self.names]


def plot_files() -> list[str]:
    """Return the file names that ``draw_all`` may write."""
    return [f"{name}.{suffix}" for suffix in PLOT_FORMATS for name in PLOTS]


def applicable(result: Result) -> list[str]:
    """Return the names of the plots of the command that ``result`` has the data for."""
    own = COMMANDS[result.command].plots if result.command in COMMANDS else ()
    if "time" in result and not result.time.size:
        return []
    return [name for name in own if _module(name).applies(result)]


def draw(result: Result, name: str) -> Figure:
    """Return the plot ``name`` of ``result``."""
    from robodyn_cli.report.style import styled

    with styled():
        figure: Figure = _module(name).draw(result)
    return figure


def draw_all(result: Result, directory: str | Path, drawings: Drawings | None = None) -> list[Path]:
    """Draw the plots that apply, or those asked for, into ``directory``, each file atomically; return the files."""
    drawings = drawings or Drawings()
    names = drawings.among(applicable(result))
    if not names:
        return []
    from robodyn_cli.report.canvas import save
    from robodyn_cli.report.style import styled

    with styled():
        return [
            save(_module(name).draw(result), Path(directory) / f"{name}.{drawings.suffix}") for name in names
        ]


def _module(name: str) -> ModuleType:
    return importlib.import_module(f"robodyn_cli.report.plots.{name}")
