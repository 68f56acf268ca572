"""Figures between the samples of integrated motions, and their errors: extremes of columns, loads, the motion itself.

A motion is integrated again, by the same steps, with many samples in each, however many the scene asks for; events have
the states on both sides. What more accurate integrations have otherwise is the error that the integration
leaves: two of them, because between steps one may have the same error as the first by chance.
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from robodyn_cli.drives.report import Accurate, Moved
from robodyn_cli.equations.discontinuities import is_of_time, switches, switching_times
from robodyn_cli.errors import NumericalError, SingularConfigurationError
from robodyn_cli.formulations.events import Jumped
from robodyn_cli.integrators.runtime.options import Grid, Options
from robodyn_cli.motion.between.samples import CloseSamples, Steps, TurningTimes, unsure
from robodyn_cli.motion.error import Attempt, integrate_again, remainder
from robodyn_cli.motion.motion import Motion
from robodyn_cli.motion.second_run import FirstRun, driver_again
from robodyn_cli.observe.columns import (
    Block,
    ChosenColumn,
    chosen_columns,
    over_both,
    refuse_missing,
)
from robodyn_cli.observe.control import signals_of
from robodyn_cli.observe.recorder import Recorder
from robodyn_cli.record import record
from robodyn_cli.solve.peaks import ROUNDED, Windows
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.apart import ROUNDED as AGREED
from robodyn_cli.summaries.apart import distance, with_others
from robodyn_cli.summaries.extremes import Extremes
from robodyn_cli.summaries.motion import MotionErrors
from robodyn_cli.torques.checks import turning

IN_STEP, FEWEST_IN_STEP = 64, 8  # samples: steps of high order are long
STRETCHES = 512  # of uniform samples, which are of several steps in a long run
NONE = TurningTimes(np.zeros(0), np.zeros(0))
LOADS = ("reactions/", "loop_reactions/")
MANY, MOST = 2**15, 2**17  # samples, beyond which steps have fewer, and those of the fewest


@record
class ColumnPeaks:
    """The peaks of columns in an integration from one time to another, and their values at the end (n,)."""

    columns: Sequence[ChosenColumn]
    windows: Windows
    final: Array
    ends: tuple[float, float]

    @staticmethod
    def of(samples: CloseSamples, columns: Sequence[ChosenColumn]) -> ColumnPeaks:
        """Return the peaks between close samples."""
        parts, final = samples.pieces(columns)
        return ColumnPeaks(columns, Windows(parts), final, samples.ends)

    def extremes(self, k: int, low_doubt: float = 0.0, high_doubt: float = 0.0) -> Extremes:
        """Return the extremes of a column; doubts : how far its values may be off beside what is between samples."""
        low, high = self.windows.best(-1.0, k, low_doubt), self.windows.best(1.0, k, high_doubt)
        return self.columns[k].extremes(low, high, float(self.final[k]))

    def beside(self, k: int, others: Sequence[ColumnPeaks], factor: float, least: float) -> Extremes:
        """Return the extremes of a column with errors for how far those of more accurate integrations are, and for
        what rounding leaves at least."""
        own = with_others(self.extremes(k), [other.extremes(k) for other in others], factor, ("extremes",))
        values = {name: _plus(getattr(own.errors, name), least) for name in ("smallest", "largest", "final")}
        own = dataclasses.replace(own, errors=dataclasses.replace(own.errors, **values))
        doubts = [
            self.columns[k].doubt(getattr(own, x), getattr(own.errors, x)) for x in ("smallest", "largest")
        ]
        times = self.extremes(k, *doubts).errors
        covered = {
            # it lies in the run
            name: min(
                max(getattr(own.errors, name), getattr(times, name)),
                max(abs(end - getattr(own, name)) for end in self.ends),
            )
            for name in ("smallest_time", "largest_time")
        }
        return dataclasses.replace(own, errors=dataclasses.replace(own.errors, **covered))


@record
class RecordedMotion:
    """A motion that has been integrated and recorded.

    again : what more accurate integrations follow, where they begin and end by themselves. errors : of the motion. Both
    None: they are not estimated.
    """

    motion: Motion
    first: FirstRun
    recorder: Recorder
    again: FirstRun | None = None
    errors: MotionErrors | None = None

    @cached_property
    def own(self) -> CloseSamples:
        """The motion itself.

        Raises
        ------
        NumericalError, SingularConfigurationError : it does not come to its end again.
        """
        first = self.first
        return self._close_samples(first, first.options, self._steps(first, first.options))

    @cached_property
    def others(self) -> tuple[CloseSamples, ...]:
        """More accurate integrations, as far as they come to the end: two, one or none."""
        found: list[CloseSamples] = []
        if self.again is not None:
            with contextlib.suppress(NumericalError, SingularConfigurationError):
                for run in (self.again, self.again.once_more(self.motion.is_steep)):
                    found.append(self._close_samples(run, *self._more_accurate(run)))
        return tuple(found)

    @property
    def is_sparse(self) -> bool:
        """Whether figures that have been asked for are those at samples, since the steps are too many."""
        return "own" in vars(self) and self.own.sparse

    @property
    def factor(self) -> float:
        """The part of the difference of the motion from the others that is its error."""
        return float(remainder(self.first, np.array([other.of[-1].count for other in self.others])).max())

    def extremes(self, names: Sequence[str]) -> dict[str, Extremes]:
        """Return the extremes of those columns that the motion has, by name; raises what ``own`` does."""
        columns = chosen_columns(self.recorder, names)
        if not columns:
            return {}
        if self.own.sparse:
            return self.own.at_samples(columns)
        own = ColumnPeaks.of(self.own, columns)
        if not self.others:
            found = {column.name: own.extremes(k) for k, column in enumerate(columns)}
            return found if self.again is None else {name: unsure(one) for name, one in found.items()}
        others = [ColumnPeaks.of(other, columns) for other in self.others]
        return {
            column.name: own.beside(k, others, self.factor, self._rounded(column.path))
            for k, column in enumerate(columns)
        }

    def first_beyond(self, name: str, limit: float) -> tuple[float, float | None] | None:
        """Return when a column first passes a limit [s], and the error of that, None where it may have done so between
        samples before; None where no close sample does."""
        columns = chosen_columns(self.recorder, [name])

        def passed(samples: CloseSamples) -> tuple[float, float] | None:
            parts, _ = samples.pieces(columns)
            t, y = (np.concatenate([part[k] for part in parts]) for k in (0, 1))
            over = np.flatnonzero(y[:, 0] > columns[0].stored(limit))
            return (float(t[over[0]]), float(t[over[0]] - t[max(over[0] - 1, 0)])) if len(over) else None

        own = passed(self.own) if columns else None
        if own is not None and self.own.sparse:
            return own[0], None
        if own is None or self.again is None:
            return own
        others = [other[0] for other in map(passed, self.others) if other is not None]
        return own[0], own[1] + distance(own[0], others or [own[0]], self.factor if others else 0.0)

    def moved(self) -> tuple[Moved, Accurate]:
        """Return the motion of the joints, and those of the other integrations with their factor; raises what ``own``
        does."""
        widths = {path: self.recorder.blocks[path][0].shape[1] for path in ("q", "qd", "qdd", "tau")}
        if self.own.sparse:
            return self.own.moved(widths), None
        own, *others = (self._beside_turns(one, widths).moved(widths) for one in (self.own, *self.others))
        return own, (others, self.factor) if others else None

    def _beside_turns(self, samples: CloseSamples, widths: Mapping[str, int]) -> CloseSamples:
        """Return samples of the same integration on both sides of where joints turn back: there losses jump, and pieces
        of a few samples would tell little."""
        problem = self.motion.problem
        columns = turning(problem) if problem.scene.motorisation is None else set(range(problem.model.nv))
        if samples.sparse or not columns:
            return samples
        turns = samples.turns(widths, sorted(columns))
        few = 0 < len(turns.times) < MOST / FEWEST_IN_STEP
        return self._close_samples(*samples.of, turns) if few else samples

    def _rounded(self, path: str) -> float:
        """Return what rounding is expected to leave in the columns of a dataset, as a part of the largest of them, and
        of loads of the largest one: what is zero, as moments in a plane are, follows from all."""
        floor = None if self.errors is None else self.errors.rounding_floor
        loads = [name for name in self.recorder.blocks if name.startswith(LOADS)]
        size, own = (
            max(float(np.abs(self.recorder.array(name)).max(initial=0.0)) for name in paths)
            for paths in (("q", "qd"), loads if path.startswith(LOADS) else (path,))
        )
        part = floor / size if isinstance(floor, float) and size > 0.0 else 0.0
        return own * max(part, AGREED)

    def _more_accurate(self, run: FirstRun) -> tuple[Options, Steps]:
        """Return the options and the steps of a more accurate integration."""
        came_to: list[tuple[Options, Steps]] = []

        def once(attempt: Attempt) -> tuple[Any, Any]:
            try:
                came_to.append((attempt.alone, self._steps(run, attempt.alone)))
            except NumericalError as error:
                if error.details.get("status") != "max_steps":
                    raise
                return np.array([attempt.alone.max_steps]), np.array([True])
            return np.array([came_to[-1][1].count]), np.array([False])

        integrate_again(run, once)
        if not came_to:
            raise NumericalError("no second integration came to the end")
        return came_to[-1]

    def _steps(self, run: FirstRun, options: Options) -> Steps:
        """Integrate, and return the steps."""
        driver, start, watch = driver_again(self.motion, run, options)
        ended: list[float] = []
        driver.met, driver.noted, driver.every = [], ended, max(1, int(run.steps[0]) // STRETCHES)
        start()
        driver.run(run.end, Grid(run.end, 0.0, 0), lambda t, x: None, watch=watch)
        begin, end = run.beginning.time, run.end
        fixed = np.unique([begin, *(event.time for event in driver.met), *self._cuts(run), end])
        within = [times[(times >= begin) & (times <= end)] for times in (np.array(ended), fixed)]
        return Steps(within[0], within[1], driver.counters.steps)

    @cached_property
    def _of_signals(self) -> list[float]:
        """Times [s] at which signals switch by formulas of time."""
        problem = self.motion.problem
        if not problem.scene.outputs.signals:
            return []
        return [
            time
            for switch in switches(signals_of(problem))
            if is_of_time(switch, problem.t)
            for time in switching_times(switch, problem.t, problem.scene.simulate.duration)
        ]

    def _cuts(self, run: FirstRun) -> list[float]:
        """Return the times [s] at which formulas of time, or what a sampled controller holds, may jump."""
        updates, time = self.motion.system.updates, run.beginning.time
        known = {*self.motion.system.breakpoints, *self._of_signals}
        times = [x for x in known if time < x < run.end]
        while updates is not None and len(times) * FEWEST_IN_STEP < MOST:
            _, _, time = updates.after(time)
            if time >= run.end:
                break
            times.append(time)
        return sorted(times)

    def _close_samples(
        self, run: FirstRun, options: Options, steps: Steps, turns: TurningTimes = NONE
    ) -> CloseSamples:
        """Integrate with samples between the knots of the steps, and on both sides of turns."""
        driver, start, watch = driver_again(self.motion, run, options)
        stretches, count = max(len(steps.knots) - 1 + len(turns.times), 1), max(steps.count, 1)
        in_step = min(max(MANY / count, 2 * FEWEST_IN_STEP), IN_STEP) * max(1.0, count / stretches)
        inside = 8 * max(1, round(min(in_step, MOST / stretches) / 8))
        knots, sides = steps.beside(turns, inside)
        # samples of steps right behind an event may be as near as roundings, and say nothing beside each other
        apart = np.diff(knots) > inside * ROUNDED * float(np.abs(knots).max())
        knots = knots[np.append(apart, True)]
        blocks: list[Block] = []
        met: list[Jumped] = []
        driver.met = met
        start()
        grid = Grid.between(knots, inside)

        def see(t: Array, x: Array) -> None:
            last = np.searchsorted(sides[0], t) - 1  # none between the two sides of a turn
            kept = (last < 0) | (t >= sides[1][last]) if sides.size else np.ones(len(t), dtype=bool)
            if kept.any():
                blocks.append((t[kept], x[kept], driver.parameters))

        driver.run(run.end, grid, see, watch=watch)
        stopped = bool(met) and met[-1].time == driver.time
        ends = run.beginning.time, driver.time if stopped else run.end
        sparse = inside * stretches < FEWEST_IN_STEP * steps.count
        cuts = self._cuts(run)
        of = run, options, steps
        return CloseSamples(self.recorder.observer, blocks, met, cuts, ends, stopped, sparse, of)


def extremes_over(motions: Sequence[RecordedMotion], names: Sequence[str]) -> dict[str, Extremes]:
    """Return the extremes of columns over motions that follow one another, by name.

    Raises
    ------
    SceneError : no motion has a column of a name. NumericalError, SingularConfigurationError : a motion does not come
        to its end again.
    """
    found = over_all(motions, names)
    refuse_missing(names, found, motions[0].recorder.blocks)
    return {name: found[name] for name in names}


def over_all(motions: Sequence[RecordedMotion], names: Sequence[str]) -> dict[str, Extremes]:
    """Return the extremes of those columns that motions have which follow one another, by name."""
    found: dict[str, Extremes] = {}
    for one in motions:
        for name, later in one.extremes(names).items():
            found[name] = over_both(found[name], later) if name in found else later
    return found


def moved_over(motions: Sequence[RecordedMotion]) -> tuple[Moved, Accurate]:
    """Return what ``moved`` gives of motions that follow one another."""
    parts, more = zip(*(one.moved() for one in motions))
    own = Moved.joined(parts)
    if None in more:
        return own, None
    return own, ([Moved.joined(x) for x in zip(*(others for others, _ in more))], max(x for _, x in more))


def _plus(error: float | None, more: float) -> float | None:
    return None if error is None else error + more
