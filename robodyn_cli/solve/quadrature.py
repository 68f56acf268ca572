"""Integrals of sampled functions, and of their positive part.

Over each interval the polynomial of degree 5 through the six nearest samples is integrated exactly (error
h^7 y^(6) an interval); where the samples change sign, the positive part is taken of that polynomial, cut at
its root. With fewer than six samples the degree is that of all of them.
"""

from __future__ import annotations

import itertools
from functools import lru_cache

import numpy as np

from robodyn_cli.spatial.algebra import Array

POINTS = 6


def integrate(y: Array, h: float) -> Array:
    """Return the integrals (n,) of y (T, n), samples a time h apart."""
    return np.asarray(_increments(y, h).sum(axis=0))


def integrate_positive(y: Array, h: float) -> Array:
    """Return the integrals (n,) of max(y, 0) for y (T, n), samples a time h apart."""
    pieces = np.where((y[:-1] > 0.0) & (y[1:] > 0.0), _increments(y, h), 0.0)
    mixed = (y[:-1] > 0.0) != (y[1:] > 0.0)
    for k, column in np.argwhere(mixed):
        first, _ = _stencil(len(y), k)
        points = min(POINTS, len(y))
        pieces[k, column] = h * _positive_piece(y[first : first + points, column], k - first)
    return np.asarray(pieces.sum(axis=0))


def root_mean_square(y: Array, h: float) -> Array:
    """Return the roots (n,) of the time averages of y^2 for y (T, n), samples a time h apart."""
    return np.sqrt(np.maximum(0.0, integrate(y * y, h) / (h * (len(y) - 1))))


def root_mean_square_over(times: Array, y: Array) -> Array:
    """Return the roots (n,) of the time averages of y^2 for y (T, n) at times (T,).

    Of uniform samples as ``root_mean_square``; of others by the trapezoidal rule, where they are finite.
    """
    if len(times) < 2:
        return np.asarray(np.abs(y).max(axis=0))
    steps = np.diff(times)
    if np.all(np.isfinite(y)) and float(np.ptp(steps)) <= 1e-9 * float(steps.max()):
        return root_mean_square(y, float(times[-1] - times[0]) / len(steps))
    found = np.zeros(y.shape[1])
    for k, column in enumerate(y.T):
        known = np.isfinite(column)
        t, square = times[known], column[known] ** 2
        if len(t) > 1:
            found[k] = np.sqrt(np.sum(np.diff(t) * (square[1:] + square[:-1])) / 2.0 / (t[-1] - t[0]))
    return found


def _stencil(samples: int, k: int) -> tuple[int, int]:
    """Return the first sample of the polynomial over interval k, and the interval's place in it."""
    points = min(POINTS, samples)
    first = min(max(k - points // 2 + 1, 0), samples - points)
    return first, k - first


@lru_cache(maxsize=64)
def _weights(points: int, place: int) -> Array:
    """Return the weights (points,) of the integral over [place, place + 1] of the interpolant at 0, 1, ..."""
    powers = np.arange(points)
    nodes = np.arange(points, dtype=float)[None, :] - place
    moments = 1.0 / (powers + 1.0)
    return np.asarray(np.linalg.solve(nodes ** powers[:, None], moments))


def _increments(y: Array, h: float) -> Array:
    """Return the integrals (T - 1, n) over each interval."""
    samples = len(y)
    points = min(POINTS, samples)
    out = np.zeros((samples - 1, y.shape[1]))
    middle = points // 2 - 1
    inner = samples - points + 1  # intervals whose stencil is centred
    w = _weights(points, middle)
    for j in range(points):
        out[middle : middle + inner] += w[j] * y[j : j + inner]
    for k in [*range(middle), *range(middle + inner, samples - 1)]:
        first, place = _stencil(samples, k)
        out[k] = _weights(points, place) @ y[first : first + points]
    return h * out


def _positive_piece(y: Array, place: int) -> float:
    """Return the integral over [place, place + 1] of the interpolant of y at 0, 1, ... where positive."""
    x = np.arange(len(y), dtype=float) - place
    p = np.linalg.solve(np.vander(x), y)
    roots = np.roots(p).astype(complex)
    inside = [float(r.real) for r in roots if abs(r.imag) < 1e-9 and 0.0 < r.real < 1.0]
    cuts = [0.0, *sorted(inside), 1.0]
    primitive = np.polyint(p)
    total = 0.0
    for a, b in itertools.pairwise(cuts):
        if np.polyval(p, 0.5 * (a + b)) > 0.0:
            total += float(np.polyval(primitive, b) - np.polyval(primitive, a))
    return total
