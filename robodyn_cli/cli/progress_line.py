"""The line that says how far a run is: on a terminal one that is written over, elsewhere what is told once a minute."""

from __future__ import annotations

import shutil
import sys
import threading
import time

from robodyn_cli.cli import interrupts
from robodyn_cli.foreign import printable

OFTEN = 0.1  # s between two lines
SOON = 1.0  # s of a pass before its time left is told
LONGEST_BAR, SHORTEST_BAR = 30, 6  # columns
UNITS = ((1.0, "s"), (60.0, "min"), (3600.0, "h"))


class ProgressLine:
    """What is done, how far it is, and the time left, on standard error.

    ``pass_of`` is what is done now, as ``error estimate``: a run may have several passes, each with its own time left.
    """

    def __init__(self, on_terminal: bool) -> None:
        self.on_terminal = on_terminal  # and one where a line can be written over
        self.shown, self._reached, self._told = 0.0, "", ""  # when, how far, and of which pass
        self._width = 0
        self._pass, self._part, self._begun = "", 0.0, 0.0
        self._writing = threading.Lock()

    def advance(self, part: float, reached: str, pass_of: str = "", left: float | None = None) -> None:
        """Show that a pass is so far; left : seconds that it still takes, None for what its own pace says."""
        now = time.monotonic()
        if pass_of != self._pass or part < self._part or not self._begun:
            self._pass, self._begun = pass_of, now
        self._part = part
        if now - self.shown < OFTEN:
            return
        gone = now - self._begun
        if left is None and 0.0 < part < 1.0 and gone > SOON:
            left = gone * (1.0 - part) / part
        self.shown, self._told = now, pass_of
        self._reached = reached + ("" if left is None else f", {duration(left)} left")
        if self.on_terminal:
            self.write(self._with_bar(part))

    def _with_bar(self, part: float) -> str:
        """Return the line with a bar where there is room for one."""
        words = f"{self._pass}  " if self._pass else ""
        room = min(LONGEST_BAR, columns() - len(words) - len(self._reached) - 4)
        bar = f"[{'#' * round(room * part):<{room}}] " if room >= SHORTEST_BAR else ""
        return f"{words}{bar}{self._reached}"

    def reached(self, activity: str) -> str:
        """Say how far an activity is; empty where the last that was told is how far another one was."""
        return self._reached if self._told in ("", activity) else ""

    def wait(self, activity: str, gone: float) -> None:
        """Show that something is done that says nothing, gone : s since the command began."""
        reached = f": {self._reached.partition(',')[0]}" if activity == self._told else ""
        self.write(f"{activity}{reached} ... {gone:.0f} s")

    def write(self, text: str) -> None:
        """Write a line over the one that is there, as much of it as there is room for."""
        with self._writing:
            text = printable(text)[: columns() - 1]
            self._put("\r" + text.ljust(self._width))
            self._width = interrupts.line_shown = max(self._width, len(text))

    def clear(self) -> None:
        """Remove the line."""
        with self._writing:
            if self._width:
                self._put(interrupts.over_line(self._width))
                self._width = interrupts.line_shown = 0

    def _put(self, text: str) -> None:
        if sys.stderr is not None:
            sys.stderr.write(text)
            sys.stderr.flush()


def duration(seconds: float) -> str:
    """Return a time that is left, for reading."""
    if seconds < 100.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 6000.0 else f"{seconds / 3600.0:.1f} h"


def spent(seconds: float) -> str:
    """Return a time that something took, for reading: with two digits."""
    seconds = max(seconds, 0.01)
    if seconds < 0.995:
        return f"{seconds:.2f} s"
    size, unit = next((size, unit) for size, unit in UNITS if seconds < 99.5 * size or unit == "h")
    return f"{seconds / size:.1f} {unit}" if seconds < 9.95 * size else f"{seconds / size:.0f} {unit}"


def columns() -> int:
    """Return the columns of the terminal."""
    return shutil.get_terminal_size().columns
