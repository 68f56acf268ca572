"""How figures are set: their width, whether a heading stands above them, and how fine pixels are."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from contextvars import ContextVar

from robodyn_cli.record import record

WIDTH = 7.0  # [inch]
NOTE_WIDTH = 90  # characters of a note that fit on a line of that width
LEFT = 0.8  # beside panels and notes [inch]
NARROW = 5.0  # width below which no panels stand side by side [inch]


@record
class FigureFormat:
    """The format of figures: width [inch], whether title and notes stand above the panels, pixels for an inch."""

    width: float = WIDTH
    titles: bool = True
    dpi: int = 120

    @property
    def characters(self) -> int:
        """How many characters of a note fit on a line."""
        return int(NOTE_WIDTH * (self.width - LEFT) / (WIDTH - LEFT))


# of ``--style``: screen; a column of a paper, whose caption says what a heading would; slides, on which few words are
# large as the figure is made as wide as the slide
FORMATS = {
    "screen": FigureFormat(),
    "paper": FigureFormat(3.5, False, 300),
    "slides": FigureFormat(5.0, True, 240),
}
_current = ContextVar("format of figures", default=FORMATS["screen"])


def current() -> FigureFormat:
    """Return the format in which figures are drawn now."""
    return _current.get()


@contextlib.contextmanager
def formatted(one: FigureFormat | None) -> Iterator[None]:
    """Draw in a format inside the context; None: in that of the screen."""
    before = _current.set(one or FORMATS["screen"])
    try:
        yield
    finally:
        _current.reset(before)
