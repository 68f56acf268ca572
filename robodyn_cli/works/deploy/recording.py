"""The recorded run of a deployment: up to what the scan has found to end it, and after the latch as the locked
structure, with the load in each joint and in the latch."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import NumericalError
from robodyn_cli.formulations.events import GO_ON, STOP, Event, EventKind, Outcome
from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.runtime.options import Grid
from robodyn_cli.motion.between.extremes import RecordedMotion, over_all
from robodyn_cli.motion.build import contact_watchers, half_turns, watched_system
from robodyn_cli.motion.driver import Driver, Repeat
from robodyn_cli.motion.figures import loads_of
from robodyn_cli.motion.joint_limits import LimitWatcher
from robodyn_cli.motion.method import supervisor_for
from robodyn_cli.motion.motion import Beginning, Motion
from robodyn_cli.motion.second_run import FirstRun, estimate_error
from robodyn_cli.motion.self_check import residual_of
from robodyn_cli.observe.observe import Column, Observer
from robodyn_cli.observe.recorder import Recorder
from robodyn_cli.record import record
from robodyn_cli.results.result import Result
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.deploy import AfterLock, LatchErrors, LatchLoad, Overload
from robodyn_cli.tools.progress import Progress, Stopwatch
from robodyn_cli.works.deploy.lock import ClosedLatch, Lock, Relocated
from robodyn_cli.works.deploy.scan import Pose, Scan, ScanEnd

# smallest singular value of the passive block, relative to the largest of Psi, that is still worth reporting
NEAR_SINGULAR = 1e-3
SHORT_OF = 1e-2  # part of the extrapolated way to a loss of rank that samples stay short of it
AT_EVENT = 1e-9  # part of the time by which an event may come sooner than in the scan


class StopAt:
    """Ends a run at the event at ``time`` [s], passing those before; None: at none."""

    def __init__(self, time: float | None) -> None:
        self.time = time

    def handle(self, event: Event) -> Outcome:
        if self.time is None or event.time < self.time - AT_EVENT * max(1.0, self.time):
            return GO_ON
        return STOP

    def again(self) -> None:
        return None


def record_motion(
    motion: Motion, scanned: Scan, end: ScanEnd, recorder: Recorder, progress: Progress
) -> Driver:
    """Integrate once more and observe; the last sample is the end itself.

    The events are those of the scan, so that the steps are the same and a singular configuration is met in the
    same way: by a step from afar, never by creeping up to it.
    """
    stretch = _stretch(motion, scanned, end)
    driver = _driver(motion, scanned, stretch.event)
    driver.tick = lambda time: progress(time, stretch.end)

    def emit(t: Array, x: Array) -> None:
        if scanned.driven:
            # close to the dead point the rates of the passive joints grow without bound: nothing to report there
            angle = motion.observer.singular_ratio(t, x)
            t, x = t[angle > NEAR_SINGULAR], x[angle > NEAR_SINGULAR]
        if len(t):
            recorder.emit(t, x, driver.parameters)
        progress(float(t[-1]) if len(t) else stretch.end, stretch.end)

    driver.start(0.0, motion.start)
    try:
        driver.run(stretch.end, stretch.grid, emit)
    except NumericalError:
        if scanned.stopped is None:
            raise
    if stretch.lost is not None:
        time, state = stretch.lost
        recorder.emit(np.array([time]), state[None, :].copy(), driver.parameters, project=False, extra=True)
        recorder.make_last_least_norm(time)
    elif not scanned.driven:
        recorder.keep_last_state(driver.time, driver.state, driver.parameters)
    return driver


@record
class _RecordedStretch:
    """What is recorded: samples of ``grid`` up to ``end`` [s].

    event : time of the located pose that ends the run, None where it ends otherwise. lost : the pose in which the loops
    lose rank, which becomes the last sample.
    """

    grid: Grid
    end: float
    event: float | None
    lost: Pose | None


def _stretch(motion: Motion, scanned: Scan, end: ScanEnd) -> _RecordedStretch:
    """Return what is recorded of a motion, by what ends it."""
    s = motion.scene.simulate
    grid = Grid.over(s.duration, s.samples)
    lost = scanned.bifurcation if end.bifurcated else None
    stop = lost[0] if lost is not None else end.time
    located = (
        []
        if scanned.driven
        else [pose[0] for pose in (scanned.dead_point, scanned.bifurcation, scanned.latched) if pose]
    )
    event = stop if stop in located else None
    until = s.duration if stop is None or event is not None else stop
    if scanned.stopped is not None:
        until = min(until, scanned.end)
    if lost is not None:
        # the way from the threshold on was travelled by extrapolation; samples stop short of the pose
        until = lost[0] - SHORT_OF * (lost[0] - scanned.clean_until)
        grid = grid.up_to(int(until / grid.step) + 1)
    return _RecordedStretch(grid, until, event, lost)


def _driver(motion: Motion, scanned: Scan, stop: float | None) -> Driver:
    """Return the driver of the recorded run, which stops at the pose that was located at ``stop`` [s].

    It changes the method after the same steps as the scan.
    """
    at = StopAt(stop)
    poses = (EventKind.RANK_LOSS, EventKind.DEAD_POINT, EventKind.LATCH)
    system = motion.system.watched_by(lambda e: at if e.kind in poses else e.owner)
    # of limits that are passed the recorded run tells, since the scan goes on behind its end
    watchers = [w for w in motion.watchers if w.changes_motion or isinstance(w, LimitWatcher)]
    return Driver(system, motion.choice.method, motion.options, watchers, Repeat(scanned.changes))


# what the locked structure says; all else is that of the mechanism without its latch
DYNAMIC = ("qdd", "tau", "constraints/", "reactions/", "loop_reactions/", "force_wrenches/", "base_wrench")


class LockedObserver(Observer):
    """Observes the locked structure; places, energies and singular values are those of the mechanism."""

    def __init__(self, problem: Problem, system: System, before: Observer) -> None:
        super().__init__(problem, system, reactions=True)
        self.before = before

    def observe(self, t: Array, x: Array, project: bool = True, singular: bool = True) -> dict[str, Array]:
        # joints that the latch holds have no contact states any more; nothing below depends on these
        if len(self.parameters) == len(self.before.parameters):
            self.before.parameters = self.parameters
        x = self.project(t, x) if project else x
        own = super().observe(t, x, False, False)
        data = self.before.observe(t, x, False, singular)
        data.update({path: block for path, block in own.items() if path.startswith(DYNAMIC)})
        return data

    def describe(self) -> dict[str, Column]:
        return {**self.before.describe(), **super().describe()}


@record
class FollowedLock:
    """The motion after the lock: its keys, and its samples, None where no sample lies behind the lock.

    whole : from the lock on.
    """

    keys: AfterLock
    recorder: Recorder | None
    whole: RecordedMotion | None = None


def follow_locked(
    motion: Motion,
    lock: Lock,
    latch: ClosedLatch,
    again: Relocated | None,
    before: Recorder,
    watch: Stopwatch,
) -> FollowedLock:
    """Integrate the locked structure from the lock to the end of the duration, on the samples of the scene's grid.

    again : where a second scan puts the lock: the error of the lock's state goes on.
    """
    s = motion.scene.simulate
    with watch.stage("equations"):
        locked = _locked(motion, latch.locked.problem)
        observer = LockedObserver(locked.problem, locked.system, before.observer)
    grid = Grid.over(s.duration, s.samples)
    first = grid.first_at(lock.time)
    first += grid.times(first, first + 1)[:1].tolist() == [lock.time]
    keys = AfterLock(
        latch.locked.freedom, list(latch.locked.rows), latch.locked.name, samples=0, until=lock.time
    )
    if first >= grid.count:
        return FollowedLock(keys, None)
    rest = Grid(float(grid.times(first, first + 1)[0]), grid.step, grid.count - first, grid.end)
    recorder = Recorder(observer, samples=rest.count)
    driver = Driver.of(locked, supervisor_for(locked.choice))
    with watch.stage("integrate"):
        begun = Beginning(rest.start, _first_sample(motion, locked, lock, latch, rest.start))
        driver.start(begun.time, begun.state)
        driver.run(s.duration, rest, lambda t, x: recorder.emit(t, x, driver.parameters))
    estimate = None
    if s.error_estimate:
        with watch.stage("error_estimate"):
            start = None
            if again is not None and again.lock and again.latch and again.lock.time < rest.start:
                start = _first_sample(motion, locked, again.lock, again.latch, rest.start)
            run = dataclasses.replace(FirstRun.of(driver, begun, rest, recorder), start=start)
            estimate = estimate_error(locked, run, recorder)
    keys = dataclasses.replace(
        keys,
        samples=recorder.samples,
        until=driver.time,
        energy_drift=recorder.drift,
        constraint_residual=residual_of(recorder),
        counters=driver.counters,
    )
    whole = RecordedMotion(
        locked, _from_lock(motion, locked, FirstRun.of(driver, begun, rest, recorder), lock, latch), recorder
    )
    if estimate is not None:
        twice = (again.lock, again.latch) if again is not None else (None, None)
        other = _from_lock(motion, locked, whole.first, *twice)
        whole = dataclasses.replace(whole, again=other, errors=estimate.errors)
        keys = dataclasses.replace(keys, error_estimate=estimate.errors)
    with watch.stage("reactions"):
        keys = dataclasses.replace(keys, latch=_latch_load(whole, keys.closure), largest=loads_of(whole))
    return FollowedLock(keys, recorder, whole)


def _first_sample(motion: Motion, locked: Motion, lock: Lock, latch: ClosedLatch, time: float) -> Array:
    """Return the state at the first sample behind the lock."""
    begun, driver = _behind(motion, locked, lock, latch), Driver.of(locked)
    driver.start(begun.time, begun.state)
    driver.advance(time)
    return driver.state


def _from_lock(
    motion: Motion, locked: Motion, run: FirstRun, lock: Lock | None, latch: ClosedLatch | None
) -> FirstRun:
    """Return a run of the locked structure from the lock on; as it is without one."""
    if lock is None or latch is None:
        return run
    return dataclasses.replace(run, beginning=_behind(motion, locked, lock, latch))


def _behind(motion: Motion, locked: Motion, lock: Lock, latch: ClosedLatch) -> Beginning:
    """Return where the motion behind a lock begins."""
    q, _, z = motion.system.split(lock.state)
    return Beginning(lock.time, locked.system.join(q, latch.impact.qd_after, z))


def join(before: Recorder, after: Recorder) -> dict[str, Array]:
    """Return the samples of both phases by path; the latch bears nothing before it closes."""
    old, new = before.columns, after.columns
    samples = {}
    for path in after.blocks:
        later = after.array(path)
        nothing = np.zeros((len(before.array("time")), *later.shape[1:]))
        earlier = before.array(path) if path in before.blocks else nothing
        if path in old and path in new and old[path].names != new[path].names:
            wide = np.zeros((len(earlier), len(new[path].names)))
            for k, name in enumerate(old[path].names):
                wide[:, new[path].names.index(name)] = earlier[:, k]
            earlier = wide
        samples[path] = np.concatenate([earlier, later])
    return samples


def _locked(motion: Motion, problem: Problem) -> Motion:
    """Return the motion of the locked structure, with watchers of its own."""
    watchers = (*contact_watchers(problem), *half_turns(problem))
    system = watched_system(problem, motion.scene.simulate.stabilisation, watchers)
    locked = dataclasses.replace(motion, problem=problem, system=system, watchers=watchers)
    for watcher in watchers:
        watcher.follow(locked)
    return locked


def _latch_load(motion: RecordedMotion, name: str) -> LatchLoad:
    """Return the largest force and moment in the latch, when, and those at the end."""
    force, moment = motion.extremes([f"loop_reactions/{name}.{x}" for x in ("force", "moment")]).values()
    off, turned = force.errors, moment.errors
    errors = LatchErrors(
        off.largest, off.largest_time, turned.largest, turned.largest_time, off.final, turned.final
    )
    return LatchLoad(
        force.largest,
        force.largest_time,
        force.final,
        moment.largest,
        moment.largest_time,
        moment.final,
        errors,
    )


def first_overload(motions: Sequence[RecordedMotion], limits: Mapping[str, Any]) -> Overload | None:
    """Return the first load of a joint or closure beyond its limit, over motions that follow one another; None if there
    is none."""
    worst: Overload | None = None
    for name, limit in limits.items():
        for quantity in ("force", "moment"):
            most = getattr(limit, quantity)
            if most is None:
                continue
            for path in ("reactions", "loop_reactions"):
                found = over_all(motions, [f"{path}/{name}.{quantity}"])
                for column, peak in found.items():
                    if peak.largest > most:
                        passed = (one.first_beyond(column, most) for one in motions)
                        # a peak between two close samples
                        time, off = next(
                            (x for x in passed if x is not None),
                            (peak.largest_time, peak.errors.largest_time),
                        )
                        one = Overload(name, quantity, most, time, off, peak.largest, peak.errors.largest)
                        worst = one if worst is None or time < worst.time else worst
    return worst


def overload_text(overload: Overload) -> str:
    """Return what is told of an overload."""
    unit = "N" if overload.quantity == "force" else "N m"
    return (
        f"{overload.name} bears a {overload.quantity} of more than its {overload.limit:.6g} {unit} from "
        f"t = {overload.time:.6g} s on, {overload.largest:.6g} {unit} at most"
    )


def add_followed(
    result: Result, lock: Lock, latch: ClosedLatch, recorder: Recorder, later: Recorder | None
) -> None:
    """Add the event of the lock and the samples behind it, which ``later`` has recorded."""
    lost = {"energy_lost": latch.impact.energy_lost, "degrees_of_freedom": latch.locked.freedom}
    result.events.append({"time": lock.time, "name": latch.locked.name, "kind": "lock", **lost})
    if later is not None:
        for path, data in join(recorder, later).items():
            result.add(path, data, **later.described(path))
