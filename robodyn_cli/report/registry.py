"""The plots: one file each in ``plots/``, one line here.

A plot is a module with ``applies(result) -> bool`` and ``draw(result) -> Figure``; its name is the name of
the PNG. Nothing is computed in a plot that the run should have reported.
"""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

from robodyn_cli.commands import PLOT_FORMATS
from robodyn_cli.record import record
from robodyn_cli.results.result import Result

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# drawings of a motion
PLOTS: tuple[str, ...] = (
    "joint_angles",
    "joint_rates",
    "joint_accelerations",
    "tracking",
    "torques",
    "torque_terms",
    "drives",
    "limits",
    "tip_path",
    "point_motion",
    "transmission_angle",
    "energy",
    "energy_drift",
    "multipliers",
    "reactions",
    "constraint_residual",
    "singular_values",
    "branches",
    "mechanism",
)

# drawings of commands that look at one configuration
STILL = ("branches", "mechanism")
AT_REST = ("assemble", "reach", "statics")
# drawings of commands whose result is no motion
ANALYSES: dict[str, tuple[str, ...]] = {
    "info": ("state",),
    "linearise": ("poles", "poles_over_time", "mode_shapes", "frequency_response"),
    "size": ("size_front", "drives"),
    "stability": ("stability_spectrum", "stability_methods", "energy_growth", "baumgarte", "stability_suite"),
    "sensitivity": ("sensitivity_tornado",),
    "sweep": ("study_response", "study_map", "study_histograms", "study_influence"),
    "work-precision": ("work_precision",),
}


@record
class Drawings:
    """Which plots are drawn, None for all that apply, and as which kind of file: one of ``PLOT_FORMATS``."""

    names: tuple[str, ...] | None = None
    suffix: str = "png"

    def among(self, possible: Sequence[str]) -> list[str]:
        """Return the plots to draw of those that are possible."""
        return [name for name in possible if self.names is None or name in self.names]


def plot_names() -> list[str]:
    """Return the names of all plots."""
    return list(dict.fromkeys((*PLOTS, *(name for names in ANALYSES.values() for name in names))))


def plot_files() -> list[str]:
    """Return the file names that ``draw_all`` may write."""
    return [f"{name}.{suffix}" for suffix in PLOT_FORMATS for name in plot_names()]


def applicable(result: Result) -> list[str]:
    """Return the names of the plots that ``result`` has the data for."""
    if result.command in ANALYSES:
        names = ANALYSES[result.command]
    elif "time" not in result or not result.time.size:
        return []
    else:
        names = STILL if result.command in AT_REST else PLOTS
    return [name for name in names if _module(name).applies(result)]


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
