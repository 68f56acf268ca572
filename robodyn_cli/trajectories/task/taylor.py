"""Exact derivatives of composed functions, by arithmetic of truncated Taylor series.

A series is an array (n + 1, T, ...): f(x + h) = sum_i f[i] h^i at T places, so the i-th derivative is i! f[i]
(Griewank and Walther 2008, chapter 13).
"""

from __future__ import annotations

import math

import numpy as np

from robodyn_cli.spatial.algebra import Array


def constant(value: Array, like: Array) -> Array:
    """Return the series of a value (...) that does not change, of the order and at the places of another."""
    series = np.zeros((*like.shape[:2], *np.shape(value)))
    series[0] = value
    return series


def scaled(a: Array, b: Array) -> Array:
    """Return the series of a number a (n + 1, T) times b (n + 1, T, ...)."""
    a = a.reshape(*a.shape, *[1] * (b.ndim - 2))
    return np.array([sum(a[j] * b[i - j] for j in range(i + 1)) for i in range(len(b))])


def multiplied(a: Array, b: Array) -> Array:
    """Return the series of the product of matrices a, b (n + 1, T, 3, 3)."""
    return np.array([sum(a[j] @ b[i - j] for j in range(i + 1)) for i in range(len(a))])


def crossed(a: Array, b: Array) -> Array:
    """Return the series of a x b (n + 1, T, 3)."""
    return np.array([sum(np.cross(a[j], b[i - j]) for j in range(i + 1)) for i in range(len(a))])


def unit(a: Array) -> Array:
    """Return the series of a / |a| (n + 1, T, 3); what has no direction gives numbers that are not finite."""
    square = np.array([sum(np.sum(a[j] * a[i - j], axis=-1) for j in range(i + 1)) for i in range(len(a))])
    inverse = np.empty_like(square)  # y = x^(-1/2), of which 2 x y' = -x' y
    with np.errstate(all="ignore"):
        inverse[0] = square[0] ** -0.5
        for i in range(1, len(a)):
            total = sum((0.5 * j + (i - j)) * square[j] * inverse[i - j] for j in range(1, i + 1))
            inverse[i] = -total / (i * square[0])
        return scaled(inverse, a)


def sine_and_cosine(a: Array) -> tuple[Array, Array]:
    """Return the series of sin(a) and cos(a) for a (n + 1, T)."""
    s, c = np.empty_like(a), np.empty_like(a)
    s[0], c[0] = np.sin(a[0]), np.cos(a[0])
    for i in range(1, len(a)):
        s[i] = sum(j * a[j] * c[i - j] for j in range(1, i + 1)) / i
        c[i] = -sum(j * a[j] * s[i - j] for j in range(1, i + 1)) / i
    return s, c


def composed(f: Array, x: Array) -> Array:
    """Return the series of f(x(t)) for f (n + 1, T, ...) at the places x[0], and x (m + 1, T) with m <= n."""
    step = x.copy()
    step[0] = 0.0
    f = f[: len(x)]
    series = constant(np.zeros(f.shape[2:]), x)
    for row in f[::-1]:
        series = scaled(step, series)
        series[0] += row
    return series


def derivative(f: Array, order: int) -> Array:
    """Return the derivative (T, ...) of an order."""
    return np.asarray(math.factorial(order) * f[order])


def angular(R: Array) -> list[Array]:
    """Return w (T, 3), and as many of its derivatives as there are, of axes R (n + 1, T, 3, 3): R' = w x R."""
    n = len(R) - 1
    slope = R[1:] * np.arange(1, n + 1).reshape(n, 1, 1, 1)
    turn = multiplied(slope, np.swapaxes(R[:n], -1, -2))
    w = 0.5 * np.stack(
        [
            turn[..., 2, 1] - turn[..., 1, 2],
            turn[..., 0, 2] - turn[..., 2, 0],
            turn[..., 1, 0] - turn[..., 0, 1],
        ],
        axis=-1,
    )
    return [derivative(w, i) for i in range(n)]
