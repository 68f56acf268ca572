"""Plates with a given outline."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from robodyn_cli.spatial.algebra import Array

Corners = Sequence[Sequence[float]]
FLAT = 1e-9  # of the square of its extent: an area that is none


def outline_problem(corners: Corners) -> str:
    """Return why corners (N, 2) are no outline of a plate, "" where they are."""
    p = np.array(corners, dtype=float)
    if abs(_area(p)) <= FLAT * float(np.ptp(p, axis=0).max()) ** 2:
        return "encloses no area; allowed: three corners or more that do not lie on one line"
    sides = [(p[k], p[(k + 1) % len(p)]) for k in range(len(p))]
    for i, j in itertools.combinations(range(len(p)), 2):
        neighbours = j - i in (1, len(p) - 1)
        if not neighbours and _cross(*sides[i], *sides[j]):
            return f"sides {i} and {j} cross; allowed: corners one after another around the plate"
    return ""


def plate(corners: Corners, thickness: float) -> tuple[Array, tuple[tuple[int, ...], ...], bool]:
    """Return points (M, 3) [m] and faces of a plate about the x-y plane, the upper one first; whether it is closed."""
    p = np.array(corners, dtype=float)
    if _area(p) < 0.0:
        p = p[::-1]
    # a face's plane is told by its first three corners, which must turn as the outline does
    turns = np.array([_turn(p[k - 1], p[k], p[(k + 1) % len(p)]) for k in range(len(p))])
    p = np.roll(p, 1 - int(np.argmax(turns)), axis=0)
    n = len(p)
    top = np.column_stack([p, np.full(n, 0.5 * thickness)])
    upper = tuple(range(n))
    if not thickness:
        return top, (upper,), False
    bottom = np.column_stack([p, np.full(n, -0.5 * thickness)])
    lower = (n + 2, n + 1, n, *range(2 * n - 1, n + 2, -1))
    sides = [(k, n + k, n + (k + 1) % n, (k + 1) % n) for k in range(n)]
    return np.concatenate([top, bottom]), (upper, lower, *sides), True


def _area(p: Array) -> float:
    x, y = p.T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def _turn(a: Array, b: Array, c: Array) -> float:
    """Return twice the area of the triangle a b c, positive where it turns to the left."""
    (x, y), (u, v) = b - a, c - b
    return float(x * v - y * u)


def _cross(a: Array, b: Array, c: Array, d: Array) -> bool:
    """Tell whether the segments a b and c d have a point in common."""
    first, second = _turn(a, b, c) * _turn(a, b, d), _turn(c, d, a) * _turn(c, d, b)
    return first <= 0.0 and second <= 0.0 and (first < 0.0 or second < 0.0)
