"""Polynomials by their coefficients c (p, ...), lowest power first: many at once."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from robodyn_cli.spatial.algebra import Array

REAL = 1e-9  # imaginary part up to which a root counts as real
# of the largest term: a smaller one of the highest power puts other roots off by as little, but adds far ones, beside
# which eigenvalues are rounded
NOTHING = 1e-12


@lru_cache(maxsize=8)
def to_powers(points: int) -> Array:
    """Return the matrix from values at 0, 1, ... to coefficients of powers."""
    return np.asarray(np.linalg.inv(np.vander(np.arange(points, dtype=float), increasing=True)))


def value(c: Array, x: Array) -> Array:
    """Return polynomials with coefficients c (p, ...) at x."""
    found = np.zeros_like(x)
    for row in c[::-1]:
        found = found * x + row
    return found


def derivative(c: Array) -> Array:
    """Return the coefficients of the derivatives of polynomials; those of a constant are one zero."""
    found: Array = c[1:] * np.arange(1.0, len(c)).reshape(-1, *[1] * (c.ndim - 1))
    return found if len(found) else np.zeros((1, *c.shape[1:]))


def real_roots(c: Array, end: Array) -> Array:
    """Return the real roots (p - 1, n) of polynomials with coefficients c (p, n) between 0 and ``end`` (n,), in no
    order; in place of each root elsewhere stands ``end``. They are eigenvalues of companion matrices."""
    count = len(c) - 1
    found: Array = np.tile(end, (count, 1))
    for _ in range(count):  # roots at 0 are none, and beside far ones others are rounded off
        c = np.where(c[0] == 0.0, np.roll(c, -1, axis=0), c)
    size = np.abs(c) * end ** np.arange(count + 1.0)[:, None]
    own = size[0] <= size[1:].sum(axis=0)  # others cannot be zero there
    if not count or not own.any():
        return found
    straight = size[-1] <= NOTHING * size.max(axis=0)  # of a lower degree
    found[:-1, own & straight] = real_roots(c[:-1, own & straight], end[own & straight])
    own &= ~straight
    companions = np.zeros((np.count_nonzero(own), count, count))
    companions[:, 0] = -(c[-2::-1, own] / c[-1, own]).T
    companions[:, np.arange(1, count), np.arange(count - 1)] = 1.0
    roots = np.linalg.eigvals(companions).T
    inside = (np.abs(roots.imag) < REAL) & (roots.real > 0.0) & (roots.real < end[own])
    found[:, own] = np.where(inside, roots.real, end[own])
    return found
