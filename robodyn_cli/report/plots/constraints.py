"""Loops over time: residuals, singular values, multipliers, and the reactions in joints and closures."""

from __future__ import annotations

from typing import Any

import numpy as np

from robodyn_cli.report import style
from robodyn_cli.report.canvas import growth_times, loop_columns, sharing_note
from robodyn_cli.report.cells import figure
from robodyn_cli.report.curves import NOTHING, DrawnCurves, curves, zero_note
from robodyn_cli.report.lines import finite, largest, where_largest
from robodyn_cli.report.numbers import error_number, labelled, number, times, typeset, unit
from robodyn_cli.report.plots.columns import draw_map
from robodyn_cli.report.registry import plot
from robodyn_cli.report.style import positive_floor
from robodyn_cli.report.time_sheet import TimeSheet, panel_height
from robodyn_cli.results import result as wrenches
from robodyn_cli.results.moments import lock, lock_time
from robodyn_cli.results.result import Result, Variable, by_unit, column_names
from robodyn_cli.spatial.algebra import Array

ROUNDING = 100.0 * float(np.finfo(float).eps)  # of the size of a mechanism: what its closing leaves
KINDS = {"position_residual": "position", "velocity_residual": "velocity"}


@plot(lambda result: any(_has(result, kind) for kind in KINDS))
def constraint_residual(result: Result) -> Any:
    """How well the loops stay closed: position and velocity residuals on a logarithmic axis; a panel for
    positions and one for velocities, which have different units."""
    kinds = {kind: word for kind, word in KINDS.items() if _has(result, kind)}
    panels = [_residual(result, kind, word) for kind, word in kinds.items()]
    sheet = TimeSheet(
        result,
        f"Residuals of the loop closures, the largest of all closures; {_worst(result, kinds)}"
        + zero_note(*(shown.data for shown in panels)),
        nothing=[text for shown in panels for text in shown.nothing],
        panels=len(kinds),
        height=panel_height(len(kinds)),
    )
    for ax, shown in zip(sheet.axes, panels):
        low, high = positive_floor(shown.data)
        sheet.draw_log(ax, shown, (max(low, high * 1e-6), high))
        ax.set_ylabel(labelled(shown.names[0], shown.units[0]))
    sheet.finish([], [])
    return sheet.figure


def _residual(result: Result, kind: str, word: str) -> DrawnCurves:
    """Return the largest residual (T, 1) of all closures, zero where it is what rounding leaves of coordinates of the
    mechanism's size and, of velocities, of its speed."""
    data = np.max(np.abs(finite(result[f"constraints/{kind}"])), axis=1, keepdims=True)
    places = [largest(np.abs(finite(item.data))) for item in result.group("points").values()]
    rounding = ROUNDING * (max(places, default=0.0) or 1.0)
    if kind == "velocity_residual":
        rounding *= largest(np.abs(finite(result["qd"]))) if "qd" in result else 1.0
    seen = np.where(data <= rounding, 0.0, data)
    units = result.variables[f"constraints/{kind}"].units
    return curves(seen if np.any(seen) else data, [word], [units], rounding)


def _has(result: Result, kind: str) -> bool:
    path = f"constraints/{kind}"
    return path in result and result[path].size > 0


def _worst(result: Result, kinds: dict[str, str]) -> str:
    """Return the largest residuals in words."""
    texts = []
    for kind, word in kinds.items():
        variable = result.variables[f"constraints/{kind}"]
        texts.append(f"{word} {error_number(largest(np.abs(finite(variable.data))))} {unit(variable.units)}")
    return ", ".join(texts)


BLOCKS = {"psi": ("Ψ", style.COLOURS[0], "-"), "passive": ("passive block", style.ALARM, style.DASHES[1])}
# Between the largest and the smallest of many singular values there is little to see.
MOST_VALUES = 6


@plot(
    lambda result: any(
        f"singularity/{kind}" in result and result[f"singularity/{kind}"].size for kind in BLOCKS
    )
)
def singular_values(result: Result) -> Any:
    """Singular values of the constraint Jacobian and of its passive block: dead points and bifurcations."""
    columns: list[Any] = []
    styles: list[dict[str, Any]] = []
    labels: list[str] = []
    smallest = []
    for kind, (word, colour, dash) in BLOCKS.items():
        path = f"singularity/{kind}"
        if path not in result or not result[path].size:
            continue
        data = nothing_is_zero(np.sort(finite(result[path]), axis=1))[:, :MOST_VALUES]
        columns += [data[:, column] for column in range(data.shape[1])]
        # The smallest one decides; the others fade.
        styles += [
            {"color": colour, "linestyle": dash, "linewidth": 1.8 if column == 0 else 0.9}
            for column in range(data.shape[1])
        ]
        labels.append(f"{word}: smallest sample {number(-largest(-data))}")
        smallest.append(len(columns) - data.shape[1])
    values = nothing_is_zero(np.column_stack(columns))
    sheet = TimeSheet(
        result,
        f"Singular values of the constraint Jacobian; the smallest of each drawn heavier{zero_note(values)}",
        "singularity",
        labels=labels,
    )
    low, high = positive_floor(values)
    # Where one vanishes, how deep a sample happens to fall says nothing.
    low = max(low, high * 1e-6)
    handles = sheet.draw_log(
        sheet.ax, curves(values, [""] * len(columns), ["1"] * len(columns)), (low, high), styles
    )
    sheet.ax.set_ylabel("singular value [1]")
    sheet.finish([handles[index] for index in smallest], labels)
    return sheet.figure


def nothing_is_zero(values: Array) -> Array:
    """Return magnitudes (T, n) with zero for what is nothing but rounding beside the largest of them."""
    return np.where(values <= NOTHING * np.nanmax(values, initial=0.0), 0.0, values)


@plot(lambda result: "constraints/multipliers" in result and result["constraints/multipliers"].size > 0)
def multipliers(result: Result) -> Any:
    """Lagrange multipliers of the loops: their norm and each of them, and where they grow beyond bounds; the
    whole run, and below it the time in which the multipliers grow; a panel a unit."""
    variable = result.variables["constraints/multipliers"]
    names, groups = column_names(variable), by_unit(variable)
    data = np.abs(finite(variable.data))
    for columns in groups.values():
        data[:, columns] = nothing_is_zero(data[:, columns])
    loops = loop_columns(result, tuple(names))
    norms = {units: _norm(data, columns, loops) for units, columns in groups.items()}
    shown = data.shape[1] if data.shape[1] < style.FEW else 0
    labels = ["norm", *(f"|{name}|" for name in names[:shown])]
    growth = [one for one in growth_times(result) if result.time[0] <= one[1] <= result.time[-1]]
    if growth:
        labels.append("multiple of the running median")
    close = _window(result, growth)
    windows = [slice(None)] if close is None else [slice(None), close]
    panels = [(units, window) for window in windows for units in groups]
    height = {1: 3.3, 2: 2.4}.get(len(panels), 1.8)
    subtitle = _subtitle(result, norms) + zero_note(*norms.values())
    sheet = TimeSheet(
        result,
        subtitle,
        "constraints/multipliers",
        panels=len(panels),
        height=height,
        gap=0.55,
        labels=labels,
    )
    looks = _styles(shown)
    handles: dict[int, Any] = {}
    for ax, (units, window) in zip(sheet.axes, panels):
        columns = [column for column in groups[units] if column < shown]
        both = np.column_stack([data[:, columns], norms[units]])
        drawn = curves(both, [*(names[k] for k in columns), "norm"], [units] * (len(columns) + 1))
        styles = [looks[k] for k in [*columns, -1]]
        handles.update(zip([*columns, shown], sheet.draw_log(ax, drawn, _ends(drawn), styles, window)))
        ax.set_ylabel(labelled("multiplier", units))
    shown_norms = {ax: norms[units] for ax, (units, _) in zip(sheet.axes, panels)}
    marks = _mark_growth(shown_norms, len(groups), result.time, growth)
    sheet.finish([handles[shown], *(handles[k] for k in range(shown)), *marks], labels)
    return sheet.figure


def _norm(data: Array, columns: list[int], loops: list[int]) -> Array:
    """Return the norm (T,) of the columns of one unit that belong to loops, or of all of them where none does."""
    chosen = [column for column in columns if column in loops] or columns
    norm: Array = np.sqrt(np.sum(data[:, chosen] ** 2, axis=1))
    return norm


def _subtitle(result: Result, norms: dict[str, Array]) -> str:
    """Return the caption with the largest norm that the summary states, else with that of the samples."""
    stated = lock(result).get("multipliers") or {}
    if len(norms) == 1 and stated.get("largest_until_lock") is not None:
        error = (stated.get("errors") or {}).get("largest_until_lock")
        told = f"until the lock {_figure(stated['largest_until_lock'], error, *norms)}"
    else:
        tops = {units: where_largest(norm) for units, norm in norms.items()}
        told = "of the samples " + ", ".join(
            f"{number(float(norms[units][top]), 6)} {unit(units)} at t = {times([float(result.time[top])], 6)[0]}"
            for units, top in tops.items()
        )
    return f"Lagrange multipliers; largest norm {told}{sharing_note(result)}"


def _figure(value: float, error: float | None, units: str) -> str:
    """Return a figure of the summary with its error, where that is known, and its unit."""
    return f"{typeset(figure(value, error))} {unit(units)}"


def _ends(drawn: DrawnCurves) -> tuple[float, float]:
    """Return the ends of the axis of columns and, last, their norm."""
    low, high = positive_floor(drawn.data[:, -1])
    # A component crosses zero while the norm does not; its dip may leave the picture.
    return max(low * 1e-2, positive_floor(drawn.data)[0]), high


def _styles(components: int) -> list[dict[str, Any]]:
    """Return the looks of the components, then that of the norm: heavy and black."""
    thin = [{**look, "linewidth": 1.1} for look in style.line_styles(components)]
    return [*thin, {"color": "#000000", "linestyle": "-", "linewidth": 1.8}]


def _window(result: Result, growth: list[tuple[float, float]]) -> slice | None:
    """Return the samples around the growth or the lock, if that is but a part of the run."""
    time, end = result.time, lock_time(result)
    marks = [at for _, at in growth] + ([end] if end is not None else [])
    if not marks or len(time) < 20:
        return None
    span = max(max(marks) - min(marks), 0.01 * float(time[-1] - time[0]))
    first = int(np.searchsorted(time, min(marks) - 0.5 * span))
    last = int(np.searchsorted(time, max(marks) + 0.25 * span, side="right"))
    few = last - first < 10
    return None if few or last - first > 0.5 * len(time) else slice(first, last)


def _mark_growth(
    norms: dict[Any, Array], groups: int, time: Array, growth: list[tuple[float, float]]
) -> list[Any]:
    """Mark on axes where the norm passed each factor; the factors are written in the last panel of each unit only."""
    handles: list[Any] = []
    look: dict[str, Any] = {"color": "white", "markeredgecolor": style.ALARM, "markeredgewidth": 1.4}
    look |= {"linestyle": "none", "clip_on": False}  # the last one is often at the edge
    for factor, at in growth:
        for place, (ax, norm) in enumerate(norms.items()):
            value = float(np.interp(at, time, norm))
            handles = ax.plot(at, value, marker="D", markersize=6, zorder=5, **look)
            if place >= len(norms) - groups:
                ax.annotate(
                    f"{factor:g}×",
                    (at, value),
                    xytext=(-6, 7),
                    textcoords="offset points",
                    ha="right",
                    color=style.ALARM,
                    bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.5},
                )
    return handles


SPREAD = 30.0  # largest over typical load from which on the scale is logarithmic


@plot(lambda result: bool(result.group("reactions")))
def reactions(result: Result) -> Any:
    """Forces and moments in joints and loop closures over time: their magnitudes.

    Forces above, moments below, or a map of the forces where there are very many. Moments that are nothing beside the
    forces have no panel.
    """
    loads = {**result.group("reactions"), **result.group("loop_reactions")}
    force = np.column_stack([magnitude(item, "f") for item in loads.values()])
    moment = np.column_stack([magnitude(item, "m") for item in loads.values()])
    names = list(loads)
    largest_force = _largest_force(result, force, names)
    subtitle = f"Reactions in joints and closures; largest force {largest_force}{sharing_note(result)}"
    forces = curves(force, names, ["N"] * len(names))
    if len(names) > style.MANY:
        return draw_map(result, forces, "force", subtitle, "reactions")
    # rounding makes moments of forces on arms of some metre
    moments = curves(moment, names, ["N m"] * len(names), beside={"N m": float(forces.size.max(initial=0.0))})
    panels = [(forces, labelled("force", "N")), (moments, labelled("moment", "N m"))]
    if not np.any(moments.data):
        del panels[1]
        subtitle += ", no moments"
    nothing = [text for part, _ in panels for text in part.nothing]
    zeros = zero_note(*(part.data for part, _ in panels if _is_spread(part)))
    sheet = TimeSheet(
        result, subtitle + zeros, "reactions", nothing, panels=len(panels), height=2.4, labels=names
    )
    handles: list[Any] = []
    for ax, (part, label) in zip(sheet.axes, panels):
        handles = _draw_loads(sheet, ax, part)
        ax.set_ylabel(label)
    sheet.finish(handles, names)
    return sheet.figure


def _largest_force(result: Result, force: Array, names: list[str]) -> str:
    """Return in words the largest of the forces that the summary states, else of the samples (T, n)."""
    whole = result.summary.get("reactions"), result.summary.get("after_lock")
    phases = [(one.get("largest") or {}) for one in whole if isinstance(one, dict)]
    loads = [(name, one) for phase in phases for name, one in phase.items() if name in names]
    if loads and {name for name, _ in loads} == set(names):
        name, one = max(loads, key=lambda load: load[1]["peak_force"])
        return f"{_figure(one['peak_force'], one['force_error'], 'N')} in {name}"
    at, worst = np.unravel_index(where_largest(force.ravel()), force.shape)
    value, time = number(float(force[at, worst]), 5), times([float(result.time[at])], 5)[0]
    return f"of the samples {value} N in {names[worst]} at t = {time}"


def _is_spread(part: DrawnCurves) -> bool:
    """Tell whether the largest load would press the others to the ground on a linear axis."""
    return bool(0.0 < SPREAD * _typical(part) < part.top.max(initial=0.0))


def _typical(part: DrawnCurves) -> float:
    return float(np.nanmedian(part.data.max(axis=1))) if part.data.size else 0.0


def _draw_loads(sheet: TimeSheet, ax: Any, part: DrawnCurves) -> list[Any]:
    """Draw magnitudes, logarithmically where they are spread; small ones run out of the picture."""
    if _is_spread(part):
        low = float(part.data[part.data > 1e-3 * _typical(part)].min())
        styles = sheet.looks.lines(part.names)
        return sheet.draw_log(ax, part, (low, float(part.top.max())), styles)
    handles = sheet.draw(ax, part, magnitudes=True)
    if np.any(part.data):
        ax.set_ylim(bottom=0.0)
    return handles


def magnitude(item: Variable, letter: str) -> Array:
    """Return the length (T,) of the force (``f``) or the moment (``m``) of a wrench."""
    return wrenches.magnitude(finite(item.data), item.names, letter)
