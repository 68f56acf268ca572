"""Columns over time as they are drawn, and how: what rounding makes of zero is zero, and zero has no place on a
logarithmic axis, so that lines break there and the lower edge is marked."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D

from robodyn_cli.record import record
from robodyn_cli.report import style
from robodyn_cli.report.lines import crest, envelope, finite
from robodyn_cli.report.numbers import error_number, unit
from robodyn_cli.report.style import log_axis
from robodyn_cli.results.held import HeldColumns
from robodyn_cli.results.result import Result, column_names, units_of
from robodyn_cli.results.sampling import too_far_apart
from robodyn_cli.results.stated_errors import meaningful_error
from robodyn_cli.spatial.algebra import Array

NOTHING = 1e-12  # of the largest value of its unit: less is what rounding leaves of zero
NAMED = 3  # columns that a caption names
DOTS: dict[str, Any] = {"linestyle": "none", "marker": ".", "markersize": 4}
LINE = 1.5  # width of a line [pt]; an error that is smaller is under it


@record
class DrawnCurves:
    """Columns over time as they are drawn: one that is nothing beside its error or its rounding is zero.

    data : (T, n). names, units : of each column. error : (n,) largest one while the motion is meaningful, nan where
    none is stated. size : (n,) largest value of its peers, which have the same unit. nothing : name and largest value
    of each column that is drawn as zero, else an empty text. held : which columns are constant between updates of a
    sampled controller. apart : (T - 1, n), or (T - 1, 1) of all columns alike, between which samples no line is drawn;
    None where that is not known.
    """

    data: Array
    names: Sequence[str]
    units: Sequence[str]
    error: Array
    size: Array
    nothing: Sequence[str]
    held: HeldColumns | None = None
    apart: Array | None = None

    def lines(self, time: Array) -> list[tuple[Array, Array]]:
        """Return the corners of the line of each column over samples at times (T,): steps where it is held, gaps where
        samples are too far apart."""
        return [self._line(time, y, k) for k, y in enumerate(self.data.T)]

    def _line(self, time: Array, y: Array, k: int) -> tuple[Array, Array]:
        if self.held is not None and self.held.is_held(k):
            return self.held.line(time, y, k)
        behind = np.flatnonzero(self.gaps(k)) + 1
        return np.insert(time, behind, time[behind - 1]), np.insert(y, behind, np.nan)

    def gaps(self, k: int) -> Array:
        """Return between which samples (T - 1,) no line of a column is drawn; none where it is held."""
        if self.apart is None or (self.held is not None and self.held.is_held(k)):
            return np.zeros(max(0, len(self.data) - 1), dtype=bool)
        return np.asarray(self.apart[:, k if self.apart.shape[1] > 1 else 0])

    def dots(self, time: Array) -> list[tuple[Array, Array]]:
        """Return the samples of each column beside gaps of its line."""
        gaps = [np.concatenate([[False], self.gaps(k), [False]]) for k in range(self.data.shape[1])]
        beside = [gap[1:] | gap[:-1] for gap in gaps]
        return [(time[at], y[at]) for at, y in zip(beside, self.data.T)]

    @property
    def least(self) -> Array:
        """What of each column (n,) counts as zero, and by how much a constant may vary."""
        return np.asarray(np.fmax(self.error, NOTHING * self.size))

    @property
    def top(self) -> Array:
        """Largest magnitude of each column (n,)."""
        return np.asarray(np.nanmax(np.abs(self.data), axis=0, initial=0.0))

    def part(self, columns: Sequence[int]) -> DrawnCurves:
        """Return some of the columns."""
        k = list(columns)
        names, units, nothing = ([x[i] for i in k] for x in (self.names, self.units, self.nothing))
        held = self.held and HeldColumns(self.held.period, tuple(self.held.offset[i] for i in k))
        apart = self.apart if self.apart is None or self.apart.shape[1] == 1 else self.apart[:, k]
        return DrawnCurves(self.data[:, k], names, units, self.error[k], self.size[k], nothing, held, apart)

    def during(self, window: slice) -> DrawnCurves:
        """Return the curves in a window of the samples."""
        data = self.data[window]
        first = window.start or 0
        apart = None if self.apart is None else self.apart[first : first + max(0, len(data) - 1)]
        return dataclasses.replace(self, data=data, apart=apart)

    def groups(self) -> dict[str, list[int]]:
        """Return the columns of each unit."""
        units = dict.fromkeys(self.units)
        return {one: [k for k, x in enumerate(self.units) if x == one] for one in units}


def curves(
    data: Array, names: Sequence[str], units: Sequence[str], error: Any = np.nan,
    beside: Mapping[str, float] | None = None, *, alone: bool = False,
) -> DrawnCurves:  # fmt: skip
    """Return the columns of ``data`` (T, n) as they are drawn.

    error : of each column, or of all. beside : largest value of other peers, by unit. alone : no column has peers.
    """
    data = finite(data)
    top = np.nanmax(np.abs(data), axis=0, initial=0.0)
    peers = {one: max([0.0, *(x for x, u in zip(top, units) if u == one)]) for one in units}
    size = top if alone else np.array([max(peers[one], (beside or {}).get(one, 0.0)) for one in units])
    errors = np.broadcast_to(np.asarray(error, dtype=float), top.shape)
    nothing = (top > 0.0) & (top <= np.fmax(errors, NOTHING * size))
    said = [
        f"{name} ({' '.join(filter(None, (error_number(largest, 1), unit(one))))})" if none else ""
        for name, one, largest, none in zip(names, units, top, nothing)
    ]
    return DrawnCurves(np.where(nothing, 0.0, data), list(names), list(units), errors, size, said)


def curves_of(result: Result, path: str, beside: Mapping[str, float] | None = None) -> DrawnCurves:
    """Return the columns of a dataset as they are drawn; that of one column has the end of its path as a name."""
    variable = result.variables[path]
    if variable.data.ndim == 1:
        names, units, data = [path.rpartition("/")[2]], [variable.units], variable.data[:, None]
    else:
        names, units, data = column_names(variable), units_of(variable), variable.data
    shown = curves(data, names, units, meaningful_error(result, path), beside)
    return dataclasses.replace(shown, held=variable.held, apart=too_far_apart(result, path))


def nothing_note(nothing: Sequence[str]) -> list[str]:
    """Return the line that says which columns are drawn as zero; none where none is."""
    names = list(dict.fromkeys(filter(None, nothing)))
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return [f"Drawn as zero, within rounding or error: {', '.join(names[:NAMED])}{more}"] if names else []


def zero_note(*magnitudes: Array) -> str:
    """Return the part of a caption that says what the marks of logarithmic axes are; empty where none has a zero."""
    mixed = any(np.any(data == 0.0) and np.any(data > 0.0) for data in magnitudes)
    return "; lower edge: zero or rounding" if mixed else ""


def draw_lines(
    ax: Axes, time: Array, lines: Sequence[tuple[Array, Array]], styles: list[dict[str, Any]] | None = None
) -> list[Any]:
    """Draw lines by their corners over the whole ``time`` (T,); return a legend handle for each."""
    styles = styles or style.line_styles(len(lines))
    if len(time) == 1:
        handles: list[Any] = [
            ax.plot(*line, marker="o", markersize=5, color=look["color"], linestyle="none")[0]
            for line, look in zip(lines, styles)
        ]
        ax.set_xlim(time[0] - 0.5, time[0] + 0.5)
        return handles
    if len(styles) <= style.FEW:
        handles = [ax.plot(*envelope(*line), **look)[0] for line, look in zip(lines, styles)]
    else:
        # A line of its own for each of a hundred columns costs more than all else in the drawing.
        bins = max(200, 8 * 1200 // len(styles))
        paths = [np.column_stack(envelope(*line, bins)) for line in lines]
        ax.add_collection(
            LineCollection(
                paths,
                colors=[look["color"] for look in styles],
                linestyles=[look["linestyle"] for look in styles],
                linewidths=styles[0]["linewidth"],
            )
        )
        ax.autoscale_view()
        handles = [Line2D([], [], **look) for look in styles]
    ax.set_xlim(time[0], time[-1])
    return handles


def draw_dots(ax: Axes, dots: Sequence[tuple[Array, Array]], handles: Sequence[Any]) -> None:
    """Draw samples that no line joins, in the colours of the lines of their columns."""
    for (x, y), handle in zip(dots, handles):
        if len(x):
            ax.plot(*envelope(x, y), color=handle.get_color(), **DOTS)


def draw_crests(ax: Axes, time: Array, data: Array) -> list[Any]:
    """Draw noisy magnitudes, shape (T, n), faintly and their crests heavily; return handles of the crests.

    Zeros leave gaps in the faint lines.
    """
    styles = style.line_styles(data.shape[1])
    if len(time) <= 2:
        return draw_lines(ax, time, [(time, y) for y in data.T], styles)
    handles = []
    for values, look in zip(data.T, styles):
        seen = np.where(values > 0.0, values, np.nan)
        if np.any(values > 0.0):
            ax.plot(*envelope(time, seen), color=look["color"], linewidth=0.5, alpha=0.45)
        handles += ax.plot(*crest(time, values), **look)
    ax.set_xlim(time[0], time[-1])
    return handles


def make_room(ax: Axes, shown: DrawnCurves) -> None:
    """Let an axis reach as far as the errors of its curves, but those that are larger than all that is drawn."""
    low, high = np.nanmin(shown.data, axis=0, initial=np.inf), np.nanmax(shown.data, axis=0, initial=-np.inf)
    seen = shown.error < high.max(initial=-np.inf) - low.min(initial=np.inf)
    if seen.any():
        x = ax.get_xlim()[0]
        ax.update_datalim([(x, y) for y in (*(low - shown.error)[seen], *(high + shown.error)[seen])])
        ax.autoscale_view(scalex=False)


def fit_axis(ax: Axes, *curves: DrawnCurves, magnitudes: bool = False) -> None:
    """Give an axis the size of the peers where its curves do not vary by more than their error or rounding, and room
    for all that is drawn."""
    low = min(float(np.nanmin(shown.data, initial=np.inf)) for shown in curves)
    high = max(float(np.nanmax(shown.data, initial=-np.inf)) for shown in curves)
    least = max(float(shown.least.max(initial=0.0)) for shown in curves)
    size = max(float(shown.size.max(initial=0.0)) for shown in curves) or 1.0
    if not high - low > 2.0 * least:
        middle = 0.5 * (low + high) if np.isfinite(low + high) else 0.0
        # the line at zero lies beside the axis, not behind it
        ends = (-0.04, 1.0) if magnitudes and middle == 0.0 else (-1.0, 1.0) if middle == 0.0 else (-0.1, 0.1)
        bottom, top = middle + ends[0] * size, middle + ends[1] * size
        drawn = ax.dataLim.intervaly
        room = 0.05 * (max(top, drawn[1]) - min(bottom, drawn[0]))
        ax.set_ylim(
            drawn[0] - room if drawn[0] < bottom else bottom, drawn[1] + room if drawn[1] > top else top
        )


def fit_log_axis(
    ax: Axes,
    time: Array,
    data: Array,
    colours: Sequence[Any],
    ends: tuple[float, float],
    rounding: bool = False,
) -> None:
    """Make an axis of magnitudes (T, n) logarithmic between two ends and mark zeros on its lower edge; where nothing is
    positive that is said, and there are no numbers. rounding : whether zeros are what rounding leaves."""
    if not np.any(data > 0.0):
        ax.set_ylim(-0.04, 1.0)
        ax.set_yticks([])
        middle = 0.5 * float(time[0] + time[-1])
        words = "zero or rounding throughout" if rounding else "zero throughout"
        ax.annotate(words, (middle, 0.5), ha="center", va="center", color=style.GREY)
        return
    log_axis(ax, *ends)
    zeros = data == 0.0
    if ax.get_yscale() != "log":
        if zeros.any():
            ax.set_ylim(-0.04 * ends[1], 1.05 * ends[1])
        return
    for none, values, colour in zip(zeros.T, data.T, colours):
        _mark_zeros(ax, time, none, colour)
        single = alone(values > 0.0) if none.any() else none
        if single.any():  # between zeros there is no line
            ax.plot(*envelope(time[single], values[single]), ".", color=colour, markersize=4)


def _mark_zeros(ax: Axes, time: Array, zero: Array, colour: Any) -> None:
    """Draw a broad line on the lower edge where a curve is zero, a ring where one sample is."""
    if not zero.any():
        return
    edge: dict[str, Any] = {"transform": ax.get_xaxis_transform(), "color": colour, "clip_on": False}
    x, y = envelope(time, np.where(zero, 0.0, np.nan))
    ax.plot(x, y, linewidth=3.5, alpha=0.6, solid_capstyle="butt", **edge)
    at = envelope(time[alone(zero)], np.zeros(int(alone(zero).sum())))
    if len(at[0]):
        ax.plot(*at, linestyle="none", marker="o", markersize=4.5, markerfacecolor="white", zorder=4, **edge)


def alone(chosen: Array) -> Array:
    """Tell which samples are chosen and their neighbours are not."""
    around = np.concatenate([[False], chosen, [False]])
    return np.asarray(chosen & ~around[:-2] & ~around[2:])


def draw_error(ax: Axes, time: Array, values: Array, error: float, colour: Any) -> bool:
    """Draw the error of a curve as a band where that is broader than its line; tell whether it is."""
    low, high = ax.get_ylim()
    assert ax.figure is not None
    points = 72.0 * ax.get_position().height * ax.figure.get_size_inches()[1]  # type: ignore[union-attr]
    if not 2.0 * error * points > LINE * (high - low) or ax.get_yscale() == "log" or not len(time):
        return False
    x, y = envelope(time, values)
    if len(time) == 1:
        ax.vlines(x, y - error, y + error, color=colour, linewidth=LINE)
    else:
        ax.fill_between(x, y - error, y + error, color=colour, alpha=0.22, linewidth=0.0, zorder=1.4)
    ax.set_ylim(low, high)
    return True
