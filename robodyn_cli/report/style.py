"""How drawings look: colours and dashes that survive colour blindness and a grey printer, units, numbers and axes."""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Iterator
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import (
    FixedLocator,
    Formatter,
    FuncFormatter,
    LogLocator,
    MaxNLocator,
    NullFormatter,
    NullLocator,
    ScalarFormatter,
)

from robodyn_cli.report.format import FigureFormat, formatted
from robodyn_cli.report.numbers import number, power, prefix

FONT_SIZE = 9.0
GREY = "#5f5f5f"
ALARM = "#D55E00"
TARGET = "#000000"

# Okabe and Ito, ordered so that neighbours differ in lightness too. In place of their yellow, too pale for a thin
# line, and of black, which is for sums, targets and outlines, two dark ones of Tol: with any of three kinds of colour
# blindness the nearest two differ by 10.9 (CIEDE2000).
COLOURS = ("#0072B2", "#E69F00", "#882255", "#009E73", "#332288", "#56B4E9", "#D55E00", "#CC79A7")
BLACK = "#000000"
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
# Up to FEW lines each have a colour of their own, up to MANY a pair of colour and dash; more become rows of a map.
FEW = len(COLOURS)
MANY = 16

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
    # titles stand where they are put: to find a place for them, all numbers of an axis would be laid out once more
    "axes.titley": 1.0,
    "hatch.linewidth": 0.6,
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
    "pdf.fonttype": 42,  # TrueType, as publishers ask for
    "agg.path.chunksize": 20000,
}


@contextlib.contextmanager
def styled(form: FigureFormat | None = None) -> Iterator[None]:
    """Draw in robodyn's style and a format inside the context, whatever the user's own settings of matplotlib."""
    with matplotlib.rc_context(), formatted(form):
        # To touch the backend would import pyplot and look for a display.
        defaults: dict[Any, Any] = {
            name: item for name, item in matplotlib.rcParamsDefault.items() if name != "backend"
        }
        matplotlib.rcParams.update(defaults)
        matplotlib.rcParams.update(_SETTINGS)
        yield


def line_styles(count: int) -> list[dict[str, Any]]:
    """Return colour, dash and width for each of ``count`` lines, which are thinner where there are many."""
    width = 1.5 if count <= FEW else 1.1
    return [{**dashed_style(place), "linewidth": width} for place in range(count)]


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


# advance of a character, over the font size: DejaVu Sans
MINUS = "\N{MINUS SIGN}"
ADVANCE = {".": 0.318, MINUS: 0.838}
DIGIT = 0.636
BESIDE = 24.0  # between the edge of the page and numbers: the axis' label, its distance, a tick [pt]


def prefix_axes(figure: Figure) -> None:
    """Number linear axes that name their unit with a prefix where the values suit it: ``time [ns]``."""
    for ax in figure.axes:
        for axis in (ax.xaxis, ax.yaxis):
            named = re.fullmatch(r"(.*\[)(.+)\]", axis.get_label_text())
            formatter = axis.get_major_formatter()
            plain = type(formatter) in (PlainFormatter, ScalarFormatter) and axis.get_scale() == "linear"
            if not named or not plain:
                continue
            low, high = axis.get_view_interval()
            word, factor = prefix(max(abs(low), abs(high)), named[2])
            if factor != 1.0 and not max(abs(low), abs(high)) > FAR_AWAY * (high - low):
                axis.set_label_text(f"{named[1]}{word}]")
                room = formatter.room if isinstance(formatter, PlainFormatter) else math.inf
                axis.set_major_formatter(PlainFormatter(room, factor))


FAR_AWAY = 1e4  # times the width of an axis, at which numbers are differences from one of them all the same


class _Scaled:
    """An axis whose values are multiplied by a factor, for its formatter."""

    def __init__(self, axis: Any, factor: float) -> None:
        self._axis, self._factor = axis, factor

    def __getattr__(self, name: str) -> Any:
        return getattr(self._axis, name)

    def get_view_interval(self) -> tuple[float, float]:
        low, high = self._axis.get_view_interval()
        return self._factor * low, self._factor * high


class PlainFormatter(ScalarFormatter):
    """Writes the numbers of a linear axis, and apart from them what they are multiplied by and what is added to all,
    as on other drawings.

    room : beside the axis, for numbers and a label [in]. Numbers that are too wide for it get a power of ten, or are
    differences from one of them. factor : of all numbers, for another unit.
    """

    def __init__(self, room: float = math.inf, factor: float = 1.0) -> None:
        super().__init__()
        self._places: list[float] = []
        self.in_label = False  # whether the label of the axis says by how much numbers are multiplied
        self.room, self._factor = room, factor
        self._most = (72.0 * room - BESIDE) / FONT_SIZE

    def set_axis(self, axis: Any) -> None:
        """Know the axis, whose values are multiplied."""
        seen: Any = axis if self._factor == 1.0 else _Scaled(axis, self._factor)
        super().set_axis(seen)

    def __call__(self, x: float, pos: Any = None) -> str:
        return str(super().__call__(x * self._factor, pos))

    def set_locs(self, locs: Any) -> None:
        """Choose how the numbers at these places are written: the first way that leaves room for a label."""
        self._places = [float(x) for x in locs]
        locs = [self._factor * x for x in self._places]
        middle = locs[len(locs) // 2] if locs else True
        for limits, offset in (((-5, 6), True), ((0, 0), True), ((0, 0), middle)):
            self.set_powerlimits(limits)
            self.set_useOffset(offset)
            super().set_locs(locs)
            if self._widest() <= self._most:
                return

    def _widest(self) -> float:
        """Return the width of the widest number, over the font size."""
        texts = (self(x) for x in self._places)
        return max((sum(ADVANCE.get(x, DIGIT) for x in text) for text in texts), default=0.0)

    def get_offset(self) -> str:
        """Return what stands above the axis: ``·10⁻¹⁶``, ``·10⁻¹² + 0.1``."""
        text = str(super().get_offset()).replace("\N{MINUS SIGN}", "-")
        factor, added = re.fullmatch("(?:1e(-?\\d+))?([+-].+)?", text).groups()  # type: ignore[union-attr]
        parts = [f"·{power(int(factor))}"] if factor and not self.in_label else []
        if added:
            parts.append(f"{'+' if added[0] == '+' else MINUS} {number(abs(float(added)), 10)}")
        return " ".join(parts)


def place_offsets(figure: Figure) -> None:
    """Put what the numbers of upright axes are multiplied by into the label, ``[10⁻⁷ J]``, or inside the panel where
    something is added to them: above it stand notes."""
    for ax in figure.axes:
        formatter, label = ax.yaxis.get_major_formatter(), ax.yaxis.get_label_text()
        if not isinstance(formatter, PlainFormatter) or ax.get_yscale() != "linear":
            continue
        formatter.set_locs(ax.yaxis.get_majorticklocs())
        factor, named = formatter.get_offset(), re.fullmatch(r"(.*\[)(.+)\]", label)
        if named and factor.startswith("·") and " " not in factor:
            units = "" if named[2] == "1" else f" {named[2]}"
            ax.yaxis.set_label_text(f"{named[1]}{factor[1:]}{units}]")
            formatter.in_label = True
        text, rest = ax.yaxis.get_offset_text(), formatter.get_offset()
        if rest and text.get_visible():
            text.set_visible(False)
            right = ax.yaxis.get_ticks_position() == "right"
            box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.5}
            place: dict[str, Any] = {
                "xy": (1.0 if right else 0.0, 1.0),
                "xytext": (-3.0 if right else 3.0, -3.0),
            }
            look: dict[str, Any] = {"ha": "right" if right else "left", "va": "top", "bbox": box, "zorder": 5}
            ax.annotate(rest, **place, xycoords="axes fraction", textcoords="offset points", **look)


def number_log_axes(figure: Figure) -> None:
    """Give logarithmic axes on which fewer than two numbers stand as many round ones as they have room for."""
    for ax in figure.axes:
        for axis in (ax.xaxis, ax.yaxis):
            if axis.get_scale() != "log":
                continue
            low, high = sorted(axis.get_view_interval())
            ticks = ((axis.get_majorticklocs(), axis.get_major_formatter()),
                     (axis.get_minorticklocs(), axis.get_minor_formatter()))  # fmt: skip
            words = [word for places, form in ticks for x, word in zip(places, form.format_ticks(list(places)))
                     if low <= x <= high and word]  # fmt: skip
            if len(words) < FEWEST_NUMBERS:
                axis.set_major_locator(FixedLocator(round_numbers(low, high)))
                axis.set_major_formatter(FuncFormatter(lambda x, _: number(x, 4)))
                axis.set_minor_formatter(NullFormatter())


FEWEST_NUMBERS = 2


def round_numbers(low: float, high: float) -> list[float]:
    """Return two numbers at least between the ends of a logarithmic axis, those as round as there are."""
    tens = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    for steps in ((1.0, 3.0), (1.0, 2.0, 5.0), range(1, 10)):
        found = [step * 10.0**k for k in tens for step in steps if low <= step * 10.0**k <= high]
        if len(found) >= FEWEST_NUMBERS:
            return found
    return [float(x) for x in MaxNLocator(4).tick_values(low, high) if low <= x <= high]


# room for degrees on the right, as for numbers that have a label beside them [in]
BESIDE_DEGREES = 0.85


class PowerFormatter(Formatter):
    """Writes powers of ten on a logarithmic axis."""

    def __call__(self, x: float, pos: Any = None) -> str:
        if x <= 0.0:
            return ""
        exponent = math.log10(x)
        return power(round(exponent)) if abs(exponent - round(exponent)) < 1e-6 else ""


def log_axis(ax: Axes, low: float, high: float) -> None:
    """Make the y-axis logarithmic and no wider than from ``low`` to ``high``; within a decade it stays linear.

    Over less than three decades numbers between the powers of ten are written too.
    """
    decades = math.log10(high / low)
    if decades < 1.0:
        room = 0.05 * (high - low) or 0.5 * high
        ax.set_ylim(low - room, high + room)
        return
    room = 10.0 ** (0.03 * decades)
    ax.set_yscale("log", nonpositive="mask")  # no line goes to or from a zero
    ax.set_ylim(low / room, high * room)
    ax.yaxis.set_major_locator(LogLocator(numticks=9))
    ax.yaxis.set_major_formatter(PowerFormatter())
    if decades <= 3.0:
        ax.yaxis.set_minor_locator(LogLocator(subs=(2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0)))
        ax.yaxis.set_minor_formatter(_Between() if decades <= 2.0 else _Silent())
        ax.tick_params(axis="y", which="minor", labelcolor="#5f5f5f")
    else:
        ax.yaxis.set_minor_locator(NullLocator())


class _Between(Formatter):
    """Writes twice and five times a power of ten."""

    def __call__(self, x: float, pos: Any = None) -> str:
        mantissa = x / 10.0 ** math.floor(math.log10(x) + 1e-9) if x > 0.0 else 0.0
        return number(x, 1) if round(mantissa) in (2, 5) else ""


class _Silent(Formatter):
    def __call__(self, x: float, pos: Any = None) -> str:
        return ""


class _Degrees(PlainFormatter):
    def __call__(self, x: float, pos: Any = None) -> str:
        return f"{super().__call__(x, pos)}°"


def degree_axis(ax: Axes) -> None:
    """Add a scale in degrees on the right of an axis in radians, with round numbers of its own."""
    twin = ax.twinx()
    low, high = ax.get_ylim()
    ax.set_ylim(low, high)
    twin.set_ylim(math.degrees(low), math.degrees(high))
    twin.yaxis.set_major_locator(MaxNLocator(nbins=8, steps=[1, 1.5, 3, 4.5, 6, 9, 10]))
    twin.yaxis.set_major_formatter(_Degrees(BESIDE_DEGREES))
    twin.spines["right"].set_visible(True)
    twin.grid(False)


def positive_floor(*arrays: Any, floor: float = 0.0) -> tuple[float, float]:
    """Return (floor, largest) for a logarithmic axis over ``arrays``, in which zeros have no place.

    Without a ``floor`` it is a little below the smallest positive value.
    """
    values = np.concatenate([np.ravel(array) for array in arrays])
    values = values[np.isfinite(values) & (values > 0.0)]
    if not values.size:
        return floor or 1e-16, 10.0 * (floor or 1e-16)
    low = floor or max(float(values.min()), float(values.max()) * 1e-25)
    return low, max(float(values.max()), low)
