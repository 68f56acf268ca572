"""How the state at t = 0 changes with keys: given values change alone, what closes the loops follows from them.

    Psi dq + eta_k = 0,   Psi dv + d(Psi v + eta_t)/d(q, k) = 0

The solution is that of the assembly (``solve/assembly.py``) wherever this is unique near the start.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from robodyn_cli.errors import CapabilityError
from robodyn_cli.run.driver.motion import Motion
from robodyn_cli.run.driver.prepare import held_columns, initial_positions
from robodyn_cli.run.many.keys import START, Key
from robodyn_cli.run.sensitivity.motion.variational import Variational
from robodyn_cli.solve.assembly import RANK_TOLERANCE
from robodyn_cli.solve.closure import rank
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.led import position_columns, velocity_columns

STAYED = 1e-9  # of a given value: farther, the assembly has moved it to close the loops
CLOSES = 1e-8  # of the change of the constraints that a change of the state must take up


def start_slopes(motion: Motion, variational: Variational, keys: Sequence[Key]) -> Array:
    """Return dx/dk (nx, K) at t = 0, in the variational system's coordinates.

    Raises
    ------
    CapabilityError : the start does not depend smoothly on the keys, or the way that closes the loops decides about it.
    """
    model, system = motion.problem.model, variational.system
    given_q, given_v = (_given(names, group, keys)
                        for names, group in ((model.q_names, "q"), (model.v_names, "qd")))  # fmt: skip
    if motion.problem.constraints.rows:
        if system.layout is not None:
            raise CapabilityError("loops of joints with quaternions are closed by differences")
        return _Closed(motion, variational).slopes(given_q, given_v)
    S = np.zeros((system.size, len(keys)))
    S[list(system.q_places)], S[list(system.v_places)] = given_q, given_v
    if system.layout is not None and np.any(given_q):
        raise CapabilityError("positions of joints with quaternions are made of unit length")
    return S


def _given(names: Sequence[str], group: str, keys: Sequence[Key]) -> Array:
    """Return the derivatives of what is given of the start (n, K), by its own keys."""
    found = np.zeros((len(names), len(keys)))
    for k, key in enumerate(keys):
        if key.sort == START and key.place.startswith(f"{group}."):
            found[names.index(key.place.partition(".")[2]), k] = 1.0
    return found


class _Closed:
    """The closed start of a mechanism, whose joints have q-dot = v."""

    def __init__(self, motion: Motion, variational: Variational) -> None:
        self.motion, self.variational = motion, variational
        self.problem, self.start = motion.problem, motion.assembled
        self.rows = self.problem.all_constraints
        self.psi = self.problem.numbers(self.rows.psi(self.problem.model.nv), self.start.q)

    def slopes(self, given_q: Array, given_v: Array) -> Array:
        system, variational = self.variational.system, self.variational
        x = system.join(self.start.q, self.start.v)
        eta = variational.slopes(self.rows.eta, 0.0, x)
        dq = self._solved(given_q, eta.keys, self._unknown_positions())
        rate = variational.slopes(self.rows.velocity_residual(self.problem.v), 0.0, x)
        residual = rate.keys + rate.state[:, : system.nq] @ dq
        dv = self._solved(given_v, residual, self._unknown_rates())
        return np.concatenate([dq, dv])

    def _solved(self, given: Array, change: Array, unknown: Sequence[int]) -> Array:
        """Return the change (nv, K) of all coordinates: the given one, and what takes up the change of the rows."""
        found = given.copy()
        found[unknown] = 0.0
        right = change + self.psi @ found
        columns = self.psi[:, unknown]
        found[unknown] = -(np.linalg.pinv(columns, rcond=RANK_TOLERANCE) @ right)
        left = np.abs(right + columns @ found[unknown]).max(axis=0, initial=0.0)
        scale = np.abs(right).max(axis=0, initial=0.0)
        if np.any(left > CLOSES * np.maximum(scale, 1e-300)):
            raise CapabilityError("with another value of a key the loops do not close")
        return found

    def _unknown_positions(self) -> list[int]:
        """Return the coordinates that close the loops, where they do it in one way."""
        model, scene = self.problem.model, self.motion.scene
        led = set(position_columns(scene.prescribed))
        held = set(held_columns(scene, self.problem)) - led
        given = initial_positions(scene, self.problem)
        free = [k for k, name in enumerate(model.q_names) if name not in held]
        if self._is_unique(free):
            return free
        missing = [k for k, name in enumerate(model.q_names) if name not in given or name in led]
        moved = [
            abs(self.start.q[k] - given[name]) for k, name in enumerate(model.q_names) if k not in missing
        ]
        if max(moved, default=0.0) <= STAYED and missing and self._is_unique(missing):
            return missing
        raise CapabilityError("how the loops are closed at the start is a choice among many")

    def _unknown_rates(self) -> list[int]:
        """Return the coordinates whose rates follow from the others, where they do in one way or all is at rest."""
        model, scene = self.problem.model, self.motion.scene
        led = set(velocity_columns(scene.prescribed))
        given = set(scene.initial.qd)
        hold = set(held_columns(scene, self.problem))
        v = np.array([scene.initial.qd.get(name, 0.0) for name in model.v_names])
        for fixed in (given | (hold - led), given, set[str]()):
            unknown = [k for k, name in enumerate(model.v_names) if name not in fixed]
            kept = [k for k in range(model.nv) if k not in unknown]
            if np.any(np.abs(self.start.v[kept] - v[kept]) > STAYED * (1.0 + np.abs(v[kept]))):
                continue
            if self._is_unique(unknown) or not np.any(self.start.v):
                return unknown
        raise CapabilityError("how rates at the start are made to fit the loops is a choice among many")

    def _is_unique(self, unknown: Collection[int]) -> bool:
        """Tell whether the rows determine these coordinates."""
        columns = list(unknown)
        return bool(columns) and rank(self.psi[:, columns], RANK_TOLERANCE) == len(columns)
