"""Closing loops from far away: rotation vectors for attitudes, damped steps, starts spread around a pose."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from robodyn_cli.solve.closure import MOST_STEP, SLOW, TINY, Conditions, Numbers
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.spatial.quaternion import logarithm

DESCENT = 300  # damped steps
ATTEMPTS = 24  # random starts
UPSIDE_DOWN = 1e-2  # rad from upside down, where the direction of an axis turns without bound


class Aligned:
    """The conditions of ``Numbers`` with a rotation vector, or that of two axes, in the place of each attitude's sines.

    phi = log(e^T f) vanishes in one attitude alone, sines in others as well. Its rate is J^-1 e^T Jw v with the left
    Jacobian J of rotation vectors: J^-1 = 1 - [phi]/2 + k [phi]^2, k = (1 - a/2 cot(a/2)) / a^2, a = |phi|
    (Barfoot 2017, 7.76).
    """

    def __init__(self, numbers: Numbers) -> None:
        self.numbers, self.lengths = numbers, numbers.lengths
        turned = {id(row.attitude): row for row in numbers.rows if row.attitude is not None}
        self._plain = [k for k, row in enumerate(numbers.rows) if row.attitude is None]
        attitudes = [(row, row.attitude) for row in turned.values() if row.attitude is not None]
        ends = [x for _, a in attitudes for part in (a.e, a.f, a.Jw) for x in part.ravel()]
        plain = [x for k in self._plain for x in (numbers.rows[k].eta, *numbers.rows[k].psi)]
        self._all, self._cut = numbers.values_of([*plain, *ends]), len(plain)
        self._of_axes = np.array([a.of_axes for _, a in attitudes], dtype=bool)
        self.rotated = [row.closure for row, _ in attitudes]
        closures = [row.closure for row, a in attitudes for _ in range(2 if a.of_axes else 3)]
        self._kept = np.array([k < 2 or not a.of_axes for _, a in attitudes for k in range(3)], dtype=bool)
        self.loops = [numbers.rows[k].closure for k in self._plain] + closures
        self.units = [numbers.rows[k].unit for k in self._plain] + ["rad"] * len(closures)
        self.sizes = np.append(numbers.sizes[self._plain], np.ones(len(closures)))

    def at(self, q: Array, t: float) -> tuple[Array, Array]:
        values, nv = self._all(q, t), self.numbers.nv
        plain, ends = values[: self._cut].reshape(-1, 1 + nv), values[self._cut :].reshape(-1, 18 + 3 * nv)
        e, f = ends[:, :9].reshape(-1, 3, 3).transpose(0, 2, 1), ends[:, 9:18].reshape(-1, 3, 3)
        relative, Jw = e @ f, e @ ends[:, 18:].reshape(-1, 3, nv)
        phi, turning = _rotation_vectors(relative, Jw)
        axes = self._of_axes
        phi[axes], turning[axes] = _tilts(relative[axes, :, 2], Jw[axes])
        return (
            np.append(plain[:, 0], phi.ravel()[self._kept]),
            np.concatenate([plain[:, 1:], turning.reshape(-1, nv)[self._kept]]),
        )

    def step(self, q: Array, dq: Array) -> Array:
        return self.numbers.step(q, dq)


def _rotation_vectors(R: Array, Jw: Array) -> tuple[Array, Array]:
    """Return phi (n, 3) of rotations (n, 3, 3) and its rates (n, 3, nv) for those of the angular velocity."""
    phi = logarithm(R)
    half = 0.5 * np.maximum(np.linalg.norm(phi, axis=1), 1e-4)  # 1e-4: k is 1/12 to rounding
    k = 0.25 * (1.0 - half / np.tan(half)) / half**2
    skew = np.cross(np.eye(3), phi[:, None, :])
    return phi, (np.eye(3) - 0.5 * skew + k[:, None, None] * (skew @ skew)) @ Jw


def _tilts(n: Array, Jw: Array) -> tuple[Array, Array]:
    """Return a u (n, 3) of axes n (n, 3), at angles a from z in the directions u across it, and its rates (n, 3, nv).

    With k = z x u: a' = k.w and u' = k (n x k).w / sin a; both tell an axis that points the other way.
    """
    across = np.hypot(n[:, 0], n[:, 1])
    angle, zero = np.arctan2(across, n[:, 2]), np.zeros(len(n))
    # upside down any way round leads back
    u = np.where(across[:, None] > TINY, n / np.maximum(across, TINY)[:, None], [1.0, 0.0, 0.0])
    u[:, 2] = 0.0
    k = np.stack([-u[:, 1], u[:, 0], zero], axis=1)
    ratio = np.where(n[:, 2] > 0.0, 1.0 / np.sinc(angle / np.pi), angle / np.maximum(across, UPSIDE_DOWN))
    tilting = (k[:, None, :] @ Jw) * u[:, :, None]
    turning = (np.cross(n, k)[:, None, :] @ Jw) * (ratio[:, None] * k)[:, :, None]
    return angle[:, None] * u, tilting + turning


class Drawn:
    """Conditions with a pull to a pose beside them, which steps that start anywhere follow to where they close near it:
    ``pull`` (q - home) / lengths, one row for each coordinate."""

    def __init__(self, aligned: Aligned, home: Array, pull: float) -> None:
        self.aligned, self.home, self.pull, self.lengths = aligned, home, pull, aligned.lengths
        self.sizes = np.append(aligned.sizes, np.ones(len(aligned.lengths)))

    def at(self, q: Array, t: float) -> tuple[Array, Array]:
        F, J = self.aligned.at(q, t)
        away = self.aligned.numbers.manifold.difference(self.home, q) / self.lengths
        return np.append(F, self.pull * away), np.concatenate([J, np.diag(self.pull / self.lengths)])

    def step(self, q: Array, dq: Array) -> Array:
        return self.aligned.step(q, dq)


def descend(
    conditions: Conditions, q: Array, free: Sequence[int], sizes: Array, gain: float = 1e-2
) -> tuple[Array, float]:
    """Return q moved to a least sum of squares of F / sizes, and its root, by Levenberg's damped steps.

    Parameters
    ----------
    free : velocity coordinates that may move. gain : part of the sum of squares that one of a few steps takes off.
    """
    columns = list(free)
    lengths = conditions.lengths[columns]
    F, J = conditions.at(q, 0.0)
    squares, slow = float(np.sum((F / sizes) ** 2)), 0
    damping = 1e-3  # of the largest diagonal entry
    dq = np.zeros(len(conditions.lengths))
    for _ in range(DESCENT):
        if not np.all(np.isfinite(J)) or squares < 1e-28 or damping > 1e12 or slow > SLOW:
            break
        A = J[:, columns] * lengths / sizes[:, None]
        gram = A.T @ A
        relative = damping * max(float(gram.diagonal().max(initial=0.0)), TINY)
        step = -np.linalg.solve(gram + relative * np.eye(len(columns)), A.T @ (F / sizes))
        step *= min(1.0, MOST_STEP / max(float(np.abs(step).max(initial=0.0)), TINY))
        dq[columns] = step * lengths
        trial = conditions.step(q, dq)
        F_new, J_new = conditions.at(trial, 0.0)
        new = float(np.sum((F_new / sizes) ** 2))
        if new < squares:
            slow = slow + 1 if new > (1.0 - gain) * squares else 0
            q, F, J, squares, damping = trial, F_new, J_new, new, max(0.2 * damping, 1e-14)
        else:
            damping *= 6.0
    return q, float(np.sqrt(squares))


def starts_around(
    numbers: Numbers, q: Array, coordinates: list[int], spread: float, seed: int, count: int = ATTEMPTS
) -> list[Array]:
    """Return starts that differ from q by up to ``spread`` in the given coordinates; none without coordinates."""
    if not coordinates:
        return []  # numpy's random numbers take longer to import than most loops to close
    rng = np.random.default_rng(seed)
    starts = []
    for _ in range(count):
        step = np.zeros(numbers.nv)
        step[coordinates] = rng.uniform(-spread, spread, len(coordinates)) * numbers.lengths[coordinates]
        starts.append(numbers.manifold.integrate(q, step))
    return starts
