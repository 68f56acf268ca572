"""After the latch: the run goes on as the locked structure, with the load in each joint and in the latch."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.runtime.options import Grid
from robodyn_cli.motion.build import contact_watchers, half_turns, watched_system
from robodyn_cli.motion.driver import Driver
from robodyn_cli.motion.method import supervisor_for
from robodyn_cli.motion.motion import Beginning, Motion
from robodyn_cli.motion.second_run import FirstRun, estimate_error
from robodyn_cli.motion.summary import residual_of
from robodyn_cli.observe.observe import Column, Observer
from robodyn_cli.observe.recorder import Recorder
from robodyn_cli.record import record
from robodyn_cli.results.columns import magnitude
from robodyn_cli.results.result import Result
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.deploy import AfterLock, LatchLoad, Overload
from robodyn_cli.tools.stopwatch import Stopwatch
from robodyn_cli.works.deploy.lock import ClosedLatch, Lock

# what the locked structure says; all else is that of the mechanism without its latch
DYNAMIC = ("qdd", "tau", "constraints/", "reactions/", "loop_reactions/", "base_wrench")


class LockedObserver(Observer):
    """Observes the locked structure; places, energies and singular values are those of the mechanism."""

    def __init__(self, problem: Problem, system: System, before: Observer) -> None:
        super().__init__(problem, system, reactions=True)
        self.before = before

    def observe(self, t: Array, x: Array, project: bool = True) -> dict[str, Array]:
        # joints that the latch holds have no contact states any more; nothing below depends on these
        if len(self.parameters) == len(self.before.parameters):
            self.before.parameters = self.parameters
        x = self.project(t, x) if project else x
        own = super().observe(t, x, False)
        data = self.before.observe(t, x, False)
        data.update({path: block for path, block in own.items() if path.startswith(DYNAMIC)})
        return data

    def describe(self) -> dict[str, Column]:
        return {**self.before.describe(), **super().describe()}


@record
class FollowedLock:
    """The motion after the lock: its keys, and its samples, None where no sample lies behind the lock."""

    keys: AfterLock
    recorder: Recorder | None


def follow_locked(
    motion: Motion, lock: Lock, latch: ClosedLatch, before: Recorder, watch: Stopwatch
) -> FollowedLock:
    """Integrate the locked structure from the lock to the end of the duration, on the samples of the scene's grid."""
    s = motion.scene.simulate
    with watch.stage("equations"):
        problem = latch.locked.problem
        watchers = (*contact_watchers(problem), *half_turns(problem))
        system = watched_system(problem, s.stabilisation, watchers)
        locked = dataclasses.replace(motion, problem=problem, system=system, watchers=watchers)
        for watcher in watchers:
            watcher.follow(locked)
        recorder = Recorder(LockedObserver(problem, locked.system, before.observer))
    grid = Grid.over(s.duration, s.samples)
    first = grid.first_at(lock.time)
    first += grid.times(first, first + 1)[:1].tolist() == [lock.time]
    keys = AfterLock(
        latch.locked.freedom, list(latch.locked.rows), latch.locked.name, samples=0, until=lock.time
    )
    if first >= grid.count:
        return FollowedLock(keys, None)
    rest = Grid(float(grid.times(first, first + 1)[0]), grid.step, grid.count - first, grid.end)
    driver = Driver.of(locked, supervisor_for(locked.choice))
    with watch.stage("integrate"):
        begun = Beginning(rest.start, _first_sample(motion, locked, lock, latch, rest.start))
        driver.start(begun.time, begun.state)
        driver.run(s.duration, rest, lambda t, x: recorder.emit(t, x, driver.parameters))
    estimate = None
    if s.error_estimate:
        with watch.stage("error_estimate"):
            estimate = estimate_error(locked, FirstRun.of(driver, begun, rest, recorder), recorder)
    keys = dataclasses.replace(
        keys,
        samples=recorder.samples,
        until=driver.time,
        error_estimate=estimate,
        energy_drift=recorder.drift,
        constraint_residual=residual_of(recorder),
        latch=_latch_load(recorder, latch.locked.name),
        largest=recorder.loads,
        counters=driver.counters,
    )
    return FollowedLock(keys, recorder)


def _first_sample(motion: Motion, locked: Motion, lock: Lock, latch: ClosedLatch, time: float) -> Array:
    """Return the state at the first sample behind the lock."""
    q, _, z = motion.system.split(lock.state)
    driver = Driver.of(locked)
    driver.start(lock.time, locked.system.join(q, latch.impact.qd_after, z))
    driver.advance(time)
    return driver.state


def join(before: Recorder, after: Recorder) -> dict[str, Array]:
    """Return the samples of both phases by path; the latch bears nothing before it closes."""
    old, new = before.columns, after.columns
    found = {}
    for path in after.blocks:
        later = after.array(path)
        nothing = np.zeros((len(before.array("time")), *later.shape[1:]))
        earlier = before.array(path) if path in before.blocks else nothing
        if path in old and path in new and old[path].names != new[path].names:
            wide = np.zeros((len(earlier), len(new[path].names)))
            for k, name in enumerate(old[path].names):
                wide[:, new[path].names.index(name)] = earlier[:, k]
            earlier = wide
        found[path] = np.concatenate([earlier, later])
    return found


def _latch_load(recorder: Recorder, name: str) -> LatchLoad:
    """Return the largest force and moment in the latch, when, and those at the end."""
    path = f"loop_reactions/{name}"
    assert recorder.observer.reactions is not None
    data, times = recorder.array(path), recorder.array("time")
    names = recorder.observer.reactions.names[path]
    force, moment = magnitude(data, names, "f"), magnitude(data, names, "m")
    most_force, most_moment = int(np.argmax(force)), int(np.argmax(moment))
    return LatchLoad(
        peak_force=float(force[most_force]),
        peak_force_time=float(times[most_force]),
        force_at_end=float(force[-1]),
        peak_moment=float(moment[most_moment]),
        peak_moment_time=float(times[most_moment]),
        moment_at_end=float(moment[-1]),
    )


def first_overload(result: Result, limits: Mapping[str, Any]) -> Overload | None:
    """Return the first sample at which a joint or closure bears more than its limit; None if none does."""
    worst: Overload | None = None
    for name, limit in limits.items():
        path = next((p for p in (f"reactions/{name}", f"loop_reactions/{name}") if p in result), None)
        if path is None:
            continue
        variable = result.variables[path]
        for quantity, letter in (("force", "f"), ("moment", "m")):
            most = getattr(limit, quantity)
            if most is None:
                continue
            size = magnitude(variable.data, variable.names, letter)
            over = np.flatnonzero(size > most)
            if len(over) and (worst is None or result.time[over[0]] < worst.time):
                at = int(over[0])
                worst = Overload(
                    name, quantity, most, float(result.time[at]), float(size[at]), float(size.max())
                )
    return worst
