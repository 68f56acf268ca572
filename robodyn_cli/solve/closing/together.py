"""The loops of many runs closed side by side, as ``nearest.close`` closes those of one: the same starts, the same
steps, the same choice among what closes.

What would be another choice by rounding, and what takes more than Newton's steps, is told and left to that.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.expr.many import Expressions, ManyNumbers
from robodyn_cli.record import record
from robodyn_cli.solve.closing.nearest import first_starts, further_starts
from robodyn_cli.solve.closing.open_loops import BESIDE
from robodyn_cli.solve.closure import (
    CLOSED,
    ROUNDED,
    SAME,
    ClosureEquations,
    Numbers,
    has_full_rank,
    least_steps,
    newton_of_many,
    regularity,
    staged_size,
)
from robodyn_cli.solve.independent_rows import RANK_TOLERANCE
from robodyn_cli.spatial.algebra import Array

EQUAL = 1e-6  # relative difference of distances by which the nearest pose is not sure
TURN = 1e-9  # rad from half a turn, where rounding chooses the sign of an angle
AGREES = 1e-10  # of rates with the constraints, relative
Rows = NDArray[np.bool_]


@record
class ChosenPose:
    """The closed positions (N, nq) chosen so far, their distances from where closing starts, whether rows are
    independent there (1, or 0; -1: nothing closes yet), and whether nothing else may be meant (1 or 0)."""

    q: Any
    distance: Any
    full: Any
    sure: Any

    @staticmethod
    def none(q: Array) -> ChosenPose:
        count = len(q)
        return ChosenPose(q.copy(), np.full(count, np.inf), np.full(count, -1.0), np.ones(count))

    def put(self, rows: NDArray[np.intp], other: ChosenPose) -> None:
        """Set the choices of some runs."""
        self.q[rows], self.distance[rows] = other.q, other.distance
        self.full[rows], self.sure[rows] = other.full, other.sure

    @property
    def sound(self) -> Rows:
        return np.asarray((self.full > 0.0) & (self.sure > 0.0))


class ManyClosing:
    """The loops of a structure for many runs: eta (N, m) and Psi (N, m, nv) at positions of their own.

    Parameters
    ----------
    q, qd : columns that have initial values. held : those whose position stays.
    """

    def __init__(
        self,
        problem: ClosureEquations,
        numbers: ManyNumbers,
        q: Collection[str],
        qd: Collection[str],
        held: Collection[str],
    ) -> None:
        self.problem, self.numbers = problem, numbers
        rows, model = problem.constraint_rows, problem.model
        self.equations = {
            "eta": [row.eta for row in rows],
            "psi": [x for row in rows for x in row.psi],
            "cosines": [row.cosine for row in rows],
            "size": [staged_size(model)],
        }
        self._expressions = {name: Expressions(own) for name, own in self.equations.items()}
        self.one = Numbers(problem, ())
        parts = self._expressions.values()
        numbers_there = [x for part in parts for x in (*part.constants, *part.outputs)]
        self.varies = any(numbers.recipe.varies(x) for x in numbers_there)  # whether runs have other loops
        self.nv = model.nv
        self.missing = [k for k, name in enumerate(model.q_names) if name not in q and name not in held]
        self.free = [k for k, name in enumerate(model.q_names) if name not in held]
        self.held_rates = [k for k, name in enumerate(model.v_names) if name in qd or name in held]
        self.metres = np.array([unit == "m" for unit in model.v_units])
        self.long = np.array([row.kind in ("force", "m") for row in rows], dtype=bool)
        self.turning = [k for k in self.missing if not self.metres[k]]
        self.size: Any = self.evaluated("size", None)

    def part(self, rows: NDArray[np.intp]) -> ManyClosing:
        """Return the loops of some of the runs, each as often as it is named."""
        own = self.sized(self.size[rows] if len(self.size) > 1 else self.size)
        own.numbers = self.numbers.rows(rows)
        return own

    def sized(self, size: Any) -> ManyClosing:
        """Return the same with sizes of mechanisms (N, 1) that are given."""
        own = object.__new__(type(self))
        own.__dict__.update(self.__dict__, size=size)
        return own

    def evaluated(self, name: str, q: Array | None) -> Array:
        """Return one of the equations (N, ...) at q (N, nq)."""
        inputs = {} if q is None else {"q": list(q.T), "t": [np.zeros(len(q))], "p": []}
        return self.numbers.evaluate(self._expressions[name], inputs)

    def at_runs(self, q: Array) -> tuple[Array, Array]:
        """Return eta (N, m) and Psi (N, m, nv)."""
        return self.evaluated("eta", q), self.evaluated("psi", q).reshape(len(q), -1, self.nv)

    @property
    def lengths(self) -> Any:
        """Sizes of large motions of the coordinates (N, nv)."""
        return np.where(self.metres, self.size, 1.0)

    @property
    def sizes(self) -> Any:
        """Sizes of large residuals (N, m)."""
        return np.where(self.long, self.size, 1.0)

    # -- the steps of a closing -----------------------------------------------------------------------
    @cached_property
    def stages(self) -> list[Array]:
        """Starts (K, nv) from what is given, in parts of ``lengths``; each array is for what the last leaves open."""
        one, home = self.one, np.zeros(self.nv)
        stages = [first_starts(one, home, self.missing), *further_starts(one, home, self.free)]
        return [np.array(starts) / one.lengths for starts in stages if starts]

    def close(self, q: Array, v: Array) -> tuple[Array, Array, Rows]:
        """Return closed positions and rates that agree with them, from what is given, and for which runs they are those
        of ``assemble``. q : zero where nothing is given."""
        if self.one.manifold.quasi or len(self.missing) == self.nv:  # the nearest to q = 0 is another search
            return q, v, np.zeros(len(q), dtype=bool)
        choice = ChosenPose.none(q)
        for steps in self.stages:
            left = np.flatnonzero(choice.full < 0.0)
            if len(left):
                choice.put(left, self.part(left)._chosen(q[left], steps))
        eta, psi = self.at_runs(choice.q)
        v, sound = self.rates_of_closed(eta, psi, v)
        return choice.q, v, sound & choice.sound

    def _chosen(self, q: Array, steps: Array) -> ChosenPose:
        """Return the choice among what the starts of one stage lead to."""
        count = len(steps)
        every = self.part(np.repeat(np.arange(len(q)), count))
        starts = np.repeat(q, count, axis=0) + every.lengths * np.tile(steps, (len(q), 1))
        ends = every._newton(every._newton(starts, self.missing), self.free)
        wrapped = self.wrapped(ends)
        fits = np.abs(every.evaluated("eta", wrapped) / every.sizes).max(axis=1) <= CLOSED
        ends = np.where(fits[:, None], wrapped, ends)
        choice = ChosenPose.none(q)
        for one in self._each(every, ends, count):
            choice = self.preferred(choice, q, *one)
        return choice

    def _each(self, every: ManyClosing, q: Array, count: int) -> Iterator[tuple[Array, Array, Array, Array]]:
        """Yield positions, eta, Psi and cosines from each start, (N, ...)."""
        parts = q, *every.at_runs(q), every.evaluated("cosines", q)
        for k in range(count):
            q, eta, psi, cosines = (x[k::count] for x in parts)
            yield q, eta, psi, cosines

    def wrapped(self, q: Any) -> Any:
        """Return positions with missing angles within half a turn."""
        wrapped, turning = q.copy(), self.turning
        if turning:
            turned = q[:, turning] + np.pi
            wrapped[:, turning] = turned - 2.0 * np.pi * np.floor(turned / (2.0 * np.pi)) - np.pi
        return wrapped

    def preferred(self, best: ChosenPose, start: Any, q: Any, eta: Any, psi: Any, cosines: Any) -> ChosenPose:
        """Return what ``nearest.close`` prefers: a regular pose to a singular one, and then the nearer to the start."""
        missing = self.missing
        given = [k for k in range(self.nv) if k not in missing]
        closes = np.abs(eta / self.sizes).max(axis=1) <= CLOSED
        upright = (cosines >= 0.5).all(axis=1)
        moved = np.abs(q - start) / self.lengths
        distance = moved[:, given].sum(axis=1) + 1e-6 * moved[:, missing].sum(axis=1)
        fine = regularity(psi)
        sound = fine > ROUNDED  # dependence that rounding hides is looked for there
        if missing:
            upside = closes & np.logical_not(closes)
            halves = np.abs(np.abs(q[:, self.turning]) - np.pi)
            sound = sound & (halves.min(axis=1, initial=np.pi) > TURN)
        else:  # that ends with an error there
            upside = closes & np.logical_not(upright) & (moved.max(axis=1) <= BESIDE)
        full = np.where(fine > RANK_TOLERANCE, 1.0, 0.0)
        valid = (closes & upright) | upside
        nearer = (full > best.full) | ((full == best.full) & (distance < best.distance))
        better = valid & nearer
        doubtful = np.abs(distance - best.distance) <= EQUAL * distance
        apart = np.abs(q - best.q).max(axis=1) > SAME
        rival = valid & apart & doubtful & (full == best.full)
        sure = np.where(
            rival, 0.0, np.where(better, np.where(sound & np.logical_not(upside), 1.0, 0.0), best.sure)
        )
        return ChosenPose(
            np.where(better[:, None], q, best.q), np.where(better, distance, best.distance),
            np.where(better, full, best.full), sure,
        )  # fmt: skip

    def rates_of_closed(self, eta: Any, psi: Any, v: Any) -> tuple[Array, Rows]:
        """Return rates (N, nv) that agree with the loops, and where positions close them, by eta and Psi there."""
        sound = (np.abs(eta / self.sizes).max(axis=1) <= CLOSED) & has_full_rank(psi, RANK_TOLERANCE)
        v, agrees = self._rates(np.where(sound[:, None, None], psi, 0.0), v)
        return v, sound & agrees

    def _newton(self, q: Array, columns: list[int]) -> Array:
        return newton_of_many(self, q, columns)[0] if columns else q

    def _rates(self, psi: Array, v: Array) -> tuple[Array, Rows]:
        """Return rates with Psi v = 0 that keep those given, and where there are such."""
        v = v.copy()
        free = [k for k in range(self.nv) if k not in self.held_rates]
        for _ in range(3):
            if free:
                residual = psi @ v[..., None]
                v[:, free] += least_steps(psi[:, :, free], -residual[..., 0])
        left = np.abs(psi @ v[..., None]).max(axis=(1, 2))
        scale = np.abs(psi).max(axis=(1, 2)) * np.maximum(np.abs(v).max(axis=1), 1.0)
        return v, left <= AGREES * scale
