"""All columns of one variable over time: as lines, or as the rows of a map where they are many."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D

from robodyn_cli.report import style
from robodyn_cli.report.canvas import Sheet
from robodyn_cli.report.curves import DrawnCurves, curves_of
from robodyn_cli.report.lines import LIMIT_NOTE, draw_limits, envelope, limits_near
from robodyn_cli.report.numbers import labelled, number
from robodyn_cli.report.style import degree_axis
from robodyn_cli.report.time_sheet import TimeSheet, draw_groups, panel_height
from robodyn_cli.results.result import Result, evenly
from robodyn_cli.spatial.algebra import Array

INSTANTS = 800  # more of them than pixels add nothing
ROWS = 400
NUMBERS = 50_000  # of a map that are kept beside it
ROW, LOWEST, HIGHEST = 0.17, 1.6, 7.0  # of a row, and of all of them: heights [inch]
NAMED_ROWS = 48  # more are not named one by one, nor have lines
LETTERS, LONGEST = 7.0, 30  # of names beside rows: their size [pt], the longest one in characters
MEASURED = {
    "start": "change from the start, blue: below, red: above",
    "zero": "blue: negative, red: positive",
    "magnitude": "magnitudes, light to dark",
}


def draw_map(result: Result, shown: DrawnCurves, quantity: str, subtitle: str, shows: str) -> Any:
    """Return a figure of curves with columns downwards and time to the right, a map for each unit.

    Each row is drawn on a scale of its own, as one column would hide all others: its largest value is beside it.
    Positions are counted from the start, since what they start at would hide the motion.
    """
    groups = shown.groups()
    kind = "start" if shows == "q" else "magnitude" if np.nanmin(shown.data, initial=0.0) >= 0.0 else "zero"
    height = float(np.clip(ROW * len(shown.names), LOWEST, HIGHEST)) / len(groups)
    sheet = TimeSheet(
        result,
        f"{subtitle}; {MEASURED[kind]}; each of {len(shown.names)} rows on its own scale, largest sample beside it",
        shows=shows,
        nothing=shown.nothing,
        panels=len(groups),
        height=height,
        gap=0.3,
        degrees=True,
        titled=True,
    )
    names = [name if len(name) <= LONGEST else name[: LONGEST - 1] + "…" for name in shown.names]
    _share(sheet, [len(columns) for columns in groups.values()], max(map(len, names)))
    for ax, (units, columns) in zip(sheet.axes, groups.items()):
        _map(ax, result.time, shown.part(columns), kind, [names[k] for k in columns])
        ax.set_title(labelled(quantity, units), fontsize=style.FONT_SIZE, loc="left", pad=3)
    sheet.finish([], [])
    return sheet.figure


def _share(sheet: Sheet, counts: Sequence[int], longest: int) -> None:
    """Give panels one below the other heights by their rows, and room on the left for the longest name."""
    width, total = sheet.figure.get_size_inches()
    boxes, gap = [ax.get_position() for ax in sheet.axes], 0.3 / total
    left = max(0.25 + 0.62 * LETTERS / 72.0 * longest, 0.5) / width
    room = boxes[0].y1 - boxes[-1].y0 - gap * (len(counts) - 1)
    top = boxes[0].y1
    for ax, box, count in zip(sheet.axes, boxes, counts):
        high = room * count / sum(counts)
        ax.set_position((left, top - high, box.x1 - left, high))
        top -= high + gap


def _map(ax: Axes, time: Array, shown: DrawnCurves, kind: str, names: Sequence[str]) -> None:
    """Draw one map, with the first column on top."""
    count, rows = len(names), evenly(len(names), ROWS)
    data = shown.data - shown.data[0] if kind == "start" else shown.data
    top = np.nanmax(np.abs(data), axis=0, initial=0.0)
    top[top <= np.nan_to_num(shown.least)] = 0.0  # rounding and errors have no pattern
    scaled = data * np.divide(1.0, top, out=np.zeros(count), where=top > 0.0)
    half = 0.5 if len(time) == 1 else 0.0
    extent = (time[0] - half, time[-1] + half, count + 0.5, 0.5)
    # lightness grows with the size, so a grey print keeps the order
    look: dict[str, Any] = (
        {"cmap": "Blues", "vmin": 0.0} if kind == "magnitude" else {"cmap": "RdBu_r", "vmin": -1.3}
    )
    image = scaled[np.ix_(evenly(len(time), INSTANTS), rows)].T
    ax.imshow(image, aspect="auto", extent=extent, interpolation="nearest", vmax=1.3, **look)
    # the numbers behind the colours, for files of them
    at = evenly(len(time), min(INSTANTS, max(1, NUMBERS // len(rows))))
    for k in rows:
        ax.add_artist(Line2D(time[at], shown.data[at, k], label=shown.names[k], visible=False))
    ax.grid(False)
    few = count <= NAMED_ROWS
    marks = range(1, count + 1) if few else sorted({round(1 + k * (count - 1) / 8) for k in range(9)})
    ax.set_yticks(list(marks), [names[mark - 1] for mark in marks], fontsize=LETTERS)
    for mark in marks:
        ax.annotate(
            number(top[mark - 1], 2), (1.0, mark), (3.0, 0.0), xycoords=ax.get_yaxis_transform(),
            textcoords="offset points", fontsize=LETTERS, va="center", annotation_clip=False,
        )  # fmt: skip
    if few and len(time) > 1:
        base, size = (0.45, 0.9) if kind == "magnitude" else (0.0, 0.45)
        curves = (k + 1 + base - size * scaled[:, k] for k in range(count))
        lines = [np.column_stack(envelope(time, y, 200)) for y in curves]
        ax.add_collection(LineCollection(lines, colors=style.BLACK, linewidths=0.6), autolim=False)
        ax.hlines(np.arange(1.5, count), *extent[:2], colors="white", linewidths=0.8)
    ax.set_ylim(*extent[2:])


def time_plot(result: Result, path: str, quantity: str, subtitle: str) -> Any:
    """Return a figure of all columns of one variable over time, with degrees where it is an angle."""
    shown = curves_of(result, path)
    names, groups = list(shown.names), shown.groups()
    if len(names) > style.MANY:
        return draw_map(result, shown, quantity, subtitle, path)
    near = limits_near(result, path)
    sheet = TimeSheet(
        result,
        subtitle + (LIMIT_NOTE if near else ""),
        shows=path,
        nothing=shown.nothing,
        panels=len(groups),
        height=panel_height(len(groups)),
        labels=names if len(names) > 1 else (),
        degrees="rad" in groups,
    )
    handles = draw_groups(sheet, shown, list(groups.values()))
    for ax, (units, columns) in zip(sheet.axes, groups.items()):
        draw_limits(ax, near, [names[k] for k in columns], [handles[k] for k in columns])
        label = "quaternion" if path == "q" and units == "1" else quantity
        ax.set_ylabel(labelled(label if len(names) > 1 else f"{names[0]}: {label}", units))
        if units == "rad":
            degree_axis(ax)
    sheet.finish(*((handles, names) if len(names) > 1 else ([], [])))
    return sheet.figure
