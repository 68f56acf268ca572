"""Deployment with several latches: one motion that goes on behind each, until what is waited for is closed."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from robodyn_cli.errors import RobodynError
from robodyn_cli.motion.contact.latches import Latches
from robodyn_cli.motion.driver import BLOCK, Driver
from robodyn_cli.motion.failure import explained
from robodyn_cli.motion.figures import recorded, with_figures, with_latches_beside
from robodyn_cli.motion.method import supervisor_for
from robodyn_cli.motion.motion import Beginning, Motion, Watcher
from robodyn_cli.motion.second_run import Estimate, FirstRun, estimate_error, grid_of
from robodyn_cli.motion.self_check import Judgement, Run, judge, motion_records
from robodyn_cli.observe.recorder import Recorder
from robodyn_cli.observe.units import add_joint_limits
from robodyn_cli.results.result import Result
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.apart import with_others
from robodyn_cli.summaries.deploy import (
    DeploySummary,
    LockErrors,
    LockKeys,
)
from robodyn_cli.summaries.facts import ABSENT, Termination
from robodyn_cli.summaries.motion import FinalState, LatchLock, LatchLockErrors, MotionSummary
from robodyn_cli.tools.progress import Progress, Stopwatch, no_progress
from robodyn_cli.works.deploy.recording import first_overload, overload_text

if TYPE_CHECKING:
    from robodyn_cli.results.hdf5.writer import ResultWriter

UNCONFIRMED = "not known: a second, tighter integration does otherwise"


def deploy_latched(
    motion: Motion,
    beginning: Beginning,
    progress: Progress = no_progress,
    watch: Stopwatch | None = None,
    writer: ResultWriter | None = None,
) -> Result:
    """Follow a motion with latches, from its beginning until what is waited for is closed.

    Returns
    -------
    A Result with status ``locked``, ``no_lock`` or ``overload``, and ``summary["locks"]``.

    Raises
    ------
    RobodynError : with ``result``.
    """
    watch = watch or Stopwatch()
    with watch.stage("equations"):
        recorder = Recorder.of(motion.observer, writer, grid_of(motion.scene, beginning).count)
    with watch.stage("method"):
        driver = Driver.of(motion, supervisor_for(motion.choice))
        driver.start(beginning.time, beginning.state)
    run = Run(motion, beginning, driver, recorder)
    stopped = _drive(run, progress, watch)
    recorder.keep_last_state(driver.time, driver.state, driver.parameters)
    judgement = judge(run, stopped)
    estimate = None
    if judgement.failure is None and motion.scene.simulate.error_estimate:
        with watch.stage("error_estimate"):
            estimate = _estimate(run)
    return _report(run, judgement, estimate, watch)


class Pending:
    """Samples that are still to be recorded: those between two changes of the parameters go together."""

    def __init__(self, driver: Driver, recorder: Recorder) -> None:
        self.driver, self.recorder, self.p = driver, recorder, np.zeros(0)
        self.blocks: list[tuple[Array, Array]] = []

    def take(self, t: Array, x: Array) -> None:
        p = self.driver.parameters
        if self.blocks and (len(t) >= BLOCK or not np.array_equal(p, self.p)):
            self.record()
        self.blocks.append((t, x))
        self.p = p

    def record(self) -> None:
        if self.blocks:
            t, x = (np.concatenate(parts) for parts in zip(*self.blocks))
            self.recorder.emit(t, x, self.p)
            self.blocks.clear()


def _drive(run: Run, progress: Progress, watch: Stopwatch) -> RobodynError | None:
    """Integrate and record, up to what is waited for; return why the run ended before."""
    duration, driver, pending = (
        run.motion.scene.simulate.duration,
        run.driver,
        Pending(run.driver, run.recorder),
    )
    driver.tick = lambda time: progress(time, duration)
    with watch.stage("integrate"):
        try:
            driver.run(duration, grid_of(run.motion.scene, run.beginning), pending.take)
        except RobodynError as error:
            return explained(error, run.motion, driver)
        finally:
            pending.record()
    return None


def _estimate(run: Run) -> Estimate:
    """Return the error of the run; the second one begins where its loops close as well, and goes on until its own
    latches are closed."""
    scene = run.motion.scene
    first = FirstRun.of(run.driver, run.beginning, grid_of(scene, run.beginning), run.recorder)
    if scene.initial.source is None:
        first = dataclasses.replace(first, start=run.motion.closed_otherwise().start)
    if run.driver.time < scene.simulate.duration:
        first = dataclasses.replace(first, latest=scene.simulate.duration)
    return estimate_error(run.motion, first, run.recorder)


def watcher_of(watchers: Sequence[Watcher]) -> Latches:
    """Return the one that follows latches."""
    return next(watcher for watcher in watchers if isinstance(watcher, Latches))


# -- the report ---------------------------------------------------------------------------------------------
def _report(run: Run, judgement: Judgement, estimate: Estimate | None, watch: Stopwatch) -> Result:
    """Return the result with its summary.

    Raises
    ------
    RobodynError : why the run failed, with the result.
    """
    failure, scene = judgement.failure, run.motion.scene
    result = Result.of("deploy", scene, "failed")
    result.events = run.driver.log
    run.recorder.fill(result)
    add_joint_limits(result, scene, run.motion.problem.model)
    for watcher in run.driver.watchers:
        watcher.add_to(result)
    summary, *others = motion_records(run, judgement, estimate)
    summary = with_latches_beside(summary, run, estimate)
    overload, motions = None, [recorded(run, estimate)] if scene.deploy.loads else []
    if failure is None:
        with watch.stage("reactions"):
            overload = first_overload(motions, scene.deploy.loads)
        latches = watcher_of(run.driver.watchers)
        closed = [latches.names[k] for k in latches.closed]
        reason, is_locked = told_of(scene.deploy.until, latches.names, closed)
        result.status = "overload" if overload is not None else "locked" if is_locked else "no_lock"
        termination: Any = Termination(reason, run.driver.time)
        if overload is not None:
            termination = {**vars(termination), "overload": overload_text(overload)}
        summary = dataclasses.replace(summary, termination=termination)
    if overload is not None:
        result.events.append({"time": overload.time, "name": overload.name, "kind": "overload"})
        result.events.sort(key=lambda event: float(event["time"]))
    keys = DeploySummary(
        lock=_lock(run, summary, estimate),
        overload=overload if scene.deploy.loads and failure is None else ABSENT,
    )
    records = [summary, *others, keys]
    if failure is None:
        records = with_figures(records, result, run, estimate, watch, motions)
    result.summarise(*records, seconds=watch.report())
    return result.unless(failure)


def told_of(until: str, names: Sequence[str], closed: Collection[str]) -> tuple[str, bool]:
    """Return why a run ended, in words, and whether what it waited for is closed.

    until : NAME, ``all`` or ``end``. names : of all latches. closed : of those that are.
    """
    count, still = len(names), [name for name in names if name not in closed]
    if until not in ("all", "end"):
        is_closed = until in closed
        return (f"latch {until} is closed" if is_closed else f"duration: latch {until} is open"), is_closed
    if not still:
        every = "the latch is closed" if count == 1 else f"all {count} latches are closed"
        return (every if until == "all" else f"duration: {every}"), True
    listed = f"{', '.join(still[:8])}{', ...' * (len(still) > 8)}"
    return f"duration: {len(still)} of {count} latches are open ({listed})", False


def _lock(run: Run, summary: MotionSummary, estimate: Estimate | None) -> LockKeys | None:
    """Return the last closing, with errors from the last one of the second run."""
    own = _lock_of(run.motion, watcher_of(run.driver.watchers), summary)
    if own is None or estimate is None or not estimate.watchers:
        return own
    if own.time_error is None:
        return dataclasses.replace(own, time_error_method=UNCONFIRMED, errors=LockErrors(None, None, None))
    other = _lock_of(run.motion, watcher_of(estimate.watchers), summary)
    if other is None or other.name != own.name:
        return own
    return dataclasses.replace(
        with_others(own, [other], estimate.factor, ("lock",)), time_error=own.time_error
    )


def time_error(locks: Mapping[str, LatchLock], last: str, end: float) -> float | None:
    """Return the error of the time of the last closing, and of the end [s] where that is the peak of a load."""
    errors = [
        error
        for name, lock in locks.items()
        if isinstance(lock.errors, LatchLockErrors)
        for own, error in ((name == last, lock.errors.time), (lock.peak_time == end, lock.errors.peak_time))
        if own and isinstance(error, float)
    ]
    return max(errors, default=None)


def _lock_of(motion: Motion, latches: Latches, summary: MotionSummary) -> LockKeys | None:
    if latches.last is None:
        return None
    time, state, k = latches.last
    model, latch = motion.problem.model, latches.latches[k]
    q, qd, _ = motion.system.split(state)
    end = summary.final.time if isinstance(summary.final, FinalState) else math.nan
    locks = summary.locks if isinstance(summary.locks, Mapping) else {}
    error = time_error(locks, latch.name, end)
    return LockKeys(
        time=time,
        time_error=error,
        time_error_method="not asked for"
        if error is None
        else "difference from a second, tighter integration",
        angles=dict(zip(model.q_names, q.tolist())),
        angles_deg={
            n: float(np.degrees(x)) for n, x, u in zip(model.q_names, q, model.q_units) if u == "rad"
        },
        rates=dict(zip(model.v_names, qd.tolist())),
        errors=LockErrors(),
        kind="latched",
        joint=None if latch.v is None else model.v_names[latch.v],
        loop=None,
        criterion="latches",
        driven=False,
        multiplier_growth=None,
        growth_times={},
        multipliers=None,
        singular_values=None,
        name=latch.name,
    )
