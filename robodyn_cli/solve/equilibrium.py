"""Balanced configurations of mechanisms: generalised forces that the constraints can hold.

r(q) = Psi^T lambda, F(q) = 0. With the columns of N spanning the motions that the constraints allow, N^T r = 0. The
balance is stable if every eigenvalue of the reduced stiffness K = N^T (d/dq)(r - Psi^T lambda) N has a positive real
part; for forces with a potential it is then a minimum of the potential.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.record import record
from robodyn_cli.solve.closure import SLOW, Conditions, newton
from robodyn_cli.solve.load_sharing import allowed_motions
from robodyn_cli.spatial.algebra import Array

MOST_STEP = 0.3  # rad, or part of the size of the mechanism
ITERATIONS = 400
CLOSED = 1e-10
BALANCED = 1e-13  # step below which the iteration has converged, rad or part of the mechanism's size
INDIFFERENT = 1e-9  # eigenvalue over the largest one below which it counts as zero


class Forces(Protocol):
    """Generalised forces at rest, as functions of q."""

    def load(self, q: Array) -> Array:
        """Return r (nv,): the generalised forces that constraints or holding torques must give."""
        ...

    def stiffness(self, q: Array, lam: Array) -> Array:
        """Return d(r - Psi^T lambda)/dq (nv, nv) along the velocity coordinates at constant lambda."""
        ...


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
        if not len(self.stiffness):
            return "rigid"
        least, size = float(self.stiffness.real.min()), float(np.abs(self.stiffness).max())
        if least > INDIFFERENT * size:
            return "stable"
        return "unstable" if least < -INDIFFERENT * size else "indifferent"


@record
class _Here:
    q: Array
    N: Array
    lam: Array
    free: Array  # N^T r


def balance(conditions: Conditions, forces: Forces, q: Array) -> Balance:
    """Return the balance that descent reaches from a closed configuration q (nq,).

    Newton steps with the stiffness's eigenvalues made positive: they lead down a potential and away from unstable
    balances. A step is halved while the force along it changes sign before its end. A start that is balanced already is
    returned, stable or not.
    """
    here = _at(conditions, forces, q)
    bound, count, converged = MOST_STEP, 0, not here.N.shape[1]
    while count < ITERATIONS and not converged:
        count += 1
        K = here.N.T @ forces.stiffness(here.q, here.lam) @ here.N
        scale = conditions.lengths
        step = _downhill(K, here.free)
        if not np.all(np.isfinite(step)):
            break
        length = float(np.abs(here.N @ step / scale).max())
        if length < BALANCED or not np.any(here.free):
            converged = True
            break
        step = step * min(1.0, bound / length)
        slope, there = float(here.free @ step), here
        for _ in range(30):
            moved, residual = newton(
                conditions, conditions.step(here.q, here.N @ step), range(len(scale)), SLOW
            )
            if not np.all(np.isfinite(moved)):
                break
            there = _at(conditions, forces, moved)
            # the force along the step, in the tangent space at its end
            ahead = float((there.N.T @ (here.N @ step)) @ there.free)
            if residual < CLOSED and ahead <= 0.5 * abs(slope) + 1e-300:
                break
            step = 0.5 * step
            slope *= 0.5
        bound = min(MOST_STEP, 2.0 * float(np.abs(here.N @ step / scale).max()))
        if there is here or not np.all(np.isfinite(there.free)):
            break
        at_rounding = float(np.abs(there.free).max()) >= float(np.abs(here.free).max()) and length < 1e-9
        here = there
        if at_rounding:
            converged = True
    K = here.N.T @ forces.stiffness(here.q, here.lam) @ here.N
    values = np.linalg.eigvals(K) if K.size else np.zeros(0)
    order = np.argsort(values.real)
    return Balance(
        here.q,
        here.lam,
        values[order].astype(complex),
        float(np.abs(here.free).max(initial=0.0)),
        count,
        converged,
    )


def _at(conditions: Conditions, forces: Forces, q: Array) -> _Here:
    _, J = conditions.at(q, 0.0)
    N, _ = allowed_motions(J[None])
    r = forces.load(q)
    lam = np.linalg.pinv(J.T, rcond=1e-8) @ r if len(J) else np.zeros(0)
    return _Here(q, N[0], lam, N[0].T @ r)


def _downhill(K: Array, force: Array) -> Array:
    """Return Newton's step -K^-1 f, or one with the eigenvalues of K's symmetric part made positive."""
    spectrum, V = np.linalg.eigh(0.5 * (K + K.T))
    values: Array = np.asarray(spectrum, dtype=np.float64)
    if values[0] > 1e-8 * max(float(np.abs(values).max()), 1e-300):
        return np.asarray(np.linalg.solve(K, -force))
    largest = max(float(np.abs(values).max()), 1e-300)
    return np.asarray(-V @ ((V.T @ force) / np.maximum(np.abs(values), 1e-6 * largest)))
