"""The transmission angle over time, with the band in which a mechanism transmits well."""

from __future__ import annotations

from typing import Any

import numpy as np

from robodyn_cli.report import style
from robodyn_cli.report.canvas import TimeSheet
from robodyn_cli.report.decimate import finite
from robodyn_cli.report.lines import draw_columns
from robodyn_cli.report.ticks import number
from robodyn_cli.results.result import Result

GOOD = (40.0, 140.0)  # degrees, the usual bounds


def applies(result: Result) -> bool:
    """Tell whether there is a transmission angle."""
    return "transmission_angle" in result


def draw(result: Result) -> Any:
    """Return the figure."""
    angle = np.degrees(finite(result["transmission_angle"]))
    low, high = number(float(np.nanmin(angle)), 4), number(float(np.nanmax(angle)), 4)
    labels = ["transmission angle", "40 to 140 deg, where it is good"]
    sheet = TimeSheet(result, f"Transmission angle: from {low} to {high} deg", labels=labels)
    handles = draw_columns(sheet.ax, result.time, angle[:, None])
    band = sheet.ax.axhspan(*GOOD, color=style.GREY, alpha=0.12, zorder=0, linewidth=0)
    sheet.ax.set_ylim(0.0, 180.0)
    sheet.ax.set_yticks(range(0, 181, 20))
    sheet.ax.set_ylabel("transmission angle [deg]")
    sheet.label_time()
    sheet.legend([*handles, band], labels)
    return sheet.figure
