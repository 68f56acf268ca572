"""The loop of a controller: Nyquist's and Nichols' pictures of each loop opened in turn, and singular values."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from robodyn_cli.report.analysis import powers, titled
from robodyn_cli.report.canvas import Sheet
from robodyn_cli.report.registry import plot
from robodyn_cli.report.style import COLOURS, GREY, dashed_style
from robodyn_cli.results.result import Result
from robodyn_cli.spatial.algebra import Array

FEW = 6  # curves that are drawn
REACH = 2.5  # of Nyquist's picture about 0: what is farther away says nothing of stability by its shape
LEAST, MOST = -60.0, 60.0  # dB of Nichols' picture
CIRCLES = (1.0, 3.0, 6.0)  # dB: closed loops |T| that are drawn


@plot(lambda result: "loop/response_real" in result and bool(_loops(result).any()))
def nyquist(result: Result) -> Any:
    """Each loop opened in turn in the complex plane (Nyquist), with -1 and the circle of its largest sensitivity."""
    loops, names = _loops(result), _names(result)
    figure = titled(6.4, 6.2, result, "Loops opened in turn (Nyquist): how they pass -1")
    ax = figure.add_axes((0.12, 0.2, 0.83, 0.68))
    turn = np.linspace(0.0, 2.0 * np.pi, 361)
    ax.plot(np.cos(turn), np.sin(turn), color=GREY, linewidth=0.7, linestyle=":")
    ax.axhline(0.0, color=GREY, linewidth=0.7)
    ax.axvline(0.0, color=GREY, linewidth=0.7)
    handles = []
    for k, name in enumerate(names[:FEW]):
        y = np.where(np.abs(loops[:, k]) > 20.0 * REACH, np.nan, loops[:, k])
        handles += ax.plot(y.real, y.imag, label=name, **dashed_style(k))
        ax.plot(y.real, -y.imag, alpha=0.35, **dashed_style(k))
        peak = result.summary["loop"][name]["sensitivity_peak"]
        if peak is not None and peak > 1.0:
            near = np.exp(1j * turn) / peak - 1.0
            ax.plot(near.real, near.imag, linewidth=0.7, color=handles[-1].get_color(), alpha=0.6)
    ax.plot([-1.0], [0.0], "+", color=COLOURS[6], markersize=11.0, markeredgewidth=2.0)
    ax.set_xlim(-REACH, REACH)
    ax.set_ylim(-REACH, REACH)
    ax.set_aspect("equal")
    ax.set_xlabel("real part of L")
    ax.set_ylabel("imaginary part of L")
    more = f" ({FEW} of {len(names)} drawn)" if len(names) > FEW else ""
    figure.legend(
        handles, names[:FEW], loc="lower center", ncols=min(3, len(handles)), frameon=False,
        title=f"solid: w > 0, pale: w < 0; circles: largest sensitivity{more}",
    )  # fmt: skip
    return figure


@plot(lambda result: "loop/response_real" in result and bool(_loops(result).any()))
def nichols(result: Result) -> Any:
    """Each loop opened in turn as gain over phase (Nichols), with -1 and lines of equal gain of the closed loop."""
    loops, names = _loops(result), _names(result)
    figure = titled(6.4, 6.0, result, "Loops opened in turn (Nichols): gain over phase about -1")
    ax = figure.add_axes((0.12, 0.2, 0.83, 0.68))
    handles, phases = [], []
    for k, name in enumerate(names[:FEW]):
        gain = 20.0 * np.log10(np.maximum(np.abs(loops[:, k]), 1e-300))
        phase = _phase(loops[:, k])
        seen = (gain > LEAST) & (gain < MOST)
        phases.append(phase[seen])
        handles += ax.plot(
            np.where(seen, phase, np.nan), np.where(seen, gain, np.nan), label=name, **dashed_style(k)
        )
    every = np.concatenate(phases) if phases else np.zeros(0)
    low, high = (float(every.min()), float(every.max())) if len(every) else (-360.0, 0.0)
    low, high = min(low, -225.0), max(high, -135.0)
    _closed_gains(ax, low, high)
    for centre in _centres(low, high):
        ax.plot([centre], [0.0], "+", color=COLOURS[6], markersize=11.0, markeredgewidth=2.0)
    ax.axhline(0.0, color=GREY, linewidth=0.7)
    ax.set_xlim(low - 10.0, high + 10.0)
    ax.set_ylim(LEAST, MOST)
    ax.set_xlabel("phase of L [deg]")
    ax.set_ylabel("gain of L [dB]")
    figure.legend(
        handles, names[:FEW], loc="lower center", ncols=min(3, len(handles)), frameon=False,
        title=f"dotted: closed loop |T| of {', '.join(f'{x:g}' for x in CIRCLES)} dB",
    )  # fmt: skip
    return figure


def _closed_gains(ax: Axes, low: float, high: float) -> None:
    """Draw where |L / (1 + L)| has some gains, about every -1 that is seen."""
    turn = np.linspace(1e-3, 2.0 * np.pi - 1e-3, 400)
    for level in CIRCLES:
        m = 10.0 ** (level / 20.0)
        L = 1.0 / (np.exp(-1j * turn) / m - 1.0)
        phase, gain = np.degrees(np.angle(L)) % 360.0 - 180.0, 20.0 * np.log10(np.abs(L))
        for centre in _centres(low, high):
            ax.plot(phase + centre, gain, color=GREY, linewidth=0.8, linestyle=":", zorder=0)


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
    """Singular values of the loop opened at all inputs, and of its sensitivity, over frequency."""
    labels = ["L, largest and smallest", "sensitivity, largest"]
    text = "Singular values of the loop opened at all inputs"
    sheet = Sheet(result, text, panels=1, height=3.6, labels=labels)
    (ax,) = sheet.axes
    hertz = result["loop/frequency"] / (2.0 * np.pi)
    values, sensitivity = result["loop/singular_values"], result["loop/sensitivity"]
    handles = ax.plot(hertz, values[:, 0], color=COLOURS[0])
    if values.shape[1] > 1:
        ax.plot(hertz, values[:, -1], color=COLOURS[0])
        ax.fill_between(hertz, values[:, -1], values[:, 0], color=COLOURS[0], alpha=0.15, linewidth=0.0)
    handles += ax.plot(hertz, sensitivity[:, 0], color=COLOURS[1], linestyle="--")
    ax.axhline(1.0, color=GREY, linewidth=0.7)
    ax.set_xscale("log")
    ax.set_yscale("log")
    powers(ax, "x")
    powers(ax, "y")
    ax.set_xlabel("frequency [Hz]")
    ax.set_ylabel("gain")
    ax.set_xlim(hertz[0], hertz[-1])
    sheet.legend(handles, labels)
    return sheet.figure


def _loops(result: Result) -> Array:
    found: Array = result["loop/response_real"] + 1j * result["loop/response_imaginary"]
    return found


def _names(result: Result) -> list[str]:
    return list(result.summary["loop"])
