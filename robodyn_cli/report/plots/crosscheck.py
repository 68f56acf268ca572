"""How far another engine is off at its own settings, over time."""

from __future__ import annotations

from typing import Any

import numpy as np

from robodyn_cli.report.curves import DrawnCurves, curves, zero_note
from robodyn_cli.report.numbers import number
from robodyn_cli.report.registry import plot
from robodyn_cli.report.style import MANY, line_styles, positive_floor
from robodyn_cli.report.time_sheet import TimeSheet, panel_height
from robodyn_cli.results.result import Result, column_names, units_of

ROUNDING = 1e-15  # m or rad, that attitudes and places of links are off by in any engine


@plot(lambda result: "crosscheck/q" in result and len(result.time) > 1)
def own_settings(result: Result) -> Any:
    """Gaps of closures, errors of accelerations and of the energy, on logarithmic axes."""
    gaps, errors = _gaps(result), _errors(result)
    every, summary = {**gaps, **errors}, result.summary
    panels = {label: shown for label, shown in every.items() if shown.top.any()} or every
    labels = [name for label, shown in gaps.items() if label in panels for name in shown.names]
    ended = summary["termination"]["reason"]
    sheet = TimeSheet(
        result,
        f"{summary['engine']} {summary['version']} at its own settings, steps of {number(summary['step'])} s: {ended}"
        + zero_note(*(shown.data for shown in panels.values())),
        nothing=[text for shown in every.values() for text in shown.nothing],
        panels=len(panels),
        height=panel_height(len(panels)),
        labels=labels,
    )
    looks = line_styles(len(labels) + 1)
    handles: list[Any] = []
    for ax, (label, shown) in zip(sheet.axes, panels.items()):
        count = len(shown.names) if label in gaps else 0
        styles = looks[len(handles) : len(handles) + count] or looks[:1]
        drawn = sheet.draw_log(ax, shown, positive_floor(shown.data), styles)
        handles += drawn[:count]
        ax.set_ylabel(label)
    sheet.finish(handles, labels)
    return sheet.figure


def _gaps(result: Result) -> dict[str, DrawnCurves]:
    """Return distances, and angles, as far as there are some, each with the largest of the motion here."""
    if "crosscheck/gap" not in result:
        return {}
    variable, here = result.variables["crosscheck/gap"], result["crosscheck/gap_here"]
    panels = {}
    for of, unit, label, factor in (("m", "mm", "gap [mm]", 1e3), ("rad", "rad", "angle [rad]", 1.0)):
        columns = [k for k, one in enumerate(units_of(variable)) if one == of]
        if not columns:
            continue
        word = label.partition(" ")[0]
        names, data = [column_names(variable)[k] for k in columns], factor * variable.data[:, columns]
        if len(columns) > MANY:
            names, data = [f"largest {word}"], data.max(axis=1, keepdims=True)
        names.append(f"largest {word} here")
        own = np.full((len(data), 1), factor * here[:, columns].max())
        # each beside itself alone: what is small beside the others need not be rounding here
        together = np.column_stack([data, own])
        panels[label] = curves(together, names, [unit] * len(names), factor * ROUNDING, alone=True)
    return panels


def _errors(result: Result) -> dict[str, DrawnCurves]:
    """Return the errors of the accelerations and of the energy; what is no larger than their own errors is zero."""
    a, energy = result.summary["accelerations"], result.summary["energy"]
    panels = {}
    for name, own, size in (
        ("acceleration", a["error"], a["size"]), ("energy", energy["error"], energy["kinetic"]),
    ):  # fmt: skip
        if f"crosscheck/{name}_error" in result:
            data = result[f"crosscheck/{name}_error"][:, None]
            panels[f"error of {name} [1]"] = curves(data, [name], [""], own / size)
    return panels
