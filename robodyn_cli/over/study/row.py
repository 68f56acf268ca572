"""What the runs of a study share, and what some of them gave."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.exit_codes import INTERNAL
from robodyn_cli.record import record
from robodyn_cli.scene.load import Family
from robodyn_cli.spatial.algebra import Array

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

        values : of the keys. outputs, errors : numbers, nan where a run has none. code : exit code that the command
        would have. holds : whether all of ``expect`` holds. done : 1 once the run was made.
        """
        keys, outputs = (len(self.keys),), (len(self.outputs),)
        return np.dtype([
            ("values", "<f8", keys), ("outputs", "<f8", outputs), ("errors", "<f8", outputs),
            ("code", "<i2"), ("holds", "?"), ("done", "?"),
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
