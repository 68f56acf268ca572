"""A path of targets, followed on one branch: continuation by Newton's method.

Along a path each step extrapolates the motion by the quintic through the last two states, corrects onto the target, and
is halved where the extrapolation misses. A redundant chain's self-motion is integrated along with it: of

    q_1 = q_0 + h/2 (q-dot_0 + q-dot_1) + h^2/12 (q-ddot_0 - q-ddot_1)        (local error h^5 q^(5) / 720)

the part that leaves the point in place is added to the corrected positions.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.record import record
from robodyn_cli.solve.newton import MOST_STEP, PointSolver, Rates, Solution, apply
from robodyn_cli.solve.reach import Singular, Unreachable
from robodyn_cli.solve.sparse import FEWEST, NEAR, Strides, counted, interpolated, together
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.course import hermite
from robodyn_cli.trajectories.motion import Asked, JointMotion, PointMotion, PoseMotion

SINGULAR = 1e-8  # smallest over largest singular value
Target = Callable[[Array], "PointMotion | PoseMotion | Asked"]

MISS = 0.1  # largest error of the extrapolation, rad or m: beyond it the branch could change unnoticed
FIRST_MISS = 1e-5  # the same for the first step of a redundant chain, which has only one state to start from
SELF_MOTION_ERROR = 1e-10  # rad or m per step
HALVINGS = 24
AHEAD = 9  # times up to the next sample at which a target may be out of reach
LISTED = 65  # times among which the worst target is sought


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
        self.h = np.inf  # a length of step that was enough
        at_samples = target(times)
        # position, rates and accelerations (T, k), (T, m), (T, m)
        self.at_samples = at_samples.values, at_samples.rates, at_samples.accelerations

    @property
    def one_by_one(self) -> bool:
        """Whether a sample depends on the way there, or is not found by adding steps."""
        return self.solver.redundant or bool(self.manifold.quasi)

    def run(self, start: Array) -> JointMotion:
        """Return the joint motion, at T times, from the solution nearest to ``start`` (nq,).

        Raises
        ------
        Unreachable, Singular : with times.
        """
        solution = self.solver.solve(self.at_samples[0][0], start)
        if not self.reached(solution.residual):
            # in a singular pose, such as a stretched arm, Newton's method may find no direction: leave it by one step
            nudge = 0.05 * np.cos(np.arange(self.manifold.nv)) * self.solver.moving
            solution = self.solver.solve(self.at_samples[0][0], self.manifold.integrate(start, nudge))
        if not self.reached(solution.residual):
            raise self.unreachable(0, solution.q)
        q = np.empty((len(self.times), len(start)), order="F")
        q[0] = solution.q
        now = self.state(self.times[0], solution, self.sample(0))
        before: PathState | None = None
        k, last = 0, len(q) - 1
        strides = Strides(len(q) < FEWEST or self.one_by_one)
        while k < last:
            further = None if strides.over else self._in_strides(strides, k, (before, now), q)
            if further:
                k, before, now = further
                continue
            k += 1
            before, now = self.advance(before, now, k)
            q[k] = now.q
        rates = self.solver.rates(q, *self.at_samples[1:])
        return JointMotion(q, np.asfortranarray(rates.qd), np.asfortranarray(rates.qdd))

    def _in_strides(
        self, strides: Strides, first: int, ends: tuple[PathState | None, PathState], q: Array
    ) -> tuple[int, PathState, PathState] | None:
        """Fill positions q (T, nq) from behind sample ``first`` up to another one; return it and the last two states
        there, or None where even the next sample has to be solved by itself.

        What fails on the way fails again there, with an error that tells its time.
        """
        states, places = [ends[1]], [first]

        def go_to(k: int) -> int:
            taken = self.steps
            states.append(self.advance(states[-2] if len(states) > 1 else ends[0], states[-1], k)[1])
            places.append(k)
            return self.steps - taken

        try:
            strides.go(first, len(q) - 1, go_to)
        except (Unreachable, Singular):
            strides.over = True
        if len(states) == 1:
            return None
        here = slice(first, places[-1] + 1)
        guess = interpolated(
            self.times[here], [k - first for k in places], [(x.q, x.qd, x.qdd) for x in states]
        )
        found, _, good = self._at_once(guess, here)
        last = counted(good, [k - first for k in places])
        if last < len(places) - 1:
            strides.length = 1
        if not last:
            return None
        q[first + 1 : places[last] + 1] = found[1 : places[last] + 1 - first]
        return places[last], states[last - 1], states[last]

    def near(self, guess: Array) -> JointMotion | None:
        """Return the joint motion at positions near a guess (T, nq), None where that does not count at some sample."""
        found, rates, good = self._at_once(guess, slice(None))
        return JointMotion(found, rates.qd, rates.qdd) if good.all() else None

    def _at_once(self, guess: Array, here: slice) -> tuple[Array, Rates, NDArray[np.bool_]]:
        """Return positions (T, nq) at samples near a guess, their rates, and which of them count: those close to the
        guess, reached, regular, and on one branch."""
        wanted, pd, pdd = (x[here] for x in self.at_samples)
        found = together(guess, lambda x: self._step(wanted, x))
        with np.errstate(all="ignore"):
            rates = self.solver.rates(found, pd, pdd)
            left = self.solver.left(wanted, self.solver.kinematics(found, rates.qd)[0])
            good = (np.abs(found - guess).max(axis=1) <= NEAR) & (rates.measure > SINGULAR)
            good &= np.sqrt((left * left).sum(axis=1)) <= max(self.solver.tolerance, self.solver.floor)
            U, Vt = rates.U, rates.Vt
            turn = np.swapaxes(U[:-1], 1, 2) @ U[1:], Vt[:-1] @ np.swapaxes(Vt[1:], 1, 2)
            good[1:] &= np.linalg.det(turn[0]) * np.linalg.det(turn[1]) > 0.0
        return found, rates, good

    def _step(self, wanted: Array, q: Array) -> Array:
        """Return Newton's steps of positions q (T, nq) to values wanted (T, k)."""
        solver = self.solver
        p, J, _ = solver.kinematics(q, np.zeros((len(q), self.manifold.nv)))
        U, s, Vt = np.linalg.svd(np.where(np.isfinite(J), J, 0.0), full_matrices=False)
        U, s, Vt = U[:, :, : solver.rank], s[:, : solver.rank], Vt[:, : solver.rank]
        with np.errstate(all="ignore"):
            steps = apply(np.swapaxes(Vt, 1, 2), apply(np.swapaxes(U, 1, 2), solver.left(wanted, p)) / s)
        solver.iterations += len(q)
        moves = np.zeros_like(q)
        moves[:, self.manifold.position] = np.where(np.isfinite(steps), steps, 0.0) * solver.moving
        return np.clip(moves, -MOST_STEP, MOST_STEP)

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

    def state(self, t: float, solution: Solution, target: tuple[Array, Array, Array]) -> PathState:
        """Return the state at a solution for a target."""
        rates = self.solver.rates(solution.q[None], target[1][None], target[2][None], solution.J[None])
        if not rates.measure[0] > SINGULAR:
            raise self.singular(t, solution.q)
        qd, qdd = self.manifold.rates(solution.q, rates.qd[0], rates.qdd[0])
        return PathState(t, solution.q, qd, qdd, rates.U[0], rates.Vt[0])

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
                self.h = max(h, self.h) if last else h  # the end may have cut it short
                if last:
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
        solution = self.solver.solve(target[0], guess)
        if not self.reached(solution.residual):
            return None
        miss = float(np.abs(solution.q - guess).max())
        if not self.solver.redundant:
            if miss > MISS:
                return None
            new = self.state(t, solution, target)
            return new if new.on_branch_of(now) else None
        if miss > (FIRST_MISS if error is None else MISS) or (
            error is not None and error > SELF_MOTION_ERROR
        ):
            return None
        new = self.state(t, solution, target)
        integrated = now.q + 0.5 * h * (now.qd + new.qd) + h * h / 12.0 * (now.qdd - new.qdd)
        drift = self.manifold.difference(new.q, self.manifold.normalise(integrated))
        drift -= new.Vt.T @ (new.Vt @ drift)  # the part that would move the point
        return dataclasses.replace(new, q=self.manifold.integrate(new.q, drift))

    def failure(self, now: PathState, t: float, p: Array, k: int) -> Exception:
        """Return the error that says why the motion cannot go on from ``now`` to the target p (k,) at time t <= t_k."""
        here = self.solver.solve(p, now.q)
        # rates grow beyond bounds just before the limit of the reach, so look up to the sample and a few beyond as well
        ahead = [self.between(x)[0] for x in np.linspace(t, float(self.times[k]), AHEAD).tolist()]
        q = here.q
        for wanted in (*ahead, *self.at_samples[0][k + 1 : k + 3]):
            there = self.solver.solve(wanted, q)
            if not self.reached(there.residual):
                return self.unreachable(k, here.q, t)
            q = there.q
        if self.reached(here.residual):
            return self.singular(now.t, now.q)
        return Unreachable(t, here.residual, t, here.residual, nearest=False)

    def singular(self, t: float, q: Array) -> Singular:
        """Return the error of a singular pose at q (n,), with the joint that moves most where the target does not."""
        _, s, Vt = np.linalg.svd(self.solver.position(q)[1])
        last = self.solver.rank - 1
        return Singular(t, float(s[last] / s[0]), int(np.argmax(np.abs(Vt[last]))))

    def unreachable(self, first: int, q: Array, time: float | None = None) -> Unreachable:
        """Return the error with the distances by which targets from sample ``first`` on are missed; time : since when,
        by default that sample's [s]."""
        since = float(self.times[first]) if time is None else time
        times = np.linspace(since, float(self.times[-1]), LISTED)
        left = []
        for t in times.tolist():
            solution = self.solver.solve(self.between(t)[0], q)
            q = solution.q
            left.append(solution.residual)
        worst = int(np.argmax(left))
        return Unreachable(since, left[0], float(times[worst]), left[worst], nearest=False)


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
