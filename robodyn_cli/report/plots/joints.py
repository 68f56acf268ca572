"""Motion of joints and points over time."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from robodyn_cli.report import style
from robodyn_cli.report.cells import figure
from robodyn_cli.report.curves import DrawnCurves, curves, curves_of, fit_axis
from robodyn_cli.report.drawing.places import moving_paths
from robodyn_cli.report.lines import envelope, finite
from robodyn_cli.report.looks import POINTS
from robodyn_cli.report.numbers import error_number, labelled, load_label, number, position_word, typeset
from robodyn_cli.report.plots.columns import time_plot
from robodyn_cli.report.registry import plot
from robodyn_cli.report.time_sheet import TimeSheet, panel_height, unseen_note
from robodyn_cli.results.result import Result
from robodyn_cli.results.sampling import too_far_apart
from robodyn_cli.results.stated_errors import meaningful_error
from robodyn_cli.spatial.algebra import Array


@plot(lambda result: "q" in result and result["q"].shape[1] > 0)
def joint_angles(result: Result) -> Any:
    """Joint angles (or displacements) over time."""
    quantity = position_word(result.variables["q"].units)
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
    names = list(result.group("point_velocities"))
    panels = []
    for group, word, units in (
        ("point_velocities", "speed", "m/s"), ("point_accelerations", "acceleration", "m/s^2")
    ):  # fmt: skip
        length = np.column_stack(
            [np.linalg.norm(finite(result[f"{group}/{name}"]), axis=1) for name in names]
        )
        panels.append(
            (curves(length, names, [units] * len(names)).part(range(len(names[: style.FEW]))), word, units)
        )
    labels = names[: style.FEW]
    nothing = [text for shown, _, _ in panels for text in shown.nothing]
    sheet = TimeSheet(
        result, "Speed and acceleration of the named points", "point_velocities", nothing, panels=2, height=2.4,
        labels=labels,
    )  # fmt: skip
    handles: list[Any] = []
    for ax, (shown, word, units) in zip(sheet.axes, panels):
        handles = sheet.draw(ax, shown, sheet.looks.lines(labels, POINTS), magnitudes=True)
        ax.set_ylabel(labelled(word, units))
        if np.any(shown.data):
            ax.set_ylim(bottom=0.0)
    sheet.finish(handles, labels)
    return sheet.figure


@plot(lambda result: "time" in result and bool(moving_paths(result)))
def point_coordinates(result: Result) -> Any:
    """Coordinates of the named points that move over time, a panel for each axis of the world along which one moves."""
    paths = moving_paths(result)
    names = list(paths)[: style.FEW]
    beside = {"m": max(float(np.nanmax(np.abs(path), initial=0.0)) for path in paths.values())}
    apart = np.stack(
        np.broadcast_arrays(*(too_far_apart(result, f"points/{name}") for name in paths)), axis=1
    )
    panels = {
        axis: dataclasses.replace(
            curves(
                np.column_stack([path[:, k] for path in paths.values()]),
                list(paths),
                ["m"] * len(paths),
                beside=beside,
            ),
            apart=apart[:, :, k % apart.shape[2]],
        )
        for k, axis in enumerate("xyz")
    }
    shown = {
        axis: one.part(range(len(names)))
        for axis, one in panels.items()
        if (np.ptp(one.data, axis=0) > one.least).any()
    }
    nothing = [text for one in shown.values() for text in one.nothing]
    some = f" ({len(names)} of {len(paths)})" if len(names) < len(paths) else ""
    sheet = TimeSheet(
        result, f"Coordinates of the named points in the world{some}", "points", nothing, panels=len(shown),
        height=panel_height(len(shown)), labels=names,
    )  # fmt: skip
    handles: list[Any] = []
    for ax, (axis, one) in zip(sheet.axes, shown.items()):
        handles = sheet.draw(ax, one, sheet.looks.lines(names, POINTS))
        ax.set_ylabel(f"{axis} [m]")
    sheet.finish(handles, names)
    return sheet.figure


GOOD = (40.0, 140.0)  # degrees, the usual bounds


@plot(lambda result: "transmission_angle" in result)
def transmission_angle(result: Result) -> Any:
    """The transmission angle over time, with the band in which a mechanism transmits well."""
    angle = np.degrees(finite(result["transmission_angle"]))
    stated = result.summary.get("transmission_angle")
    if stated:
        ends = [figure(stated[end], stated["errors"][end]) for end in ("smallest_deg", "largest_deg")]
    else:
        ends = [number(float(end), 4) for end in (np.nanmin(angle), np.nanmax(angle))]
    labels = ["transmission angle", "40 to 140 deg, where it is good"]
    text = (
        f"Transmission angle{'' if stated else ' of the samples'}: from {' to '.join(map(typeset, ends))} deg"
    )
    sheet = TimeSheet(result, text, "transmission_angle", labels=labels)
    handles = sheet.draw(sheet.ax, curves(angle[:, None], labels[:1], ["deg"]))
    band = sheet.ax.axhspan(*GOOD, color=style.GREY, alpha=0.12, zorder=0, linewidth=0)
    sheet.ax.set_ylim(0.0, 180.0)
    sheet.ax.set_yticks(range(0, 181, 20))
    sheet.ax.set_ylabel("transmission angle [deg]")
    sheet.finish([*handles, band], labels)
    return sheet.figure


MOST_COORDINATES = 6  # coordinates that are drawn: those with the largest error
BAND: dict[str, Any] = {
    "linewidth": 4.5,
    "alpha": 0.3,
    "solid_capstyle": "butt",
}  # the reference, which motion lies on
Looks = Mapping[str, Mapping[str, Any]]


@plot(lambda result: "control/error" in result and bool(result["control/error"].size))
def tracking(result: Result) -> Any:
    """How a controller follows its reference: motion against it, the error, and torques with their limits; a
    panel for the motion and one for the error of each unit, then one of the torques."""
    motion, error = _followed(result)
    torque = curves_of(result, "control/torque")
    names, groups = list(error.names), _shown(error)
    labels = [
        f"{names[k]}: error up to {_largest_error(result, names[k], error.top[k], units)}"
        for units, ks in groups
        for k in ks
    ]
    loads = torque.groups()
    panels = 2 * len(groups) + len(loads)
    note = "; those with the largest errors" if len(labels) < len(names) else ""
    seen = _seen(result)
    of_sensors = " (grey: by what the controller saw last)" if seen else ""
    sheet = TimeSheet(
        result,
        f"Motion and reference (broad, pale), error{of_sensors}, torque and its limits (thin){note}",
        "q",
        [*error.nothing, *torque.nothing],
        panels=panels,
        height=panel_height(panels),
        labels=labels,
        told=unseen_note(result, "control/torque"),
    )
    looks = dict(zip(names, sheet.looks.lines(names)))
    axes, handles = list(sheet.axes), []
    for units, columns in groups:
        styles = [{**looks[names[k]], "linewidth": 1.5} for k in columns]
        ax = axes.pop(0)
        for k in columns:
            wanted = finite(result["control/reference"][:, k])
            ax.plot(*envelope(result.time, wanted), color=looks[names[k]]["color"], **BAND)
        handles += sheet.draw(ax, motion.part(columns), styles)
        ax.set_ylabel(f"position [{units}]")
        ax = axes.pop(0)
        for k in columns:
            if names[k] in seen:
                x, measured = seen[names[k]]
                off = finite(np.interp(x, result.time, result["control/reference"][:, k]) - measured)
                ax.plot(*envelope(x, off), color=style.GREY, alpha=0.6, linewidth=0.6, zorder=1)
        sheet.draw(ax, error.part(columns), styles)
        ax.axhline(0.0, color=style.GREY, linewidth=0.6)
        ax.set_ylabel(f"error [{units}]")
    for units, columns in loads.items():
        own = {**dict(zip(torque.names, sheet.looks.lines(torque.names))), **looks}
        _torques(axes.pop(0), result, torque, columns, own, units)
    sheet.finish(handles, labels)
    return sheet.figure


def _largest_error(result: Result, name: str, at_samples: float, units: str) -> str:
    """Return the largest tracking error that the summary states of a coordinate, else that of the samples."""
    stated = ((result.summary.get("control") or {}).get("tracking") or {}).get(name)
    if stated is None:
        return f"{error_number(at_samples)} {units} at the samples"
    return f"{error_number(stated['peak'] + (stated['errors']['peak'] or 0.0))} {units}"


def _seen(result: Result) -> dict[str, tuple[Array, Array]]:
    """Return times and positions as the controller saw them last, by coordinate, where it has sensors."""
    if "control/measured" not in result:
        return {}
    measured = curves_of(result, "control/measured")
    return dict(zip(measured.names, measured.lines(result.time)))


def _followed(result: Result) -> tuple[DrawnCurves, DrawnCurves]:
    """Return the motion and its tracking error, whose own error is that of the motion."""
    off, wanted, own = (
        curves_of(result, "control/error"),
        curves_of(result, "control/reference"),
        meaningful_error(result, "q"),
    )
    largest = {units: float(wanted.top[columns].max()) for units, columns in wanted.groups().items()}
    motion = wanted.data - off.data
    return (
        curves(motion, off.names, off.units, own, largest),
        curves(result["control/error"], off.names, off.units, own, largest),
    )


def _shown(error: DrawnCurves) -> list[tuple[str, list[int]]]:
    """Return the columns that are drawn, by unit."""
    chosen = set(np.argsort(-error.top, kind="stable")[:MOST_COORDINATES].tolist())
    shown = ((units, [k for k in columns if k in chosen]) for units, columns in error.groups().items())
    return [(units, columns) for units, columns in shown if columns]


def _torques(
    ax: Any, result: Result, torque: DrawnCurves, columns: list[int], looks: Looks, units: str
) -> None:
    """Draw torques with the limits of joints that have some."""
    names, lines = torque.names, torque.lines(result.time)
    control = result.summary.get("control") or {}
    limits, least = control.get("limits", {}), control.get("least_limits", {})
    for k in columns:
        look = looks[names[k]]
        ax.plot(*envelope(*lines[k]), **{**look, "linewidth": 1.2})
        if names[k] in limits:
            for level in (least.get(names[k], -limits[names[k]]), limits[names[k]]):
                ax.axhline(level, **{**look, "linewidth": 0.7})
    fit_axis(ax, torque.part(columns))
    ax.set_ylabel(load_label("torque", units))
