"""Limits along a path as rows that are linear in the path's acceleration.

A path q(s) is run through as s(t). With x = s-dot^2 and u = s-double-dot

    q-dot = q' sqrt(x),    q-ddot = q' u + q'' x,    tau = M q' u + f(s, x)

so that each limit, divided by its bound, reads |A u + B x + C| <= 1; f is linear in x but for forces like viscous
friction, and is replaced by its tangent at a profile x(s) then.
"""

from __future__ import annotations

import numpy as np

from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

# places in a segment, in parts of it, at which limits are looked at; the ends count as inside of the segment
PLACES = (0.0, 0.5, 1.0)
FINE = tuple(k / 8 for k in range(9))  # and at which they are checked in the end


@record
class Rows:
    """Limits on K segments at the three places ``PLACES`` of each.

    A, B, C : (K, 3, n), of |A u + B x + C| <= 1. most : (K, 3), the largest x that the limits of speed allow.
    rest : (2, n), C at rest at both ends of the path, where friction does not act: it may help to brake until then.
    """

    A: Array
    B: Array
    C: Array
    most: Array
    rest: Array

    def values(self, u: Array, x: Array) -> Array:
        """Return A u + B x + C (K, 3, n) for u and x (K, 3)."""
        found: Array = self.A * u[..., None] + self.B * x[..., None] + self.C
        return found

    def passed(self, u: Array, x: Array) -> Passed:
        """Return by how much the limits are passed for u and x (K, 3)."""
        at_rest = self.A[[0, -1], [0, -1]] * u[[0, -1], [0, -1]][:, None] + self.rest
        return Passed.of(self.values(u, x), (x / self.most)[..., None], at_rest)


@record
class Passed:
    """By how much limits are passed in each segment, in parts of them; negative where they are not reached.

    over, under : (K, n), in the positive and the negative direction. fast : (K,), x beyond what limits of speed allow.
    """

    over: Array
    under: Array
    fast: Array

    @staticmethod
    def of(values: Array, squares: Array, at_rest: Array) -> Passed:
        """Return it for values (K, places, n), 1 on the limit, squared speeds (K, places, m), values at rest (2, n)."""
        largest, smallest = _peaks(values)
        for k in (0, -1):
            largest[k], smallest[k] = np.maximum(largest[k], at_rest[k]), np.minimum(smallest[k], at_rest[k])
        fast = _peaks(squares)[0].max(axis=1, initial=0.0)
        return Passed(largest - 1.0, -smallest - 1.0, fast - 1.0)

    @property
    def largest(self) -> float:
        """The largest part by which any limit is passed."""
        return float(max(x.max(initial=-1.0) for x in (self.over, self.under, self.fast)))

    def positive(self) -> Passed:
        """Return it with 0 where limits are not reached."""
        return Passed(*(np.maximum(x, 0.0) for x in (self.over, self.under, self.fast)))


def _peaks(values: Array) -> tuple[Array, Array]:
    """Return the largest and the smallest value (K, n) of the parabolas through each three of values (K, places, n)."""
    left, here, right = values[:, :-2:2], values[:, 1::2], values[:, 2::2]
    slope, bend = 0.5 * (right - left), 2.0 * here - left - right
    steep = np.abs(slope)
    with np.errstate(divide="ignore", invalid="ignore"):
        turn = here + 0.5 * slope * slope / bend
    largest = np.where(steep < bend, turn, np.maximum(left, right))
    smallest = np.where(steep < -bend, turn, np.minimum(left, right))
    return largest.max(axis=1), smallest.min(axis=1)
