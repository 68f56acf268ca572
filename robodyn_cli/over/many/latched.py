"""Many deployments with latches: each run goes from event to event with the watchers of the command, on equations and
compiled code that are built once for all of them."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from functools import cached_property, partial
from typing import Any

import numpy as np

from robodyn_cli.errors import OF_STATUS, RobodynError
from robodyn_cli.integration_methods import DEFAULT
from robodyn_cli.integrators.runtime.options import Grid, Options
from robodyn_cli.motion.contact.latch_states import beside, doubts
from robodyn_cli.motion.contact.latches import Latches
from robodyn_cli.motion.driver import Driver
from robodyn_cli.motion.error import Attempt, First, Masks, integrate_again, remainder
from robodyn_cli.motion.method import FAST_DECAYS
from robodyn_cli.motion.motion import Motion
from robodyn_cli.motion.second_run import watched_again
from robodyn_cli.motion.self_check import is_judged_by_energy
from robodyn_cli.motion.stiffness import FIRST_LOOK, WORTH
from robodyn_cli.over.many.closings import ClosedRuns, LatchFacts, suits
from robodyn_cli.over.many.command import AskedRuns, BatchCommand, ManyRuns, Rows, ended
from robodyn_cli.over.many.course import OTHERS, motions_of
from robodyn_cli.over.many.groups import first_of, table_rows
from robodyn_cli.over.many.integrate import RunBatch, decays_of, keeps_energy
from robodyn_cli.over.many.locks import ALONG
from robodyn_cli.over.many.simulate import COUNTERS, LOCK_ERRORS, SECOND_STEPS, Deploy
from robodyn_cli.over.many.structure import Structure
from robodyn_cli.record import record
from robodyn_cli.scene.checks.columns import asking, column_of
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.apart import ROUNDED
from robodyn_cli.summaries.facts import Fact
from robodyn_cli.summaries.keys import leaf_of
from robodyn_cli.works.deploy.latched import deploy_latched, time_error, told_of, watcher_of

SAMPLES = 4_000_000  # numbers that samples of runs in compiled code take at a time
OF_LATCHES = ("locks", "missed")
OF_BUILD = ("assembly", "wall_time_s")  # sections of the summary that tell of what runs share here
ENDS = ("lock.time", "lock.time_error", "termination.time")
NOTHING_ALONG = (math.nan,) * len(ALONG)
# what the summary says of every run that locks
WORDS: dict[str, Any] = {"lock.kind": "latched", "lock.criterion": "latches", "lock.driven": False}


class DeployLatches(Deploy):
    """Deployments with latches; ends are the states at the last closings."""

    words = WORDS
    follows_events = True

    def __init__(self, scene: Scene) -> None:
        self.scene = scene

    def obstacle(self, motion: Motion) -> str:
        latches = motion.problem.latches
        reasons = {
            "a controller acts": motion.problem.control is not None,
            "joints stick or meet stops by numbers that the equations do not hold": bool(
                motion.problem.contact_joints
            ),
            "a latch closes in a dead point (at_dead_point), where a determinant of numbers passes zero": any(
                latch.spec.at_dead_point for latch in latches
            ),
            "loads are judged on samples": bool(motion.scene.deploy.loads),
            "payloads are gripped or released": bool(motion.problem.model.switched),
            "singular poses are passed": motion.scene.simulate.singular == "pass",
        }
        return first_of(reasons)

    def gives(self, key: str) -> bool:
        group, _, rest = key.partition(".")
        figure = key in LOCK_ERRORS or key.startswith(("lock.angles.", "lock.rates."))
        on_the_way = bool(column_of(self.scene, key))  # the largest load of a rigid one
        return key in ENDS or figure or (group in OF_LATCHES and rest.count(".") >= 1 and not on_the_way)

    def is_plain(self, key: str) -> bool:
        leaf = leaf_of(self.name, key)
        own = leaf is not None and leaf.is_number and key.partition(".")[0] not in OF_BUILD
        return own or key in self.words

    def _in_code(self, key: str) -> bool:
        """Tell whether runs in compiled code note what this key of the summary needs."""
        return key in (*COUNTERS, SECOND_STEPS, *ALONG, *self.words) or self.gives(key)

    def make(self, structure: Structure, rows: Rows, asked: AskedRuns) -> list[int]:
        choice, result = structure.motion.choice, asked.result
        q, qd = (None if x is None else x[rows] for x in (asked.q, asked.qd))
        batch = RunBatch.of(structure, result.values[rows], q, qd, asked.threads)
        method = DEFAULT if choice.may_change else choice.method
        trusted = batch.starts.sound.copy()
        if choice.may_change:  # those are looked into by the command
            trusted &= decays_of(batch) * batch.ends < FAST_DECAYS
        in_code, along = all(map(self._in_code, result.outputs)), any(key in ALONG for key in result.outputs)
        made: list[int] = []
        if in_code:
            alike = structure.observed_alike(batch.numbers) if along else True
            for runs in _closed(batch, method, trusted & alike, along):
                made += _keep(batch, runs, rows, result)
        trusted[made] = False
        if along or not in_code:
            made += self._as_commands(batch, method, trusted, rows, result)
        elif trusted.any():
            runner = _Runner(batch, method)
            alone = {k: runner.make(k) for k in np.flatnonzero(trusted).tolist()}
            made += _keep(batch, {k: run for k, run in alone.items() if run is not None}, rows, result)
        return np.delete(rows, made).tolist()

    def _as_commands(
        self, batch: RunBatch, method: str, trusted: Masks, rows: Rows, result: ManyRuns
    ) -> list[int]:
        """Make runs of a batch as the command does, on equations that are there already; return those that are made."""
        keys, made = list(result.outputs), []
        reactions = asking(batch.structure.motion.scene, keys).outputs.reactions
        own = np.flatnonzero(trusted & batch.structure.observed_alike(batch.numbers, reactions))
        for k, motion in zip(own.tolist(), motions_of(batch.part(own), keys, method)):
            run = ended(partial(deploy_latched, motion, motion.beginning))
            if run.summary and "error" not in run.summary:
                result.take(int(rows[k]), run)
                self.read(run.summary, result, int(rows[k]))
                made.append(k)
        return made


def _closed(batch: RunBatch, method: str, trusted: Masks, along: bool) -> Iterator[dict[int, LatchedRun]]:
    """Yield the runs that compiled code makes alone, of those that are trusted, by their numbers; ``along`` : with
    the figures of samples."""
    if not (trusted.any() and suits(batch, method)):
        return
    samples = batch.structure.motion.scene.simulate.samples
    parts = 1 + np.count_nonzero(trusted) * samples * batch.states.shape[1] // SAMPLES
    for rows in np.array_split(np.flatnonzero(trusted), parts):
        closed = ClosedRuns.of(batch.part(rows), method)
        figures = closed.along() if along else [NOTHING_ALONG] * len(closed.sound)
        runs = {
            int(rows[k]): LatchedRun.in_compiled_code(closed, k, figures[k])
            for k in np.flatnonzero(closed.sound).tolist()
        }
        yield {k: run for k, run in runs.items() if run is not None}


def _keep(batch: RunBatch, runs: dict[int, LatchedRun], rows: Rows, result: ManyRuns) -> list[int]:
    """Write those runs whose energy balances into the result; return their numbers in the batch."""
    motion, made = batch.structure.motion, np.array(list(runs), dtype=np.int64)
    if is_judged_by_energy(motion) and len(made):
        y, p, steps = (
            np.array([getattr(run, name) for run in runs.values()]) for name in ("y", "p", "steps")
        )
        made = made[keeps_energy(batch.part(made), y, steps, p)]
    kept: list[int] = made.tolist()
    for k in kept:
        runs[k].keep(result, int(rows[k]), motion)
    return kept


def command_for(command: BatchCommand[Any], scene: Scene) -> BatchCommand[Any]:
    """Return what makes many runs of a scene: a command itself, or with latches one of its own."""
    return DeployLatches(scene) if isinstance(command, Deploy) and scene.deploy.latches else command


@record
class LatchedRun:
    """What a run came to: its end, what its latches did, and those of the second run (None: there is none).

    y, p : state and parameters at the end at ``time``. counts : by name of ``counters``. factor : times a difference is
    an error. along : the figures of ``ALONG``.
    """

    time: float
    y: Array
    p: Array
    counts: dict[str, float]
    second_steps: float
    factor: float
    own: LatchFacts
    second: LatchFacts | None
    along: Sequence[float]
    reason: str
    is_locked: bool

    @staticmethod
    def in_compiled_code(closed: ClosedRuns, k: int, along: Sequence[float]) -> LatchedRun | None:
        """Return run k of those in compiled code; None where the second one does not confirm it."""
        runs, second = closed.runs, closed.second
        own = closed.facts(runs, k)
        again = None if second is None else closed.facts(second, k)
        if again is not None and doubts(own.locks, again.locks):
            return None  # too sensitive: the command says so
        counts = {name: float(getattr(runs, name)[k]) for name in ("steps", "rejected", "evaluations")}
        steps = math.nan if second is None else float(second.steps[k])
        motion, time, factor = closed.batch.structure.motion, float(runs.time[k]), float(closed.factor[k])
        told = told_of(motion.scene.deploy.until, [*own.locks, *own.missed], own.locks)
        return LatchedRun(time, runs.y[k], runs.p[k], counts, steps, factor, own, again, along, *told)

    @cached_property
    def _facts(self) -> dict[str, Any]:
        """Records of latches by group and name, with errors where there is a second run."""
        own, again = (
            None if x is None else {"locks": x.locks, "missed": x.missed} for x in (self.own, self.second)
        )
        return own or {} if again is None else beside(own or {}, again, self.factor)

    def _with_errors(self, group: str, name: str) -> Any:
        """Return the record of a latch among ``locks`` or ``missed``, None where it is not there."""
        return self._facts[group].get(name)

    @property
    def other(self) -> Array | None:
        """The state at the last closing of the second run, where that is of the same latch."""
        last = None if self.second is None else self.second.last
        same = last is not None and self.own.last is not None and last[2] == self.own.last[2]
        return last[1] if same and last is not None else None

    @property
    def steps(self) -> int:
        return int(self.counts["steps"])

    def keep(self, result: ManyRuns, row: int, motion: Motion) -> None:
        """Write it into its row."""
        result.code[row] = 0 if self.is_locked else OF_STATUS["no_lock"]
        result.reason[row] = "" if self.is_locked else self.reason
        result.steps[row] = self.steps
        if self.own.last is not None:
            time, x, name = self.own.last
            locks = {
                key: self._with_errors("locks", key)
                for key in self.own.locks
                if key == name or self._is_end(key)
            }
            result.time[row], result.time_error[row] = time, _number(time_error(locks, name, self.time))
            result.q[row], result.qd[row], _ = motion.system.split(x)
            if (other := self.other) is not None:
                apart = self.factor * np.abs(other - x)
                for errors, own, off in zip(
                    (result.q_error, result.qd_error), motion.system.split(x), motion.system.split(apart)
                ):
                    least = ROUNDED * np.abs(own)
                    errors[row] = np.max(np.maximum(off + least, least.max()), initial=0.0)
        for key, column in result.outputs.items():
            column[row], result.errors[key][row] = self._figure(key, result, row)

    def _is_end(self, name: str) -> bool:
        """Tell whether the run ends where the load of a latch is largest."""
        return self.own.locks[name].peak_time == self.time

    def _figure(self, key: str, result: ManyRuns, row: int) -> tuple[float, float]:
        """Return a figure of the summary and its error, nan for what there is not."""
        group, *names = key.split(".")
        if group in OF_LATCHES:
            return _of_latch(self._with_errors(group, names[0]), names[1:])
        if group == "counters":
            return float(self.counts[names[0]]), math.nan
        if key == SECOND_STEPS:
            return self.second_steps, math.nan
        if key in ALONG:
            return float(self.along[ALONG.index(key)]), math.nan
        if key == "termination.time":
            return self.time, float(result.time_error[row])
        if isinstance(WORDS.get(key), bool):
            return (math.nan if self.own.last is None else 0.0), math.nan
        if key in ENDS:
            time, error = float(result.time[row]), float(result.time_error[row])
            return (time, error) if key == "lock.time" else (error, math.nan)
        kind = names[1] if names[0] == "errors" else names[0]
        values, errors = (result.q, result.q_error) if kind == "angles" else (result.qd, result.qd_error)
        largest = float(errors[row].max(initial=-math.inf))
        if names[0] == "errors":
            return largest, math.nan
        columns, name = (result.q_names if kind == "angles" else result.qd_names), ".".join(names[1:])
        if name not in columns:
            return math.nan, math.nan
        return float(values[row, columns.index(name)]), largest


def _number(x: Any) -> float:
    return float(x) if isinstance(x, (int, float, np.number)) else math.nan


def _of_latch(entry: Any, names: list[str]) -> tuple[float, float]:
    """Return a figure of the record of a latch, and its error."""
    value, error = entry, math.nan
    for name in names:
        fact: Fact | None = next(
            (f.metadata["fact"] for f in dataclasses.fields(value) if f.name == name), None
        ) if dataclasses.is_dataclass(value) else None  # fmt: skip
        if fact is not None and fact.errors:
            error = _number(getattr(value.errors, name, None))
        value = getattr(value, name, None)
    return _number(value), error


class _Runner:
    """Drives runs of a batch one after another, each with its own numbers, and once more for the errors."""

    def __init__(self, batch: RunBatch, method: str) -> None:
        motion, options = batch.structure.motion, batch.options
        if motion.choice.may_change:  # more steps: the command thinks about another method
            options = dataclasses.replace(options, max_steps=min(options.max_steps, FIRST_LOOK + WORTH))
        system, watchers = watched_again(motion)
        self.batch, self.method, self.options, self.motion = batch, method, options, motion
        self._others = batch.closed_otherwise().states
        own = motion.system.watched_by(lambda e: OTHERS.get(e.kind, e.owner))
        self.first = Driver(own, method, options, [watcher_of(motion.watchers)])
        self.second = Driver(system, method, options, watchers)
        self._tables = [
            table_rows(driver.integrator.engine.tables, batch.numbers) for driver in self._drivers
        ]
        kernels = [kernel for watcher in motion.watchers for kernel in watcher.kernels.values()]
        self._kernels = [
            (x, np.ascontiguousarray(batch.numbers.table(x.program.numbers or (0.0,)))) for x in kernels
        ]

    @property
    def _drivers(self) -> tuple[Driver, Driver]:
        return self.first, self.second

    def make(self, k: int) -> LatchedRun | None:
        """Return what a run came to; None where the command has to look into it."""
        for kernel, rows in self._kernels:
            kernel.table = rows[k]
        for driver, tables in zip(self._drivers, self._tables):
            driver.integrator.engine.take(tables[k])
        try:
            self._drive(self.first, self.options, k, self.batch.states)
            second_steps = self._again(k) if self.motion.scene.simulate.error_estimate else None
        except RobodynError:
            return None
        finally:
            for kernel, _ in self._kernels:
                kernel.table = None
        return self._run(second_steps)

    def _drive(self, driver: Driver, options: Options, k: int, states: Array) -> None:
        end = float(self.batch.ends[k])
        driver.start(0.0, states[k], options)
        driver.run(end, Grid.over(end, self.motion.scene.simulate.samples), lambda t, x: None)

    def _again(self, k: int) -> int:
        """Make the second run; return its steps."""

        def once(attempt: Attempt) -> tuple[Any, Any]:
            self._drive(self.second, attempt.alone, k, self._others)
            return np.array([self.second.counters.steps]), np.array([False])

        integrate_again(self._begun, once)
        return self.second.counters.steps

    @property
    def _begun(self) -> First:
        driver = self.first
        return First(self.options, self.method, np.array([driver.counters.steps]), np.array([driver.time]))

    def _run(self, second_steps: int | None) -> LatchedRun | None:
        driver, latches, other = self.first, watcher_of(self.first.watchers), watcher_of(self.second.watchers)
        own, second, factor = _facts_of(latches, driver.time), None, math.nan
        if second_steps is not None:
            second = _facts_of(other, self.second.time)
            if doubts(own.locks, second.locks):
                return None  # too sensitive: the command says so
            factor = float(remainder(self._begun, np.array([second_steps]))[0])
        if latches.warnings:
            return None
        counters = driver.counters
        until = self.motion.scene.deploy.until
        told = told_of(until, latches.names, [latches.names[k] for k in latches.closed])
        return LatchedRun(
            driver.time, driver.state, driver.parameters, vars(counters).copy(),
            math.nan if second_steps is None else float(second_steps), factor,
            own, second, NOTHING_ALONG, *told,
        )  # fmt: skip


def _facts_of(latches: Latches, end: float) -> LatchFacts:
    """Return what the latches of a watcher did up to an end [s]."""
    facts, last = latches.facts(end), latches.last
    named = None if last is None else (last[0], last[1], latches.names[last[2]])
    return LatchFacts(facts["locks"], facts["missed"], named)
