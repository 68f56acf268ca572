"""HTML, in which every text that is not markup itself is escaped.

Tables of what a result says in words and numbers: its summary, its plan, errors beside figures, where it is from.
"""

from __future__ import annotations

import html
import json
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from robodyn_cli.record import record
from robodyn_cli.report import figures
from robodyn_cli.report.style import number, unit
from robodyn_cli.report.time_sheet import told
from robodyn_cli.results.result import Result
from robodyn_cli.results.stated_errors import concerning

UnitOfKey = Callable[[str], str]
VOID = ("input", "meta", "img", "br")


class Html(str):
    """Text that is markup already."""


def markup(content: Any) -> Html:
    """Return content as markup: text is escaped, lists and tuples are joined, None is nothing."""
    if isinstance(content, Html):
        return content
    if content is None:
        return Html("")
    if isinstance(content, list | tuple):
        return Html("".join(markup(item) for item in content))
    return Html(html.escape(str(content)))


def element(name: str, /, *content: Any, **attributes: Any) -> Html:
    """Return an element with escaped attributes; True is one without a value, None and False are left out.

    Underscores of names become hyphens, and a last one, as in ``class_``, is dropped.
    """
    words = []
    for key, value in attributes.items():
        attribute = key.rstrip("_").replace("_", "-")
        if value is True:
            words.append(f" {attribute}")
        elif value is not None and value is not False:
            words.append(f' {attribute}="{html.escape(str(value))}"')
    start = f"<{name}{''.join(words)}>"
    return Html(start) if name in VOID else Html(f"{start}{markup(content)}</{name}>")


def json_block(data: Any, identifier: str) -> Html:
    """Return data as a block of JSON in which no text can end the block."""
    text = json.dumps(data, separators=(",", ":"), allow_nan=False)
    for sign in "<>&\u2028\u2029":
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    return Html(f'<script type="application/json" id="{html.escape(identifier)}">{text}</script>')


DIGITS = 6
MOST_ROWS = 200  # of a table of runs
MOST_ITEMS = 60  # of a list in a cell
EACH = " and "  # between the units of the numbers of a list

# told elsewhere on the page
APART = ("status", "command", "title", "definitions", "outputs", "scene_file", "run_id")


@record
class Quantity:
    """A number of a summary, or a list of them, with its unit."""

    value: Any
    unit: str


def with_units(value: Any, unit_of: UnitOfKey, key: str = "") -> Any:
    """Return a value of a summary with its numbers as quantities; those that have no unit stay as they are."""
    if isinstance(value, Mapping):
        return {
            name: with_units(item, unit_of, f"{key}.{name}" if key else name) for name, item in value.items()
        }
    if isinstance(value, list | tuple) and any(isinstance(item, Mapping | list | tuple) for item in value):
        return [with_units(item, unit_of, f"{key}.{k}") for k, item in enumerate(value)]
    first = value[0] if isinstance(value, list | tuple) and value else value
    if isinstance(first, bool) or not isinstance(first, int | float):
        return value
    symbol = unit_of(f"{key}.0" if first is not value else key)
    if first is not value and len(own := symbol.split(EACH)) > 1:
        return [_quantity(x, "" if one == "1" else one) for x, one in zip(value, own, strict=True)]
    return _quantity(value, symbol)


def _quantity(value: Any, symbol: str) -> Any:
    return Quantity(value, symbol) if symbol else value


def written(value: Any) -> str:
    """Return a value as it stands in a cell: numbers with six digits, lists with commas."""
    if isinstance(value, Quantity):
        return f"{written(value.value)} {unit(value.unit)}"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if value is None:
        return "–"
    if isinstance(value, float):
        return number(value, DIGITS) if math.isfinite(value) else str(value)
    if isinstance(value, int):
        return str(value).replace("-", "−")
    if isinstance(value, Sequence) and not isinstance(value, str):
        more = f", and {len(value) - MOST_ITEMS} more" if len(value) > MOST_ITEMS else ""
        return ", ".join(written(item) for item in value[:MOST_ITEMS]) + more or "none"
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {written(item)}" for key, item in value.items()) or "none"
    return str(value)


def named(key: str) -> str:
    """Return a key in words, without the unit that some end with."""
    return key.removesuffix("_s").replace("_", " ")


def table(head: Sequence[str], rows: Sequence[Sequence[Any]], caption: str | None = None) -> Html:
    """Return a table whose first column names its rows; numbers are set to the right."""
    top = [element("caption", caption)] if caption else []
    if any(head):
        top.append(element("thead", element("tr", [element("th", name, scope="col") for name in head])))
    cells = [[_cell(x, aligned=any(head)) for x in row[1:]] for row in rows]
    body = [
        element("tr", element("th", written(row[0]), scope="row"), rest) for row, rest in zip(rows, cells)
    ]
    return element("div", element("table", top, element("tbody", body)), class_="wide", tabindex="0")


def _cell(value: Any, aligned: bool) -> Html:
    """Return a cell; numbers of columns that are to be compared are ``aligned`` to the right."""
    inner = value.value if isinstance(value, Quantity) else value
    plain = isinstance(inner, int | float) and not isinstance(inner, bool)
    return element("td", written(value), class_="number" if plain and aligned else None)


def main_figures(result: Result) -> Html | None:
    """Return the main figures of a result with their errors, None of a command that has none."""
    parts = [_first_rows(one.head, one.rows) for one in figures.tables(result)]
    return element("div", element("h3", "Main figures"), parts) if parts else None


def summary_tables(summary: Mapping[str, Any], unit_of: UnitOfKey) -> list[Html]:
    """Return the tables of a summary: its plain entries first, then one for each entry that holds several.

    unit_of : the unit of a key, empty where there is none to show.
    """
    definitions = summary.get("definitions")
    meaning = definitions if isinstance(definitions, Mapping) else {}
    facts = with_units({key: value for key, value in summary.items() if key not in APART}, unit_of)
    parts = _entry_tables(facts, is_open=True)
    if meaning:
        rows = [(named(key), text) for key, text in meaning.items()]
        parts.append(_folded("definitions", [table(("", ""), rows)], is_open=False))
    return parts


def _entry_tables(facts: Mapping[str, Any], is_open: bool) -> list[Html]:
    """Return the table of the plain entries, and below it those of the others, which can be folded away."""
    nested = {key: value for key, value in facts.items() if _holds_several(value)}
    plain = [(named(key), value) for key, value in facts.items() if key not in nested]
    parts = [table(("", ""), plain)] if plain else []
    for key, value in nested.items():
        parts.append(_folded(named(key), _nested(value), is_open))
    return parts


def _holds_several(value: Any) -> bool:
    if isinstance(value, Mapping):
        return len(value) > 0
    return (
        isinstance(value, Sequence)
        and not isinstance(value, str)
        and any(isinstance(x, Mapping) for x in value)
    )


def _nested(value: Any) -> list[Html]:
    if not isinstance(value, Mapping):
        return [_rows([item for item in value if isinstance(item, Mapping)])]
    if all(isinstance(item, Mapping) and item for item in value.values()):
        return [_rows([{"": name, **item} for name, item in value.items()])]
    return _entry_tables(value, is_open=False)


def _rows(items: Sequence[Mapping[str, Any]]) -> Html:
    """Return a table with an item a row."""
    columns = list(dict.fromkeys(key for item in items[:MOST_ROWS] for key in item))
    return _first_rows(
        [named(key) for key in columns], [[item.get(key, "") for key in columns] for item in items]
    )


def _first_rows(head: Sequence[str], rows: Sequence[Sequence[Any]]) -> Html:
    """Return a table of as many rows as a page may have, which says so where that leaves some out."""
    left_out = f"The first {MOST_ROWS} of {len(rows)} rows; all of them are in the result's files."
    return table(head, rows[:MOST_ROWS], left_out if len(rows) > MOST_ROWS else None)


def _folded(title: str, content: list[Html], is_open: bool) -> Html:
    """Return tables that can be folded away; those with several columns go across the page."""
    broad = any("<thead>" in table for table in content)
    return element(
        "details", element("summary", title), content, open=is_open, class_="broad" if broad else None
    )


def errors_of(summary: Mapping[str, Any], path: str) -> Html | None:
    """Return the errors and residuals that a dataset is to be read with, None where the summary has none for it."""
    said = [told(one) for one in concerning(summary, path)]
    return element("p", f"Errors: {'; '.join(said)}.", class_="errors") if said else None


def error_note(summary: Mapping[str, Any]) -> Html | None:
    """Return how the errors beside the figures were estimated; None where they were not."""
    estimate = summary.get("error_estimate")
    method = estimate.get("method") if isinstance(estimate, Mapping) else None
    return element("p", f"Error estimate: {method}.", class_="note") if method else None


def plan_tables(plan: Mapping[str, Any]) -> list[Html]:
    """Return the terms that the equations keep and leave out, with the operations of each, and why."""
    head = ("term", "operations", "why")
    parts = []
    for key, title, cost in (
        ("kept", "Terms kept", "operations"),
        ("left_out", "Terms left out", "operations_saved"),
    ):
        terms = plan.get(key) or []
        rows = [(term.get("term", ""), term.get(cost), term.get("reason", "")) for term in terms]
        parts += [table(head, rows, title)] if rows else []
    facts = [("mechanism", plan.get("mechanism")), ("operations of this scene", plan.get("operations")),
             ("of code for any scene", plan.get("operations_general"))]  # fmt: skip
    return [table(("", ""), [fact for fact in facts if fact[1] is not None]), *parts]


def provenance_table(summary: Mapping[str, Any], attributes: Mapping[str, Any]) -> Html:
    """Return where a result is from: file of the scene, version, processor, libraries, seconds."""
    versions = attributes.get("versions")
    rows = [
        ("scene file", summary.get("scene_file")),
        ("run", attributes.get("run_id")),
        ("robodyn", attributes.get("robodyn_version")),
        ("code of robodyn (SHA-256)", attributes.get("robodyn_code_sha256")),
        ("processor", attributes.get("cpu")),
        *((versions or {}).items() if isinstance(versions, Mapping) else ()),
    ]
    return table(("", ""), [row for row in rows if row[1] is not None])
