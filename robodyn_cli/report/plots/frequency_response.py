"""Gain and phase of a linear model's outputs over the frequency of its inputs (Bode's diagram)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from robodyn_cli.report.analysis import legend_below, powers, titled
from robodyn_cli.report.style import GREY, dashed_style
from robodyn_cli.results.result import Result
from robodyn_cli.spatial.algebra import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FEW = 6  # pairs that are drawn
ROUNDING = 1e-13  # of the largest gain, below which a response counts as none


def applies(result: Result) -> bool:
    """Tell whether there is a response."""
    return "linear/response_real" in result and bool(shown(result))


def shown(result: Result) -> list[tuple[int, int]]:
    """Return the pairs of output and input that are drawn, the strongest first."""
    gain = np.abs(_response(result)).max(axis=0)
    pairs = [place for place in np.ndindex(*gain.shape) if gain[place] > ROUNDING * gain.max()]
    strongest: list[tuple[int, int]] = sorted(pairs, key=lambda place: -gain[place])[:FEW]
    return sorted(strongest)


def draw(result: Result) -> Any:
    """Return the figure."""
    pairs, found = shown(result), _response(result)
    outputs, inputs = result.summary["outputs"], result.summary["inputs"]
    more = "" if len(pairs) == found[0].size else f"; {len(pairs)} of {found[0].size} pairs drawn"
    figure = titled(7.2, 6.6, result, f"Frequency response of the linear model{more}")
    gain, phase = figure.add_axes((0.12, 0.56, 0.84, 0.32)), figure.add_axes((0.12, 0.29, 0.84, 0.24))
    hertz = result["linear/frequency"] / (2.0 * np.pi)
    for k, (i, j) in enumerate(pairs):
        y, u = outputs[i], inputs[j]
        below = f"({u['unit']})" if " " in u["unit"] else u["unit"]
        label = f"{y['name']} over {u['name']} [{y['unit']}/{below}]"
        gain.plot(hertz, np.abs(found[:, i, j]), label=label, **dashed_style(k))
        phase.plot(hertz, _degrees(found[:, i, j]), **dashed_style(k))
    gain.set_yscale("log")
    powers(gain, "y")
    gain.set_ylabel("gain")
    phase.set_ylabel("phase [deg]")
    phase.set_xlabel("frequency [Hz]")
    for ax in (gain, phase):
        _modes(ax, result)
    gain.tick_params(labelbottom=False)
    legend_below(figure, gain, (0.1, 0.02))
    return figure


def _modes(ax: Axes, result: Result) -> None:
    """Set the logarithmic axis of frequencies, with a line at each mode."""
    ax.set_xscale("log")
    powers(ax, "x")
    for mode in result.summary["modes"]:
        if mode["imaginary"]:
            ax.axvline(mode["frequency"], color=GREY, linewidth=0.7, linestyle=":")


def _response(result: Result) -> Array:
    found: Array = result["linear/response_real"] + 1j * result["linear/response_imaginary"]
    return found


def _degrees(response: Array) -> Array:
    """Return the phase without jumps, from -180 to 180 degrees at the lowest frequency."""
    found: Array = np.degrees(np.unwrap(np.angle(response)))
    return found
