"""What the drawings of ``stability`` share: figures with a title, legends below the axes, looks of the verdicts."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robodyn_cli.report.canvas import legend_shape
from robodyn_cli.report.style import GREY, HANDLE_LENGTH
from robodyn_cli.results.result import Result

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# colour-blind safe, and told apart by hatch and word too
STATUS = {
    "stable": ("#009E73", ""),
    "inaccurate": ("#E69F00", "///"),
    "diverged": ("#D55E00", "xxx"),
    "too_slow": ("#56B4E9", "..."),
    "unsupported": ("#bbbbbb", ""),
}
LEAST = 1e-16  # the smallest error that is drawn


def titled(width: float, height: float, result: Result, subtitle: str) -> Figure:
    """Return a figure, its size in inches, with the title of the result and a line below it."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=120)
    figure.text(0.1, 1 - 0.22 / height, result.title, fontsize=11, fontweight="bold", va="center")
    figure.text(0.1, 1 - 0.45 / height, subtitle, color=GREY, va="center")
    return figure


def legend_below(figure: Figure, ax: Axes, place: tuple[float, float]) -> None:
    """Put the legend of ``ax`` with its lower left corner at ``place``, in as many columns as the labels allow."""
    handles, labels = ax.get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="lower left", bbox_to_anchor=place, ncols=legend_shape(labels)[0],
        handlelength=HANDLE_LENGTH, columnspacing=1.6,
    )  # fmt: skip


def powers(ax: Axes, *axes: str) -> None:
    """Number the axes ``x`` or ``y`` with powers of ten alone."""
    from matplotlib.ticker import NullFormatter

    from robodyn_cli.report.ticks import PowerFormatter

    for name in axes:
        one = getattr(ax, f"{name}axis")
        one.set_major_formatter(PowerFormatter())
        one.set_minor_formatter(NullFormatter())
