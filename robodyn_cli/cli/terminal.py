"""What the terminal at hand can show: how many columns, and colours."""

from __future__ import annotations

import os
import re
import shutil
from typing import TextIO

# by what a line begins with; all else stays as it is
COLOURS = {
    "ok": "32", "equal": "32",
    "failed": "31", "error": "31", "differs": "31", "missing": "31", "unreadable": "31", "stopped": "33", "extra": "33",
    "robodyn: error:": "31", "robodyn: warning:": "33",
}  # fmt: skip
_COLOURED = re.compile(rf"(?:{'|'.join(sorted(COLOURS, key=len, reverse=True))})(?= )")
_GAP = re.compile(r"\s{2,}(?=\S)")  # between a label and its text


def is_terminal(stream: TextIO | None) -> bool:
    """Tell whether somebody reads a stream as it is written."""
    return stream is not None and stream.isatty()


def width(stream: TextIO | None) -> int | None:
    """Return the columns of a stream's terminal; None where it is none, for other programs read lines."""
    return shutil.get_terminal_size().columns if is_terminal(stream) else None


def fitted(text: str, stream: TextIO | None) -> str:
    """Return text for a stream: on a terminal with colours, and lines that are too long go on below their text."""
    columns = width(stream)
    if columns is None:
        return text
    lines = [line if len(line) <= columns else _wrapped(line, columns) for line in text.split("\n")]
    return "\n".join(map(_painted, lines) if _has_colours() else lines)


def _wrapped(line: str, columns: int) -> str:
    import textwrap

    starts = [gap.end() for gap in _GAP.finditer(line) if gap.end() <= columns // 2]
    indent = " " * (starts[-1] if starts else 4)
    return textwrap.fill(
        line, columns, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )


def _has_colours() -> bool:
    """Tell whether colours are wanted (https://no-color.org)."""
    return not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"


def _painted(line: str) -> str:
    word = _COLOURED.match(line)
    if word is None:
        return line
    return f"\x1b[{COLOURS[word.group()]}m{word.group()}\x1b[0m{line[word.end() :]}"
