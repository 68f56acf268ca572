"""How far configurations at rest may be off: what residuals and rounding make of positions, torques and multipliers.

As with closed loops (``ready.closed_errors``), each number and result is changed by a random part of its rounding, and
what follows is solved again: the loops, J dq = -F, and a balance, N^T (r - J^T lambda + K dq) = 0, then multipliers,
torques and stiffness there. Directions in which the stiffness changes by much over such an error, as where balances
meet, are searched instead: the balance is no farther away than where the force along them is clear of its rounding on
both sides. Where that is nowhere all positions along them balance, and the errors are those of the nearest balance.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import TypeVar

import numpy as np

from robodyn_cli.observe.rounding import ENLARGED
from robodyn_cli.ready.closed_errors import SAFETY
from robodyn_cli.record import record
from robodyn_cli.results.result import magnitude
from robodyn_cli.solve.closing.balance import (
    INDIFFERENT,
    LEFT,
    MOST_STEP,
    NEARBY,
    Which,
    eigenvalues,
)
from robodyn_cli.solve.load_sharing import LostRank, Unbalanced, null_spaces, share
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.facts import PeakLoad
from robodyn_cli.works.rest.terms import ForcesAtRest, NearRest

There = TypeVar("There")

BELIEVED = 0.25  # part of itself by which the stiffness may change over an error of first order
CLEAR = 2.0  # times what is left of a force and the largest rounding of it, from which on its sign is sure


@record
class Nearby:
    """Configurations q (B, nq), with the multipliers lam (B, m) and J (B, m, nv) of all rows, that rounding may make of
    one at rest.

    weights : (draws,) of differences to the first of them, which makes them errors; the others are as far as may be.
    """

    q: Array
    lam: Array
    J: Array
    weights: Array

    def off(self, changes: Array) -> Array:
        """Return how far figures (n,) may be off that change by so much (B, n) to these."""
        draws, far = np.split(np.abs(changes), [len(self.weights)])
        largest: Array = (self.weights[:, None] * draws).max(axis=0, initial=0.0) + far.sum(axis=0)
        return largest


@record
class OffAtRest:
    """Errors of a configuration at rest: of q (nq,), of the multipliers lam (m,) of all rows, of torques tau and of
    those that keep joints in place (nv,), of eigenvalues of the stiffness.

    sure : whether first order tells them. beside : what rounding may make of the configuration.
    """

    q: Array
    lam: Array
    tau: Array
    holding: Array
    stiffness: float
    sure: bool
    beside: Nearby


@record
class _There:
    """What follows from positions q (R, nq): J (R, m, nv), the load, multipliers, torques and those that keep joints in
    place, the stiffness K (R, nv, nv), and the motions N (R, nv, f) that constraints allow."""

    q: Array
    J: Array
    load: Array
    lam: Array
    tau: Array
    holding: Array
    K: Array
    N: Array

    @cached_property
    def reduced(self) -> Array:
        """N^T K N (R, f, f)."""
        return np.asarray(np.swapaxes(self.N, 1, 2) @ self.K @ self.N)

    @property
    def figures(self) -> Array:
        """q, lambda, tau and what keeps joints in place (R, ...), one after another."""
        return np.concatenate([self.q, self.lam, self.tau, self.holding], axis=1)


class ErrorsOfBalances:
    """Errors of balances.

    Parameters
    ----------
    rest : the runs. staying : rows that keep joints where they are.
    """

    def __init__(self, rest: NearRest, staying: Sequence[int]) -> None:
        self.rest, self.staying = rest, list(staying)

    def __call__(self, q: Array) -> list[OffAtRest]:
        """Return the errors of balances q (R, nq); of several first order tells them, or they are not sure."""
        here = self._there(q)
        changes = self.rest.rounding(q, here.lam).solved(self.rest.terms(q).J, here.lam)
        U, sigma, Vt = np.linalg.svd(here.reduced)
        kept: Which = np.asarray(sigma > INDIFFERENT * sigma[:, :1])
        beside, weights = self._draws(here, changes, np.linalg.pinv(here.reduced, rcond=INDIFFERENT))
        for there, weight in zip(beside, weights.T):
            moved = np.linalg.svd(there.reduced, compute_uv=False)
            kept &= weight[:, None] * np.abs(moved - sigma) <= BELIEVED * sigma
        sure: Which = np.asarray(kept.all(axis=1))
        if len(q) == 1 and not sure[0]:
            strong = (Vt[0][kept[0]].T / sigma[0][kept[0]]) @ U[0][:, kept[0]].T
            beside, weights = self._draws(here, changes, strong[None])
            for k in np.flatnonzero(~kept[0]).tolist():
                beside += self._cleared(here, changes, (U[0][:, k], Vt[0][k], strong))
        spectra = np.array([_apart(here, there) for there in beside])
        products = np.swapaxes(np.abs(here.N), 1, 2) @ np.abs(here.K) @ np.abs(here.N)
        rounded = LEFT * products.reshape(len(q), -1).max(axis=1, initial=0.0)
        figures = here.figures, [x.figures for x in beside]
        cuts = np.cumsum([x.shape[1] for x in (here.q, here.lam, here.tau)])
        found = []
        for k, weight in enumerate(weights):
            places, multipliers, rows = (
                np.array([own[k] for own in every])
                for every in zip(*((there.q, there.lam, there.J) for there in beside))
            )
            nearby = Nearby(places, multipliers, rows, weight)
            off = nearby.off(np.array([x[k] for x in figures[1]]) - figures[0][k])
            positions, lam, tau, holding = np.split(off, cuts)
            stiffness = float(nearby.off(spectra[:, k, None])[0] + rounded[k])
            found.append(OffAtRest(positions, lam, tau, holding, stiffness, bool(sure[k]), nearby))
        return found

    def _there(self, q: Array, change: ForcesAtRest | None = None) -> _There:
        """Return what follows from positions, and from terms that rounding has changed."""
        rest = self.rest
        terms = rest.terms(q) if change is None else rest.terms(q) + change
        transposed = np.swapaxes(terms.J, 1, 2)
        lam = (np.linalg.pinv(transposed, rcond=rest.tolerance) @ terms.load[..., None])[..., 0]
        holding = (transposed[:, :, self.staying] @ lam[:, self.staying, None])[..., 0]
        _, ranks, Vt = null_spaces(terms.J, rest.tolerance)
        N = np.swapaxes(Vt[:, int(ranks.max()) :], 1, 2)
        K = rest.stiffness(q, lam) + terms.K
        return _There(q, terms.J, terms.load, lam, terms.tau + holding, holding, K, N)

    def _draws(self, here: _There, changes: ForcesAtRest, inverse: Array) -> tuple[list[_There], Array]:
        """Return what rounding may make of balances, and the weights (R, draw) of that; inverse : of the reduced
        stiffness (R, f, f)."""
        rest, terms = self.rest, self.rest.terms(here.q)
        back = np.linalg.pinv(terms.J, rcond=rest.tolerance)
        left = terms.load - np.einsum("rmv,rm->rv", terms.J, here.lam)
        lacking = ENLARGED * terms.F[:, None] + changes.F
        dq = -np.einsum("rvm,rdm->rdv", back, lacking)
        force = ENLARGED * left[:, None] + changes.load - np.einsum("rdmv,rm->rdv", changes.J, here.lam)
        force += np.einsum("rvw,rdw->rdv", here.K, dq)
        dq -= (here.N @ inverse @ np.swapaxes(here.N, 1, 2) @ np.swapaxes(force, 1, 2)).swapaxes(1, 2)
        for row, column in self._alone(terms.J):
            dq[:, :, column] = -lacking[:, :, row] / terms.J[:, row, column, None]
        parts = parts_of(dq, rest.lengths)
        there = [
            self._there(rest.step(here.q, parts[:, k, None] * dq[:, k]), changes.part(k, parts[:, k]))
            for k in range(dq.shape[1])
        ]
        return there, SAFETY / (ENLARGED * parts)

    def _alone(self, J: Array) -> list[tuple[int, int]]:
        """Return the rows that keep a single coordinate in place, and which: it is off by what they lack, and not by
        what solving for all coordinates leaves."""
        used = (J != 0.0).any(axis=0)
        return [(i, int(used[i].argmax())) for i in self.staying if np.count_nonzero(used[i]) == 1]

    def _cleared(
        self, here: _There, changes: ForcesAtRest, along: tuple[Array, Array, Array]
    ) -> list[_There]:
        """Return the configurations on both sides of a single balance where the force along a motion is clear of its
        rounding; none where that is nowhere. along : the force u, the motion v (f,), and the inverse (f, f) of the
        stiffness of the other motions, which balance."""
        u, v, strong = along
        rest, N = self.rest, here.N[0]
        noise = (changes.load - np.einsum("rdmv,rm->rdv", changes.J, here.lam)) @ N @ u
        left = abs(float(u @ N.T @ here.load[0]))
        sure = CLEAR * (SAFETY / ENLARGED * float(np.abs(noise).max()) + left)
        way = N @ v / max(float(np.abs(N @ v / rest.lengths).max()), 1e-300)

        def force(there: _There) -> Array:
            return np.asarray(N.T @ there.N[0] @ (there.N[0].T @ there.load[0]))

        def at(s: float) -> _There:
            there = self._there(rest.moved(here.q, s * way[None])[0])
            back = -N @ (strong @ force(there))
            return self._there(rest.moved(there.q, back[None])[0])

        return beyond_rounding(at, lambda there: abs(float(u @ force(there))) > sure)


def beyond_rounding(at: Callable[[float], There], clear: Callable[[There], bool]) -> list[There]:
    """Return the nearest places ``at`` steps of either sign along a motion that are both clear; none nowhere."""
    s = float(np.finfo(float).eps)
    while s < MOST_STEP:
        ends = [at(-s), at(s)]
        if all(map(clear, ends)):
            return ends
        s *= 2.0
    return []


def _apart(here: _There, there: _There) -> Array:
    """Return how far the eigenvalues of the stiffness (R,) lie apart in two configurations of each run."""
    one, two = (eigenvalues(x.reduced) for x in (here, there))
    # of pairs that are conjugate either may come first
    pairs = (one.real, two.real), (np.abs(one.imag), np.abs(two.imag))
    largest = (np.abs(np.sort(x, axis=1) - np.sort(y, axis=1)).max(axis=1, initial=0.0) for x, y in pairs)
    return np.asarray(sum(largest))


def parts_of(dq: Array, lengths: Array) -> Array:
    """Return which parts (R, draw) of enlarged changes dq (R, draw, nv) to take, so that first order holds; none less
    than what is not enlarged."""
    far = np.abs(dq / lengths).max(axis=2, initial=0.0)
    parts: Array = np.clip(NEARBY / np.maximum(far, 1e-300), 1.0 / ENLARGED, 1.0)
    return parts


class ErrorsOfHolding:
    """Errors of configurations that actuators hold.

    Parameters
    ----------
    rest : the runs, whose load actuators and loops bear. free : velocity coordinates that closed the loops. loops :
    rows of these. columns : velocity coordinates of the actuators.
    """

    def __init__(
        self, rest: NearRest, free: Sequence[int], loops: Sequence[int], columns: Sequence[int]
    ) -> None:
        self.rest, self.free, self.loops, self.columns = rest, list(free), list(loops), list(columns)

    def __call__(self, q: Array, lam: Array, tau: Array) -> list[OffAtRest | None]:
        """Return the errors of configurations q (R, nq) with multipliers of the loops (R, m) and torques (R, nv); None
        where rounding decides whether actuators hold them."""
        rest, terms = self.rest, self.rest.terms(q)
        every = np.zeros(terms.J.shape[:2])
        every[:, self.loops] = lam
        changes = rest.rounding(q, every).solved(terms.J, every)
        dq = np.zeros(changes.load.shape)
        back = np.linalg.pinv(terms.J[:, :, self.free], rcond=rest.tolerance)
        dq[:, :, self.free] = -np.einsum("rvm,rdm->rdv", back, ENLARGED * terms.F[:, None] + changes.F)
        parts = parts_of(dq, rest.lengths)
        places = [rest.step(q, parts[:, k, None] * dq[:, k]) for k in range(parts.shape[1])]
        beside = [rest.terms(x) + changes.part(k, parts[:, k]) for k, x in enumerate(places)]
        found: list[OffAtRest | None] = []
        for k, own in enumerate(q):
            if (shared := self._shared(beside, k)) is None:
                found.append(None)
                continue
            rows = np.array([x.J[k] for x in beside])
            nearby = Nearby(np.array([x[k] for x in places]), shared[0], rows, SAFETY / (ENLARGED * parts[k]))
            apart = (nearby.q - own, shared[0] - every[k], shared[1] - tau[k], np.zeros_like(shared[1]))
            positions, multipliers, torques, none = map(nearby.off, apart)
            found.append(OffAtRest(positions, multipliers, torques, none, 0.0, True, nearby))
        return found

    def _shared(self, terms: Sequence[ForcesAtRest], k: int) -> tuple[Array, Array] | None:
        """Return multipliers of all rows and torques of a run with some terms, one after another; None where actuators
        do not hold it with all of them."""
        psi, load = (np.array([x[k] for x in own]) for own in zip(*((one.J, one.load) for one in terms)))
        try:
            shared = share(psi[:, self.loops], self.columns, {"load": load}, self.rest.tolerance)
        except (LostRank, Unbalanced, np.linalg.LinAlgError):
            return None
        lam = np.zeros(psi.shape[:2])
        lam[:, self.loops] = shared.multipliers
        return lam, shared.tau


def with_errors(
    largest: Mapping[str, PeakLoad],
    loads: Mapping[str, Array],
    names: Mapping[str, tuple[str, ...]],
    beside: Nearby,
    noise: Mapping[str, Array],
) -> dict[str, PeakLoad]:
    """Return the loads of joints and closures with their errors.

    loads : by path, at rest and beside (1 + B, n). names : of their columns. noise : what rounding changes of them at
    rest (draw, n), enlarged.
    """
    found = {}
    for path, values in loads.items():
        sizes = []
        for letter in "fm":
            own = magnitude(np.vstack([values, values[0] + noise[path]]), names[path], letter)
            nearby, rounded = np.split(own[1:] - own[0], [len(values) - 1])
            sizes.append(
                float(beside.off(nearby[:, None])[0] + SAFETY / ENLARGED * np.abs(rounded).max(initial=0.0))
            )
        name = path.split("/")[-1]
        found[name] = PeakLoad(largest[name].peak_force, largest[name].peak_moment, *sizes)
    return found
