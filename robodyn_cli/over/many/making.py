"""Rows of runs by one command: groups of one structure, compiled code where it does, else scene by scene."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from robodyn_cli.over.many.command import Asked, Command, Rows
from robodyn_cli.over.many.groups import Structures
from robodyn_cli.over.many.keys import settings
from robodyn_cli.over.many.record import ManyRuns
from robodyn_cli.over.many.single import ended, error_of, number_of
from robodyn_cli.scene.types import Scene


class Making:
    """Makes rows of runs of one mechanism.

    Parameters
    ----------
    command : what the runs do.
    """

    def __init__(self, command: Command[Any], structures: Structures, asked: Asked) -> None:
        self.command, self.structures, self.asked = command, structures, asked

    @property
    def result(self) -> ManyRuns:
        """The rows."""
        return self.asked.result

    def compiled(self, rows: Rows) -> Rows:
        """Make these rows in compiled code; return those that are left to be made one by one."""
        plain = all(self.command.is_plain(key) for key in self.result.outputs)
        left: list[int] = []
        for structure, group in self.structures.groups(self.result.values[rows]):
            here = rows[group]
            if structure is None or structure.obstacle or not plain:
                left += here.tolist()
            else:
                left += self.command.make(structure, here, self.asked)
        return np.array(sorted(left), dtype=np.int64)

    def one_by_one(self, rows: Rows) -> None:
        """Make these rows as the command does."""
        for row in rows.tolist():
            self._alone(row)

    def _alone(self, row: int) -> None:
        """Make one run as the command does."""
        result = self.result
        result.one_by_one[row] = True
        found = ended(lambda: self.command.single(self._scene(row)))
        result.code[row], result.reason[row] = found.code, found.reason
        if found.result is None:
            return
        summary, own = found.summary, found.result
        for key, column in result.outputs.items():
            column[row], result.errors[key][row] = number_of(summary, key), error_of(summary, key)
        if self.asked.samples and len(own.time) == self.asked.samples:
            result.samples["time"][row] = own.time
            for name in self.command.sampled:
                result.samples[name][row] = own[name]
        self.command.read(summary, result, row)

    def _scene(self, row: int) -> Scene:
        """Return the scene of one run."""
        result, structures = self.result, self.structures
        scene = structures.family.scene(settings(result.keys, result.values[row]))
        initial, q, qd = scene.initial, self.asked.q, self.asked.qd
        if q is not None:
            initial = dataclasses.replace(initial, q=dict(zip(result.q_names, q[row].tolist())))
        if qd is not None:
            initial = dataclasses.replace(initial, qd=dict(zip(result.qd_names, qd[row].tolist())))
        if self.asked.samples:
            scene = self.command.with_samples(scene, self.asked.samples)
        return dataclasses.replace(scene, initial=initial)
