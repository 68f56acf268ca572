"""Sheets of panels over time, which show the moments of a run, its errors, and from when on they are lost in them."""

from __future__ import annotations

import dataclasses
import textwrap
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D

from robodyn_cli.report import style
from robodyn_cli.report.abscissa import abscissa, over_joint
from robodyn_cli.report.canvas import EMPTY, Sheet
from robodyn_cli.report.curves import (
    DrawnCurves,
    draw_crests,
    draw_dots,
    draw_error,
    draw_lines,
    fit_axis,
    fit_log_axis,
    make_room,
    nothing_note,
)
from robodyn_cli.report.format import NARROW, NOTE_WIDTH, current
from robodyn_cli.report.looks import looks_of
from robodyn_cli.report.numbers import stated_words, times
from robodyn_cli.report.style import PlainFormatter
from robodyn_cli.results.moments import DECISIVE, Moment, moments
from robodyn_cli.results.result import Result
from robodyn_cli.results.sampling import sparse_words, too_far_apart
from robodyn_cli.results.stated_errors import concerning, meaningful_error, meaningful_until
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.motion import NOT_MEANINGFUL

# how moments look that come often, and what one and many of them are called; drawn at the upper edge of a panel
MARKED = {
    "impact": ("v", "impact", "impacts"),
    "contact": ("s", "contact", "contacts"),
    "release": ("^", "release", "releases"),
    "stick": ("o", "stick", "sticks"),
    "slip": ("D", "slip", "slips"),
    "latched": (">", "latch closes", "latches close"),
    "opened": ("<", "latch opens", "latches open"),
    "grip": ("P", "payload gripped", "payloads gripped"),
    "let_go": ("X", "payload released", "payloads released"),
}


def counted(found: Sequence[Moment]) -> dict[str, str]:
    """Return the label of each kind of moment that comes often, with how many there are."""
    kinds = [moment.kind for moment in found]
    return {
        kind: f"{one if kinds.count(kind) == 1 else many} ({kinds.count(kind)})"
        for kind, (_, one, many) in MARKED.items()
        if kind in kinds
    }


def decisive_text(found: Sequence[Moment]) -> str:
    """Return the decisive moments with their times, for the line above a drawing."""
    return "; ".join(f"{m.text} at {times([m.time], 6)[0]}" for m in found if m.kind in DECISIVE)


def mark_moments(axes: Sequence[Axes], found: Sequence[Moment]) -> None:
    """Mark moments on axes over time, as far as their limits go: decisive ones by a line, others by a small mark."""
    for ax in axes:
        low, high = ax.get_xlim()
        inside = [moment for moment in found if low <= moment.time <= high]
        for moment in inside:
            if moment.kind in DECISIVE:
                ax.axvline(moment.time, color=style.ALARM, linewidth=1.0, linestyle=(0, (4, 2)), zorder=1.5)
        for kind in MARKED:
            times = [moment.time for moment in inside if moment.kind == kind]
            if times:
                ax.vlines(
                    times,
                    0.0,
                    1.0,
                    transform=ax.get_xaxis_transform(),
                    color="#cfcfcf",
                    linewidth=0.5,
                    zorder=1,
                )
                ax.plot(times, [1.0] * len(times), transform=ax.get_xaxis_transform(), **marker_of(kind))


def marker_of(kind: str) -> dict[str, Any]:
    """Return the look of the mark of a kind of moment."""
    return {"marker": MARKED[kind][0], "markersize": 4.5, "markerfacecolor": "white", "markeredgecolor": style.GREY,
            "linestyle": "none", "clip_on": False, "zorder": 4}  # fmt: skip


def lost_note(result: Result) -> list[str]:
    """Return the line that says what the hatched part of a plot over time is; none where nothing is hatched."""
    until = meaningful_until(result.summary)
    if "time" not in result or not until < result.time[-1]:
        return []
    part = f"{NOT_MEANINGFUL:.0%}".replace("%", " %")
    return [
        f"Hatched: not meaningful after t = {times([until])[0]} (estimated error above {part} of the motion)"
    ]


def sparse_note(result: Result, shows: str) -> list[str]:
    """Return the line that says that samples are too far apart to show what is drawn; none where they are not."""
    if not shows:
        return []
    paths = [path for path in result.variables if path.startswith(f"{shows}/")] if shows in PARTS else [shows]
    return (
        [f"{sparse_words(result)}: dots, no lines"]
        if any(too_far_apart(result, path).any() for path in paths)
        else []
    )


def unseen_note(result: Result, path: str) -> list[str]:
    """Return the line that says that samples miss values that a sampled controller holds; none where they do not."""
    held = result.variables[path].held
    if held is None or not any(held.hides(result.time, k) for k in range(len(held.offset))):
        return []
    return [
        f"Sloping torques are not known: samples are further apart than the controller's period, "
        f"{times([held.period])[0]} (simulate.samples)"
    ]


PARTS = ("energy", "points")  # groups whose datasets are too far apart each for itself


def hatch(axes: Sequence[Axes], until: float) -> None:
    """Hatch what is drawn over time after a motion is lost in its error."""
    look: dict[str, Any] = {
        "facecolor": "none",
        "edgecolor": "#a8a8a8",
        "hatch": "//",
        "linewidth": 0.0,
        "zorder": 2.5,
    }
    for ax in axes:
        low, high = ax.get_xlim()
        if until < high:
            ax.axvspan(max(until, low), high, **look)
            ax.set_xlim(low, high)


def error_words(result: Result, path: str) -> str:
    """Return in a line what a result states of the error of a dataset or a group: first what bounds it."""
    until = meaningful_until(result.summary)
    said: list[str] = []
    for one in sorted(concerning(result.summary, path), key=lambda x: x.statement.bounds != path):
        when = ""
        if one.statement.bounds == path and np.isfinite(until):
            one = dataclasses.replace(one, value=min(one.value, meaningful_error(result, path)))
            when = f" until {times([until])[0]}"
        words = stated_words(one, result) + when
        if words not in said and (not said or len("; ".join([*said, words])) < NOTE_WIDTH - len(UNDER) - 8):
            said.append(words)
    if said:
        return f"Errors: {'; '.join(said)}"
    estimate = result.summary.get("error_estimate")
    reason = estimate.get("reason") if isinstance(estimate, dict) else None
    words = f"No error estimate: {reason}" if reason else "No error is stated for this"
    return textwrap.shorten(words, NOTE_WIDTH, placeholder=" ...")


BANDS, UNDER = " (bands)", " (under the lines)"  # how errors are seen


class TimeSheet(Sheet):
    """A sheet of panels over time, which shows the moments of the run: the decisive ones in words and as lines, those
    that come often as small marks with an entry of the legend. Its last caption states the errors."""

    def __init__(
        self, result: Result, subtitle: str, shows: str = "", nothing: Sequence[str] = (), **layout: Any
    ) -> None:
        """Lay out the panels; ``layout`` : fields of ``Panels`` but for ``captions``.

        shows : the dataset, or group of them, whose errors are told; empty where errors are drawn. nothing : what is
        said of columns that are drawn as zero.
        """
        self.moments, self.looks = moments(result), looks_of(result)
        self._result, self._shows, self._counted = result, shows, counted(self.moments)
        labels = [*layout.pop("labels", ()), *self._counted.values()]
        layout.setdefault("height", panel_height(1))
        self._errors = [error_words(result, shows)] if shows else []
        captions = [*nothing_note(nothing), *self._errors]
        alarms = [
            *filter(None, [decisive_text(self.moments)]),
            *lost_note(result),
            *sparse_note(result, shows),
        ]
        alarms += layout.pop("told", ())
        super().__init__(result, subtitle, labels=labels, captions=captions, told=alarms, **layout)
        self._drawn: list[tuple[Axes, Array, DrawnCurves, list[Line2D]]] = []

    def draw(
        self,
        ax: Axes,
        shown: DrawnCurves,
        styles: list[dict[str, Any]] | None = None,
        magnitudes: bool = False,
    ) -> list[Any]:
        """Draw curves on a linear axis, with their errors; return a handle for each. Looks are those of their names."""
        styles = styles or self.looks.lines(shown.names)
        time, shown = self._result.time, self._sampled(shown)
        handles = draw_lines(ax, time, shown.lines(time), styles)
        draw_dots(ax, shown.dots(time), handles)
        make_room(ax, shown)
        fit_axis(ax, shown, magnitudes=magnitudes)
        self._drawn.append((ax, self._result.time, shown, handles))
        return handles

    def draw_log(
        self,
        ax: Axes,
        shown: DrawnCurves,
        ends: tuple[float, float],
        styles: list[dict[str, Any]] | None = None,
        window: slice = slice(None),
    ) -> list[Any]:
        """Draw magnitudes in a window of the time on a logarithmic axis between two ends; those without ``styles``
        are noisy, and drawn with their crests."""
        time, data = self._result.time[window], shown.data[window]
        if styles:
            shown = self._sampled(shown).during(window)
            handles = draw_lines(ax, time, shown.lines(time), styles)
            draw_dots(ax, shown.dots(time), handles)
        else:
            handles = draw_crests(ax, time, data)
        colours = [handle.get_color() for handle in handles]
        fit_log_axis(ax, time, data, colours, ends, any(shown.nothing))
        return handles

    def _sampled(self, shown: DrawnCurves) -> DrawnCurves:
        """Return curves that know where samples are too far apart for them: where they are for what follows from the
        state."""
        known = shown.apart is not None
        return shown if known else dataclasses.replace(shown, apart=too_far_apart(self._result))

    def finish(self, handles: Sequence[Any], labels: Sequence[str]) -> None:
        """Draw the errors, hatch what is lost in them, mark the moments, name the time axis, put the legend below."""
        for panel, ax in enumerate(self.axes):
            below = self.axes[panel + self.across :: self.across][:1]
            if below and below[0].get_xlim() == ax.get_xlim():
                ax.tick_params(labelbottom=False)
            else:
                ax.set_xlabel("time [s]")
                ax.xaxis.set_major_formatter(PlainFormatter())
        close = [] if abscissa(self._result) else self._close_ups()
        self._draw_errors()
        hatch(self.axes, meaningful_until(self._result.summary))
        mark_moments([*self.axes, *close], self.moments)
        over_joint(self._result, self.axes)
        marks = [Line2D([], [], **marker_of(kind)) for kind in self._counted]
        super().legend([*handles, *marks], [*labels, *self._counted.values()])
        if not any(map(_shows_something, self.axes)):
            self.figure.set_label(EMPTY)

    def _close_ups(self) -> list[Axes]:
        """Draw the last periods of curves that swing so often that they are a band, on axes beside them."""
        until, close = meaningful_until(self._result.summary), []
        for ax, time, shown, handles in list(self._drawn) if current().width >= NARROW else ():
            window = last_periods(time, shown, until)
            if window is None or any(
                shown.gaps(k)[time[:-1] >= window[0]].any() for k in range(len(shown.names))
            ):
                continue
            beside = _axes_beside(ax)
            for (x, y), handle in zip(shown.lines(time), handles):
                seen = (x >= window[0]) & (x <= window[1])
                (line,) = beside.plot(x[seen], y[seen])
                line.update_from(handle)
            beside.set_xlim(*window)
            self._drawn.append((beside, time, shown, handles))
            close.append(beside)
        return close

    def _draw_errors(self) -> None:
        """Draw the errors of curves as bands where they can be seen, and say whether they can."""
        until, stated, seen = meaningful_until(self._result.summary), False, False
        for ax, time, shown, handles in self._drawn:
            for (x, y), error, handle in zip(shown.lines(time), shown.error, handles):
                if np.isfinite(error):
                    stated, kept = True, (x >= ax.get_xlim()[0]) & (x <= until)
                    seen |= draw_error(ax, x[kept], y[kept], float(error), handle.get_color())
        if stated and self._errors:
            # of a note that takes several lines the last one; none where it is cut
            for line in [note for note in self.notes if self._errors[0].endswith(note.get_text())][:1]:
                line.set_text(line.get_text() + (BANDS if seen else UNDER))


BAND = 60  # periods of a curve from which on it is a filled band
LAST_PERIODS = 5  # that are drawn once more, beside the band
SAMPLES = 8  # of a period, without which it has no shape
CLOSE_UP = "close-up"  # label of their axes
PART, APART, APART_DEGREES = 0.66, 0.2, 0.62  # of the panel's width that is left; room between [inch]


def last_periods(time: Array, shown: DrawnCurves, until: float) -> tuple[float, float] | None:
    """Return from when to when the last periods of the curve go that swings most often; None where there are few or
    samples do not show their shape. Times after ``until`` say nothing."""
    data = shown.data[time <= until]
    if not len(data):
        return None
    low, high = np.nanmin(data, axis=0, initial=np.inf), np.nanmax(data, axis=0, initial=-np.inf)
    with np.errstate(all="ignore"):
        swings = high - low > 2.0 * shown.least
        passes = [np.flatnonzero(np.diff(y > 0.5 * (a + b))) for y, a, b in zip(data.T, low, high)]
    most = max((at for at, swing in zip(passes, swings) if swing), key=len, default=np.zeros(0, dtype=int))
    if len(most) < 2 * BAND or len(data) - most[-2 * LAST_PERIODS - 1] < SAMPLES * LAST_PERIODS:
        return None
    return float(time[most[-2 * LAST_PERIODS - 1]]), float(time[len(data) - 1])


def _axes_beside(ax: Axes) -> Axes:
    """Return axes of the same height beside others, which are narrowed for it."""
    assert ax.figure is not None
    width = ax.figure.get_size_inches()[0]  # type: ignore[union-attr]
    box = ax.get_position()
    twins = [one for one in ax.figure.axes if one is not ax and one.bbox.bounds == ax.bbox.bounds]
    ax.set_position((box.x0, box.y0, PART * box.width, box.height))
    gap = (APART_DEGREES if twins else APART) / width
    beside: Axes = ax.figure.add_axes(
        (box.x0 + PART * box.width + gap, box.y0, (1.0 - PART) * box.width - gap, box.height), label=CLOSE_UP
    )
    beside.set_ylim(*ax.get_ylim())
    beside.tick_params(labelleft=False, labelbottom=bool(ax.get_xlabel()))
    beside.set_xlabel(ax.get_xlabel())
    beside.xaxis.set_major_formatter(PlainFormatter())
    beside.locator_params(axis="x", nbins=3)
    words = f"the last {LAST_PERIODS} periods"
    look: dict[str, Any] = {"ha": "right", "va": "bottom", "fontsize": 7.5, "color": style.GREY}
    beside.text(1.0, 1.02, words, transform=beside.transAxes, **look)
    return beside


def _shows_something(ax: Axes) -> bool:
    """Tell whether a panel has a curve, or a map, that is not zero throughout."""
    own = [line.get_ydata() for line in ax.lines if line.get_transform() == ax.transData]
    groups = [group for group in ax.collections if isinstance(group, LineCollection)]
    own += [segment[:, 1] for group in groups for segment in group.get_segments()]
    seen = [image.get_array() for image in ax.images] or own
    return any(np.any(np.nan_to_num(np.asarray(values, dtype=float)) != 0.0) for values in seen)


def panel_height(panels: int) -> float:
    """Return the height of a panel [inch], less where there are several."""
    return {1: 3.3, 2: 2.2}.get(panels, 1.6) * min(1.0, 0.25 + 0.15 * current().width)


def draw_groups(sheet: TimeSheet, shown: DrawnCurves, groups: Sequence[list[int]]) -> list[Any]:
    """Draw each group of columns in a panel of its own; return the handles in the order of the columns."""
    styles = sheet.looks.lines(shown.names)
    handles: dict[int, Any] = {}
    for ax, columns in zip(sheet.axes, groups):
        handles.update(zip(columns, sheet.draw(ax, shown.part(columns), [styles[k] for k in columns])))
    return [handles[k] for k in range(shown.data.shape[1])]
