"""Extremes of columns over integrated motions, and their errors.

A motion is integrated once more with so many samples that polynomials through them follow its steps, however many samples
the scene asks for; and again more accurately, for the errors that the integration leaves.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from robodyn_cli.errors import NumericalError
from robodyn_cli.integrators.runtime.options import Grid
from robodyn_cli.motion.error import remainder
from robodyn_cli.motion.motion import Motion
from robodyn_cli.motion.second_run import FirstRun, Second, SecondFailed, Tick, run_again, second_run
from robodyn_cli.observe.columns import ColumnSamples, chosen_columns, over_both, refuse_missing
from robodyn_cli.observe.recorder import Recorder
from robodyn_cli.record import record
from robodyn_cli.solve.quadrature import breaks_at
from robodyn_cli.summaries.apart import with_second
from robodyn_cli.summaries.facts import Extremes

FEWEST, MOST = 2**11, 2**17  # intervals between the samples
OF_STEP = 64  # in a step of the integrator: those of high order are long
OF_UPDATE = 16  # in the period of a sampled controller


@record
class RecordedMotion:
    """A motion that has been integrated and recorded.

    again : what a more accurate integration follows, where it begins and ends by itself; None: there is none.
    """

    motion: Motion
    first: FirstRun
    recorder: Recorder
    again: FirstRun | None

    def extremes(self, names: Sequence[str], tick: Tick) -> dict[str, Extremes]:
        """Return the extremes of those columns that the motion has, by name."""
        own = ColumnSamples(self.recorder.observer, chosen_columns(self.recorder, names))
        first = self._with_samples(self.first)
        found = own.extremes(self._take(own, first, run_again(self.motion, first, first.options, tick)))
        if self.again is None:
            return found
        other, again = ColumnSamples(self.recorder.observer, own.columns), self._with_samples(self.again)
        try:
            second = second_run(self.motion, again, tick)
        except SecondFailed:
            return {name: _unsure(one) for name, one in found.items()}
        factor = float(remainder(first, np.array([second.steps]))[0])
        more = other.extremes(self._take(other, again, second))
        return own.with_rivals(with_second(found, more, factor, ("extremes",)))

    def _with_samples(self, run: FirstRun) -> FirstRun:
        """Return a run with samples for extremes."""
        start = run.beginning.time
        count = max(OF_STEP * int(self.first.steps[0]), OF_UPDATE * len(self._updates(run)))
        count = min(max(FEWEST, count), MOST) + 1
        grid = Grid(start, (run.end - start) / (count - 1), count, run.end)
        return dataclasses.replace(run, grid=grid)

    def _updates(self, run: FirstRun) -> list[float]:
        """Return the times [s] of the updates of a sampled controller, but for those too many to tell."""
        updates, time = self.motion.system.updates, run.beginning.time
        times: list[float] = []
        while updates is not None and OF_UPDATE * len(times) < MOST:
            _, _, time = updates.after(time)
            if time >= run.end:
                break
            times.append(time)
        return times

    def _take(self, samples: ColumnSamples, run: FirstRun, made: Second) -> list[float]:
        """Take the samples of a run; return the places between them where the motion may jump."""
        for t, x, p in made.blocks:
            samples.emit(t, x, p)
        return breaks_at(
            samples.times, sorted([*made.met, *self.motion.system.breakpoints, *self._updates(run)])
        )


def extremes_over(
    motions: Sequence[RecordedMotion], names: Sequence[str], tick: Tick = None
) -> dict[str, Extremes]:
    """Return the extremes of columns over motions that follow one another, by name.

    Raises
    ------
    SceneError : no motion has a column of a name. NumericalError : a motion does not come to its end again.
    """
    found: dict[str, Extremes] = {}
    for one in motions:
        try:
            for name, later in one.extremes(names, tick).items():
                found[name] = over_both(found[name], later) if name in found else later
        except SecondFailed as failed:
            raise NumericalError(f"extremes: the motion did not come to its end again: {failed.message}") from failed
    refuse_missing(names, found, motions[0].recorder.blocks)
    return {name: found[name] for name in names}


def _unsure(found: Extremes) -> Extremes:
    """Return extremes of which no second run tells the errors."""
    fields = [field.name for field in dataclasses.fields(found.errors)]
    return dataclasses.replace(found, errors=dataclasses.replace(found.errors, **dict.fromkeys(fields)))
