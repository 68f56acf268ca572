"""Coefficients of the backward differentiation formulas of order 1 to 5 (Shampine and Reichelt 1997)."""

from __future__ import annotations

from fractions import Fraction
from math import comb

import numpy as np

HIGHEST = 5
ROWS = HIGHEST + 3  # backward differences of a component, those for the error estimates included
# of the numerical differentiation formulas: a smaller error at a little less stability; order 5 has nothing to gain
_KAPPA = [Fraction(x) for x in ("0", "-0.185", "-1/9", "-0.0823", "-0.0415", "0")]
_GAMMA = [sum((Fraction(1, j) for j in range(1, k + 1)), Fraction(0)) for k in range(HIGHEST + 1)]
_ALPHA = [(1 - kappa) * gamma for kappa, gamma in zip(_KAPPA, _GAMMA)]
ALPHA = [float(alpha) for alpha in _ALPHA]
ERROR = [
    *(float(kappa * gamma + Fraction(1, k + 1)) for k, (kappa, gamma) in enumerate(zip(_KAPPA, _GAMMA))),
    0.0,
]


def masks() -> np.ndarray:
    """Return (orders, ROWS): 1 where a difference belongs to the order's polynomial."""
    return np.array([[float(j <= k) for j in range(ROWS)] for k in range(ROWS)])


def histories() -> np.ndarray:
    """Return (orders, ROWS): gamma_j / alpha_k, the weights of the differences in psi."""
    out = np.zeros((ROWS, ROWS))
    for k in range(1, HIGHEST + 1):
        out[k, 1 : k + 1] = [float(gamma / _ALPHA[k]) for gamma in _GAMMA[1 : k + 1]]
    return out


def rescaling() -> list[list[list[float]]]:
    """Return T[j][l], polynomials in r (lowest power first): differences for steps r h are sum_l T[j][l](r) D_l.

    They come from the polynomial D_0 + sum D_l (s)(s + 1)..(s + l - 1) / l! at s = -i r, whose differences they are;
    T[j][l] vanishes for l < j.
    """
    basis = [[Fraction(1)]]
    for m in range(HIGHEST):
        last = basis[-1]
        # times (s + m) / (m + 1)
        grown = [Fraction(0)] * (len(last) + 1)
        for n, c in enumerate(last):
            grown[n] += c * m / (m + 1)
            grown[n + 1] += c / (m + 1)
        basis.append(grown)
    table = []
    for j in range(HIGHEST + 1):
        # the j-th difference of s^n at s = -i r is a multiple of r^n
        row = []
        for p in basis:
            sums = [
                sum((-1) ** i * comb(j, i) * Fraction(-i) ** n for i in range(j + 1)) for n in range(len(p))
            ]
            row.append([float(c * x) for c, x in zip(p, sums)])
        table.append(row)
    return table
