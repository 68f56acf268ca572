"""HTML, in which every text that is not markup itself is escaped."""

from __future__ import annotations

import html
import json
from typing import Any

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
