"""Small dense linear algebra on numbers or expressions, without pivoting."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from robodyn_cli.spatial.algebra import Matrix, Vector, zeros


def factor_ldl(A: Matrix, order: Sequence[int] | None = None) -> tuple[Matrix, list[Any]]:
    """Factor a symmetric positive definite matrix as L D L^T; zeros of A that stay zero cost nothing.

    Returns
    -------
    L : unit lower triangle (below the diagonal only). d : the inverses of the pivots.
    """
    n = A.shape[0]
    L = zeros(n, n)
    D: list[Any] = []
    inverse: list[Any] = []
    for j in range(n):
        pivot = A[j, j]
        scaled = []
        for k in range(j):
            w = L[j, k] * D[k]
            scaled.append(w)
            pivot = pivot - L[j, k] * w
        D.append(pivot)
        inverse.append(1.0 / pivot)
        for i in range(j + 1, n):
            entry = A[i, j]
            for k in range(j):
                entry = entry - L[i, k] * scaled[k]
            L[i, j] = entry * inverse[j]
    return L, inverse


def solve_ldl(L: Matrix, inverse: Sequence[Any], b: Sequence[Any]) -> Vector:
    """Solve L D L^T x = b."""
    n = len(inverse)
    x = zeros(n)
    for i in range(n):
        entry = b[i]
        for k in range(i):
            entry = entry - L[i, k] * x[k]
        x[i] = entry
    for i in range(n):
        x[i] = x[i] * inverse[i]
    for i in reversed(range(n)):
        entry = x[i]
        for k in range(i + 1, n):
            entry = entry - L[k, i] * x[k]
        x[i] = entry
    return x
