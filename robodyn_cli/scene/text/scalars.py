"""Plain scalars of YAML 1.2 (core schema), without the readings of YAML 1.1.

``1e-9`` is a number, ``010`` is ten, ``1:30`` and ``yes`` are text, only ``true`` and ``false`` are booleans.
"""

from __future__ import annotations

import math
import re

Value = None | bool | int | float | str

_INT = re.compile(r"[-+]?[0-9]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_INFINITE = re.compile(r"[-+]?\.(inf|Inf|INF)")
_NAN = re.compile(r"\.(nan|NaN|NAN)")
_BASED = re.compile(r"[-+]?0[oOxX][0-9a-fA-F]+")
_WORDS: dict[str, Value] = {"true": True, "false": False, "null": None, "~": None, "": None}

# Python does not convert very long integers; as floats they are infinite, and the reader refuses those
_LONGEST_INT = 300


def resolve(text: str) -> Value:
    """Return the value of a plain scalar.

    Raises
    ------
    ValueError : an octal or hexadecimal number.
    """
    if text in _WORDS:
        return _WORDS[text]
    first = text[0]
    if not (first.isdigit() or first in "+-."):
        return text
    if _INT.fullmatch(text):
        return int(text) if len(text) <= _LONGEST_INT else float(text)
    if _FLOAT.fullmatch(text):
        return float(text)
    if _INFINITE.fullmatch(text):
        return -math.inf if first == "-" else math.inf
    if _NAN.fullmatch(text):
        return math.nan
    if _BASED.fullmatch(text):
        raise ValueError(
            "octal and hexadecimal numbers are not read; write a decimal number, or quote a text"
        )
    return text
