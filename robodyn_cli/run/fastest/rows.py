"""Limits along a path as rows that are linear in the path's acceleration.

A path q(s) is run through as s(t). With x = s-dot^2 and u = s-double-dot

    q-dot = q' sqrt(x),    q-ddot = q' u + q'' x,    tau = M q' u + f(s, x)

so that each limit, divided by its bound, reads |A u + B x + C| <= 1; f is linear in x but for forces like viscous
friction, and is replaced by its tangent at a profile x(s) then.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

# places in a segment, in parts of it, at which limits are looked at; the ends count as inside of the segment
PLACES = (0.0, 0.25, 0.5, 0.75, 1.0)
FINE = tuple(k / 8 for k in range(9))  # and at which they are checked in the end
SAMPLES = 17  # of the polynomials through the values there


@record
class Rows:
    """Limits on K segments at the five ``PLACES`` of each.

    A, B, C : (K, 5, n), of |A u + B x + C| <= 1. most : (K, 5), the largest x that the limits of speed allow.
    rest : (2, n), C at rest at both ends of the path, where friction does not act: it may help to brake until then.
    """

    A: Array
    B: Array
    C: Array
    most: Array
    rest: Array

    def values(self, u: Array, x: Array) -> Array:
        """Return A u + B x + C (K, 5, n) for u and x (K, 5)."""
        found: Array = self.A * u[..., None] + self.B * x[..., None] + self.C
        return found

    def passed(self, u: Array, x: Array) -> tuple[Array, Array, Array]:
        """Return by how much each limit is passed in each segment: both ways (K, n), and that of speed (K,)."""
        values = self.values(u, x)
        over, under = peak(values), peak(-values)
        for k in (0, -1):
            still = self.A[k, k] * u[k, k] + self.rest[k]
            over[k], under[k] = np.maximum(over[k], still), np.maximum(under[k], -still)
        return over - 1.0, under - 1.0, peak((x / self.most)[..., None])[:, 0] - 1.0


@lru_cache(maxsize=2)
def _interpolation(places: int) -> Array:
    """Return the matrix from values at so many evenly spaced places to those at the ``SAMPLES``."""
    vander = np.polynomial.chebyshev.chebvander
    at, to = (vander(np.linspace(-1.0, 1.0, n), places - 1) for n in (places, SAMPLES))
    return np.asarray(to @ np.linalg.inv(at))


def peak(values: Array) -> Array:
    """Return the largest value (K, n) of (K, places, n), of the polynomials through evenly spaced places."""
    fine = np.matmul(_interpolation(values.shape[1]), values)
    k = np.clip(fine.argmax(axis=1), 1, SAMPLES - 2)[:, None]
    left, here, right = (np.take_along_axis(fine, k + i, axis=1)[:, 0] for i in (-1, 0, 1))
    bend = np.maximum(
        2.0 * here - left - right, 1e-300
    )  # of the parabola through the largest and its neighbours
    place = np.clip(0.5 * (right - left) / bend, -1.0, 1.0)
    return np.asarray(here + 0.5 * place * (right - left - place * bend))
