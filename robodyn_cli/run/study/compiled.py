"""Runs of a study in compiled code, block by block, where it asks only for what that gives."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from robodyn_cli.expr.expectation import Expectation
from robodyn_cli.record import record
from robodyn_cli.run.batch.criteria import EXIT_CODE
from robodyn_cli.run.many.command import Command
from robodyn_cli.run.many.deploy import Deploy
from robodyn_cli.run.many.inverse import Inverse
from robodyn_cli.run.many.mechanism import Mechanism
from robodyn_cli.run.many.record import ManyRuns
from robodyn_cli.run.many.simulate import Simulate
from robodyn_cli.run.study.row import Row, Task, Values
from robodyn_cli.spatial.algebra import Array

FIRST_BLOCK, LARGEST_BLOCK = 64, 8192  # runs
SECONDS_OF_BLOCK = 0.5  # about: between blocks rows are stored, and interrupts seen
STATUS = "status"
COMMANDS: dict[str, Command[Any]] = {"simulate": Simulate(), "deploy": Deploy(), "inverse": Inverse()}
GOOD = {"simulate": "ok", "deploy": "locked", "inverse": "ok"}  # status of a run that ended as it should


@record
class Block:
    """Rows of runs that were made, and the values of those that are left to be made one by one."""

    rows: list[Row]
    left: list[Values]


def suits(task: Task) -> bool:
    """Tell whether compiled code gives all that a study wants of its runs."""
    wanted = [*task.outputs, *(key for key in task.family.own.expect if key not in (EXIT_CODE, STATUS))]
    command = COMMANDS.get(task.command)
    return command is not None and all(command.is_plain(key) for key in wanted)


def blocks(task: Task, points: Sequence[Values], threads: int) -> Iterator[Block]:
    """Yield the rows of all points, a block at a time."""
    mechanism, command = Mechanism(task.family, task.keys), COMMANDS[task.command]
    expect = task.family.own.expect
    of = tuple(dict.fromkeys([*task.outputs, *(key for key in expect if command.is_plain(key))]))
    first, size = 0, FIRST_BLOCK
    while first < len(points):
        block = points[first : first + size]
        first += len(block)
        start = time.perf_counter()
        runs, left = mechanism.compiled(command, np.array(block), of, threads)
        spent = time.perf_counter() - start
        rows = _rows(task, expect, runs, block, np.isin(np.arange(len(block)), left, invert=True), spent)
        yield Block(rows, [block[k] for k in left])
        size = int(min(LARGEST_BLOCK, max(FIRST_BLOCK, size * SECONDS_OF_BLOCK / max(spent, 1e-3))))


def _rows(
    task: Task,
    expect: Mapping[str, Expectation],
    runs: ManyRuns,
    block: Sequence[Values],
    made: Array,
    spent: float,
) -> list[Row]:
    """Return the rows of the runs that were made; ``spent`` : time of all [s]."""
    none = np.empty((len(block), 0))
    outputs = np.stack([runs.outputs[key] for key in task.outputs], axis=1) if task.outputs else none
    errors = np.stack([runs.errors[key] for key in task.outputs], axis=1) if task.outputs else none
    holds = _holds(expect, runs, GOOD[task.command])
    each = spent / len(block)
    columns = zip(runs.code.tolist(), outputs.tolist(), errors.tolist(), holds.tolist(), runs.reason)
    return [
        Row(values, code, tuple(out), tuple(error), held, reason, each)
        for values, mine, (code, out, error, held, reason) in zip(block, made.tolist(), columns)
        if mine
    ]


def _holds(expect: Mapping[str, Expectation], runs: ManyRuns, status: str) -> Array:
    """Return in which runs (N,) all that a scene expects holds; in none that is refused."""
    holds = runs.ok.copy()
    for key, expected in expect.items():
        found = {EXIT_CODE: runs.code.tolist(), STATUS: [status] * len(runs)}.get(key)
        values = runs.outputs[key].tolist() if found is None else found
        holds &= np.array([expected.holds(x) for x in values], dtype=bool)
    return holds
