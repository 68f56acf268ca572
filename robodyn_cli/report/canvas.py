"""Figures with a fixed layout in inches, what they say about the course of a run, and their way into a file.

Automatic layout draws everything once more to measure it; with legends below the axes and known font sizes
the room needed is known beforehand.
"""

from __future__ import annotations

import math
import textwrap
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from robodyn_cli.record import record
from robodyn_cli.report import numbers, style
from robodyn_cli.report.format import LEFT, NARROW, current
from robodyn_cli.report.style import PlainFormatter
from robodyn_cli.results.atomic import written
from robodyn_cli.results.moments import lock
from robodyn_cli.results.output_dir import CREATOR, MARK
from robodyn_cli.results.result import Result


def failure_note(result: Result) -> list[str]:
    """Return the lines that say that and why a run failed; none if it did not."""
    if result.status != "failed":
        return []
    termination = result.summary.get("termination") or result.attributes.get("termination") or {}
    if not isinstance(termination, dict):
        termination = {"reason": str(termination)}
    reason = str(termination.get("reason") or "reason not recorded")
    time = termination.get("time")
    if not isinstance(time, int | float):
        time = result.time[-1] if result.time.size else math.nan
    return wrapped(f"Run failed at t = {numbers.times([float(time)], 6)[0]}: {reason}", 2)


def wrapped(text: str, most: int | None = None) -> list[str]:
    """Return a note in lines as long as the width of figures allows, ``most`` of them at most; a number and its unit
    stay together."""
    lines = textwrap.wrap(numbers.tied(text), current().characters, max_lines=most)
    return [line.replace("\N{NO-BREAK SPACE}", " ") for line in lines]


def sharing_note(result: Result) -> str:
    """Return the part of a subtitle that says that loads in the loops could be shared in another way; else empty."""
    rows = result.variables.get("constraints/multipliers")
    if rows is None or "least norm" not in rows.long_name:
        return ""
    return ". Not unique, since rows depend on each other: those of least norm"


def torque_note(result: Result) -> str:
    """Return the same for torques that more actuators than needed share."""
    shared = result.summary.get("mechanism")
    torques = str(shared.get("torques", "unique")) if isinstance(shared, dict) else "unique"
    return "" if torques == "unique" else f". Not unique: those of {torques}"


def loop_columns(result: Result, names: tuple[str, ...]) -> list[int]:
    """Return the columns of the multipliers that belong to loops, not to joints moved by prescription."""
    multipliers = lock(result).get("multipliers")
    rows = multipliers.get("rows") if isinstance(multipliers, dict) else None
    columns = [column for column, name in enumerate(names) if name in rows] if isinstance(rows, list) else []
    return columns or list(range(len(names)))


def growth_times(result: Result) -> list[tuple[float, float]]:
    """Return (factor, time) at which the multipliers passed multiples of their running median."""
    table = lock(result).get("growth_times")
    if table is None:
        # Without a lock the run still says which thresholds were passed.
        criteria = result.summary.get("criteria")
        table = criteria.get("growth_times") if isinstance(criteria, dict) else None
    if not isinstance(table, dict):
        return []
    return sorted(
        (float(factor), float(time)) for factor, time in table.items() if isinstance(time, int | float)
    )


# labels of the texts above the panels: a page says titles itself, and sets notes as a caption; of a note that takes
# several lines the further ones
TITLE, NOTE, MORE = "title", "note", "note goes on"
EMPTY = "empty"  # label of a figure in which all curves are zero
RIGHT = 0.3
DEGREES = 0.36
BETWEEN = 0.7
TITLE_LINE, SUBTITLE_LINE = 0.21, 0.18
X_LABEL = 0.52
LEGEND_LINE = 0.19
# Mean advance of a character over the font size; DejaVu Sans is wide.
CHARACTER = 0.62 * style.FONT_SIZE / 72.0
HANDLE = 0.62


@record
class Panels:
    """How a sheet is laid out: ``panels`` of ``height`` inches, ``across`` of them side by side, ``gap`` apart
    vertically and ``between`` horizontally.

    labels : texts of the legend below. degrees : leaves room for a second scale. titled : leaves room for a title
    above the first panels. captions : lines below the subtitle.
    told : lines in the colour of alarms. numbered : leaves room for numbers and a label below the panels.
    """

    panels: int = 1
    across: int = 1
    height: float = 3.3
    gap: float = 0.16
    between: float = BETWEEN
    labels: Sequence[str] = ()
    degrees: bool = False
    titled: bool = False
    captions: Sequence[str] = ()
    told: Sequence[str] = ()
    numbered: bool = True


def panel_width(across: int = 1) -> float:
    """Return the width of each of so many panels side by side [inch]."""
    across = across if current().width >= NARROW else 1
    return (current().width - LEFT - RIGHT - (across - 1) * BETWEEN) / across


class Sheet:
    """A figure with its panels; legend and captions are placed around them."""

    def __init__(self, result: Result, subtitle: str, **layout: Any) -> None:
        """Lay out the panels; ``layout`` : fields of ``Panels``."""
        shape = Panels(**layout)
        form = current()
        panels, height, gap = shape.panels, shape.height, shape.gap
        across = shape.across if form.width >= NARROW else 1
        title = textwrap.wrap(
            result.title or result.command, int(0.8 * form.characters), max_lines=2, placeholder=" ..."
        )
        alarms = [line for text in shape.told for line in wrapped(text, 2)]
        alarms += failure_note(result)
        said = [wrapped(subtitle), *(wrapped(text, 2) for text in shape.captions)]
        labels = [MORE if k else NOTE for own in said for k in range(len(own))]
        notes = [*(line for own in said for line in own), *alarms]
        self.columns, lines = legend_shape(list(shape.labels))
        lines_above = (len(notes) if form.titles else len(alarms)) + (1 if shape.titled else 0)
        top = 0.12 + TITLE_LINE * len(title) * form.titles + SUBTITLE_LINE * lines_above + 0.14
        below = X_LABEL if shape.numbered else 0.1
        bottom = below + (LEGEND_LINE * lines + 0.1 if lines else 0.0) + 0.04
        rows = math.ceil(panels / across)
        total = top + rows * height + (rows - 1) * gap + bottom
        WIDTH = form.width
        self.figure = Figure(figsize=(WIDTH, total), dpi=form.dpi)
        width = WIDTH - LEFT - RIGHT - (DEGREES if shape.degrees else 0.0)
        wide = (width - (across - 1) * shape.between) / across
        self.across = across
        self.axes: list[Axes] = []
        for panel in range(panels):
            row, column = divmod(panel, across)
            x = LEFT + column * (wide + shape.between)
            y = bottom + (rows - 1 - row) * (height + gap)
            self.axes.append(self.figure.add_axes((x / WIDTH, y / total, wide / WIDTH, height / total)))
            self.axes[-1].yaxis.set_major_formatter(PlainFormatter(LEFT if column == 0 else shape.between))
        self.notes: list[Any] = []
        y = total - 0.12
        for line in title:
            self._text(LEFT, y, total, line, label=TITLE, fontsize=11, fontweight="bold", visible=form.titles)
            y -= TITLE_LINE * form.titles
        for index, line in enumerate(notes):
            alarm = index >= len(notes) - len(alarms)
            looks = (
                {"label": TITLE, "color": style.ALARM}
                if alarm
                else {"label": labels[index], "color": style.GREY, "visible": form.titles}
            )
            self.notes.append(self._text(LEFT, y, total, line, **looks))
            y -= SUBTITLE_LINE if alarm or form.titles else 0.0
        self._legend_at = ((LEFT - 0.1) / WIDTH, (bottom - below) / total)

    @property
    def ax(self) -> Axes:
        """The first panel."""
        return self.axes[0]

    def legend(self, handles: list[Any], labels: list[str] | tuple[str, ...]) -> None:
        """Put the legend below the panels, in the columns foreseen."""
        if not labels:
            return
        self.figure.legend(
            handles,
            # A leading underscore would hide the entry.
            [folded(f" {label}" if label.startswith("_") else label) for label in labels],
            loc="upper left",
            bbox_to_anchor=self._legend_at,
            ncols=self.columns,
            borderaxespad=0.0,
            borderpad=0.1,
            handlelength=2.6,
            columnspacing=1.6,
            labelspacing=0.3,
        )

    def _text(self, x: float, y: float, total: float, text: str, **style_: Any) -> Any:
        return self.figure.text(x / current().width, y / total, text, ha="left", va="top", **style_)


def legend_shape(labels: tuple[str, ...] | list[str]) -> tuple[int, int]:
    """Return how many columns and lines a legend of ``labels`` takes below the axes."""
    if not labels:
        return 1, 0
    entry = HANDLE + CHARACTER * max(len(label) for label in labels)
    columns = max(1, min(len(labels), int((current().width - LEFT) / entry)))
    lines = math.ceil(len(labels) / columns)
    more = max(folded(label).count("\n") for label in labels)
    # As few columns as the lines allow: 9 names in 5 + 4, not 8 + 1.
    return math.ceil(len(labels) / lines), lines * (1 + more)


def folded(label: str) -> str:
    """Return a label of a legend, in lines where it is wider than the figure."""
    most = int((current().width - 0.2 - HANDLE) / CHARACTER)
    return label if len(label) <= most else textwrap.fill(label, most, subsequent_indent="  ")


def save(figure: Figure, target: Path) -> Path:
    """Draw ``figure`` once and store it as ``target``, whole or not at all, marked as ours; return ``target``.

    The suffix says how: ``.png``, ``.svg`` or ``.pdf``. The same figure gives the same bytes.
    """
    # No sync: a drawing can be made again from the result, and a sync is as slow as a plot.
    with written(target) as temporary:
        print_figure(figure, temporary, target.suffix)
    return target


def print_figure(figure: Figure, file: Path | BinaryIO, suffix: str, part: Bbox | None = None) -> None:
    """Draw ``figure``, or the ``part`` of it between these corners [in], as the kind that a suffix names."""
    kind = suffix.lower()
    with warnings.catch_warnings(), rc_context({"svg.hashsalt": MARK}):
        # A title in a script that the font lacks shows boxes; that is no news for a user of the tool.
        warnings.filterwarnings("ignore", message="Glyph .* missing")
        style.prefix_axes(figure)
        style.number_log_axes(figure)
        style.place_offsets(figure)
        OpaqueCanvas(figure)
        figure.savefig(file, format=kind[1:], bbox_inches=part, **_described(figure, kind))


class OpaqueCanvas(FigureCanvasAgg):
    """Writes PNG without transparency, which no drawing has: a fifth less to compress."""

    def print_png(
        self, filename_or_obj: Any, *, metadata: Any = None, pil_kwargs: Any = None, **_: Any
    ) -> None:
        """Draw the figure and write it."""
        self.draw()  # type: ignore[no-untyped-call]
        words = PngInfo()
        for key, text in metadata.items():
            words.add_text(key, text)
        image = Image.fromarray(np.asarray(self.buffer_rgba())).convert("RGB")  # type: ignore[no-untyped-call]
        dpi = self.figure.dpi
        image.save(filename_or_obj, "png", pnginfo=words, dpi=(dpi, dpi), **pil_kwargs)


def below_heading(figure: Figure) -> Bbox | None:
    """Hide the title of a sheet and the lines below it; return the part that is left [in], None without a heading."""
    heading = [text for text in figure.texts if text.get_label() in (TITLE, NOTE, MORE)]
    if not heading:
        return None
    for text in heading:
        text.set_visible(False)
    width, height = figure.get_size_inches()
    last = min(text.get_position()[1] for text in heading)
    return Bbox.from_bounds(0.0, 0.0, width, last * height - SUBTITLE_LINE)


def _described(figure: Figure, kind: str) -> dict[str, Any]:
    """Return how a kind of file is written, with the heading of the figure in its metadata."""
    own = PRINTED[kind]
    title = " ".join(text.get_text() for text in figure.texts if text.get_label() == TITLE)
    notes = " ".join(text.get_text() for text in figure.texts if text.get_label() in (NOTE, MORE))
    words = {"Title": title, "Subject" if kind == ".pdf" else "Description": notes}
    return {**own, "metadata": {**own["metadata"], **{key: text for key, text in words.items() if text}}}


# The strongest compression costs as much as the drawing and saves a tenth.
PRINTED: dict[str, dict[str, Any]] = {
    ".png": {"metadata": {"Software": MARK}, "pil_kwargs": {"compress_level": 3}},
    ".svg": {"metadata": {"Creator": CREATOR, "Date": None}},
    ".pdf": {"metadata": {"Creator": CREATOR, "CreationDate": None}},
}
