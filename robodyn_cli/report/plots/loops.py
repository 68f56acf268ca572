"""The loop of a controller: Nyquist's and Nichols' pictures of each loop opened in turn, and singular values."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from robodyn_cli.report.analysis import powers
from robodyn_cli.report.canvas import Sheet, panel_width
from robodyn_cli.report.looks import looks_of
from robodyn_cli.report.numbers import number
from robodyn_cli.report.plots.linear import number_phases
from robodyn_cli.report.registry import plot
from robodyn_cli.report.style import COLOURS, GREY
from robodyn_cli.results.result import Result
from robodyn_cli.spatial.algebra import Array

FEW = 6  # curves that are drawn
SQUARE = 4.4  # height of a picture that is as high as wide [inch]
REACH = (
    -3.0,
    1.5,
    2.25,
)  # of Nyquist's picture: left, right, up and down; what is farther away says nothing of margins
FAR = 50.0  # gains beyond are not drawn
LEAST, MOST = -60.0, 60.0  # dB of Nichols' picture
CIRCLES = (1.0, 3.0, 6.0)  # dB: closed loops |T| that are drawn
OVAL = 66.0  # deg to either side of -1 that the outermost of them takes
GROWING = 1.4  # gain at which an arrow shows where frequency grows
SMALLEST, GREATEST = 1e-3, 1e4  # gains of the loop that are drawn
PEAK = 1.0 + 1e-6  # sensitivity from which on it has a peak
SLOW = 1e-3  # of the frequency at which the loop has the gain 1: nothing new comes below


@plot(lambda result: "loop/response_real" in result and bool(_loops(result).any()))
def nyquist(result: Result) -> Any:
    """Each loop opened in turn in the complex plane (Nyquist), with -1, the unit circle, and the circle about -1 that
    its largest sensitivity makes."""
    loops, names = _loops(result), _names(result)
    peaks = [_peak(result, name) for name in names[:FEW]]
    labels = [f"{name}: {_sensitivity(result, name)}" for name in names[:FEW]]
    told = "Arrow: frequency grows; pale: its negative; dotted: |L| = 1"
    if any(peak is not None and peak > 1.0 for peak in peaks):
        told += "; thin: 1\N{NO-BREAK SPACE}/\N{NO-BREAK SPACE}largest\N{NO-BREAK SPACE}sensitivity"
    sheet = Sheet(
        result,
        _opened(names, "Nyquist", "how they pass −1"),
        height=min(panel_width(), SQUARE),
        labels=labels,
        captions=[told],
    )
    ax = sheet.ax
    turn = np.linspace(0.0, 2.0 * np.pi, 361)
    ax.plot(np.cos(turn), np.sin(turn), color=GREY, linewidth=0.9, linestyle=":")
    ax.axhline(0.0, color=GREY, linewidth=0.7)
    ax.axvline(0.0, color=GREY, linewidth=0.7)
    handles, looks = [], looks_of(result).lines(names)
    for k, name in enumerate(names[:FEW]):
        y = np.where(np.abs(loops[:, k]) > FAR, np.nan, loops[:, k])
        handles += ax.plot(y.real, y.imag, label=name, **looks[k])
        ax.plot(y.real, -y.imag, alpha=0.35, **looks[k])
        _arrow(ax, y, handles[-1].get_color())
        peak = peaks[k]
        if peak is not None and peak > 1.0:
            near = np.exp(1j * turn) / peak - 1.0
            ax.plot(near.real, near.imag, linewidth=0.7, color=handles[-1].get_color(), alpha=0.6)
    ax.plot([-1.0], [0.0], "+", color=COLOURS[6], markersize=11.0, markeredgewidth=2.0)
    ax.set_xlim(*REACH[:2])
    ax.set_ylim(-REACH[2], REACH[2])
    ax.set_aspect("equal")
    ax.set_xlabel("real part of L")
    ax.set_ylabel("imaginary part of L")
    sheet.legend(handles, labels)
    return sheet.figure


@plot(lambda result: "loop/response_real" in result and bool(_loops(result).any()))
def nichols(result: Result) -> Any:
    """Each loop opened in turn as gain over phase (Nichols), with -1 and lines of equal gain of the closed loop."""
    loops, names = _loops(result), _names(result)
    sheet = Sheet(
        result,
        _opened(names, "Nichols", "gain over phase about −1"),
        height=min(panel_width(), SQUARE),
        labels=names[:FEW],
        captions=["Arrows: growing frequency; dotted: gain |T| of the closed loop"],
    )
    ax = sheet.ax
    handles, phases, looks = [], [], looks_of(result).lines(names)
    for k, name in enumerate(names[:FEW]):
        gain = 20.0 * np.log10(np.maximum(np.abs(loops[:, k]), 1e-300))
        phase = _phase(loops[:, k])
        seen = (gain > LEAST) & (gain < MOST)
        phases.append(phase[seen])
        curve = np.where(seen, phase, np.nan) + 1j * np.where(seen, gain, np.nan)
        handles += ax.plot(curve.real, curve.imag, label=name, **looks[k])
        _arrow(ax, curve, handles[-1].get_color(), gain)
    every = np.concatenate(phases) if phases else np.zeros(0)
    low, high = (float(every.min()), float(every.max())) if len(every) else (-180.0, -180.0)
    low, high = min(low, -180.0), max(high, -180.0)
    centres = _centres(low, high)
    ax.set_xlim(min(low, centres[0] - OVAL) - 10.0, max(high, centres[-1] + OVAL) + 10.0)
    ax.set_ylim(LEAST, MOST)
    _closed_gains(ax, centres)
    for centre in centres:
        ax.plot([centre], [0.0], "+", color=COLOURS[6], markersize=11.0, markeredgewidth=2.0)
    ax.axhline(0.0, color=GREY, linewidth=0.7)
    number_phases(ax.xaxis)
    ax.set_xlabel("phase of L [deg]")
    ax.set_ylabel("gain of L [dB]")
    sheet.legend(handles, names[:FEW])
    return sheet.figure


def _opened(names: list[str], kind: str, what: str) -> str:
    """Return the line below the title, which says how many loops there are and are drawn."""
    if len(names) == 1:
        return f"Open loop L ({kind}): {what.replace('they pass', 'it passes')}"
    more = f", {FEW} of {len(names)} drawn" if len(names) > FEW else ""
    return f"Loops L opened in turn, the others closed ({kind}{more}): {what}"


def _peak(result: Result, name: str) -> float | None:
    peak: float | None = result.summary["loop"][name]["sensitivity_peak"]
    return peak


def _sensitivity(result: Result, name: str) -> str:
    peak = _peak(result, name)
    return "not stable" if peak is None else f"sensitivity up to {number(peak, 4)}"


def _arrow(ax: Axes, curve: Array, colour: Any, gain: Array | None = None) -> None:
    """Draw which way a curve (F,) goes as frequency grows, where its gain is about ``GROWING``."""
    size = np.abs(curve) if gain is None else 10.0 ** (gain / 20.0)
    near = np.abs(np.log(np.maximum(size[:-1], 1e-300) / GROWING))
    moved = np.isfinite(curve[1:] - curve[:-1]) & (np.abs(np.diff(curve)) > 1e-6)
    if not moved.any():
        return
    k = int(np.argmin(np.where(moved, near, np.inf)))
    ends = [(z.real, z.imag) for z in (curve[k], curve[k + 1])]
    look = {"arrowstyle": "-|>", "color": colour, "mutation_scale": 14.0, "shrinkA": 0.0, "shrinkB": 0.0}
    ax.annotate("", xy=ends[1], xytext=ends[0], arrowprops=look, annotation_clip=True)


def _closed_gains(ax: Axes, centres: Array) -> None:
    """Draw where |L / (1 + L)| has some gains, about every -1 that is seen."""
    turn = np.linspace(1e-3, 2.0 * np.pi - 1e-3, 400)
    for level in CIRCLES:
        m = 10.0 ** (level / 20.0)
        L = 1.0 / (np.exp(-1j * turn) / m - 1.0)
        phase, gain = np.degrees(np.angle(L)) % 360.0 - 180.0, 20.0 * np.log10(np.abs(L))
        for centre in centres:
            ax.plot(phase + centre, gain, color=GREY, linewidth=0.8, linestyle=":", zorder=0)
            ax.text(centre, gain.max(), f"{level:g} dB", color=GREY, ha="center", va="bottom", fontsize=7)


def _centres(low: float, high: float) -> Array:
    """Return the phases [deg] of -1 between two."""
    found: Array = np.arange(-180.0 + 360.0 * np.ceil((low + 180.0) / 360.0), high + 1.0, 360.0)
    return found


def _phase(y: Array) -> Array:
    """Return the phase of a loop in degrees without jumps, between -360 and 0 where it crosses the gain 1 first."""
    phase = np.degrees(np.unwrap(np.angle(y)))
    crossing = int(np.argmin(np.abs(np.log(np.maximum(np.abs(y), 1e-300)))))
    found: Array = phase - 360.0 * np.ceil(phase[crossing] / 360.0)
    return found


@plot(lambda result: "loop/singular_values" in result)
def singular_loop(result: Result) -> Any:
    """Gain of the loop opened at all inputs, above, and its sensitivity, below, over frequency: largest and smallest
    singular values where there are several."""
    values, sensitivity = result["loop/singular_values"], result["loop/sensitivity"][:, 0]
    several = values.shape[1] > 1
    labels = [
        "gain of L, largest and smallest" if several else "gain of L",
        "largest sensitivity" if several else "sensitivity",
    ]
    text = (
        "Singular values of the loop opened at all inputs"
        if several
        else "Gain of the open loop and sensitivity"
    )
    sheet = Sheet(result, text, panels=2, height=2.4, labels=labels)
    above, below = sheet.axes
    w = result["loop/frequency"]
    handles = above.plot(w, values[:, 0], color=COLOURS[0])
    if several:
        above.plot(w, values[:, -1], color=COLOURS[0])
        above.fill_between(w, values[:, -1], values[:, 0], color=COLOURS[0], alpha=0.15, linewidth=0.0)
    handles += below.plot(w, sensitivity, color=COLOURS[1], linestyle="--")
    at = int(np.argmax(sensitivity))
    if sensitivity[at] > PEAK:
        below.plot(w[at], sensitivity[at], "o", color=COLOURS[1], markersize=5.0, clip_on=False)
    for ax in (above, below):
        ax.axhline(1.0, color=GREY, linewidth=0.7)
        ax.set_xscale("log")
        ax.set_xlim(_slowest(w, values), w[-1])
        powers(ax, "x")
    above.set_yscale("log")
    above.set_ylim(max(SMALLEST, values[:, -1].min()) / 1.5, min(GREATEST, values[:, 0].max()) * 1.5)
    powers(above, "y")
    above.set_ylabel("gain of L")
    above.tick_params(labelbottom=False)
    below.set_ylim(0.0, 1.15 * max(1.0, float(sensitivity.max())))
    below.set_ylabel("sensitivity")
    below.set_xlabel("frequency [rad/s]")
    sheet.legend(handles, labels)
    return sheet.figure


def _slowest(w: Array, values: Array) -> float:
    """Return where the axis of frequencies begins: far below the first where the loop has the gain 1, if any."""
    crossed = np.flatnonzero(np.diff(np.sign(values - 1.0), axis=0).any(axis=1))
    return float(max(w[0], SLOW * w[crossed[0]])) if len(crossed) else float(w[0])


def _loops(result: Result) -> Array:
    found: Array = result["loop/response_real"] + 1j * result["loop/response_imaginary"]
    return found


def _names(result: Result) -> list[str]:
    return list(result.summary["loop"])
