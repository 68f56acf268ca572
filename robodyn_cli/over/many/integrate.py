"""Many runs of one structure in compiled code: method, integration, error estimate, and which of them can be trusted.

What is done for each run is what ``simulate`` does, with its options and its second integration. A run that does not
come to its end, or that looks doubtful, is left to ``simulate`` itself.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.expr.many import ManyNumbers
from robodyn_cli.integration_methods import DEFAULT, STIFF
from robodyn_cli.integrators.runtime.fleet import NO_LIMITS, Limits, Runs
from robodyn_cli.integrators.runtime.options import Options
from robodyn_cli.motion.method import FAST_DECAYS, trial_of
from robodyn_cli.motion.second_run import (
    end_errors,
    finer_step,
    other_steps,
    remainder,
    rounding_walk,
    shorter_step,
    steps_between,
    tighter,
)
from robodyn_cli.motion.self_check import BEYOND, EPS, is_judged_by_energy
from robodyn_cli.motion.stiffness import COST, FIRST_LOOK, MOST, WORTH, largest_decays
from robodyn_cli.over.many.groups import table_rows
from robodyn_cli.over.many.start import Starts, starts_of
from robodyn_cli.over.many.structure import Structure
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

Masks = NDArray[np.bool_]
JUDGED = 16  # samples, at least, by which errors at the end are judged


@record
class Batch:
    """Runs of one structure, ready to be driven: rows of values (N, keys), their numbers, starts and ends [s]."""

    structure: Structure
    values: Array
    numbers: ManyNumbers
    starts: Starts
    states: Array
    ends: Array
    options: Options
    threads: int
    tables: dict[str, Array]  # of numbers (N, n), by method

    @staticmethod
    def of(structure: Structure, values: Array, q: Array | None, qd: Array | None, threads: int) -> Batch:
        """Return the runs of rows of values; q, qd : initial states in place of the scene's."""
        numbers = structure.numbers(values)
        starts = starts_of(structure, values, numbers, q, qd)
        ends = structure.column("duration", values)
        if ends is None:
            ends = np.full(len(values), structure.motion.scene.simulate.duration)
        states = starts.states(structure)
        return Batch(structure, values, numbers, starts, states, ends, structure.motion.options, threads, {})

    def part(self, rows: Any) -> Batch:
        """Return some of the runs."""
        if len(rows) == len(self.values):
            return self
        numbers = self.structure.numbers(self.values[rows])
        starts = Starts(self.starts.q[rows], self.starts.v[rows], self.starts.sound[rows])
        tables = {method: table[rows] for method, table in self.tables.items()}
        return Batch(
            self.structure, self.values[rows], numbers, starts, self.states[rows], self.ends[rows], self.options,
            self.threads, tables,
        )  # fmt: skip

    def drive(
        self, method: str, options: Options, limits: Limits = NO_LIMITS, samples: int = 0, watch: bool = True
    ) -> Runs:
        """Return the runs, driven; samples, limits : see ``Fleet.begin``. watch : whether to look for events."""
        fleet = self.structure.fleet(method, watch)
        if method not in self.tables:
            self.tables[method] = table_rows(fleet.tables, self.numbers)
        runs = fleet.begin(self.states, self.tables[method], self.ends, options, limits, samples)
        fleet.drive(runs, self.threads)
        return runs


@record
class Driven:
    """What a batch came to: the first run, and for which runs all of this can be trusted.

    errors, time_errors : of states (N, nx) and times (N,) at the end, nan where none is estimated; None for all runs.
    second_steps : of the second integration, None without one.
    """

    runs: Runs
    trusted: Masks
    errors: Array | None = None
    time_errors: Array | None = None
    second_steps: NDArray[np.int64] | None = None


def method_of(batch: Batch) -> NDArray[np.str_]:
    """Return the method of each run: what the scene asks for, or what ``choose`` would take."""
    choice, count = batch.structure.motion.choice, len(batch.values)
    found = np.full(count, DEFAULT if choice.may_change else choice.method, dtype="<U20")
    if not choice.may_change:
        return found
    decays = _decays(batch)
    stiff = np.flatnonzero(decays * batch.ends >= FAST_DECAYS)
    if len(stiff):
        part = batch.part(stiff)
        part = dataclasses.replace(part, ends=trial_of(part.ends, decays[stiff]))
        most = np.full(len(stiff), MOST)
        costs = {}
        for method in (DEFAULT, STIFF):
            runs = part.drive(method, batch.options, Limits(steps=most), watch=False)
            costs[method] = np.where(runs.arrived, COST[method] * runs.evaluations, np.inf)
        found[stiff[costs[STIFF] < costs[DEFAULT]]] = STIFF
    return found


def _decays(batch: Batch) -> Array:
    """Return the fastest decays at the starts (N,) [1/s]."""
    system, x = batch.structure.motion.system, batch.states
    groups = {"t": [0.0], "q": x.T[: system.nq], "v": x.T[system.nq : system.nq + system.nv],
              "z": x.T[system.nq + system.nv :], "p": []}  # fmt: skip
    J = batch.numbers.evaluate(batch.structure.jacobian, groups).reshape(len(x), system.size, system.size)
    found: Array = largest_decays(J)
    return found


def first_run(batch: Batch, method: str, samples: int) -> Runs:
    """Make the runs of a batch by one method, as far as it is sure to be the one."""
    motion = batch.structure.motion
    most = np.full(len(batch.values), batch.options.max_steps)
    if motion.choice.may_change:
        # more steps: ``StiffnessWatch`` would think about another method
        most = np.minimum(most, FIRST_LOOK + WORTH)
    return batch.drive(method, batch.options, Limits(steps=most), samples)


def integrate(batch: Batch, method: str, samples: int = 0) -> Driven:
    """Make the runs of a batch by one method, and estimate their errors by a second integration."""
    motion = batch.structure.motion
    if not motion.scene.simulate.error_estimate:
        runs = first_run(batch, method, samples)
        return Driven(runs, _trusted(batch, runs))
    # the errors at the end are judged by samples, of which those asked for are some
    share = -(-JUDGED // samples) if samples else 1
    judged = share * samples or JUDGED
    runs = first_run(batch, method, judged)
    trusted = _trusted(batch, runs)
    rows = np.flatnonzero(trusted)
    second = Second(batch.part(rows), method, runs.steps[rows], batch.ends[rows], samples=judged)
    errors, steps = np.full(runs.y.shape, np.nan), np.zeros(len(runs), dtype=np.int64)
    errors[rows] = np.maximum(_end_errors(batch, runs.out[rows], second), _rounding(batch, runs)[rows])
    steps[rows] = second.steps
    trusted[rows] &= second.done
    runs = dataclasses.replace(
        runs, out=runs.out[:, :, share - 1 :: share] if samples else runs.out[:, :, :0]
    )
    return Driven(runs, trusted, errors, second_steps=steps)


def _trusted(batch: Batch, runs: Runs) -> Masks:
    """Tell which runs came to their end, and look as they should."""
    trusted = runs.arrived & batch.starts.sound & np.isfinite(runs.y).all(axis=1)
    if is_judged_by_energy(batch.structure.motion):
        trusted &= _keeps_energy(batch, runs)
    return trusted


def _end_errors(batch: Batch, samples: Array, second: Second) -> Array:
    """Return the errors of states at the end (N, nx), from samples (N, nx, M), by the rule of ``end_errors``."""
    system, scale = batch.structure.motion.system, second.scale
    apart = np.pad(second.samples - samples, ((0, 0), (0, 0), (1, 0)))  # both begin alike
    found = (scale[:, None, None] * np.abs(apart)).transpose(0, 2, 1)
    errors: Array = found[:, -1].copy()
    for places in (list(system.q_places), list(system.v_places)):
        errors[:, places] = end_errors(found[:, :, places], scale)
    return errors


def _rounding(batch: Batch, runs: Runs) -> Array:
    """Return what rounding of the state is expected to leave of each component (N, nx), as ``rounding_floor`` does."""
    system, floor = batch.structure.motion.system, np.zeros(runs.y.shape)
    for places in (list(system.q_places), list(system.v_places)):
        largest = np.maximum(np.abs(batch.states[:, places]), np.abs(runs.y[:, places])).max(
            axis=1, initial=0.0
        )
        floor[:, places] = (rounding_walk(runs.steps) * largest)[:, None]
    return floor


class Second:
    """The second integration of many runs; see ``motion/second_run.py``, whose rules these are.

    Parameters
    ----------
    steps, ends : of the first one, in which it came so far [s]. arrived : tells which runs came to their end.

    What it came to: time (N,) [s], states y (N, nx), samples (N, nx, M), steps, and which runs are done.
    """

    def __init__(
        self,
        batch: Batch,
        method: str,
        steps: NDArray[np.int64],
        ends: Array,
        arrived: Callable[[Runs], Masks] = lambda runs: runs.arrived,
        samples: int = 0,
    ) -> None:
        self._batch, self._method, self._first, self._arrived = batch, method, steps, arrived
        self._mean_step = ends / np.maximum(steps, 1)
        count, size = batch.states.shape
        self.time, self.y = np.full(count, np.nan), np.full((count, size), np.nan)
        self.samples = np.full((count, size, samples), np.nan)
        self.steps, self.done = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=bool)
        if count:
            self._integrate()

    @property
    def scale(self) -> Array:
        """By which differences from the first are multiplied (N,); see ``remainder``."""
        found: Array = remainder(self._method, self._first, self.steps)
        return found

    def _integrate(self) -> None:
        """Make the runs once more, more accurately."""
        options, longest_mean = self._batch.options, float(self._mean_step.max())
        tight, _ = tighter(options, longest_mean, self._method)
        steps = None if tight.rtol < options.rtol else shorter_step(options, self._mean_step)
        if options.step is not None:
            steps = finer_step(options.step, self._mean_step)
        self._drive(np.arange(len(self.time)), tight, steps)
        if options.step is not None:
            return
        # with other steps those whose method cannot keep a tighter tolerance, or about whose steps it does not decide
        few = self.done & (self.steps < steps_between(options, tight, self._method, self._first)[0])
        for rows, base in ((np.flatnonzero(few), tight), (np.flatnonzero(~self.done), options)):
            other, _ = other_steps(base, longest_mean)
            self._drive(rows, other, shorter_step(options, self._mean_step))

    def _drive(self, rows: NDArray[np.int64], options: Options, steps: Array | None) -> None:
        """Make some of the runs; steps : fixed or longest ones (N,) [s]."""
        if not len(rows):
            return
        _, most = steps_between(self._batch.options, options, self._method, self._first[rows])
        limits = Limits(None if steps is None else steps[rows], most)
        runs = self._batch.part(rows).drive(self._method, options, limits, self.samples.shape[2])
        self.time[rows], self.y[rows], self.samples[rows] = runs.time, runs.y, runs.out
        self.steps[rows], self.done[rows] = runs.steps, self._arrived(runs)


def _keeps_energy(batch: Batch, runs: Runs) -> Masks:
    """Tell in which runs the energy at the end is that at the start and the work, as far as tolerances explain.

    A stricter form of ``energy_out_of_balance``, which looks at samples: what it refuses, ``simulate`` judges.
    """
    structure, numbers = batch.structure, batch.numbers
    system = structure.motion.system

    def energies(t: Any, x: Array) -> Array:
        q, v, _ = system.split(x)
        groups = {"t": [t], "q": q.T, "v": v.T, "p": []}
        return numbers.evaluate(structure.energies, groups)

    (kinetic, potential), (kinetic_end, potential_end) = (
        energies(t, x).T for t, x in ((0.0, batch.states), (batch.ends, runs.y))
    )
    work = system.split(runs.y)[2][:, -1] if system.work_done_by else 0.0
    risen, level = potential_end - potential, np.abs(potential_end)
    drift = np.abs(kinetic_end - kinetic + risen - work)
    exchanged = kinetic_end + kinetic + np.abs(risen) + np.abs(work) + level * EPS
    rtol = max(batch.options.rtol, EPS)
    rounding = EPS * np.maximum(runs.steps, 1) * (exchanged + level)
    found: Masks = drift <= BEYOND * np.maximum(rtol * exchanged, rounding)
    return found
