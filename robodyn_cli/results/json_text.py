"""JSON as people read it: a key a line, a list of numbers on one."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

INDENT = 2
NUMBERS = frozenset({float, int, bool, type(None)})


def indented(data: Any, ensure_ascii: bool = False) -> str:
    """Return data of JSON as text; rows of matrices are lines.

    Python's own encoder is slower as soon as it indents, and gives each number a line.
    """
    encode = json.JSONEncoder(ensure_ascii=ensure_ascii).encode
    return "".join(_pieces(data, encode, "\n"))


def _pieces(data: Any, encode: Any, end: str) -> Iterator[str]:
    """Yield the text of a value in pieces; end : what ends a line and indents the next."""
    inner = end + " " * INDENT
    if isinstance(data, Mapping) and data:
        start = "{" + inner
        for key, value in data.items():
            yield f"{start}{encode(str(key))}: "
            yield from _pieces(value, encode, inner)
            start = "," + inner
        yield end + "}"
    elif isinstance(data, list | tuple) and not NUMBERS.issuperset(map(type, data)):
        start = "[" + inner
        for value in data:
            yield start
            yield from _pieces(value, encode, inner)
            start = "," + inner
        yield end + "]"
    else:
        yield encode(data)
