"""Runs of a study in compiled code, block by block, where it asks only for what that gives."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from robodyn_cli.commands import COMMANDS, places
from robodyn_cli.expr.statements import Expectation
from robodyn_cli.over.batch.criteria import EXIT_CODE
from robodyn_cli.over.many.command import BatchCommand, ManyRuns
from robodyn_cli.over.many.mechanism import Mechanism
from robodyn_cli.over.study.row import Points, RunRows, Task
from robodyn_cli.over.study.rows import Missing
from robodyn_cli.registry import Registry
from robodyn_cli.spatial.algebra import Array

FIRST_BLOCK, LARGEST_BLOCK = 64, 8192  # runs
SECONDS_OF_BLOCK = 0.5  # about: between blocks rows are stored, and interrupts seen
STATUS = "status"

commands: Registry[BatchCommand[Any]] = Registry("robodyn_cli", places("batch"), made=True)


def suits(task: Task) -> bool:
    """Tell whether compiled code gives all that a study wants of its runs."""
    wanted = [*task.outputs, *(key for key in task.family.own.expect if key not in (EXIT_CODE, STATUS))]
    command = commands.get(task.command)
    return command is not None and all(command.is_plain(key) for key in wanted)


class Compiled:
    """Makes runs of a study in compiled code, as far as that can be trusted."""

    def __init__(self, task: Task, threads: int) -> None:
        self.task, self.threads = task, threads
        self._mechanism, self._command = Mechanism(task.family, task.keys), commands[task.command]
        expected = (key for key in task.family.own.expect if self._command.is_plain(key))
        self._of = tuple(dict.fromkeys([*task.outputs, *expected]))

    def make(self, points: Points) -> RunRows:
        """Return the rows of those runs that could be made; the others are left to be made one by one."""
        task = self.task
        runs, left = self._mechanism.compiled(self._command, points.values, self._of, self.threads)
        rows = np.zeros(len(points), task.layout)
        rows["values"], rows["code"], rows["done"] = points.values, runs.code, True
        for k, key in enumerate(task.outputs):
            rows["outputs"][:, k], rows["errors"][:, k] = runs.outputs[key], runs.errors[key]
        rows["holds"] = _holds(task.family.own.expect, runs, COMMANDS[task.command].good)
        made = np.isin(np.arange(len(points)), left, invert=True)
        failed = np.flatnonzero(made & (runs.code != 0)).tolist()
        return RunRows(points.runs[made], rows[made], {int(points.runs[k]): runs.reason[k] for k in failed})

    def blocks(self, missing: Missing) -> Iterator[RunRows]:
        """Yield the rows of all missing runs that could be made, a block at a time."""
        size = FIRST_BLOCK
        while len(points := missing.take(size)):
            start = time.perf_counter()
            yield self.make(points)
            spent = max(time.perf_counter() - start, 1e-3)
            size = int(min(LARGEST_BLOCK, max(FIRST_BLOCK, len(points) * SECONDS_OF_BLOCK / spent)))


def _holds(expect: Mapping[str, Expectation], runs: ManyRuns, status: str) -> Array:
    """Return in which runs (N,) all that a scene expects holds; in none that is refused."""
    holds = runs.ok.copy()
    for key, expected in expect.items():
        found = {EXIT_CODE: runs.code.tolist(), STATUS: [status] * len(runs)}.get(key)
        values = runs.outputs[key].tolist() if found is None else found
        holds &= np.array([expected.holds(x) for x in values], dtype=bool)
    return holds
