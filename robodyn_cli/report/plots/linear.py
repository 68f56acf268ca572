"""Linear models: poles and frequency responses."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis

from robodyn_cli.record import record
from robodyn_cli.report.analysis import bar_beside, powers
from robodyn_cli.report.canvas import Sheet, panel_width
from robodyn_cli.report.numbers import number
from robodyn_cli.report.registry import plot
from robodyn_cli.report.style import BLACK, COLOURS, GREY, PlainFormatter, dashed_style
from robodyn_cli.report.time_sheet import TimeSheet
from robodyn_cli.results.result import Result
from robodyn_cli.spatial.algebra import Array

POLES = 3.9  # height of the plane of poles [inch]


@plot(lambda result: "linear/poles_real" in result)
def poles(result: Result) -> Any:
    """The poles of a linear model in the complex plane, with those of the loop of a controller: of a sampled one beside
    it, with the unit circle; poles along a motion are shaded by time."""
    real, imaginary = result["linear/poles_real"], result["linear/poles_imaginary"]
    if "loop/poles_real" in result:
        return _with_loop(result)
    along = real.ndim == 2
    text = "Poles of the linear model: left decays, right grows" + ("; shaded by time" if along else "")
    sheet = Sheet(result, text, height=POLES, degrees=along)
    ax = sheet.ax
    if along:
        shades = np.repeat(result.time[:, None], real.shape[1], axis=1)
        dots = ax.scatter(
            real.ravel(), imaginary.ravel(), c=shades.ravel(), cmap="cividis", s=9, linewidths=0
        )
        sheet.figure.colorbar(dots, cax=bar_beside(ax, "time [s]"))
    else:
        ax.plot(real, imaginary, "x", markersize=8.0, markeredgewidth=1.8)
    _frame(ax, real + 1j * imaginary)
    return sheet.figure


def _with_loop(result: Result) -> Any:
    """Return the poles of a plant and of its loop: in one plane, or with samples in two."""
    plant, loop = (
        result[f"{x}/poles_real"] + 1j * result[f"{x}/poles_imaginary"] for x in ("linear", "loop")
    )
    sampled = "loop/period" in result
    where = "right: per sample, inside the circle decays" if sampled else "left decays, right grows"
    labels = ["plant alone", "loop with the controller"]
    sheet = Sheet(
        result,
        f"Poles of the plant alone, and of the loop; {where}",
        panels=2 if sampled else 1,
        across=2 if sampled else 1,
        height=panel_width(2) if sampled else POLES,
        gap=0.62,
        labels=labels,
    )
    ax, other = sheet.axes[0], sheet.axes[-1]
    handles = ax.plot(plant.real, plant.imag, "x", color=GREY, markersize=7.0, markeredgewidth=1.6)
    handles += other.plot(loop.real, loop.imag, "x", color=COLOURS[0], markersize=8.0, markeredgewidth=1.8)
    _frame(ax, plant if sampled else np.concatenate([plant, loop]))
    if sampled:
        turn = np.linspace(0.0, 2.0 * np.pi, 361)
        other.plot(np.cos(turn), np.sin(turn), color=GREY, linewidth=0.9, linestyle=":")
        _frame(other, np.append(loop, [1.0, 1j]), "1")
        other.set_aspect("equal")
    sheet.legend(handles, labels)
    return sheet.figure


def _frame(ax: Axes, found: Array, unit: str = "") -> None:
    """Give a plane of poles its axes; rounding beside these is not to fill the picture."""
    ax.axvline(0.0, color=GREY, linewidth=0.8, zorder=1)
    ax.axhline(0.0, color=GREY, linewidth=0.8, zorder=1)
    size = float(np.abs(found).max()) or 1.0
    for part, limits in ((found.real, ax.set_xlim), (found.imag, ax.set_ylim)):
        reach = max(float(np.abs(part).max()), 0.05 * size) * 1.15
        limits(-reach, reach)
    ax.xaxis.set_major_formatter(PlainFormatter())
    ax.set_xlabel(f"real part [{unit or '1/s'}]")
    ax.set_ylabel(f"imaginary part [{unit or 'rad/s'}]")


GROWS, DECAYS, STAYS = COLOURS[6], COLOURS[0], BLACK


@plot(
    lambda result: (
        "linear/poles_real" in result and result["linear/poles_real"].ndim == 2 and result.time.size > 1
    )
)
def poles_over_time(result: Result) -> Any:
    """The poles of a linear model along a motion: what grows and decays, and how fast it swings, over time; real
    parts above, oscillations (if any) below; dots, for poles meet and part."""
    real, imaginary = result["linear/poles_real"], result["linear/poles_imaginary"]
    time = np.repeat(result.time[:, None], real.shape[1], axis=1)
    kinds = [
        (name, colour, chosen)
        for name, colour, chosen in (
            ("grows", GROWS, real > 0.0), ("decays", DECAYS, real < 0.0), ("neither", STAYS, real == 0.0)
        )
        if chosen.any()
    ]  # fmt: skip
    labels = [name for name, _, _ in kinds]
    text = "Poles of the linear model along the motion, each instant as if it stayed so"
    swinging = imaginary > 0.0
    sheet = TimeSheet(result, text, "linear", panels=2 if swinging.any() else 1, height=2.1, labels=labels)
    upper, lower = sheet.axes[0], sheet.axes[-1]
    handles = []
    for _, colour, chosen in kinds:
        handles += upper.plot(time[chosen], real[chosen], ".", color=colour, markersize=2.6)
        swings = chosen & swinging
        lower.plot(time[swings], imaginary[swings] / (2.0 * np.pi), ".", color=colour, markersize=2.6)
    upper.axhline(0.0, color=GREY, linewidth=0.8)
    upper.set_ylabel("real part [1/s]")
    if lower is not upper:
        lower.set_ylabel("oscillation [Hz]")
        lower.set_ylim(bottom=0.0)
    for ax in sheet.axes:
        ax.set_xlim(float(result.time[0]), float(result.time[-1]))
    sheet.finish(handles, labels)
    return sheet.figure


FEW = 6  # curves that are drawn
ROUNDING = 1e-13  # of the largest gain, below which a response counts as none
LEAST_PHASE = 30.0  # deg that an axis of phases has
STEPS = 5.0, 15.0, 30.0, 45.0, 90.0, 180.0  # deg: between the numbers of an axis of phases
MOST_STEPS = 6


@record
class ResponseCurve:
    """A response that is drawn: at which instant, of which output, over which input."""

    instant: int
    output: int
    input: int


def shown(result: Result) -> list[ResponseCurve]:
    """Return what is drawn: of the pairs of output and input the strongest, each at all instants."""
    magnitudes = np.abs(_responses(result))
    gain = magnitudes.max(axis=(0, 1))
    pairs = [place for place in np.ndindex(*gain.shape) if gain[place] > ROUNDING * gain.max()]
    instants = min(len(magnitudes), FEW)
    strongest = sorted(pairs, key=lambda place: -gain[place])[: FEW // instants]
    return [ResponseCurve(k, *place) for place in sorted(strongest) for k in range(instants)]


@plot(lambda result: "linear/response_real" in result and bool(shown(result)))
def frequency_response(result: Result) -> Any:
    """Gain and phase of a linear model's outputs over the frequency of its inputs (Bode's diagram)."""
    curves, found = shown(result), _responses(result)
    every = found[:, 0].size
    more = "" if len(curves) == every else f"; {len(curves)} of {every} drawn"
    labels = [_label(result, curve) for curve in curves]
    alone = " of the plant alone" if "loop/poles_real" in result else ""  # the loop has pictures of its own
    text = f"Frequency response{alone or ' of the linear model'}{more}"
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
    number_phases(phase.yaxis)
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


def number_phases(axis: Axis) -> None:
    """Number an axis of phases with parts and multiples of a right angle, three at least."""
    from matplotlib.ticker import MultipleLocator

    low, high = axis.get_view_interval()
    beyond = max(0.0, LEAST_PHASE - (high - low)) / 2.0
    axis.set_view_interval(low - beyond, high + beyond, ignore=True)
    span = max(high - low, LEAST_PHASE)
    turns = STEPS[-1] * math.ceil(span / (MOST_STEPS * STEPS[-1]))
    axis.set_major_locator(MultipleLocator(next((x for x in STEPS if span <= MOST_STEPS * x), turns)))


def _responses(result: Result) -> Array:
    """Return the responses (instant, frequency, output, input); those of a state as of one instant."""
    responses: Array = result["linear/response_real"] + 1j * result["linear/response_imaginary"]
    return responses if responses.ndim == 4 else responses[None]
