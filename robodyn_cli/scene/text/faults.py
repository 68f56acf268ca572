"""The errors of a scene, collected: reading goes on after an error where it can."""

from __future__ import annotations

from collections.abc import Iterable
from types import TracebackType

from robodyn_cli.errors import SceneError

# reading ends after so many
MOST = 1000


class TooMany(Exception):
    """There are too many errors; raised to end the reading of the scene."""


class Faults:
    """A list of errors, and a ``with`` block that ends at its first error and adds it to the list.

    found : the errors, in the order in which they were found.
    lost : keys without a value because a file to be included has an error.
    """

    def __init__(self) -> None:
        self.found: list[SceneError] = []
        self.lost: list[str] = []

    def report(self, error: SceneError) -> None:
        """Add an error.

        Raises
        ------
        TooMany : there are ``MOST`` errors now.
        """
        self.found.append(error)
        if len(self.found) >= MOST:
            raise TooMany

    def __enter__(self) -> None:
        pass

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool:
        if not isinstance(error, SceneError):
            return False
        self.report(error)
        return True

    @property
    def keys(self) -> list[str]:
        """Return the keys with faults."""
        return [key for key in (*map(key_of, self.found), *self.lost) if key]

    def add_unrelated(self, errors: Iterable[SceneError], sections: bool = False) -> None:
        """Add the errors that do not follow from those found: about the same key, or a key above or below it.

        sections : errors about other keys of a section follow too, since they may miss the one that could not be read.
        """
        known = self.keys
        within = {
            above for above, _, last in (key.rpartition(".") for key in known) if above and not last.isdigit()
        }
        within = within if sections else set()
        self.found += [
            e
            for e in errors
            if key_of(e).rpartition(".")[0] not in within
            and not any(_related(key_of(e), key) for key in known)
        ]

    def in_order(self) -> list[SceneError]:
        """Return the errors file by file and line by line, each once."""
        files = list(dict.fromkeys(str(e.details.get("file")) for e in self.found))

        def place(e: SceneError) -> tuple[int, int, int]:
            line, column = e.details.get("line") or 0, e.details.get("column") or 0
            return files.index(str(e.details.get("file"))), line, column

        return sorted({e.message: e for e in self.found}.values(), key=place)


def key_of(error: SceneError) -> str:
    """Return the key that an error is about, as a dotted path."""
    return str(error.details.get("key", ""))


def _related(a: str, b: str) -> bool:
    return a == b or (a != "" and b.startswith(a + ".")) or a.startswith(b + ".")
