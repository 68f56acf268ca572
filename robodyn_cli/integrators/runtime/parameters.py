"""The parameters p of a run: those the caller gives, and those the system's partition chooses along the motion."""

from __future__ import annotations

from typing import Any

import numpy as np

from robodyn_cli.formulations.system import System
from robodyn_cli.spatial.algebra import Array


class Parameters:
    """p of one run, written in place.

    given : values for all parameters that the partition does not choose. repartitions : how often it has chosen anew.

    Raises
    ------
    ValueError : too few, or too many for the partition, are given.
    """

    def __init__(self, system: System, given: Any) -> None:
        self.partition = partition = system.partition
        self.system = system
        self.repartitions = 0
        programs = (system.positions, system.velocities, system.switching)
        needed = max([system.dynamics.parameters, *(p.inputs.get("p", 0) for p in programs if p is not None)])
        room = len(given) if partition is None else partition.first + partition.count
        if room < needed or (partition is not None and len(given) != partition.first):
            raise ValueError(f"the system has {needed} parameters, got {len(given)}")
        self.values = np.zeros(max(1, room))
        self.values[: len(given)] = given

    def start(self, time: float, state: Array) -> None:
        """Let the partition choose for a run from ``state``."""
        self._choose(time, state, None)

    def repartition(self, time: float, state: Array) -> None:
        """Let the partition choose anew; the motion goes on as it was."""
        self.repartitions += 1
        assert self.partition is not None
        self._choose(time, state, self.values[self.partition.first :].copy())

    def _choose(self, time: float, state: Array, before: Array | None) -> None:
        if self.partition is not None:
            chosen = self.partition.choose(time, self.system.split(state)[0], before)
            self.values[self.partition.first :] = chosen
