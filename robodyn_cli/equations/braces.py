"""Inertias for prescribed joints that feel none of their own, without which M would have no inverse.

The acceleration a_j of such a joint is given, so an inertia b_j of any size changes nothing but the force that drives
it, and -b_j a_j takes that off again: with b_j in M and -b_j a_j in h, motion and multipliers are the mechanism's.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from robodyn_cli.expr.graph import is_nonzero
from robodyn_cli.spatial.algebra import Matrix, Vector

if TYPE_CHECKING:
    from robodyn_cli.equations.constraints import Constraints

Braces = Mapping[int, float]  # b_j by velocity coordinate


def with_inertia(M: Matrix, braces: Braces) -> Matrix:
    """Return M + b."""
    for k, inertia in braces.items():
        M[k, k] = M[k, k] + inertia
    return M


def with_force(h: Vector, braces: Braces, constraints: Constraints) -> Vector:
    """Return h - b a with the accelerations a that ``constraints`` prescribe."""
    for i in constraints.prescribed:
        row = constraints.rows[i]
        for k, x in enumerate(row.psi):
            if k in braces and is_nonzero(x):
                h[k] = h[k] + braces[k] * row.gamma  # which is -a
    return h
