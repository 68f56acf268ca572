"""Polynomials in 60-digit arithmetic: nodes, collocation matrices and their like, rounded once.

Coefficients of Gauss collocation, computed to full double precision from their definitions, and of its dense output.

With s stages the collocation polynomial has order s inside a step whose ends have order 2 s. Where samples are wanted,
the residual d(u) = f(u, x(u)) - x-dot(u) of that polynomial is evaluated at s further nodes, integrated, and the
corrected solution is substituted once more (defect correction, Stetter 1978). What is corrected is small, so
rounding in the tables of dense output does not matter.

Coefficients of Radau IIA methods, and the eigenvalues that take their Newton systems apart.
"""

from __future__ import annotations

from decimal import Decimal, localcontext
from functools import lru_cache

import numpy as np

from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

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
    polynomials: list[Polynomial] = [[Decimal(1)], [Decimal(-1), Decimal(2)]]
    for k in range(1, n):
        a, b = polynomials[k], polynomials[k - 1]
        longer = [Decimal(0), *[2 * c for c in a]]
        for j, c in enumerate(a):
            longer[j] -= c
        nxt = [Decimal(2 * k + 1) * c for c in longer]
        for j, c in enumerate(b):
            nxt[j] -= Decimal(k) * c
        polynomials.append([c / Decimal(k + 1) for c in nxt])
    return polynomials[: n + 1]


def roots(p: Polynomial, guesses: np.ndarray) -> list[Decimal]:
    """Return roots by Newton's method from guesses of double precision."""
    slope = [k * c for k, c in enumerate(p)][1:]
    zeros = []
    for guess in guesses:
        x = Decimal(float(guess))
        for _ in range(4):
            x -= evaluate(p, x) / evaluate(slope, x)
        zeros.append(x)
    return zeros


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


@record
class RadauTable:
    """Radau IIA with s stages, order 2 s - 1 (Hairer and Wanner 1996, sections IV.5 and IV.8), padded to whole vectors.

    lanes : of a vector of stages, s or more; stages beyond s repeat the last one and count for nothing.
    shifts : lanes of a vector of eigenvalues of A^-1, one for each complex pair, the real one first.
    c : (lanes,) nodes, the last one 1. A : (lanes, s) Runge-Kutta matrix. P : (lanes, s) takes stage increments Z to
    the coefficients of u, u^2 .. u^s of x(t1 + u h) - x1.
    g : (shifts,) complex eigenvalues. to : (2 shifts, s) takes residuals of the stages to the eigenvectors, real parts
    then imaginary ones, times the eigenvalue; back : (lanes, 2 shifts) takes them back.
    e, gamma : the error is (1 - h gamma J)^-1 (gamma h f(x0) + sum e_i Z_i), gamma being 1 / g[0].
    """

    s: int
    lanes: int
    shifts: int
    c: Array
    A: Array
    P: Array
    g: Array
    to: Array
    back: Array
    e: Array
    gamma: float


def _power_of_two(n: int) -> int:
    return 1 << (n - 1).bit_length()


@lru_cache(maxsize=4)
def radau_table(s: int) -> RadauTable:
    """Return the coefficients for an odd number of stages.

    Raises
    ------
    ArithmeticError : a condition that defines the method fails.
    """
    with localcontext() as context:
        context.prec = 60
        orthogonal = legendre(s)
        # P_s - P_(s-1) has the right Radau points as roots, 1 among them
        top = [a - b for a, b in zip(orthogonal[s], [*orthogonal[s - 1], Decimal(0)])]
        approximate = np.roots([float(x) for x in reversed(top)]).real
        nodes = roots(top, np.sort(approximate))
        nodes[-1] = Decimal(1)
        A = np.array(integrals(lagrange(nodes), nodes), dtype=float)
        c = np.array(nodes, dtype=float)
    _check(c, A)
    values, vectors = np.linalg.eig(np.linalg.inv(A))
    real = int(np.argmin(np.abs(values.imag)))
    chosen = [real, *(k for k in range(s) if values[k].imag > 0 and k != real)]
    lanes, shifts = _power_of_two(s), _power_of_two(len(chosen))
    inverse = np.linalg.inv(vectors)
    g = np.full(shifts, values[chosen[-1]])
    to, back = np.zeros((2 * shifts, s)), np.zeros((lanes, 2 * shifts))
    for lane, k in enumerate(chosen):
        g[lane] = values[k]
        scaled = values[k] * inverse[k]
        twice = 1.0 if k == real else 2.0
        to[lane], to[shifts + lane] = scaled.real, scaled.imag
        back[:s, lane], back[:s, shifts + lane] = twice * vectors[:, k].real, -twice * vectors[:, k].imag
    g[0] = g[0].real
    # x(t1 + u h) - x1 at u = -1, where it is -Z_s, and at u = c_i - 1, where it is Z_i - Z_s
    u = np.array([-1.0, *(c[:-1] - 1.0)])
    differences = np.concatenate([np.zeros((1, s)), np.eye(s)[:-1]]) - np.eye(s)[-1]
    P = np.linalg.solve(u[:, None] ** np.arange(1, s + 1), differences)
    gamma = 1.0 / float(g[0].real)
    conditions = 1.0 / np.arange(1, s + 1) - gamma * (np.arange(s) == 0)
    embedded = np.linalg.solve((c[:, None] ** np.arange(s)).T, conditions)

    def padded(rows: Array) -> Array:
        return np.concatenate([rows, np.repeat(rows[-1:], lanes - s, axis=0)])

    P = np.concatenate([P, np.zeros((lanes - s, s))])
    back[s:] = back[s - 1]
    e = np.linalg.solve(A.T, embedded - A[-1])
    return RadauTable(s, lanes, shifts, padded(c), padded(A), P, g, to, back, e, gamma)


def _check(c: Array, A: Array) -> None:
    """Check what defines the method: quadrature of order 2 s - 1, collocation at every node, the last one at 1."""
    s = len(c)
    for k in range(2 * s - 1):
        if abs(A[-1] @ c**k - 1.0 / (k + 1)) > 1e-14:
            raise ArithmeticError(f"Radau weights fail at power {k}")
    for k in range(s):
        if np.abs(A @ c**k - c ** (k + 1) / (k + 1)).max() > 1e-14:
            raise ArithmeticError(f"Radau matrix fails at power {k}")
