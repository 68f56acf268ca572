"""Drawings of stored results, made again: all of one, or several over one another.

Several results over one another: a panel a quantity, a line a result.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from robodyn_cli.errors import CapabilityError
from robodyn_cli.report import style
from robodyn_cli.report.canvas import Sheet, failure_note, save
from robodyn_cli.report.curves import (
    NAMED,
    DrawnCurves,
    curves_of,
    draw_dots,
    draw_error,
    fit_axis,
    nothing_note,
)
from robodyn_cli.report.lines import envelope
from robodyn_cli.report.numbers import position_word, unit
from robodyn_cli.report.registry import Drawings, applicable, draw_all
from robodyn_cli.report.style import styled
from robodyn_cli.report.time_sheet import error_words, hatch, lost_note, panel_height
from robodyn_cli.results.atomic import output_errors
from robodyn_cli.results.output_dir import path_ends
from robodyn_cli.results.result import Result
from robodyn_cli.results.stated_errors import meaningful_until
from robodyn_cli.spatial.algebra import Array


def draw_again(
    results: Sequence[tuple[Path, Result]], directory: Path, drawings: Drawings
) -> tuple[list[Path], list[str]]:
    """Draw stored results into a directory; return the files, and the plots asked for that no data are there for.

    Raises
    ------
    CapabilityError : nothing can be drawn. OutputError : it cannot be written.
    """
    loaded = [result for _, result in results]
    asked = drawings.names is not None
    possible = applicable(loaded[0], asked) if len(loaded) == 1 else common_plots(loaded)
    missing = [name for name in drawings.names or () if name not in possible]
    if not drawings.among(possible):
        whose = (
            "the result has no data for them"
            if len(loaded) == 1
            else "the results have no data in common for them"
        )
        raise CapabilityError(f"no plots: {whose}; possible: {', '.join(possible) or 'none'}")
    with output_errors(directory):
        directory.mkdir(parents=True, exist_ok=True)
    if len(loaded) == 1:
        return draw_all(loaded[0], directory, drawings), missing
    return _over(results, directory, drawings.among(possible), drawings), missing


def _over(
    results: Sequence[tuple[Path, Result]], directory: Path, names: Sequence[str], drawings: Drawings
) -> list[Path]:
    paths, loaded = zip(*results)
    labelled = dict(zip(labels_of(paths, [result.title for result in loaded]), loaded))
    with styled(drawings.form):
        return [save(draw_over(labelled, name), directory / f"{name}.{drawings.suffix}") for name in names]


# plots that can be laid over one another, with the datasets that they show
OVERLAID: dict[str, tuple[str, ...]] = {
    "joint_angles": ("q",),
    "joint_rates": ("qd",),
    "joint_accelerations": ("qdd",),
    "torques": ("tau",),
    "tip_path": ("points/",),
    "transmission_angle": ("transmission_angle",),
    "tracking": ("control/error",),
    "energy": ("energy/kinetic", "energy/potential", "energy/total", "energy/work"),
    "multipliers": ("constraints/multipliers",),
    "reactions": ("reactions/", "loop_reactions/"),
}
MOST_PANELS = 8

Series = dict[tuple[str, str], tuple[Array, DrawnCurves]]  # name and units: times (T,), one curve


def labels_of(paths: Sequence[Path], titles: Sequence[str]) -> list[str]:
    """Return the title of each result; the end of its path where titles do not tell it apart."""
    if len(set(titles)) == 1:
        return path_ends(paths)
    return [
        title if titles.count(title) == 1 else f"{title} ({end})".strip()
        for title, end in zip(titles, path_ends(paths))
    ]


def common_plots(results: Sequence[Result]) -> list[str]:
    """Return the plots for which all results have data of the same name."""
    return [name for name in OVERLAID if shared([series_of(result, name) for result in results])]


def shared(all_series: Sequence[Series]) -> list[tuple[str, str]]:
    """Return names and units of the quantities of a plot that all results have."""
    common = [key for key in all_series[0] if all(key in series for series in all_series[1:])]
    # what is zero in all of them is left out where there is something else
    return [
        key for key in common if any(np.any(series[key][1].data != 0.0) for series in all_series)
    ] or common


def draw_over(results: Mapping[str, Result], name: str) -> Any:
    """Return the figure of a plot of several results, by their labels."""
    all_series = {label: series_of(result, name) for label, result in results.items()}
    keys = shared(list(all_series.values()))
    panels = sorted(_most_different(keys, list(all_series.values())), key=keys.index)
    titles = {result.title for result in results.values()}
    title = titles.pop() if len(titles) == 1 else "Results compared"
    shown = name.replace("_", " ")
    if name == "joint_angles":
        shown = f"{position_word(' or '.join({units for _, units in keys}))}s"
    if name == "tip_path":
        shown = "coordinates of the named points"
    if name == "tracking":
        shown = "errors of tracking (reference less motion)"
    subtitle = f"{shown[:1].upper()}{shown[1:]} of {len(results)} results"
    if len(panels) < len(keys):
        subtitle += f"; the {len(panels)} of {len(keys)} quantities that differ most"
    nothing = [text for series in all_series.values() for key in panels for text in series[key][1].nothing]
    first_lost = min(results.values(), key=lambda result: meaningful_until(result.summary))
    sheet = Sheet(
        Result("plot", title, "ok", ""), subtitle, panels=len(panels), across=1 if len(panels) <= 3 else 2,
        height=panel_height(len(panels)), gap=0.5, titled=True, labels=list(results),
        captions=[*nothing_note(nothing), *_errors(results, name)], told=[*_failures(results), *lost_note(first_lost)],
    )  # fmt: skip
    looks = style.line_styles(len(results))
    handles: list[Any] = []
    for panel, (ax, key) in enumerate(zip(sheet.axes, panels)):
        drawn = [series[key] for series in all_series.values()]
        handles = [
            ax.plot(*envelope(*one.lines(time)[0]), **look)[0] for (time, one), look in zip(drawn, looks)
        ]
        draw_dots(ax, [one.dots(time)[0] for time, one in drawn], handles)
        fit_axis(ax, *(one for _, one in drawn))
        for (time, one), handle, result in zip(drawn, handles, results.values()):
            x, y = one.lines(time)[0]
            kept = x <= meaningful_until(result.summary)
            draw_error(ax, x[kept], y[kept], float(one.error[0]), handle.get_color())
        ends = [time[[0, -1]] for time, _ in drawn]
        low, high = float(np.min(ends)), float(np.max(ends))
        ax.set_xlim(low, high if high > low else low + 1.0)
        ax.set_title(f"{key[0]} [{unit(key[1]) or '1'}]", fontsize=style.FONT_SIZE, loc="left", pad=4)
        if panel + sheet.across >= len(panels):
            ax.set_xlabel("time [s]")
    hatch(sheet.axes, meaningful_until(first_lost.summary))
    sheet.legend(handles, list(results))
    return sheet.figure


def _failures(results: Mapping[str, Result]) -> list[str]:
    """Return the lines that say which results failed and why, a line each."""
    notes = {label: failure_note(result) for label, result in results.items()}
    failed = [f"{label}: {' '.join(note)}" for label, note in notes.items() if note]
    return failed[:NAMED] + ([f"and {len(failed) - NAMED} more failed"] if len(failed) > NAMED else [])


def _errors(results: Mapping[str, Result], name: str) -> list[str]:
    """Return what the first results state of the errors of a plot, a line each; bands show those that can be seen."""
    path = "energy" if name == "energy" else OVERLAID[name][0].rstrip("/")
    path = "q" if name == "tracking" else path  # an error of tracking is no surer than the motion
    more = [f"and {len(results) - NAMED} more"] if len(results) > NAMED else []
    return [f"{label}: {error_words(result, path)}" for label, result in list(results.items())[:NAMED]] + more


def series_of(result: Result, name: str) -> Series:
    """Return the quantities of a plot over time."""
    series: Series = {}
    if "time" not in result or not result.time.size:
        return series
    for path, variable in result.variables.items():
        if not any(
            path == start or (start.endswith("/") and path.startswith(start)) for start in OVERLAID[name]
        ):
            continue
        if variable.dims[:1] != ("time",) or variable.data.ndim > 2:
            continue
        shown, short = curves_of(result, path), path.rpartition("/")[2]
        prefix = (
            f"{short}."
            if "/" in path and variable.data.ndim == 2 and path != "constraints/multipliers"
            else ""
        )
        for k, (column, units) in enumerate(zip(shown.names, shown.units)):
            series[(f"{prefix}{column}", units)] = result.time, shown.part([k])
    return series


def _most_different(keys: list[tuple[str, str]], all_series: list[Series]) -> list[tuple[str, str]]:
    """Return the quantities that differ most, over their range, on the times of the first result."""
    if len(keys) <= MOST_PANELS:
        return keys

    def difference(key: tuple[str, str]) -> float:
        t, first = all_series[0][key][0], all_series[0][key][1].data[:, 0]
        worst = 0.0
        for series in all_series[1:]:
            times, one = series[key]
            inside = t <= times[-1]
            other = np.interp(t[inside], times, one.data[:, 0])
            worst = max(worst, float(np.nanmax(np.abs(first[inside] - other), initial=0.0)))
        spread = float(np.nanmax(first, initial=-np.inf) - np.nanmin(first, initial=np.inf))
        return worst / spread if spread > 0.0 else worst

    return sorted(keys, key=difference, reverse=True)[:MOST_PANELS]
