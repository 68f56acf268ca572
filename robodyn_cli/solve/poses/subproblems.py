"""The two canonical subproblems of rotations about given axes, for many right-hand sides at once.

Paden and Kahan (1986); in the form of Elias and Wen (2025), who build inverse kinematics from them. Vectors are
(3,) or (T, 3), angles (T,).
"""

from __future__ import annotations

import numpy as np

from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array


def dots(a: Array, b: Array) -> Array:
    """Return a . b row by row."""
    out: Array = np.einsum("...i,...i->...", a, b)
    return out


def rotations(axis: Array, angle: Array) -> Array:
    """Return the rotations (T, 3, 3) by angles (T,) about one unit axis (Rodrigues)."""
    x, y, z = axis
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    # E + sin K + (1 - cos) K^2 as one product
    parts = np.stack([np.eye(3), K, K @ K]).reshape(3, 9)
    out: Array = np.column_stack([np.ones(len(angle)), np.sin(angle), 1.0 - np.cos(angle)]) @ parts
    return out.reshape(-1, 3, 3)


def turned(R: Array, a: Array) -> Array:
    """Return R a row by row, R (T, 3, 3)."""
    return np.einsum("tij,tj->ti", R, np.broadcast_to(a, (len(R), 3)))


def turned_back(R: Array, a: Array) -> Array:
    """Return R^T a row by row, R (T, 3, 3)."""
    return np.einsum("tji,tj->ti", R, np.broadcast_to(a, (len(R), 3)))


def angle_between(axis: Array, first: Array, second: Array) -> Array:
    """Return the angle (T,) about the axis that turns the direction of ``first`` to that of ``second``."""
    sine = dots(axis, np.cross(first, second))
    cosine = dots(first, second) - dots(first, axis) * dots(second, axis)
    out: Array = np.arctan2(sine, cosine)
    return out


@record
class Pair:
    """Two angles (T,) that solve an equation, and by how much the equation fails (0 where there are solutions).

    The derivative of the equation's left side is positive at ``plus`` and negative at ``minus``.
    """

    plus: Array
    minus: Array
    missed: Array


def component_angles(h: Array, axis: Array, p: Array, d: Array) -> Pair:
    """Return the angles at which rot(axis, angle) p has the component d along h; the nearest where there are none.

    h . rot(k, angle) p = (h . k)(k . p) + a sin(angle) + b cos(angle), a = h . (k x p), b = h . p - (h . k)(k . p).
    """
    across = np.cross(axis, p)
    fixed = dots(h, axis) * dots(axis, p)
    a, b = dots(h, across), dots(h, p) - fixed
    size = np.hypot(a, b)
    wanted = d - fixed
    inside = np.sqrt(np.maximum(0.0, (size - wanted) * (size + wanted)))
    half = np.arctan2(inside, wanted)
    middle = np.arctan2(a, b)
    return Pair(middle - half, middle + half, np.maximum(0.0, np.abs(wanted) - size))
