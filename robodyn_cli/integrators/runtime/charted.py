"""The parameters p of a run: those the caller gives, and those the chart of the system chooses along the motion."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.formulations.system import System

Array = NDArray[Any]


class Parameters:
    """p of one run, written in place.

    given : values for all parameters that the chart does not choose. renewals : how often it has chosen anew.

    Raises
    ------
    ValueError : too few, or too many for the chart, are given.
    """

    def __init__(self, system: System, given: Any) -> None:
        self.chart = chart = system.chart
        self.system = system
        self.renewals = 0
        programs = (system.positions, system.velocities, system.switching)
        needed = max([system.dynamics.parameters, *(p.inputs.get("p", 0) for p in programs if p is not None)])
        room = len(given) if chart is None else chart.first + chart.count
        if room < needed or (chart is not None and len(given) != chart.first):
            raise ValueError(f"the system has {needed} parameters, got {len(given)}")
        self.values = np.zeros(max(1, room))
        self.values[: len(given)] = given

    def start(self, time: float, state: Array) -> None:
        """Let the chart choose for a run from ``state``."""
        self._choose(time, state, None)

    def renew(self, time: float, state: Array) -> None:
        """Let the chart choose anew; the motion goes on as it was."""
        self.renewals += 1
        assert self.chart is not None
        self._choose(time, state, self.values[self.chart.first :].copy())

    def _choose(self, time: float, state: Array, before: Array | None) -> None:
        if self.chart is not None:
            self.values[self.chart.first :] = self.chart.choose(time, self.system.split(state)[0], before)
