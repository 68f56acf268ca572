"""The plots: one file each in ``plots/``, one line here.

A plot is a module with ``applies(result) -> bool`` and ``draw(result) -> Figure``; its name is the name of
the PNG. Nothing is computed in a plot that the run should have reported.
"""

from __future__ import annotations

import importlib
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

from robodyn_cli.results.result import Result

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PLOTS: tuple[str, ...] = (
    "joint_angles",
    "joint_rates",
    "joint_accelerations",
    "torques",
    "torque_terms",
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

# commands that look at one configuration, and what there is to draw of it
AT_REST = ("assemble", "statics")
STILL = ("branches", "mechanism")


def plot_files() -> list[str]:
    """Return the file names that ``draw_all`` may write."""
    return [f"{name}.png" for name in PLOTS]


def applicable(result: Result) -> list[str]:
    """Return the names of the plots that ``result`` has the data for."""
    if "time" not in result or not result.time.size:
        return []
    names = STILL if result.command in AT_REST else PLOTS
    return [name for name in names if _module(name).applies(result)]


def draw(result: Result, name: str) -> Figure:
    """Return the plot ``name`` of ``result``."""
    from robodyn_cli.report.style import styled

    with styled():
        figure: Figure = _module(name).draw(result)
    return figure


def draw_all(result: Result, directory: str | Path) -> list[Path]:
    """Draw every plot that applies into ``directory``, each file atomically; return the files written."""
    names = applicable(result)
    if not names:
        return []
    from robodyn_cli.report.canvas import save_png
    from robodyn_cli.report.style import styled

    with styled():
        return [save_png(_module(name).draw(result), Path(directory) / f"{name}.png") for name in names]


def _module(name: str) -> ModuleType:
    return importlib.import_module(f"robodyn_cli.report.plots.{name}")
