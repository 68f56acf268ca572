"""Configurations in which the constraints alone hold a mechanism, of one run or of several side by side.

r(q) = Psi^T lambda, F(q) = 0. With the columns of N spanning the motions that the constraints allow, N^T r = 0. The
balance is stable if every eigenvalue of the reduced stiffness K = N^T (d/dq)(r - Psi^T lambda) N has a positive real
part; for forces with a potential it is then a minimum of the potential.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.record import record
from robodyn_cli.solve.closure import CUT, RANK, SLOW, Conditions, newton
from robodyn_cli.solve.load_sharing import null_spaces
from robodyn_cli.spatial.algebra import Array

Which = NDArray[np.bool_]  # of the runs (R,)
MOST_STEP = 0.3  # rad, or part of the size of the mechanism
ITERATIONS = 400
CLOSED = 1e-10
BALANCED = 1e-13  # step below which the iteration has converged, rad or part of the mechanism's size
INDIFFERENT = 1e-12  # eigenvalue over the largest one below which it is rounding and counts as zero
FLAT = 1e-6  # of the largest eigenvalue: the stiffness that steps take where there is none
NEARBY = 1e-5  # rad, or part of the mechanism's size, over which slopes of the stiffness are taken
LEFT = 1e-14  # of the forces in play: what rounding leaves of a force


class Forces(Protocol):
    """Generalised forces at rest, as functions of q."""

    def load(self, q: Array) -> Array:
        """Return r (nv,): the generalised forces that constraints or holding torques must give."""
        ...

    def stiffness(self, q: Array, lam: Array) -> Array:
        """Return d(r - Psi^T lambda)/dq (nv, nv) along the velocity coordinates at constant lambda."""
        ...


class ManyAtRest(Protocol):
    """Constraints and ``Forces`` of R runs side by side, at positions q (R, nq).

    lengths : (nv,) size of a large motion of each coordinate. tolerance : ratio of singular values of J below which
    rows depend on each other.
    """

    @property
    def lengths(self) -> Array: ...
    @property
    def tolerance(self) -> float: ...

    def jacobian(self, q: Array) -> Array:
        """Return J (R, m, nv)."""
        ...

    def moved(self, q: Array, dq: Array) -> tuple[Array, Array]:
        """Return q moved by dq (R, nv) and closed again, and the largest relative residuals (R,)."""
        ...

    def load(self, q: Array) -> Array: ...
    def stiffness(self, q: Array, lam: Array) -> Array: ...


@record
class OneAtRest:
    """A single run."""

    conditions: Conditions
    forces: Forces
    tolerance: float

    @property
    def lengths(self) -> Array:
        return self.conditions.lengths

    def jacobian(self, q: Array) -> Array:
        return self.conditions.at(q[0], 0.0)[1][None]

    def moved(self, q: Array, dq: Array) -> tuple[Array, Array]:
        start = self.conditions.step(q[0], dq[0])
        cut = CUT if self.tolerance == RANK else self.tolerance
        there, residual = newton(self.conditions, start, range(len(self.lengths)), SLOW, cut)
        return there[None], np.array([residual])

    def load(self, q: Array) -> Array:
        return self.forces.load(q[0])[None]

    def stiffness(self, q: Array, lam: Array) -> Array:
        return self.forces.stiffness(q[0], lam[0])[None]


@record
class Balance:
    """A balanced configuration.

    lam : multipliers of the conditions, of least norm. stiffness : eigenvalues of the reduced stiffness, smallest
    real part first. residual : largest entry of N^T r. converged : whether Newton's method did.
    """

    q: Array
    lam: Array
    stiffness: NDArray[np.complex128]
    residual: float
    iterations: int
    converged: bool

    @property
    def stability(self) -> str:
        """``stable``, ``unstable``, ``indifferent``, or ``rigid`` where nothing can move."""
        return self.stability_beyond(0.0)

    def stability_beyond(self, error: float) -> str:
        """Return the same where eigenvalues that are within an error of zero count as zero."""
        if not len(self.stiffness):
            return "rigid"
        zero = max(error, INDIFFERENT * float(np.abs(self.stiffness).max()))
        least = float(self.stiffness.real.min())
        if least > zero:
            return "stable"
        return "unstable" if least < -zero else "indifferent"


@record
class _Here:
    """Configurations of R runs with a basis N (R, nv, f) of their motions.

    free : N^T r (R, f). carried : |r| + |Psi|^T |lambda| (R, nv), the forces in play.
    """

    q: Array
    N: Array
    lam: Array
    free: Array
    carried: Array

    def is_rounding(self, lengths: Array) -> Which:
        """Tell in which runs the forces that are left are what rounding leaves of those in play, as torques."""
        torques = np.abs(self.carried * lengths).max(axis=1, initial=0.0)
        room = LEFT * torques[:, None] * np.abs(self.N / lengths[:, None]).sum(axis=1)
        return np.asarray((np.abs(self.free) <= room).all(axis=1))

    def along(self, step: Array) -> Array:
        """Return N x (R, nv) for steps x (R, f)."""
        return np.asarray((self.N @ step[..., None])[..., 0])

    def reduced(self, rest: ManyAtRest) -> Array:
        """Return the reduced stiffness (R, f, f)."""
        return np.asarray(np.swapaxes(self.N, 1, 2) @ rest.stiffness(self.q, self.lam) @ self.N)

    def put(self, rows: Which, other: _Here) -> _Here:
        """Return these with other ones in the place of some."""
        if rows.all() or not rows.any():
            return other if rows.all() else self
        own = ((getattr(x, name) for x in (other, self)) for name in ("q", "N", "lam", "free", "carried"))
        return _Here(*(np.where(rows.reshape(-1, *[1] * (x.ndim - 1)), x, y) for x, y in own))


def balance(conditions: Conditions, forces: Forces, q: Array, tolerance: float = RANK) -> Balance:
    """Return the balance that descent reaches from a closed configuration q (nq,); see ``balances``.

    tolerance : see ``ManyAtRest``.
    """
    return balances(OneAtRest(conditions, forces, tolerance), q[None])[0]


def balances(rest: ManyAtRest, q: Array, most: int = ITERATIONS) -> list[Balance]:
    """Return the balances that descent reaches from closed configurations q (R, nq) in so many steps at most.

    Newton steps with the stiffness's eigenvalues made positive: they lead down a potential and away from unstable
    balances. A step is halved while the force along it changes sign before its end. A start that is balanced already is
    returned, stable or not. Of several runs those end whose loops come to leave other freedoms.
    """
    here, scale = _at(rest, q), rest.lengths
    bound, count = np.full(len(q), MOST_STEP), np.zeros(len(q), dtype=int)
    converged = np.full(len(q), not here.N.shape[2])
    going = ~converged
    for _ in range(most):
        if not going.any():
            break
        count += going
        step = _downhill(here.reduced(rest), here.free)
        going &= np.isfinite(step).all(axis=1)
        length = np.abs(here.along(step) / scale).max(axis=1)
        done = going & ((length < BALANCED) | ~here.free.any(axis=1))
        converged, going = converged | done, going & ~done
        step, there, went = _stepped(
            rest, here, step * np.minimum(1.0, bound / np.maximum(length, 1e-300))[:, None], going
        )
        bound = np.minimum(MOST_STEP, 2.0 * np.abs(here.along(step) / scale).max(axis=1))
        going = went & np.isfinite(there.free).all(axis=1)
        before, after = (np.abs(x.free).max(axis=1) for x in (here, there))
        # steps along what nothing holds go on for ever, led by rounding
        idle = going & (after >= 0.5 * before) & here.is_rounding(scale)
        going &= ~idle
        here = here.put(going, there)
        converged |= idle | (going & (after >= before) & (length < 1e-9))
        going &= ~converged
    values = eigenvalues(here.reduced(rest))
    left = np.abs(here.free).max(axis=1, initial=0.0)
    ends = zip(here.q, here.lam, values, left.tolist(), count.tolist(), converged.tolist())
    return [Balance(*end) for end in ends]


def eigenvalues(K: Array) -> NDArray[np.complex128]:
    """Return the eigenvalues of K (R, f, f), smallest real part first."""
    values = np.linalg.eigvals(_finite(K)) if K.size else np.zeros(K.shape[:2])
    return np.take_along_axis(values, np.argsort(values.real, axis=1), axis=1).astype(complex)


def _stepped(rest: ManyAtRest, here: _Here, step: Array, waiting: Which) -> tuple[Array, _Here, Which]:
    """Return the parts of steps (R, f) that were taken, where they lead, and which runs went; those that do not wait
    stay."""
    slope, there, went = np.abs((here.free * step).sum(axis=1)), here, np.zeros(len(step), dtype=bool)
    for _ in range(30):
        moved, residual = rest.moved(here.q, here.along(step))
        waiting = waiting & np.isfinite(moved).all(axis=1)
        if not waiting.any():
            break
        trial = _at(rest, moved, here)
        there, went = there.put(waiting, trial), went | waiting
        # the force along the step, in the tangent space at its end
        ahead = (np.swapaxes(trial.N, 1, 2) @ here.along(step)[..., None])[..., 0]
        waiting &= (residual >= closed_up_to(rest.tolerance)) | (
            (ahead * trial.free).sum(axis=1) > 0.5 * slope + 1e-300
        )
        if not waiting.any():
            break
        half = np.where(waiting, 0.5, 1.0)
        step, slope = step * half[:, None], slope * half
    return step, there, went


def first_steps(rest: ManyAtRest, q: Array) -> Array:
    """Return how far the first steps from closed configurations q (R, nq) would go (R,), in rad or parts of the size:
    how near a balance is, be it stable or not."""
    here = _at(rest, q)
    if not here.N.shape[2]:
        return np.zeros(len(q))
    step = _downhill(here.reduced(rest), here.free)
    return np.asarray(np.abs(here.along(step) / rest.lengths).max(axis=1))


def _at(rest: ManyAtRest, q: Array, before: _Here | None = None) -> _Here:
    """Return configurations of runs; several that were somewhere before have no forces where their freedoms are other
    ones."""
    J = rest.jacobian(q)
    J = np.where(np.isfinite(J).all(axis=(1, 2), keepdims=True), J, 0.0)
    _, ranks, Vt = null_spaces(J, rest.tolerance)
    one = before is None or len(q) == 1
    rank = int(ranks.max()) if one or before is None else J.shape[2] - before.N.shape[2]
    N = np.swapaxes(Vt[:, rank:], 1, 2)
    r = np.where((ranks == rank)[:, None], rest.load(q), np.nan)
    lam = (np.linalg.pinv(np.swapaxes(J, 1, 2), rcond=rest.tolerance) @ r[..., None])[..., 0]
    free = (np.swapaxes(N, 1, 2) @ r[..., None])[..., 0]
    carried = (np.swapaxes(np.abs(J), 1, 2) @ np.abs(lam)[..., None])[..., 0]
    return _Here(q, N, lam, free, np.abs(r) + carried)


def closed_up_to(tolerance: float) -> float:
    """Return the relative residual up to which loops are closed whose rows depend on each other below a ratio."""
    return CLOSED if tolerance == RANK else tolerance


def _finite(K: Array) -> Array:
    """Return matrices (R, f, f), those without a value as if they were rigid."""
    return np.where(np.isfinite(K).all(axis=(1, 2), keepdims=True), K, np.eye(K.shape[1]))


def _downhill(K: Array, force: Array) -> Array:
    """Return Newton's steps -K^-1 f (R, f), or ones with the eigenvalues of K's symmetric part made positive."""
    known = np.isfinite(K).all(axis=(1, 2))
    K = _finite(K)
    spectrum, V = np.linalg.eigh(0.5 * (K + np.swapaxes(K, 1, 2)))
    values: Array = np.asarray(spectrum, dtype=np.float64)
    largest = np.maximum(np.abs(values).max(axis=1), 1e-300)[:, None]
    downhill = values[:, 0] > INDIFFERENT * largest[:, 0]
    # a spring may be as much stiffer than the weights as rounding lets them be seen beside it
    values = np.where(np.abs(values) > INDIFFERENT * largest, np.abs(values), FLAT * largest)
    step = -(V @ ((np.swapaxes(V, 1, 2) @ force[..., None]) / values[..., None]))[..., 0]
    step[downhill] = np.linalg.solve(K[downhill], -force[downhill][..., None])[..., 0]
    step[~known] = np.nan
    return np.asarray(step)
