"""Coefficients of Gauss collocation, computed to full double precision from their definitions."""

from __future__ import annotations

from decimal import Decimal, localcontext
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.integrators.methods.polynomials import evaluate, integrals, lagrange, legendre, roots
from robodyn_cli.record import record


@record
class GaussTable:
    """Gauss method with s stages, order 2 s (Hairer, Lubich and Wanner 2006, section II.1.3), padded to whole vectors.

    Stages beyond s repeat the last one and count for nothing: their columns and weights are zero.

    c : nodes. A : Runge-Kutta matrix; A2 = A A, for second-order equations. b : weights; b_bar = b (1 - c).
    M : takes stage values to monomial coefficients in u = c - 1. legendre : takes them to Legendre coefficients.
    """

    s: int
    lanes: int
    c: NDArray[np.float64]
    A: NDArray[np.float64]
    A2: NDArray[np.float64]
    b: NDArray[np.float64]
    b_bar: NDArray[np.float64]
    M: NDArray[np.float64]
    legendre: NDArray[np.float64]


@lru_cache(maxsize=8)
def gauss_table(s: int) -> GaussTable:
    """Return the coefficients for s stages."""
    with localcontext() as context:
        context.prec = 60
        orthogonal = legendre(s)
        # Golub and Welsch 1969: the roots on [-1, 1] are eigenvalues of the recurrence
        n = np.arange(1, s)
        recurrence = np.diag(n / np.sqrt(4.0 * n**2 - 1.0), -1)
        c = roots(orthogonal[s], (np.linalg.eigvalsh(recurrence) + 1) / 2)
        basis = lagrange(c)
        *A, b = integrals(basis, [*c, Decimal(1)])
        A2 = [[sum((A[i][k] * A[k][j] for k in range(s)), Decimal(0)) for j in range(s)] for i in range(s)]
        # Taylor shift of each basis polynomial to u = x - 1
        M = [[Decimal(0)] * s for _ in range(s)]
        for j, p in enumerate(basis):
            shifted = list(p)
            for start in range(s - 1):
                for k in range(s - 2, start - 1, -1):
                    shifted[k] += shifted[k + 1]
            for k in range(s):
                M[k][j] = shifted[k]
        L = [[(2 * k + 1) * b[j] * evaluate(orthogonal[k], c[j]) for j in range(s)] for k in range(s)]

    def array(x: list[Decimal] | list[list[Decimal]]) -> NDArray[np.float64]:
        return np.array(x, dtype=float)

    lanes = padded_width(s)
    nodes, weights, matrix = array(c), array(b), array(A)
    check(nodes, weights, matrix)
    more = lanes - s

    def vector(x: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.append(x, np.zeros(more))

    def columns(x: NDArray[np.float64], like_last: bool) -> NDArray[np.float64]:
        rows = np.concatenate([x, np.repeat(x[-1:] * float(like_last), more, axis=0)])
        return np.concatenate([rows, np.zeros((lanes, more))], axis=1)

    return GaussTable(
        s,
        lanes,
        np.append(nodes, np.repeat(nodes[-1], more)),
        columns(matrix, like_last=True),
        columns(array(A2), like_last=True),
        vector(weights),
        vector(array([w * (1 - x) for w, x in zip(b, c)])),
        columns(array(M), like_last=False),
        np.concatenate([array(L), np.zeros((s, more))], axis=1),
    )


def padded_width(s: int) -> int:
    """Return the lanes of the shortest vector that holds s entries."""
    return 1 << (s - 1).bit_length()


def check(c: NDArray[np.float64], b: NDArray[np.float64], A: NDArray[np.float64]) -> None:
    """Check the sums that define the method: b c^k = 1/(k+1) for k < 2s and A c^k = c^(k+1)/(k+1) for k < s."""
    for k in range(2 * len(c)):
        if abs(b @ c**k - 1 / (k + 1)) > 1e-14:
            raise ArithmeticError(f"Gauss weights fail at power {k}")
    for k in range(len(c)):
        if np.abs(A @ c**k - c ** (k + 1) / (k + 1)).max() > 1e-14:
            raise ArithmeticError(f"Gauss matrix fails at power {k}")
