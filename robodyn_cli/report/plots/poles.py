"""The poles of a linear model in the complex plane."""

from __future__ import annotations

from typing import Any

import numpy as np

from robodyn_cli.report.analysis import titled
from robodyn_cli.report.style import GREY
from robodyn_cli.results.result import Result


def applies(result: Result) -> bool:
    """Tell whether there are poles."""
    return "linear/poles_real" in result


def draw(result: Result) -> Any:
    """Return the figure; poles along a motion are shaded by time."""
    real, imaginary = result["linear/poles_real"], result["linear/poles_imaginary"]
    along = real.ndim == 2
    text = "Poles of the linear model: left decays, right grows" + ("; shaded by time" if along else "")
    figure = titled(6.4, 5.2, result, text)
    ax = figure.add_axes((0.13, 0.11, 0.7 if along else 0.83, 0.74))
    ax.axvline(0.0, color=GREY, linewidth=0.8)
    ax.axhline(0.0, color=GREY, linewidth=0.8)
    if along:
        shades = np.repeat(result.time[:, None], real.shape[1], axis=1)
        dots = ax.scatter(
            real.ravel(), imaginary.ravel(), c=shades.ravel(), cmap="cividis", s=9, linewidths=0
        )
        figure.colorbar(dots, cax=figure.add_axes((0.86, 0.11, 0.022, 0.74))).set_label("time [s]")
    else:
        ax.plot(real, imaginary, "x", markersize=8.0, markeredgewidth=1.8)
    size = float(np.hypot(real, imaginary).max()) or 1.0
    # rounding beside the axes is not to fill the picture
    for part, limits in ((real, ax.set_xlim), (imaginary, ax.set_ylim)):
        reach = max(float(np.abs(part).max()), 0.05 * size) * 1.15
        limits(-reach, reach)
    ax.set_xlabel("real part [1/s]")
    ax.set_ylabel("imaginary part [rad/s]")
    return figure
