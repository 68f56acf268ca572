"""Follow a path of targets by Newton's method on one branch, from sample to sample.

Each step extrapolates the motion by the quintic through the last two states, corrects onto the target, and is
halved where the extrapolation misses. A redundant chain's self-motion is integrated along with it: of

    q_1 = q_0 + h/2 (q-dot_0 + q-dot_1) + h^2/12 (q-ddot_0 - q-ddot_1)        (local error h^5 q^(5) / 720)

the part that leaves the point in place is added to the corrected positions.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from robodyn_cli.record import record
from robodyn_cli.solve.newton import SINGULAR, PointSolver, Solution
from robodyn_cli.solve.reach import Singular, Unreachable
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.motion import Asked, JointMotion, PointMotion, PoseMotion
from robodyn_cli.trajectories.quintic_spline import hermite

Target = Callable[[Array], "PointMotion | PoseMotion | Asked"]

MISS = 0.1  # largest error of the extrapolation, rad or m: beyond it the branch could change unnoticed
FIRST_MISS = 1e-5  # the same for the first step of a redundant chain, which has only one state to start from
SELF_MOTION_ERROR = 1e-10  # rad or m per step
HALVINGS = 18
LISTED = 200  # samples among which the worst target is sought


@record
class PathState:
    """Joint positions, their rates and accelerations (nq,) at one time; U (m, r) and V^T (r, nv) of the Jacobian."""

    t: float
    q: Array
    qd: Array
    qdd: Array
    U: Array
    Vt: Array

    def on_branch_of(self, other: PathState) -> bool:
        """Tell whether the Jacobian keeps its orientation; it turns where a singular value passes zero.

        Singular values are never negative, so on the way through zero U or V^T changes sign instead. That is
        how the branches of a chain without redundancy meet.
        """
        return bool(np.linalg.det(self.U.T @ other.U) * np.linalg.det(self.Vt @ other.Vt.T) > 0.0)


class PathFollower:
    """Continuation along one path."""

    def __init__(self, solver: PointSolver, target: Target, times: Array) -> None:
        self.solver = solver
        self.manifold = solver.manifold
        # columns of q that are positions of moving joints
        velocities = np.flatnonzero(solver.moving)
        self.moving = np.isin(
            np.arange(self.manifold.nq), [k for v in velocities for k in self.manifold.columns(int(v))]
        )
        self.target = target
        self.times = times
        self.steps = 0
        self.h = np.inf  # length of the last step
        at_samples = target(times)
        # position, rates and accelerations (T, k), (T, m), (T, m)
        self.at_samples = at_samples.values, at_samples.rates, at_samples.accelerations

    def run(self, start: Array) -> JointMotion:
        """Return the joint motion, at T times, from the solution nearest to ``start`` (nq,).

        Raises
        ------
        Unreachable, Singular : with times.
        """
        found = self.solver.solve(self.at_samples[0][0], start)
        if not self.reached(found.residual):
            # in a singular pose, such as a stretched arm, Newton's method may find no direction: leave it by one step
            nudge = 0.05 * np.cos(np.arange(self.manifold.nv)) * self.solver.moving
            found = self.solver.solve(self.at_samples[0][0], self.manifold.integrate(start, nudge))
        if not self.reached(found.residual):
            raise self.unreachable(0, found.q)
        q = np.empty((len(self.times), len(start)), order="F")
        q[0] = found.q
        now = self.state(self.times[0], found, self.sample(0))
        before: PathState | None = None
        for k in range(1, len(self.times)):
            before, now = self.advance(before, now, k)
            q[k] = now.q
        rates = self.solver.rates(q, *self.at_samples[1:])
        return JointMotion(q, np.asfortranarray(rates.qd), np.asfortranarray(rates.qdd))

    def reached(self, residual: float) -> bool:
        """Tell whether a target counts as reached."""
        return residual <= max(self.solver.tolerance, self.solver.floor)

    def sample(self, k: int) -> tuple[Array, Array, Array]:
        """Return values (k,), rates and accelerations (m,) asked at sample k."""
        values, rates, accelerations = self.at_samples
        return values[k], rates[k], accelerations[k]

    def between(self, t: float) -> tuple[Array, Array, Array]:
        """Return values (k,), rates and accelerations (m,) asked at any time."""
        target = self.target(np.array([t]))
        return target.values[0], target.rates[0], target.accelerations[0]

    def state(self, t: float, found: Solution, target: tuple[Array, Array, Array]) -> PathState:
        """Return the state at a solution for a target."""
        rates = self.solver.rates(found.q[None], target[1][None], target[2][None], found.J[None])
        if not rates.measure[0] > SINGULAR:
            raise self.singular(t, found.q)
        qd, qdd = self.manifold.rates(found.q, rates.qd[0], rates.qdd[0])
        return PathState(t, found.q, qd, qdd, rates.U[0], rates.Vt[0])

    def advance(self, before: PathState | None, now: PathState, k: int) -> tuple[PathState, PathState]:
        """Go on to sample k, in smaller steps where needed; return the last two states."""
        end = float(self.times[k])
        whole = end - now.t
        h = min(whole, 2.0 * self.h)
        while True:
            last = now.t + 1.5 * h > end
            t = end if last else now.t + h
            target = self.sample(k) if last else self.between(t)
            reached = self.step(before, now, t, target)
            if reached is not None:
                before, now = now, reached
                if last:
                    self.h = h
                    return before, now
                h = min(2.0 * h, whole)
            elif t - now.t < whole * 0.5**HALVINGS:
                raise self.failure(now, t, target[0], k)
            else:
                h = 0.5 * (t - now.t)

    def step(
        self, before: PathState | None, now: PathState, t: float, target: tuple[Array, Array, Array]
    ) -> PathState | None:
        """Return the state at time t, or None where the step is too long."""
        self.steps += 1
        h = t - now.t
        guess, error = extrapolate(before, now, h)
        # a joint that does not move the point is never corrected, so extrapolating it would amplify rounding
        guess = self.manifold.normalise(np.where(self.moving, guess, now.q))
        found = self.solver.solve(target[0], guess)
        if not self.reached(found.residual):
            return None
        miss = float(np.abs(found.q - guess).max())
        if not self.solver.redundant:
            if miss > MISS:
                return None
            new = self.state(t, found, target)
            return new if new.on_branch_of(now) else None
        if miss > (FIRST_MISS if error is None else MISS) or (
            error is not None and error > SELF_MOTION_ERROR
        ):
            return None
        new = self.state(t, found, target)
        integrated = now.q + 0.5 * h * (now.qd + new.qd) + h * h / 12.0 * (now.qdd - new.qdd)
        drift = self.manifold.difference(new.q, self.manifold.normalise(integrated))
        drift -= new.Vt.T @ (new.Vt @ drift)  # the part that would move the point
        return dataclasses.replace(new, q=self.manifold.integrate(new.q, drift))

    def failure(self, now: PathState, t: float, p: Array, k: int) -> Exception:
        """Return the error that says why the motion cannot go on from ``now`` to the target p (k,) at time t <= t_k."""
        here = self.solver.solve(p, now.q)
        # rates grow beyond bounds just before the limit of the reach, so look a few samples ahead as well
        for ahead in range(k, min(k + 3, len(self.times))):
            there = self.solver.solve(self.at_samples[0][ahead], here.q)
            if not self.reached(there.residual):
                return self.unreachable(ahead, here.q)
        if self.reached(here.residual):
            return self.singular(now.t, now.q)
        return Unreachable(t, here.residual, t, here.residual, nearest=False)

    def singular(self, t: float, q: Array) -> Singular:
        """Return the error of a singular pose at q (n,), with the joint that moves most where the target does not."""
        _, s, Vt = np.linalg.svd(self.solver.position(q)[1])
        last = self.solver.rank - 1
        return Singular(t, float(s[last] / s[0]), int(np.argmax(np.abs(Vt[last]))))

    def unreachable(self, first: int, q: Array) -> Unreachable:
        """Return the error with the distances by which some targets from sample ``first`` on are missed."""
        listed = np.unique(np.linspace(first, len(self.times) - 1, LISTED).round().astype(int))
        left = []
        for k in listed:
            found = self.solver.solve(self.at_samples[0][k], q)
            q = found.q
            left.append(found.residual)
        worst = int(np.argmax(left))
        return Unreachable(self.times[first], left[0], self.times[listed[worst]], left[worst], nearest=False)


def extrapolate(before: PathState | None, now: PathState, h: float) -> tuple[Array, float | None]:
    """Return the positions (n,) extrapolated by h, and the error of the self-motion's step (None: unknown).

    With two states: the quintic through both, whose fifth derivative gives the error h^5 q^(5) / 720.
    """
    if before is None or before.t == now.t or h > 4.0 * (now.t - before.t):
        return now.q + h * (now.qd + 0.5 * h * now.qdd), None
    span = now.t - before.t
    c = hermite(span, (before.q, before.qd, before.qdd), (now.q, now.qd, now.qdd))
    s = 1.0 + h / span
    guess = c[0] + s * (c[1] + s * (c[2] + s * (c[3] + s * (c[4] + s * c[5]))))
    return guess, float(np.abs(c[5]).max()) * (h / span) ** 5 / 6.0
