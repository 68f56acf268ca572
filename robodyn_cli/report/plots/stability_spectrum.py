"""Eigenvalues in the complex plane, and the largest stable steps along the run."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from robodyn_cli.integration_methods import EXTREMES, METHODS
from robodyn_cli.report.analysis import legend_below, powers, titled
from robodyn_cli.report.style import GREY, MARKERS, dashed_style
from robodyn_cli.results.result import Result

# step limits that are drawn
SHOWN = tuple(name for name in EXTREMES if not METHODS[name].stiff)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def applies(result: Result) -> bool:
    """Tell whether the motion was linearised."""
    return "stability/time" in result


def draw(result: Result) -> Figure:
    """Return the figure."""
    found = result.summary["spectrum"]
    figure = titled(
        7.6, 7.4, result,
        f"stiffness ratio at most {found['stiffness_ratio']:.3g}; fastest decay {found['fastest_decay']:.3g} 1/s, "
        f"fastest oscillation {found['fastest_oscillation']:.3g} rad/s",
    )  # fmt: skip
    _eigenvalues(figure, result)
    _steps(figure, result)
    figure.text(
        0.1, 0.022, "explicit: all modes inside |R| <= 1; gauss: the iteration of a step is done within its rounds",
        color=GREY, fontsize=8,
    )  # fmt: skip
    return figure


def _eigenvalues(figure: Figure, result: Result) -> None:
    """Draw the eigenvalues in the complex plane, shaded by time."""
    time = result["stability/time"]
    real, imaginary = result["stability/eigenvalues_real"], result["stability/eigenvalues_imaginary"]
    plane = figure.add_axes((0.1, 0.545, 0.72, 0.345))
    bar = figure.add_axes((0.85, 0.545, 0.022, 0.345))
    size = max(float(np.abs(real).max()), float(np.abs(imaginary).max()), 1e-9)
    smallest = max(result.summary["spectrum"]["slowest_rate"], 1e-9 * size)
    shades = np.repeat(time[:, None], real.shape[1], axis=1)
    dots = plane.scatter(
        real.ravel(), imaginary.ravel(), c=shades.ravel(), cmap="cividis", s=11, linewidths=0
    )
    for name, values in (("x", real), ("y", imaginary)):
        largest = float(np.abs(values).max())
        if largest > 30.0 * smallest:
            getattr(plane, f"set_{name}scale")("symlog", linthresh=smallest, linscale=0.6)
            _sparse(plane, name, smallest, largest)
    plane.axvline(0.0, color=GREY, linewidth=0.8)
    plane.margins(0.06)
    plane.set_xlabel("real part of the eigenvalues [1/s]: left decays, right grows")
    plane.set_ylabel("imaginary part [rad/s]")
    figure.colorbar(dots, cax=bar).set_label("time [s]")


def _steps(figure: Figure, result: Result) -> None:
    """Draw the largest stable steps along the run."""
    time, steps = result["stability/time"], result["stability/step_limit"]
    names = result.variables["stability/step_limit"].names
    shown = [k for k, name in enumerate(names) if name in SHOWN]
    ax = figure.add_axes((0.1, 0.2, 0.84, 0.24))
    for k in shown:
        name = names[k]
        place = SHOWN.index(name)  # a method looks the same in every scene
        good = np.isfinite(steps[:, k])
        ax.plot(
            time[good], steps[good, k], label=name, marker=MARKERS[place % len(MARKERS)] if good.sum() < 4 else None,
            **dashed_style(place),
        )  # fmt: skip
    ax.set_yscale("log")
    powers(ax, "y")
    ax.set_xlabel("time [s]")
    ax.set_ylabel("largest stable step [s]")
    legend_below(figure, ax, (0.08, 0.045))


def _sparse(ax: Axes, name: str, smallest: float, largest: float) -> None:
    """Put a handful of ticks on a symmetric logarithmic axis."""
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

    from robodyn_cli.report.ticks import power

    first, last = int(np.ceil(np.log10(smallest))), int(np.floor(np.log10(largest)))
    every = max(1, (last - first) // 4)
    powers = list(range(last, first - 1, -every)) if last >= first else []
    places = [0.0, *(s * 10.0**p for p in powers for s in (-1.0, 1.0))]
    axis = getattr(ax, f"{name}axis")
    axis.set_major_locator(FixedLocator(sorted(places)))
    axis.set_minor_locator(NullLocator())

    def text(x: float, _: Any = None) -> str:
        if x == 0.0:
            return "0"
        return ("−" if x < 0 else "") + power(round(np.log10(abs(x))))

    axis.set_major_formatter(FuncFormatter(text))
