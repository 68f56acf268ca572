"""Gain and phase of a linear model's outputs over the frequency of its inputs (Bode's diagram)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from robodyn_cli.record import record
from robodyn_cli.report.analysis import powers
from robodyn_cli.report.canvas import Sheet
from robodyn_cli.report.style import GREY, dashed_style
from robodyn_cli.report.ticks import number
from robodyn_cli.results.result import Result
from robodyn_cli.spatial.algebra import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FEW = 6  # curves that are drawn
ROUNDING = 1e-13  # of the largest gain, below which a response counts as none
RIGHT_ANGLE, TURN = 90.0, 180.0  # deg: ticks of a phase that goes so far


@record
class ResponseCurve:
    """A response that is drawn: at which instant, of which output, over which input."""

    instant: int
    output: int
    input: int


def applies(result: Result) -> bool:
    """Tell whether there is a response."""
    return "linear/response_real" in result and bool(shown(result))


def shown(result: Result) -> list[ResponseCurve]:
    """Return what is drawn: of the pairs of output and input the strongest, each at all instants."""
    found = np.abs(_responses(result))
    gain = found.max(axis=(0, 1))
    pairs = [place for place in np.ndindex(*gain.shape) if gain[place] > ROUNDING * gain.max()]
    instants = min(len(found), FEW)
    strongest = sorted(pairs, key=lambda place: -gain[place])[: FEW // instants]
    return [ResponseCurve(k, *place) for place in sorted(strongest) for k in range(instants)]


def draw(result: Result) -> Any:
    """Return the figure."""
    curves, found = shown(result), _responses(result)
    every = found[:, 0].size
    more = "" if len(curves) == every else f"; {len(curves)} of {every} drawn"
    labels = [_label(result, curve) for curve in curves]
    text = f"Frequency response of the linear model{more}"
    sheet = Sheet(result, text, panels=2, height=2.3, labels=labels)
    gain, phase = sheet.axes
    hertz = result["linear/frequency"] / (2.0 * np.pi)
    handles = []
    for k, curve in enumerate(curves):
        values = found[curve.instant, :, curve.output, curve.input]
        handles += gain.plot(hertz, np.abs(values), **dashed_style(k))
        phase.plot(hertz, np.degrees(np.unwrap(np.angle(values))), **dashed_style(k))
    gain.set_yscale("log")
    powers(gain, "y")
    gain.set_ylabel("gain")
    _right_angles(phase)
    phase.set_ylabel("phase [deg]")
    phase.set_xlabel("frequency [Hz]")
    for ax in (gain, phase):
        _modes(ax, result)
    gain.tick_params(labelbottom=False)
    sheet.legend(handles, labels)
    return sheet.figure


def _label(result: Result, curve: ResponseCurve) -> str:
    """Return the name of a response with its unit, and its instant along a motion."""
    y, u = result.summary["measured"][curve.output], result.summary["inputs"][curve.input]
    below = f"({u['unit']})" if " " in u["unit"] else u["unit"]
    when = f" at {number(result['linear/instant'][curve.instant])} s" if "linear/instant" in result else ""
    return f"{y['name']} over {u['name']} [{y['unit']}/{below}]{when}"


def _modes(ax: Axes, result: Result) -> None:
    """Set the logarithmic axis of frequencies, with a line at each mode of a state."""
    ax.set_xscale("log")
    powers(ax, "x")
    for mode in result.summary.get("modes", ()):
        if mode["imaginary"]:
            ax.axvline(mode["frequency"], color=GREY, linewidth=0.7, linestyle=":")


def _right_angles(ax: Axes) -> None:
    """Number a phase that goes far with multiples of a right angle, or of half a turn."""
    from matplotlib.ticker import MultipleLocator

    low, high = ax.get_ylim()
    if high - low > RIGHT_ANGLE:
        step = RIGHT_ANGLE if high - low < 6.0 * RIGHT_ANGLE else TURN
        ax.yaxis.set_major_locator(MultipleLocator(step))


def _responses(result: Result) -> Array:
    """Return the responses (instant, frequency, output, input); those of a state as of one instant."""
    found: Array = result["linear/response_real"] + 1j * result["linear/response_imaginary"]
    return found if found.ndim == 4 else found[None]
