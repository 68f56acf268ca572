"""The mechanism in space: at instants, at one state, in its branches and modes, and the paths of its points."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.lines import Line2D

from robodyn_cli.report import numbers, style
from robodyn_cli.report.canvas import SUBTITLE_LINE, Sheet, panel_width
from robodyn_cli.report.curves import DOTS, alone
from robodyn_cli.report.drawing import paper
from robodyn_cli.report.drawing.build import can_draw, drawing_of, gravity_of, make_drawing, paths_of
from robodyn_cli.report.drawing.camera import Camera, View, along_axis, default_camera
from robodyn_cli.report.drawing.paper import Painted, name_lines
from robodyn_cli.report.drawing.places import along_motion, drawing_of_paths, moving_paths
from robodyn_cli.report.drawing.record import Drawing, Stroke
from robodyn_cli.report.drawing.strokes import silhouette
from robodyn_cli.report.lines import finite, largest, thin_path
from robodyn_cli.report.looks import POINTS, Looks, looks_of
from robodyn_cli.report.numbers import error_number, number
from robodyn_cli.report.registry import plot
from robodyn_cli.report.style import FEW, GREY, TARGET
from robodyn_cli.results.moments import lock_time
from robodyn_cli.results.result import Result, evenly
from robodyn_cli.spatial.algebra import Array

POSES = 8
FAR = 1.5  # times the size of the mechanism, beyond which a flight has a view of its own
MOST_NAMES = 8
# of frames: Okabe and Ito's vermilion, green and blue
AXIS_COLOURS = ("#D55E00", "#009E73", "#0072B2")
LENGTH = 26.0  # of an axis of a frame [pt]


@plot(can_draw)
def mechanism(result: Result) -> Any:
    """The mechanism at several instants, light to dark, the last pose in full; in space with views along the axes."""
    return _at_instants(result, around=True)


def mechanism_alone(result: Result) -> Any:
    """Return the same without views along the axes."""
    return _at_instants(result, around=False)


def _at_instants(result: Result, around: bool) -> Any:
    drawing = make_drawing(result, evenly(len(result.time), 400))
    chosen = along_motion(drawing, POSES)
    poses = drawing.at(chosen)
    view, views = _views(poses, default_camera(drawing))
    views = views if around or view.flat else []
    locked = lock_time(result)
    times = numbers.times(poses.times.tolist())
    end = "locked" if locked is not None and abs(poses.times[-1] - locked) < 1e-6 else "last"
    labels = [] if len(chosen) == 1 else [*times[:-1], f"{times[-1]} ({end})"]
    height = paper.height_of(view, panel_width())
    more = paper.room_below(views)
    subtitle = _subtitle(view, len(chosen), bool(views)) + _dots_note(x.points for x in drawing.trails)
    sheet = Sheet(result, subtitle, labels=labels, height=height + more)
    for one, below in zip(views, paper.axes_below(sheet, views)):
        paper.put(below, one, len(chosen) - 1, _ghosts(one, 0.7), grid=False)
    ax = sheet.ax
    paper.set_up(ax, view)
    last = len(chosen) - 1
    paper.put(ax, view, last, _ghosts(view, 1.3), grid=not view.numbered)
    if len(drawing.links) <= MOST_NAMES:
        name_lines(ax, view, last, [line for k in range(last) for line in silhouette(view, k)])
    handles = [
        Line2D([], [], color=_shade(k, last), linewidth=2.6 if k == last else 1.3) for k in range(last + 1)
    ]
    sheet.legend(handles, labels)
    return sheet.figure


def _views(drawing: Drawing, camera: Camera) -> tuple[View, list[View]]:
    """Return the view of a drawing, and those below it: along the axes in space, in a plane of a flight that leads so
    far away that the first one leaves it out."""
    whole, near = (View(drawing, camera, near=x) for x in (False, True))
    sizes = [float(np.ptp(view.extent, axis=0).max()) for view in (whole, near)]
    view = near if sizes[0] > FAR * sizes[1] else whole
    if not view.flat:
        return view, [View(drawing, along_axis(axis)) for axis in (1, 0, 2)]
    return view, [whole] if view is near else []


def _subtitle(view: View, count: int, below: bool) -> str:
    instants = f"{count} instants, light to dark" if count > 1 else "1 instant"
    where = paper.where(view) + (" and along the axes" if below and not view.flat else "")
    if view.flat and below:
        instants += "; below with the whole flight"
    told = paper.caption(view, grid=not view.numbered)
    return f"The mechanism {where} at {instants}{'; ' if told else ''}{told}"


def _dots_note(paths: Iterable[Array]) -> str:
    """Return the part of a subtitle that says what dots on paths (K, 3) are; empty where there are none."""
    broken = any(np.isnan(path).any() for path in paths)
    return "; dots where samples are too far apart to show more" if broken else ""


def _shade(k: int, last: int) -> str:
    """Return the colour of a pose: black for the last."""
    return "#000000" if k == last else to_hex(colormaps["Blues"](0.25 + 0.6 * k / max(1, last)))


def _ghosts(view: View, width: float) -> list[Stroke]:
    """Return the outlines of all poses but the last."""
    last = len(view.drawing.times) - 1
    return [Stroke(line, _shade(k, last), width) for k in range(last) for line in silhouette(view, k)]


START: dict[str, Any] = {"marker": "o", "color": "white", "markeredgewidth": 1.8, "markersize": 8}


@plot(lambda result: bool(moving_paths(result)))
def tip_path(result: Result) -> Any:
    """Paths of the named points that move, and of their targets: flat in a plane, in space with views along the
    axes."""
    samples, points = moving_paths(result), {name: path for name, (_, path) in paths_of(result).items()}
    targets = {name: item.data for name, item in result.group("targets").items() if name in points}
    drawn = list(points)[:FEW]
    shown = {name: points[name] for name in drawn}
    gravity = gravity_of(result) if can_draw(result) else np.zeros(3)
    paths = drawing_of_paths([*shown.values(), *targets.values()], gravity)
    view = View(paths, default_camera(paths))
    views = [] if view.flat else [View(paths, along_axis(axis)) for axis in (1, 0, 2)]
    labels = [*drawn, *(["target"] if targets else []), "start"]
    height = paper.height_of(view, panel_width()) + paper.room_below(views)
    subtitle = _subtitle_of_paths(view, samples, targets, drawn)
    subtitle += _dots_note(shown.values())
    sheet = Sheet(result, subtitle, labels=labels, height=height)
    looks = looks_of(result)
    for one, ax in zip(views, paper.axes_below(sheet, views)):
        _paths(ax, one, looks, shown, targets, 0.6)
    paper.set_up(sheet.ax, view)
    if not view.flat:
        paper.ground(sheet.ax, view)
    handles = _paths(sheet.ax, view, looks, shown, targets, 1.0)
    sheet.legend([*handles, Line2D([], [], markeredgecolor=GREY, **START)], labels)
    return sheet.figure


def _paths(
    ax: Axes, view: View, looks: Looks, points: dict[str, Array], targets: dict[str, Array], scale: float
) -> list[Any]:
    """Draw the paths; return handles of those of points, and of a target where there is one."""
    handles: list[Any] = []
    # A path lies below its target: one that is tracked then shows as a dashed line on a broad one.
    for (name, data), look in zip(points.items(), looks.lines(list(points), POINTS)):
        path = thin_path(view.camera.project(data)[:, :2])
        width, dash = (3.0, "-") if name in targets else (1.5, look["linestyle"])
        handles += ax.plot(*path.T, color=look["color"], linestyle=dash, linewidth=scale * width)
        ax.plot(*path[alone(~np.isnan(path[:, 0]))].T, color=look["color"], **DOTS)
    dashed: list[Any] = []
    for data in targets.values():
        path = thin_path(view.camera.project(data)[:, :2])
        dashed = ax.plot(*path.T, color=TARGET, linestyle=(0, (4, 3)), linewidth=scale * 1.0)
    for data, handle in zip(points.values(), handles):
        start = view.camera.project(data[:1])[:, :2]
        look = {**START, "markersize": scale * START["markersize"]}
        ax.plot(*start.T, markeredgecolor=handle.get_color(), zorder=4, **look)
    return [*handles, *dashed[:1]]


def _subtitle_of_paths(
    view: View, points: dict[str, Array], targets: dict[str, Array], drawn: list[str]
) -> str:
    text = "Path of " + (f"point {drawn[0]}" if len(drawn) == 1 else "the points")
    if len(drawn) < len(points):
        text += f" ({len(drawn)} of {len(points)})"
    if not view.flat:
        text += f", in perspective and along the axes; {paper.caption(view)}"
    if targets:
        gap = max(
            largest(np.linalg.norm(points[name] - finite(target), axis=1)) for name, target in targets.items()
        )
        text += f"; largest distance of a sample from the target {error_number(gap)} m"
    return text


OTHERS = "#cccccc"
MOST_BRANCHES = 4 * style.FEW
ALIKE = 2.0  # apart [pt]: less is seen as the same place


@plot(lambda result: "branches/q" in result and len(result["branches/q"]) > 0)
def branches(result: Result) -> Any:
    """All the ways in which a mechanism closes, or an arm reaches a pose, one over the other; a panel for those that
    look the same, with the others faintly behind it."""
    q = result["branches/q"][:MOST_BRANCHES]
    drawing = drawing_of(result, np.zeros(len(q)), q)
    view = View(drawing, default_camera(drawing))
    alike = _alike(drawing, ALIKE * view.pt)[: style.FEW]
    across = min(len(alike), 2)
    names = ["\n".join(_branch_name(result, k) for k in group) for group in alike]
    lines = max(name.count("\n") for name in names)
    sheet = Sheet(
        result,
        _subtitle_of_branches(view, "frame" in result.summary, len(result["branches/q"]), alike),
        panels=len(alike),
        across=across,
        height=paper.height_of(view, panel_width(across), 1.6, 3.8),
        gap=0.45 + SUBTITLE_LINE * lines,
        titled=True,
    )
    others = [Stroke(line, OTHERS, 1.0) for group in alike for line in silhouette(view, group[0])]
    for place, (ax, group, name) in enumerate(zip(sheet.axes, alike, names)):
        paper.set_up(ax, view)
        paper.put(ax, view, group[0], others, grid=not view.numbered)
        ax.set_title(name, fontsize=style.FONT_SIZE, loc="left", pad=3)
        if place % sheet.across:
            ax.set_ylabel("")
        if place + sheet.across < len(alike):
            ax.set_xlabel("")
    return sheet.figure


def _alike(drawing: Drawing, near: float) -> list[list[int]]:
    """Return the poses of a drawing in groups whose links lie in the same places, up to a distance [m]: a wrist that
    flips about a point moves none."""
    seen = sorted({vertex for part in drawing.links for vertex in part.vertices})
    groups: list[list[int]] = []
    for k, places in enumerate(drawing.vertices[:, seen]):
        same = (x for x in groups if np.abs(drawing.vertices[x[0], seen] - places).max(initial=0.0) < near)
        group = next(same, None)
        if group is None:
            groups.append([k])
        else:
            group.append(k)
    return groups


def _subtitle_of_branches(view: View, posed: bool, count: int, alike: list[list[int]]) -> str:
    shown = sum(map(len, alike))
    more = f", {shown} of them drawn" if shown < count else ""
    more += "; those that look the same share a picture" if len(alike) < shown else ""
    plural = "es" if count != 1 else ""
    of = "that reach the pose" if posed else "of the closed loops"
    return f"{count} branch{plural} {of} {paper.where(view)}{more}"


def _branch_name(result: Result, k: int) -> str:
    """Return what stands above a panel: number, orientation, whether the assembly chose it."""
    listed = [x for x in result.summary.get("branches") or [] if x.get("reached", True)]
    facts: dict[str, Any] = listed[k] if k < len(listed) else {}
    sign = {1: ", orientation +", -1: ", orientation \u2212"}.get(facts.get("orientation", 0), "")
    name = facts.get("name", "")
    label = f"branch {k + 1}" if not name or name.isdigit() else name.replace("_", " ").replace("-", ", ")
    return f"{label}{sign}" + (", chosen" if facts.get("chosen") else "")


SIDES = ("#E69F00", "#56B4E9")


@plot(lambda result: "modes/q" in result and can_draw(result))
def mode_shapes(result: Result) -> Any:
    """The modes of a mechanism: the pose, and how far each mode swings to both sides; a panel a mode."""
    swung = result["modes/q"]
    count, shown = len(swung), min(len(swung), style.FEW)
    q = np.concatenate([result["q"][:1], swung[:shown].reshape(-1, swung.shape[2])])
    drawing = drawing_of(result, np.zeros(len(q)), q)
    view = View(drawing, default_camera(drawing))
    across = min(shown, 2)
    more = f", {shown} of them drawn" if shown < count else ""
    text = f"{count} mode{'s' if count != 1 else ''} {paper.where(view)}{more}; swings are drawn large"
    height = paper.height_of(view, panel_width(across), 1.6)
    sheet = Sheet(result, text, panels=shown, across=across, height=height, gap=0.45, titled=True)
    for k, ax in enumerate(sheet.axes):
        paper.set_up(ax, view)
        lines = [(SIDES[j], silhouette(view, 1 + 2 * k + j)) for j in range(2)]
        swings = [Stroke(line, colour, 1.6) for colour, of_side in lines for line in of_side]
        paper.put(ax, view, 0, grid=not view.numbered)
        ax.add_artist(Painted(swings)).set_zorder(5)  # in front of what would hide them
        ax.set_title(_mode_name(result.summary["modes"][k]), fontsize=style.FONT_SIZE, loc="left", pad=3)
        if k % sheet.across:
            ax.set_ylabel("")
        if k + sheet.across < shown:
            ax.set_xlabel("")
    return sheet.figure


def _mode_name(mode: dict[str, Any]) -> str:
    """Return what stands above a panel."""
    if mode["imaginary"]:
        return f"{number(mode['frequency'], 4)} Hz, damping {number(mode['damping'])}"
    if not mode["real"]:
        return "free, without restoring force"
    return f"{'grows' if mode['real'] > 0 else 'decays'} e times in {numbers.times([mode['time']], 3)[0]}"


@plot(lambda result: "frames" in result.summary and can_draw(result))
def state(result: Result) -> Any:
    """The mechanism at one state with its frames, for ``info``; the frames are origins (3,) and axes (3, 3;
    columns) in world coordinates."""
    drawing = make_drawing(result)
    view = View(drawing, default_camera(drawing))
    labels = [f"{axis} of a frame" for axis in "xyz"]
    told = paper.caption(view, grid=not view.numbered)
    subtitle = f"The mechanism {paper.where(view)} with its frames{'; ' if told else ''}{told}"
    sheet = Sheet(result, subtitle, labels=labels, height=paper.height_of(view, 5.9))
    ax = sheet.ax
    paper.set_up(ax, view)
    ax.add_artist(Painted(_axes(result, view))).set_zorder(4)
    paper.put(ax, view, 0, grid=not view.numbered)
    _names(ax, result, view)
    sheet.legend([Line2D([], [], color=colour) for colour in AXIS_COLOURS], labels)
    return sheet.figure


def _axes(result: Result, view: View) -> list[Stroke]:
    """Return the axes of the links' frames."""
    strokes = []
    for frame in result.summary["frames"].values():
        p, R = (np.array(frame[key]) for key in ("position", "rotation"))
        ends = np.stack([p, *(p + LENGTH * view.pt * R[:, k] for k in range(3))])
        places = view.project(ends, 0)[:, :2]
        strokes += [Stroke(places[[0, k + 1]], AXIS_COLOURS[k], 1.6) for k in range(3)]
    return strokes


def _names(ax: Any, result: Result, view: View) -> None:
    """Write the names of frames and of points, once for those that nearly coincide."""

    def seen(p: Array) -> Array:
        return np.asarray(view.project(p, 0)[:2])

    box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 0.6}
    look: dict[str, Any] = {"textcoords": "offset points", "bbox": box, "zorder": 6}
    near = 6.0 * view.pt
    frames = {name: seen(frame["position"]) for name, frame in result.summary["frames"].items()}
    middle = 0.5 * (view.low[0] + view.high[0])

    def write(place: Array, text: str, above: float, **more: Any) -> None:
        # towards the middle, where there is room
        left = bool(place[0] <= middle)
        side = {"xytext": (6.0 if left else -6.0, above), "ha": "left" if left else "right"}
        ax.annotate(text, (place[0], place[1]), **side, **look, **more)

    for place, text in _together(frames, near):
        write(place, text, -15.0, color=style.GREY)
    points = {name: seen(item.data[0]) for name, item in result.group("points").items()}
    for place, text in _together(points, near):
        ax.plot(*place[:, None], marker="x", color="black", linestyle="none", zorder=7)
        write(place, text, 9.0)


def _together(places: dict[str, Array], near: float) -> list[tuple[Array, str]]:
    """Return places with their names; those that nearly coincide share one label."""
    merged: list[tuple[Array, list[str]]] = []
    for name, place in places.items():
        same = next((names for other, names in merged if np.abs(other - place).max() < near), None)
        if same is None:
            merged.append((place, [name]))
        else:
            same.append(name)
    return [(place, ", ".join(names)) for place, names in merged]
