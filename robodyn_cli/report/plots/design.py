"""Kinematic design: chains of four links in their dead points, centrodes, curvature, ratios, pressure angles; shaking
forces, a flywheel, fluctuation of speed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from robodyn_cli.report import style
from robodyn_cli.report.canvas import Sheet
from robodyn_cli.report.curves import curves, curves_of
from robodyn_cli.report.lines import finite, thin_path
from robodyn_cli.report.numbers import labelled, number
from robodyn_cli.report.registry import plot
from robodyn_cli.report.style import FEW, line_styles
from robodyn_cli.report.time_sheet import TimeSheet, draw_groups, panel_height
from robodyn_cli.results.result import Result, column_names
from robodyn_cli.spatial.algebra import Array

FAR = 4.0  # times the middle distance of poles from their middle: what is further is beyond the drawing
SIDE = 2.6  # of a panel in which lengths are true [inch]


def _name(path: str) -> str:
    return path.rpartition("/")[2]


def _in_plane(points: Array) -> tuple[Array, tuple[str, str]]:
    """Return points (..., 3) of one plane by the two axes of the world that are least across it, and these."""
    flat = points.reshape(-1, 3)
    flat = flat[np.isfinite(flat).all(axis=1)]
    spread = np.ptp(flat, axis=0) if len(flat) else np.zeros(3)
    kept = sorted(sorted(range(3), key=lambda k: (-spread[k] > 0.0, k == 2, -spread[k]))[:2])
    if spread[2] <= 1e-9 * max(float(spread.max()), 1e-300):
        kept = [0, 1]
    return points[..., kept], ("xyz"[kept[0]], "xyz"[kept[1]])


def _true_lengths(ax: Axes, axes: tuple[str, str]) -> None:
    _same_scale(ax)
    ax.set_xlabel(f"{axes[0]} [m]")
    ax.set_ylabel(f"{axes[1]} [m]")


def _same_scale(ax: Axes) -> None:
    """Let one side of an axis reach further, so that both have the same scale."""
    assert ax.figure is not None
    width, height = ax.get_position().size * ax.figure.get_size_inches()  # type: ignore[union-attr]
    (left, right), (low, high) = ax.get_xlim(), ax.get_ylim()
    scale = max((right - left) / width, (high - low) / height)
    x, y = 0.5 * (left + right), 0.5 * (low + high)
    ax.set_xlim(x - 0.5 * scale * width, x + 0.5 * scale * width)
    ax.set_ylim(y - 0.5 * scale * height, y + 0.5 * scale * height)


@plot(lambda result: bool(result.group("four_bars")))
def four_bars(result: Result) -> Any:
    """Chains of four links now, in full, and in the dead points of joints on their fixed link; a panel a chain."""
    chains = list(result.group("four_bars").items())[:FEW]
    across = min(len(chains), 2)
    labels = ["first pose", "dead points of joints on the fixed link"]
    told = result.summary["design"]["four_bars"]
    captions = [f"{name}: {told[name]['type']} on {told[name]['ground']}, margin {number(told[name]['margin'], 4)} m"
                for name, _ in chains]  # fmt: skip
    sheet = Sheet(
        result, "Closed chains of four links", panels=len(chains), across=across, labels=labels, captions=captions,
        height=SIDE if across > 1 else 3.6, gap=0.55,
    )  # fmt: skip
    handles: list[Any] = []
    for ax, (_, item) in zip(sheet.axes, chains):
        data, axes = _in_plane(item.data)
        slides = "offset" in told[_name(_)]
        later: dict[str, Any] = {"color": "#56B4E9", "linewidth": 1.1, "marker": "o", "markersize": 3.0}
        for k, pose in reversed(list(enumerate(data))):
            look = later if k else {"color": "black", "linewidth": 2.2, "marker": "o", "markersize": 5.0}
            ring = pose[:3] if slides else np.vstack([pose, pose[:1]])
            drawn = ax.plot(*ring.T, markerfacecolor="white", zorder=3 if k == 0 else 2, **look)
            handles = [*drawn, *handles[-1:]] if k == 0 else drawn
        if slides:
            for pose in data:  # the slide's line, which turns where its guide does
                ax.plot(*pose[3:1:-1].T, color=style.GREY, linewidth=0.8, linestyle=(0, (5, 3)), zorder=1)
        ax.margins(0.06)
        _true_lengths(ax, axes)
    if len(handles) == 1:  # no joint on the fixed link has a dead point
        labels = labels[:1]
    sheet.legend(handles, labels)
    return sheet.figure


@plot(lambda result: any(np.isfinite(x.data).any() for x in result.group("centrodes/fixed").values()))
def centrodes(result: Result) -> Any:
    """Paths of the pole in the axes of both links of a pair; broken where the pole passes infinity."""
    names = [n for n, x in result.group("centrodes/fixed").items() if np.isfinite(x.data).any()][: FEW // 2]
    sheet = Sheet(
        result,
        "Centrodes: paths of the pole in the axes of the second link (left, fixed) and of the first (right, moving)",
        panels=2 * len(names), across=2, height=SIDE, gap=0.78, captions=_far_note(result, names), titled=True,
    )  # fmt: skip
    for row, name in enumerate(names):
        rate = result[f"relative_rates/{name}"]
        for ax, kind in zip(sheet.axes[2 * row : 2 * row + 2], ("fixed", "moving")):
            data, axes = _in_plane(result[f"centrodes/{kind}/{name}"])
            look = {
                "color": style.COLOURS[row % len(style.COLOURS)],
                "linestyle": "-" if kind == "fixed" else "--",
            }
            _draw_path(ax, data, rate, look)
            _true_lengths(ax, axes)
            ax.set_title(f"{name}, {kind}", fontsize=style.FONT_SIZE, loc="left", pad=3)
    return sheet.figure


@plot(lambda result: any(np.isfinite(x.data).any() for x in result.group("acceleration_poles").values()))
def pole_paths(result: Result) -> Any:
    """Poles and acceleration poles of pairs of links in the world, a panel a pair."""
    names = [n for n, x in result.group("acceleration_poles").items() if np.isfinite(x.data).any()][:FEW]
    across = min(2, len(names))
    labels = ["pole", "acceleration pole", "where they begin"]
    sheet = Sheet(
        result, "Poles and acceleration poles in the world", panels=len(names), across=across,
        height=SIDE if across > 1 else 3.6, gap=0.78, labels=labels, captions=_far_note(result, names), titled=True,
    )  # fmt: skip
    handles: list[Any] = []
    for ax, name in zip(sheet.axes, names):
        both = np.stack([result[f"poles/{name}"], result[f"acceleration_poles/{name}"]])
        data, axes = _in_plane(both)
        steady = np.ones(len(data[0]))
        handles = [
            *_draw_path(ax, data[0], result[f"relative_rates/{name}"], {"color": style.COLOURS[0]}),
            *_draw_path(ax, data[1], steady, {"color": style.COLOURS[1], "linestyle": "--"}),
        ]
        first = data[:, np.isfinite(data).all(axis=(0, 2))][:, :1].reshape(-1, 2)
        handles += ax.plot(*first.T, "o", color="white", markeredgecolor=style.GREY, markersize=6, zorder=4)
        _frame(ax, data.reshape(-1, 2))
        _true_lengths(ax, axes)
        ax.set_title(name, fontsize=style.FONT_SIZE, loc="left", pad=3)
    sheet.legend(handles, labels)
    return sheet.figure


def _far_note(result: Result, names: Sequence[str]) -> list[str]:
    """Return the line that says which poles go to infinity."""
    told = (result.summary.get("design") or {}).get("unbounded") or {}
    said = []
    for name in names:
        one = told.get(f"poles/{name}")
        if one is not None:
            times = ", ".join(number(t, 4) for t in one["times"][:6])
            said.append(f"{name}: at infinity {'throughout' if one['throughout'] else f'at t = {times} s'}")
    return [f"Line broken, far parts beyond the drawing: {'; '.join(said)}"] if said else []


def _draw_path(ax: Axes, data: Array, rate: Array, look: Mapping[str, Any]) -> list[Any]:
    """Draw the path (T, 2) of a pole, broken where the rate of turning (T,) passes zero, within what is near."""
    turns = np.flatnonzero(np.sign(rate[:-1]) * np.sign(rate[1:]) <= 0.0) + 1
    path = np.insert(data, turns, np.nan, axis=0)
    if len(path) > 3000 and not len(turns):
        path = thin_path(path)
    handles = ax.plot(*path.T, **{"linewidth": 1.5, **look})
    still = np.nanmax(np.nanmax(data, axis=0) - np.nanmin(data, axis=0), initial=0.0) if len(data) else 0.0
    if np.isfinite(still) and still <= 1e-9 * max(1.0, float(np.nanmax(np.abs(data)))):
        ax.plot(*data[np.isfinite(data).all(axis=1)][:1].T, "o", markersize=5, color=look["color"])
    _frame(ax, data)
    return handles


def _frame(ax: Axes, points: Array) -> None:
    """Show what of points (n, 2) is near the middle one."""
    own = points[np.isfinite(points).all(axis=1)]
    if not len(own):
        return
    middle = np.median(own, axis=0)
    away = np.linalg.norm(own - middle, axis=1)
    near = own[away <= FAR * max(float(np.median(away)), 1e-9)]
    low, high = near.min(axis=0), near.max(axis=0)
    spread = float((high - low).max())
    # a pole that stays where it is has no size of its own
    room = 0.06 * spread if spread > 1e-9 * max(1.0, float(np.abs(middle).max())) else 0.5 * max(
        0.1, float(np.abs(middle).max())
    )  # fmt: skip
    ax.set_xlim(low[0] - room, high[0] + room)
    ax.set_ylim(low[1] - room, high[1] + room)


@plot(lambda result: bool(result.group("curvatures")))
def curvature(result: Result) -> Any:
    """Curvature of the paths of points, positive to the left."""
    return _columns(
        result, "curvatures", "curvature", "Curvature of paths, positive to the left; broken at rest"
    )


@plot(lambda result: bool(result.group("ratios")))
def velocity_ratios(result: Result) -> Any:
    """Velocity ratios; a dead point of the first joint is where one is zero."""
    return _columns(
        result,
        "ratios",
        "ratio",
        "Velocity ratios; zero: dead point if the first drives; broken: if the second does",
    )


def _columns(result: Result, group: str, quantity: str, subtitle: str) -> Any:
    """Return a figure of the datasets of a group over time, a panel for each unit, with the largest ones cut off."""
    items = dict(list(result.group(group).items())[:FEW])
    data = np.column_stack([finite(item.data) for item in items.values()])
    shown = curves(data, list(items), [item.units for item in items.values()])
    groups = shown.groups()
    sheet = TimeSheet(
        result,
        subtitle,
        group,
        shown.nothing,
        panels=len(groups),
        height=panel_height(len(groups)),
        labels=list(items),
    )
    handles = draw_groups(sheet, shown, list(groups.values()))
    for ax, (units, columns) in zip(sheet.axes, groups.items()):
        own = data[:, columns]
        size = float(np.nanpercentile(np.abs(own), 90)) if np.isfinite(own).any() else 0.0
        if size > 0.0 and np.nanmax(np.abs(own)) > 10.0 * FAR * size:  # what goes to infinity hides all else
            low, high = (float(x) for x in np.nanpercentile(own, (5, 95)))
            ax.set_ylim(min(low, 0.0) - FAR * size * (low < 0.0), max(high, 0.0) + FAR * size * (high > 0.0))
        ax.axhline(0.0, color=style.GREY, linewidth=0.6)
        ax.set_ylabel(quantity if units == "1" else labelled(quantity, units))
    sheet.finish(handles, list(items))
    return sheet.figure


STEEP = 45.0  # degrees, beyond which a force hardly drives


@plot(lambda result: bool(result.group("pressure_angles")))
def pressure_angle(result: Result) -> Any:
    """Pressure angles over time, with the band in which a force drives well."""
    items = dict(list(result.group("pressure_angles").items())[:FEW])
    angle = np.degrees(np.column_stack([finite(item.data) for item in items.values()]))
    labels = [*items, f"within {STEEP:.0f} deg, where a force drives well"]
    sheet = TimeSheet(
        result, "Pressure angle: from the way of a point to the force", "pressure_angles", labels=labels
    )
    handles = sheet.draw(sheet.ax, curves(angle, list(items), ["deg"] * len(items)))
    handles.append(sheet.ax.axhspan(-STEEP, STEEP, color=style.GREY, alpha=0.12, zorder=0, linewidth=0))
    sheet.ax.set_ylabel("pressure angle [deg]")
    sheet.finish(handles, labels)
    return sheet.figure


@plot(lambda result: "shaking" in result)
def shaking(result: Result) -> Any:
    """Shaking force and moment over time, a panel each; components that are nothing are left out."""
    whole = curves_of(result, "shaking")
    kept = [k for k, top in enumerate(whole.top) if top > 0.0] or [0]
    shown = whole.part(kept)
    groups, facts = shown.groups(), result.summary["shaking"]
    peak = f"largest {number(facts['peak_force'], 4)} N"
    if facts.get("peak_moment") is not None:
        peak += f", {number(facts['peak_moment'], 4)} N m"
    sheet = TimeSheet(
        result, f"Shaking force and moment on the base about {facts['about']}: {peak}", "shaking", whole.nothing,
        panels=len(groups), height=panel_height(len(groups)), labels=list(shown.names),
    )  # fmt: skip
    handles = draw_groups(sheet, shown, list(groups.values()))
    for ax, units in zip(sheet.axes, groups):
        ax.set_ylabel(labelled("force" if units == "N" else "moment", units))
    sheet.finish(handles, list(shown.names))
    return sheet.figure


@plot(
    lambda result: (
        "shaking" in result and sum(name[0] == "f" for name in column_names(result.variables["shaking"])) > 1
    )
)
def shaking_polar(result: Result) -> Any:
    """The shaking force as an arrow from the origin: the path of its head."""
    variable = result.variables["shaking"]
    names = [name for name in column_names(variable) if name[0] == "f"]
    force = finite(variable.data[:, [column_names(variable).index(name) for name in names]])
    sizes = np.nanmax(np.abs(force), axis=0)
    first, second = sorted(sorted(range(len(names)), key=lambda k: -sizes[k])[:2])
    sheet = Sheet(
        result, "Path of the head of the shaking force", height=4.2, labels=["shaking force", "first sample"]
    )
    ax, path = sheet.ax, force[:, [first, second]]
    handles = ax.plot(*thin_path(path).T, color=style.COLOURS[0], linewidth=1.5)
    handles += ax.plot(*path[:1].T, "o", color="white", markeredgecolor=style.COLOURS[0], markersize=7)
    ax.plot(0.0, 0.0, "+", color="black", markersize=9)
    ax.margins(0.05)
    _same_scale(ax)
    ax.set_xlabel(f"{names[first]} [N]")
    ax.set_ylabel(f"{names[second]} [N]")
    sheet.legend(handles, ["shaking force", "first sample"])
    return sheet.figure


@plot(lambda result: "flywheel/energy" in result)
def flywheel(result: Result) -> Any:
    """The torque that a constant rate needs, with its mean, and the energy that a flywheel gives."""
    facts = result.summary["flywheel"]
    labels = [f"torque of {facts['joint']}", "mean", "energy given", "slowest and quickest"]
    text = f"Flywheel of {number(facts['inertia'], 4)} kg m², which takes up {number(facts['energy'], 4)} J"
    sheet = TimeSheet(result, text, "flywheel", panels=2, height=2.2, labels=labels)
    looks = line_styles(2)
    torque, energy = (curves_of(result, f"flywheel/{x}") for x in ("torque", "energy"))
    handles = sheet.draw(sheet.axes[0], torque, [looks[0]])
    handles.append(
        sheet.axes[0].axhline(facts["mean_torque"], color=style.GREY, linewidth=1.2, linestyle="--")
    )
    handles += sheet.draw(sheet.axes[1], energy, [looks[1]])
    times = [facts["emptiest_time"], facts["fullest_time"]]
    given = finite(result["flywheel/energy"])
    ends = np.interp(times, result.time, given)
    handles += sheet.axes[1].plot(
        times, ends, "D", color="white", markeredgecolor=style.ALARM, zorder=4, clip_on=False
    )
    sheet.axes[0].set_ylabel("torque [N m]")
    sheet.axes[1].set_ylabel("energy [J]")
    sheet.finish(handles, labels)
    return sheet.figure


@plot(lambda result: bool(result.summary.get("fluctuation")))
def fluctuation(result: Result) -> Any:
    """Rates of joints with their largest and smallest values, and the coefficient of fluctuation of each."""
    told = dict(list(result.summary["fluctuation"].items())[:FEW])
    whole = curves_of(result, "qd")
    sheet = TimeSheet(
        result, "Fluctuation of speed; thin lines: largest and smallest rate", "qd", panels=len(told),
        height=panel_height(len(told)),
        labels=[f"{name}: coefficient {number(one['coefficient'], 5) if one['coefficient'] is not None else 'none'}"
                for name, one in told.items()],
    )  # fmt: skip
    handles: list[Any] = []
    for ax, name, look in zip(sheet.axes, told, sheet.looks.lines(list(told))):
        k = list(whole.names).index(name)
        handles += sheet.draw(ax, whole.part([k]), [look])
        ends = result.summary["extremes"][f"qd.{name}"]
        for end in ("smallest", "largest"):
            ax.axhline(ends[end], color=look["color"], linewidth=0.8, alpha=0.7)
        ax.set_ylabel(labelled("rate", whole.units[k]))
    labels = [
        f"{name}: coefficient {number(one['coefficient'], 5) if one['coefficient'] is not None else 'none'}"
        for name, one in told.items()
    ]
    sheet.finish(handles, labels)
    return sheet.figure
