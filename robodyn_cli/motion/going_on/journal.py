"""What a long run has come to, block by block, so that it goes on where it was when it was killed.

The file begins with a line that says of which run it is. Each block follows as a line (JSON: the shape, the counters,
the changes of method, what watchers have noted) and its numbers: times (m,), states (m, nx) and parameters (np,), as
doubles. A block that was being written when the run ended is not used.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from robodyn_cli.errors import SceneError
from robodyn_cli.motion.driver import Driver, MethodChange
from robodyn_cli.record import record
from robodyn_cli.results.atomic import output_errors
from robodyn_cli.results.provenance import sha256
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.motion import Counters
from robodyn_cli.version import code_digest

DOUBLE = np.dtype("<f8")


@record
class JournalBlock:
    """Samples at times t (m,) with states x (m, nx), all with parameters p; what the run had done by then.

    noted : by the driver's watchers, in their order.
    """

    t: Array
    x: Array
    p: Array
    counters: Counters
    changes: tuple[MethodChange, ...]
    noted: tuple[dict[str, float], ...]


class Journal:
    """Context manager around the file of one run.

    resume : whether to take over the blocks of an earlier run; ``taken`` tells whether there are any.

    Raises
    ------
    SceneError : the blocks are of another scene, or of other settings.
    """

    def __init__(self, path: Path, scene: Scene, resume: bool = False) -> None:
        self.path = path
        self._head = {"scene": sha256(scene.text), "code": code_digest()}
        self._length = 0
        self.taken = resume and self._find(scene)
        self._file: BinaryIO | None = None

    def _find(self, scene: Scene) -> bool:
        """Tell whether there are blocks of this run, and note how long the file is up to its last whole one."""
        found = False
        if not self.path.exists():
            return False
        with output_errors(self.path), open(self.path, "rb") as file:
            head = _line(file)
            if head is not None and head != self._head:
                raise SceneError(
                    f"{scene.path}: the unfinished run in {self.path} is of another scene, other settings or other "
                    "code of robodyn; allowed: the same ones, or a run from the start, without --resume",
                    file=scene.path,
                )
            for _ in _blocks(file):
                self._length, found = file.tell(), True
        return found

    def __enter__(self) -> Journal:
        with output_errors(self.path):
            if self.taken:
                os.truncate(self.path, self._length)
                self._file = open(self.path, "ab")
            else:
                self._file = open(self.path, "wb")
                self._write(json.dumps(self._head).encode() + b"\n")
        return self

    def __exit__(self, *error: object) -> None:
        if self._file is not None:
            with contextlib.suppress(OSError):
                self._file.close()

    def blocks(self) -> Iterator[JournalBlock]:
        """Yield the blocks that were taken over."""
        if self.taken:
            with open(self.path, "rb") as file:
                _line(file)
                for block in _blocks(file):
                    yield block
                    if file.tell() >= self._length:  # behind it are those that this run adds
                        return

    def add(self, t: Array, x: Array, driver: Driver) -> None:
        """Write a block of samples; it is in the file when this returns."""
        p = driver.parameters
        head = {
            "shape": [*x.shape, len(p)],
            "counters": dataclasses.astuple(driver.counters),
            "changes": [dataclasses.astuple(change) for change in driver.changes],
            "noted": [watcher.noted for watcher in driver.watchers],
        }
        numbers = np.concatenate([t, x.ravel(), p]).astype(DOUBLE)
        with output_errors(self.path):
            self._write(json.dumps(head).encode() + b"\n" + numbers.tobytes())

    def _write(self, data: bytes) -> None:
        assert self._file is not None
        self._file.write(data)
        self._file.flush()


def _line(file: BinaryIO) -> dict[str, Any] | None:
    """Return the next line, None where there is no whole one."""
    line = file.readline()
    with contextlib.suppress(ValueError):
        found = json.loads(line)
        if line.endswith(b"\n") and isinstance(found, dict):
            return found
    return None


def _blocks(file: BinaryIO) -> Iterator[JournalBlock]:
    """Yield the whole blocks from here on."""
    while (head := _line(file)) is not None:
        m, n, k = head["shape"]
        data = file.read(DOUBLE.itemsize * (m * (n + 1) + k))
        if len(data) < DOUBLE.itemsize * (m * (n + 1) + k):
            return
        t, x, p = np.split(np.frombuffer(data, DOUBLE).copy(), [m, m * (n + 1)])
        changes = tuple(MethodChange(*c) for c in head["changes"])
        yield JournalBlock(t, x.reshape(m, n), p, Counters(*head["counters"]), changes, tuple(head["noted"]))
