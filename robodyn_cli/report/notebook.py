"""A result as a notebook shows it: its main figures with an error beside each, and a picture."""

from __future__ import annotations

import base64
import functools
import html
import io
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from robodyn_cli.errors import CapabilityError
from robodyn_cli.report.cells import Table
from robodyn_cli.report.figures import MOST_ROWS, alarms, notes, tables
from robodyn_cli.report.numbers import typeset
from robodyn_cli.results.result import Result

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PICTURE_WIDTH = 480  # pixels on the screen; the picture has more, for dense ones
# what is drawn beside the tables: the first of these that there is, or of all plots, and what comes after it
FIRST, BESIDE = ("nyquist", "mechanism"), ("tracking",)
PADDING = "padding:0.1em 0.6em"


def plot(result: Result, name: str) -> Figure:
    """Return a plot of a result, which a notebook shows and ``savefig`` stores.

    Raises
    ------
    CapabilityError : there is no such plot, or the result has no data for it.
    """
    from robodyn_cli.report.registry import applicable, draw

    possible = applicable(result)
    if name not in possible:
        raise CapabilityError(f"no plot {name!r} of this result; possible: {', '.join(possible) or 'none'}")
    figure = draw(result, name)
    # notebooks ask an object itself where pyplot has not told them what to do with figures
    vars(figure)["_repr_png_"] = functools.partial(png, figure)
    return figure


def png(figure: Figure) -> bytes:
    """Return a drawing as PNG."""
    from robodyn_cli.report.canvas import print_figure
    from robodyn_cli.report.style import styled

    stream = io.BytesIO()
    with styled():
        print_figure(figure, stream, ".png")
    return stream.getvalue()


def as_html(result: Result) -> str:
    """Return what a notebook shows: tables, notes, and the loop, the mechanism, or else the first plot with data; of a
    controller how it follows, too."""
    from robodyn_cli.report.registry import applicable, draw

    possible = applicable(result)
    first = next((name for name in (*FIRST, *possible) if name in possible), None)
    shown = [name for name in dict.fromkeys((first, *BESIDE)) if name in possible]
    pictures = "".join(_picture(name, png(draw(result, name))) for name in shown if name is not None)
    head = f"<b>{html.escape(result.title)}</b><br>{html.escape(f'{result.command}: {result.status}')}"
    said = "".join(f"<br>{html.escape(typeset(text))}" for text in [*notes(result), *alarms(result)])
    # where tables are wider than the page they scroll alone: what is said of them keeps to it
    left = f'<div style="max-width:100%"><p>{head}{said}</p>{"".join(_table(table) for table in tables(result))}</div>'
    return f'<div style="display:flex;flex-wrap:wrap;gap:2em;align-items:flex-start">{left}{pictures}</div>'


def _picture(name: str, content: bytes) -> str:
    data = base64.b64encode(content).decode()
    return f'<img alt="{name}" width="{PICTURE_WIDTH}" src="data:image/png;base64,{data}">'


def _table(table: Table) -> str:
    more = len(table.rows) - MOST_ROWS
    rows = "".join(_row(row, "td") for row in table.rows[:MOST_ROWS])
    foot = f"<p>and {more} more</p>" if more > 0 else ""
    foot += f"<p><small>{html.escape(typeset(table.meaning))}</small></p>" if table.meaning else ""
    # a row of empty headers would be read aloud as such
    head = f"<thead>{_row(table.head, 'th')}</thead>" if any(table.head) else ""
    return f'<div style="overflow-x:auto"><table>{head}<tbody>{rows}</tbody></table></div>{foot}'


def _row(cells: Sequence[Any], kind: str) -> str:
    first, *others = (html.escape(typeset(str(cell))) for cell in cells)
    right = "".join(f'<{kind} style="text-align:right;{PADDING}">{cell}</{kind}>' for cell in others)
    return f'<tr><th style="text-align:left;{PADDING}">{first}</th>{right}</tr>'
