"""The poles of a linear model along a motion: what grows and decays, and how fast it swings, over time."""

from __future__ import annotations

from typing import Any

import numpy as np

from robodyn_cli.report.canvas import TimeSheet
from robodyn_cli.report.style import COLOURS, GREY
from robodyn_cli.results.result import Result

GROWS, DECAYS, STAYS = COLOURS[6], COLOURS[0], COLOURS[2]


def applies(result: Result) -> bool:
    """Tell whether there are poles along a motion."""
    return "linear/poles_real" in result and result["linear/poles_real"].ndim == 2 and result.time.size > 1


def draw(result: Result) -> Any:
    """Return the figure: real parts above, oscillations (if any) below; dots, for poles meet and part."""
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
    sheet = TimeSheet(result, text, panels=2 if swinging.any() else 1, height=2.1, labels=labels)
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
    sheet.label_time()
    sheet.legend(handles, labels)
    return sheet.figure
