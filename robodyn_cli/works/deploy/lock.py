"""The lock of a deployment: the pose, its kind, the latch that closes there, and the error of its time."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from robodyn_cli.errors import NumericalError, RobodynError, SingularConfigurationError
from robodyn_cli.motion.error import TIME_ROUNDING, TRUSTED, Attempt, First, integrate_again, remainder
from robodyn_cli.motion.motion import Motion
from robodyn_cli.observe.recorder import Recorder
from robodyn_cli.ready.singularity import Singularity, classify, culprit, psi_at
from robodyn_cli.record import record
from robodyn_cli.solve.peaks import Windows, pieces
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.apart import with_others
from robodyn_cli.summaries.deploy import (
    CriterionErrors,
    CriterionTimes,
    LatchKeys,
    LockErrors,
    LockKeys,
    MultiplierGrowth,
    MultiplierKeys,
    NormErrors,
    SingularValues,
)  # fmt: skip
from robodyn_cli.summaries.facts import ABSENT, Absent, rounded_up
from robodyn_cli.works.deploy.growth import (
    GRID,
    RATES_ROUNDED,
    LatchImpact,
    Locked,
    close_latch,
    farthest,
    locked,
    locks_beside,
    multiplier_norm,
    starts_beside,
)
from robodyn_cli.works.deploy.scan import Pose, Scan, ScanEnd, fired, scan


@record
class Lock:
    """Where and how a deployment locks.

    state : x (nx,) before the latch closes. kind : ``dead_point``, ``bifurcation``, ``approaching_dead_point``,
    ``overload`` (the multipliers passed their threshold away from any singular pose) or ``latched`` (a latch has closed
    at its position).
    """

    time: float
    criterion: str
    state: Array
    kind: str
    singular: Singularity


@record
class ClosedLatch:
    """The structure that a latch makes of the mechanism, and its impact."""

    locked: Locked
    impact: LatchImpact


def find_lock(motion: Motion, scanned: Scan, end: ScanEnd, recorder: Recorder) -> Lock | None:
    """Return the lock of the recorded run, None where no criterion fired."""
    if end.time is None:
        return None
    if scanned.dead_point is not None and end.criterion == "dead_point":
        state = scanned.dead_point[1]
    elif scanned.latched is not None and end.criterion == "latch":
        state = scanned.latched[1]
    else:
        z = recorder.array("energy/work")[-1:] if "energy/work" in recorder.blocks else None
        state = motion.system.join(recorder.array("q")[-1], recorder.array("qd")[-1], z)
    here = classify(motion.problem, motion.system.split(state)[0], motion.passive)
    kind = here.kind
    if kind == "regular" and end.criterion == "latch":
        kind = "latched"
    if kind == "regular":
        kind = "approaching_dead_point" if _approaches(motion, scanned, end.time) else "overload"
    return Lock(end.time, end.criterion, state, kind, here)


def _approaches(motion: Motion, scanned: Scan, stop: float) -> bool:
    """Tell multipliers that rise from the stop to a dead point from an overload that passes by itself."""
    if all(time < stop for time, _ in scanned.dead_points):
        return False
    growth, own = scanned.growth, motion.scene.deploy.growth
    assert growth is not None
    first = own if growth.times.get(own) == stop else "limit"
    return first not in growth.calmed


def close(motion: Motion, scanned: Scan, lock: Lock | None) -> ClosedLatch | None:
    """Close the scene's latch at the lock; None without one, at an overload, or where rates are unbounded."""
    spec = motion.scene.deploy.latch
    if lock is None or spec is None or lock.kind == "overload" or scanned.driven:
        return None
    q, qd, _ = motion.system.split(lock.state)
    structure = locked(motion.problem, spec.between[0], spec.between[1], q, lock.time)
    return ClosedLatch(structure, close_latch(motion.problem, structure, q, qd, lock.time))


@record
class Relocated:
    """Where a second, tighter scan puts a lock.

    error : of the first one's time [s], None where the second finds no lock. lock, latch : of the second. factor : the
    difference of figures times it is their error.
    """

    error: float | None
    scanned: Scan
    lock: Lock | None
    latch: ClosedLatch | None
    factor: float


@record
class Rescan:
    """What a second, tighter scan met; factor : the difference of figures times it is their error."""

    scanned: Scan
    factor: float

    def time_error(self, time: float, pose: Pose | None) -> float | None:
        """Return the error of the time [s] of an event that the second scan puts at a pose; None where it has none."""
        if self.scanned.driven:  # the root of a smooth function, to rounding
            return TIME_ROUNDING * max(1.0, abs(time))
        return None if pose is None else max(self.factor * abs(pose[0] - time), TIME_ROUNDING * time)


def rescan(motion: Motion, scanned: Scan) -> Rescan:
    """Scan once more; what is driven into a dead point is pure geometry, which no second scan changes."""
    if scanned.driven:
        return Rescan(scanned, 1.0)
    first = First(motion.options, motion.choice.method, np.array([scanned.steps]), np.array([scanned.end]))
    other, steps = scanned, 0.0

    def once(attempt: Attempt) -> tuple[Any, Any]:
        nonlocal other, steps
        # what rounding leaves open of the start moves the lock, too
        again = motion.with_own_watchers().closed_otherwise()
        other = scan(again, attempt.alone, multipliers=scanned.growth is not None)
        # the scans may end at different times, so it is steps per second that count
        steps = round(other.steps * scanned.end / max(other.end, 1e-300))
        given_up = other.stopped is not None and other.stopped.details.get("status") == "max_steps"
        return np.array([steps]), np.array([given_up])

    integrate_again(first, once)
    return Rescan(other, float(remainder(first, np.array([steps]))[0]))


def relocate(motion: Motion, again: Rescan, lock: Lock, recorder: Recorder) -> Relocated:
    """Look for the lock in a second scan."""
    other, factor = again.scanned, again.factor
    if lock.criterion == "multipliers":
        fires = fired(other.growth, motion.scene.deploy.growth)
        error = None if fires is None else GRID + factor * abs(fires - lock.time)
        moved = _earlier(motion, lock, recorder, GRID if error is None else error)
        if other.driven:
            return Relocated(error, other, moved, None, factor)
    else:
        pose = other.latched if lock.criterion == "latch" else other.dead_point
        error = again.time_error(lock.time, pose)
        if pose is None or other.driven:
            return Relocated(error, other, lock if other.driven else None, None, factor)
        moved = dataclasses.replace(lock, time=pose[0], state=pose[1])
    here = classify(motion.problem, motion.system.split(moved.state)[0], motion.passive)
    moved = dataclasses.replace(moved, singular=here)
    return Relocated(error, other, moved, close(motion, other, moved), factor)


def _earlier(motion: Motion, lock: Lock, recorder: Recorder, by: float) -> Lock:
    """Return a lock so much [s] earlier, by the last two samples."""
    times, z = recorder.array("time"), motion.system.split(lock.state)[2]
    if len(times) < 2:
        return lock
    part = by / (times[-1] - times[-2])
    q, qd = (x[-1] - part * (x[-1] - x[-2]) for x in (recorder.array("q"), recorder.array("qd")))
    return dataclasses.replace(lock, time=lock.time - by, state=motion.system.join(q, qd, z))


def doubt(lock: Lock | None, error: float | None) -> NumericalError | None:
    """Return the error of a lock whose time is too uncertain to be one, else None."""
    if lock is None or lock.criterion == "multipliers" or error is None or error <= TRUSTED * lock.time:
        return None
    event = "the latch closes" if lock.criterion == "latch" else "a dead point"
    return NumericalError(
        f"{event} at t = {lock.time:.4g} s, but a second, tighter integration puts it {rounded_up(error):.2g} s away: "
        "the motion is too sensitive to say when it locks",
        time=lock.time,
        time_error=error,
    )


def bifurcation_error(motion: Motion, scanned: Scan) -> RobodynError:
    """Return the error of a deployment that comes to a loss of rank before it locks."""
    assert scanned.bifurcation is not None
    time, state = scanned.bifurcation
    q, _, _ = motion.system.split(state)
    kind = classify(motion.problem, q, motion.passive)
    named = culprit(motion.problem, q, range(motion.problem.model.nv), time)
    angles = dict(zip(motion.problem.model.q_names, q.tolist()))
    return SingularConfigurationError(
        f"bifurcation instead of a lock at t = {time:.9g} s: the constraint Jacobian of loop {named.loop} loses rank "
        f"(singular values {kind.psi[0]:.3g} to {kind.psi[-1]:.1e}); the multipliers are not unique there and the "
        "mechanism may go on in more than one way",
        time=time, kind="bifurcation", singular_values=kind.psi.tolist(), angles=angles,
        loop=named.loop, joint=named.joint,
    )  # fmt: skip


# -- what is reported ---------------------------------------------------------------------------------------
def events(scanned: Scan) -> list[dict[str, Any]]:
    """Return what the scan met."""
    listed = [{"time": time, "name": "dead_point", "kind": "dead_point"} for time, _ in scanned.dead_points]
    if scanned.bifurcation:
        listed.append({"time": scanned.bifurcation[0], "name": "rank", "kind": "bifurcation"})
    growth = scanned.growth
    for level, time in growth.times.items() if growth else ():
        listed.append({"time": time, "name": f"multipliers {level:g} x median", "kind": "growth"})
    if growth and growth.limit_time is not None:
        listed.append({"time": growth.limit_time, "name": "multipliers over the limit", "kind": "limit"})
    return listed


def growth_times(scanned: Scan) -> dict[str, float | None]:
    """Return when each level of growth was passed [s]."""
    growth = scanned.growth
    return {f"{level:g}": growth.times.get(level) for level in growth.levels} if growth else {}


def criteria(motion: Motion, scanned: Scan, again: Rescan | None = None) -> CriterionTimes:
    """Say when each criterion fired, whichever was chosen, with errors by a second scan."""
    times = CriterionTimes(
        chosen=motion.scene.deploy.criterion,
        dead_point=scanned.dead_point[0] if scanned.dead_point else None,
        multipliers=fired(scanned.growth, motion.scene.deploy.growth),
        growth_times=growth_times(scanned),
        limit_time=scanned.growth.limit_time if scanned.growth else None,
        grid=GRID,
        latch=(scanned.latched[0] if scanned.latched else None)
        if motion.scene.deploy.criterion == "latch"
        else ABSENT,
        errors=CriterionErrors(growth=GRID if scanned.growth else ABSENT),
    )
    if again is None:
        return times
    times = with_others(times, [criteria(motion, again.scanned)], again.factor, ("criteria",))
    dead = (
        ABSENT
        if scanned.dead_point is None
        else again.time_error(scanned.dead_point[0], again.scanned.dead_point)
    )
    return dataclasses.replace(times, errors=dataclasses.replace(times.errors, dead_point=dead))


def describe_lock(
    motion: Motion,
    scanned: Scan,
    lock: Lock,
    latch: ClosedLatch | None,
    error: float | None,
    recorder: Recorder,
) -> LockKeys:
    """Describe the lock: time and its ``error``, configuration, kind, multipliers, latch."""
    problem, model = motion.problem, motion.problem.model
    q, qd, _ = motion.system.split(lock.state)
    named = culprit(problem, q, motion.passive, lock.time) if motion.passive and scanned.growth else None
    times = growth_times(scanned)
    estimated = motion.scene.simulate.error_estimate
    angles = [(name, float(x), unit) for name, x, unit in zip(model.q_names, q, model.q_units)]
    keys, note = _latch_keys(motion, lock, latch)
    return LockKeys(
        time=lock.time,
        time_error=error,
        time_error_method="difference from a second, tighter integration; for growth, one grid interval more"
        if estimated or error is not None
        else "not asked for",
        angles={name: x for name, x, _ in angles},
        angles_deg={name: float(np.degrees(x)) for name, x, unit in angles if unit == "rad"},
        rates=dict(zip(model.v_names, qd.tolist())) if not scanned.driven else None,
        errors=LockErrors(),
        kind=lock.kind,
        joint=named.joint if named else None,
        loop=named.loop if named else None,
        criterion=lock.criterion,
        driven=scanned.driven,
        multiplier_growth=MultiplierGrowth(
            None if scanned.driven else scanned.growth.ratio, ABSENT, times, GRID
        )
        if scanned.growth
        else None,
        growth_times=times,
        multipliers=_multiplier_keys(motion, scanned, recorder) if scanned.growth else None,
        singular_values=SingularValues(
            np.linalg.svd(psi_at(problem, q), compute_uv=False).tolist(), lock.singular.passive.tolist()
        )
        if scanned.growth
        else None,
        latch=keys,
        latch_note=note,
    )


def with_rounding(keys: LockKeys, latch: ClosedLatch | None) -> LockKeys:
    """Return the keys of a lock with errors that a second run to it may share with the first."""
    rates = keys.rates or {}
    least = RATES_ROUNDED * max(map(abs, rates.values()), default=0.0)
    keys = dataclasses.replace(keys, errors=LockErrors(rates=least if rates else ABSENT))
    if latch is None or not isinstance(keys.latch, LatchKeys):
        return keys
    return dataclasses.replace(keys, latch=dataclasses.replace(keys.latch, errors=latch.impact.rounding()))


def with_multipliers_beside(keys: LockKeys, motion: Motion, first: Lock) -> LockKeys:
    """Return the keys of a second run's lock with the multipliers farthest from those of the first run.

    Counted are starts that close the loops as well, and states at the lock that differ by rounding alone.
    """
    multipliers = keys.multipliers
    if multipliers is None or not isinstance(multipliers, MultiplierKeys):
        return keys
    rows = motion.problem.constraints.of_loops

    def norms(t: float, x: Array) -> Array:
        return multiplier_norm(motion.observer.multipliers(np.full(len(x), t), np.asfortranarray(x))[:, rows])

    starts = starts_beside(motion.start, motion.closed_otherwise().start)
    multipliers = dataclasses.replace(multipliers, start=float(farthest(norms(0.0, starts))))
    if isinstance(multipliers.at_lock, float):
        beside = np.vstack([first.state, locks_beside(motion.system, first.state)])
        moved = np.append(norms(first.time, beside), multipliers.at_lock)
        multipliers = dataclasses.replace(multipliers, at_lock=float(farthest(moved)))
    return dataclasses.replace(keys, multipliers=multipliers)


def _multiplier_keys(motion: Motion, scanned: Scan, recorder: Recorder) -> MultiplierKeys:
    constraints = motion.problem.constraints
    norm = multiplier_norm(recorder.array("constraints/multipliers")[:, constraints.of_loops])
    times = recorder.array("time")
    ends = float(times[0]), float(times[-1])
    cuts = [(time, None, None) for time in motion.system.breakpoints if ends[0] < time < ends[1]]
    # they diverge towards the lock, which is no sample of the grid: polynomials follow both, differences do not
    peak, error, *_ = Windows(pieces(times, norm[:, None], cuts, ends)).best(1.0, 0)
    return MultiplierKeys(
        start=float(norm[0]),
        at_lock=None if scanned.driven else float(norm[-1]),
        largest_until_lock=None if scanned.driven else peak,
        errors=NormErrors(largest_until_lock=ABSENT if scanned.driven else error),
        rows=[row.name for row in constraints.loop_rows],
        diverge=scanned.driven,
    )


def _latch_keys(
    motion: Motion, lock: Lock, latch: ClosedLatch | None
) -> tuple[LatchKeys | Absent | None, str | Absent]:
    """Return what is said of the latch, and a note where one was asked for and none could close."""
    if latch is not None:
        return latch.impact.keys(motion.problem.model.v_names), ABSENT
    if lock.kind == "overload":
        return None, ABSENT
    if motion.scene.deploy.latch is None:
        return ABSENT, ABSENT
    return None, "rates are unbounded at a dead point that is driven through, so no impulse exists"
