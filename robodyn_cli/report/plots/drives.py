"""Motors in their envelopes, and the combinations of a catalogue."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from robodyn_cli.record import record
from robodyn_cli.report import numbers, style
from robodyn_cli.report.abscissa import over_joint
from robodyn_cli.report.canvas import Sheet
from robodyn_cli.report.cells import figure
from robodyn_cli.report.looks import looks_of
from robodyn_cli.report.numbers import labelled, number, position_word
from robodyn_cli.report.registry import plot
from robodyn_cli.report.style import log_axis
from robodyn_cli.results.result import Result, column_names, units_of
from robodyn_cli.spatial.algebra import Array

MOST = 8  # motors that are drawn: those that use most of their envelope
FAR = 3.0  # times an envelope: points further out are drawn at the edge, or the envelope could not be seen
EDGE = 1.4  # times the envelope, where that is
INSIDE = 0.965  # of the axis, where they are drawn
NONE = np.empty(0)
DOTS = {"linestyle": "none"}
RING = {**DOTS, "marker": "o", "markerfacecolor": "none", "clip_on": False}
# what there is to draw, in the order of the legend; told apart by dashes and outlines, in grey too
LOOKS: dict[str, Mapping[str, Any]] = {
    "peak, driving": {"color": "#000000", "linestyle": "-", "linewidth": 1.6},
    "peak, braking": {"color": "#000000", "linestyle": (0, (1.2, 1.2)), "linewidth": 1.2},
    "continuous": {"color": style.COLOURS[0], "linestyle": (0, (5, 1.5)), "linewidth": 1.4},
    "inside": {**DOTS, "marker": ".", "color": "#8f8f8f", "markersize": 2.5},
    "outside": {**DOTS, "marker": "x", "color": style.ALARM, "markersize": 4},
    "beyond the drawing": {**DOTS, "marker": "^", "color": style.ALARM, "markersize": 5},
    "RMS": {**DOTS, "marker": "s", "color": style.COLOURS[0], "markersize": 5, "clip_on": False},
    "decides": {**RING, "color": style.ALARM, "markersize": 9},
}


MEANINGS = {
    "peak, driving": "driving: the torque acts along the motion, braking: against it",
    "RMS": "RMS: root mean square, compared with continuous",
}


@record
class DrawnMotor:
    """What is drawn of one motor: points (n,) of speed [rad/s] and torque [N m] by their look, and the ends of the
    axes."""

    name: str
    facts: Mapping[str, Any]
    points: Mapping[str, tuple[Array, Array]]
    ends: tuple[float, float]


@plot(lambda result: "drives/torque" in result and result["drives/torque"].size > 0)
def drives(result: Result) -> Any:
    """Torque over speed of each motor, with the envelopes that it has to stay inside."""
    names = column_names(result.variables["drives/torque"])
    motors = [_motor(result, names[k], k) for k in _shown(result, names)]
    left = len(names) - len(motors)
    note = f"; the {MOST} of {len(names)} that use most of it" if left else ""
    labels = [label for label in LOOKS if any(len(motor.points[label][0]) for motor in motors)]
    sheet = Sheet(
        result,
        f"Torque over speed of each motor in its envelope{note}; both as magnitudes{_meanings(labels)}",
        panels=len(motors),
        across=1 if len(motors) == 1 else 2,
        height=2.6 if len(motors) < 3 else 2.0,
        gap=0.8,
        titled=True,
        labels=labels,
    )
    for ax, motor in zip(sheet.axes, motors):
        handles = _panel(ax, motor, labels)
    sheet.legend(handles, labels)
    return sheet.figure


def _meanings(labels: Sequence[str]) -> str:
    """Return what the words of the legend mean."""
    return "".join(f"; {meaning}" for label, meaning in MEANINGS.items() if label in labels)


def _shown(result: Result, names: Any) -> list[int]:
    """Return the columns that are drawn, in their own order."""
    use = result["drives/use"].max(axis=0)
    return (
        sorted(np.argsort(-use, kind="stable")[:MOST].tolist()) if len(names) > MOST else [*range(len(names))]
    )


def _motor(result: Result, name: str, k: int) -> DrawnMotor:
    """Return what is drawn of one motor, whose number is k."""
    speed, torque = (np.abs(result[f"drives/{x}"][:, k]) for x in ("speed", "torque"))
    facts = result.summary.get("drives", {}).get(name, {})
    curves = {kind: _curve(result, kind, name) for kind in ("driving", "braking", "continuous")}
    ends = tuple(
        _end(own, np.concatenate([curve[axis] for curve in curves.values()]))
        for axis, own in enumerate((speed, torque))
    )
    inside = result["drives/use"][:, k] <= 1.0
    beyond = (speed > ends[0]) | (torque > ends[1])
    at = _decisive(result, facts)
    rms = _rms(speed, torque) if len(curves["continuous"][0]) else (NONE, NONE)
    if np.any(np.greater(rms, np.reshape(ends, (2, 1)))):
        rms = NONE, NONE
    points = {
        **dict(zip(LOOKS, curves.values())),
        "inside": (speed[inside], torque[inside]),
        "outside": (speed[~inside & ~beyond], torque[~inside & ~beyond]),
        "beyond the drawing": (speed[beyond], torque[beyond]),
        "RMS": rms,
        "decides": (speed[at], torque[at]),
    }
    return DrawnMotor(name, facts, points, (ends[0], ends[1]))


def _curve(result: Result, kind: str, name: str) -> tuple[Array, Array]:
    path = f"envelopes/{kind}/{name}"
    return (result[path][:, 0], result[path][:, 1]) if path in result else (NONE, NONE)


def _end(points: Array, envelope: Array) -> float:
    """Return where an axis ends: with the points, or not far from the envelope where these are far outside."""
    most, own = float(points.max(initial=0.0)), float(envelope.max(initial=0.0))
    return EDGE * own if own > 0.0 and most > FAR * own else 1.1 * max(most, own)


def _decisive(result: Result, facts: Mapping[str, Any]) -> list[int]:
    """Return the sample that decides, none where that is no instant."""
    time = facts.get("time")
    return [] if time is None else [int(np.argmin(np.abs(result.time - time)))]


def _rms(speed: Array, torque: Array) -> tuple[Array, Array]:
    """Return the point of a cycle that is compared with the continuous envelope."""
    speed, torque = (np.sqrt(np.mean(np.square(x), keepdims=True)) for x in (speed, torque))
    return speed, torque


def _panel(ax: Any, motor: DrawnMotor, labels: list[str]) -> list[Any]:
    """Draw one motor; return what the legend shows."""
    right, top = motor.ends
    handles = []
    for label in labels:
        speed, torque = motor.points[label]
        places = (np.where(x > end, INSIDE * end, x) for x, end in ((speed, right), (torque, top)))
        handles += ax.plot(*places, **LOOKS[label])
    ax.set_xlim(0.0, right or 1.0)
    ax.set_ylim(0.0, top or 1.0)
    for axis in (ax.xaxis, ax.yaxis):  # a power of ten above the axis would be in the way of the title
        axis.set_major_formatter(lambda x, _: number(x, 5))
    ax.set_xlabel("speed at the motor [rad/s]")
    ax.set_ylabel("torque at the motor [N·m]")
    ax.set_title(_title(motor.name, motor.facts), fontsize=style.FONT_SIZE, loc="left", pad=4)
    told = _told(motor)
    if told:
        box = {"facecolor": "white", "edgecolor": "none", "pad": 1.5}
        ax.text(0.97, 0.9, told, transform=ax.transAxes, ha="right", va="top", color=style.ALARM, bbox=box)
    return handles


def _told(motor: DrawnMotor) -> str:
    """Return how far points are out that the drawing does not reach."""
    speed, torque = motor.points["beyond the drawing"]
    curves = [motor.points[label] for label in ("peak, driving", "peak, braking", "continuous")]
    texts = []
    for axis, (name, unit, points) in enumerate((("speed", "rad/s", speed), ("torque", "N·m", torque))):
        most = float(points.max(initial=0.0))
        own = max(float(curve[axis].max(initial=0.0)) for curve in curves)
        if most > motor.ends[axis]:
            texts.append(f"{name} up to {number(most)} {unit},\n{number(most / own)} times the envelope")
    return "\n".join(texts)


def _title(name: str, facts: Mapping[str, Any]) -> str:
    """Return a joint with its motor, the verdict and what decides it."""
    if not facts:
        return name
    limit, margin = facts["decides"].replace("_", " "), facts["margin"]
    verdict = "suffices" if facts["passes"] else "too small"
    left = (
        f"needs {number(1.0 - margin)} times limit '{limit}'"
        if margin < 0.0
        else f"{number(100.0 * margin)} % left of limit '{limit}'"
    )
    return f"{name}: {facts['motor']}, {verdict}\n{left}"


MOST_JOINTS = 8  # joints that are drawn
WORST = -1.0  # margins below are drawn at the edge
TICKS = (WORST, -0.5, 0.0, 0.5, 1.0)
COMBINATION = {"linestyle": "none", "marker": "."}
FRONT = {"linestyle": "none", "marker": "o", "markerfacecolor": "none", "markersize": 9}
# what there is to draw, in the order of the legend
FRONT_LOOKS: dict[str, Mapping[str, Any]] = {
    "suffices": {**COMBINATION, "color": "#000000", "markersize": 4},
    "too small": {**COMBINATION, "color": "#b5b5b5", "markersize": 3},
    "none is better in both": {
        "drawstyle": "steps-post", "color": style.COLOURS[0], "linewidth": 1.4, "marker": "D", "markersize": 3,
    },
    "chosen": {**FRONT, "color": style.ALARM},
}  # fmt: skip


@plot(lambda result: bool(result.group("candidates")))
def size_front(result: Result) -> Any:
    """All combinations of motors and gears of each joint: cost or mass over the margin, and what none of them
    beats."""
    tables = dict(list(result.group("candidates").items())[:MOST_JOINTS])
    by = result.summary["size"]["by"]
    left = len(result.group("candidates")) - len(tables)
    note = f"; {left} further joints left out" if left else ""
    found = [_points(result, name, table.data, by) for name, table in tables.items()]
    labels = [label for label in FRONT_LOOKS if any(len(points[label][0]) for points in found)]
    sheet = Sheet(
        result,
        f"Combinations of motor and gear: {by} over the margin of the limit that decides{note}",
        panels=len(tables),
        across=1 if len(tables) == 1 else 2,
        height=2.4,
        gap=0.9,
        titled=True,
        labels=labels,
    )
    for ax, name, points in zip(sheet.axes, tables, found):
        handles = [ax.plot(*points[label], **FRONT_LOOKS[label])[0] for label in labels]
        _finish(ax, result, name, by, np.concatenate([prices for _, prices in points.values()]))
    sheet.legend(handles, labels)
    return sheet.figure


def _points(result: Result, name: str, data: Array, by: str) -> dict[str, tuple[Array, Array]]:
    """Return margins [%] and prices of one joint's combinations by their look."""
    sized, drive = result.summary["size"]["joints"][name], result.summary["drives"][name]
    rows = data[np.isfinite(data[:, 4])]
    passing = rows[:, 4] >= drive["least_margin"]
    margins, prices = rows[:, 4], rows[:, {"cost": 2, "mass": 3}[by]]
    front = np.array([(one["margin"], one[by]) for one in sized["front"]]).reshape(-1, 2)
    groups = {
        "suffices": (margins[passing], prices[passing]),
        "too small": (margins[~passing], prices[~passing]),
        "none is better in both": (front[:, 0], front[:, 1]),
        "chosen": (np.array([drive["margin"]]), np.array([drive[by]])),
    }
    return {label: (100.0 * np.maximum(x, WORST), y) for label, (x, y) in groups.items()}


def _finish(ax: Any, result: Result, name: str, by: str, prices: Array) -> None:
    """Give one joint's panel its axes and its title."""
    sized, drive = result.summary["size"]["joints"][name], result.summary["drives"][name]
    ax.axvline(100.0 * drive["least_margin"], color=style.GREY, linewidth=0.8, linestyle=style.DASHES[1])
    if np.all(prices > 0.0):
        log_axis(ax, 0.8 * float(prices.min()), 1.25 * float(prices.max()))
    ax.set_xlim(100.0 * WORST - 5.0, 105.0)
    ax.set_xticks(
        [100.0 * x for x in TICKS], [f"{'≤ ' if x == WORST else ''}{number(100.0 * x)}" for x in TICKS]
    )
    ax.set_xlabel("margin [%]")
    ax.set_ylabel("cost" if by == "cost" else "mass [kg]")
    count = f"{sized['passing']} of {sized['combinations']} suffice"
    ax.set_title(f"{name}: {drive['motor']}{' + ' + drive['gear'] if drive['gear'] else ''}\n{count}",
                 fontsize=style.FONT_SIZE, loc="left", pad=4)  # fmt: skip


# where both are the same, dashes lie on a broad line
RATIOS: dict[str, dict[str, Any]] = {
    "dynamic": {"linewidth": 3.2, "alpha": 0.55, "solid_capstyle": "butt"},
    "static": {"linewidth": 1.3, "linestyle": (0, (4, 1.6))},
}
HIGHEST = 3.0  # times what is required, or 1.5 times a least ratio, up to which ratios are drawn


@plot(lambda result: "motorisation/static_available" in result and len(result.time) > 1)
def motorisation(result: Result) -> Any:
    """Torque available over factored resistance of each driven joint, over the time and over its position."""
    names = column_names(result.variables["motorisation/static_available"])[: style.FEW]
    kinds = [kind for kind in RATIOS if f"motorisation/{kind}_available" in result]
    figures = {name: result.summary["motorisation"][name] for name in names}
    required = figures[names[0]]["required"]
    highest = HIGHEST * max(required, *(0.5 * (one["ratio"] or 0.0) for one in figures.values()))
    labels = [f"{name}, {kind}" for name in names for kind in kinds] + ["required"]
    sheet = Sheet(
        result,
        "Torque available over factored resistance; where nothing resists, or little, it is beyond the drawing",
        panels=2,
        across=2,
        labels=labels,
        captions=[f"Least ratio of {name}: {_ratio(one)}" for name, one in figures.items()],
    )
    handles: list[Any] = []
    angles, looks = dict(zip(column_names(result.variables["q"]), result["q"].T)), looks_of(result)
    q = result.variables["q"]
    units = (
        " or ".join(dict.fromkeys(u for name, u in zip(column_names(q), units_of(q)) if name in names))
        or "rad"
    )
    place = labelled(names[0] if len(names) == 1 else position_word(units), units)
    for ax, over, label in zip(sheet.axes, ({}, angles), ("time [s]", place)):
        handles, drawn, ways = [], [], []
        for k, name in enumerate(names):
            for kind in kinds:
                x = over.get(name, result.time) if ax is sheet.axes[0] or name in over else NONE
                y = _ratios(result, kind, k, highest)[: len(x)]
                handles += ax.plot(x, y, color=looks.colour(name), **RATIOS[kind])
                drawn.append(y)
                ways.append(x)
        handles.append(ax.axhline(required, color=style.ALARM, linewidth=1.0))
        ax.set_xlabel(label)
        every, way = np.concatenate(drawn), np.concatenate(ways)
        if len(way) and np.ptp(way) > 0.0:  # the whole motion, also where a ratio is beyond the drawing
            ax.set_xlim(way.min(), way.max())
        if not (every < highest).all():
            ax.set_ylim(top=highest)
    # the least ratio may be reached between two samples whose own are beyond the drawing
    for name, one in figures.items():
        if one["ratio"] is not None and one["ratio"] < highest:
            sheet.axes[0].plot(one["time"], one["ratio"], "o", color=looks.colour(name), clip_on=False)
    over_joint(result, sheet.axes[:1])
    sheet.ax.set_ylabel("ratio")
    sheet.legend(handles, labels)
    return sheet.figure


def _ratios(result: Result, kind: str, k: int, highest: float) -> Array:
    """Return ratios (T,) of a driven joint, nan beyond the drawing."""
    available, resistance = (
        result[f"motorisation/{kind}_{side}"][:, k] for side in ("available", "resistance")
    )
    beyond = (available >= 2.0 * highest * resistance) | (resistance <= 0.0)
    ratios: Array = np.where(beyond, np.nan, available / np.where(beyond, 1.0, resistance))
    return ratios


def _ratio(figures: Mapping[str, Any]) -> str:
    """Return the least ratio of a joint with its error in words."""
    if figures["ratio"] is None:
        return "nothing resists"
    error = figures["errors"]["ratio"]
    told = (
        number(figures["ratio"], 5) if error is None else figure(figures["ratio"], error).replace("±", "+-")
    )
    return f"{told} at {numbers.times([figures['time']])[0]}"
