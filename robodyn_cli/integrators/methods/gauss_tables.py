"""Coefficients of Gauss collocation, computed to full double precision from their definitions, and of its dense output.

With s stages the collocation polynomial has order s inside a step whose ends have order 2 s. Where samples are wanted,
the residual d(u) = f(u, x(u)) - x-dot(u) of that polynomial is evaluated at s further nodes, integrated, and the
corrected solution is substituted once more (defect correction, Stetter 1978). What is corrected is small, so
rounding in the tables of dense output does not matter.
"""

from __future__ import annotations

from decimal import Decimal, localcontext
from functools import lru_cache

import numpy as np

from robodyn_cli.integrators.methods.polynomials import evaluate, integrals, lagrange, legendre, roots
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array


@record
class GaussTable:
    """Gauss method with s stages, order 2 s (Hairer, Lubich and Wanner 2006, section II.1.3), padded to whole vectors.

    Stages beyond s repeat the last one and count for nothing: their columns and weights are zero.

    c : nodes. A : Runge-Kutta matrix; A2 = A A, for second-order equations. b : weights; b_bar = b (1 - c).
    M : takes stage values to monomial coefficients in u = c - 1. legendre : takes them to Legendre coefficients.
    """

    s: int
    lanes: int
    c: Array
    A: Array
    A2: Array
    b: Array
    b_bar: Array
    M: Array
    legendre: Array


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

    def array(x: list[Decimal] | list[list[Decimal]]) -> Array:
        return np.array(x, dtype=float)

    lanes = padded_width(s)
    nodes, weights, matrix = array(c), array(b), array(A)
    check(nodes, weights, matrix)
    more = lanes - s

    def vector(x: Array) -> Array:
        return np.append(x, np.zeros(more))

    def columns(x: Array, like_last: bool) -> Array:
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


def check(c: Array, b: Array, A: Array) -> None:
    """Check the sums that define the method: b c^k = 1/(k+1) for k < 2s and A c^k = c^(k+1)/(k+1) for k < s."""
    for k in range(2 * len(c)):
        if abs(b @ c**k - 1 / (k + 1)) > 1e-14:
            raise ArithmeticError(f"Gauss weights fail at power {k}")
    for k in range(len(c)):
        if np.abs(A @ c**k - c ** (k + 1) / (k + 1)).max() > 1e-14:
            raise ArithmeticError(f"Gauss matrix fails at power {k}")


@record
class DenseTable:
    """Tables over 2 s nodes: the s of Gauss (group 0) and s between them (group 1), in [0, 1], padded to m lanes.

    width : coefficients of one correction, 2 s + 2 padded to whole vectors. extra : nodes of group 1. value, once,
    twice : (m, m), the collocation polynomial's rate, its integral and its double integral at group 1, from the stage
    rates. inner_once, inner_twice : (2, 2, m, m) integrals of the residual's interpolant [at group, from group].
    once_coefficients, twice_coefficients : (2, width, m) monomials in x = 2 u + 1 of these integrals, from group.
    """

    width: int
    extra: Array
    value: Array
    once: Array
    twice: Array
    inner_once: Array
    inner_twice: Array
    once_coefficients: Array
    twice_coefficients: Array


def _powers(c: Array, n: int) -> Array:
    """Return x^k at c, x = 2 c - 1."""
    return np.vander(2 * c - 1, n, increasing=True)


def _integrate(coefficients: Array) -> Array:
    """Integrate monomials in x over c from 0 (x = -1): dc = dx / 2. Rows are powers."""
    n = coefficients.shape[0]
    out = np.zeros((n + 1, coefficients.shape[1]))
    out[1:] = coefficients / (2.0 * np.arange(1, n + 1))[:, None]
    out[0] = -((-1.0) ** np.arange(1, n + 1)) @ out[1:]
    return out


def dense_width(s: int) -> int:
    """Return the coefficients of one correction: 2 s + 2, padded to whole vectors."""
    m = padded_width(s)
    return -(-(2 * s + 2) // m) * m


@lru_cache(maxsize=8)
def dense_table(s: int = 8) -> DenseTable:
    """Return the tables for s stages."""
    c = gauss_table(s).c[:s]
    m, width = padded_width(s), dense_width(s)
    # between neighbours in the angle of the cosine, close to Chebyshev's points; the end of the step is not among
    # them, because steps end where the right-hand side jumps
    angle = np.append(np.arccos(1 - 2 * c), np.pi)
    extra = (1 - np.cos((angle[1:] + angle[:-1]) / 2)) / 2
    stage = np.linalg.inv(_powers(c, s))
    stage_once, stage_twice = _integrate(stage), _integrate(_integrate(stage))
    nodes = [c, extra]
    both = np.linalg.inv(_powers(np.concatenate(nodes), 2 * s))
    both_once, both_twice = _integrate(both), _integrate(_integrate(both))

    def square(table: Array) -> Array:
        out = np.zeros((m, m))
        out[:s, :s] = table
        return out

    def at_groups(table: Array) -> Array:
        values = [_powers(x, table.shape[0]) @ table for x in nodes]
        return np.array([[square(v[:, :s]), square(v[:, s:])] for v in values])

    def padded(table: Array) -> Array:
        out = np.zeros((2, width, m))
        out[0, : table.shape[0], :s], out[1, : table.shape[0], :s] = table[:, :s], table[:, s:]
        return out

    return DenseTable(
        width,
        np.append(extra, np.repeat(extra[-1], m - s)),
        square(_powers(extra, s) @ stage),
        square(_powers(extra, s + 1) @ stage_once),
        square(_powers(extra, s + 2) @ stage_twice),
        at_groups(both_once),
        at_groups(both_twice),
        padded(both_once),
        padded(both_twice),
    )
