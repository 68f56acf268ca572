"""What the drawings of a study share: its inputs and outputs, and their panels.

What the drawings of ``stability`` share: looks of the verdicts, scales of colours, axes of powers.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from robodyn_cli.report import style
from robodyn_cli.report.canvas import CHARACTER, Sheet
from robodyn_cli.report.numbers import labelled, number
from robodyn_cli.report.style import PowerFormatter
from robodyn_cli.results.result import Result
from robodyn_cli.spatial.algebra import Array

MOST_PANELS = 8  # outputs beyond these are in the file alone
SMALLEST = 6.5  # size of letters of a label [pt]
ROOM = 0.62  # of a number below an axis [inch]


def inputs(result: Result) -> dict[str, Array]:
    """Return the values of the keys that vary, by key, one a run."""
    return {name: v.data for name, v in result.group("inputs").items() if np.ptp(v.data) > 0.0}


def outputs(result: Result) -> dict[str, Array]:
    """Return the outputs that runs have, by key, one a run; nan where a run has none."""
    columns = {name: v.data for name, v in result.group("outputs").items()}
    return {name: data for name, data in list(columns.items())[:MOST_PANELS] if np.any(np.isfinite(data))}


def axis_label(result: Result, key: str, group: str = "inputs", short: bool = False) -> str:
    """Return the name of a key that varies, or of an output (``group`` outputs), with its unit where it has one; of a
    ``short`` one the last step."""
    units = result.variables[f"{group}/{key}"].units
    name = key.rpartition(".")[2] if short else key
    return labelled(name, units) if units not in ("", "1") else name


def fit_label(ax: Any, axis: str, text: str, **look: Any) -> None:
    """Label an axis, ``x`` or ``y``, as long as its panel: smaller where it must be, then without its beginning."""
    width, height = ax.get_position().size * ax.figure.get_size_inches()
    room = (width if axis == "x" else height) / CHARACTER  # characters
    size = max(SMALLEST, style.FONT_SIZE * min(1.0, room / len(text)))
    most = int(room * style.FONT_SIZE / size)
    text = text if len(text) <= most else "…" + text[1 - most :]
    getattr(ax, f"set_{axis}label")(text, fontsize=size, **look)


def panels(result: Result, subtitle: str, names: list[str], height: float = 2.2, **layout: Any) -> Sheet:
    """Return a sheet with a panel for each output, two side by side unless ``layout`` says otherwise."""
    layout = {"across": 1 if len(names) == 1 else 2, "height": height, "gap": 0.62, **layout}
    sheet = Sheet(result, subtitle, panels=len(names), **layout)
    for ax in sheet.axes:
        ax.xaxis.set_major_formatter(style.PlainFormatter())
    return sheet


def runs_text(result: Result) -> str:
    """Return how many runs there are, and how many failed."""
    code = result["runs/exit_code"]
    failed = int(np.count_nonzero(code))
    return f"{len(code)} runs" + (f", {failed} failed" if failed else "")


def tornado(ax: Any, label: str, swings: dict[str, float], figures: bool = False) -> None:
    """Draw a bar for each key, the longest on top; its name stands inside the panel, above the bar.

    figures : whether its number stands there too.
    """
    y = np.arange(len(swings))[::-1]
    colours = [style.COLOURS[0] if swing >= 0.0 else style.COLOURS[1] for swing in swings.values()]
    ax.barh(y, list(swings.values()), height=0.42, color=colours)
    ax.axvline(0.0, color="#4d4d4d", linewidth=0.8)
    ax.set_yticks([])
    ax.set_ylim(-0.5, len(swings) - 0.3)
    ax.margins(x=0.08)
    behind = {"facecolor": "white", "edgecolor": "none", "pad": 0.6}  # or lines would cross the text
    for place, key in zip(y, swings):
        text = f"{key}:  {'+' * (swings[key] > 0.0)}{number(swings[key])}" if figures else key
        ax.text(
            0.01,
            place + 0.24,
            text,
            transform=ax.get_yaxis_transform(),
            fontsize=7.5,
            va="bottom",
            bbox=behind,
        )
    fit_label(ax, "x", label)
    width = ax.get_position().width * ax.figure.get_size_inches()[0]
    ax.locator_params(axis="x", nbins=min(6, int(width / ROOM)))


# colour-blind safe, and told apart by hatch and word too
STATUS = {
    "stable": ("#009E73", ""),
    "inaccurate": ("#E69F00", "///"),
    "diverged": ("#D55E00", "xxx"),
    "too_slow": ("#56B4E9", "..."),
    "unsupported": ("#bbbbbb", ""),
}
LEAST = 1e-16  # the smallest error that is drawn
BAR_GAP, BAR = 0.08, 0.12  # between a panel and its scale of colours, and its width [inch]


def bar_beside(ax: Axes, title: str = "") -> Axes:
    """Return axes on the right of others for a scale of colours, with what it is of above."""
    box = ax.get_position()
    assert ax.figure is not None
    width = ax.figure.get_size_inches()[0]  # type: ignore[union-attr]
    bar = ax.figure.add_axes((box.x1 + BAR_GAP / width, box.y0, BAR / width, box.height))
    bar.set_title(title, fontsize=8, loc="left", pad=4)
    return bar


def powers(ax: Axes, *axes: str) -> None:
    """Number the axes ``x`` or ``y`` with powers of ten alone."""
    from matplotlib.ticker import NullFormatter

    for name in axes:
        one = getattr(ax, f"{name}axis")
        one.set_major_formatter(PowerFormatter())
        one.set_minor_formatter(NullFormatter())
