"""The directory that a run writes into: locked, freed of the run's own old outputs, filled file by file."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

from robodyn_cli.errors import OutputError
from robodyn_cli.results.atomic import (
    discard,
    is_temporary,
    output_error,
    output_errors,
    publish,
    temporary_path,
)
from robodyn_cli.results.lock import DirectoryLock
from robodyn_cli.results.summary import read_summary, write_summary

RESULT_NAME = "result.h5"
SUMMARY_NAME = "summary.json"
# The kind of file that a report leaves; anything else in an old list of outputs is not ours to remove.
DRAWING_SUFFIX = ".png"
# Text that every drawing of ours carries near its start (PNG keyword "Software").
SIGNATURE = b"Software\x00robodyn"


class OutputDirectory:
    """Context manager around the output directory of one run.

    Entering creates and locks the directory and removes what an earlier run left there; leaving removes
    unpublished temporary files and unlocks. Files of others are never touched: a drawing is removed only if it
    carries robodyn's mark. ``drawings`` are names that a report may have left without a summary listing them (a run
    that was killed).
    """

    def __init__(self, path: str | Path, drawings: Iterable[str] = ()) -> None:
        self.path = Path(path)
        self.outputs: list[str] = []
        self._drawings = tuple(drawings)
        self._temporaries: dict[str, Path] = {}
        self._lock: DirectoryLock | None = None

    def __enter__(self) -> OutputDirectory:
        with output_errors(self.path):
            try:
                self.path.mkdir(parents=True, exist_ok=True)
            except (FileExistsError, NotADirectoryError) as error:
                raise OutputError(
                    f"cannot write into {self.path}: it, or a part of it, is a file and not a directory",
                    path=str(self.path),
                ) from error
            self._lock = DirectoryLock(self.path)
        try:
            self._remove_old()
        except BaseException:
            self._lock.release()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for temporary in self._temporaries.values():
            discard(temporary)
        self._temporaries.clear()
        if self._lock is not None:
            self._lock.release()
            self._lock = None

    @property
    def result_path(self) -> Path:
        """Where the result file goes; its writer publishes it by itself."""
        return self.path / RESULT_NAME

    def temporary(self, name: str) -> Path:
        """Return the path under which to write the file ``name`` until it is published."""
        return self._temporaries.setdefault(name, temporary_path(self.path / name))

    def publish(self, name: str) -> Path:
        """Give the file written at ``temporary(name)`` its name and list it among the outputs."""
        target = self.path / name
        with output_errors(target):
            publish(self._temporaries[name], target)
        del self._temporaries[name]
        self.record([target])
        return target

    def record(self, paths: Iterable[str | Path]) -> None:
        """List files that were published by other means (``ResultWriter``, ``draw_all``)."""
        for path in paths:
            name = Path(path).name
            if name not in self.outputs:
                self.outputs.append(name)

    def write_summary(self, summary: Mapping[str, Any]) -> Path:
        """Write ``summary.json`` with the list of outputs added."""
        target = self.path / SUMMARY_NAME
        if self.result_path.exists():
            self.record([self.result_path])
        names = sorted({*self.outputs, SUMMARY_NAME}, key=lambda name: (name != RESULT_NAME, name))
        write_summary({**summary, "outputs": names}, target)
        self.record([target])
        return target

    def _remove_old(self) -> None:
        listed = read_summary(self.path / SUMMARY_NAME).get("outputs", ())
        names = [name for name in listed if _is_drawing(name)] if isinstance(listed, list) else []
        # a list can name a file that somebody else has put there since
        drawings = [
            name for name in {**dict.fromkeys(names), **dict.fromkeys(self._drawings)} if self._is_ours(name)
        ]
        # The lock is ours, so a temporary file here belongs to a run that was killed.
        stale = [path.name for path in _entries(self.path) if is_temporary(path)]
        # The summary goes last: killed halfway, the next run still knows what to remove.
        for name in [*drawings, *stale, RESULT_NAME, SUMMARY_NAME]:
            path = self.path / name
            try:
                path.unlink(missing_ok=True)
            except OSError as error:
                raise output_error(path, error) from error

    def _is_ours(self, name: str) -> bool:
        """Tell whether a file carries robodyn's mark."""
        path = self.path / name
        try:
            if not path.is_file():
                return False
            with open(path, "rb") as stream:
                return SIGNATURE in stream.read(512)
        except OSError:
            return False


def _entries(directory: Path) -> list[Path]:
    with output_errors(directory):
        return [Path(entry.path) for entry in os.scandir(directory)]


def _is_drawing(name: Any) -> bool:
    """Tell whether an entry of an old list of outputs is the plain name of a drawing."""
    return isinstance(name, str) and Path(name).name == name and name.endswith(DRAWING_SUFFIX)
