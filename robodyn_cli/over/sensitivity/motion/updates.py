"""How sensitivities go over the updates of a sampled controller, z+ = u(t, q, v, z-, k) at known instants:

S_z+ = u_x S- + u_k,   S_q and S_v as they are
"""

from __future__ import annotations

from typing import Any

import numpy as np

from robodyn_cli.equations.control.control import NOISE
from robodyn_cli.motion.motion import Motion
from robodyn_cli.over.sensitivity.motion.course import further_places
from robodyn_cli.over.sensitivity.motion.variational import StatePoint, Variational
from robodyn_cli.spatial.algebra import Array


class Updated:
    """The updates of a motion's controller; none where it has no sampled one."""

    def __init__(self, motion: Motion, variational: Variational) -> None:
        self.motion, self.variational = motion, variational
        control: Any = motion.problem.control
        self.control = control
        self.updates = variational.system.updates
        self.places = list(further_places(variational.system))
        layout = variational.system.layout
        phases = [] if self.updates is None else control.phases
        self.phases = [phase if layout is None else layout.renamed(phase) for phase in phases]

    def over(self, update: tuple[int, int], before: StatePoint) -> Array:
        """Return S (nx, K) behind an update, named by its number and phase."""
        number, phase = update
        return self._set(phase, number, before.t, before.x, before.S)

    def begun(self, S: Array) -> Array:
        """Return S at t = 0 with the states of a controller, which the first update sets."""
        if self.updates is None:
            return S
        system, control = self.variational.system, self.control
        q, v = self.motion.assembled.q, self.motion.assembled.v
        z = control.before_start(q, v, self.motion.system.parameters_at(0.0, q), self.updates.noise[0])
        S = S.copy()
        if control.last:  # what was measured last is where the joints are
            S[np.array(self.places)[control.last]] = S[list(system.q_places)]
        return self._set(0, 0, 0.0, system.join(q, v, z), S)

    def _set(self, phase: int, number: int, t: float, x: Array, S: Array) -> Array:
        assert self.updates is not None
        noise = self.updates.noise[min(number, len(self.updates.noise) - 1)]
        at = self.variational.slopes(self.phases[phase], t, x, **{NOISE: noise})
        found = S.copy()
        found[self.places] = at.state @ S + at.keys
        return found
