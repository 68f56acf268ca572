"""Formulas as MathML, which browsers show without a script."""

from __future__ import annotations

import re
from typing import Any

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx

FUNCTION = re.compile(r"(?<=[\w}])\s*(\\(?:sin|cos|tan|exp|ln|log)\b)")


def mathml(node: Any, display: str) -> str:
    """Return a formula; a thin space parts the name of a function from a factor before it."""
    return str(convert(FUNCTION.sub(r"\\,\1", node.astext()), display=display))


def inline(writer: Any, node: Any) -> None:
    writer.body.append(mathml(node, "inline"))
    raise nodes.SkipNode


def display(writer: Any, node: Any) -> None:
    writer.body.append(f'<div class="formula">{mathml(node, "block")}</div>')
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    app.add_html_math_renderer("mathml", (inline, None), (display, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
