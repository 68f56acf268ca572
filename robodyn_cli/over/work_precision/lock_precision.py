"""The error of a lock's time against run time: what ``work-precision`` compares for a scene of ``deploy``."""

from __future__ import annotations

import numpy as np

from robodyn_cli.errors import NumericalError
from robodyn_cli.integrators.runtime.options import Grid, Options
from robodyn_cli.motion.driver import Driver
from robodyn_cli.motion.error import TRUSTED
from robodyn_cli.motion.motion import Motion
from robodyn_cli.over.commands import locks as ends_by_lock
from robodyn_cli.over.work_precision.entries import SECONDS, driver_of, tight_runs
from robodyn_cli.record import record
from robodyn_cli.scene.types import Scene
from robodyn_cli.summaries.stability import TimedRun
from robodyn_cli.works.deploy.scan import DeadPoint, watcher_of

AGREED = 1e-7  # relative agreement about the time of a lock, without which there is no reference


@record
class LockReference:
    """The time of a lock [s] that two families of methods agree on, to how many digits and within how much [s]."""

    time: float
    digits: float
    apart: float
    methods: tuple[str, str]


def locks(scene: Scene) -> bool:
    """Tell whether a scene deploys to a dead point, whose time is what matters; growth is judged on a grid of 1 ms."""
    return (
        ends_by_lock(scene.command)
        and scene.deploy.criterion not in ("multipliers", "latch")
        and not scene.deploy.latches
        and bool(scene.loops)
    )


def run_to_lock(driver: Driver, motion: Motion) -> float | None:
    """Run a driver that has started until its mechanism locks; return when [s], None where it does not."""
    duration = motion.scene.simulate.duration
    driver.run(duration, Grid(duration, 0.0, 0), lambda t, x: None)
    dead = watcher_of(motion, DeadPoint)
    events = dead.found if dead else []
    return events[0][0] if events else None


def lock_reference(motion: Motion) -> LockReference | None:
    """Return the time of the lock by two methods at tight tolerance; None where the first of them finds no lock.

    Raises
    ------
    NumericalError : fewer than two methods get through, or they do not agree.
    """

    def run(method: str, options: Options) -> float | None:
        driver = driver_of(motion, method, options, 3.0 * SECONDS)
        driver.start(0.0, motion.start)
        return run_to_lock(driver, motion)

    times: list[tuple[str, float]] = []
    for method, time in tight_runs(motion, run):
        if time is not None:
            times.append((method, time))
        elif not times:
            return None
        if len(times) == 2:
            break
    if len(times) < 2:
        raise NumericalError("no two methods come to the lock at tight tolerance, so there is no reference")
    (first, one), (second, other) = times
    apart = abs(one - other) / one
    if apart > AGREED:
        raise NumericalError(
            f"{first} and {second} at tight tolerance put the lock at {one:.9g} s and {other:.9g} s, so there is no "
            "reference"
        )
    return LockReference(one, -float(np.log10(max(apart, 1e-16))), abs(one - other), (first, second))


def judge_lock(driver: Driver, entry: TimedRun, motion: Motion, ref: LockReference) -> None:
    """Run to the lock; fill in its time and its error."""
    entry.lock_time = run_to_lock(driver, motion)
    if entry.lock_time is None:
        entry.status = "no_lock"
        return
    entry.error = abs(entry.lock_time - ref.time)
    if entry.error > TRUSTED * ref.time:
        entry.status = "inaccurate"
