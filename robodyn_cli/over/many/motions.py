"""What many motions have in common: they are driven in compiled code, and end in a state."""

from __future__ import annotations

import dataclasses
from abc import abstractmethod
from collections.abc import Sequence

import numpy as np

from robodyn_cli.motion.motion import Motion
from robodyn_cli.over.many.command import Asked, Command, Rows
from robodyn_cli.over.many.integrate import Batch, Driven, method_of
from robodyn_cli.over.many.keys import Key
from robodyn_cli.over.many.record import ManyRuns
from robodyn_cli.over.many.structure import Structure
from robodyn_cli.scene.load import Family
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array

SECOND_STEPS = "error_estimate.steps"
COUNTERS = ("counters.steps", "counters.rejected", "counters.evaluations")


class MotionCommand(Command[Structure]):
    """A command that integrates motions."""

    @abstractmethod
    def build(self, scene: Scene) -> Motion:
        """Return the motion of a scene; raises what the command raises for it."""

    def obstacle(self, motion: Motion) -> str:
        """Return why runs of a motion are made one by one, beside what holds for all commands; nothing if not."""
        return ""

    @abstractmethod
    def gives(self, key: str) -> bool:
        """Tell whether ``output`` gives this key of the summary."""

    @abstractmethod
    def drive(self, batch: Batch, method: str, samples: int) -> Driven:
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
        return key in (*COUNTERS, SECOND_STEPS) or self.gives(key)

    def with_samples(self, scene: Scene, samples: int) -> Scene:
        return dataclasses.replace(scene, simulate=dataclasses.replace(scene.simulate, samples=samples))

    def make(self, structure: Structure, rows: Rows, asked: Asked) -> list[int]:
        own_q, own_qd = (None if x is None else x[rows] for x in (asked.q, asked.qd))
        batch = Batch.of(structure, asked.result.values[rows], own_q, own_qd, asked.threads)
        found = method_of(batch)
        left: list[int] = []
        for method in dict.fromkeys(found.tolist()):
            chosen = np.flatnonzero(found == method)
            part = batch if len(chosen) == len(rows) else batch.part(chosen)
            driven = self.drive(part, method, max(0, asked.samples - 1))
            self._keep(part, driven, rows[chosen], asked)
            left += rows[chosen[~driven.trusted]].tolist()
        return left

    def _keep(self, batch: Batch, driven: Driven, rows: Rows, asked: Asked) -> None:
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
            column[to] = self._output(key, result, driven, to)
            result.errors[key][to] = self.error_of(key, result, to)
        if asked.samples:
            _keep_samples(batch, driven, to, asked)

    def _output(self, key: str, result: ManyRuns, driven: Driven, rows: Rows) -> Array:
        """Return an output of those runs that can be trusted, which are these rows."""
        section, _, name = key.partition(".")
        if section == "counters":
            found: Array = getattr(driven.runs, name)[driven.trusted]
            return found
        if key == SECOND_STEPS:
            if driven.second_steps is None:
                return np.full(len(rows), np.nan)
            steps = driven.second_steps[driven.trusted]
            return np.where(steps > 0, steps, np.nan)
        return self.output(key, result, rows)


def _keep_samples(batch: Batch, driven: Driven, rows: Rows, asked: Asked) -> None:
    samples, good = asked.result.samples, driven.trusted
    states = np.concatenate([batch.states[:, None], driven.runs.out.transpose(0, 2, 1)], axis=1)[good]
    share = np.arange(asked.samples) / max(asked.samples - 1, 1)
    samples["time"][rows] = batch.ends[good, None] * share
    samples["q"][rows], samples["qd"][rows], _ = batch.structure.motion.system.split(states)


def column_of(result: ManyRuns, group: str, name: str, rows: Rows) -> Array:
    """Return a position or a rate (``q``, ``theta1``) of rows, nan where there is none of that name."""
    names = result.q_names if group == "q" else result.qd_names
    if name not in names:
        return np.full(len(rows), np.nan)
    found: Array = getattr(result, group)[rows, names.index(name)]
    return found
