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
from robodyn_cli.record import record
from robodyn_cli.run.driver.method import FAST_DECAYS, TRIAL
from robodyn_cli.run.driver.second_run import (
    MOST_STEPS,
    least_growth,
    other_steps,
    remainder,
    rounding_walk,
    tighter,
)
from robodyn_cli.run.driver.self_check import BEYOND, EPS, is_judged_by_energy
from robodyn_cli.run.driver.stiffness import COST, FIRST_LOOK, MOST, WORTH
from robodyn_cli.run.many.groups import table_rows
from robodyn_cli.run.many.start import Starts, starts_of
from robodyn_cli.run.many.structure import Structure
from robodyn_cli.spatial.algebra import Array

Masks = NDArray[np.bool_]


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

    errors, time_errors : of states (N, nx) and times (N,) at the end, nan where none is estimated. second_steps : of
    the second integration.
    """

    runs: Runs
    errors: Array
    time_errors: Array
    second_steps: NDArray[np.int64]
    trusted: Masks


def method_of(batch: Batch) -> NDArray[np.str_]:
    """Return the method of each run: what the scene asks for, or what ``choose`` would take."""
    choice, count = batch.structure.motion.choice, len(batch.values)
    found = np.full(count, DEFAULT if choice.may_change else choice.method, dtype="<U20")
    if not choice.may_change:
        return found
    decays = _fastest_decays(batch)
    stiff = np.flatnonzero(decays * batch.ends >= FAST_DECAYS)
    if len(stiff):
        part = batch.part(stiff)
        trial = np.maximum(TRIAL * part.ends, np.minimum(part.ends, 20.0 / decays[stiff]))
        part, most = dataclasses.replace(part, ends=trial), np.full(len(stiff), MOST)
        costs = {}
        for method in (DEFAULT, STIFF):
            runs = part.drive(method, batch.options, Limits(steps=most), watch=False)
            costs[method] = np.where(runs.arrived, COST[method] * runs.evaluations, np.inf)
        found[stiff[costs[STIFF] < costs[DEFAULT]]] = STIFF
    return found


def _fastest_decays(batch: Batch) -> Array:
    """Return the largest -Re of the eigenvalues of the Jacobian at the starts (N,) [1/s]."""
    system, x = batch.structure.motion.system, batch.states
    groups = {"t": [0.0], "q": x.T[: system.nq], "v": x.T[system.nq : system.nq + system.nv],
              "z": x.T[system.nq + system.nv :], "p": []}  # fmt: skip
    J = batch.numbers.evaluate(batch.structure.jacobian, groups).reshape(len(x), system.size, system.size)
    sound = np.isfinite(J).all(axis=(1, 2))
    J[~sound] = 0.0
    found: Array = np.maximum(0.0, -np.linalg.eigvals(J).real.min(axis=1))
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
    motion, runs = batch.structure.motion, first_run(batch, method, samples)
    trusted = runs.arrived & batch.starts.sound & np.isfinite(runs.y).all(axis=1)
    if is_judged_by_energy(motion):
        trusted &= _keeps_energy(batch, runs)
    errors, none = np.full(runs.y.shape, np.nan), np.full(len(runs), np.nan)
    steps = np.zeros(len(runs), dtype=np.int64)
    rows = np.flatnonzero(trusted)
    if motion.scene.simulate.error_estimate and len(rows):
        ends = Second(batch.part(rows), method, runs.steps[rows], batch.ends[rows]).run()
        found = ends.scale[:, None] * np.abs(ends.y - runs.y[rows])
        errors[rows] = np.maximum(found, _rounding(batch, runs)[rows])
        steps[rows] = ends.steps
        trusted[rows] &= ends.done
    return Driven(runs, errors, none, steps, trusted)


def _rounding(batch: Batch, runs: Runs) -> Array:
    """Return what rounding of the state is expected to leave of each component (N, nx), as ``rounding_floor`` does."""
    system, floor = batch.structure.motion.system, np.zeros(runs.y.shape)
    for places in (list(system.q_places), list(system.v_places)):
        largest = np.maximum(np.abs(batch.states[:, places]), np.abs(runs.y[:, places])).max(
            axis=1, initial=0.0
        )
        floor[:, places] = (rounding_walk(runs.steps) * largest)[:, None]
    return floor


@record
class Ends:
    """What second integrations came to: time (N,) [s], states (N, nx), steps, and which came to their end.

    scale : by which differences from the first are multiplied; see ``remainder``.
    """

    time: Array
    y: Array
    steps: NDArray[np.int64]
    done: Masks
    scale: Array


class Second:
    """The second integration of many runs; see ``run/driver/second_run.py``, whose rules these are.

    Parameters
    ----------
    steps, ends : of the first one, in which it came so far [s]. arrived : tells which runs came to their end.
    """

    def __init__(
        self,
        batch: Batch,
        method: str,
        steps: NDArray[np.int64],
        ends: Array,
        arrived: Callable[[Runs], Masks] = lambda runs: runs.arrived,
    ) -> None:
        self.batch, self.method, self.first, self.arrived = batch, method, steps, arrived
        self.mean_step = ends / np.maximum(steps, 1)
        self.tight, _ = tighter(batch.options, float(self.mean_step.mean()), method)
        self.least = least_growth(batch.options, self.tight, method)

    def run(self) -> Ends:
        """Make the runs once more, more accurately."""
        count = len(self.first)
        time, y = np.full(count, np.nan), np.full(self.batch.states.shape, np.nan)
        steps, done = np.zeros_like(self.first), np.zeros(count, dtype=bool)
        rows = np.arange(count)
        # those about whose steps a tolerance does not decide go on with other steps
        for way in (self._tighter, self._other_steps):
            if not len(rows):
                break
            runs = way(rows)
            arrived = self.arrived(runs)
            time[rows], y[rows], steps[rows], done[rows] = runs.time, runs.y, runs.steps, arrived
            rows = rows[~arrived | (runs.steps < self.least * self.first[rows])]
        return Ends(time, y, steps, done, remainder(self.method, self.first, steps))

    def _most(self, rows: NDArray[np.int64]) -> NDArray[np.int64]:
        return np.minimum(4 * self.batch.options.max_steps, MOST_STEPS * self.first[rows] + 1000)

    def _tighter(self, rows: NDArray[np.int64]) -> Runs:
        options = self.batch.options
        step = self._shorter(rows) if self.tight.max_step < options.max_step else None
        return self.batch.part(rows).drive(self.method, self.tight, Limits(step, self._most(rows)))

    def _other_steps(self, rows: NDArray[np.int64]) -> Runs:
        options, _ = other_steps(self.tight, float(self.mean_step.max()))
        limits = Limits(self._shorter(rows), self._most(rows))
        return self.batch.part(rows).drive(self.method, options, limits)

    def _shorter(self, rows: NDArray[np.int64]) -> Array:
        return np.array([other_steps(self.batch.options, float(h))[0].max_step for h in self.mean_step[rows]])


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

    before, after = energies(0.0, batch.states), energies(batch.ends, runs.y)
    work = system.split(runs.y)[2][:, -1] if system.work_done_by else np.zeros(len(runs))
    drift = np.abs(after.sum(axis=1) - before.sum(axis=1) - work)
    exchanged = after[:, 0] + before[:, 0] + np.abs(after[:, 1] - before[:, 1]) + np.abs(work)
    exchanged += np.abs(after[:, 1]) * EPS
    rtol = max(batch.options.rtol, EPS)
    rounding = EPS * np.maximum(runs.steps, 1) * (exchanged + np.abs(after[:, 1]))
    found: Masks = drift <= BEYOND * np.maximum(rtol * exchanged, rounding)
    return found
