"""Coefficients of Gauss collocation, computed to full double precision from their definitions."""

from __future__ import annotations

import dataclasses
from decimal import Decimal, localcontext
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Polynomial = list[Decimal]  # coefficients, lowest power first


def _evaluate(p: Polynomial, x: Decimal) -> Decimal:
    total = Decimal(0)
    for c in reversed(p):
        total = total * x + c
    return total


def _times_linear(p: Polynomial, root: Decimal) -> Polynomial:
    """Return p(x) (x - root)."""
    out = [Decimal(0), *p]
    for k, c in enumerate(p):
        out[k] -= root * c
    return out


def _legendre(n: int) -> list[Polynomial]:
    """Return Legendre polynomials 0..n on [0, 1], with P(1) = 1."""
    found: list[Polynomial] = [[Decimal(1)], [Decimal(-1), Decimal(2)]]
    for k in range(1, n):
        a, b = found[k], found[k - 1]
        longer = [Decimal(0), *[2 * c for c in a]]
        for j, c in enumerate(a):
            longer[j] -= c
        nxt = [Decimal(2 * k + 1) * c for c in longer]
        for j, c in enumerate(b):
            nxt[j] -= Decimal(k) * c
        found.append([c / Decimal(k + 1) for c in nxt])
    return found[: n + 1]


@dataclasses.dataclass(frozen=True)
class GaussTable:
    """Gauss method with s stages, order 2 s (Hairer, Lubich and Wanner 2006, section II.1.3).

    c : nodes. A : Runge-Kutta matrix; A2 = A A, for second-order equations. b : weights; b_bar = b (1 - c).
    M : takes stage values to monomial coefficients in u = c - 1. legendre : takes them to Legendre coefficients.
    """

    s: int
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
        legendre = _legendre(s)
        top = legendre[s]
        slope = [k * c for k, c in enumerate(top)][1:]
        c = []
        for guess in (np.polynomial.legendre.leggauss(s)[0] + 1) / 2:
            x = Decimal(float(guess))
            for _ in range(4):
                x -= _evaluate(top, x) / _evaluate(slope, x)
            c.append(x)
        basis: list[Polynomial] = []
        for j in range(s):
            p: Polynomial = [Decimal(1)]
            for k in range(s):
                if k != j:
                    p = [x / (c[j] - c[k]) for x in _times_linear(p, c[k])]
            basis.append(p)
        integral = [[Decimal(0), *[x / (k + 1) for k, x in enumerate(p)]] for p in basis]
        A = [[_evaluate(integral[j], c[i]) for j in range(s)] for i in range(s)]
        b = [_evaluate(integral[j], Decimal(1)) for j in range(s)]
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
        L = [[(2 * k + 1) * b[j] * _evaluate(legendre[k], c[j]) for j in range(s)] for k in range(s)]

    def array(x: list[Decimal] | list[list[Decimal]]) -> NDArray[np.float64]:
        return np.array(x, dtype=float)

    table = GaussTable(
        s,
        array(c),
        array(A),
        array(A2),
        array(b),
        array([w * (1 - x) for w, x in zip(b, c)]),
        array(M),
        array(L),
    )
    check(table)
    return table


def check(table: GaussTable) -> None:
    """Check the sums that define the method: b c^k = 1/(k+1) for k < 2s and A c^k = c^(k+1)/(k+1) for k < s."""
    for k in range(2 * table.s):
        if abs(table.b @ table.c**k - 1 / (k + 1)) > 1e-14:
            raise ArithmeticError(f"Gauss weights fail at power {k}")
    for k in range(table.s):
        if np.abs(table.A @ table.c**k - table.c ** (k + 1) / (k + 1)).max() > 1e-14:
            raise ArithmeticError(f"Gauss matrix fails at power {k}")
