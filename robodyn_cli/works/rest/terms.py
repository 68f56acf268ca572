"""The terms of configurations at rest: residuals and forces, and what rounding changes of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Protocol

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.expr.many import ManyNumbers
from robodyn_cli.given.loop_conditions import LoopConditions
from robodyn_cli.observe.rounding import ENLARGED, UNIT, more_changes
from robodyn_cli.ready.closed_errors import Noise
from robodyn_cli.record import record
from robodyn_cli.solve.closing.balance import ManyAtRest, OneAtRest
from robodyn_cli.spatial.algebra import Array

SOLVED = 8.0  # units of rounding of the largest force of loops that the solution of equations for them leaves


@record
class ForcesAtRest:
    """Residuals F (..., m) of loops and of what stays, J (..., m, nv), and the forces at rest (..., nv): ``load`` that
    constraints or actuators must give, ``tau`` of the scene's actuators. Or what rounding changes of these, and of the
    stiffness K (..., nv, nv)."""

    F: Array
    J: Array
    load: Array
    tau: Array
    K: Array | float = 0.0

    def part(self, k: int, parts: Array) -> ForcesAtRest:
        """Return parts (R,) of the k-th of changes (R, draw, ...)."""

        def one(x: Array) -> Array:
            return np.asarray(x[:, k] * parts.reshape(-1, *[1] * (x.ndim - 2)))

        return ForcesAtRest(one(self.F), one(self.J), one(self.load), one(self.tau), one(np.asarray(self.K)))

    def solved(self, J: Array, lam: Array) -> ForcesAtRest:
        """Return changes with what solving J^T lambda = r for multipliers (R, m), J (R, m, nv), adds to those of r."""
        carried = (np.swapaxes(np.abs(J), 1, 2) @ np.abs(lam)[..., None])[..., 0]
        largest = np.where(carried > 0.0, carried.max(axis=1, initial=0.0, keepdims=True), 0.0)
        noise = more_changes(self.load.shape[2])
        return dataclasses.replace(self, load=self.load + ENLARGED * UNIT * SOLVED * noise * largest[:, None])

    def __add__(self, other: ForcesAtRest) -> ForcesAtRest:
        tau, K = self.tau + other.tau, self.K + other.K
        return ForcesAtRest(self.F + other.F, self.J + other.J, self.load + other.load, tau, K)


class NearRest(ManyAtRest, Protocol):
    """R runs at rest, with their terms and the rounding of these."""

    def step(self, q: Array, dq: Array) -> Array:
        """Return positions (R, nq) moved by dq (R, nv)."""
        ...

    def terms(self, q: Array) -> ForcesAtRest:
        """Return the terms at q (R, nq)."""
        ...

    def rounding(self, q: Array, lam: Array) -> ForcesAtRest:
        """Return what rounding changes of the terms (R, draw, ...) with multipliers lam (R, m), enlarged."""
        ...


@record
class RestTerms:
    """The terms of some conditions as expressions: load and tau (nv,), and slopes, which are K column by column, none
    where it does not matter. p : parameters of load and slopes, and of tau."""

    conditions: LoopConditions
    load: Sequence[Scalar]
    tau: Sequence[Scalar]
    slopes: Sequence[Scalar]
    p: tuple[Sequence[float], Sequence[float]]

    @cached_property
    def _noises(self) -> tuple[Noise, Noise]:
        return Noise([*self.conditions.entries()[0], *self.load, *self.slopes]), Noise(self.tau)

    def rounding(self, q: Array, lam: Array, numbers: ManyNumbers | None = None) -> ForcesAtRest:
        """Return what rounding changes of them (R, draw, ...) at q (R, nq) and multipliers lam (R, m), enlarged."""
        nv, m = self.conditions.model.nv, len(self.conditions.names)
        values = m - self.conditions.led  # led joints are where they are
        forces, tau = (
            noise(_still(q, nv) | {"lam": lam[:, None], "p": np.tile(own, (len(q), 1, 1))}, numbers)
            for noise, own in zip(self._noises, self.p)
        )
        F, J, load, slopes = np.split(forces, np.cumsum([values, m * nv, nv]), axis=2)
        led = np.zeros((*F.shape[:2], m - values))
        K = np.swapaxes(slopes.reshape(*F.shape[:2], nv if slopes.size else 0, nv), 2, 3)
        return ForcesAtRest(np.concatenate([F, led], axis=2), J.reshape(*F.shape[:2], m, nv), load, tau, K)


@record
class SingleRest(OneAtRest):
    """A single run (see ``NearRest``)."""

    problem: Problem
    expressions: RestTerms

    def step(self, q: Array, dq: Array) -> Array:
        return self.conditions.step(q[0], dq[0])[None]

    def terms(self, q: Array) -> ForcesAtRest:
        F, J = self.conditions.at(q[0], 0.0)
        own = self.expressions
        tau = self.problem.numbers(list(own.tau), q[0], p=np.array(own.p[1]))
        return ForcesAtRest(F[None], J[None], self.load(q), tau[None])

    def rounding(self, q: Array, lam: Array) -> ForcesAtRest:
        return self.expressions.rounding(q, lam)


class RoundedLoads:
    """What rounding changes of the loads of joints and closures. entries : as expressions, by path."""

    def __init__(self, entries: Mapping[str, Sequence[Scalar]]) -> None:
        self._paths, self._cuts = list(entries), np.cumsum([len(x) for x in entries.values()])[:-1]
        self._noise = Noise([x for own in entries.values() for x in own])

    def __call__(
        self, q: Array, lam: Array, nv: int, numbers: ManyNumbers | None = None
    ) -> list[dict[str, Array]]:
        """Return it for each run at q (R, nq) and multipliers of all rows (R, m): (draw, n) by path, enlarged."""
        noise = self._noise(_still(q, nv) | {"lam": lam[:, None], "p": np.zeros((len(q), 1, 0))}, numbers)
        return [dict(zip(self._paths, np.split(own, self._cuts, axis=1))) for own in noise]


def _still(q: Array, nv: int) -> dict[str, Array]:
    """Return q (R, nq) at rest as inputs of one sample by group."""
    still = np.zeros((len(q), 1, nv))
    return {"q": q[:, None], "v": still, "a": still, "t": np.zeros((len(q), 1, 1))}
