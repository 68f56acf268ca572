"""Runs of a study: in compiled code, block by block, where it asks only for what that gives, or as whole commands, many
of them in processes side by side."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import multiprocessing
import os
import signal
import sys
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from multiprocessing.connection import Connection, wait
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.commands import COMMANDS, places
from robodyn_cli.errors import FAILED, INTERRUPTED, SceneError
from robodyn_cli.expr.statements import Expectation
from robodyn_cli.over.batch.criteria import EXIT_CODE, judge
from robodyn_cli.over.commands import execute
from robodyn_cli.over.many.command import STATUS, BatchCommand, ManyRuns, ended, error_of, number_of
from robodyn_cli.over.many.groups import Built
from robodyn_cli.over.many.keys import Key, settings
from robodyn_cli.over.many.mechanism import Mechanism
from robodyn_cli.over.study.rows import Missing, Points, RowFile, RunRows, Task, joined, killed, told
from robodyn_cli.registry import Registry
from robodyn_cli.results.atomic import uninterrupted
from robodyn_cli.scene.checks.columns import asking
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.threads import without_main
from robodyn_cli.tools.progress import Progress, Stopwatch, no_progress

FIRST_BLOCK, LARGEST_BLOCK = 64, 8192  # runs
SECONDS_OF_BLOCK = 0.5  # about: between blocks rows are stored, and interrupts seen
MOST_KEYS = 3  # that are named

commands: Registry[BatchCommand[Any]] = Registry("robodyn_cli", places("batch"), made=True)


def suits(task: Task) -> bool:
    """Tell whether compiled code gives all that a study wants of its runs."""
    return _command_of(task) is not None and not beyond(task) and task.family.own.initial.source is None


def _command_of(task: Task) -> BatchCommand[Any] | None:
    """Return what makes many runs of a study; None where nothing does."""
    command = commands.get(task.command)
    if command is None or not task.family.own.deploy.latches:
        return command
    from robodyn_cli.over.many.latched import command_for

    return command_for(command, task.family.own)


def beyond(task: Task) -> list[str]:
    """Return the outputs and expectations of a study that compiled code does not give."""
    command = _command_of(task)
    judged = task.family.own.motorisation is not None and not (command is not None and command.judges)
    margins = ["motorisation"] if judged else []  # decide the exit code
    wanted = [
        *task.outputs,
        *margins,
        *(key for key in task.family.own.expect if key not in (EXIT_CODE, STATUS)),
    ]
    return [key for key in dict.fromkeys(wanted) if command is None or not command.is_plain(key)]


def why_slow(task: Task) -> str:
    """Return in a line why runs of a study are whole commands; empty where compiled code makes them."""
    if suits(task):
        return ""
    keys = beyond(task)
    if task.command not in commands:
        return f"each run is a whole command: there is no compiled code of {task.command} for many runs"
    if not keys:
        return "each run is a whole command: it goes on from a stored one (initial.from)"
    more = f" and {len(keys) - MOST_KEYS} more" if len(keys) > MOST_KEYS else ""
    command = _command_of(task)
    slow = () if command is None else command.slow.items()
    more += next((f" ({why})" for head, why in slow if keys[0].startswith(head)), "")
    advice = "" if set(keys) & set(task.outputs) else " of expect (--set expect={} leaves it out)"
    return f"each run is a whole command: compiled code does not give {', '.join(keys[:MOST_KEYS])}{more}{advice}"


class Compiled:
    """Makes runs of a study in compiled code, as far as that can be trusted."""

    def __init__(self, task: Task, threads: int, keys: tuple[Key, ...] = ()) -> None:
        """``keys`` : what the keys of the task are, where that is known."""
        self.task, self.threads = task, threads
        command = _command_of(task)
        assert command is not None
        self._mechanism, self._command = Mechanism(task.family, task.keys, keys), command
        expected = (
            key for key in task.family.own.expect if command.is_plain(key) and key not in command.words
        )
        self._of = tuple(dict.fromkeys([*task.outputs, *expected]))
        self.left: Counter[str] = Counter()  # why runs were left to the command, and how many

    def allow(self, values: Array) -> None:
        """Check values (N, keys) that others will lie between, so that those need no look of their own."""
        self._mechanism.refusals(values)

    def make(self, points: Points) -> RunRows:
        """Return the rows of those runs that could be made; the others are left to be made one by one."""
        task = self.task
        runs, left = self._mechanism.compiled(self._command, points.values, self._of, self.threads)
        self.left.update(runs.left)
        rows = np.zeros(len(points), task.layout)
        rows["values"], rows["code"], rows["done"] = points.values, runs.code, True
        rows["series"] = runs.series
        for k, key in enumerate(task.outputs):
            rows["outputs"][:, k], rows["errors"][:, k] = runs.outputs[key], runs.errors[key]
        words = {STATUS: COMMANDS[task.command].good, **self._command.words}
        rows["holds"] = _holds(task.family.own.expect, runs, words, self._command.missed)
        made = np.isin(np.arange(len(points)), left, invert=True)
        failed = np.flatnonzero(made & (runs.code != 0)).tolist()
        return RunRows(points.runs[made], rows[made], {int(points.runs[k]): runs.reason[k] for k in failed})

    def structures(self, values: Array) -> list[tuple[Built, NDArray[np.int64]]]:
        """Return the structures that serve rows of values (N, keys), with the numbers of their rows."""
        return self._mechanism.structures(self._command, values)

    def blocks(self, missing: Missing) -> Iterator[RunRows]:
        """Yield the rows of all missing runs that could be made, a block at a time."""
        size = FIRST_BLOCK
        while len(points := missing.take(size)):
            start = time.perf_counter()
            yield self.make(points)
            spent = max(time.perf_counter() - start, 1e-3)
            size = int(min(LARGEST_BLOCK, max(FIRST_BLOCK, len(points) * SECONDS_OF_BLOCK / spent)))


def _holds(
    expect: Mapping[str, Expectation], runs: ManyRuns, words: Mapping[str, Any], missed: Mapping[str, Any]
) -> Array:
    """Return in which runs (N,) all that a scene expects holds; in none that is refused.

    words : of runs that end as they should, missed : of those that do not, all for the same reason.
    """
    good, holds = runs.ok, runs.ok | (runs.code == FAILED)
    for key, expected in expect.items():
        if key == EXIT_CODE or (key not in words and key in runs.outputs):
            values: list[Any] = (runs.code if key == EXIT_CODE else runs.outputs[key]).tolist()
        else:
            values = [words[key] if ok else missed.get(key) for ok in good]
        holds &= np.array([expected.holds(x) for x in values], dtype=bool)
    return holds


FEWEST_IN_PROCESSES = 16  # a process takes as long to start as some ten runs take
LONGEST_CHUNK = 64  # runs that a process is given at a time
SECONDS_OF_CHUNK = 0.5  # about


def make_alone(task: Task, points: Points) -> RunRows:
    """Return what whole commands give, one after another."""
    return joined([make_one(task, int(run), values)[0] for run, values in zip(points.runs, points.values)])


def make_one(task: Task, run: int, values: Array) -> tuple[RunRows, Mapping[str, Any]]:
    """Return what a run with these values gives, and its summary; whatever ends it is part of its row."""
    words, holds = settings(task.keys, values), False
    ending = ended(
        lambda: execute(
            task.command, asking(task.family.scene(words), task.outputs), no_progress, Stopwatch()
        )
    )
    if ending.summary:
        try:
            holds = all(outcome.holds for outcome in judge(task.family.own.expect, ending.summary))
        except SceneError as error:  # the scene expects something that this run does not have
            ending = dataclasses.replace(ending, code=error.exit_code, reason=error.message)
    row = np.zeros(1, task.layout)
    row["values"], row["code"], row["holds"], row["done"] = values, ending.code, holds, True
    row["outputs"] = [number_of(ending.summary, key) for key in task.outputs]
    row["errors"] = [error_of(ending.summary, key) for key in task.outputs]
    return RunRows(np.array([run]), row, {run: ending.reason} if ending.code else {}), ending.summary


# -- side by side ---------------------------------------------------------------------------------------
def _serve(pipe: Connection, task: Task) -> None:
    """Make the runs that come through a pipe and send what they give, or the error, and the time that one took [s].

    Ends with the process that began it, however that ends, and leaves interrupts to it.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with contextlib.suppress(EOFError, OSError):  # the pipe is closed
        while True:
            points: Points = pipe.recv()
            start = time.perf_counter()
            made: RunRows | Exception
            try:
                made = make_alone(task, points)
            except Exception as error:
                made = error
            pipe.send((made, (time.perf_counter() - start) / len(points)))


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(INTERRUPTED)


def run_here(
    task: Task,
    file: RowFile,
    jobs: int,
    tell: Callable[[str], None] = lambda text: None,
    seconds: float = math.nan,
) -> Iterator[RunRows]:
    """Yield the rows of all missing runs, some at a time, in the order in which they are done.

    The caller puts them into the file.

    Parameters
    ----------
    jobs : threads, or processes where compiled code does not do; with one process, or for a few points, this one runs
        them itself.
    tell : is told how many runs compiled code leaves to whole commands, and why, and how long these took. seconds :
        that the scene as it stands took, as a whole command.
    """
    reasons: Counter[str] = Counter()
    if suits(task):
        compiled = Compiled(task, jobs)
        yield from compiled.blocks(file.missing())
        reasons = compiled.left
    missing = file.missing()
    count, start = missing.left, time.perf_counter()
    if count and reasons:
        why = "; ".join(
            f"{number}: {reason}" if len(reasons) > 1 else reason for reason, number in reasons.items()
        )
        tell(
            f"robodyn: compiled code leaves {count} of {len(file)} runs to whole commands: {why}; {cost_of(seconds)}"
        )
    yield from one_by_one(task, missing, jobs)
    if count:
        each = (time.perf_counter() - start) / count
        tell(f"robodyn: {count} of {len(file)} runs were whole commands, {each:.2g} s each")


def cost_of(seconds: float) -> str:
    """Return in words how long a whole command took."""
    return f"that of the scene as it stands took {seconds:.2g} s"


def run_points(
    task: Task, points: Points, jobs: int, compiled: Compiled | None = None, progress: Progress = no_progress
) -> RunRows:
    """Return the rows of runs that are few enough for memory.

    jobs : as for ``run_here``. compiled : code of the task that is there already.
    """
    parts, n = [], len(points)
    if suits(task):
        parts.append((compiled or Compiled(task, jobs)).make(points))
        points = points.part(np.isin(points.runs, parts[0].runs, invert=True))
    return joined([*parts, *told(one_by_one(task, Waiting([points]), jobs), n, progress, n - len(points))])


def one_by_one(task: Task, missing: SceneSource, jobs: int) -> Iterator[RunRows]:
    """Yield the rows of runs that are whole commands."""
    if jobs == 1 or missing.left < FEWEST_IN_PROCESSES:
        while missing.left:
            yield make_alone(task, missing.take(1))
        return
    suspects = Waiting()
    while missing.left or suspects.left:
        # what was being run as a process died is run again one by one, to find the run that does it
        if suspects.left:
            lost = yield from _in_processes(task, suspects, 1)
            yield from (killed(points, task) for points in lost)
        else:
            suspects = Waiting((yield from _in_processes(task, missing, jobs)))


class SceneSource(Protocol):
    """Where runs are taken from; ``left`` are there."""

    @property
    def left(self) -> int: ...
    def take(self, most: int) -> Points: ...


class Waiting:
    """Runs that wait to be made one by one."""

    def __init__(self, points: Sequence[Points] = ()) -> None:
        self._queue: deque[Points] = deque()
        for part in points:
            self.add(part)

    def add(self, points: Points) -> None:
        """Put runs at the end of the queue."""
        self._queue.extend(points.part([k]) for k in range(len(points)))

    @property
    def left(self) -> int:
        return len(self._queue)

    def take(self, most: int) -> Points:
        """Return the next of them."""
        return self._queue.popleft()


def _in_processes(task: Task, source: SceneSource, jobs: int) -> Generator[RunRows, None, list[Points]]:
    """Run what a source has in processes, until one dies; return the runs that were lost with it."""
    size = 1
    flying: dict[Any, Points] = {}
    lost: list[Points] = []
    with _workers(task, jobs) as idle:
        while flying or (source.left and not lost):
            while source.left and idle and not lost:
                pipe = idle.pop()
                flying[pipe] = source.take(size)
                with contextlib.suppress(OSError):  # it has died: seen below
                    pipe.send(flying[pipe])
            # without a time limit an interrupt would not be seen on every system
            ready: list[Any] = wait(list(flying), timeout=0.2)
            for pipe in ready:
                points = flying.pop(pipe)
                try:
                    made, seconds = pipe.recv()
                except (EOFError, OSError):
                    lost.append(points)
                    continue
                if isinstance(made, Exception):
                    raise made
                idle.append(pipe)
                yield made
                size = 1 if jobs == 1 else _next_size(seconds, source.left, jobs)
    return lost


@contextlib.contextmanager
def _workers(task: Task, jobs: int) -> Iterator[list[Any]]:
    """Give pipes to processes; where the block is left early, end them at once.

    A pool of the library shares semaphores with its processes, which outlive it where it is killed.
    """
    context = multiprocessing.get_context("spawn")
    pairs = [context.Pipe() for _ in range(jobs)]
    processes = [context.Process(target=_serve, args=(theirs, task), daemon=True) for _, theirs in pairs]
    try:
        with _interrupts_held(), without_main():
            for process in processes:
                process.start()
        for _, theirs in pairs:
            theirs.close()
        yield [mine for mine, _ in pairs]
    except BaseException:
        for process in processes:
            if process.pid is not None:
                process.terminate()
        raise
    finally:
        for mine, _ in pairs:
            mine.close()
        for process in processes:
            if process.pid is not None:
                process.join()


@contextlib.contextmanager
def _interrupts_held() -> Iterator[None]:
    """Hold interrupts back in the block; processes that begin in it never get any.

    The mask goes to the processes. It does not suffice here: a thread of another library may take the signal, and
    Python then raises in this one, with a process half begun.
    """
    with uninterrupted():
        if sys.platform == "win32":
            yield
            return
        from multiprocessing import resource_tracker

        # which the first process starts otherwise, and lets interrupts pass again after that
        resource_tracker.ensure_running()
        before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _next_size(seconds: float, left: int, jobs: int) -> int:
    """Return how many runs to give a process at a time, from how long one took."""
    fitting = int(SECONDS_OF_CHUNK / max(seconds, 1e-6))
    return max(1, min(fitting, LONGEST_CHUNK, left // (4 * jobs) + 1))
