"""What numerical tests share: plain arrays, comparisons that state their scale, high-order differences."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

import numpy as np
from hypothesis import HealthCheck, settings

EPS = float(np.finfo(float).eps)


def examples(n: int) -> settings:
    """Settings of a property test with ``n`` examples; a third of them, the same ones on every run, where nothing is said.

    With ``ROBODYN_EXPLORE=k`` in the environment, k times as many fresh ones.
    """
    explore = int(os.environ.get("ROBODYN_EXPLORE", "0"))
    return settings(
        max_examples=n * explore or (n + 2) // 3,
        deadline=None,
        derandomize=not explore,
        database=None,
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much],
    )


def real(x: Any) -> np.ndarray:
    """Return an array of floats from what an algorithm returned; fails on what is not a number."""
    return np.array(x, dtype=float)


def assert_close(got: Any, expected: Any, tolerance: float, scale: float | None = None) -> None:
    """Fail unless the largest difference is below ``tolerance`` times the scale (default: largest entry)."""
    a, b = real(got), real(expected)
    assert a.shape == b.shape, (a.shape, b.shape)
    if a.size == 0:
        return
    if scale is None:
        scale = max(float(np.abs(a).max()), float(np.abs(b).max()))
    error = float(np.abs(a - b).max()) / max(float(scale), 1e-300)
    assert error <= tolerance, f"relative difference {error:.3e} exceeds {tolerance:.1e} (scale {scale:.3g})"


# central differences of order 8; exact for polynomials up to degree 8 and 9
_FIRST = np.array([4 / 5, -1 / 5, 4 / 105, -1 / 280])
_SECOND = np.array([8 / 5, -1 / 5, 8 / 315, -1 / 560])


def first_derivative(f: Callable[[float], np.ndarray], h: float) -> np.ndarray:
    """Return f'(0) to order h^8."""
    total = 0.0
    for k, c in enumerate(_FIRST, start=1):
        total = total + c * (real(f(k * h)) - real(f(-k * h)))
    return total / h


def second_derivative(f: Callable[[float], np.ndarray], h: float) -> np.ndarray:
    """Return f''(0) to order h^8."""
    total = -205 / 72 * real(f(0.0))
    for k, c in enumerate(_SECOND, start=1):
        total = total + c * (real(f(k * h)) + real(f(-k * h)))
    return total / h**2


def vee(W: np.ndarray) -> np.ndarray:
    """Return w from the skew part of a matrix w~."""
    return np.array([W[2, 1] - W[1, 2], W[0, 2] - W[2, 0], W[1, 0] - W[0, 1]]) / 2
