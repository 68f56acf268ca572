"""HTML, in which every text that is not markup itself is escaped.

Tables of what a result says in words and numbers: main figures, its plan, errors beside figures, where it is from.
"""

from __future__ import annotations

import html
import json
import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

from robodyn_cli.record import record
from robodyn_cli.report import figures
from robodyn_cli.report.cells import is_number
from robodyn_cli.report.numbers import number, stated_words, typeset, unit
from robodyn_cli.results.result import Result
from robodyn_cli.results.stated_errors import concerning
from robodyn_cli.summaries import rounding

VOID = ("input", "meta", "img", "br", "wbr")


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


def raised(content: Html) -> Html:
    """Return a part of a page with headings a level higher, below that of the page alone; texts are escaped."""
    return Html(re.sub(r"<(/?)h3>", r"<\1h2>", content))


def json_block(data: Any, identifier: str) -> Html:
    """Return data as a block of JSON in which no text can end the block."""
    text = json.dumps(data, separators=(",", ":"), allow_nan=False)
    for sign in "<>&\u2028\u2029":
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    return Html(f'<script type="application/json" id="{html.escape(identifier)}">{text}</script>')


DIGITS = 6
MOST_ROWS = 200  # of a table of runs
MOST_ITEMS = 60  # of a list in a cell


@record
class Quantity:
    """A number of a summary, or a list of them, with its unit and the error that the summary states of it."""

    value: Any
    unit: str = ""
    error: float | None = None


def written(value: Any) -> str:
    """Return a value as it stands in a cell: numbers with six digits, lists with commas."""
    if isinstance(value, Quantity):
        text = written(value.value) if value.error is None else within(value.value, value.error)
        return f"{text} {unit(value.unit)}" if value.unit else text
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


def within(value: Any, error: float) -> str:
    """Return numbers with the digits that their error leaves, and the error."""
    values = value if isinstance(value, list | tuple) else [value]
    if not error > 0.0 or not math.isfinite(error) or not all(map(is_number, values)):
        return written(value)
    kept, off = rounding.within(values, error)
    return typeset(f"{', '.join(kept)} ± {off}")


def named(key: str) -> str:
    """Return a key in words, without the unit that some end with."""
    return key.removesuffix("_s").replace("_", " ")


def table(head: Sequence[str], rows: Sequence[Sequence[Any]], caption: str | None = None) -> Html:
    """Return a table whose first column names its rows; numbers are set to the right."""
    top = [element("caption", caption)] if caption else []
    if any(head):
        right = [any(_is_plain_number(row[k]) for row in rows if k < len(row)) for k in range(len(head))]
        names = [
            element("th", name, scope="col", class_="number" if k and right[k] else None)
            if name
            else element("td")
            for k, name in enumerate(head)
        ]
        top.append(element("thead", element("tr", names)))
    cells = [[_cell(x, aligned=any(head)) for x in row[1:]] for row in rows]
    body = [
        element("tr", element("th", written(row[0]), scope="row"), rest) for row, rest in zip(rows, cells)
    ]
    return element("div", element("table", top, element("tbody", body)), class_="wide", tabindex="0")


def _cell(value: Any, aligned: bool) -> Html:
    """Return a cell; numbers of columns that are to be compared are ``aligned`` to the right."""
    text = value if isinstance(value, Html) else written(value)
    return element("td", text, class_="number" if aligned and _is_plain_number(value) else None)


def _is_plain_number(value: Any) -> bool:
    inner = value.value if isinstance(value, Quantity) else value
    return isinstance(inner, int | float) and not isinstance(inner, bool)


def main_figures(result: Result) -> Html | None:
    """Return the main figures of a result with their errors, None of a command that has none."""
    parts = []
    for one in figures.tables(result):
        parts.append(table(one.head, [[typeset(str(cell)) for cell in row] for row in one.rows[:MOST_ROWS]]))
        parts += [element("p", f"{typeset(one.meaning)}.", class_="note")] if one.meaning else []
    return element("div", element("h3", "Main figures"), parts) if parts else None


def errors_of(result: Result, *paths: str) -> Html | None:
    """Return the errors and residuals that datasets are to be read with, None where the summary has none for them."""
    said = dict.fromkeys(
        stated_words(one, result) for path in paths for one in concerning(result.summary, path)
    )
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


def _hash(digest: Any) -> Html | None:
    """Return a digest that takes several lines where there is no room for it."""
    return None if digest is None else element("span", str(digest), class_="hash")


def provenance_table(summary: Mapping[str, Any], attributes: Mapping[str, Any]) -> Html:
    """Return where a result is from: file of the scene, version, processor, libraries, seconds."""
    versions = attributes.get("versions")
    rows = [
        ("scene file", summary.get("scene_file")),
        ("run", attributes.get("run_id")),
        ("robodyn", attributes.get("robodyn_version")),
        ("code of robodyn (SHA-256)", _hash(attributes.get("robodyn_code_sha256"))),
        ("processor", attributes.get("cpu")),
        *((versions or {}).items() if isinstance(versions, Mapping) else ()),
    ]
    return table(("", ""), [row for row in rows if row[1] is not None])
