"""Inverse kinematics of any open chain: damped Newton steps, and a path of targets followed on one branch.

A step solves J dq = e in the damped least-squares sense, dq = V S (S^2 + mu^2)^-1 U^T e with J = U S V^T
(Wampler 1986, Nakamura and Hanafusa 1986): least norm where the chain is redundant, least error where the
target has a component that the chain cannot follow.

A redundant chain moves at each instant with the rates nearest to a drift u(q), none by default: the least-norm rates
then. q-dot = J^+ p-dot + (1 - J^+ J) u; its acceleration is the exact derivative of that, q-ddot = J^+ (p-ddot - J-dot
q-dot) + (1 - J^+ J) (u-dot + J-dot^T J^+T (q-dot - u)) (Golub and Pereyra 1973), which satisfies J q-ddot = p-ddot -
J-dot q-dot like every other. A drift down the gradient of a criterion keeps the chain near its optimum (Liegeois 1977).
Radians and metres weigh alike in the norm.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from robodyn_cli.model.manifold import Manifold
from robodyn_cli.record import record
from robodyn_cli.solve.point_kinematics import Led, PointFunction, what_is_left
from robodyn_cli.spatial.algebra import Array

RANK = 1e-9
MOST_STEP = 1.0  # rad or m


class Drift(Protocol):
    """The rates u (T, nv) that a redundant chain should have, and u-dot, at q (T, nq) and v (T, nv)."""

    def __call__(self, q: Array, v: Array) -> tuple[Array, Array]: ...


@record
class Solution:
    """Joint positions (nq,), what is left to the target [m, rad], and the Jacobian J (m, nv) there."""

    q: Array
    residual: float
    J: Array


@record
class Rates:
    """Joint rates and accelerations (T, nv), and J = U S V^T as far as its rank r: U (T, m, r), V^T (T, r, nv).

    measure : smallest over largest singular value (T,).
    """

    qd: Array
    qdd: Array
    measure: Array
    U: Array
    Vt: Array


class PointSolver:
    """Newton's method for one point, or one pose, of one chain.

    Parameters
    ----------
    function : p, J and J-dot of what is led (see ``PointFunction``). manifold : of the chain's positions.
    tolerance : what may be left to the target [m, rad]; max_iterations : per sample. drift : of a redundant chain.
    """

    def __init__(
        self,
        function: PointFunction,
        led: Led,
        manifold: Manifold,
        tolerance: float,
        max_iterations: int,
        drift: Drift | None = None,
    ) -> None:
        self.function, self.led, self.manifold = function, led, manifold
        self.drift = drift
        self.tolerance = tolerance
        self.max_iterations = max_iterations
        self.iterations = 0
        some = np.random.default_rng(1).uniform(-2.0, 2.0, size=(16, manifold.nq))
        some = np.array([manifold.normalise(q) for q in some])
        p, J, _ = function(some, np.zeros((16, manifold.nv)))
        self.leads = bool(np.abs(J[:, : led.rows]).max() > 0.0)  # whether any joint moves the point
        influence = np.abs(J).max(axis=(0, 1))
        self.moving = influence > RANK * max(
            float(influence.max()), 1e-300
        )  # velocities that move what is led
        values = np.linalg.svd(J * self.moving, compute_uv=False)
        self.rank = int((values > RANK * max(float(values.max()), 1e-300)).sum(axis=1).max())
        self.redundant = int(self.moving.sum()) > self.rank
        # rounding of p, below which no tolerance can be met
        self.floor = 16.0 * float(np.finfo(float).eps) * float(np.abs(p).max())

    def kinematics(self, q: Array, v: Array) -> tuple[Array, Array, Array]:
        """Return p, J and J-dot at q and v; columns of joints that do not move the point are exactly zero."""
        p, J, J_rate = self.function(q, v)
        return p, J * self.moving, J_rate * self.moving

    def position(self, q: Array) -> tuple[Array, Array]:
        """Return the values p (k,) and J (m, nv) at q (nq,)."""
        p, J, _ = self.kinematics(q[None, :], np.zeros((1, self.manifold.nv)))
        return p[0], J[0]

    def left(self, target: Array, p: Array) -> Array:
        """Return the rows (m,) that lead from values p to a target."""
        return what_is_left(target, p, self.led.oriented)

    def solve(self, target: Array, q: Array) -> Solution:
        """Return the solution near q (nq,) for a target (k,), or the nearest point if it is not reached."""
        p, J = self.position(q)
        e = self.left(target, p)
        r = _length(e)
        mu, count = 0.0, 0
        limit = max(self.tolerance, self.floor)
        # at least one step, even from a near start: it takes little time and leaves only rounding
        while r > (limit if count else 0.0) and count < self.max_iterations:
            count += 1
            U, s, Vt = np.linalg.svd(J, full_matrices=False)
            U, s, Vt = U[:, : self.rank], s[: self.rank], Vt[: self.rank]
            g = U.T @ e
            pull = s * g
            if not _length(pull) > 1e-9 * s[0] * r:
                break  # the nearest point: J^T e = 0
            while True:
                step = Vt.T @ (pull / (s * s + mu * mu) if mu or s[-1] > 1e-12 * s[0] else pull / s[0] ** 2)
                largest = float(np.abs(step).max())
                if largest > MOST_STEP:
                    step *= MOST_STEP / largest
                step = np.where(self.moving, step, 0.0)
                moved = self.manifold.integrate(q, step)
                p, J_new = self.position(moved)
                e_new = self.left(target, p)
                r_new = _length(e_new)
                if r_new < r:
                    break
                mu = max(10.0 * mu, 1e-4 * s[0])
                if r <= limit or mu > 1e8 * s[0]:
                    self.iterations += count
                    return Solution(q, r, J)
            q, e, r, J = moved, e_new, r_new, J_new
            mu = 0.1 * mu if mu > 1e-6 * s[0] else 0.0
        self.iterations += count
        return Solution(q, r, J)

    def rates(self, q: Array, pd: Array, pdd: Array, J: Array | None = None) -> Rates:
        """Return rates and accelerations at q (T, nq) for pd, pdd (T, m); J (T, m, nv) where it is known."""
        if J is None:
            _, J, _ = self.kinematics(q, np.zeros((len(q), self.manifold.nv)))
        U, s, Vt = np.linalg.svd(J, full_matrices=False)
        U, s, Vt = U[:, :, : self.rank], s[:, : self.rank], Vt[:, : self.rank]
        with np.errstate(divide="ignore", invalid="ignore"):  # the caller checks the measure first
            V, Ut = np.swapaxes(Vt, 1, 2), np.swapaxes(U, 1, 2)
            qd = apply(V, apply(Ut, pd) / s)
            drift = None
            if self.redundant and self.drift is not None:
                drift, _ = self.drift(q, qd)
                qd = qd + drift - apply(V, apply(Vt, drift))
            _, _, J_rate = self.kinematics(q, qd)
            qdd = apply(V, apply(Ut, pdd - apply(J_rate, qd)) / s)
            if self.redundant:
                own = qd if drift is None else qd - drift
                turn = apply(np.swapaxes(J_rate, 1, 2), apply(U, apply(Vt, own) / s))
                if self.drift is not None:
                    turn = turn + self.drift(q, qd)[1]
                qdd += turn - apply(V, apply(Vt, turn))
            return Rates(qd * self.moving, qdd * self.moving, s[:, -1] / s[:, 0], U, Vt)


def apply(A: Array, x: Array) -> Array:
    """Return A x for a batch: (T, i, j), (T, j)."""
    return np.matmul(A, x[:, :, None])[:, :, 0]


def _length(x: Array) -> float:
    return float(np.sqrt(x @ x))
