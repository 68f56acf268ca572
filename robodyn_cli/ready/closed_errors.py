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
from robodyn_cli.record import record
from robodyn_cli.solve.closing.rates import RatesByLoops
from robodyn_cli.spatial.algebra import Array

SAFETY = 4.0  # times the largest of a few draws


@record
class OffClosed:
    """Errors of a closed configuration q (nq,), of rates v and accelerations a (nv,), and of entries of J (m, nv).

    beside : what rounding makes of the configuration, enlarged: q (draw, nq) and J (draw, m, nv).
    """

    q: Array
    v: Array
    a: Array
    J: Array
    beside: tuple[Array, Array]


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
        return largest_of([self._moved(q, J, x, free) - q for x in rounded])

    def of_configuration(self, q: Array, free: Sequence[int]) -> OffClosed:
        """Return the errors of a configuration whose free velocity coordinates closed the loops, at rest."""
        F, J = self.conditions.at(q, 0.0)
        still = np.zeros(J.shape[1])
        noise = Noise(self._here)(_one(q, still))
        off = [self._beside(q, (F, J), x, free) for x in noise]
        return _found((q, J), [(there, still, still, J_there) for there, J_there in off])

    def of_state(self, q: Array, v: Array, a: Array, rule: RatesByLoops) -> OffClosed:
        """Return the errors of q (nq,), and of v and v-dot (nv,), which follow by a rule and with least norm."""
        F, J = self.conditions.at(q, 0.0)
        m, nv = J.shape
        free = [k for k in range(nv) if k not in rule.hold]
        off: list[tuple[Array, ...]] = []
        for x in Noise([*self._here, *self._moving])(_one(q, v)):
            here, eta_t, gamma = np.split(x, np.cumsum([m + m * nv, m]))
            there, J_there = self._beside(q, (F, J), here, free)
            rates, *_ = rule(J_there, eta_t - self.conditions.rates(there, v, 0.0)[0])
            b = self.conditions.rates(there, rates, 0.0)[1] - gamma
            accelerations, *_ = np.linalg.lstsq(J_there, b, rcond=self.cut)
            off.append((there, rates - v, accelerations - a, J_there))
        return _found((q, J), off)

    def _beside(
        self, q: Array, here: tuple[Array, Array], noise: Array, free: Sequence[int]
    ) -> tuple[Array, Array]:
        """Return a configuration that rounding makes of q (nq,) with its F and J, and J there."""
        F, J = here
        there = self._moved(q, J, ENLARGED * F + noise[: len(F)], free)
        return there, self.conditions.at(there, 0.0)[1] + noise[len(F) :].reshape(J.shape)

    def _moved(self, q: Array, J: Array, F: Array, free: Sequence[int]) -> Array:
        """Return the configuration a step towards F = 0 away."""
        dq = np.zeros(J.shape[1])
        dq[free], *_ = np.linalg.lstsq(J[:, free], -F, rcond=self.cut)
        return self.conditions.step(q, dq)


def _found(here: tuple[Array, Array], off: Sequence[tuple[Array, ...]]) -> OffClosed:
    """Return the errors of q and J, from changes of rates and accelerations and from q and J beside."""
    q, dv, da, J = (np.array(x) for x in zip(*off))
    positions, rates, accelerations, rows = map(largest_of, (q - here[0], dv, da, J - here[1]))
    return OffClosed(positions, rates, accelerations, rows, (q, J))


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


def largest_of(changes: Array | Sequence[Array]) -> Array:
    """Return the error that enlarged changes, one after another, make."""
    return SAFETY / ENLARGED * np.max(np.abs(changes), axis=0)
