"""``deploy`` for many runs: up to the dead point, which is located in compiled code, with the error of its time."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from robodyn_cli.formulations.events import EventKind
from robodyn_cli.integrators.runtime.fleet import Runs
from robodyn_cli.integrators.runtime.layout import IntegerSlot, Status
from robodyn_cli.motion.error.attempts import First, Masks
from robodyn_cli.motion.error.estimate import time_errors
from robodyn_cli.motion.motion import Motion
from robodyn_cli.over.many.command import Rows
from robodyn_cli.over.many.groups import first_of
from robodyn_cli.over.many.integrate import Batch, Driven, first_run, second_runs
from robodyn_cli.over.many.motions import MotionCommand, column_of
from robodyn_cli.over.many.record import ManyRuns
from robodyn_cli.over.many.single import number_of
from robodyn_cli.results.result import Result
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.closure import has_full_rank
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.tools.stopwatch import Stopwatch
from robodyn_cli.works.deploy.deploy import build_deployment
from robodyn_cli.works.deploy.lock import TRUSTED

SOUND = 1e-3  # ratio of singular values below which ``classify`` is left to judge the pose
LOCK_TIME, LOCK_ERROR = "lock.time", "lock.time_error"


class Deploy(MotionCommand):
    """Motions up to their lock; ends are the states there."""

    name = "deploy"

    def build(self, scene: Scene) -> Motion:
        return build_deployment(scene, Stopwatch())

    def obstacle(self, motion: Motion) -> str:
        asked = motion.scene.deploy
        reasons = {
            "multipliers are judged on samples": asked.criterion != "dead_point",
            "the motion goes on as the locked structure": asked.after == "continue",
            "loads are judged on samples": bool(asked.loads),
        }
        return first_of(reasons)

    def gives(self, key: str) -> bool:
        return key in (LOCK_TIME, LOCK_ERROR) or key.startswith(("lock.angles.", "lock.rates."))

    def drive(self, batch: Batch, method: str, samples: int) -> Driven:
        motion, count = batch.structure.motion, len(batch.values)
        functions = batch.structure.fleet(method).system.events
        dead = np.array([e.kind is EventKind.DEAD_POINT for e in functions])

        def locked(runs: Runs) -> Masks:
            event = runs.n[:, IntegerSlot.EVENT]
            alone = runs.n[:, IntegerSlot.LOCATED] != 0
            found: Masks = (runs.status == Status.EVENT) & alone & dead[event]
            return found

        runs = first_run(batch, method)
        trusted = locked(runs) & batch.starts.sound & np.isfinite(runs.y).all(axis=1)
        system = motion.system
        trusted &= self._is_regular(batch, batch.starts.q, motion.passive)
        trusted &= self._is_regular(batch, system.split(runs.y)[0], ())
        if not motion.scene.simulate.error_estimate:
            return Driven(runs, trusted)
        errors, steps = np.full(count, np.nan), np.zeros(count, dtype=np.int64)
        if len(rows := np.flatnonzero(trusted)):
            time = runs.time[rows]
            first = First(batch.options, method, runs.steps[rows], time)
            second, done = second_runs(batch.part(rows), first, locked)
            pace = time / np.maximum(second.time, 1e-300)
            found = time_errors(first, np.abs(second.time - time), np.rint(second.steps * pace), time)
            errors[rows], steps[rows] = found, second.steps
            trusted[rows] = done & (found <= TRUSTED * time)
        return Driven(runs, trusted, time_errors=errors, second_steps=steps)

    @staticmethod
    def _is_regular(batch: Batch, q: Array, columns: tuple[int, ...]) -> Masks:
        """Tell at which positions Psi of the loops is far from losing rank, in these coordinates or in all."""
        psi = batch.structure.psi_of_loops
        inputs = {"q": list(q.T), "t": [0.0], "p": []}
        values = batch.numbers.evaluate(psi, inputs).reshape(len(q), -1, batch.structure.motion.system.nv)
        return has_full_rank(values[:, :, list(columns)] if columns else values, SOUND)

    def output(self, key: str, result: ManyRuns, rows: Rows) -> Array:
        if key in (LOCK_TIME, LOCK_ERROR):
            return (result.time if key == LOCK_TIME else result.time_error)[rows]
        _, group, name = key.split(".", 2)
        return column_of(result, "q" if group == "angles" else "qd", name, rows)

    def error_of(self, key: str, result: ManyRuns, rows: Rows) -> Array | float:
        return result.time_error[rows] if key == LOCK_TIME else math.nan

    def single(self, scene: Scene) -> Result:
        from robodyn_cli.works.deploy.deploy import deploy

        return deploy(scene)

    def read(self, summary: Mapping[str, Any], result: ManyRuns, row: int) -> None:
        result.time[row], result.time_error[row] = (
            number_of(summary, LOCK_TIME),
            number_of(summary, LOCK_ERROR),
        )
        for group, names, target in (
            ("angles", result.q_names, result.q),
            ("rates", result.qd_names, result.qd),
        ):
            target[row] = [number_of(summary, f"lock.{group}.{name}") for name in names]
        steps = number_of(summary, "counters.steps")
        result.steps[row] = 0 if math.isnan(steps) else int(steps)
