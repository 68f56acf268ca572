"""How robodyn's drawings look: colours and dashes that survive colour blindness and a grey printer."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from typing import Any

import matplotlib
from matplotlib import colormaps

DPI = 120
FONT_SIZE = 9.0
GREY = "#5f5f5f"
ALARM = "#D55E00"
TARGET = "#000000"

# Okabe and Ito, ordered so that neighbours differ in lightness too; its yellow is too pale for a thin line.
COLOURS = ("#0072B2", "#E69F00", "#000000", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#7F7F7F")
DASHES: tuple[Any, ...] = (
    "-",
    (0, (5, 1.5)),
    (0, (1.2, 1.2)),
    (0, (7, 1.5, 1.2, 1.5)),
    (0, (3, 1)),
    (0, (9, 3)),
    (0, (3, 1.2, 1, 1.2, 1, 1.2)),
    (0, (1, 2.5)),
)
# Of a line in a legend, in font sizes: as long as the longest dash needs to be told from a solid line.
HANDLE_LENGTH = 3.5
# Markers differ in outline, and each is known filled and open.
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
# Up to this many lines are told apart by colour and dash, up to MANY by shade and dash; more become a map.
FEW = len(COLOURS)
MANY = 24

_SETTINGS: dict[Any, Any] = {
    "font.size": FONT_SIZE,
    "axes.labelsize": FONT_SIZE,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#4d4d4d",
    "axes.linewidth": 0.8,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.xmargin": 0.0,
    "grid.color": "#dedede",
    "grid.linewidth": 0.6,
    "xtick.color": "#4d4d4d",
    "ytick.color": "#4d4d4d",
    "xtick.labelcolor": "black",
    "ytick.labelcolor": "black",
    "lines.linewidth": 1.5,
    "lines.solid_capstyle": "round",
    "legend.frameon": False,
    "legend.fontsize": FONT_SIZE,
    # Names come from the scene: a dollar sign in one is no formula. Without formulas, text is cheaper too.
    "text.parse_math": False,
    "path.simplify_threshold": 0.2,
    "agg.path.chunksize": 20000,
}


@contextlib.contextmanager
def styled() -> Iterator[None]:
    """Draw in robodyn's style inside the context, whatever the user's own settings of matplotlib."""
    with matplotlib.rc_context():
        # To touch the backend would import pyplot and look for a display.
        defaults: dict[Any, Any] = {
            name: item for name, item in matplotlib.rcParamsDefault.items() if name != "backend"
        }
        matplotlib.rcParams.update(defaults)
        matplotlib.rcParams.update(_SETTINGS)
        yield


def line_styles(count: int) -> list[dict[str, Any]]:
    """Return colour, dash and width for each of ``count`` lines."""
    if count == 1:
        return [{"color": COLOURS[0], "linestyle": "-", "linewidth": 1.5}]
    if count <= FEW:
        return [
            {"color": colour, "linestyle": dash, "linewidth": 1.5} for colour, dash in zip(COLOURS, DASHES)
        ][:count]
    return [
        {"color": colour, "linestyle": DASHES[index % 3], "linewidth": 1.1}
        for index, colour in enumerate(shades(count))
    ]


def marked_style(index: int) -> dict[str, Any]:
    """Return colour and marker of the ``index``-th curve; they repeat after twice the number of markers.

    Marker and filling alone tell the curves apart, for a grey printer. In the second round the marker is open and
    another than the one which the colour had in the first.
    """
    lap, place = divmod(index % (2 * len(MARKERS)), len(MARKERS))
    colour = COLOURS[place]
    return {
        "color": colour,
        "marker": MARKERS[(place + 3 * lap) % len(MARKERS)],
        "markerfacecolor": "white" if lap else colour,
    }


def dashed_style(index: int) -> dict[str, Any]:
    """Return colour and dash of the ``index``-th curve without markers; they repeat after the square of FEW.

    Each further round pairs the colours with the next dashes but two.
    """
    lap, place = divmod(index, FEW)
    return {"color": COLOURS[place], "linestyle": DASHES[(place + 3 * lap) % FEW]}


def shades(count: int) -> Sequence[Any]:
    """Return ``count`` colours in order from dark to light, none too pale for white paper."""
    palette = colormaps["viridis"]
    return [palette(0.9 * index / max(1, count - 1)) for index in range(count)]
