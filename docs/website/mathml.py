"""Formulas as MathML, which browsers show without a script."""

from __future__ import annotations

import re
from typing import Any

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx

from website.text import side_by_side

FUNCTION = re.compile(r"(?<=[\w}])\s*(\\(?:sin|cos|tan|exp|ln|log)\b)")


def mathml(text: str, display: str) -> str:
    """Return a formula; a thin space parts the name of a function from a factor before it."""
    return str(convert(FUNCTION.sub(r"\\,\1", text), display=display))


def inline(writer: Any, node: Any) -> None:
    writer.body.append(mathml(node.astext(), "inline"))
    raise nodes.SkipNode


def display(writer: Any, node: Any) -> None:
    formulas = "".join(mathml(part, "block") for part in side_by_side(node.astext()))
    writer.body.append(f'<div class="formula">{formulas}</div>')
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    app.add_html_math_renderer("mathml", (inline, None), (display, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
