"""Figures over a whole run that its scene asks for: extremes of columns, drives, margins of motorisation."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

from robodyn_cli.motion.second_run import Estimate, FirstRun, grid_of
from robodyn_cli.motion.self_check import Run, with_margins
from robodyn_cli.results.result import Result
from robodyn_cli.summaries.facts import ABSENT
from robodyn_cli.tools.progress import Stopwatch

if TYPE_CHECKING:
    from robodyn_cli.summaries.extremes import RunExtremes
    from robodyn_cli.summaries.motion import MotionSummary

BEYOND = 1e-9  # of the time at which an event ended a run: so much later it has come again


def with_figures(
    records: list[Any], result: Result, run: Run, estimate: Estimate | None, watch: Stopwatch
) -> list[Any]:
    """Return the records of a run with those of the figures that its scene asks for behind them."""
    scene = run.motion.scene
    if scene.outputs.extremes:
        with watch.stage("extremes"):
            found = _extremes(run, estimate)
            records = [_with_loads_of_latches(records[0], found), *records[1:], found]
    if scene.drives:
        from robodyn_cli.drives.report import with_drives

        with watch.stage("drives"):
            again = None
            if estimate is not None and estimate.recorder is not None:
                again = (estimate.recorder, estimate.factor)
            problem, instants = run.motion.problem, run.motion.system.breakpoints
            records = with_drives(records, result, problem, instants=instants, again=again)
    if scene.motorisation is not None:
        with watch.stage("motorisation"):
            records = with_margins(records, result, run, estimate)
    return records


def with_latches_beside(summary: MotionSummary, run: Run, estimate: Estimate | None) -> MotionSummary:
    """Return the summary of a motion with what its latches did, with errors by those of its second run."""
    from robodyn_cli.motion.contact.latch_states import beside
    from robodyn_cli.motion.contact.latches import Latches

    one, two = (
        next((x for x in watchers if isinstance(x, Latches)), None)
        for watchers in (run.driver.watchers, () if estimate is None else estimate.watchers)
    )
    if estimate is None or one is None or two is None:
        return summary
    facts = one.facts(run.driver.time), two.facts(estimate.end)
    return dataclasses.replace(summary, **beside(*facts, estimate.factor))


def _extremes(run: Run, estimate: Estimate | None) -> RunExtremes:
    """Return the extremes of columns over a run; the second run goes on to its own end."""
    from robodyn_cli.motion.extremes import RecordedMotion, extremes_over
    from robodyn_cli.summaries.extremes import RunExtremes

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
    return RunExtremes.of(extremes_over([motion], scene.outputs.extremes), scene.simulate.fluctuation)


def _with_loads_of_latches(summary: MotionSummary, found: RunExtremes) -> MotionSummary:
    """Return the summary of a motion with the largest loads of those rigid latches whose extremes are known."""
    if not isinstance(summary.locks, dict):
        return summary
    locks = dict(summary.locks)
    for name, lock in locks.items():
        load = found.extremes.get(f"latch_loads.{name}")
        if load is None or lock.angular_impulse is ABSENT or lock.errors is ABSENT:
            continue
        side = "largest" if load.largest >= -load.smallest else "smallest"
        peak, error = getattr(load, side), getattr(load.errors, side)
        time, time_error = getattr(load, f"{side}_time"), getattr(load.errors, f"{side}_time")
        errors = dataclasses.replace(lock.errors, peak_moment=error, peak_time=time_error)
        locks[name] = dataclasses.replace(lock, peak_moment=abs(peak), peak_time=time, errors=errors)
    return dataclasses.replace(summary, locks=locks)
