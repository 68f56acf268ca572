"""Torque over speed of each motor, with the envelopes that it has to stay inside."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from robodyn_cli.report import style
from robodyn_cli.report.canvas import Sheet
from robodyn_cli.report.ticks import number
from robodyn_cli.results.columns import column_names
from robodyn_cli.results.result import Result

MOST = 8  # motors that are drawn: those that use most of their envelope
LABELS = ("peak, driving", "peak, braking", "continuous", "inside", "outside", "decides")


def applies(result: Result) -> bool:
    """Tell whether the run has drives."""
    return "drives/torque" in result and result["drives/torque"].size > 0


def draw(result: Result) -> Any:
    """Return the figure."""
    names = column_names(result.variables["drives/torque"])
    shown = _shown(result, names)
    left = len(names) - len(shown)
    note = f"; the {MOST} of {len(names)} that use most of it" if left else ""
    sheet = Sheet(
        result,
        f"Torque over speed of each motor in its envelope{note}; both as magnitudes",
        panels=len(shown),
        across=1 if len(shown) == 1 else 2,
        height=2.6 if len(shown) < 3 else 2.0,
        gap=0.8,
        titled=True,
        labels=LABELS,
    )
    handles: list[Any] = []
    for ax, k in zip(sheet.axes, shown):
        handles = _panel(ax, result, names[k], k)
    sheet.legend(handles, LABELS)
    return sheet.figure


def _shown(result: Result, names: Any) -> list[int]:
    """Return the columns that are drawn, in their own order."""
    use = result["drives/use"].max(axis=0)
    return (
        sorted(np.argsort(-use, kind="stable")[:MOST].tolist()) if len(names) > MOST else [*range(len(names))]
    )


def _panel(ax: Any, result: Result, name: str, k: int) -> list[Any]:
    """Draw one motor; return what the legend shows."""
    speed, torque = (np.abs(result[f"drives/{x}"][:, k]) for x in ("speed", "torque"))
    inside = result["drives/use"][:, k] <= 1.0
    looks: tuple[Mapping[str, Any], ...] = (
        {"color": "#000000", "linestyle": "-", "linewidth": 1.6},
        {"color": "#000000", "linestyle": (0, (1.2, 1.2)), "linewidth": 1.2},
        {"color": style.COLOURS[0], "linestyle": (0, (5, 1.5)), "linewidth": 1.4},
    )
    handles = [
        ax.plot(*_curve(result, kind, name), **look)[0]
        for kind, look in zip(("driving", "braking", "continuous"), looks)
    ]
    dots = {"linestyle": "none", "marker": "."}
    handles += ax.plot(speed[inside], torque[inside], **dots, color="#8f8f8f", markersize=2.5)
    handles += ax.plot(
        speed[~inside], torque[~inside], linestyle="none", marker="x", color=style.ALARM, markersize=4
    )
    facts = result.summary.get("drives", {}).get(name, {})
    at = int(np.argmin(np.abs(result.time - facts["time"]))) if facts.get("time") is not None else None
    places = ([], []) if at is None else ([speed[at]], [torque[at]])
    handles += ax.plot(
        *places, linestyle="none", marker="o", markerfacecolor="none", color=style.ALARM, markersize=8
    )
    ends = [line.get_xdata() for line in handles], [line.get_ydata() for line in handles]
    right, top = (max(float(np.max(x)) for x in axis if len(x)) for axis in ends)
    ax.set_xlim(0.0, 1.06 * right)
    ax.set_ylim(0.0, 1.1 * top)
    ax.set_xlabel("speed of the motor [rad/s]")
    ax.set_ylabel("torque [N·m]")
    ax.set_title(_title(name, facts), fontsize=style.FONT_SIZE, loc="left", pad=4)
    return handles


def _curve(result: Result, kind: str, name: str) -> tuple[Any, Any]:
    path = f"envelopes/{kind}/{name}"
    return tuple(result[path].T) if path in result else ([], [])


def _title(name: str, facts: Mapping[str, Any]) -> str:
    """Return a joint with its motor, the verdict and what decides it."""
    if not facts:
        return name
    limit, percent = facts["decides"].replace("_", " "), number(100.0 * abs(facts["margin"]), 3)
    margin = f"limit '{limit}': {percent} % {'left' if facts['margin'] >= 0.0 else 'beyond'}"
    return f"{name}: {facts['motor']}, {'bears it' if facts['passes'] else 'too small'}\n{margin}"
