"""Splines of degree 5 through points, with rates and accelerations given at some of them.

Of all functions through the points with the given rates and accelerations, the spline has the least integral
of the squared jerk q''' (Kyriakopoulos and Saridis 1988 for one segment). Where an inner rate v is free, the
condition for the minimum is that q'''' does not jump there; where an inner acceleration a is free, that q'''
does not. So with both free the spline is C4; each given value gives up one of the two.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.course import Course

Ends = tuple[Array, Array, Array]

# (c3, c4, c5) of the quintic on [0, 1] from (q0, v0, a0, q1, v1, a1)
_COEFFICIENTS = np.array(
    [
        [-10.0, -6.0, -1.5, 10.0, -4.0, 0.5],
        [15.0, 8.0, 1.5, -15.0, 7.0, -1.0],
        [-6.0, -3.0, -0.5, 6.0, -3.0, 0.5],
    ]
)
# integral over [0, 1] of the square of 6 c3 + 24 c4 s + 60 c5 s^2, as a quadratic form
_SQUARED_JERK = np.array([[36.0, 72.0, 120.0], [72.0, 192.0, 360.0], [120.0, 360.0, 720.0]])
_ENERGY = _COEFFICIENTS.T @ _SQUARED_JERK @ _COEFFICIENTS


def hermite(h: Any, start: Ends, end: Ends) -> Array:
    """Return the coefficients (6, ...) in s = (t - t0) / h of the quintic with (q, v, a) at its start and its end."""
    (q0, v0, a0), (q1, v1, a1) = start, end
    ends = np.array([q0, h * v0, h * h * a0, q1, h * v1, h * h * a1])
    return np.concatenate([ends[:2], 0.5 * ends[2:3], np.tensordot(_COEFFICIENTS, ends, 1)])


def course_through(t: Array, q: Array, v: Array, a: tuple[Array, Array]) -> Course:
    """Return the quintics through positions and rates (N, n) at the times ``t`` (N,).

    a : accelerations (N, n) behind and before each time, where they may jump.
    """
    h = np.diff(t)[:, None]
    c = hermite(h, (q[:-1], v[:-1], a[0][:-1]), (q[1:], v[1:], a[1][1:]))
    return Course(t, c / h ** np.arange(6.0)[:, None, None])


class QuinticSpline:
    """Quintic spline of n functions through N points.

    Parameters
    ----------
    t : (N,) increasing. q : (N, n).
    v, a : (N, n) first and second derivatives, NaN where they are free; one row is given or free as a whole,
        and the first and the last row are given.
    """

    def __init__(self, t: Array, q: Array, v: Array, a: Array) -> None:
        self.t = t
        x = _least_jerk(np.diff(t), q, np.stack([v, a], axis=1))
        ends = (q[:-1], x[:-1, 0], x[:-1, 1]), (q[1:], x[1:, 0], x[1:, 1])
        self.c = hermite(np.diff(t)[:, None], *ends)  # (6, N - 1, n)

    def __call__(self, times: Array) -> tuple[Array, Array, Array]:
        """Return values and first and second derivatives (T, n) in column order."""
        k = np.clip(np.searchsorted(self.t, times, side="right") - 1, 0, len(self.t) - 2)
        h = (self.t[k + 1] - self.t[k])[:, None]
        s = (times[:, None] - self.t[k][:, None]) / h
        c = self.c[:, k]
        q = c[0] + s * (c[1] + s * (c[2] + s * (c[3] + s * (c[4] + s * c[5]))))
        qd = c[1] + s * (2 * c[2] + s * (3 * c[3] + s * (4 * c[4] + s * (5 * c[5]))))
        qdd = 2 * c[2] + s * (6 * c[3] + s * (12 * c[4] + s * (20 * c[5])))
        return np.asfortranarray(q), np.asfortranarray(qd / h), np.asfortranarray(qdd / h**2)


def _least_jerk(h: Array, q: Array, given: Array) -> Array:
    """Return derivatives (N, 2, n) at the points: those given, the free ones where the squared jerk is least.

    The minimum is a symmetric positive definite system, block tridiagonal in the pairs (v_i, a_i); it is
    solved by block elimination, which needs no pivoting.
    """
    N, n = q.shape
    free = np.isnan(given[:, :, 0])
    x = np.where(np.isnan(given), 0.0, given)
    if not free.any():
        return x
    diagonal, upper, right = np.zeros((N, 2, 2)), np.zeros((N, 2, 2)), np.zeros((N, 2, n))
    for i, step in enumerate(h):
        # the integral over a segment in terms of (q, v, a) at its ends: lengths scale as (1, h, h^2), jerk^2
        # as h^-5
        scale = np.array([1.0, step, step**2, 1.0, step, step**2])
        K = _ENERGY * np.outer(scale, scale) / step**5
        known = K @ np.concatenate([q[i, None], x[i], q[i + 1, None], x[i + 1]])
        diagonal[i] += K[1:3, 1:3]
        diagonal[i + 1] += K[4:6, 4:6]
        upper[i] = K[1:3, 4:6]
        right[i] -= known[1:3]
        right[i + 1] -= known[4:6]
    for i, j in np.argwhere(~free):
        diagonal[i, j, :] = diagonal[i, :, j] = 0.0
        diagonal[i, j, j] = 1.0
        right[i, j] = 0.0
        upper[i, j, :] = 0.0
        if i:
            upper[i - 1, :, j] = 0.0
    for i in range(1, N):
        carry = np.linalg.solve(diagonal[i - 1], upper[i - 1]).T
        diagonal[i] -= carry @ upper[i - 1]
        right[i] -= carry @ right[i - 1]
    step = np.linalg.solve(diagonal[-1], right[-1])
    x[-1] += step
    for i in reversed(range(N - 1)):
        step = np.linalg.solve(diagonal[i], right[i] - upper[i] @ step)
        x[i] += step
    return x
