"""Follow the motion of a mechanism that its loops and the conditions on some joints or on a point determine.

At every sample F(q, t) = 0 is solved by Newton's method on one branch, then J v = c and J v-dot = b. F holds the rows
of the loops and of the conditions. J has full column rank where these determine the motion, even if some rows depend
on others.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from robodyn_cli.record import record
from robodyn_cli.solve.closure import Conditions
from robodyn_cli.spatial.algebra import Array

MISS = 0.08  # rad, or part of the mechanism's size, by which extrapolation may miss before the branch could change
SINGULAR = 1e-8  # smallest over largest singular value of J
SAME = 1e-9  # relative residual below which conditions agree
CLOSED = 1e-12  # rad, or part of the mechanism's size: a shorter step of Newton's method is the last one
ITERATIONS = 12
HALVINGS = 40


class MotionConditions(Conditions, Protocol):
    """Conditions along a motion: their names, and their rates."""

    names: tuple[str, ...]

    def rates(self, q: Array, v: Array, t: float) -> tuple[Array, Array]:
        """Return c and b (m,) of J v = c and J v-dot = b; b depends on v."""
        ...


@record
class GuidedPlace:
    """Position, rates and accelerations at one time, with J scaled to its rows' and coordinates' sizes."""

    t: float
    q: Array
    v: Array
    a: Array
    J: Array

    @property
    def measure(self) -> float:
        """Smallest over largest singular value of J."""
        s = np.linalg.svd(self.J, compute_uv=False)
        return float(s[-1] / s[0]) if len(s) == self.J.shape[1] else 0.0


class Stuck(Exception):
    """The motion cannot go on: the configuration is singular, or conditions contradict each other.

    last : the last place that was reached. time : of the step that failed [s]. row : the violated row and its
    residual; None at a singular configuration. weights : of rows and of coordinates in the direction in which J
    loses rank.
    """

    def __init__(
        self,
        last: GuidedPlace | None,
        time: float,
        row: tuple[str, float] | None,
        weights: tuple[Array, Array],
    ):
        super().__init__()
        self.last, self.time, self.row, self.weights = last, time, row, weights


class Guide:
    """Continuation of one mechanism along a motion."""

    def __init__(self, conditions: MotionConditions) -> None:
        self.conditions = conditions
        self.iterations = 0
        self.steps = 0
        self._h = np.inf

    def scaled(self, J: Array) -> Array:
        """Return J with rows and columns in comparable units."""
        out: Array = J * self.conditions.lengths / self.conditions.sizes[:, None]
        return out

    def solve(self, q: Array, t: float) -> tuple[Array, Array, float, float]:
        """Return q, J, the largest relative residual and the relative motion, by Newton's method from q."""
        moved = np.zeros(len(self.conditions.lengths))
        F, J = self.conditions.at(q, t)
        size = float(np.abs(F / self.conditions.sizes).max(initial=0.0))
        for _ in range(ITERATIONS):
            if not np.all(np.isfinite(J)) or not np.isfinite(size):
                return q, J, np.inf, np.inf
            self.iterations += 1
            step, *_ = np.linalg.lstsq(self.scaled(J), -F / self.conditions.sizes, rcond=None)
            if float(np.abs(moved + step).max(initial=0.0)) > 1.0:
                return q, J, size, np.inf
            trial = self.conditions.step(q, step * self.conditions.lengths)
            F_new, J_new = self.conditions.at(trial, t)
            new = float(np.abs(F_new / self.conditions.sizes).max(initial=0.0))
            if not new < size and size < SAME:
                break
            q, F, J, moved = trial, F_new, J_new, moved + step
            done = float(np.abs(step).max(initial=0.0)) < CLOSED
            size = new
            if done:
                break
        return q, J, size, float(np.abs(moved).max(initial=0.0))

    def place(self, q: Array, J: Array, t: float) -> GuidedPlace:
        """Return the place at a solution: rates, then accelerations."""
        c, b = self.conditions.rates(q, np.zeros(len(self.conditions.lengths)), t)
        v, *_ = np.linalg.lstsq(J, c, rcond=None)
        _, b = self.conditions.rates(q, v, t)
        a, *_ = np.linalg.lstsq(J, b, rcond=None)
        return GuidedPlace(t, q, v, a, self.scaled(J))

    def start(self, q: Array, t: float) -> GuidedPlace:
        """Return the place at the start, near q.

        Raises
        ------
        Stuck : the conditions cannot be met there, or J is singular.
        """
        q, J, residual, _ = self.solve(q, t)
        if not residual < SAME:
            raise self._stuck(None, q, J, t, residual)
        here = self.place(q, J, t)
        if not here.measure > SINGULAR:
            raise self._stuck(here, q, J, t, 0.0)
        return here

    def advance(self, now: GuidedPlace, end: float) -> GuidedPlace:
        """Return the place at time ``end``, in steps short enough to stay on the branch.

        Raises
        ------
        Stuck : the branch ends before.
        """
        whole = end - now.t
        h = min(whole, 2.0 * self._h)
        while True:
            last = now.t + 1.0000001 * h >= end
            t = end if last else now.t + h
            self.steps += 1
            reached = self._step(now, t)
            if reached is not None:
                self._h = t - now.t
                now = reached
                if last:
                    return now
                h = min(2.0 * self._h, end - now.t)
            elif t - now.t < whole * 0.5**HALVINGS or t - now.t < 1e-14 * max(1.0, abs(t)):
                q, J, residual, _ = self.solve(now.q, t)
                contradicted = residual > SAME and now.measure > 1e-5
                raise self._stuck(now, q if contradicted else now.q, J, t, residual if contradicted else 0.0)
            else:
                h = 0.5 * (t - now.t)

    def _step(self, now: GuidedPlace, t: float) -> GuidedPlace | None:
        h = t - now.t
        guess = self.conditions.step(now.q, h * now.v + 0.5 * h * h * now.a)
        q, J, residual, missed = self.solve(guess, t)
        if not residual < SAME or not missed < MISS:
            return None
        new = self.place(q, J, t)
        # branches meet where a singular value passes zero, which changes this sign
        sign, _ = np.linalg.slogdet(now.J.T @ new.J)
        if not sign > 0.0:
            return None
        if not new.measure > SINGULAR:
            return None
        return new

    def _stuck(self, last: GuidedPlace | None, q: Array, J: Array, t: float, residual: float) -> Stuck:
        U, _, Vt = np.linalg.svd(self.scaled(J) if last is None or residual else last.J)
        weights = np.abs(U[:, J.shape[1] - 1]) if U.shape[0] >= J.shape[1] else np.abs(U[:, -1])
        row = None
        if residual:
            F, _ = self.conditions.at(q, t)
            worst = int(np.abs(F / self.conditions.sizes).argmax())
            row = (self.conditions.names[worst], float(F[worst]))
        return Stuck(last, t, row, (weights, np.abs(Vt[-1])))
