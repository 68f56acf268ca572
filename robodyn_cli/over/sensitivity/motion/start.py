"""How the state of a motion at t = 0 changes with keys."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError
from robodyn_cli.motion.motion import Motion
from robodyn_cli.over.many.keys import START, Key
from robodyn_cli.over.sensitivity.motion.variational import (
    Variational,
)
from robodyn_cli.ready.prepare import held_columns, initial_positions
from robodyn_cli.solve.closure import rank
from robodyn_cli.solve.independent_rows import RANK_TOLERANCE
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
    given_q, given_v = (given_slopes(names, group, keys)
                        for names, group in ((model.q_names, "q"), (model.v_names, "qd")))  # fmt: skip
    if motion.problem.constraints.rows:
        if system.layout is not None:
            raise CapabilityError("loops of joints with quaternions are closed by differences")
        return _closed(motion, variational, given_q, given_v)
    S = np.zeros((system.size, len(keys)))
    S[list(system.q_places)], S[list(system.v_places)] = given_q, given_v
    if system.layout is not None and np.any(given_q):
        raise CapabilityError("positions of joints with quaternions are made of unit length")
    return S


def _closed(motion: Motion, variational: Variational, given_q: Array, given_v: Array) -> Array:
    """Return dx/dk (nx, K) at a start with closed loops."""
    problem, start, system = motion.problem, motion.assembled, variational.system
    closing = Closing(problem, start.q, start.v)
    x = system.join(start.q, start.v)
    dq = closing.positions(given_q, variational.slopes(closing.rows.eta, 0.0, x).keys)
    rate = variational.slopes(closing.rows.velocity_residual(problem.v), 0.0, x)
    dv = closing.rates(given_v, rate.keys + rate.state[:, : system.nq] @ dq)
    return np.concatenate([dq, dv, np.zeros((system.size - 2 * system.nq, dq.shape[1]))])


def given_slopes(names: Sequence[str], group: str, keys: Sequence[Key]) -> Array:
    """Return the derivatives of what is given of the start (n, K), by its own keys."""
    slopes = np.zeros((len(names), len(keys)))
    for k, key in enumerate(keys):
        if key.sort == START and key.place.startswith(f"{group}."):
            slopes[names.index(key.place.partition(".")[2]), k] = 1.0
    return slopes


class Closing:
    """How a closed state q, v (nv,) of a mechanism whose joints have q-dot = v follows from what is given of it."""

    def __init__(self, problem: Problem, q: Array, v: Array) -> None:
        self.problem, self.scene, self.q, self.v = problem, problem.scene, q, v
        self.rows = problem.all_constraints
        self.psi = problem.numbers(self.rows.psi(problem.model.nv), q)

    def positions(self, given: Array, eta_change: Array) -> Array:
        """Return dq (nv, K) from the changes of what is given of it, and those of eta (m, K) with the keys alone."""
        return self._solved(given, eta_change, self._unknown_positions())

    def rates(self, given: Array, change: Array) -> Array:
        """Return dv (nv, K); ``change`` : of Psi v + eta_t (m, K) with keys and positions."""
        return self._solved(given, change, self._unknown_rates())

    def _solved(self, given: Array, change: Array, unknown: Sequence[int]) -> Array:
        """Return the change (nv, K) of all coordinates: the given one, and what takes up the change of the rows."""
        solved = given.copy()
        solved[unknown] = 0.0
        right = change + self.psi @ solved
        columns = self.psi[:, unknown]
        solved[unknown] = -(np.linalg.pinv(columns, rcond=RANK_TOLERANCE) @ right)
        left = np.abs(right + columns @ solved[unknown]).max(axis=0, initial=0.0)
        scale = np.abs(right).max(axis=0, initial=0.0)
        if np.any(left > CLOSES * np.maximum(scale, 1e-300)):
            raise CapabilityError("with another value of a key the loops do not close")
        return solved

    def _unknown_positions(self) -> list[int]:
        """Return the coordinates that close the loops, where they do it in one way."""
        model, scene = self.problem.model, self.scene
        led = set(position_columns(scene.prescribed))
        held = set(held_columns(scene, self.problem)) - led
        given = initial_positions(scene, self.problem)
        free = [k for k, name in enumerate(model.q_names) if name not in held]
        if self._is_unique(free):
            return free
        missing = [k for k, name in enumerate(model.q_names) if name not in given or name in led]
        moved = [abs(self.q[k] - given[name]) for k, name in enumerate(model.q_names) if k not in missing]
        if max(moved, default=0.0) <= STAYED and missing and self._is_unique(missing):
            return missing
        raise CapabilityError(
            "nothing decides which coordinates close the loops; hold the others (initial.hold)"
        )

    def _unknown_rates(self) -> list[int]:
        """Return the coordinates whose rates follow from the others, where they do in one way or all is at rest."""
        model, scene = self.problem.model, self.scene
        led = set(velocity_columns(scene.prescribed))
        given = set(scene.initial.qd)
        hold = set(held_columns(scene, self.problem))
        v = np.array([scene.initial.qd.get(name, 0.0) for name in model.v_names])
        for fixed in (given | (hold - led), given, set[str]()):
            unknown = [k for k, name in enumerate(model.v_names) if name not in fixed]
            kept = [k for k in range(model.nv) if k not in unknown]
            if np.any(np.abs(self.v[kept] - v[kept]) > STAYED * (1.0 + np.abs(v[kept]))):
                continue
            if self._is_unique(unknown) or not np.any(self.v):
                return unknown
        raise CapabilityError(
            "nothing decides which rates follow from the loops at the start; give the others (initial.qd)"
        )

    def _is_unique(self, unknown: Collection[int]) -> bool:
        """Tell whether the rows determine these coordinates."""
        columns = list(unknown)
        return bool(columns) and rank(self.psi[:, columns], RANK_TOLERANCE) == len(columns)
