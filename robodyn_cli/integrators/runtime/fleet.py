"""Many runs of one system with numbers of their own, side by side in threads that hold no interpreter lock.

Each run starts from empty memory and nothing is shared between runs, so its bits depend neither on the number of
threads nor on the order.
"""

from __future__ import annotations

import dataclasses
import math
import threading
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.registry import methods
from robodyn_cli.integrators.runtime.engine import (
    ADDRESS,
    NUMBER,
    Engine,
    doubles_at_start,
    first_step,
    integers_at_start,
)
from robodyn_cli.integrators.runtime.memory import UNARMED, DoubleSlot, IntegerSlot, Status
from robodyn_cli.integrators.runtime.options import Options, stretches
from robodyn_cli.integrators.stepping.lanes import suits, write_lanes
from robodyn_cli.integrators.stepping.many import JOB, MOST_FUNCTIONS, write_many
from robodyn_cli.kernels.compiler import CompiledModule, compile_module, machine
from robodyn_cli.kernels.program import NUMBERS
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

Integers = NDArray[np.int64]
CHUNK = 64  # runs of one call into compiled code, at most: between calls interrupts are handled
PER_LANE = 64  # the same for each lane: the last runs of a call leave lanes idle
FEW = 32  # samples, at most, to which runs in lanes go step by step; more make more steps than lanes save
COUNTED = [IntegerSlot.ACCEPTED, IntegerSlot.REJECTED, IntegerSlot.EVALUATIONS]
WAIT = 0.1  # s between looks of the calling thread at interrupts


@record
class FleetLimits:
    """Limits of single runs (N,): longest or fixed steps [s], numbers of steps; None: as in the options."""

    step: Array | None = None
    steps: Integers | None = None


NO_LIMITS = FleetLimits()


@record
class Sampling:
    """Samples of runs up to their ends: how many, and how far apart (N,) [s]; None: evenly from the start.

    before : the first of them lies a step behind this time (N,) [s].
    """

    count: int = 0
    step: Array | None = None
    before: Array | float = 0.0

    def part(self, rows: Any) -> Sampling:
        """Return the samples of some of the runs."""
        if self.step is None:
            return self
        return Sampling(self.count, self.step[rows], np.broadcast_to(self.before, self.step.shape)[rows])


NO_SAMPLES = Sampling()


@record
class Runs:
    """Rows of memory, one a run: before they are driven their starts, afterwards their ends.

    w, n : see ``DoubleSlot`` and ``IntegerSlot``. y : states. p : parameters. numbers : what the programs read. out :
    samples (N, nx, rows). status : see ``Status``.
    """

    w: Array
    n: Integers
    y: Array
    p: Array
    numbers: Array
    out: Array
    status: Integers

    def __len__(self) -> int:
        return len(self.y)

    def part(self, rows: Any) -> Runs:
        """Return some of the runs."""
        if len(rows) == len(self):
            return self
        return Runs(*(getattr(self, field.name)[rows] for field in dataclasses.fields(self)))

    def put(self, rows: Any, runs: Runs) -> None:
        """Put runs in place of these rows."""
        for field in dataclasses.fields(self):
            getattr(self, field.name)[rows] = getattr(runs, field.name)

    @property
    def time(self) -> Array:
        """Where the runs have come to [s]."""
        return self.w[:, DoubleSlot.T]

    @property
    def rounded(self) -> Array:
        """What rounding of the equations has made of rates, at most [rad/s, m/s]; 0 where it is as usual."""
        return self.w[:, DoubleSlot.ROUNDED]

    @property
    def steps(self) -> Integers:
        """Accepted steps."""
        return self.n[:, IntegerSlot.ACCEPTED]

    @property
    def rejected(self) -> Integers:
        """Rejected steps."""
        return self.n[:, IntegerSlot.REJECTED]

    @property
    def evaluations(self) -> Integers:
        """Evaluations of the rates, a vector of lanes counted as one."""
        return self.n[:, IntegerSlot.EVALUATIONS]

    @property
    def arrived(self) -> NDArray[np.bool_]:
        """Which runs have come to their end."""
        return self.status == Status.DONE


class Fleet:
    """The compiled code of a system and a method, for many runs.

    watch : whether to look for events. passing : numbers of those at which a run goes on, kept as bits; it ends at
    others.
    """

    def __init__(
        self, system: System, method: str, p: Array, watch: bool = True, passing: Sequence[int] = ()
    ) -> None:
        self.system, self.method = system, method
        self.watch = watch and bool(system.events)
        self.passing = sum(1 << k for k in passing if k < MOST_FUNCTIONS)
        self._p = p
        host, kind = machine(), methods[method]
        self.lanes = host.lanes if suits(system, kind) else 1
        self._engines = [self._engine()]
        self.stretches = np.array(list(stretches(system.breakpoints, 0.0, math.inf)))
        self._clear = np.zeros_like(self._engines[0].memory.block)
        self._many = _callable(compile_module("many runs", write_many))
        if self.lanes > 1:
            self._in_lanes = _callable(
                compile_module(
                    f"lanes {method} {system.digest} {self.tables.digest}",
                    lambda: write_lanes(system, kind, host.fused, host.lanes),
                )
            )

    def _engine(self) -> Engine:
        # the code of single runs is loaded where lanes cannot make them: as much to compile as that of lanes
        return Engine(self.system, self.method, self._p.copy(), interpreted=False, loaded=self.lanes == 1)

    @property
    def engine(self) -> Engine:
        """The code and the memory of one run."""
        self._engines[0].load()
        return self._engines[0]

    @property
    def tables(self) -> Any:
        """The tables of numbers that the code reads: a run's row holds them one after another."""
        return self._engines[0].tables

    def begin(
        self,
        starts: Array,
        numbers: Array,
        ends: Array,
        options: Options,
        limits: FleetLimits = NO_LIMITS,
        sampling: Sampling = NO_SAMPLES,
    ) -> Runs:
        """Return runs from ``starts`` (N, nx) at t = 0 to ``ends`` (N,) [s]; limits : of single runs."""
        memory, count = self._engines[0].memory, len(starts)
        w = np.zeros((count, len(memory.w)))
        n = np.zeros((count, IntegerSlot.SIZE), dtype=np.int64)
        for slot, value in doubles_at_start(0.0, options).items():
            w[:, slot] = value
        for slot, number in integers_at_start(self.system.nv).items():
            n[:, slot] = number
        n[:, IntegerSlot.MAX_STEPS] = options.max_steps if limits.steps is None else limits.steps
        if self.watch:
            n[:, IntegerSlot.WATCH] = UNARMED
        self.set_steps(w, ends, options, limits.step)
        if updates := self.system.updates:
            n[:, IntegerSlot.UPDATES], n[:, IntegerSlot.PHASE], w[:, DoubleSlot.NEXT_UPDATE] = updates.after(
                0.0
            )
        if samples := sampling.count:
            n[:, IntegerSlot.NEXT_SAMPLE], n[:, IntegerSlot.LAST_SAMPLE] = 1, samples
            n[:, IntegerSlot.CAPACITY] = samples
            w[:, DoubleSlot.SAMPLE_STEP] = ends / samples if sampling.step is None else sampling.step
            w[:, DoubleSlot.SAMPLE_START] = sampling.before
        if options.draw:
            numbers = numbers * self.tables.off_by_rounding(options.draw)
        out = np.zeros((count, self.system.size, samples))
        p = np.tile(self._p, (count, 1))
        return Runs(w, n, np.array(starts), p, np.ascontiguousarray(numbers), out, np.full(count, -1))

    @staticmethod
    def set_steps(w: Array, ends: Array, options: Options, own: Array | None) -> None:
        """Set ends and steps in rows of doubles; own : the longest or fixed step of each run."""
        fixed = options.step is not None
        longest: Any = (options.step if fixed else options.max_step) if own is None else own
        longest = options.part_of_way(longest, ends) if fixed else longest
        first = longest if fixed else np.minimum(first_step(ends, options), longest)
        w[:, DoubleSlot.T_END], w[:, DoubleSlot.H_MAX] = ends, longest
        w[:, DoubleSlot.H] = w[:, DoubleSlot.H_OLD] = first

    def drive(self, runs: Runs, threads: int = 1) -> None:
        """Make the runs, up to their end, their first event or what stops them."""
        samples = runs.out.shape[2]
        if self.lanes == 1 or samples > FEW:
            self._drive(runs, threads, 1)
        elif samples:
            self._drive_to_samples(runs, threads)
        else:
            self._drive(runs, threads, self.lanes)

    def drive_one_by_one(self, runs: Runs) -> None:
        """Make the runs one after another, by the loop of a single run."""
        self._drive(runs, 1, 1)

    def _drive_to_samples(self, runs: Runs, threads: int) -> None:
        """Make the runs in lanes, which have no output between steps: steps end at the samples."""
        ends, most, samples = (
            runs.w[:, DoubleSlot.T_END].copy(),
            runs.n[:, IntegerSlot.MAX_STEPS].copy(),
            runs.out.shape[2],
        )
        counts = np.zeros((len(runs), len(COUNTED)), dtype=np.int64)
        status = np.full(len(runs), int(Status.DONE))
        for k in range(samples):
            runs.w[:, DoubleSlot.T_END] = ends * ((k + 1) / samples)
            runs.n[:, IntegerSlot.MAX_STEPS] = most - counts[:, 0] - counts[:, 1]
            self._drive(runs, threads, self.lanes)
            runs.out[:, :, k] = runs.y
            counts += runs.n[:, COUNTED]
            status = np.where(status == Status.DONE, runs.status, status)
        # a step may end a stretch and be one too many
        many = (status == Status.DONE) & (counts[:, 0] + counts[:, 1] > most)
        runs.n[:, COUNTED], runs.status[:] = counts, np.where(many, int(Status.MAX_STEPS), status)

    def _drive(self, runs: Runs, threads: int, lanes: int) -> None:
        many, most = (self._many, CHUNK) if lanes == 1 else (self._in_lanes, PER_LANE * lanes)
        size = max(lanes, min(most, len(runs) // (4 * threads)))
        chunks = deque((k, min(k + size, len(runs))) for k in range(0, len(runs), size))
        crew_size = min(threads, len(chunks))
        while len(self._engines) < crew_size:
            self._engines.append(self._engine())
        if lanes == 1:
            for engine in self._engines[:crew_size]:
                engine.load()
        stop = np.zeros(1, dtype=np.int64)
        job = self._job(runs, stop)
        workers = [_Worker(engine, many, job, chunks) for engine in self._engines[:crew_size]]
        if len(workers) < 2:
            for worker in workers:
                worker.work()
            return
        crew = [threading.Thread(target=worker.work, daemon=True) for worker in workers]
        try:
            for thread in crew:
                thread.start()
            for thread in crew:
                while thread.is_alive():
                    thread.join(WAIT)
        except BaseException:
            stop[0] = 1
            chunks.clear()
            # compiled code writes into the arrays of the runs until the run that it is at has ended
            for thread in crew:
                if thread.ident is not None:
                    thread.join()
            raise

    def _job(self, runs: Runs, stop: Integers) -> Integers:
        """Return the table ``JOB`` of these runs, all of whose arrays are kept by the caller."""
        run, trial, close, _ = self._engines[0].addresses
        fields: dict[str, int] = {
            "run": run, "trial": trial, "close": close, "stop": stop.ctypes.data, "clear": self._clear.ctypes.data,
            "events": len(self.system.events), "passing": self.passing,
            "stops": len(self.stretches), "stretches": self.stretches.ctypes.data,
            "all.status": runs.status.ctypes.data,
        }  # fmt: skip
        rows = {"w": runs.w, "n": runs.n, "y": runs.y, "p": runs.p, NUMBERS: runs.numbers, "out": runs.out}
        for name, array in rows.items():
            fields[f"all.{name}"] = array.ctypes.data
            fields[f"bytes.{name}"] = array.nbytes // max(len(array), 1)
        return np.array([fields[name] for name in JOB], dtype=np.int64)


def _callable(compiled: CompiledModule) -> Callable[..., int]:
    return compiled.function("many", ADDRESS, ADDRESS, NUMBER, NUMBER, result=NUMBER)


class _Worker:
    """One thread's engine, and the chunks of runs that it takes from the queue."""

    def __init__(
        self, engine: Engine, many: Callable[..., int], job: Integers, chunks: deque[tuple[int, int]]
    ) -> None:
        self._places, self._job, self._many, self._chunks = engine.addresses[-1], job, many, chunks

    def work(self) -> None:
        """Make chunk after chunk until there are none."""
        while True:
            try:
                first, last = self._chunks.popleft()
            except IndexError:
                return
            self._many(self._places, self._job.ctypes.data, first, last)
