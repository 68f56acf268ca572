"""What a search has made so far, a line for each run and derivative: the same command goes on from there.

A search makes the same runs in the same order, so what is kept takes the place of making it again.
"""

from __future__ import annotations

import contextlib
import json
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, TextIO

import numpy as np

from robodyn_cli.foreign import contents
from robodyn_cli.results.atomic import discard, output_errors
from robodyn_cli.spatial.algebra import Array

if TYPE_CHECKING:
    from robodyn_cli.over.search.points import DesignPoint, OutputSlopes

NAME = "unfinished.search"
MOST = 1_000_000_000  # bytes


class Journal:
    """Context manager around the file; without a directory nothing is kept.

    Parameters
    ----------
    head : of the search, which lines must share to be taken over.
    """

    def __init__(self, directory: Path | None = None, head: str = "") -> None:
        self._path = None if directory is None else directory / NAME
        self._head = head
        self._file: TextIO | None = None
        self._runs: dict[bytes, tuple[Array, Array, int, str]] = {}
        self._slopes: dict[tuple[bytes, bool], tuple[Array, Array, bool]] = {}
        self.taken = 0

    def __enter__(self) -> Journal:
        if self._path is not None:
            self._read(self._path)
            with output_errors(self._path):
                self._file = open(self._path, "a" if self.taken else "w", encoding="utf-8")
            if not self.taken:
                self._add({"search": self._head})
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._file is not None:
            with contextlib.suppress(OSError):
                self._file.close()

    def _read(self, path: Path) -> None:
        """Take what an earlier search has made; nothing where there is none, or it was another one."""
        with contextlib.suppress(
            OSError, ValueError, TypeError, KeyError
        ):  # ends at a line that is not whole
            first, *lines = contents(path, MOST).decode().splitlines()
            if json.loads(first)["search"] != self._head:
                return
            for line in lines:
                one = json.loads(line)
                x = np.array(one["x"]).tobytes()
                if "code" in one:
                    self._runs[x] = np.array(one["y"]), np.array(one["errors"]), one["code"], one["reason"]
                    self.taken += 1
                else:
                    self._slopes[x, one["asked"]] = (
                        np.array(one["slopes"]),
                        np.array(one["errors"]),
                        one["exact"],
                    )

    def run(self, x: Array) -> tuple[Array, Array, int, str] | None:
        """Return outputs, errors, exit code and reason of a run that is there."""
        return self._runs.pop(x.tobytes(), None)

    def slopes(self, x: Array, exact: bool) -> tuple[Array, Array, bool] | None:
        """Return derivatives (n, K), their errors, and whether any is exact; exact : asked for as such."""
        return self._slopes.pop((x.tobytes(), exact), None)

    def add_run(self, point: DesignPoint, is_new: bool) -> None:
        """Keep a run."""
        if is_new:
            self._add({"x": point.x.tolist(), "y": point.y.tolist(), "errors": point.error.tolist(),
                       "code": point.code, "reason": point.reason})  # fmt: skip

    def add_slopes(self, x: Array, slopes: OutputSlopes, exact: bool) -> None:
        """Keep derivatives."""
        self._add({"x": x.tolist(), "slopes": slopes.values.tolist(), "errors": slopes.errors.tolist(),
                   "exact": slopes.exact, "asked": exact})  # fmt: skip

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
