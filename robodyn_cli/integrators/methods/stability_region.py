"""Linear stability of the methods: what a step makes of x' = lambda x.

A Runge-Kutta method multiplies x by R(z), z = h lambda, in each step (Hairer and Wanner 1996, section IV.2). It is
stable where |R(z)| <= 1; how far that region reaches along a direction of the complex plane limits the step.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from robodyn_cli.integrators.methods.collocation_tables import gauss_table
from robodyn_cli.integrators.methods.explicit import ExplicitRungeKutta, ExplicitTable
from robodyn_cli.integrators.methods.gauss import Gauss
from robodyn_cli.integrators.registry import methods
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

FARTHEST = 40.0  # |z| up to which the boundary is looked for; explicit methods end well before
STRICT = 1e-9  # growth per step that counts as none: rounding of R


def amplification(table: ExplicitTable, z: Array) -> Array:
    """Return R(z) of an explicit Runge-Kutta method, by its stages: k_i = 1 + z sum_j a_ij k_j."""
    z = np.asarray(z, dtype=complex)
    stages: list[Array] = []
    for row in table.A[: len(table.b)]:
        k = np.ones_like(z)
        for a, other in zip(row, stages):
            if a != 0.0:
                k = k + z * a * other
        stages.append(k)
    total = np.ones_like(z)
    for b, k in zip(table.b, stages):
        total = total + z * b * k
    return total


def radius(table: ExplicitTable, direction: Array, growth: float = STRICT) -> Array:
    """Return how far from 0 along directions (unit complex numbers) |R| stays below 1 + ``growth``."""
    direction = np.atleast_1d(np.asarray(direction, dtype=complex))
    grid = np.linspace(0.0, FARTHEST, 4001)[1:]
    outside = np.abs(amplification(table, direction[:, None] * grid)) > 1.0 + growth
    first = np.where(outside.any(axis=1), outside.argmax(axis=1), len(grid) - 1)
    high = grid[first]
    low = np.where(first > 0, grid[first - 1], 0.0)
    for _ in range(40):
        middle = 0.5 * (low + high)
        bad = np.abs(amplification(table, direction * middle)) > 1.0 + growth
        low, high = np.where(bad, low, middle), np.where(bad, middle, high)
    return low


@record
class Limit:
    """How far a method's step may go: for decaying modes along the real axis, for oscillating ones along the imaginary.

    kind : ``region`` (|R| <= 1) or ``iteration`` (an implicit method that is solved by fixed-point iteration, which
        contracts only while h |lambda| times the spectral radius of A stays below 1).
    real, imaginary : extents in |h lambda|. contraction : that the iteration needs, to be done within its rounds.
    """

    method: str
    kind: str
    real: float
    imaginary: float
    contraction: float | None = None

    def largest_step(self, eigenvalues: Array) -> float:
        """Return the largest step of an explicit method at which no decaying or oscillating mode grows (modes that grow
        by themselves set no limit); infinite where there is none."""
        modes = np.asarray(eigenvalues, dtype=complex)
        size = np.abs(modes)
        biggest = float(size.max(initial=0.0))
        modes = modes[(modes.real <= 1e-3 * size) & (size > 1e-12 * biggest)]
        if not modes.size:
            return float("inf")
        # a real part that is only rounding does not decide which side of the axis a mode is on
        modes = np.where(modes.real > 0.0, 1j * np.abs(modes), modes)
        method = methods[self.method]
        assert isinstance(method, ExplicitRungeKutta)
        table = method.table
        return float((radius(table, modes / np.abs(modes)) / np.abs(modes)).min())


@lru_cache
def limits() -> tuple[Limit, ...]:
    """Return the limits of the registered methods that have one; implicit ones that are solved exactly have none."""
    rows = []
    for name, method in methods.items():
        if isinstance(method, ExplicitRungeKutta):
            along = radius(method.table, np.array([-1.0, 1j]))
            rows.append(Limit(name, "region", float(along[0]), float(along[1])))
        elif isinstance(method, Gauss):
            reach = 1.0 / float(np.abs(np.linalg.eigvals(gauss_table(method.stages).A)).max())
            rows.append(Limit(name, "iteration", reach, reach, method.contraction))
    return tuple(rows)
