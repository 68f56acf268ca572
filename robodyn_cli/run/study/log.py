"""The rows of a study that is not finished, a line each, so that it goes on where it was."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import math
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import TracebackType

from robodyn_cli.results.atomic import output_errors
from robodyn_cli.results.summary import jsonable
from robodyn_cli.run.study.row import Row, Values

LOG_NAME = "unfinished.jsonl"


class Log:
    """Context manager around the file. Its first line says of which study the rows are."""

    def __init__(self, path: Path, digest: str) -> None:
        self.path, self.digest = path, digest
        self.rows = {row.values: row for row in _rows(path, digest)}

    def __enter__(self) -> Log:
        with output_errors(self.path):
            # a line that was being written as the run ended is written again
            self._file = open(self.path, "w", encoding="utf-8")
            self._file.write(json.dumps({"study": self.digest}) + "\n")
            self._file.writelines(_line(row) for row in self.rows.values())
            self._file.flush()
        return self

    def add(self, rows: Iterable[Row]) -> None:
        """Write rows; they are in the file when this returns."""
        with output_errors(self.path):
            self._file.writelines(_line(row) for row in rows)
            self._file.flush()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with contextlib.suppress(OSError):
            self._file.close()


def _line(row: Row) -> str:
    return json.dumps(jsonable(dataclasses.astuple(row))) + "\n"


def _rows(path: Path, digest: str) -> Iterator[Row]:
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, ValueError):
        return
    lines = text.splitlines()
    with contextlib.suppress(ValueError, TypeError, KeyError, IndexError):  # ends at a line that is not whole
        if json.loads(lines[0])["study"] != digest:
            return
        for line in lines[1:]:
            values, code, outputs, errors, holds, reason, seconds = json.loads(line)
            yield Row(_numbers(values), code, _numbers(outputs), _numbers(errors), holds, reason, seconds)


def _numbers(entries: list[float | None]) -> Values:
    return tuple(math.nan if x is None else float(x) for x in entries)
