"""Polynomials in 60-digit arithmetic: nodes, collocation matrices and their like, rounded once."""

from __future__ import annotations

from decimal import Decimal

import numpy as np

Polynomial = list[Decimal]  # coefficients, lowest power first


def evaluate(p: Polynomial, x: Decimal) -> Decimal:
    total = Decimal(0)
    for c in reversed(p):
        total = total * x + c
    return total


def times_linear(p: Polynomial, root: Decimal) -> Polynomial:
    """Return p(x) (x - root)."""
    out = [Decimal(0), *p]
    for k, c in enumerate(p):
        out[k] -= root * c
    return out


def legendre(n: int) -> list[Polynomial]:
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


def roots(p: Polynomial, guesses: np.ndarray) -> list[Decimal]:
    """Return roots by Newton's method from guesses of double precision."""
    slope = [k * c for k, c in enumerate(p)][1:]
    found = []
    for guess in guesses:
        x = Decimal(float(guess))
        for _ in range(4):
            x -= evaluate(p, x) / evaluate(slope, x)
        found.append(x)
    return found


def lagrange(c: list[Decimal]) -> list[Polynomial]:
    """Return the polynomials that are 1 at one node and 0 at the others."""
    basis: list[Polynomial] = []
    for j in range(len(c)):
        p: Polynomial = [Decimal(1)]
        for k in range(len(c)):
            if k != j:
                p = [x / (c[j] - c[k]) for x in times_linear(p, c[k])]
        basis.append(p)
    return basis


def integrals(basis: list[Polynomial], ends: list[Decimal]) -> list[list[Decimal]]:
    """Return the integral of each polynomial from 0 to each end, a row an end."""
    integral = [[Decimal(0), *[x / (k + 1) for k, x in enumerate(p)]] for p in basis]
    return [[evaluate(p, end) for p in integral] for end in ends]
