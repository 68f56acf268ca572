"""Deployments whose latches compiled code closes (``System.closings``): all runs of a batch go to their ends in it."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from robodyn_cli.expr.many import Expressions
from robodyn_cli.integrators.registry import methods
from robodyn_cli.integrators.runtime.fleet import Runs, Sampling
from robodyn_cli.integrators.runtime.memory import DoubleSlot, IntegerSlot, Note, Status, first_note
from robodyn_cli.motion.contact.events import LatchChange, LatchClosing, LatchFunction
from robodyn_cli.motion.contact.latches import TORN
from robodyn_cli.motion.error import First, Masks, remainder
from robodyn_cli.observe.recorder import Recorder
from robodyn_cli.over.many.integrate import RunBatch, first_run, second_runs
from robodyn_cli.over.many.locks import recorded_along
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.motion import LatchLock, MissedLatch, MissedLatchErrors

SETS_OFF = 1e-9  # part of the largest acceleration, below which one does not tell which way a joint sets off


@record
class LatchFacts:
    """What the latches of a run did: records of those that have closed and of the others, by name.

    last : time of the last closing [s], the state x (nx,) before it, and the latch; None without one.
    """

    locks: dict[str, LatchLock]
    missed: dict[str, MissedLatch]
    last: tuple[float, Array, str] | None


@record
class ClosedRuns:
    """Runs of a batch, once and again for their errors.

    second : None without an error estimate. factor : times a difference of both is an error (N,), see ``remainder``.
    sound : those that came to their ends.
    """

    batch: RunBatch
    runs: Runs
    second: Runs | None
    factor: Array
    sound: Masks

    @staticmethod
    def of(batch: RunBatch, method: str) -> ClosedRuns:
        """Make the runs of a batch by a method, with the samples of the command."""
        simulate = batch.structure.motion.scene.simulate
        batch, sound = _begun(batch, method)
        sampling, second, factor = Sampling(simulate.samples - 1), None, np.full(len(sound), math.nan)
        runs = first_run(batch, method, sampling)
        sound &= _arrived(runs) & np.isfinite(runs.y).all(axis=1)
        if simulate.error_estimate:
            first = First(batch.options, method, runs.steps, runs.time)
            second, done = second_runs(batch, first, _arrived, sampling)
            sound, factor = sound & done, remainder(first, second.steps)
        for each in (runs, second):
            if each is not None:
                _note_ends(batch, each)
        return ClosedRuns(batch, runs, second, factor, sound)

    def along(self) -> Array:
        """Return the figures of ``ALONG`` of the first runs (N, 4); an open chain has but energies, and these do not
        depend on what is closed."""
        structure, runs, rows = self.batch.structure, self.runs, []
        step = self.batch.ends / (structure.motion.scene.simulate.samples - 1)
        for k, observer in enumerate(structure.observers(self.batch.numbers)):
            count = int(runs.n[k, IntegerSlot.NEXT_SAMPLE]) - 1
            states = np.vstack([self.batch.states[k], runs.out[k, :, :count].T, runs.y[k]])
            recorder = Recorder(observer)
            times = np.append(step[k] * np.arange(count + 1), runs.time[k])
            recorder.emit(times, np.asfortranarray(states), runs.p[k])
            rows.append(recorded_along(recorder))
        return np.array(rows)

    def facts(self, runs: Runs, k: int) -> LatchFacts:
        """Return what the latches did in run k, of the first or of the second runs."""
        problem = self.batch.structure.motion.problem
        rows = _notes(self.batch, runs)[k].tolist()
        latches = problem.latches
        times = {
            latch.name: row[Note.TIME] for latch, row in zip(latches, rows) if not math.isnan(row[Note.TIME])
        }
        locks, missed = {}, {}
        for latch, row in zip(latches, rows):
            name = latch.name
            time, *figures = row[: Note.IMPULSE + 1]
            if math.isnan(time):
                unit = latch.closing_unit(problem.model)
                missed[name] = MissedLatch(
                    row[Note.NEAREST], row[Note.NEAREST_TIME], MissedLatchErrors(), unit
                )
                continue
            angle, speed, lost, impulse = figures
            order = 1 + sum(x < time for x in times.values())
            closing = LatchClosing(order, time, angle, speed, lost, impulse)
            locks[name] = closing.described(latch, problem.model)
        if not locks:
            return LatchFacts(locks, missed, None)
        last = max(times, key=times.__getitem__)
        return LatchFacts(locks, missed, (times[last], runs.w[k, -runs.y.shape[1] :], last))


def suits(batch: RunBatch, method: str) -> bool:
    """Tell whether compiled code closes the latches of a batch by itself."""
    motion = batch.structure.motion
    return (
        motion.system.closings is not None and methods[method].adaptive and motion.scene.simulate.samples > 1
    )


def _arrived(runs: Runs) -> Masks:
    arrived: Masks = (runs.status == Status.DONE) | (runs.status == Status.HALTED)
    return arrived


def _notes(batch: RunBatch, runs: Runs) -> Array:
    """Return what is noted of the latches (N, k, Note.SIZE)."""
    count = len(batch.structure.motion.problem.latches)
    return runs.w[:, -runs.y.shape[1] - count * Note.SIZE : -runs.y.shape[1]].reshape(-1, count, Note.SIZE)


def _values(batch: RunBatch, x: Array) -> Array:
    """Return what passes zero where each latch closes, at states x (N, nx): (N, k)."""
    system, problem = batch.structure.motion.system, batch.structure.motion.problem
    closes = Expressions([row.closes for row in problem.latches if row.closes is not None])
    return batch.numbers.evaluate(closes, {"q": system.split(x)[0].T})


def _note_ends(batch: RunBatch, runs: Runs) -> None:
    """Note how near latches are at the last samples of runs that came to the end of their time."""
    ended = np.flatnonzero(runs.status == Status.DONE)
    if not len(ended):
        return
    notes, size = _notes(batch, runs), np.abs(_values(batch, runs.out[:, :, -1]))
    nearer = (size < notes[:, :, Note.NEAREST]) & (runs.status == Status.DONE)[:, None]
    notes[nearer, Note.NEAREST] = size[nearer]
    notes[nearer, Note.NEAREST_TIME] = np.broadcast_to(batch.ends[:, None], size.shape)[nearer]


def _begun(batch: RunBatch, method: str) -> tuple[RunBatch, Masks]:
    """Return the batch with what slots behind those of ``DoubleSlot`` hold at the start, and which runs begin plainly:
    no latch is in its position, and it is clear which way each joint at rest sets off (``Latches.arm``)."""
    motion, x, events = batch.structure.motion, batch.states, batch.structure.fleet(method).system.events
    system, latches = motion.system, motion.problem.latches
    values, (q, v, z) = _values(batch, x), system.split(x)
    rates = Expressions(list(motion.problem.forward.qdd))
    groups = {"t": [0.0], "q": q.T, "v": v.T, "z": z.T, "p": list(system.parameters)}
    a = batch.numbers.evaluate(rates, groups)
    sides = np.zeros((len(x), first_note(len(events)) - DoubleSlot.SIZE))
    sound: Masks = np.all(np.abs(values) > TORN, axis=1)
    for n, function in enumerate(events):
        if isinstance(function, LatchFunction) and function.change is LatchChange.TURNS:
            place = latches[function.number].closing
            rests = v[:, place] == 0.0
            sides[rests, n] = np.copysign(1e-300, a[rests, place])
            sound &= ~rests | (np.abs(a[:, place]) > SETS_OFF * np.abs(a).max(axis=1))
    notes = np.zeros((len(x), len(latches), Note.SIZE))
    notes[:, :, Note.TIME], notes[:, :, Note.NEAREST] = math.nan, np.abs(values)
    slots = np.hstack([sides, notes.reshape(len(x), -1), np.zeros_like(x)])
    return dataclasses.replace(batch, slots=slots), sound
