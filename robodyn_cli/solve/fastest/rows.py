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
PLACES = (0.0, 0.25, 0.5, 0.75, 1.0)


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


def peak(values: Array) -> Array:
    """Return the largest value (K, n) of (K, 5, n), between the five places by parabolas."""
    top = values.max(axis=1)
    for k in range(1, len(PLACES) - 1):
        left, here, right = values[:, k - 1], values[:, k], values[:, k + 1]
        bend = 2.0 * here - left - right
        with np.errstate(all="ignore"):
            found = here + 0.125 * (right - left) ** 2 / bend
        inside = (bend > 0.0) & (np.abs(right - left) <= 2.0 * bend)
        top = np.where(inside, np.maximum(top, found), top)
    return top
