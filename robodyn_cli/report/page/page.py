"""A page of results: one file that needs no network, with a policy that lets nothing but its own script run."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path

from robodyn_cli.report.page.charts import Store
from robodyn_cli.report.page.section import Shown, section
from robodyn_cli.report.page.tables import Html, element, json_block, markup
from robodyn_cli.results.atomic import write_bytes
from robodyn_cli.version import __version__

# one after another they are the script of the page
SCRIPTS = ("strokes.js", "surfaces.js", "player.js", "charts.js", "page.js")
STYLE = "page.css"


def write_page(shown: Sequence[Shown], target: Path) -> int:
    """Write results into one page, whole or not at all; return its size in bytes.

    Raises
    ------
    CapabilityError : a result has poses, but this version cannot read its scene. OutputError : it cannot be written.
    """
    content = make_page(shown).encode()
    write_bytes(target, content)
    return len(content)


def make_page(shown: Sequence[Shown]) -> str:
    """Return the page of results, one below another, with a table of contents where there are several."""
    store = Store()
    alone = len(shown) == 1
    sections = [section(place, one, store, alone) for place, one in enumerate(shown, 1)]
    titles = {one.result.title or one.label for one in shown}
    heading = f"{len(shown)} results" if len(titles) > 1 else titles.pop()
    body = [
        None if alone else element("header", element("h1", heading), _contents(shown)),
        element(
            "noscript", element("p", "Drawings and plots need JavaScript; the tables do not.", class_="note")
        ),
        element("main", sections),
        element("footer", f"Made by robodyn {__version__}. This page fetches nothing and sends nothing."),
        json_block({"arrays": store.arrays.packed, "figures": store.figures}, "data"),
    ]
    return _document(heading, markup(body))


def _contents(shown: Sequence[Shown]) -> Html:
    links = [
        element(
            "li",
            element("a", one.result.title or one.label, href=f"#result-{place}"),
            f" ({one.label}: {one.result.status.replace('_', ' ')})",
        )
        for place, one in enumerate(shown, 1)
    ]
    return element("nav", element("ol", links), aria_label="Results")


def _document(title: str, body: Html) -> str:
    script, style = Html("\n".join(_asset(name) for name in SCRIPTS)), Html(_asset(STYLE))
    policy = (
        f"default-src 'none'; script-src {_digest(script)}; style-src {_digest(style)}; img-src data:; "
        "base-uri 'none'; form-action 'none'"
    )
    head = [
        element("meta", charset="utf-8"),
        element("meta", http_equiv="Content-Security-Policy", content=policy),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("meta", name="color-scheme", content="light dark"),
        element("title", f"{title} - robodyn"),
        element("style", style),
    ]
    parts = (element("head", head), element("body", body, element("script", script)))
    return "<!doctype html>\n" + element("html", parts, lang="en") + "\n"


def _asset(name: str) -> str:
    return (files("robodyn_cli.report.page") / name).read_text(encoding="utf-8")


def _digest(text: str) -> str:
    """Return the source expression of the policy that allows exactly this text."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
