"""Many runs of one structure in compiled code: method, integration, error estimate, and which of them can be trusted.

What is done for each run is what ``simulate`` does, with its options and its second integration. A run that does not
come to its end, or that looks doubtful, is left to ``simulate`` itself.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.expr.many import ManyNumbers
from robodyn_cli.formulations.events import EventKind
from robodyn_cli.integration_methods import DEFAULT, STIFF
from robodyn_cli.integrators.runtime.fleet import FEW, NO_LIMITS, NO_SAMPLES, FleetLimits, Runs, Sampling
from robodyn_cli.integrators.runtime.memory import DoubleSlot, IntegerSlot, Status
from robodyn_cli.integrators.runtime.options import Options
from robodyn_cli.model.manifold import Manifold
from robodyn_cli.motion.conditioning import closing_steps, rounded_rows
from robodyn_cli.motion.error import Attempt, First, Masks, integrate_again
from robodyn_cli.motion.method import compare
from robodyn_cli.motion.self_check import EPS, EnergyCourse, allowed_drift, is_judged_by_energy
from robodyn_cli.motion.stiffness import COST, FIRST_LOOK, MOST, WORTH, largest_decays
from robodyn_cli.over.many.groups import table_rows
from robodyn_cli.over.many.start import Starts, starts_of
from robodyn_cli.over.many.structure import Structure
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

SOUND = 1e-3  # ratio of singular values below which ``classify`` is left to judge the pose
FINER_SAMPLES = 4000, 32000  # of a run, between which Psi is followed
LOOKED_AT = 2 * FEW  # samples of a run by which its energy is judged: not by steps in lanes, which end at few
SERIES_STEPS = 3  # of a Taylor series, about, go the way of one of the default method
ROUNDED_AT_ONCE = 2000  # samples whose rounding is looked at together: some MB for 50 operations
CURVED = 1.5  # times the distance of two samples of Psi is at least the way between them


@record
class RunBatch:
    """Runs of one structure, ready to be driven: rows of values (N, keys), their numbers, starts and ends [s].

    through : whether they go on where the loops come near a loss of rank. slots : what memory holds at the start behind
    ``DoubleSlot`` (N, n); None: zeros.
    """

    structure: Structure
    values: Array
    numbers: ManyNumbers
    starts: Starts
    states: Array
    ends: Array
    options: Options
    threads: int
    tables: dict[tuple[str, bool], Array]  # of numbers (N, n), by method
    through: bool = False
    slots: Array | None = None

    @staticmethod
    def of(structure: Structure, values: Array, q: Array | None, qd: Array | None, threads: int) -> RunBatch:
        """Return the runs of rows of values; q, qd : initial states in place of the scene's."""
        numbers = structure.numbers(values)
        starts = starts_of(structure, structure.motion, values, q, qd)
        ends = structure.column("duration", values)
        if ends is None:
            ends = np.full(len(values), structure.motion.scene.simulate.duration)
        states = starts.states(structure, numbers)
        return RunBatch(
            structure, values, numbers, starts, states, ends, structure.motion.options, threads, {}
        )

    def part(self, rows: Any) -> RunBatch:
        """Return some of the runs."""
        if len(rows) == len(self.values):
            return self
        numbers = self.structure.numbers(self.values[rows])
        starts = Starts(self.starts.q[rows], self.starts.v[rows], self.starts.sound[rows])
        tables = {key: table[rows] for key, table in self.tables.items()}
        return RunBatch(
            self.structure, self.values[rows], numbers, starts, self.states[rows], self.ends[rows], self.options,
            self.threads, tables, self.through, None if self.slots is None else self.slots[rows],
        )  # fmt: skip

    def at_share(self, share: float) -> RunBatch:
        """Return the runs with a share of their tolerances."""
        rtol, atol = share * self.options.rtol, share * self.options.atol
        return dataclasses.replace(self, options=dataclasses.replace(self.options, rtol=rtol, atol=atol))

    @property
    def start_rounding(self) -> tuple[Array, Array]:
        """Psi (N, m, nv) at the starts, and how far rounding may have put the rows off there (N,); both empty
        without any."""
        q, v, problem = self.starts.q, self.starts.v, self.structure.motion.problem
        parts = []
        for rows in in_parts(len(q), 1):
            inputs = {"t": np.zeros((len(rows), 1, 1)), "q": q[rows, None], "v": v[rows, None]}
            parts.append(rounded_rows(problem, inputs, self.numbers.rows(rows)))
        psi, off = (np.concatenate(part) for part in zip(*parts))
        return (psi[:, 0], off[:, 0]) if off.size else (np.zeros((0, 0, problem.model.nv)), np.zeros(0))

    def closed_otherwise(self) -> RunBatch:
        """Return the runs from other starts that close the loops as well: as far away as rounding leaves open."""
        motion, (psi, off) = self.structure.motion, self.start_rounding
        if not len(off):
            return self
        steps = closing_steps(psi, off, motion.held)
        manifold = Manifold(motion.problem.model)
        states, places = self.states.copy(), list(motion.system.q_places)
        for state, q, step in zip(states, self.starts.q, steps):
            state[places] = manifold.integrate(q, step)
        return dataclasses.replace(self, states=states)

    def drive(
        self,
        method: str,
        options: Options,
        limits: FleetLimits = NO_LIMITS,
        sampling: Sampling = NO_SAMPLES,
        watch: bool = True,
    ) -> Runs:
        """Return the runs, driven; limits, sampling : see ``Fleet.begin``. watch : whether to look for events."""
        fleet = self.structure.fleet(method, watch, self.through)
        key = method, self.through
        if key not in self.tables:
            self.tables[key] = table_rows(fleet.tables, self.numbers)
        runs = fleet.begin(self.states, self.tables[key], self.ends, options, limits, sampling)
        if self.slots is not None:
            runs.w[:, DoubleSlot.SIZE :] = self.slots
        fleet.drive(runs, self.threads)
        return runs

    def sampled(self, method: str, times: Array, samples: int, step: Array | None = None) -> Runs:
        """Return the runs once more with samples up to times (N,) [s]; step : between these (N,) [s]."""
        motion = self.structure.motion
        if any(event.is_discontinuity for event in motion.system.events):
            return self.drive(method, self.options, sampling=Sampling(samples, step))
        return dataclasses.replace(self, ends=times).drive(
            method, self.options, sampling=Sampling(samples, step), watch=False
        )


# values and errors (n,) by key of the summary, of runs of these numbers (n,)
FiguresOf = Callable[[NDArray[np.int64]], Mapping[str, "tuple[Array, Array]"]]


@record
class Driven:
    """What a batch came to: the first run, and for which runs all of this can be trusted.

    errors, time_errors : of states (N, nx) and times (N,) at the end, nan where none is estimated; None for all runs.
    second_steps : of the second integration, None without one. figures : values and errors (N,) of keys of the summary
    beside these. missed : runs that came to their end without the event that they were to meet; None: all are to.
    """

    runs: Runs
    trusted: Masks
    errors: Array | None = None
    time_errors: Array | None = None
    second_steps: NDArray[np.int64] | None = None
    figures: dict[str, tuple[Array, Array]] = dataclasses.field(default_factory=dict)
    missed: Masks | None = None

    def with_figures(self, batch: RunBatch, figures: FiguresOf, reactions: bool = False) -> Driven:
        """Return the same with figures of those runs that can be trusted and whose samples the structure evaluates;
        reactions : loads, too."""
        trusted = self.trusted & batch.structure.observed_alike(batch.numbers, reactions)
        rows = np.flatnonzero(trusted)
        more = {}
        for key, pair in figures(rows).items():
            value, error = (np.full(len(trusted), np.nan) for _ in pair)
            value[rows], error[rows] = pair
            more[key] = value, error
        return dataclasses.replace(self, trusted=trusted, figures={**self.figures, **more})


def in_parts(count: int, samples: int) -> list[NDArray[np.intp]]:
    """Return the numbers of runs in parts whose rounding is looked at together, so that memory suffices."""
    parts = max(1, math.ceil(count * samples / ROUNDED_AT_ONCE))
    return list(np.array_split(np.arange(count), parts))


def method_of(batch: RunBatch) -> tuple[NDArray[np.str_], Masks]:
    """Return the method of each run: what the scene asks for, or what ``choose`` would take; and which runs are surely
    not stiff."""
    choice, count = batch.structure.motion.choice, len(batch.values)
    methods = np.full(count, DEFAULT if choice.may_change else choice.method, dtype="<U20")
    calm = np.ones(count, dtype=bool)
    if not choice.may_change:
        return methods, calm

    def cost(method: str, rows: NDArray[np.int64], trials: Array) -> Array:
        limits = FleetLimits(steps=np.full(len(rows), MOST))
        runs = dataclasses.replace(batch.part(rows), ends=trials).drive(
            method, batch.options, limits, watch=False
        )
        costs: Array = np.where(runs.arrived, COST[method] * runs.evaluations, np.inf)
        return costs

    rows, _, slow, fast = compare(decays_of(batch), batch.ends, cost)
    methods[rows[fast < slow]] = STIFF
    calm[rows] = False
    return methods, calm


def decays_of(batch: RunBatch) -> Array:
    """Return the fastest decays at the starts (N,) [1/s]."""
    system, x = batch.structure.motion.system, batch.states
    groups = {"t": [0.0], "q": x.T[: system.nq], "v": x.T[system.nq : system.nq + system.nv],
              "z": x.T[system.nq + system.nv :], "p": list(system.parameters)}  # fmt: skip
    J = batch.numbers.evaluate(batch.structure.jacobian, groups).reshape(len(x), system.size, system.size)
    decays: Array = largest_decays(J)
    return decays


def first_run(batch: RunBatch, method: str, sampling: Sampling = NO_SAMPLES) -> Runs:
    """Make the runs of a batch by one method, as far as it is sure to be the one."""
    motion = batch.structure.motion
    most = np.full(len(batch.values), batch.options.max_steps)
    if motion.choice.may_change:
        # more steps: ``StiffnessWatch`` would think about another method
        most = np.minimum(most, (FIRST_LOOK + WORTH) * (1 if method in (DEFAULT, STIFF) else SERIES_STEPS))
    return batch.drive(method, batch.options, FleetLimits(steps=most), sampling)


def near_rank_loss(batch: RunBatch, runs: Runs, method: str) -> Masks:
    """Tell which runs ended where the loops come near a loss of rank."""
    events = batch.structure.fleet(method, through=batch.through).system.events
    near = np.array([e.kind is EventKind.RANK_LOSS for e in events] or [False])
    ended: Masks = (runs.status == Status.EVENT) & near[runs.n[:, IntegerSlot.EVENT]]
    return ended


def keep_rank(batch: RunBatch, method: str, times: Array) -> Masks:
    """Tell in which runs Psi of the loops provably keeps its rank up to times (N,) [s].

    No singular value changes by more than the norm of the change of the matrix (Weyl), so between two samples none
    falls below half of its sum there less the length of the way of Psi.
    """
    structure, kernel = batch.structure, batch.structure.psi_at_samples
    tables, kept = batch.numbers.table(kernel.program.numbers or (0.0,)), np.zeros(len(times), dtype=bool)
    nv, q_places = structure.motion.system.nv, list(structure.motion.system.q_places)
    for k in range(len(times)):
        one = batch.part(np.array([k]))
        for samples in FINER_SAMPLES:
            runs = one.sampled(method, times[k : k + 1], samples)
            states = np.vstack([one.states, runs.out[0].T])
            kernel.table = np.ascontiguousarray(tables[k])
            groups = {"q": states[:, q_places], "t": np.zeros(len(states)), "p": np.zeros(1)}
            psi = kernel.evaluate(len(states), groups)["psi"].reshape(len(states), -1, nv)
            sigma = np.linalg.svd(psi, compute_uv=False)
            way = CURVED * np.linalg.norm(np.diff(psi, axis=0), axis=(1, 2))
            least = 0.5 * (sigma[1:, -1] + sigma[:-1, -1] - way)
            if np.isfinite(least).all() and (least > SOUND * sigma[1:, 0]).all():
                kept[k] = True
                break
    return kept


def second_runs(
    batch: RunBatch,
    first: First,
    arrived: Callable[[Runs], Masks],
    sampling: Sampling = NO_SAMPLES,
    watch: bool = True,
) -> tuple[Runs, Masks]:
    """Make runs once more, more accurately; return them, and which came to their end.

    arrived : tells which runs did. watch : whether to look for events.
    """
    second: Runs
    done = np.zeros(len(batch.values), dtype=bool)

    def once(attempt: Attempt) -> tuple[Any, Masks]:
        nonlocal second
        rows = attempt.rows
        own = sampling.part(rows)
        limits = FleetLimits(attempt.step, attempt.most)
        runs = batch.part(rows).drive(first.method, attempt.options, limits, own, watch)
        if len(rows) == len(done):
            second = runs
        else:
            second.put(rows, runs)
        done[rows] = arrived(runs)
        given_up: Masks = runs.status == Status.MAX_STEPS
        # what failed otherwise is not made once more
        return np.where(done[rows], runs.steps, np.iinfo(np.int64).max), given_up

    integrate_again(first, once)
    return second, done


def trust(batch: RunBatch, runs: Runs, method: str) -> Masks:
    """Tell which runs came to their end, and look as they should."""
    trusted = runs.arrived & batch.starts.sound & np.isfinite(runs.y).all(axis=1)
    if is_judged_by_energy(batch.structure.motion):
        kept = keeps_energy(batch, runs.y, runs.steps)
        if len(rows := np.flatnonzero(trusted & ~kept)):
            kept[rows] = keeps_energy_along(batch.part(rows), method)
        trusted &= kept
    return trusted


def keeps_energy(batch: RunBatch, y: Array, steps: NDArray[np.int64], p: Array | None = None) -> Masks:
    """Tell in which runs the energy at the end is that at the start and the work, as far as tolerances explain.

    A stricter form of ``energy_out_of_balance``, which looks at samples: what it refuses, that judges.

    Parameters
    ----------
    y : states (N, nx) at the ends. p : parameters (N, np) there, where they change.
    """
    none = list(batch.structure.motion.system.parameters)
    (kinetic, potential, _), (kinetic_end, potential_end, work) = (
        _energies(batch, t, x, p)
        for t, x, p in ((0.0, batch.states, none), (batch.ends, y, none if p is None else p.T))
    )
    change = kinetic_end - kinetic, potential_end - potential, work
    return balances(change, kinetic + kinetic_end, potential_end, steps, batch.options.rtol)


def keeps_energy_along(batch: RunBatch, method: str) -> Masks:
    """Tell in which runs the energy is in balance at samples along the way, as ``energy_out_of_balance`` does."""
    motion, step = batch.structure.motion, batch.ends / LOOKED_AT
    runs = batch.drive(method, batch.options, sampling=Sampling(LOOKED_AT, step))
    x = np.concatenate([batch.states[:, None], runs.out.transpose(0, 2, 1)], axis=1)
    energies = energies_along(batch, np.multiply.outer(step, np.arange(x.shape[1])), x)
    course = EnergyCourse(*(y.swapaxes(0, 1) for y in (*energies, *motion.system.split(x)[:2])))
    rounding = sum(watcher.rounding for watcher in motion.watchers)
    kept: Masks = runs.arrived & np.all(
        course.drift <= course.allowed(runs.steps, batch.options, rounding + runs.rounded), axis=0
    )
    return kept


def energies_along(batch: RunBatch, t: Array, x: Array) -> tuple[Array, Array, Array]:
    """Return kinetic and potential energy, and the work that was done [J], of runs at times (N, T) and states
    (N, T, nx): (N, T) each."""
    structure, system = batch.structure, batch.structure.motion.system
    kernel = structure.energies_at_samples
    q, v, z = system.split(x)
    tables = batch.numbers.table(kernel.program.numbers or (0.0,))
    groups = {"t": t[..., None], "q": q, "v": v, "p": np.array([*system.parameters, 0.0])}
    found = kernel.of_tables(tables, x.shape[1], groups)
    work = z[..., -1] if system.work_done_by else np.zeros(t.shape)
    return found["kinetic"][:, 0], found["potential"][:, 0], work


def _energies(batch: RunBatch, t: Any, x: Array, p: Any) -> tuple[Array, Array, Array]:
    """Return kinetic and potential energy, and the work that was done [J], of runs (N,) at states (N, nx)."""
    structure = batch.structure
    q, v, z = structure.motion.system.split(x)
    groups = {"t": [t], "q": q.T, "v": v.T, "p": p}
    kinetic, potential = batch.numbers.evaluate(structure.energies, groups).T
    return kinetic, potential, z[:, -1] if structure.motion.system.work_done_by else np.zeros(len(x))


def balances(change: tuple[Any, Any, Any], kinetic: Any, potential: Any, steps: Any, rtol: float) -> Masks:
    """Tell whether changes of energies and the work that was done [J] balance, as far as tolerances explain.

    Parameters
    ----------
    change : of the kinetic and of the potential energy, and the work. kinetic : of start and end together. potential :
    at the end.
    """
    gained, risen, work = change
    level = np.abs(potential)
    drift = np.abs(gained + risen - work)
    exchanged = kinetic + np.abs(risen) + np.abs(work) + level * EPS
    kept: Masks = drift <= allowed_drift(exchanged, level, steps, rtol)
    return kept
