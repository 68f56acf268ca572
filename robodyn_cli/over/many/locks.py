"""Figures of the locks of many runs that compiled code has made: those of the summary of ``deploy``, with its errors.

A figure follows from states of the run; its error from the same figure of the second run, as ``with_others`` has it.
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from robodyn_cli.errors import RobodynError
from robodyn_cli.integrators.runtime.fleet import Runs
from robodyn_cli.integrators.runtime.memory import IntegerSlot
from robodyn_cli.integrators.runtime.options import Grid
from robodyn_cli.observe.recorder import Recorder
from robodyn_cli.over.many.command import ManyRuns, Rows
from robodyn_cli.over.many.course import (
    LARGEST,
    CourseEnds,
    CourseErrors,
    integrate_to,
    is_between,
    recordings,
    with_between,
)
from robodyn_cli.over.many.integrate import Driven, RunBatch, energies_along
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.apart import ROUNDED
from robodyn_cli.works.deploy.growth import farthest, locks_beside, multiplier_norm, starts_beside
from robodyn_cli.works.deploy.recording import first_overload

# what the summary says of every run whose lock compiled code has found
WORDS: dict[str, Any] = {
    "lock.kind": "dead_point",
    "lock.criterion": "dead_point",
    "lock.driven": False,
    "lock.multipliers.diverge": False,
    "criteria.chosen": "dead_point",
    "termination.kind": "dead_point",
}
# why the command alone gives others
SLOW = {
    "lock.multipliers.largest_until_lock": "it is a peak between samples of the whole motion",
    **dict.fromkeys(
        ("criteria.", "lock.multiplier_growth", "lock.growth_times"), "multipliers are judged on samples"
    ),
    "lock.latch": "it follows from the equations at the lock of each run",
    "assembly.": "it tells how the loops of one run were closed",
}
TIMES = ("lock.time", "criteria.dead_point", "termination.time")
RESIDUALS = ("constraint_residual.position", "constraint_residual.velocity")
ENERGIES = ("energy_drift", "energy_drift_relative")
ALONG = (*RESIDUALS, *ENERGIES)  # the samples of the scene
NORMS = ("lock.multipliers.start", "lock.multipliers.at_lock")
ENTRIES = 4_000_000  # of sampled states at a time: 32 MB
ERRORS = {"error_estimate.q_end": "q", "error_estimate.qd_end": "qd"}
FINAL = ("final.q.", "final.qd.", "final.time")
DEGREES = "lock.angles_deg"
DEGREES_ERROR = "lock.errors.angles_deg"
SINGULAR = ("lock.singular_values.psi", "lock.singular_values.passive")


@record
class Locks:
    """Locks of a batch of runs: times (N,) [s], states there of the first and of the second runs (N, nx).

    factor : (N,), times a difference of both is an error; nan where none is estimated.
    """

    batch: RunBatch
    times: Array
    first: Array
    second: Array
    factor: Array


Figure = tuple[Array, Array]  # values and errors, both (N,)


def is_figure(key: str) -> bool:
    """Tell whether ``figures_of`` gives this key of the summary."""
    group, _, index = key.rpartition(".")
    known = key in (*NORMS, DEGREES_ERROR) or key.startswith(f"{DEGREES}.")
    return known or (group in SINGULAR and index.isdecimal())


def with_ends(driven: Driven, batch: RunBatch, method: str, again: Array, result: ManyRuns) -> Driven:
    """Return what deployments came to with figures of the recorded motions that are asked for.

    again : ends of the second runs (N,) [s]. Where loads have limits, runs that pass one are not trusted.
    """
    keys, runs, limits = list(result.outputs), driven.runs, batch.structure.motion.scene.deploy.loads
    asked = any(key in (*ERRORS, *LARGEST) or key.startswith(FINAL) or is_between(key) for key in keys)
    if not asked and not limits:
        return driven
    system, nothing = batch.structure.motion.system, np.full(len(runs), np.nan)
    good = driven.trusted & batch.structure.observed_alike(batch.numbers)
    errors = CourseErrors.unknown(runs.y.shape)
    if batch.structure.motion.scene.simulate.error_estimate and len(rows := np.flatnonzero(good)):
        errors.put(rows, integrate_to(batch.part(rows), method, runs.time[rows]))
        good &= errors.done
    figures = errors.figures()
    for group, values, off in zip(("q", "qd"), system.split(runs.y), system.split(errors.at_end)):
        largest = off.max(axis=1, initial=0.0)
        figures[f"error_estimate.{group}_end"] = largest, nothing
        if driven.errors is not None:  # that of the lock's time moves the state, too
            at_lock = system.split(driven.errors)[group == "qd"].max(axis=1, initial=0.0)
            largest = np.fmax(largest, at_lock)
        names = getattr(result, f"{group}_names")
        figures |= {f"final.{group}.{name}": (values[:, k], largest) for k, name in enumerate(names)}
    figures["final.time"] = runs.time, nothing if driven.time_errors is None else driven.time_errors
    driven = dataclasses.replace(driven, trusted=good, figures={**driven.figures, **figures})
    ended = CourseEnds(runs.time, again, runs.y, runs.steps, errors.floor)
    driven = with_between(driven, batch, method, ended, keys, "deploy")
    return _below(limits, driven, batch, method, ended) if limits else driven


def _below(
    limits: Mapping[str, Any], driven: Driven, batch: RunBatch, method: str, ended: CourseEnds
) -> Driven:
    """Return what deployments came to; those in which a load passes its limit are left to the command."""
    below = np.zeros(len(driven.trusted), dtype=bool)
    rows = np.flatnonzero(driven.trusted & batch.structure.observed_alike(batch.numbers, reactions=True))
    without_errors = dataclasses.replace(ended, floor=np.full_like(ended.floor, np.nan)).part(rows)
    for k, motion in zip(rows, recordings(batch.part(rows), method, without_errors, ())):
        with contextlib.suppress(RobodynError):  # the command says what is wrong
            below[k] = first_overload([motion], limits) is None
    return dataclasses.replace(driven, trusted=driven.trusted & below)


def with_locks(driven: Driven, batch: RunBatch, second: tuple[Array, Array], result: ManyRuns) -> Driven:
    """Return what deployments came to with figures of their locks that are asked for.

    second : states of the second runs, and the factor, see ``Locks``.
    """
    keys, runs = [key for key in result.outputs if is_figure(key)], driven.runs

    def figures(rows: Rows) -> dict[str, Figure]:
        own = (x[rows] for x in second)
        return figures_of(Locks(batch.part(rows), runs.time[rows], runs.y[rows], *own), keys)

    return driven.with_figures(batch, figures) if keys else driven


def figures_of(locks: Locks, keys: Sequence[str]) -> dict[str, Figure]:
    """Return what keys of the summary are in all runs."""
    motion = locks.batch.structure.motion
    model, nothing = motion.problem.model, np.full(len(locks.first), np.nan)
    known: dict[str, Figure] = {}
    if any(key == DEGREES_ERROR or key.startswith(DEGREES) for key in keys):
        turning = [k for k, unit in enumerate(model.q_units) if unit == "rad"]
        values, errors = _apart(locks, lambda x: np.degrees(motion.system.split(x)[0][:, turning]))
        largest = errors.max(axis=1) if turning else nothing
        known[DEGREES_ERROR] = largest, nothing
        known |= {f"{DEGREES}.{model.q_names[k]}": (x, largest) for k, x in zip(turning, values.T)}
    for group, columns in zip(SINGULAR, (range(model.nv), motion.passive)):
        if any(key.startswith(group) for key in keys):
            values, errors = _apart(locks, partial(_singular_values, locks, columns))
            known |= {f"{group}.{k}": (x, errors.max(axis=1)) for k, x in enumerate(values.T)}
    if any(key in NORMS for key in keys):
        starts = starts_beside(locks.batch.states, locks.batch.closed_otherwise().states)
        here = locks.first[None]
        beside = np.vstack([here, locks_beside(motion.system, locks.first)])
        values, errors = _apart(
            locks, lambda x: _norms(locks, starts[:1], x[None]), lambda x: _norms(locks, starts, [*beside, x])
        )
        known |= {key: (values[:, k], errors[:, k]) for k, key in enumerate(NORMS)}
    return {key: known.get(key, (nothing, nothing)) for key in keys}


def _apart(
    locks: Locks, figure: Callable[[Array], Array], other: Callable[[Array], Array] | None = None
) -> tuple[Array, Array]:
    """Return figures (N, k) of states at the lock, and their errors: how far those of the second runs are apart.

    other : gives the figures of the second runs, where that is not ``figure``.
    """
    values = figure(locks.first)
    if np.isnan(locks.factor).all():
        return values, np.full(values.shape, np.nan)
    # without a second run there is no error: ``factor`` is nan
    again = (other or figure)(np.where(np.isfinite(locks.second), locks.second, locks.first))
    apart = np.abs(again - values)
    return values, locks.factor[:, None] * apart + ROUNDED * np.abs(values)


def _singular_values(locks: Locks, columns: Sequence[int], x: Array) -> Array:
    """Return the singular values of columns of Psi of the loops (N, k)."""
    structure = locks.batch.structure
    q = structure.motion.system.split(x)[0]
    psi = locks.batch.numbers.evaluate(structure.psi_of_loops, {"q": list(q.T), "t": [0.0], "p": []})
    psi = psi.reshape(len(q), -1, structure.motion.system.nv)
    values: Array = np.linalg.svd(psi[:, :, list(columns)], compute_uv=False)
    return values


def _norms(locks: Locks, starts: Array, ends: Array | Sequence[Array]) -> Array:
    """Return the norms of the loops' multipliers at starts (S, N, nx) and at locks (L, N, nx), each time that farthest
    from the first: (N, 2)."""
    batch = locks.batch
    rows = batch.structure.motion.problem.constraints.of_loops
    x = np.asarray(ends)
    norms = np.empty((x.shape[1], 2))
    for k, observer in enumerate(batch.structure.observers(batch.numbers)):
        states = np.asfortranarray(np.vstack([starts[:, k], x[:, k]]))
        times = np.repeat([0.0, locks.times[k]], [len(starts), len(x)])
        own = multiplier_norm(observer.multipliers(times, states)[:, rows])
        norms[k] = farthest(own[: len(starts)]), farthest(own[len(starts) :])
    return norms


def recorded_along(recorder: Recorder) -> tuple[float, ...]:
    """Return the figures of ``ALONG`` of what a recorder has seen."""
    residuals = recorder.position_residual, recorder.velocity_residual
    constrained = bool(recorder.observer.problem.constraints.rows)
    return *(residuals if constrained else (np.nan, np.nan)), recorder.drift, recorder.relative_drift


def figures_along(batch: RunBatch, method: str, times: Array, keys: Sequence[str]) -> dict[str, Figure]:
    """Return figures of the samples of the scene up to the ends of the runs at times (N,) [s], which have no error:
    largest residuals of position and velocity, and those of ``ENERGIES`` where they are among the keys."""
    count, asked = len(batch.values), max(batch.structure.motion.scene.simulate.samples - 1, 1)
    step, largest = batch.ends / asked, np.full((len(times), len(ALONG)), np.nan)
    constrained, wanted = bool(batch.structure.motion.problem.constraints.rows), set(keys) & set(ENERGIES)
    taken = np.array([Grid(0.0, h, asked + 1).first_at(t) for h, t in zip(step, times)])
    size = max(1, ENTRIES // (asked * batch.states.shape[1]))
    for first in range(0, count, size):
        rows = np.arange(first, min(first + size, count))
        part, most = batch.part(rows), int(taken[rows].max())
        runs = part.sampled(method, times[rows], most, step[rows])
        seen = np.minimum(taken[rows], runs.n[:, IntegerSlot.NEXT_SAMPLE] - 1)
        if wanted and not constrained:
            largest[rows, len(RESIDUALS) :] = _energy_drifts(part, runs, seen, times[rows], step[rows])
            continue
        for k, observer in zip(rows.tolist(), part.structure.observers(part.numbers)):
            own = int(seen[k - first])
            states = np.vstack([part.states[k - first], runs.out[k - first, :, :own].T, runs.y[k - first]])
            at = np.append(step[k] * np.arange(own + 1), times[k])
            states = np.asfortranarray(states)
            if wanted:
                recorder = Recorder(observer)
                recorder.emit(at, states, observer.parameters)
                largest[k] = recorded_along(recorder)
            elif constrained:
                largest[k, : len(RESIDUALS)] = observer.largest_residuals(at, states)
    return {key: (largest[:, k], np.full(count, np.nan)) for k, key in enumerate(ALONG)}


def _energy_drifts(batch: RunBatch, runs: Runs, seen: Array, times: Array, step: Array) -> Array:
    """Return the figures of ``ENERGIES`` (N, 2) over the first samples ``seen`` (N,) of runs, one each ``step`` (N,)
    [s], and their ends at times (N,); the scale is that of ``Recorder``."""
    x = np.concatenate([batch.states[:, None], runs.out.transpose(0, 2, 1), runs.y[:, None]], axis=1)
    t = np.column_stack([np.multiply.outer(step, np.arange(x.shape[1] - 1.0)), times])
    beyond = np.arange(x.shape[1]) > seen[:, None]
    beyond[:, -1] = False
    # what is not sampled changes nothing
    x[beyond], t[beyond] = np.broadcast_to(batch.states[:, None], x.shape)[beyond], 0.0
    kinetic, potential, work = energies_along(batch, t, x)
    balance = kinetic + potential - work
    drift = np.abs(balance - balance[:, :1]).max(axis=1)
    scale = np.maximum(np.ptp(potential, axis=1), kinetic.max(axis=1))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.column_stack([drift, np.where(scale > 0.0, drift / scale, 0.0)])
