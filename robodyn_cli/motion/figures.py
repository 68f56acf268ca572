"""Figures over a whole run: loads of its parts, and those that its scene asks for: extremes of columns, drives, margins
of motorisation."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from robodyn_cli.errors import NumericalError, SingularConfigurationError
from robodyn_cli.motion.second_run import Estimate, FirstRun, grid_of
from robodyn_cli.motion.self_check import Run
from robodyn_cli.results.result import Result
from robodyn_cli.summaries.facts import ABSENT, PeakLoad, warned
from robodyn_cli.tools.progress import Stopwatch

if TYPE_CHECKING:
    from robodyn_cli.motion.between.extremes import RecordedMotion
    from robodyn_cli.summaries.extremes import RunExtremes
    from robodyn_cli.summaries.motion import MotionSummary

NO_BOUND = (
    "a prescribed motion drives the mechanism into a dead point, where loads have no bound: there are no largest "
    "loads, figures of drives or margins; `simulate` with a duration that ends before it has them"
)
SPARSE = (
    "the run has more steps than are looked into: extremes, largest loads, figures of drives and margins are those at "
    "samples, without errors; a shorter 'simulate.duration' has them"
)
BEYOND = 1e-9  # of the time at which an event ended a run: so much later it has come again


def with_figures(
    records: list[Any],
    result: Result,
    run: Run,
    estimate: Estimate | None,
    watch: Stopwatch,
    motions: Sequence[RecordedMotion] = (),
) -> list[Any]:
    """Return the records of a run with those of its figures behind them.

    motions : what ``recorded`` gives of the run, and what follows it; by default nothing does.
    """
    scene, reactions = run.motion.scene, run.recorder.observer.reactions
    responding = scene.outputs.response and run.motion.problem.control is not None
    looks = responding or scene.drives or scene.motorisation is not None
    if reactions is not None or scene.outputs.extremes or looks:
        motions = motions or [recorded(run, estimate)]
    summary, *others = records
    if reactions is not None:
        with watch.stage("reactions"):
            loads = reactions.described(loads_of(motions[0]))
            summary = dataclasses.replace(summary, reactions=loads)
    if scene.outputs.extremes:
        from robodyn_cli.motion.between.extremes import extremes_over
        from robodyn_cli.summaries.extremes import RunExtremes

        with watch.stage("extremes"):
            extremes = extremes_over(motions, scene.outputs.extremes)
            found = RunExtremes.of(extremes, scene.simulate.fluctuation)
            summary, others = _with_loads_of_latches(summary, found), [*others, found]
    if responding:
        others = _with_responses(others, run, motions[0], watch)
    records = [summary, *others]
    if scene.drives:
        from robodyn_cli.drives.report import with_drives

        with watch.stage("drives"):
            from robodyn_cli.motion.between.extremes import moved_over

            instants = run.motion.system.breakpoints
            records = with_drives(records, result, run.motion.problem, *moved_over(motions), instants)
    if scene.motorisation is not None:
        with watch.stage("motorisation"):
            records = _with_margins(records, result, run, motions)
    summary, *others = records
    return [warned(summary, [SPARSE] * any(one.is_sparse for one in motions)), *others]


def without_figures(summary: MotionSummary, run: Run) -> MotionSummary:
    """Return the summary of a motion towards loads without bound: the largest would be those of its last sample."""
    scene = run.motion.scene
    asked = run.recorder.observer.reactions is not None or scene.drives or scene.motorisation is not None
    return warned(summary, [NO_BOUND] if asked else [])


def _with_responses(records: list[Any], run: Run, motion: RecordedMotion, watch: Stopwatch) -> list[Any]:
    """Return records with the responses of what the controller leads, and all figures of its torques."""
    from robodyn_cli.motion.response import responses, with_held_torques
    from robodyn_cli.summaries.control import ControlKeys

    control = run.motion.problem.control
    assert control is not None
    with watch.stage("response"):
        records = [
            with_held_torques(motion, control, x) if isinstance(x, ControlKeys) else x for x in records
        ]
        return [*records, responses(motion, control)]


def with_latches_beside(summary: MotionSummary, run: Run, estimate: Estimate | None) -> MotionSummary:
    """Return the summary of a motion with what its latches did, with errors by those of its second run, and warnings
    where that does otherwise."""
    if not run.motion.problem.latches:
        return summary
    from robodyn_cli.motion.contact.latch_states import beside, doubts
    from robodyn_cli.motion.contact.latches import Latches

    one, two = (
        next((x for x in watchers if isinstance(x, Latches)), None)
        for watchers in (run.driver.watchers, () if estimate is None else estimate.watchers)
    )
    if estimate is None or one is None or two is None:
        return summary
    own, again = one.facts(run.driver.time), two.facts(estimate.end)
    told: MotionSummary = warned(summary, doubts(own["locks"], again["locks"]))
    return dataclasses.replace(told, **beside(own, again, estimate.factor))


def _with_margins(
    records: list[Any], result: Result, run: Run, motions: Sequence[RecordedMotion]
) -> list[Any]:
    """Return the records of a run with the margins of motorisation that its scene asks for behind them."""
    from robodyn_cli.drives.motorisation import with_motorisation
    from robodyn_cli.drives.report import Moved
    from robodyn_cli.motion.between.extremes import moved_over

    at_samples = Moved.of(
        run.recorder.array, tuple(run.recorder.breaks(run.recorder.array("time"), run.driver.instants))
    )
    return with_motorisation(records, result, run.motion.problem, at_samples, *moved_over(motions))


def loads_of(motion: RecordedMotion) -> dict[str, PeakLoad]:
    """Return the largest loads of joints, closures and the base by name; where no further integration comes to the end,
    those at the samples, with errors that are not known."""
    reactions = motion.recorder.observer.reactions
    assert reactions is not None
    paths = {path.split("/")[-1]: path for path in reactions.of_parts}
    try:
        found = motion.extremes([f"{path}.{size}" for path in paths.values() for size in ("force", "moment")])
    except (NumericalError, SingularConfigurationError):
        loads = motion.recorder.largest_loads()
        return {
            name: dataclasses.replace(load, force_error=None, moment_error=None)
            for name, load in loads.items()
        }

    def most(column: str) -> tuple[float, float | None]:
        one = found.get(column)  # components that the data leave open have none
        return (0.0, 0.0) if one is None else (one.largest, one.errors.largest)

    loads = {}
    for name, path in paths.items():
        (force, force_error), (moment, moment_error) = most(f"{path}.force"), most(f"{path}.moment")
        loads[name] = PeakLoad(force, moment, force_error, moment_error)
    return loads


def recorded(run: Run, estimate: Estimate | None) -> RecordedMotion:
    """Return a run that has been recorded; the second one goes on to its own end."""
    from robodyn_cli.motion.between.extremes import RecordedMotion

    scene = run.motion.scene
    duration = scene.simulate.duration
    first = FirstRun.of(run.driver, run.beginning, grid_of(scene, run.beginning), run.recorder)

    def to(end: float) -> FirstRun:
        # an event that ended the run ends it again
        return dataclasses.replace(first, end=min(end + BEYOND * abs(end), duration)) if ended else first

    ended = run.driver.time < duration
    motion = RecordedMotion(run.motion, to(first.end), run.recorder)
    if estimate is not None:
        again = to(estimate.end) if estimate.watchers else first
        motion = dataclasses.replace(motion, again=again, errors=estimate.errors)
    return motion


def _with_loads_of_latches(summary: MotionSummary, found: RunExtremes) -> MotionSummary:
    """Return the summary of a motion with the largest loads of those rigid latches whose extremes are known."""
    if not isinstance(summary.locks, dict):
        return summary
    locks = dict(summary.locks)
    for name, lock in locks.items():
        load = found.extremes.get(f"latch_loads.{name}")
        is_rigid = lock.angular_impulse is not ABSENT or (not lock.order and lock.peak_moment is ABSENT)
        if load is None or not is_rigid or lock.errors is ABSENT:
            continue
        side = "largest" if load.largest >= -load.smallest else "smallest"
        peak, error = getattr(load, side), getattr(load.errors, side)
        time, time_error = getattr(load, f"{side}_time"), getattr(load.errors, f"{side}_time")
        errors = dataclasses.replace(lock.errors, peak_moment=error, peak_time=time_error)
        locks[name] = dataclasses.replace(lock, peak_moment=abs(peak), peak_time=time, errors=errors)
    return dataclasses.replace(summary, locks=locks)
