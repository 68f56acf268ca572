"""What a search has made so far, a line for each run and derivative: the same command goes on from there.

A search makes the same runs in the same order, so what is kept takes the place of making it again.
"""

from __future__ import annotations

import contextlib
import json
from pathlib import Path
from types import TracebackType
from typing import Any, TextIO

import numpy as np

from robodyn_cli.foreign import contents
from robodyn_cli.results.atomic import anew, discard, output_errors
from robodyn_cli.spatial.algebra import Array

NAME = "unfinished.search"
MOST = 1_000_000_000  # bytes
# outputs and errors (n,), exit code, why it failed, whether compiled code has made it
KeptRun = tuple[Array, Array, int, str, bool]
# derivatives (n, K), their errors, how far outputs jump (n,), whether any is exact
KeptSlopes = tuple[Array, Array, Array, bool]


class SearchJournal:
    """Context manager around the file; without a directory nothing is kept.

    Parameters
    ----------
    head : of the search, which lines must share to be taken over.
    """

    def __init__(self, directory: Path | None = None, head: str = "") -> None:
        self._path = None if directory is None else directory / NAME
        self._head = head
        self._file: TextIO | None = None
        self._runs: dict[bytes, KeptRun] = {}
        self._slopes: dict[bytes, KeptSlopes] = {}
        self.taken = 0

    def __enter__(self) -> SearchJournal:
        if self._path is not None:
            whole = self._read(self._path)
            with output_errors(self._path):
                self._file = anew(self._path)
            self._add({"search": self._head})
            for line in whole:
                self._add(line)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._file is not None:
            with contextlib.suppress(OSError):
                self._file.close()

    def _read(self, path: Path) -> list[dict[str, Any]]:
        """Take what an earlier search has made, and return its lines; nothing where it was another one."""
        whole: list[dict[str, Any]] = []
        # ends at a line that is not whole
        with contextlib.suppress(OSError, ValueError, TypeError, KeyError):
            first, *lines = contents(path, MOST).decode().splitlines()
            if json.loads(first)["search"] != self._head:
                return whole
            for line in lines:
                one = json.loads(line)
                x, errors = np.array(one["x"]).tobytes(), np.array(one["errors"])
                if "code" in one:
                    self._runs[x] = np.array(one["y"]), errors, one["code"], one["reason"], one["compiled"]
                    self.taken += 1
                else:
                    self._slopes[x] = np.array(one["slopes"]), errors, np.array(one["jumps"]), one["exact"]
                whole.append(one)
        return whole

    def run(self, x: Array) -> KeptRun | None:
        """Return outputs, errors, exit code and reason of a run that is there."""
        return self._runs.pop(x.tobytes(), None)

    def slopes(self, x: Array) -> KeptSlopes | None:
        """Return derivatives (n, K) and what belongs to them, see ``KeptSlopes``."""
        return self._slopes.pop(x.tobytes(), None)

    def add_run(self, x: Array, run: KeptRun) -> None:
        """Keep a run, as ``run`` returns it."""
        y, errors, code, reason, compiled = run
        self._add({"x": x.tolist(), "y": y.tolist(), "errors": errors.tolist(), "code": code, "reason": reason,
                   "compiled": compiled})  # fmt: skip

    def add_slopes(self, x: Array, slopes: KeptSlopes) -> None:
        """Keep derivatives, as ``slopes`` returns them."""
        values, errors, jumps, own = slopes
        self._add({"x": x.tolist(), "slopes": values.tolist(), "errors": errors.tolist(),
                   "jumps": jumps.tolist(), "exact": own})  # fmt: skip

    def _add(self, line: dict[str, Any]) -> None:
        if self._file is None or self._path is None:
            return
        with output_errors(self._path):
            self._file.write(json.dumps(line) + "\n")
            self._file.flush()

    def forget(self) -> None:
        """Remove the file."""
        if self._path is not None:
            discard(self._path)
