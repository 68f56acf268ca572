"""Several results beside one another: figures in one table, signals in one chart, and what tells the scenes apart."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from robodyn_cli.report.lines import envelope
from robodyn_cli.report.numbers import labelled, typeset, unit
from robodyn_cli.report.overlay import OVERLAID, series_of
from robodyn_cli.report.page.charts import Arrays, looks
from robodyn_cli.report.page.compared import (
    DIFFER,
    OPEN,
    WITHIN,
    SideBySide,
    compared,
    number_of,
    without_loners,
)
from robodyn_cli.report.page.tables import Html, Quantity, element, written
from robodyn_cli.report.page.verdict import verdicts
from robodyn_cli.results.result import Result
from robodyn_cli.results.stated_errors import meaningful_until

WHOLE = 12  # results that have drawings and plots of their own
DRAWINGS = 120  # results that have a small drawing, which is made where it is opened; in all as large as that of three
ABREAST = 6  # results that stand side by side; more are rows
MOST_FIGURES = 80  # of the table
POINTS = 600_000  # of all lines over one another: 10 MB as text
FEWEST = 60  # of a line
DRAWN = 8  # results whose lines are seen first
MARKS = {
    DIFFER: ("≠", "differ by more than their errors"),
    WITHIN: ("≈", "differ within their errors"),
    OPEN: ("?", "differ, and not all state an error"),
}


# -- the table ------------------------------------------------------------------------------------------------
def figures_table(labels: Sequence[str], found: Sequence[SideBySide]) -> Html:
    """Return the table of figures: a column a result where there are few, else a row a result."""
    marks = [one.mark for one in found]
    if len(labels) <= ABREAST:
        head = ["", *(_name(k, label, "col") for k, label in enumerate(labels))]
        rows = [
            [_figure_head(one, marks[n], "row"), *(_cell(value, k, n) for k, value in enumerate(one.values))]
            for n, one in enumerate(found)
        ]
        content = [
            element("tr", row, class_=f"{mark} figure".strip(), data_figure_row=str(n))
            for n, (row, mark) in enumerate(zip(rows, marks))
        ]
    else:
        head = ["", *(_figure_head(one, marks[n], "col", n) for n, one in enumerate(found))]
        content = [
            element(
                "tr",
                _name(k, label, "row"),
                [_cell(one.values[k], k, n, marks[n]) for n, one in enumerate(found)],
                data_of=str(k),
            )
            for k, label in enumerate(labels)
        ]
    tops = [x if isinstance(x, Html) else element("td", x) for x in head]
    table = element("table", element("thead", element("tr", tops)), element("tbody", content))
    return element("div", table, class_="wide sided", tabindex="0", role="region", aria_label="Figures")


def _name(k: int, label: str, scope: str) -> Html:
    link = element("a", label, href=f"#result-{k + 1}")
    return element("th", link, scope=scope, data_of=str(k) if scope == "col" else None)


def _figure_head(one: SideBySide, mark: str, scope: str, n: int | None = None) -> Html:
    """Return the name of a figure with the mark that tells whether it differs."""
    name = one.name.replace("_", " ") if not one.given else one.name
    # a line may end behind a dot
    words: list[Any] = [element("span", [(part, element("wbr")) for part in re.split(r"(?<=\.)", name)])]
    if mark in MARKS:
        sign, meaning = MARKS[mark]
        words.append(
            element(
                "span",
                f"\N{NO-BREAK SPACE}{sign}",
                class_="mark",
                title=meaning,
                role="img",
                aria_label=meaning,
            )
        )
    if n is None:
        return element("th", words, scope=scope)
    button = element("button", words, type="button", class_="sort", data_sort=str(n))
    return element("th", button, scope=scope, class_=mark or None)


def _cell(value: Any, k: int, n: int, mark: str = "") -> Html:
    """Return a cell with its number and error for the script that makes differences."""
    number = number_of(value)
    if value is None:
        return element("td", data_of=str(k), data_row=str(n))
    data = {} if number is None else {"data_v": repr(number[0]), "data_e": repr(number[1])}
    if number is not None and isinstance(value, Quantity):
        data["data_u"] = unit(value.unit)
        data["data_known"] = "yes" if value.error is not None else "no"
    text = typeset(value) if isinstance(value, str) else written(value)
    shown = "number" if number is not None else ""
    return element(
        "td", text, class_=f"{shown} {mark}".strip() or None, data_of=str(k), data_row=str(n), **data
    )


# -- lines over one another -----------------------------------------------------------------------------------
def overlay_data(labels: Sequence[str], results: Sequence[Result], arrays: Arrays) -> dict[str, Any]:
    """Return the signals of several results, those that most of them have first; arrays go into ``arrays``.

    Lines of long results are thinned to their smallest and largest samples, so that a page stays small.
    """
    signals: dict[tuple[str, str, str], list[tuple[int, Any, Any]]] = {}
    for k, result in enumerate(results):
        for plot in OVERLAID:
            for (name, units), (time, one) in series_of(result, plot).items():
                signals.setdefault((plot, name, units), []).append((k, time, one))
    lines = sum(len(lines) for lines in signals.values())
    most = max(FEWEST, POINTS // max(1, lines))
    listed = []
    for (plot, name, units), of in sorted(signals.items(), key=lambda item: -len(item[1])):
        own = []
        for k, time, one in of:
            x, y = dataclasses.replace(one, apart=None).lines(time)[0]
            x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
            kept = envelope(x, y, max(1, most // 4))
            thinned = len(kept[0]) < len(x)
            error = float(one.error[0])
            own.append(
                {
                    "of": k,
                    "x": arrays.put(kept[0], double=not thinned),
                    "y": arrays.put(kept[1], double=not thinned and len(results) <= WHOLE),
                    "thinned": thinned,
                    "dotted": bool(one.gaps(0).any()),  # a line would hide the motion somewhere
                    "error": error if math.isfinite(error) else None,
                }
            )
        words = f"{plot.replace('_', ' ')}: {name}"
        listed.append({"name": words, "label": labelled(name, units), "unit": unit(units), "lines": own})
    ends = [meaningful_until(result.summary) for result in results]
    return {
        "labels": list(labels),
        "looks": looks(len(results)),
        "signals": listed,
        "until": [end if math.isfinite(end) else None for end in ends],
    }


# -- the page -------------------------------------------------------------------------------------------------
def beside(
    titles: Sequence[tuple[str, str]], results: Sequence[Result], arrays: Arrays
) -> tuple[Html, dict[str, Any]]:
    """Return the list of results and what stands above them, and what the script shows of them.

    titles : label of each result on this page, and its words for the list.
    """
    labels = [label for label, _ in titles]
    data = overlay_data(labels, results, arrays)
    found = compared(results)
    told = without_loners(found, results)
    return element("div", _compare(labels, told, len(found) - len(told), data), class_="compare"), data


def contents(titles: Sequence[tuple[str, str]], results: Sequence[Result]) -> Html:
    """Return the list of results: a box for its lines, a link, what became of it."""
    rows = []
    for k, ((label, words), result) in enumerate(zip(titles, results)):
        outcome = [
            [element("span", one.words, class_="alarm" if one.alarming else None), ", "]
            for one in verdicts(result)
        ]
        box = element(
            "input", type="checkbox", checked=k < DRAWN, data_line=str(k), aria_label=f"lines of {label}"
        )
        rows.append(
            element(
                "li",
                box,
                element("svg", class_="swatch", viewBox="0 0 30 12", aria_hidden="true"),
                element("a", label, href=f"#result-{k + 1}"),
                element("small", outcome, words),
                data_of=str(k),
            )
        )
    count = f"{len(results)} results"
    asked = element(
        "label",
        element("span", "Filter results"),
        element("input", type="search", class_="filter", autocomplete="off", spellcheck="false"),
        class_="asked",
    )
    all_of = element(
        "p",
        element("button", "all lines", type="button", data_all="yes"),
        " ",
        element("button", "no lines", type="button", data_all="no"),
        class_="asked",
    )
    told = element("p", count, class_="note count", role="status")
    return element("nav", [asked, told, all_of, element("ol", rows)], aria_label="Results", class_="results")


def _compare(
    labels: Sequence[str], found: Sequence[SideBySide], alone: int, data: Mapping[str, Any]
) -> list[Html]:
    """Return the table of figures and the chart of signals, with what is asked of them.

    alone : how many figures are left out as one result has them alone.
    """
    choices = [element("option", label, value=str(k)) for k, label in enumerate(labels)]
    to = element(
        "label",
        "Differences to ",
        element("select", [element("option", "none", value=""), *choices], class_="to"),
        class_="asked",
    )
    few = element(
        "label", element("input", type="checkbox", class_="differing"), "only what differs", class_="asked"
    )
    left = len(found) - MOST_FIGURES
    more = f" {left} more figures, those that differ least, stand with each result." if left > 0 else ""
    more += f" {alone} figures that one result alone can have stand with it." if alone else ""
    legend = (
        "≠ differ by more than their errors; ≈ differ within them; ? differ, and not all state an error; blank: the "
        "result has no such figure. "
        "A difference without ± is of figures of which one states no error."
    )
    parts = [
        element("h2", "Side by side", id="side-by-side"),
        element("p", [to, few], class_="controls"),
        element("p", legend + more, class_="note"),
        figures_table(labels, found[:MOST_FIGURES]),
    ]
    if data["signals"]:
        options = [
            element("option", f"{one['name']} ({len(one['lines'])})", value=str(k))
            for k, one in enumerate(data["signals"])
        ]
        asked = element("label", "Signal ", element("select", options, class_="signal"))
        chart = [element("p", asked, class_="controls"), element("div", class_="drawn")]
        parts.append(
            element(
                "figure",
                element("h3", "Over one another"),
                chart,
                element("p", class_="note told", role="status"),
                class_="overlay",
            )
        )
    return parts
