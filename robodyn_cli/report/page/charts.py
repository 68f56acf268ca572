"""What the script of a page draws: figures, and their arrays as text.

Figures over time as data for the browser: what their axes show, read off the figures themselves.

So a plot is described once, in ``report/plots``, with its units, captions and marks. Figures that are not over time, or
hold more than lines, bands and words, go into the page as pictures.
"""

from __future__ import annotations

import base64
import hashlib
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backend_bases import RendererBase
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Annotation

from robodyn_cli.report.canvas import MORE, NOTE
from robodyn_cli.report.lines import envelope
from robodyn_cli.report.page.pictures import picture
from robodyn_cli.report.page.tables import Html, element
from robodyn_cli.report.style import line_styles
from robodyn_cli.report.time_sheet import CLOSE_UP
from robodyn_cli.spatial.algebra import Array


class Arrays:
    """The arrays of a page, each stored once and known by its number."""

    def __init__(self) -> None:
        self.packed: list[dict[str, Any]] = []
        self._numbers: dict[tuple[bytes, tuple[int, ...], str], int] = {}

    def put(self, array: Array, double: bool = False) -> int:
        """Return the number of an array, kept with 7 digits, or with all of them if ``double``."""
        kind = "<f8" if double else "<f4"
        # what single precision cannot hold is drawn nowhere
        with np.errstate(over="ignore"):
            content = np.ascontiguousarray(array, dtype=kind)
        data = content.tobytes()
        key = hashlib.sha256(data).digest(), content.shape, kind
        if key not in self._numbers:
            self._numbers[key] = len(self.packed)
            text = base64.b64encode(data).decode()
            self.packed.append({"type": kind[1:], "shape": content.shape, "data": text})
        return self._numbers[key]


class Store:
    """What the script of a page draws and runs: figures, the arrays that they hold by number, and scenes."""

    def __init__(self) -> None:
        self.arrays = Arrays()
        self.figures: list[dict[str, Any]] = []
        self.running: dict[str, list[Mapping[str, Any]]] = {}
        self.pictures = 0

    def add(self, figure: dict[str, Any]) -> int:
        """Return the number of a figure."""
        self.figures.append(figure)
        return len(self.figures) - 1

    def picture(self, figure: Figure, label: str) -> Html:
        """Return a figure as a picture, which the script has nothing to do with."""
        self.pictures += 1
        return picture(figure, label, self.pictures)

    def spare(self, figure: Figure, label: str) -> Html:
        """Return a figure as a picture that stands where no script runs."""
        return element("noscript", self.picture(figure, label))

    def run(self, scene: Mapping[str, Any]) -> int:
        """Return the number of a scene that runs in the page."""
        scenes = self.running.setdefault("live", [])
        scenes.append(scene)
        return len(scenes) - 1


TIME = "time [s]"
BINS = 400  # of a line: its smallest and largest value in each are kept


def chart_data(figure: Figure, arrays: Arrays) -> dict[str, Any] | None:
    """Return the panels and the legend of a figure over time, None for any other; arrays go into ``arrays``."""
    # the page shows any part of the time closely itself
    panels = [
        ax for ax in figure.axes if (ax.lines or ax.collections or ax.images) and ax.get_label() != CLOSE_UP
    ]
    if not any(ax.get_xlabel() == TIME for ax in panels) or not all(_plain(ax) for ax in panels):
        return None
    legend = [
        _entry(handle, text)
        for box in figure.legends
        for handle, text in zip(box.legend_handles, _texts(box))
    ]
    return {"panels": [_panel(ax, legend, arrays) for ax in panels], "legend": legend}


MOST_POINTS = 60_000  # of the curves of a picture, whose numbers the page has too


def curves_data(figure: Figure, arrays: Arrays) -> list[dict[str, Any]]:
    """Return the curves of a figure that is a picture, each with its name and the labels of its axes, for a file of
    their numbers: those that the legend names, or all where there is none, and the rows of maps, which are lines that
    are not seen. None of them where there are very many points; arrays go into ``arrays``."""
    named = {
        _look(_entry(handle, "")): text
        for box in figure.legends
        for handle, text in zip(box.legend_handles, _texts(box))
        if isinstance(handle, Line2D)
    }
    found: list[tuple[str, str, str, Array, Array]] = []
    for ax in figure.axes:
        # of panels above one another the lowest is labelled; what is seen in perspective has no axes
        below = (one.get_xlabel() for one in figure.axes if one.get_xlim() == ax.get_xlim())
        across, label = ax.get_xlabel() or next(filter(None, below), ""), ax.get_ylabel()
        label = label or (ax.get_title(loc="left") if ax.images else "")
        for line in ax.lines if across and label else ():
            own = line.get_transform().contains_branch_seperately(ax.transData) == (True, True)
            name = named.get(_look(_style(line)), "" if named else f"curve {len(found) + 1}")
            name = name if line.get_visible() else str(line.get_label())
            x, y = (np.asarray(part, dtype=float) for part in line.get_data(orig=False))
            if own and name and len(x) > 2:
                title = " ".join(ax.get_title(loc="left").split()) if line.get_visible() else ""
                found.append((f"{title}: {name}" if title else name, across, label, x, y))
    if sum(len(x) for *_, x, _ in found) > MOST_POINTS:
        return []
    return [
        {"name": name, "across": across, "label": label, "x": arrays.put(x), "y": arrays.put(y)}
        for name, across, label, x, y in found
    ]


def is_thinned(chart: dict[str, Any]) -> bool:
    """Tell whether lines of a chart have fewer points than the figure."""
    return any(line["thinned"] for panel in chart.get("panels", ()) for line in panel["lines"])


def captions(figure: Figure) -> list[str]:
    """Return the notes above the panels that say what is shown, with its figures."""
    notes: list[str] = []
    for text in figure.texts:
        if text.get_label() == NOTE:
            notes.append(text.get_text())
        elif text.get_label() == MORE:
            notes[-1] += f" {text.get_text()}"
    return notes


def _texts(box: Any) -> list[str]:
    return [text.get_text().strip() for text in box.get_texts()]


def _plain(ax: Axes) -> bool:
    """Tell whether axes hold only what the browser draws."""
    return not ax.images and all(isinstance(item, LineCollection | PolyCollection) for item in ax.collections)


def _panel(ax: Axes, legend: list[dict[str, Any]], arrays: Arrays) -> dict[str, Any]:
    lines = [_line(ax, line, arrays) for line in ax.lines if line.get_visible()]
    of_lines = [x for x in ax.collections if isinstance(x, LineCollection)]
    of_errors = [x for x in ax.collections if isinstance(x, PolyCollection)]
    lines += [item for collection in of_lines for item in _collected(ax, collection, arrays)]
    looks = {_look(entry): place for place, entry in reversed(list(enumerate(legend)))}
    for line in lines:
        line["entry"] = looks.get(_look(line))
        line["of"] = _owner(line, legend)
    return {
        "title": ax.get_title(loc="left") or None,
        "label": ax.get_ylabel(),
        "log": ax.get_yscale() == "log",
        "numbered": len(ax.get_yticks()) > 0,
        "x": [float(x) for x in ax.get_xlim()],
        "y": [float(y) for y in ax.get_ylim()],
        "lines": lines,
        "bands": [_band(ax, patch) for patch in ax.patches],
        "errors": [_error(collection, arrays) for collection in of_errors],
        "notes": [_note(text) for text in ax.texts if isinstance(text, Annotation)],
    }


def _look(item: dict[str, Any]) -> tuple[Any, ...]:
    """Return what tells lines apart in a legend: a thin line beside a heavy one is another."""
    marker = None if item["width"] else item["marker"]
    return item["colour"], tuple(round(x, 3) for x in item["dashes"]), round(item["width"], 3), marker


def _owner(line: dict[str, Any], legend: list[dict[str, Any]]) -> int | None:
    """Return the entry of the legend that a line belongs to and is hidden with: its own, or the only one of its colour.

    Lines from the bottom to the top mark times, which are of all.
    """
    if line["entry"] is not None or line["spans"][1]:
        return line["entry"]
    same = [place for place, entry in enumerate(legend) if entry["colour"] == line["colour"]]
    return same[0] if len(same) == 1 else None


def _entry(handle: Any, text: str) -> dict[str, Any]:
    if isinstance(handle, Line2D):
        return {**_style(handle), "text": text, "band": False}
    colour = to_hex(handle.get_facecolor())
    return {"colour": colour, "dashes": [], "width": 0.0, "marker": None, "text": text, "band": True}


def _style(line: Line2D) -> dict[str, Any]:
    """Return the look of a line: colour, width [pt], dashes over the width, marker and its colours."""
    shown = line.get_linestyle() not in ("None", "none", "", " ")
    marker = line.get_marker()
    marked = marker not in ("None", "none", "", " ", None)
    return {
        "colour": to_hex(line.get_color() if shown else line.get_markeredgecolor()),
        "width": line.get_linewidth() if shown else 0.0,
        "dashes": _dashes(line) if shown else [],
        "alpha": 1.0 if line.get_alpha() is None else line.get_alpha(),
        "marker": str(marker) if marked else None,
        "fill": to_hex(line.get_markerfacecolor()) if marked else None,
    }


def looks(count: int) -> list[dict[str, Any]]:
    """Return the looks of so many lines of one plot."""
    return [_style(Line2D([], [], **look)) for look in line_styles(count)]


class _Dashes(RendererBase):
    """Notes how a line is dashed: matplotlib tells that to renderers alone."""

    found: list[float]

    def draw_path(self, gc: Any, path: Any, transform: Any, rgbFace: Any = None) -> None:
        self.found = [float(x) for x in gc.get_dashes()[1] or ()]


def _dashes(line: Line2D) -> list[float]:
    """Return the dashes of a line [pt], none where it is solid."""
    if line.get_linestyle() == "-":
        return []
    sample = Line2D([0.0, 1.0], [0.0, 1.0])
    sample.update_from(line)
    sample.set_marker("None")
    recorder = _Dashes()
    recorder.found = []
    sample.draw(recorder)
    return recorder.found


def _line(ax: Axes, line: Line2D, arrays: Arrays) -> dict[str, Any]:
    """Return a line with its points; coordinates from 0 to 1 along an axis whose data it does not have."""
    x, y = (np.asarray(part, dtype=float) for part in line.get_data())
    return {**_style(line), **_points(ax, line, x, y, arrays)}


def _points(ax: Axes, artist: Any, x: Array, y: Array, arrays: Arrays) -> dict[str, Any]:
    along_x, along_y = artist.get_transform().contains_branch_seperately(ax.transData)
    thin_x, thin_y = envelope(x, y, BINS)
    thinned = len(thin_x) < len(x)
    return {
        "x": arrays.put(thin_x, double=True),  # times of the cursor are compared with them
        "y": arrays.put(thin_y, double=_is_narrow(thin_y)),
        "spans": [not along_x, not along_y],
        "thinned": thinned,
    }


def _is_narrow(y: Array) -> bool:
    """Tell whether values differ so little that single precision would make stairs of their line."""
    finite = y[np.isfinite(y)]
    return bool(finite.size) and 0.0 < np.ptp(finite) < 1e-4 * np.abs(finite).max()


def _collected(ax: Axes, collection: Any, arrays: Arrays) -> list[dict[str, Any]]:
    """Return the lines of a collection."""
    segments, drawn = collection.get_segments(), []
    colours, widths = collection.get_colors(), collection.get_linewidths()
    dashes = collection.get_linestyles()
    for k, points in enumerate(segments):
        _, pattern = dashes[k % len(dashes)]
        look = {
            "colour": to_hex(colours[k % len(colours)]),
            "width": float(widths[k % len(widths)]),
            "dashes": [float(x) for x in pattern or ()],
            "alpha": 1.0 if collection.get_alpha() is None else collection.get_alpha(),
            "marker": None,
            "fill": None,
        }
        drawn.append({**look, **_points(ax, collection, points[:, 0], points[:, 1], arrays)})
    return drawn


def _band(ax: Axes, patch: Any) -> dict[str, Any]:
    """Return a band across the panel, from side to side or from below upwards; ``hatched`` where it covers curves."""
    box = patch.get_window_extent().transformed(ax.transData.inverted())
    alpha, hatched = patch.get_alpha(), bool(patch.get_hatch())
    low, high = sorted((float(box.y0), float(box.y1)))
    left, right = sorted((float(box.x0), float(box.x1)))
    return {
        "low": low,
        "high": high,
        "left": left,
        "right": right,
        "hatched": hatched,
        "colour": to_hex(patch.get_edgecolor() if hatched else patch.get_facecolor()),
        "alpha": 1.0 if alpha is None else alpha,
    }


def _error(collection: Any, arrays: Arrays) -> dict[str, Any]:
    """Return the band of an error about a curve: corners of the areas that it consists of, a gap between two."""
    gap = np.full((1, 2), np.nan)
    corners = [part for path in collection.get_paths() for part in (path.vertices, gap)] or [gap]
    x, y = np.concatenate(corners).T
    look = {"colour": to_hex(collection.get_facecolor()[0]), "alpha": collection.get_alpha() or 1.0}
    return {**look, "x": arrays.put(x, double=True), "y": arrays.put(y, double=_is_narrow(y))}


def _note(text: Annotation) -> dict[str, Any]:
    x, y = (float(value) for value in text.xy)
    return {
        "text": text.get_text(),
        "x": x,
        "y": y if math.isfinite(y) else 0.0,
        "colour": to_hex(text.get_color()),
    }
