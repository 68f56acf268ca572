"""Rows of runs by one command: groups of one structure, compiled code where it does, else scene by scene."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.errors import RobodynError
from robodyn_cli.exit_codes import INTERNAL
from robodyn_cli.results.result import Result
from robodyn_cli.run.many.command import Command
from robodyn_cli.run.many.integrate import Batch, Driven, method_of
from robodyn_cli.run.many.keys import settings
from robodyn_cli.run.many.record import ManyRuns
from robodyn_cli.run.many.single import error_of, number_of, reason_of, summary_of
from robodyn_cli.run.many.structure import Structure, Structures
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array

Rows = NDArray[np.int64]
SECOND_STEPS = "error_estimate.steps"
COUNTERS = ("counters.steps", "counters.rejected", "counters.evaluations")


class Making:
    """Makes rows of runs of one mechanism.

    Parameters
    ----------
    command : what the runs do. result : takes the rows; its outputs are the keys that are wanted. samples : at how many
    uniform times, from the start to the end, states are wanted. threads : that make runs.
    """

    def __init__(
        self, command: Command, structures: Structures, result: ManyRuns, samples: int, threads: int
    ) -> None:
        self.command, self.structures, self.result = command, structures, result
        self.samples, self.threads = samples, threads

    def compiled(self, rows: Rows, q: Array | None, qd: Array | None) -> Rows:
        """Make these rows in compiled code; return those that are left to be made one by one.

        q, qd : initial states (N, nq), (N, nv) in place of the scene's.
        """
        plain = all(is_plain(self.command, key) for key in self.result.outputs)
        left: list[int] = []
        for structure, group in self.structures.groups(self.result.values[rows]):
            here = rows[group]
            if structure is None or structure.obstacle or not plain:
                left += here.tolist()
            else:
                left += self._compiled(structure, here, q, qd)
        return np.array(sorted(left), dtype=np.int64)

    def one_by_one(self, rows: Rows, q: Array | None, qd: Array | None) -> None:
        """Make these rows as the command does."""
        for row in rows.tolist():
            self._alone(row, q, qd)

    def _compiled(self, structure: Structure, rows: Rows, q: Array | None, qd: Array | None) -> list[int]:
        """Make runs of one structure; return those that are left to be made one by one."""
        own_q, own_qd = (None if x is None else x[rows] for x in (q, qd))
        batch = Batch.of(structure, self.result.values[rows], own_q, own_qd, self.threads)
        found = method_of(batch)
        left: list[int] = []
        for method in dict.fromkeys(found.tolist()):
            chosen = np.flatnonzero(found == method)
            part = batch if len(chosen) == len(rows) else batch.part(chosen)
            driven = self.command.drive(part, method, max(0, self.samples - 1))
            self._keep(structure, part, driven, rows[chosen])
            left += rows[chosen[~driven.trusted]].tolist()
        return left

    def _keep(self, structure: Structure, batch: Batch, driven: Driven, rows: Rows) -> None:
        """Write those runs of a batch that can be trusted into the result."""
        result, system, good = self.result, structure.motion.system, driven.trusted
        runs, to = driven.runs, rows[driven.trusted]
        result.code[to], result.time[to], result.steps[to] = 0, runs.time[good], runs.steps[good]
        result.time_error[to] = driven.time_errors[good]
        result.q[to], result.qd[to], _ = system.split(runs.y[good])
        result.q_error[to], result.qd_error[to], _ = system.split(driven.errors[good])
        for key, column in result.outputs.items():
            column[to] = self._output(key, driven, to)
            result.errors[key][to] = self.command.error_of(key, result, to)
        if self.samples:
            self._keep_samples(system, batch, driven, to)

    def _output(self, key: str, driven: Driven, rows: Rows) -> Array:
        """Return an output of those runs that can be trusted, which are these rows."""
        section, _, name = key.partition(".")
        if section == "counters":
            found: Array = getattr(driven.runs, name)[driven.trusted]
            return found
        if key == SECOND_STEPS:
            return driven.second_steps[driven.trusted]
        return self.command.output(key, self.result, rows)

    def _keep_samples(self, system: Any, batch: Batch, driven: Driven, rows: Rows) -> None:
        samples, good = self.result.samples, driven.trusted
        states = np.concatenate([batch.states[:, None], driven.runs.out.transpose(0, 2, 1)], axis=1)[good]
        share = np.arange(self.samples) / max(self.samples - 1, 1)
        samples["time"][rows] = batch.ends[good, None] * share
        samples["q"][rows], samples["qd"][rows], _ = system.split(states)

    # -- one by one -------------------------------------------------------------------------------------
    def _alone(self, row: int, q: Array | None, qd: Array | None) -> None:
        """Make one run as the command does."""
        result = self.result
        result.one_by_one[row] = True
        try:
            summary, code, found = self._summary(row, q, qd)
        except RobodynError as refusal:
            result.code[row], result.reason[row] = refusal.exit_code, refusal.message
            return
        except Exception as fault:  # of the program, in one run: the others stay as they are
            result.code[row], result.reason[row] = INTERNAL, f"{type(fault).__name__}: {fault}"
            return
        result.code[row], result.reason[row] = code, reason_of(summary, code)
        self.command.read(summary, result, row)
        for key, column in result.outputs.items():
            column[row], result.errors[key][row] = number_of(summary, key), error_of(summary, key)
        if self.samples and len(found.time) == self.samples:
            result.samples["time"][row] = found.time
            result.samples["q"][row], result.samples["qd"][row] = found["q"], found["qd"]

    def _summary(self, row: int, q: Array | None, qd: Array | None) -> tuple[dict[str, Any], int, Result]:
        scene = self._scene(row, q, qd)
        return summary_of(lambda: self.command.single(scene))

    def _scene(self, row: int, q: Array | None, qd: Array | None) -> Scene:
        """Return the scene of one run."""
        result, structures = self.result, self.structures
        scene = structures.family.scene(settings(result.keys, result.values[row]))
        initial, simulate = scene.initial, scene.simulate
        if q is not None:
            initial = dataclasses.replace(initial, q=dict(zip(result.q_names, q[row].tolist())))
        if qd is not None:
            initial = dataclasses.replace(initial, qd=dict(zip(result.qd_names, qd[row].tolist())))
        if self.samples:
            simulate = dataclasses.replace(simulate, samples=self.samples)
        return dataclasses.replace(scene, initial=initial, simulate=simulate)


def is_plain(command: Command, key: str) -> bool:
    """Tell whether compiled code gives this key of the summary."""
    return key in (*COUNTERS, SECOND_STEPS) or command.is_plain(key)
