"""The plots of a result on a page: charts that its script draws, pictures of the others and where no script runs."""

from __future__ import annotations

from matplotlib.figure import Figure

from robodyn_cli.report.canvas import EMPTY
from robodyn_cli.report.numbers import tied
from robodyn_cli.report.page import tables
from robodyn_cli.report.page.charts import Store, captions, chart_data, curves_data, is_thinned
from robodyn_cli.report.page.tables import Html, element, markup
from robodyn_cli.report.plots.mechanism import mechanism_alone
from robodyn_cli.report.registry import applicable, draw
from robodyn_cli.report.style import styled
from robodyn_cli.results.result import Result

THINNED = "Lines of many samples are thinned: the smallest and the largest of each of some hundred intervals are kept."


def still(result: Result, store: Store) -> list[Html | None]:
    """Return the drawing that stands where no script runs, with its caption."""
    if "mechanism" not in applicable(result):
        return []
    with styled():
        figure = mechanism_alone(result)
        caption = element("noscript", _caption(captions(figure), ""))
        return [store.spare(figure, f"The mechanism of {result.title}"), caption]


def plots_of(result: Result, store: Store, moving: bool) -> Html | None:
    """Return the plots that the result has data for; the drawing stands for that of the mechanism."""
    names = [name for name in applicable(result) if not (name == "mechanism" and moving)]
    if not names:
        return None
    first = len(store.figures)
    with styled():
        figures = {name: draw(result, name) for name in names}
        empty = [name for name, figure in figures.items() if figure.get_label() == EMPTY]
        plots = [_plot(figure, name, store) for name, figure in figures.items() if name not in empty]
    thinned = any(is_thinned(chart) for chart in store.figures[first:])
    said = [THINNED] if thinned else []
    if empty:
        said.append(f"Left out, as all in them is zero or missing: {', '.join(map(_title, empty))}.")
    notes = [element("p", text, class_="note") for text in said]
    return markup([tables.error_note(result.summary), notes, element("div", plots, class_="plots")])


def plot_of(result: Result, name: str, store: Store) -> Html:
    """Return a plot: a chart that follows the drawing where it is over time, else a picture."""
    return _plot(draw(result, name), name, store)


def _title(name: str) -> str:
    return name.replace("_", " ").capitalize()


def _plot(figure: Figure, name: str, store: Store) -> Html:
    data, title = chart_data(figure, store.arrays), _title(name)
    content = [
        element("h3", title),
        _caption(captions(figure), title),
        None if data is None else element("div", class_="chart"),
        store.picture(figure, title) if data is None else store.spare(figure, title),
    ]
    drawn = {"curves": curves_data(figure, store.arrays)} if data is None else data
    there = data is not None or drawn["curves"]
    number_of = store.add({**drawn, "name": title}) if there else None
    return element("figure", content, class_="plot", data_figure=number_of)


def _caption(notes: list[str], title: str) -> Html | None:
    """Return what the figure says of itself beyond its name, a sentence each."""
    text = ". ".join(note.removesuffix(".") for note in notes if note and note != title)
    return element("p", tied(text), class_="caption") if text else None
