"""Drift and error over the plane of Baumgarte's gains, with the chosen pair marked."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from robodyn_cli.report.analysis import LEAST, powers, titled
from robodyn_cli.results.result import Result

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def applies(result: Result) -> bool:
    """Tell whether gains were scanned."""
    return bool(_planes(result))


def _planes(result: Result) -> list[str]:
    return [name for name in ("own", "fixed") if f"baumgarte/{name}/drift" in result]


def draw(result: Result) -> Figure:
    """Return the figure."""
    found, planes = result.summary["baumgarte"], _planes(result)
    height = 0.62 + 3.15 * len(planes)
    figure = titled(
        8.2, height, result, "star: alpha = beta = c/h, the smallest whose drift stays below the integration error; "
        "hatched: unstable",
    )  # fmt: skip
    for row, name in enumerate(planes):
        gain = result[f"baumgarte/{name}/gain"]
        chosen = found[name]["chosen"]
        y = 1 - (0.3 + 3.15 * (row + 1) - 0.3) / height
        for column, (path, words) in enumerate((("drift", "drift"), ("error", "error of q"))):
            ax = figure.add_axes((0.1 + 0.47 * column, y, 0.31, 2.35 / height))
            bar = figure.add_axes((0.42 + 0.47 * column, y, 0.015, 2.35 / height))
            _plane(figure, ax, bar, gain, result[f"baumgarte/{name}/{path}"], f"{words} [rad, m]")
            # where no gain is needed the star stands in the corner, for the axes have no zero
            ax.plot(
                [max(chosen["beta"], gain[0])],
                [max(chosen["alpha"], gain[0])],
                marker="*",
                markersize=13,
                color="white",
                markeredgecolor="black",
                clip_on=False,
            )
            none = ", no gain needed" if chosen["alpha"] == 0.0 == chosen["beta"] else ""
            ax.set_title(
                f"{found[name]['method']}, {path}, h = {found[name]['reference_step']:.2g} s{none}",
                fontsize=9,
            )
            ax.set_xlabel("beta [1/s]")
            if column == 0:
                ax.set_ylabel("alpha [1/s]")
    return figure


def _plane(figure: Figure, ax: Axes, bar: Axes, gain: Any, data: Any, label: str) -> None:
    from matplotlib.colors import LogNorm

    shown = np.ma.masked_invalid(np.maximum(data, LEAST))
    half = np.sqrt(gain[1] / gain[0])
    edges = np.append(gain / half, gain[-1] * half)
    low = float(shown.min()) if shown.count() else 1e-12
    high = max(float(shown.max()) if shown.count() else 1.0, 10.0 * low)
    ax.patch.set(facecolor="white", edgecolor="#8a8a8a", hatch="///", linewidth=0.0)
    drawn = ax.pcolormesh(edges, edges, shown, norm=LogNorm(low, high), cmap="cividis")
    ax.grid(False)
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_xlim(edges[0], edges[-1])
    ax.set_ylim(edges[0], edges[-1])
    powers(ax, "x", "y")
    figure.colorbar(drawn, cax=bar)
    bar.set_ylabel(label)
    powers(bar, "y")
