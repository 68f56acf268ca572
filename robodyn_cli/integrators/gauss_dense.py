"""Dense output of the Gauss method at the accuracy of its steps.

The collocation polynomial has order 8 inside a step whose ends have order 16. Where samples are wanted, the
residual d(u) = f(u, x(u)) - x-dot(u) of that polynomial is evaluated at eight further nodes, integrated, and the
corrected solution is substituted once more (defect correction, Stetter 1978). What is corrected is small, so
rounding in these tables does not matter.
"""

from __future__ import annotations

import dataclasses
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.integrators.gauss_tables import gauss_table

Array = NDArray[Any]
WIDTH = 24  # coefficients of one correction, padded to whole vectors


@dataclasses.dataclass(frozen=True)
class DenseTable:
    """Tables over 16 nodes: the 8 of Gauss (group 0) and 8 between them (group 1), in [0, 1].

    extra : nodes of group 1. value, once, twice : (8, 8), the collocation polynomial's rate, its integral and its
    double integral at group 1, from the stage rates. inner_once, inner_twice : (2, 2, 8, 8) integrals of the
    residual's interpolant [at group, from group]. once_coefficients, twice_coefficients : (2, 24, 8) monomials in
    x = 2 u + 1 of these integrals, from group.
    """

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


@lru_cache(maxsize=2)
def dense_table(s: int = 8) -> DenseTable:
    """Return the tables for s stages."""
    c = gauss_table(s).c
    # between neighbours in the angle of the cosine, close to Chebyshev's points; the end of the step is not among
    # them, because steps end where the right-hand side jumps
    angle = np.append(np.arccos(1 - 2 * c), np.pi)
    extra = (1 - np.cos((angle[1:] + angle[:-1]) / 2)) / 2
    stage = np.linalg.inv(_powers(c, s))
    stage_once, stage_twice = _integrate(stage), _integrate(_integrate(stage))
    nodes = [c, extra]
    both = np.linalg.inv(_powers(np.concatenate(nodes), 2 * s))
    both_once, both_twice = _integrate(both), _integrate(_integrate(both))

    def at_groups(table: Array) -> Array:
        values = [_powers(x, table.shape[0]) @ table for x in nodes]
        return np.array([[v[:, :s], v[:, s:]] for v in values])

    def padded(table: Array) -> Array:
        out = np.zeros((WIDTH, 2 * s))
        out[: table.shape[0]] = table
        return np.array([out[:, :s], out[:, s:]])

    return DenseTable(
        extra,
        _powers(extra, s) @ stage,
        _powers(extra, s + 1) @ stage_once,
        _powers(extra, s + 2) @ stage_twice,
        at_groups(both_once),
        at_groups(both_twice),
        padded(both_once),
        padded(both_twice),
    )
