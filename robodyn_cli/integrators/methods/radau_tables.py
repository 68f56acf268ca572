"""Coefficients of Radau IIA methods, and the eigenvalues that take their Newton systems apart."""

from __future__ import annotations

from decimal import Decimal, localcontext
from functools import lru_cache

import numpy as np

from robodyn_cli.integrators.methods.polynomials import integrals, lagrange, legendre, roots
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array


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
