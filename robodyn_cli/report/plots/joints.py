"""Motion of joints and points over time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from robodyn_cli.report import style
from robodyn_cli.report.canvas import TimeSheet
from robodyn_cli.report.lines import draw_columns, envelope, finite, panel_height, time_plot
from robodyn_cli.report.registry import plot
from robodyn_cli.report.style import labelled, load_label, number
from robodyn_cli.results.result import Result, Variable, by_unit, column_names


@plot(lambda result: "q" in result and result["q"].shape[1] > 0)
def joint_angles(result: Result) -> Any:
    """Joint angles (or displacements) over time."""
    units = result.variables["q"].units
    quantity = {"rad": "joint angle", "m": "joint displacement"}.get(units, "joint position")
    return time_plot(result, "q", quantity, f"{quantity.capitalize()}s")


@plot(lambda result: "qd" in result and result["qd"].shape[1] > 0)
def joint_rates(result: Result) -> Any:
    """Joint velocities over time."""
    return time_plot(result, "qd", "joint rate", "Joint rates")


@plot(lambda result: "qdd" in result and result["qdd"].shape[1] > 0)
def joint_accelerations(result: Result) -> Any:
    """Joint accelerations over time."""
    return time_plot(result, "qdd", "joint acceleration", "Joint accelerations")


@plot(lambda result: bool(result.group("point_velocities")) and bool(result.group("point_accelerations")))
def point_motion(result: Result) -> Any:
    """Speed and acceleration of the named points over time; speeds above, magnitudes of the accelerations below."""
    names = list(result.group("point_velocities"))[: style.FEW]
    sheet = TimeSheet(
        result, "Speed and acceleration of the named points", panels=2, height=2.4, labels=names
    )
    handles: list[Any] = []
    for ax, group, label in zip(
        sheet.axes,
        ("point_velocities", "point_accelerations"),
        (labelled("speed", "m/s"), labelled("acceleration", "m/s^2")),
    ):
        length = [np.linalg.norm(finite(result[f"{group}/{name}"]), axis=1) for name in names]
        handles = draw_columns(ax, result.time, np.column_stack(length))
        ax.set_ylabel(label)
        ax.set_ylim(bottom=0.0)
    sheet.label_time()
    sheet.legend(handles, names)
    return sheet.figure


GOOD = (40.0, 140.0)  # degrees, the usual bounds


@plot(lambda result: "transmission_angle" in result)
def transmission_angle(result: Result) -> Any:
    """The transmission angle over time, with the band in which a mechanism transmits well."""
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


MOST_COORDINATES = 6  # coordinates that are drawn: those with the largest error
BAND = {"linewidth": 4.5, "alpha": 0.3, "solid_capstyle": "butt"}  # the reference, which motion lies on
Looks = Mapping[str, Mapping[str, Any]]


@plot(lambda result: "control/error" in result and bool(result["control/error"].size))
def tracking(result: Result) -> Any:
    """How a controller follows its reference: motion against it, the error, and torques with their limits; a
    panel for the motion and one for the error of each unit, then one of the torques."""
    error, torque = result.variables["control/error"], result.variables["control/torque"]
    names, groups = column_names(error), _shown(error)
    labels = [f"{names[k]}: error up to {_size(result, names[k], units)}" for units, ks in groups for k in ks]
    loads = list(by_unit(torque).items())
    panels = 2 * len(groups) + len(loads)
    note = "; those with the largest errors" if len(labels) < len(names) else ""
    sheet = TimeSheet(
        result,
        f"Motion and reference (broad, pale), error, torque and its limits (thin){note}",
        panels=panels,
        height=panel_height(panels),
        labels=labels,
    )
    looks = {name: style.dashed_style(i) for i, name in enumerate(_order(names, groups))}
    axes, handles = list(sheet.axes), []
    for units, columns in groups:
        shown = [{**looks[names[k]], "linewidth": 1.5} for k in columns]
        handles += _motion(axes.pop(0), result, columns, shown, units)
        ax = axes.pop(0)
        draw_columns(ax, result.time, finite(error.data[:, columns]), shown)
        ax.axhline(0.0, color=style.GREY, linewidth=0.6)
        ax.set_ylabel(f"error [{units}]")
    for units, columns in loads:
        _torques(axes.pop(0), result, columns, looks, units)
    sheet.label_time()
    sheet.legend(handles, labels)
    return sheet.figure


def _shown(variable: Variable) -> list[tuple[str, list[int]]]:
    """Return the columns that are drawn, by unit."""
    largest = np.abs(finite(variable.data)).max(axis=0, initial=0.0)
    chosen = set(np.argsort(-largest, kind="stable")[:MOST_COORDINATES].tolist())
    found = ((units, [k for k in columns if k in chosen]) for units, columns in by_unit(variable).items())
    return [(units, columns) for units, columns in found if columns]


def _order(names: list[str], groups: list[tuple[str, list[int]]]) -> list[str]:
    drawn = [names[k] for _, columns in groups for k in columns]
    return [*drawn, *(name for name in names if name not in drawn)]


def _size(result: Result, name: str, units: str) -> str:
    data = result["control/error"][:, column_names(result.variables["control/error"]).index(name)]
    return f"{number(float(np.nanmax(np.abs(data))), 3)} {units}"


def _motion(
    ax: Any, result: Result, columns: list[int], looks: list[dict[str, Any]], units: str
) -> list[Any]:
    """Draw motion and reference; return the handles of the motion."""
    wanted = finite(result["control/reference"][:, columns])
    actual = wanted - finite(result["control/error"][:, columns])
    for k, look in enumerate(looks):
        ax.plot(*envelope(result.time, wanted[:, k]), color=look["color"], **BAND)
    ax.set_ylabel(f"position [{units}]")
    return draw_columns(ax, result.time, actual, looks)


def _torques(ax: Any, result: Result, columns: list[int], looks: Looks, units: str) -> None:
    """Draw torques with the limits of joints that have some."""
    variable = result.variables["control/torque"]
    names, data = column_names(variable), finite(variable.data)
    control = result.summary.get("control") or {}
    limits = control.get("limits", {})
    drawn = "steps-post" if "period" in control else "default"  # held between samples
    for k in columns:
        look = looks.get(names[k]) or style.dashed_style(k)
        ax.plot(*envelope(result.time, data[:, k]), **look, linewidth=1.2, drawstyle=drawn)
        if names[k] in limits:
            for side in (-1.0, 1.0):
                ax.axhline(side * limits[names[k]], **look, linewidth=0.7)
    ax.set_ylabel(load_label("torque", units))
