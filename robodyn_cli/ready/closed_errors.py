"""How far closed loops may be off: what their residuals and rounding make of positions, rates and accelerations.

Each number and result of the loops' equations is changed by a random part of its rounding (see ``observe.rounding``),
and the state is solved again: J dq = -eta of positions, then rates and accelerations there, by the rules that made
them. The largest of a few changes, times ``SAFETY``, is the error. The changes are enlarged as there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np

from robodyn_cli.expr.graph import Expr, Scalar
from robodyn_cli.expr.many import ManyNumbers
from robodyn_cli.given.loop_conditions import LoopConditions
from robodyn_cli.observe.rounding import DRAWS, ENLARGED, Rounded
from robodyn_cli.solve.closing.rates import RatesByLoops
from robodyn_cli.spatial.algebra import Array

SAFETY = 4.0  # times the largest of a few draws


class ErrorsOfClosing:
    """Errors of closed configurations and states.

    Parameters
    ----------
    conditions : the loops and prescribed joints, at t = 0. cut : ratio of singular values below which a direction is
    left alone.
    """

    def __init__(self, conditions: LoopConditions, cut: float) -> None:
        self.conditions, self.cut = conditions, cut
        self._here, self._moving = conditions.entries()

    @cached_property
    def _of_values(self) -> Noise:
        return Noise(self._here[: len(self.conditions.names)])

    def of_positions(self, q: Array, free: Sequence[int]) -> Array:
        """Return the errors (nq,) of a configuration whose free velocity coordinates closed the loops."""
        F, J = self.conditions.at(q, 0.0)
        rounded = ENLARGED * F + self._of_values(_one(q, np.zeros(self.conditions.model.nv)))
        return _largest([self._moved(q, J, x, free) - q for x in rounded])

    def of_state(self, q: Array, v: Array, a: Array, rule: RatesByLoops) -> tuple[Array, Array, Array]:
        """Return the errors of q (nq,), and of v and v-dot (nv,), which follow by a rule and with least norm."""
        F, J = self.conditions.at(q, 0.0)
        m, nv = J.shape
        free = [k for k in range(nv) if k not in rule.hold]
        off: list[tuple[Array, Array, Array]] = []
        for x in Noise([*self._here, *self._moving])(_one(q, v)):
            eta, dJ, eta_t, gamma = np.split(x, np.cumsum([m, m * nv, m]))
            there = self._moved(q, J, ENLARGED * F + eta, free)
            J_there = self.conditions.at(there, 0.0)[1] + dJ.reshape(m, nv)
            rates, *_ = rule(J_there, eta_t - self.conditions.rates(there, v, 0.0)[0])
            b = self.conditions.rates(there, rates, 0.0)[1] - gamma
            accelerations, *_ = np.linalg.lstsq(J_there, b, rcond=self.cut)
            off.append((there - q, rates - v, accelerations - a))
        positions, rates, accelerations = map(_largest, zip(*off))
        return positions, rates, accelerations

    def _moved(self, q: Array, J: Array, F: Array, free: Sequence[int]) -> Array:
        """Return the configuration a step towards F = 0 away."""
        dq = np.zeros(J.shape[1])
        dq[free], *_ = np.linalg.lstsq(J[:, free], -F, rcond=self.cut)
        return self.conditions.step(q, dq)


class Noise:
    """What rounding changes of expressions, enlarged: (draw, n) at one state, (run, draw, n) at those of runs."""

    def __init__(self, outputs: Sequence[Scalar]) -> None:
        self._varying = [k for k, x in enumerate(outputs) if isinstance(x, Expr)]
        self._count, self._rounded = len(outputs), Rounded([outputs[k] for k in self._varying])

    def __call__(self, inputs: Mapping[str, Array], runs: ManyNumbers | None = None) -> Array:
        """Return it at inputs of one sample by group, see ``Rounded``."""
        if not self._varying:
            many = next(iter(inputs.values())).shape[:-2]
            return np.zeros((*many, DRAWS, self._count))
        drawn = self._rounded(inputs, runs)[..., 0, :]
        changes = drawn[..., 1:, :] - drawn[..., :1, :]
        noise = np.zeros((*changes.shape[:-1], self._count))
        noise[..., self._varying] = changes
        return noise


def _one(q: Array, v: Array) -> dict[str, Array]:
    return {"t": np.zeros((1, 1)), "q": q[None], "v": v[None]}


def _largest(changes: Sequence[Array]) -> Array:
    return SAFETY / ENLARGED * np.max(np.abs(changes), axis=0)
