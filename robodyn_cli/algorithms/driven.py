"""Driven joints of a mechanism with loops: their accelerations by their torques, and the torques for accelerations."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from robodyn_cli.algorithms.linear import LdlFactor, minimum_degree
from robodyn_cli.spatial.algebra import Array, Matrix, Values, Vector, dot, identity, vector, zeros


class DrivenJoints:
    """The driven coordinates d of M qdd = f + B tau + Psi^T lambda, Psi qdd + gamma = 0, without qdd and lambda:

        qdd_d = a_0 + A tau,   A = B^T P B,   P = M^-1 - M^-1 Psi^T (Psi M^-1 Psi^T)^-1 Psi M^-1

    A (n, n) is symmetric. Where n driven joints move n degrees of freedom it is positive definite but at dead points.
    With more joints than freedoms it has their rank, and A^+ gives torques of least norm for the accelerations nearest
    to those asked for: the torques that ``solve.load_sharing.share`` finds for a motion that the loops allow.

    Parameters
    ----------
    factor : of M. psi : (m, nv), independent rows. driven : their velocity coordinates. directions : (n, f) columns
    that span the range of A at some pose, where there are more joints than freedoms f; None otherwise.
    """

    def __init__(
        self, factor: LdlFactor, psi: Matrix, driven: Sequence[int], directions: Array | None = None
    ) -> None:
        self.factor, self.psi, self.directions = factor, psi, directions
        units = identity(psi.shape[1])
        self._unit = [factor.forward(units[k]) for k in driven]
        self._rows = [factor.forward(row) for row in psi]
        gram = self._products(self._rows, self._rows)
        self._loops = LdlFactor.of(gram, minimum_degree(gram))
        # what torques and loads give in the rows of the loops, whitened by the factor of Psi M^-1 Psi^T
        self._hold = [self._loops.forward(column) for column in self._products(self._unit, self._rows)]
        self.A = self._products(self._unit, self._unit)
        for i, x in enumerate(self._hold):
            for j, y in enumerate(self._hold):
                self.A[i, j] = self.A[i, j] - self._weighted(self._loops, x, y)

    def free(self, f: Values, gamma: Values) -> Vector:
        """Return a_0 (n,), the accelerations of the driven joints without their torques; f (nv,), gamma (m,)."""
        load = self.factor.forward(f)
        rows = [g + self._weighted(self.factor, y, load) for g, y in zip(gamma, self._rows)]
        held = self._loops.forward(rows)
        return vector(
            [
                self._weighted(self.factor, x, load) - self._weighted(self._loops, y, held)
                for x, y in zip(self._unit, self._hold)
            ]
        )

    def torques(self, accelerations: Values) -> Vector:
        """Return A^+ r (n,) of accelerations r that the torques give beside a_0.

        Of more joints than freedoms: A^+ = C^+T K C^+ with C = A S, K = S^T A S and the directions S.
        """
        if self.directions is None:
            return LdlFactor.of(self.A).solve(accelerations)
        C = self.A @ self.directions
        K = self.directions.T @ C
        normal = LdlFactor.of(C.T @ C)
        return C @ normal.solve(K @ normal.solve(C.T @ vector(accelerations)))

    def _products(self, some: Sequence[Vector], others: Sequence[Vector]) -> Matrix:
        found = zeros(len(some), len(others))
        for i, x in enumerate(some):
            for k, y in enumerate(others):
                found[i, k] = self._weighted(self.factor, x, y)
        return found

    @staticmethod
    def _weighted(factor: LdlFactor, x: Values, y: Values) -> Any:
        """Return x^T D^-1 y."""
        return dot([a * d for a, d in zip(x, factor.inverse)], y)
