"""Small dense linear algebra on numbers or expressions, without pivoting."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

from robodyn_cli.spatial.algebra import Matrix, Values, Vector, zeros


@dataclasses.dataclass(frozen=True)
class LdlFactor:
    """Symmetric positive definite A = P^T L D L^T P; zeros of A that stay zero cost nothing.

    L : unit lower triangle (below the diagonal only). inverse : inverses of the pivots D. order : the
    permutation; position k of the factor is row order[k] of A.
    """

    L: Matrix
    inverse: tuple[Any, ...]
    order: tuple[int, ...]

    @staticmethod
    def of(A: Matrix, order: Sequence[int] | None = None) -> LdlFactor:
        """Factor A. Eliminating the leaves of a tree first keeps the branches apart."""
        n = A.shape[0]
        order = tuple(range(n)) if order is None else tuple(order)
        L = zeros(n, n)
        LD = zeros(n, n)  # L times D, which falls out before the division
        inverse: list[Any] = []
        for j in range(n):
            pivot = A[order[j], order[j]]
            for k in range(j):
                pivot = pivot - L[j, k] * LD[j, k]
            inverse.append(1.0 / pivot)
            for i in range(j + 1, n):
                entry = A[order[i], order[j]]
                for k in range(j):
                    entry = entry - L[i, k] * LD[j, k]
                LD[i, j] = entry
                L[i, j] = entry * inverse[j]
        return LdlFactor(L, tuple(inverse), order)

    def forward(self, b: Values) -> Vector:
        """Return L^-1 P b."""
        n = len(self.inverse)
        x = zeros(n)
        for i in range(n):
            entry = b[self.order[i]]
            for k in range(i):
                entry = entry - self.L[i, k] * x[k]
            x[i] = entry
        return x

    def backward(self, y: Values) -> Vector:
        """Return P^T L^-T y."""
        n = len(self.inverse)
        x = zeros(n)
        for i in reversed(range(n)):
            entry = y[i]
            for k in range(i + 1, n):
                entry = entry - self.L[k, i] * x[k]
            x[i] = entry
        out = zeros(n)
        for i in range(n):
            out[self.order[i]] = x[i]
        return out

    def solve(self, b: Values) -> Vector:
        """Return A^-1 b."""
        return self.backward([x * d for x, d in zip(self.forward(b), self.inverse)])


@dataclasses.dataclass(frozen=True)
class LuFactor:
    """A = L U without pivoting, L with unit diagonal; zeros of A that stay zero cost nothing.

    entries : L below and U on and above the diagonal, the diagonal of U inverted.
    """

    entries: Matrix

    @staticmethod
    def of(A: Matrix) -> LuFactor:
        """Factor A by Crout's scheme, row by row."""
        n = A.shape[0]
        F = zeros(n, n)
        for i in range(n):
            for j in range(n):
                entry = A[i, j]
                for k in range(min(i, j)):
                    entry = entry - F[i, k] * F[k, j]
                if j < i:
                    entry = entry * F[j, j]
                F[i, j] = 1.0 / entry if i == j else entry
        return LuFactor(F)

    def solve(self, b: Values) -> Vector:
        """Return A^-1 b."""
        n = self.entries.shape[0]
        x = zeros(n)
        for i in range(n):
            entry = b[i]
            for k in range(i):
                entry = entry - self.entries[i, k] * x[k]
            x[i] = entry
        for i in reversed(range(n)):
            entry = x[i]
            for k in range(i + 1, n):
                entry = entry - self.entries[i, k] * x[k]
            x[i] = entry * self.entries[i, i]
        return x
