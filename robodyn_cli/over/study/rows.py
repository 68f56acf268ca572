"""What runs of a study share and give: rows in a file, each at the place of its run, so that any number of runs takes
the same memory.

A file that an earlier process left is gone on with. Rows of another design, of more samples say, are found by their
values and taken over.
"""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.errors import INTERNAL
from robodyn_cli.foreign import contents
from robodyn_cli.over.study.design import Design
from robodyn_cli.record import record
from robodyn_cli.results.atomic import discard, output_errors, write_bytes
from robodyn_cli.scene.load import Family
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.tools.progress import Progress

Runs = NDArray[np.int64]


@record
class Task:
    """What all runs of a study share: their scenes, the command, the keys that vary, the outputs."""

    family: Family
    command: str
    keys: tuple[str, ...]
    outputs: tuple[str, ...]

    @property
    def layout(self) -> np.dtype[Any]:
        """What is kept of a run.

        values : of the keys. outputs, errors : numbers, nan where a run has none. series : see ``ManyRuns``. code :
        exit code that the command would have. holds : whether all of ``expect`` holds. done : 1 once the run was made.
        """
        keys, outputs = (len(self.keys),), (len(self.outputs),)
        return np.dtype([
            ("values", "<f8", keys), ("outputs", "<f8", outputs), ("errors", "<f8", outputs),
            ("series", "<i2"), ("code", "<i2"), ("holds", "?"), ("done", "?"),
        ])  # fmt: skip


@record
class RunRows:
    """What some runs of a study gave.

    runs : their numbers (n,). rows : what they gave (n,), see ``Task.layout``. reasons : why those failed that did, by
    the number of the run.
    """

    runs: Runs
    rows: NDArray[Any]
    reasons: dict[int, str]

    def __len__(self) -> int:
        return len(self.runs)


def joined(parts: Sequence[RunRows]) -> RunRows:
    """Return the rows of several parts as one."""
    reasons = {run: reason for part in parts for run, reason in part.reasons.items()}
    return RunRows(np.concatenate([p.runs for p in parts]), np.concatenate([p.rows for p in parts]), reasons)


@record
class Points:
    """Runs that are to be made: their numbers (n,) and values (n, keys)."""

    runs: Runs
    values: Array

    def __len__(self) -> int:
        return len(self.runs)

    def part(self, which: Any) -> Points:
        """Return some of them."""
        return Points(self.runs[which], self.values[which])


def killed(points: Points, task: Task) -> RunRows:
    """Return the row of a run with which its process died."""
    row = np.zeros(1, task.layout)
    row["values"], row["code"], row["done"] = points.values, INTERNAL, True
    row["outputs"] = row["errors"] = np.nan
    return RunRows(points.runs, row, {int(points.runs[0]): "the process of this run was ended from outside"})


ROWS_NAME, REASONS_NAME = "unfinished.rows", "unfinished.jsonl"
BLOCK = 8192  # rows that are read at a time
MOST_REASONS = 10_000_000  # bytes: a line for each exit code
MIX = np.uint64(0x9E3779B97F4A7C15)  # odd, its bits as good as random


class RowFile:
    """Context manager around the files of rows and of reasons.

    The first line of ``unfinished.jsonl`` says of which runs the rows are. More lines tell why runs failed: of the
    first run with each exit code, as far as it is known when it is written. A row is there when its byte ``done`` is,
    which is written last.

    Parameters
    ----------
    head : digest of the ``study`` (scene, command, keys, outputs), which rows must share to be taken over, and of its
    ``design``.
    """

    def __init__(self, directory: Path, task: Task, design: Design, head: Mapping[str, str]) -> None:
        self.path, self._reasons_path = directory / ROWS_NAME, directory / REASONS_NAME
        self.design, self.layout, self._head = design, task.layout, head
        self.done, self._opened = 0, contextlib.ExitStack()
        self.reasons: dict[
            int, tuple[int, str]
        ] = {}  # by exit code: the first run that failed with it, and why

    def __len__(self) -> int:
        return len(self.design)

    def __enter__(self) -> RowFile:
        with output_errors(self.path):
            earlier = self._begin()
            mode: Literal["r+b", "w+b"] = "r+b" if self.path.exists() else "w+b"
            self._file = self._opened.enter_context(open(self.path, mode, buffering=0))
            self._file.truncate(len(self) * self.layout.itemsize)
            self._reasons_file = self._opened.enter_context(open(self._reasons_path, "a", encoding="utf-8"))
        self.done = sum(int(np.count_nonzero(rows["done"])) for _, rows in self.blocks())
        if earlier is not None:
            self.take_over(earlier)
            del earlier
            discard(self._old)
        return self

    @property
    def study(self) -> str:
        """Digest of what all rows share."""
        return self._head["study"]

    @property
    def _old(self) -> Path:
        return self.path.with_suffix(".old")

    def _begin(self) -> NDArray[Any] | None:
        """Leave no rows but those of this design; return those of another one of this study.

        They lie in a file of their own until they are taken over, for the case that this process is killed before.
        """
        head, reasons = _lines(self._reasons_path)
        if head.get("study") != self._head["study"]:
            self.forget()
        elif head["design"] == self._head["design"]:
            self.reasons = reasons
        elif self._old.exists():
            discard(self.path)
        elif self.path.exists():
            os.replace(self.path, self._old)
        lines = [self._head, *([code, *why] for code, why in self.reasons.items())]
        write_bytes(self._reasons_path, "".join(json.dumps(line) + "\n" for line in lines).encode())
        if not self._old.exists():
            return None
        whole = self._old.stat().st_size // self.layout.itemsize
        return np.memmap(self._old, self.layout, "r", shape=whole) if whole else None

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._close()

    def _close(self) -> None:
        with contextlib.suppress(OSError):
            self._opened.close()

    def blocks(self) -> Iterator[tuple[int, NDArray[Any]]]:
        """Yield all rows, a block at a time, each with the number of its first run."""
        for first in range(0, len(self), BLOCK):
            yield first, self.read(first, min(first + BLOCK, len(self)))

    def read(self, first: int, last: int) -> NDArray[Any]:
        """Return the rows of the runs from ``first`` up to, and without, ``last``."""
        size = self.layout.itemsize
        with output_errors(self.path):
            self._file.seek(first * size)
            return np.frombuffer(self._file.read((last - first) * size), self.layout)

    def add(self, made: RunRows) -> None:
        """Write rows; they are in the files when this returns."""
        for code in np.unique(made.rows["code"][made.rows["code"] != 0]).tolist():
            run = int(made.runs[made.rows["code"] == code].min())
            if code not in self.reasons or run < self.reasons[code][0]:
                self.reasons[code] = run, made.reasons.get(run, "")
                self._note([code, run, made.reasons.get(run, "")])
        order = np.argsort(made.runs, kind="stable")
        runs, rows = made.runs[order], made.rows[order]
        for part in np.split(np.arange(len(runs)), np.flatnonzero(np.diff(runs) != 1) + 1):
            if len(part):
                self._put(int(runs[part[0]]), rows[part])
        self.done += len(made)

    def _put(self, first: int, rows: NDArray[Any]) -> None:
        data = memoryview(rows.tobytes())
        with output_errors(self.path):
            self._file.seek(first * self.layout.itemsize)
            while data:
                data = data[self._file.write(data) :]

    def _note(self, line: Any) -> None:
        with output_errors(self._reasons_path):
            self._reasons_file.write(json.dumps(line) + "\n")
            self._reasons_file.flush()

    def take_over(self, earlier: NDArray[Any]) -> None:
        """Take rows of an earlier study that have the values of runs which are not made yet.

        Those of runs that failed are left: they run again.
        """
        known = _ByValues(earlier)
        for first, rows in self.blocks():
            runs = np.flatnonzero(~rows["done"])
            which = known.find(self.design.rows(first, first + len(rows))[runs])
            there = which >= 0
            if there.any():
                self.add(RunRows(first + runs[there], earlier[which[there]], {}))

    def missing(self) -> Missing:
        """Return the runs that are still to be made."""
        return Missing(self)

    def forget(self) -> None:
        """Remove the files; on Windows only those go that nobody has open."""
        self._close()
        for path in (self.path, self._old, self._reasons_path):
            discard(path)


def told(parts: Iterable[RunRows], total: int, progress: Progress, done: int = 0) -> Iterator[RunRows]:
    """Yield the rows of runs as they are made, and tell how many of all there are, of which some were there before."""
    for part in parts:
        yield part
        done += len(part.runs)
        progress(done, total, "runs")


class Missing:
    """The runs of a file that are not there, in their order."""

    def __init__(self, file: RowFile) -> None:
        self._file = file
        self.left = len(file) - file.done
        self._next = 0
        self._block = Points(np.empty(0, dtype=np.int64), np.empty((0, len(file.design.keys))))

    def take(self, most: int) -> Points:
        """Return the next runs, ``most`` or, where there are not so many at hand, fewer; none at the end."""
        while not len(self._block) and self._next < len(self._file):
            first, self._next = self._next, min(self._next + BLOCK, len(self._file))
            runs = np.flatnonzero(~self._file.read(first, self._next)["done"])
            self._block = Points(first + runs, self._file.design.rows(first, self._next)[runs])
        taken, self._block = self._block.part(slice(most)), self._block.part(slice(most, None))
        self.left -= len(taken)
        return taken


class _ByValues:
    """Rows of runs that went well, by their values: a number of 64 bits stands for those of each, in order."""

    def __init__(self, rows: NDArray[Any]) -> None:
        self._rows = rows
        there = np.flatnonzero(rows["done"] & (rows["code"] == 0))
        parts = (there[k : k + BLOCK] for k in range(0, len(there), BLOCK))
        mixed = np.concatenate([np.empty(0, np.uint64), *(_mixed(rows[part]["values"]) for part in parts)])
        order = np.argsort(mixed, kind="stable")
        self._mixed, self._runs = mixed[order], there[order]

    def find(self, values: Array) -> Runs:
        """Return where the rows with these values (n, keys) are; -1 where there is none."""
        if not len(self._runs):
            return np.full(len(values), -1)
        places = np.searchsorted(self._mixed, _mixed(values))
        which = self._runs[np.minimum(places, len(self._runs) - 1)]
        return np.where((self._rows[which]["values"] == values).all(axis=1), which, -1)


def _mixed(values: Array) -> NDArray[np.uint64]:
    mixed = np.zeros(len(values), dtype=np.uint64)
    for column in np.ascontiguousarray(values).view(np.uint64).T:
        mixed = (mixed ^ column) * MIX
        mixed ^= mixed >> np.uint64(29)
    return mixed


def _lines(path: Path) -> tuple[dict[str, str], dict[int, tuple[int, str]]]:
    """Return of which runs rows are, and why some failed; nothing where there is no such file."""
    head: dict[str, str] = {}
    reasons: dict[int, tuple[int, str]] = {}
    with contextlib.suppress(OSError, ValueError, TypeError):  # ends at a line that is not whole
        first, *lines = contents(path, MOST_REASONS).decode().splitlines()
        head = dict(json.loads(first))
        for line in lines:
            code, run, reason = json.loads(line)
            reasons[code] = run, reason
    return head, reasons
