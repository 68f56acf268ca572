"""Many simulations and many deployments in compiled code."""

from __future__ import annotations

import dataclasses
import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from robodyn_cli.errors import OF_STATUS
from robodyn_cli.formulations.events import EventKind
from robodyn_cli.integration_methods import DEFAULT, METHODS
from robodyn_cli.integrators.runtime.fleet import FEW, Runs
from robodyn_cli.integrators.runtime.memory import IntegerSlot, Location, Status
from robodyn_cli.motion.build import build_motion
from robodyn_cli.motion.error import TRUSTED, First, Masks, remainder, time_errors
from robodyn_cli.motion.method import side_by_side
from robodyn_cli.motion.motion import Motion
from robodyn_cli.motion.self_check import tolerances
from robodyn_cli.over.many.command import STATUS, AskedRuns, BatchCommand, ManyRuns, Rows, number_of
from robodyn_cli.over.many.course import LARGEST, CourseEnds, integrate, is_between, with_between
from robodyn_cli.over.many.groups import first_of
from robodyn_cli.over.many.integrate import (
    SOUND,
    Driven,
    RunBatch,
    first_run,
    keep_rank,
    method_of,
    near_rank_loss,
    second_runs,
)  # fmt: skip
from robodyn_cli.over.many.keys import Key
from robodyn_cli.over.many.locks import (
    ALONG,
    ERRORS,
    FINAL,
    SLOW,
    TIMES,
    WORDS,
    Figure,
    figures_along,
    is_figure,
    with_ends,
    with_locks,
)  # fmt: skip
from robodyn_cli.over.many.structure import Structure
from robodyn_cli.ready.integrable import integrable
from robodyn_cli.results.result import Result
from robodyn_cli.results.summary import as_keys
from robodyn_cli.scene.load import Family
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.closure import has_full_rank
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.apart import ROUNDED
from robodyn_cli.tools.progress import Stopwatch
from robodyn_cli.works.deploy.deploy import build_deployment, deploy
from robodyn_cli.works.deploy.growth import rounding_at_lock

SECOND_STEPS = "error_estimate.steps"
COUNTERS = ("counters.steps", "counters.rejected", "counters.evaluations")
TOLERANCES = ("tolerances.rtol", "tolerances.atol", "tolerances.step")
# sections of the summary that runs have which come to their end without their event
OF_ENDED = ("final", "error_estimate", "termination", "extremes", "fluctuation", "reactions")


class MotionCommand(BatchCommand[Structure]):
    """A command that integrates motions.

    follows_events : whether runs are handed to the watchers of the motion at events.
    """

    follows_events = False

    @abstractmethod
    def build(self, scene: Scene) -> Motion:
        """Return the motion of a scene; raises what the command raises for it."""

    def obstacle(self, motion: Motion) -> str:
        """Return why runs of a motion are made one by one, beside what holds for all commands; nothing if not."""
        return ""

    def beyond(self, motion: Motion) -> str:
        """Return why the command itself has to look into some runs of a motion; nothing if it has not."""
        return ""

    def side_by_side(self, motion: Motion, asked: AskedRuns) -> tuple[str, float] | None:
        """Return what makes runs in lanes in place of the method of the command, and at which share of the tolerances;
        None where nothing does. What it leaves is made by that."""
        return None

    @abstractmethod
    def gives(self, key: str) -> bool:
        """Tell whether ``output`` gives this key of the summary."""

    @abstractmethod
    def drive(self, batch: RunBatch, method: str, asked: AskedRuns) -> Driven:
        """Make the runs of a batch."""

    @abstractmethod
    def output(self, key: str, result: ManyRuns, rows: Rows) -> Array:
        """Return a key that it gives for rows whose ends are in the result."""

    @abstractmethod
    def error_of(self, key: str, result: ManyRuns, rows: Rows) -> Array | float:
        """Return the estimated error of a key for such rows, nan where there is none."""

    def structure(self, family: Family, keys: Sequence[Key], row: Array) -> Structure:
        return Structure(family, keys, row, self)

    def is_plain(self, key: str) -> bool:
        known = (*COUNTERS, SECOND_STEPS, *ALONG, *TOLERANCES, *ERRORS, *LARGEST, *self.words)
        return key in known or key.startswith(FINAL) or is_between(key) or self.gives(key)

    def with_samples(self, scene: Scene, samples: int) -> Scene:
        return dataclasses.replace(scene, simulate=dataclasses.replace(scene.simulate, samples=samples))

    def make(self, structure: Structure, rows: Rows, asked: AskedRuns) -> list[int]:
        own_q, own_qd = (None if x is None else x[rows] for x in (asked.q, asked.qd))
        batch = RunBatch.of(structure, asked.result.values[rows], own_q, own_qd, asked.threads)
        methods, calm = method_of(batch)
        waiting, left = np.ones(len(rows), dtype=bool), list[int]()
        if lanes := self.side_by_side(structure.motion, asked):
            here = np.flatnonzero(calm & (methods == DEFAULT))
            own, (name, share) = rows[here], lanes
            waiting[here] = np.isin(own, self._make(batch.part(here).at_share(share), name, own, asked))
            asked.result.series[own[~waiting[here]]] = METHODS[name].order
        for method in dict.fromkeys(methods[waiting].tolist()):
            chosen = np.flatnonzero(waiting & (methods == method))
            left += self._make(batch.part(chosen), method, rows[chosen], asked)
        return left

    def _make(self, batch: RunBatch, method: str, rows: Rows, asked: AskedRuns) -> list[int]:
        """Make the runs of a batch by one method, which are these rows; return those that are left."""
        driven = self.drive(batch, method, asked)
        told = as_keys(tolerances(batch.structure.motion.options))
        driven.figures.update({key: same(told.get(key.partition(".")[2]), batch) for key in TOLERANCES})
        if along := [key for key in asked.result.outputs if key in ALONG]:
            driven = driven.with_figures(batch, partial(_along, batch, method, driven.runs.time, along))
        if batch.through and len(good := np.flatnonzero(driven.trusted)):
            driven.trusted[good] = keep_rank(batch.part(good), method, driven.runs.time[good])
        self._keep(batch, driven, rows, asked)
        left = ~driven.trusted
        if batch.through or set(asked.result.outputs) & set(COUNTERS):  # other steps
            return rows[left].tolist()
        if not (near := left & near_rank_loss(batch, driven.runs, method)).any():
            return rows[left].tolist()
        # what comes near a loss of rank and keeps it goes on
        on = dataclasses.replace(batch.part(np.flatnonzero(near)), through=True)
        return [*rows[left & ~near].tolist(), *self._make(on, method, rows[near], asked)]

    def _keep(self, batch: RunBatch, driven: Driven, rows: Rows, asked: AskedRuns) -> None:
        """Write those runs of a batch that can be trusted into the result."""
        result, system, good = asked.result, batch.structure.motion.system, driven.trusted
        runs, to = driven.runs, rows[driven.trusted]
        result.code[to], result.time[to], result.steps[to] = 0, runs.time[good], runs.steps[good]
        result.q[to], result.qd[to], _ = system.split(runs.y[good])
        if driven.time_errors is not None:
            result.time_error[to] = driven.time_errors[good]
        if driven.errors is not None:
            result.q_error[to], result.qd_error[to], _ = system.split(driven.errors[good])
        for key, column in result.outputs.items():
            if key in driven.figures:
                column[to], result.errors[key][to] = (x[good] for x in driven.figures[key])
            else:
                column[to] = self._output(key, result, driven, to)
                result.errors[key][to] = self.error_of(key, result, to)
        if asked.samples:
            _keep_samples(batch, driven, to, asked)
        if driven.missed is not None and (missed := rows[driven.missed & good]).size:
            self._keep_missed(result, missed)

    @staticmethod
    def _keep_missed(result: ManyRuns, rows: Rows) -> None:
        """Write runs that came to their end without their event; what is told of it they do not have."""
        result.code[rows] = OF_STATUS["no_lock"]
        for row in rows.tolist():
            result.reason[row] = NO_LOCK
        for array in (result.time, result.time_error, result.q, result.qd, result.q_error, result.qd_error):
            array[rows] = np.nan
        for key in result.outputs:
            if key not in (*COUNTERS, *ALONG, *TOLERANCES) and key.partition(".")[0] not in OF_ENDED:
                result.outputs[key][rows] = result.errors[key][rows] = np.nan

    def _output(self, key: str, result: ManyRuns, driven: Driven, rows: Rows) -> Array:
        """Return an output of those runs that can be trusted, which are these rows."""
        if isinstance(self.words.get(key), bool):
            return np.full(len(rows), float(self.words[key]))
        section, _, name = key.partition(".")
        if section == "counters":
            counts: Array = getattr(driven.runs, name)[driven.trusted]
            return counts
        if key == SECOND_STEPS:
            if driven.second_steps is None:
                return np.full(len(rows), np.nan)
            steps = driven.second_steps[driven.trusted]
            return np.where(steps > 0, steps, np.nan)
        return self.output(key, result, rows)


def same(value: float | None, batch: RunBatch) -> Figure:
    """Return a figure that is the same in all runs of a batch, None of one that they do not have; it has no error."""
    count = len(batch.values)
    return np.full(count, math.nan if value is None else value), np.full(count, math.nan)


def _along(batch: RunBatch, method: str, times: Array, keys: Sequence[str], rows: Rows) -> dict[str, Figure]:
    return figures_along(batch.part(rows), method, times[rows], keys)


def _keep_samples(batch: RunBatch, driven: Driven, rows: Rows, asked: AskedRuns) -> None:
    samples, good = asked.result.samples, driven.trusted
    states = np.concatenate([batch.states[:, None], driven.runs.out.transpose(0, 2, 1)], axis=1)[good]
    share = np.arange(asked.samples) / max(asked.samples - 1, 1)
    samples["time"][rows] = batch.ends[good, None] * share
    samples["q"][rows], samples["qd"][rows], _ = batch.structure.motion.system.split(states)


ENDS = ("final.time", "termination.time")


class Simulate(MotionCommand):
    """Motions over their duration; ends are the last states."""

    name = "simulate"

    def build(self, scene: Scene) -> Motion:
        return build_motion(integrable(scene))

    def side_by_side(self, motion: Motion, asked: AskedRuns) -> tuple[str, float] | None:
        # steps in lanes end at few samples, and are others than those that counters tell of
        plain = (*TOLERANCES, *ERRORS, *ENDS)
        at_end = all(key in plain or key.startswith(FINAL) for key in asked.result.outputs)
        return side_by_side(motion.scene, motion.system) if at_end and asked.samples <= FEW else None

    def gives(self, key: str) -> bool:
        return key == "termination.time"

    def drive(self, batch: RunBatch, method: str, asked: AskedRuns) -> Driven:
        keys = list(asked.result.outputs)
        driven, errors = integrate(batch, method, max(0, asked.samples - 1), bool(set(keys) & set(LARGEST)))
        driven = dataclasses.replace(driven, figures=errors.figures())
        runs = driven.runs
        ended = CourseEnds(runs.time, runs.time, runs.y, runs.steps, errors.floor)
        return with_between(driven, batch, method, ended, keys, self.name)

    def output(self, key: str, result: ManyRuns, rows: Rows) -> Array:
        if key in ERRORS:
            return result.largest_error(ERRORS[key], rows)
        if key in ENDS:
            return result.time[rows]
        _, group, name = key.split(".", 2)
        return result.end_of(group, name, rows)

    def error_of(self, key: str, result: ManyRuns, rows: Rows) -> Array | float:
        parts = key.split(".")
        return result.largest_error(parts[1], rows) if parts[0] == "final" and len(parts) > 2 else math.nan

    def single(self, scene: Scene) -> Result:
        from robodyn_cli.works.simulate import simulate

        return simulate(scene)

    def read(self, summary: Mapping[str, Any], result: ManyRuns, row: int) -> None:
        final = summary.get("final")
        if isinstance(final, Mapping):
            result.time[row] = final["time"]
            result.q[row] = [final["q"][name] for name in result.q_names]
            result.qd[row] = [final["qd"][name] for name in result.qd_names]
            result.steps[row] = summary["counters"]["steps"]
        for key, group in ERRORS.items():
            errors = result.q_error if group == "q" else result.qd_error
            errors[row] = number_of(summary, key)


NO_LOCK = "duration: no lock"
LOCK_ERROR = "lock.time_error"
LOCK_ERRORS = {"lock.errors.angles": "q", "lock.errors.rates": "qd"}


class Deploy(MotionCommand):
    """Motions up to their lock; ends are the states there."""

    name = "deploy"
    words = WORDS
    missed: Mapping[str, Any] = {STATUS: "no_lock"}
    slow = SLOW

    def build(self, scene: Scene) -> Motion:
        return build_deployment(scene, Stopwatch())

    def obstacle(self, motion: Motion) -> str:
        reasons = {
            "a controller acts": motion.problem.control is not None,
            "a motion is prescribed": bool(motion.problem.constraints.rheonomic),
            "multipliers are judged on samples": motion.scene.deploy.criterion != "dead_point",
        }
        return first_of(reasons)

    def beyond(self, motion: Motion) -> str:
        goes_on, loads = motion.scene.deploy.after == "continue", bool(motion.scene.deploy.loads)
        return first_of(
            {"the motion goes on as the locked structure": goes_on, "loads are judged on samples": loads}
        )

    def gives(self, key: str) -> bool:
        known = (*TIMES, LOCK_ERROR, *LOCK_ERRORS)
        return key in known or key.startswith(("lock.angles.", "lock.rates.")) or is_figure(key)

    def drive(self, batch: RunBatch, method: str, asked: AskedRuns) -> Driven:
        motion, count = batch.structure.motion, len(batch.values)
        functions = batch.structure.fleet(method, through=batch.through).system.events
        dead = np.array([e.kind is EventKind.DEAD_POINT for e in functions])

        def locked(runs: Runs) -> Masks:
            event = runs.n[:, IntegerSlot.EVENT]
            alone = runs.n[:, IntegerSlot.LOCATED] == Location.EVENT
            at_lock: Masks = (runs.status == Status.EVENT) & alone & dead[event]
            return at_lock

        runs = first_run(batch, method)
        begun = batch.starts.sound & np.isfinite(runs.y).all(axis=1)
        begun &= self._is_regular(batch, batch.starts.q, motion.passive)
        missed = begun & runs.arrived & (SECOND_STEPS not in asked.result.outputs)
        trusted = begun & locked(runs) & self._is_regular(batch, motion.system.split(runs.y)[0], ())
        trusted &= motion.scene.deploy.after != "continue"  # the command follows the locked structure
        if not motion.scene.simulate.error_estimate:
            nothing = np.full(count, np.nan)
            driven = Driven(runs, trusted | missed, missed=missed)
            driven = with_ends(driven, batch, method, runs.time, asked.result)
            return with_locks(driven, batch, (runs.y, nothing), asked.result)
        errors, steps = np.full(count, np.nan), np.zeros(count, dtype=np.int64)
        others, factor, again = np.full_like(runs.y, np.nan), np.full(count, np.nan), runs.time.copy()
        if len(rows := np.flatnonzero(trusted)):
            time = runs.time[rows]
            first = First(batch.options, method, runs.steps[rows], time)
            second, done = second_runs(batch.part(rows).closed_otherwise(), first, locked)
            pace = time / np.maximum(second.time, 1e-300)
            paced = np.rint(second.steps * pace)
            errors[rows], steps[rows] = (
                time_errors(first, np.abs(second.time - time), paced, time),
                second.steps,
            )
            others[rows], factor[rows], again[rows] = second.y, remainder(first, paced), second.time
            trusted[rows] = done & (errors[rows] <= TRUSTED * time)
        apart = factor[:, None] * np.abs(others - runs.y) + ROUNDED * np.abs(runs.y)
        rates = list(motion.system.v_places)
        apart[:, rates] += rounding_at_lock(motion.system, runs.y)[:, rates]
        driven = Driven(
            runs, trusted | missed, errors=apart, time_errors=errors, second_steps=steps, missed=missed
        )
        driven = with_ends(driven, batch, method, again, asked.result)
        return with_locks(driven, batch, (others, factor), asked.result)

    @staticmethod
    def _is_regular(batch: RunBatch, q: Array, columns: tuple[int, ...]) -> Masks:
        """Tell at which positions Psi of the loops is far from losing rank, in these coordinates or in all."""
        psi = batch.structure.psi_of_loops
        inputs = {"q": list(q.T), "t": [0.0], "p": []}
        values = batch.numbers.evaluate(psi, inputs).reshape(len(q), -1, batch.structure.motion.system.nv)
        return has_full_rank(values[:, :, list(columns)] if columns else values, SOUND)

    def output(self, key: str, result: ManyRuns, rows: Rows) -> Array:
        if key in TIMES or key == LOCK_ERROR:
            return (result.time_error if key == LOCK_ERROR else result.time)[rows]
        if key in LOCK_ERRORS:
            return result.largest_error(LOCK_ERRORS[key], rows)
        _, group, name = key.split(".", 2)
        return result.end_of("q" if group == "angles" else "qd", name, rows)

    def error_of(self, key: str, result: ManyRuns, rows: Rows) -> Array | float:
        if key in TIMES:
            return result.time_error[rows]
        groups = {"lock.angles.": "q", "lock.rates.": "qd"}
        group = next((group for head, group in groups.items() if key.startswith(head)), None)
        return math.nan if group is None else result.largest_error(group, rows)

    def single(self, scene: Scene) -> Result:
        return deploy(scene)

    def read(self, summary: Mapping[str, Any], result: ManyRuns, row: int) -> None:
        result.time[row], result.time_error[row] = (
            number_of(summary, TIMES[0]),
            number_of(summary, LOCK_ERROR),
        )
        for group, names, target, errors in (
            ("angles", result.q_names, result.q, result.q_error),
            ("rates", result.qd_names, result.qd, result.qd_error),
        ):
            target[row] = [number_of(summary, f"lock.{group}.{name}") for name in names]
            errors[row] = number_of(summary, f"lock.errors.{group}")
        steps = number_of(summary, "counters.steps")
        result.steps[row] = 0 if math.isnan(steps) else int(steps)
