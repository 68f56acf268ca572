"""Plots over the position of a joint in place of time, as `outputs.abscissa` asks for: what is drawn over time is moved
to where the joint is at these times."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon, Rectangle
from matplotlib.text import Annotation

from robodyn_cli.report.lines import finite
from robodyn_cli.report.style import PlainFormatter
from robodyn_cli.results.result import Result, column_names, units_of
from robodyn_cli.spatial.algebra import Array

ABSCISSA = "abscissa"  # attribute of a result


def abscissa(result: Result) -> tuple[str, Array] | None:
    """Return the label and the positions (T,) of the joint over which plots are drawn; None: they are over time."""
    name = str(result.attributes.get(ABSCISSA, ""))
    if not name or "q" not in result or name not in column_names(result.variables["q"]):
        return None
    variable = result.variables["q"]
    k = column_names(variable).index(name)
    turns = units_of(variable)[k] == "rad"
    x = finite(variable.data[:, k])
    return f"{name} [{'deg' if turns else units_of(variable)[k]}]", np.degrees(x) if turns else x


def over_joint(result: Result, axes: Sequence[Axes]) -> None:
    """Move what is drawn over time on axes to the positions of the joint of the abscissa, where there is one.

    Maps, which need even steps, stay over time, and of a joint that turns back nothing is hatched.
    """
    own = abscissa(result)
    if own is None:
        return
    label, x = own
    known = np.isfinite(x)
    if np.count_nonzero(known) < 2 or not np.ptp(x[known]) > 0.0:
        return
    times, places = result.time[known], x[known]
    one_way = bool((np.diff(places) >= 0.0).all() or (np.diff(places) <= 0.0).all())
    for ax in axes:
        if ax.images:
            continue
        low, high = ax.get_xlim()
        inside = np.concatenate([[low, high], times[(times >= low) & (times <= high)]])
        ends = np.interp(inside, times, places)
        for artist in [*ax.lines, *ax.collections, *ax.patches, *ax.texts]:
            _move(ax, artist, times, places, one_way)
        room = 0.0 if np.ptp(ends) > 0.0 else 0.5
        ax.set_xlim(float(ends.min()) - room, float(ends.max()) + room)
        if ax.get_xlabel():
            ax.set_xlabel(label)
            ax.xaxis.set_major_formatter(PlainFormatter())


def _move(ax: Axes, artist: Any, times: Array, places: Array, one_way: bool) -> None:
    """Move an artist whose x is a time."""

    def moved(t: Any) -> Array:
        return np.asarray(np.interp(np.asarray(t, dtype=float), times, places))

    if isinstance(artist, Annotation):
        artist.xy = (float(moved(artist.xy[0])), artist.xy[1])
    elif not artist.get_transform().contains_branch_seperately(ax.transData)[0]:
        return
    elif isinstance(artist, Line2D):
        artist.set_xdata(moved(artist.get_xdata()))
    elif isinstance(artist, Rectangle):
        ends = np.sort(moved([artist.get_x(), artist.get_x() + artist.get_width()]))
        artist.set_x(ends[0])
        artist.set_width(ends[1] - ends[0])
        artist.set_visible(one_way)
    elif isinstance(artist, Polygon):
        corners = np.asarray(artist.get_xy())
        artist.set_xy(np.column_stack([moved(corners[:, 0]), corners[:, 1]]))
        artist.set_visible(one_way)
    elif isinstance(artist, (LineCollection, PolyCollection)):
        for path in artist.get_paths():
            vertices = np.asarray(path.vertices)
            path.vertices = np.column_stack([moved(vertices[:, 0]), vertices[:, 1]])
