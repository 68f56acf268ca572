"""Torques over time, their terms, and the limits that they use."""

from __future__ import annotations

from typing import Any

import numpy as np

from robodyn_cli.report import style
from robodyn_cli.report.canvas import torque_note
from robodyn_cli.report.curves import DrawnCurves, curves, curves_of
from robodyn_cli.report.lines import LIMIT_NOTE, draw_limits, finite, limits_near, where_largest
from robodyn_cli.report.numbers import load_label, number, unit
from robodyn_cli.report.plots.columns import draw_map
from robodyn_cli.report.registry import plot
from robodyn_cli.report.style import COLOURS, DASHES, FONT_SIZE
from robodyn_cli.report.time_sheet import TimeSheet, draw_groups, panel_height, unseen_note
from robodyn_cli.results.result import Result, column_names, units_of
from robodyn_cli.results.stated_errors import meaningful_error
from robodyn_cli.solve.extremes import root_mean_square
from robodyn_cli.spatial.algebra import Array

RATIO = 8.0  # of the peaks of two torques from which on each has a panel of its own


def _has_torques(result: Result) -> bool:
    """Tell whether there are torques: those that were given, and not computed, are not drawn where all are zero."""
    if "tau" not in result or not result["tau"].size:
        return False
    return bool(result.group("torque_terms")) or bool(np.any(result["tau"] != 0.0))


@plot(_has_torques)
def torques(result: Result) -> Any:
    """Actuator torques over time, with the peak and the root mean square of each; joints without any torque are
    left out where others have some."""
    whole = curves_of(result, "tau", _largest_terms(result))
    shown = whole.part(_working(whole))
    data, names = shown.data, list(shown.names)
    units = [unit(u) for u in shown.units]
    at_samples = _root_mean_squares(shown, result.time)
    rms = np.array([_stated(result, name, "rms_torque", x) for name, x in zip(names, at_samples)])
    peak = [where_largest(np.abs(data[:, column])) for column in range(data.shape[1])]
    few = len(names) <= style.FEW
    lined: set[int] = set()  # no root mean square is drawn where no torque comes so high
    panels = _panels(shown) if few else list(shown.groups().items())
    zero = len(whole.names) - len(names)
    near = limits_near(result, "tau")
    note = _idle_note(zero) + (LIMIT_NOTE if near else "") + torque_note(result)
    labels, subtitle = names, _worst(result, names, data, rms, units) + note
    if len(names) > style.MANY:
        return draw_map(result, shown, "torque or force", subtitle, "tau")
    if few:
        lined = {k for _, columns in panels for k in columns if 0.0 < rms[k] <= np.nanmax(data[:, columns])}
        beside = ", thin line: root mean square" if lined else ""
        subtitle = f"Actuator torques; dot: peak{beside}{_of_samples(result, names)}{note}"
        stated = [
            _stated(result, name, "peak_torque", data[at, k]) for k, (name, at) in enumerate(zip(names, peak))
        ]
        labels = [
            f"{name}: peak {number(stated[k], 4)}, RMS {number(float(rms[k]), 4)} {units[k]}"
            for k, name in enumerate(names)
        ]
    height = panel_height(len(panels))
    sheet = TimeSheet(
        result, subtitle, "tau", whole.nothing, panels=len(panels), height=height, labels=labels,
        told=unseen_note(result, "tau"),
    )  # fmt: skip
    handles = draw_groups(sheet, shown, [columns for _, columns in panels])
    for ax, (units_here, columns) in zip(sheet.axes, panels):
        for column in [k for k in columns if few and shown.top[k] > 0.0]:
            colour, dash = handles[column].get_color(), handles[column].get_linestyle()
            largest = data[peak[column], column]
            ax.plot(
                result.time[peak[column]], largest, "o", color=colour, markersize=5, clip_on=False, zorder=3
            )
            if column in lined:
                ax.axhline(float(rms[column]), color=colour, linewidth=0.8, linestyle=dash, alpha=0.7)
        draw_limits(ax, near, [names[k] for k in columns], [handles[k] for k in columns])
        ax.set_ylabel(load_label("torque or force", units_here))
    sheet.finish(handles, labels)
    return sheet.figure


def _root_mean_squares(shown: DrawnCurves, time: Array) -> Array:
    """Return the root mean square of each column (n,), of one that is held that of its steps."""
    rms = root_mean_square(time, shown.data)[0]
    for k, (x, y) in enumerate(shown.lines(time)):
        if shown.held is not None and shown.held.is_held(k) and x[-1] > x[0]:
            squares = (y[:-1] ** 2 + y[:-1] * y[1:] + y[1:] ** 2) / 3.0
            rms[k] = np.sqrt(np.sum(np.diff(x) * squares) / (x[-1] - x[0]))
    return np.asarray(rms)


def _stated(result: Result, name: str, key: str, at_samples: float) -> float:
    """Return a figure of a joint that the summary states, which knows what lies between samples; else that of these."""
    stated = result.summary.get("joints", {}).get(name, {}).get(key, at_samples)
    return float(np.copysign(stated, at_samples))


def _of_samples(result: Result, names: list[str]) -> str:
    """Return the part of a subtitle that says that the summary states no peaks; empty where it does."""
    stated = result.summary.get("joints", {})
    return (
        ""
        if len(result.time) == 1 or all("peak_torque" in stated.get(name, {}) for name in names)
        else "; figures of the samples"
    )


def _largest_terms(result: Result) -> dict[str, float]:
    """Return the largest term of any torque by its unit: what rounding leaves where terms cancel is small beside it."""
    found: dict[str, float] = {}
    for item in result.group("torque_terms").values():
        for units, top in zip(units_of(item), np.nanmax(np.abs(finite(item.data)), axis=0, initial=0.0)):
            found[units] = max(found.get(units, 0.0), float(top))
    return found


def _panels(shown: DrawnCurves) -> list[tuple[str, list[int]]]:
    """Return unit and columns of each panel: beside a torque that is much larger a small one would be a line."""
    panels: list[tuple[str, list[int]]] = []
    for units, columns in shown.groups().items():
        largest = np.inf
        for column in sorted(columns, key=lambda k: -shown.top[k]):
            if 0.0 < shown.top[column] * RATIO < largest:
                largest = shown.top[column]
                panels.append((units, []))
            elif not panels or panels[-1][0] != units:
                panels.append((units, []))
            panels[-1][1].append(column)
    return [(units, sorted(columns)) for units, columns in panels]


def _idle_note(count: int) -> str:
    """Return the part of a subtitle about joints that are not drawn since they have no torque; empty where none is."""
    return f"; not drawn: {count} joint{'s' if count > 1 else ''} without torque" if count else ""


def _working(shown: DrawnCurves) -> list[int]:
    """Return the columns of joints with a torque, all of them where none has any."""
    return np.flatnonzero(shown.data.any(axis=0)).tolist() or list(range(len(shown.names)))


def _worst(result: Result, names: list[str], data: Any, rms: Any, units: list[str]) -> str:
    largest = where_largest(rms)
    at_samples = data[where_largest(np.abs(data[:, largest])), largest]
    peak = _stated(result, names[largest], "peak_torque", at_samples)
    return (
        f"Actuator torques; largest RMS: {names[largest]} with {number(float(rms[largest]), 4)} {units[largest]},"
        f" peak {number(peak, 4)} {units[largest]}{_of_samples(result, names)}"
    )


# The order of the contract, so that a term has the same colour in every drawing.
ORDER = ("inertia", "coriolis", "gravity", "friction", "passive", "external", "stops", "gear")
MOST_JOINTS = 8


@plot(lambda result: bool(result.group("torque_terms")) and "tau" in result and result["tau"].size > 0)
def torque_terms(result: Result) -> Any:
    """What the torque of each joint is made of: one panel a joint, one line a term."""
    terms = result.group("torque_terms")
    order = [name for name in ORDER if name in terms] + [name for name in terms if name not in ORDER]
    total = result.variables["tau"]
    names = column_names(total)
    units = units_of(total)
    whole = curves_of(result, "tau", _largest_terms(result))
    peak, error = whole.top, meaningful_error(result, "tau")
    joints = _largest(peak)
    subtitle = "Terms of the actuator torque, which sum to the total"
    left_out = int(np.count_nonzero(peak)) - len(joints)
    if left_out > 0:
        subtitle += f"; the {len(joints)} of {len(names)} joints with the largest torque"
    elif len(joints) < len(names):
        subtitle += _idle_note(len(names) - len(joints))
    labels = [*order, "total"]
    parts = []
    for joint in joints:
        columns = [terms[name].data[:, joint] for name in order] + [total.data[:, joint]]
        labels_here = [f"{names[joint]}: {name}" for name in labels]
        own, beside = [units[joint]] * len(labels), {units[joint]: float(whole.size[joint])}
        parts.append(curves(np.column_stack(columns), labels_here, own, error, beside))
    nothing = [text for part in parts for text in part.nothing]
    count = len(joints)
    height = {1: 3.3, 2: 2.0}.get(count, 1.6)
    across = 1 if count <= 3 else 2
    sheet = TimeSheet(
        result, subtitle, "torque_terms", nothing, panels=count, across=across, height=height, gap=0.36,
        titled=True, labels=labels,
    )  # fmt: skip
    styles = [_look(name) for name in order]
    styles.append({"color": "#000000", "linestyle": "-", "linewidth": 1.8})
    handles: list[Any] = []
    for ax, joint, part in zip(sheet.axes, joints, parts):
        handles = sheet.draw(ax, part, styles)
        ax.set_title(names[joint], fontsize=FONT_SIZE, loc="left", pad=4)
        ax.set_ylabel(load_label("torque or force", units[joint]))
    sheet.finish(handles, labels)
    return sheet.figure


def _look(name: str) -> dict[str, Any]:
    index = ORDER.index(name) if name in ORDER else len(ORDER)
    # a solid line is the total's, so there is one term more than dashes
    dash = (0, (2, 2, 6, 2)) if index >= 7 else DASHES[index + 1]
    return {"color": COLOURS[index % len(COLOURS)], "linestyle": dash, "linewidth": 1.4}


def _largest(peak: Any) -> list[int]:
    """Return the joints with the largest torques, in their own order; none that are zero beside others."""
    order = np.argsort(-peak, kind="stable")[:MOST_JOINTS].tolist()
    return sorted([k for k in order if peak[k] > 0.0] or order)


MOST_LIMITS = 8  # limits that are drawn with a name of their own: those that bind longest


@plot(lambda result: "limits/use" in result and bool(result["limits/use"].size))
def limits(result: Result) -> Any:
    """How much of each limit a motion in the least time uses: one of them binds at every time."""
    variable = result.variables["limits/use"]
    data, names = finite(variable.data), column_names(variable)
    part = np.array([np.mean(result["limits/binding"] == k) for k in range(len(names))])
    binding = int(np.count_nonzero(part)) or len(part)
    order = np.argsort(-part, kind="stable")[: min(MOST_LIMITS, binding)]
    styles = style.line_styles(len(order))
    labels = [f"{names[k]}: binds {number(100.0 * part[k], 3)} % of the time" for k in order]
    left = len(names) - len(order)
    note = f"; {left} that bind less, or never, left out" if left else ""
    text = f"Use of the limits on the path in the least time, 1: on the limit{note}"
    sheet = TimeSheet(result, text, "limits", labels=labels)
    handles = sheet.draw(sheet.ax, curves(data[:, order], labels, ["1"] * len(labels)), styles)
    sheet.ax.axhline(1.0, color=style.ALARM, linewidth=0.8, linestyle=style.DASHES[1])
    sheet.ax.set_ylim(0.0, 1.08)
    sheet.ax.set_ylabel("use of the limit [1]")
    sheet.finish(handles, labels)
    return sheet.figure
