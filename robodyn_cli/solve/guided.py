"""Follow the motion of a mechanism that its loops and the conditions on some joints or on a point determine.

At every sample F(q, t) = 0 is solved by Newton's method on one branch, then J v = c and J v-dot = b. F holds the rows
of the loops and of the conditions. J has full column rank where these determine the motion, even if some rows depend
on others.
"""

from __future__ import annotations

import dataclasses
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.algorithms import bands
from robodyn_cli.model.manifold import Manifold
from robodyn_cli.record import record
from robodyn_cli.solve.closure import Conditions, least_step, least_steps
from robodyn_cli.solve.sparse import FEWEST, NEAR, Strides, counted, interpolated, together
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.motion import JointMotion

MISS = 0.08  # rad, or part of the mechanism's size, by which extrapolation may miss before the branch could change
SINGULAR = 1e-8  # smallest over largest singular value of J
SAME = 1e-9  # relative residual below which conditions agree
CLOSED = 1e-12  # rad, or part of the mechanism's size: a shorter step of Newton's method is the last one
ITERATIONS = 12
HALVINGS = 40


class Sizes(Protocol):
    """How large conditions and coordinates are.

    same : relative residual below which they agree. singular : ratio of singular values of J below which they do not
    determine the motion.
    """

    lengths: Array
    sizes: Array
    manifold: Manifold
    same: float
    singular: float


class SampledConditions(Sizes, Protocol):
    """Conditions at samples side by side: of one motion, or of many runs."""

    def at_samples(self, q: Array, samples: slice) -> tuple[Array, Array]:
        """Return F (T, m) and J (T, m, nv) at positions q (T, nq) of some of the motion's samples."""
        ...

    def rates_at_samples(self, q: Array, v: Array, samples: slice) -> tuple[Array, Array]:
        """Return c and b (T, m) of J v = c and J v-dot = b, at q (T, nq) and v (T, nv) of some samples."""
        ...


class MotionConditions(Conditions, SampledConditions, Protocol):
    """Conditions along a motion: their names, and their rates."""

    names: tuple[str, ...]

    @property
    def together(self) -> bool:
        """Whether samples can be evaluated side by side, on positions that are sums of steps."""
        ...

    def rates(self, q: Array, v: Array, t: float) -> tuple[Array, Array]:
        """Return c and b (m,) of J v = c and J v-dot = b; b depends on v."""
        ...


@record
class Places:
    """Places side by side: positions q (T, nq), rates v and accelerations a (T, nv), J (T, m, nv) scaled.

    regular : where the conditions hold and determine the motion. moved : how far Newton's method went (T,).
    rounds : that it took.
    """

    q: Array
    v: Array
    a: Array
    J: Array
    regular: NDArray[np.bool_]
    moved: Array
    rounds: int

    def part(self, rows: NDArray[Any]) -> Places:
        """Return some of them."""
        return dataclasses.replace(self, **{name: getattr(self, name)[rows] for name in PER_PLACE})

    def put(self, rows: NDArray[Any], other: Places) -> None:
        """Put others in the place of some of them."""
        for name in PER_PLACE:
            getattr(self, name)[rows] = getattr(other, name)


PER_PLACE = ("q", "v", "a", "J", "regular", "moved")


def same_branch(before: Array, after: Array) -> NDArray[np.bool_]:
    """Tell where places with scaled J (T, m, nv) are on the branch of others.

    Where branches meet, a singular value passes zero, which changes the sign of det (J_0^T J).
    """
    square = before.shape[1] == before.shape[2]
    sign: Array = bands.slogdet(after if square else np.swapaxes(before, 1, 2) @ after)[0]
    if square:
        sign = sign * bands.slogdet(before)[0]
    return sign > 0.0


def newton_moves(conditions: Sizes, q: Array, F: Array, J: Array) -> Array:
    """Return the step (T, nq) of Newton's method from positions q with F (T, m) and J (T, m, nv)."""
    lengths, moves = conditions.lengths, np.zeros_like(q)
    scaled = np.where(np.isfinite(J), J, 0.0) * lengths / conditions.sizes[:, None]
    steps = least_steps(scaled, -F / conditions.sizes)
    finite = np.where(np.isfinite(steps), np.clip(steps, -1.0, 1.0), 0.0)
    moves[:, conditions.manifold.position] = finite * lengths
    return moves


def regular_places(conditions: Sizes, F: Array, J: Array) -> tuple[Any, Array]:
    """Return where conditions with F (T, m) and J (T, m, nv) hold and determine the motion (T,), and J scaled."""
    regular: Any = np.isfinite(J).all(axis=(1, 2)) & np.isfinite(F).all(axis=1)
    J = np.where(regular[:, None, None], J, 0.0)
    regular = regular & (np.abs(F / conditions.sizes).max(axis=1, initial=0.0) < conditions.same)
    scaled = J * conditions.lengths / conditions.sizes[:, None]
    regular = regular & bands.full_rank(scaled, conditions.singular)
    return regular & (J.shape[1] >= J.shape[2]), scaled


@np.errstate(all="ignore")
def solve_together(conditions: SampledConditions, guess: Array, samples: slice) -> Places:
    """Return the places at samples near a guess (T, nq), by Newton's method on all of them at once."""
    rounds, moved = 0, np.zeros(len(guess))

    def step(q: Array) -> Array:
        nonlocal rounds, moved
        F, J = conditions.at_samples(q, samples)
        rounds += 1
        moves = newton_moves(conditions, q, F, J)
        # the way there counts: from beyond its bound it may come back to another solution
        moved = np.maximum(moved, far(q + moves))
        return moves

    def far(q: Array) -> Array:
        away: Array = (np.abs(q - guess)[:, conditions.manifold.position] / conditions.lengths).max(
            axis=1, initial=0.0
        )
        return away

    q = together(guess, step)
    F, J = conditions.at_samples(q, samples)
    regular, scaled = regular_places(conditions, F, J)
    known: Any = np.isfinite(J).all(axis=(1, 2)) & np.isfinite(F).all(axis=1)
    J = np.where(known[:, None, None], J, 0.0)
    v = least_steps(J, conditions.rates_at_samples(q, np.zeros((len(q), J.shape[2])), samples)[0])
    a = least_steps(J, conditions.rates_at_samples(q, v, samples)[1])
    return Places(q, v, a, scaled, regular, np.maximum(moved, far(q)), rounds)


@record
class GuidedPlace:
    """Position, rates and accelerations at one time, with J scaled to its rows' and coordinates' sizes.

    Where samples are solved together, J is that of the sample before from which the motion was followed.
    """

    t: float
    q: Array
    v: Array
    a: Array
    J: Array

    @property
    def measure(self) -> float:
        """Smallest over largest singular value of J."""
        s = bands.singular_values(self.J)
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
            step = least_step(self.scaled(J), -F / self.conditions.sizes)
            if float(np.abs(moved + step).max(initial=0.0)) > 1.0:
                return q, J, size, np.inf
            trial = self.conditions.step(q, step * self.conditions.lengths)
            F_new, J_new = self.conditions.at(trial, t)
            new = float(np.abs(F_new / self.conditions.sizes).max(initial=0.0))
            small = float(np.abs(step).max(initial=0.0)) < CLOSED
            if size < self.conditions.same and not new < size and (small or self.conditions.same == SAME):
                break
            q, F, J, moved, size = trial, F_new, J_new, moved + step, new
            if small:
                break
        return q, J, size, float(np.abs(moved).max(initial=0.0))

    def place(self, q: Array, J: Array, t: float) -> GuidedPlace:
        """Return the place at a solution: rates, then accelerations."""
        c, b = self.conditions.rates(q, np.zeros(len(self.conditions.lengths)), t)
        v = least_step(J, c)
        _, b = self.conditions.rates(q, v, t)
        a = least_step(J, b)
        return GuidedPlace(t, q, v, a, self.scaled(J))

    def start(self, q: Array, t: float) -> GuidedPlace:
        """Return the place at the start, near q.

        Raises
        ------
        Stuck : the conditions cannot be met there, or J is singular.
        """
        q, J, residual, _ = self.solve(q, t)
        if not residual < self.conditions.same:
            raise self._stuck(None, q, J, t, residual)
        here = self.place(q, J, t)
        if not here.measure > self.conditions.singular:
            raise self._stuck(here, q, J, t, 0.0)
        return here

    def follow(self, start: GuidedPlace, times: Array) -> tuple[list[GuidedPlace], Stuck | None]:
        """Return the places at samples (T,), the first of which is the start, and why they end before the last, if they
        do."""
        places, last = [start], len(times) - 1
        strides = Strides(len(times) < FEWEST or not self.conditions.together)
        while len(places) <= last:
            more = [] if strides.over else self._in_strides(strides, places[-1], len(places) - 1, times)
            if not more:
                try:
                    more = [self.advance(places[-1], float(times[len(places)]))]
                except Stuck as stuck:
                    return places, stuck
            places += more
        return places, None

    def _in_strides(
        self, strides: Strides, start: GuidedPlace, first: int, times: Array
    ) -> list[GuidedPlace]:
        """Return the places behind sample ``first`` up to another one; none where even the next sample has to be solved
        by itself. What gets stuck on the way gets stuck again there, with its time.
        """
        through, places = [start], [first]

        def go_to(k: int) -> int:
            taken = self.steps
            through.append(self.advance(through[-1], float(times[k])))
            places.append(k)
            return self.steps - taken

        try:
            strides.go(first, len(times) - 1, go_to)
        except Stuck:
            strides.over = True
        if len(places) == 1:
            return []
        here, at = slice(first, places[-1] + 1), [k - first for k in places]
        states = [(x.q, *self.conditions.manifold.rates(x.q, x.v, x.a)) for x in through]
        guess = interpolated(times[here], at, states)
        found, good = self.near(guess, here)
        last = counted(good, at)
        if last < len(at) - 1:
            strides.length = 1
        before = np.searchsorted(at, np.arange(at[last] + 1), side="right") - 1
        rows = zip(times[here].tolist(), found.q, found.qd, found.qdd, (through[k].J for k in before))
        return [GuidedPlace(*row) for row in rows][1:]

    def near(self, guess: Array, samples: slice) -> tuple[JointMotion, NDArray[np.bool_]]:
        """Return the motion at samples near a guess (T, nq), and which of them count."""
        first = samples.start or 0
        found: list[tuple[Array, ...]] = []
        before: Array | None = None  # J at the sample before
        for part in bands.parts((len(guess), len(self.conditions.sizes), len(self.conditions.lengths))):
            here = solve_together(self.conditions, guess[part], slice(first + part.start, first + part.stop))
            self.iterations += here.rounds * len(here.q)
            good = here.regular & (here.moved <= NEAR)
            good[1:] &= same_branch(here.J[:-1], here.J[1:])
            if before is not None:
                good[0] &= same_branch(before, here.J[:1])[0]
            before = here.J[-1:].copy()
            found.append((here.q, here.v, here.a, good))
        q, v, a, good = (np.concatenate(x) for x in zip(*found))
        return JointMotion(q, v, a), good

    def advance(self, now: GuidedPlace, end: float) -> GuidedPlace:
        """Return the place at time ``end``, in steps short enough to stay on the branch.

        Raises
        ------
        Stuck : the branch ends before.
        """
        whole = end - now.t
        if whole == 0.0:
            return now
        h = min(whole, 2.0 * self._h)
        while True:
            last = now.t + 1.0000001 * h >= end
            t = end if last else now.t + h
            self.steps += 1
            reached = self._step(now, t)
            if reached is not None:
                self._h = max(t - now.t, self._h) if last else t - now.t  # the end may have cut it short
                now = reached
                if last:
                    return now
                h = min(2.0 * self._h, end - now.t)
            elif t - now.t < whole * 0.5**HALVINGS or t - now.t < 1e-14 * max(1.0, abs(t)):
                q, J, residual, _ = self.solve(now.q, t)
                contradicted = residual > self.conditions.same and now.measure > 1e-5
                raise self._stuck(now, q if contradicted else now.q, J, t, residual if contradicted else 0.0)
            else:
                h = 0.5 * (t - now.t)

    def _step(self, now: GuidedPlace, t: float) -> GuidedPlace | None:
        h = t - now.t
        guess = self.conditions.step(now.q, h * now.v + 0.5 * h * h * now.a)
        q, J, residual, missed = self.solve(guess, t)
        if not residual < self.conditions.same or not missed < MISS:
            return None
        new = self.place(q, J, t)
        on_branch = bool(same_branch(now.J[None], new.J[None])[0])
        return new if on_branch and new.measure > self.conditions.singular else None

    def _stuck(self, last: GuidedPlace | None, q: Array, J: Array, t: float, residual: float) -> Stuck:
        U, _, Vt = np.linalg.svd(self.scaled(J) if last is None or residual else last.J)
        weights = np.abs(U[:, J.shape[1] - 1]) if U.shape[0] >= J.shape[1] else np.abs(U[:, -1])
        row = None
        if residual:
            F, _ = self.conditions.at(q, t)
            worst = int(np.abs(F / self.conditions.sizes).argmax())
            row = (self.conditions.names[worst], float(F[worst]))
        return Stuck(last, t, row, (weights, np.abs(Vt[-1])))
