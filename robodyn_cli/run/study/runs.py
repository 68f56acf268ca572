"""One run of a study: values in, outputs out; and many of them, in processes side by side."""

from __future__ import annotations

import concurrent.futures as futures
import contextlib
import math
import multiprocessing
import signal
import time
from collections import deque
from collections.abc import Generator, Iterator, Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from typing import Any

from robodyn_cli.errors import RobodynError
from robodyn_cli.exit_codes import INTERNAL
from robodyn_cli.run.batch.criteria import judge
from robodyn_cli.run.commands import execute
from robodyn_cli.run.many.keys import settings
from robodyn_cli.run.many.single import error_of, number_of, reason_of, summary_of
from robodyn_cli.run.progress import no_progress
from robodyn_cli.run.stopwatch import Stopwatch
from robodyn_cli.run.study.compiled import blocks, suits
from robodyn_cli.run.study.row import Row, Task, Values
from robodyn_cli.scene.types import Scene

FEWEST_IN_PROCESSES = 16  # a process takes as long to start as some ten runs take
LONGEST_CHUNK = 64  # runs that a process is given at a time
SECONDS_OF_CHUNK = 0.5  # about


class Runner:
    """Runs the scenes of a study one after another."""

    def __init__(self, task: Task) -> None:
        self.task = task

    def scene(self, values: Sequence[float]) -> Scene:
        """Return the scene with these values.

        Raises
        ------
        SceneError : a value is not allowed there.
        """
        return self.task.family.scene(settings(self.task.keys, values))

    def one(self, values: Values) -> Row:
        """Return what the run with these values gives; whatever ends it is part of the row."""
        return self.with_summary(values)[0]

    def with_summary(self, values: Values) -> tuple[Row, Mapping[str, Any]]:
        """Return what a run gives, and its summary."""
        start = time.perf_counter()
        summary: Mapping[str, Any] = {}
        reason, code, holds = "", INTERNAL, False
        try:
            scene = self.scene(values)
            command = self.task.command
            summary, code, _ = summary_of(lambda: execute(command, scene, no_progress, Stopwatch()))
            holds = all(o.holds for o in judge(scene.expect, summary))
            reason = reason_of(summary, code)
        except RobodynError as error:
            code, reason = error.exit_code, error.message
        except Exception as error:  # a fault of the program in one run leaves the others as they are
            reason = f"{type(error).__name__}: {error}"
        outputs = tuple(number_of(summary, key) for key in self.task.outputs)
        errors = tuple(error_of(summary, key) for key in self.task.outputs)
        return Row(values, code, outputs, errors, holds, reason, time.perf_counter() - start), summary


# -- side by side ---------------------------------------------------------------------------------------
_runner: Runner | None = None  # of this process


def _begin(task: Task) -> None:
    """Prepare a process for the runs of a study; interrupts are left to the process that began it."""
    global _runner
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _runner = Runner(task)


def _run_chunk(points: Sequence[Values]) -> list[Row]:
    assert _runner is not None
    return [_runner.one(values) for values in points]


def run_all(task: Task, points: Sequence[Values], jobs: int) -> Iterator[list[Row]]:
    """Yield the rows of all points, some at a time, in the order in which they are done.

    Parameters
    ----------
    jobs : threads, or processes where compiled code does not do; with one process, or for a few points, this one runs
        them itself.
    """
    if suits(task):
        left: list[Values] = []
        for block in blocks(task, points, jobs):
            left += block.left
            yield block.rows
        points = left
    for row in _one_by_one(task, points, jobs):
        yield [row]


def _one_by_one(task: Task, points: Sequence[Values], jobs: int) -> Iterator[Row]:
    """Yield the rows of points whose runs are whole commands."""
    if jobs == 1 or len(points) < FEWEST_IN_PROCESSES:
        runner = Runner(task)
        yield from (runner.one(values) for values in points)
        return
    waiting, suspects = deque(points), deque[Values]()
    while waiting or suspects:
        # what was being run as a process died is run again one by one, to find the run that does it
        if suspects:
            lost = yield from _in_processes(task, suspects, 1)
            yield from (_killed(values, task) for values in lost)
        else:
            suspects.extend((yield from _in_processes(task, waiting, jobs)))


def _in_processes(task: Task, waiting: deque[Values], jobs: int) -> Generator[Row, None, list[Values]]:
    """Run points in processes, taking them from the queue; return those that were lost with a process."""
    alone = jobs == 1
    size = 1
    flying: dict[futures.Future[list[Row]], list[Values]] = {}
    with _pool(task, jobs) as pool:
        try:
            while waiting or flying:
                while waiting and len(flying) < (1 if alone else 2 * jobs):
                    chunk = [waiting.popleft() for _ in range(min(size, len(waiting)))]
                    flying[pool.submit(_run_chunk, chunk)] = chunk
                # without a time limit an interrupt would not be seen on every system
                done, _ = futures.wait(flying, timeout=0.2, return_when=futures.FIRST_COMPLETED)
                for future in done:
                    rows = future.result()
                    del flying[future]
                    yield from rows
                    size = 1 if alone else _next_size(rows[-1].seconds, len(waiting), jobs)
        except BrokenProcessPool:
            return [values for chunk in flying.values() for values in chunk]
    return []


@contextlib.contextmanager
def _pool(task: Task, jobs: int) -> Iterator[futures.ProcessPoolExecutor]:
    """Give a pool of processes; where the block is left early, end them at once."""
    context = multiprocessing.get_context("spawn")
    pool = futures.ProcessPoolExecutor(jobs, context, _begin, (task,))
    try:
        yield pool
    except BaseException:
        for process in multiprocessing.active_children():
            process.terminate()
        # waiting lets the pool give back its semaphores, of which Python would complain otherwise
        pool.shutdown(cancel_futures=True)
        raise
    pool.shutdown()


def _next_size(seconds: float, left: int, jobs: int) -> int:
    """Return how many runs to give a process at a time, from how long one took."""
    fitting = int(SECONDS_OF_CHUNK / max(seconds, 1e-6))
    return max(1, min(fitting, LONGEST_CHUNK, left // (4 * jobs) + 1))


def _killed(values: Values, task: Task) -> Row:
    none = (math.nan,) * len(task.outputs)
    return Row(values, INTERNAL, none, none, False, "the process of this run was ended from outside", 0.0)
