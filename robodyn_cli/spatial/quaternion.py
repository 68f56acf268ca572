"""Unit quaternions (w, x, y, z) and rigid motions over any scalar: numbers or expressions.

A quaternion represents the rotation R that takes body coordinates to those of the frame before; q-dot = q (0, w) / 2
with the angular velocity w in body coordinates (Hairer, Lubich and Wanner 2006, VII.5.3).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from robodyn_cli.expr.functions import atan2, cos, maximum, sin, sqrt, where
from robodyn_cli.spatial.algebra import Array, Matrix, Values, Vector, cross, dot, identity, vector

TINY = 1e-300  # keeps quotients of two vanishing lengths finite
NEAR = 0.25  # squared angle [rad^2] below which power series replace quotients that lose digits
# cos(a/2), sin(a/2) / a, (a - sin a) / a^3 and (1 - a/2 cot(a/2)) / a^2 as series in a^2
SERIES_HALF_COSINE = tuple((-0.25) ** k / math.factorial(2 * k) for k in range(8))
SERIES_HALF_SINE = tuple(0.5 * (-0.25) ** k / math.factorial(2 * k + 1) for k in range(8))
SERIES_SINE = (1 / 6, -1 / 120, 1 / 5040, -1 / 362880, 1 / 39916800, -1 / 6227020800, 1 / 1307674368000)
SERIES_COTANGENT = (
    1 / 12, 1 / 720, 1 / 30240, 1 / 1209600, 1 / 47900160, 691 / 1307674368000, 1 / 74724249600,
)  # fmt: skip


def product(p: Values, q: Values) -> Vector:
    """Return the quaternion p q, the rotation q followed by p."""
    a, b, c, d = p
    w, x, y, z = q
    return vector(
        [
            a * w - b * x - c * y - d * z,
            a * x + b * w + c * z - d * y,
            a * y - b * z + c * w + d * x,
            a * z + b * y - c * x + d * w,
        ]
    )


def conjugate(q: Values) -> Vector:
    """Return the inverse of a unit quaternion."""
    return vector([q[0], -q[1], -q[2], -q[3]])


def rotation(q: Values) -> Matrix:
    """Return the rotation R (3, 3) of a unit quaternion: the body's axes as columns."""
    w, x, y, z = q
    R = identity()
    for i, j, a, b, c in ((0, 1, x, y, z), (1, 2, y, z, x), (2, 0, z, x, y)):
        R[i, i] = 1.0 - 2.0 * (b * b + c * c)
        R[i, j], R[j, i] = 2.0 * (a * b - w * c), 2.0 * (a * b + w * c)
    return R


def rotations(q: Array) -> Array:
    """Return the rotations (..., 3, 3) of quaternions (..., 4) of any length but zero."""
    parts = rotation(list(np.moveaxis(q / np.linalg.norm(q, axis=-1, keepdims=True), -1, 0)))
    return np.moveaxis(np.array(parts.tolist(), dtype=float), (0, 1), (-2, -1))


def rate(q: Values, w: Values) -> Vector:
    """Return q-dot = q (0, w) / 2 for the angular velocity ``w`` (3,) in body coordinates."""
    return product(q, vector([0.0, *(0.5 * x for x in w)]))


def angular_velocity(q: Values, qd: Values) -> Vector:
    """Return the angular velocity (3,) in body coordinates, the vector part of 2 q* q-dot."""
    return 2.0 * product(conjugate(q), qd)[1:]


def unit(q: Values) -> Vector:
    """Return the quaternion of length 1 in the direction of ``q``."""
    length = sqrt(dot(q, q))
    return vector([x / length for x in q])


def from_rotation_vector(u: Values) -> Vector:
    """Return the quaternion of a rotation by |u| [rad] about u (3,); smooth at 0, derivatives too."""
    square = dot(u, u)
    half = 0.5 * sqrt(maximum(square, NEAR))
    w = where(square - NEAR, cos(half), _series(SERIES_HALF_COSINE, square))
    k = _half_sine(square)
    return vector([w, *(k * x for x in u)])


def from_rpy(rpy: Values) -> Vector:
    """Return the quaternion of Rz(yaw) Ry(pitch) Rx(roll), angles in rad."""
    turns = [
        vector([cos(0.5 * a), *(sin(0.5 * a) if i == k else 0.0 for i in range(3))])
        for k, a in enumerate(rpy)
    ]
    return product(turns[2], product(turns[1], turns[0]))


def rotation_vector(q: Values) -> Vector:
    """Return the rotation vector (3,) of a unit quaternion, no longer than pi [rad]."""
    w, xyz = q[0], q[1:]
    s = sqrt(dot(xyz, xyz))
    flip = where(w, 1.0, -1.0)
    factor = 2.0 * atan2(s, flip * w) / maximum(s, TINY) * flip
    return vector([factor * x for x in xyz])


def logarithm(R: Array) -> Array:
    """Return the rotation vectors (..., 3) [rad] of rotations R (..., 3, 3), no longer than pi; exact at half turns.

    4 q q^T is linear in R; its column with the largest diagonal entry loses no digits (Shepperd 1978). Of the two
    vectors of a half turn it returns one.
    """
    squares = np.empty((*R.shape[:-2], 4, 4))
    trace = np.trace(R, axis1=-2, axis2=-1)
    squares[..., 0, 0] = 1.0 + trace
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        squares[..., 1 + i, 1 + i] = 1.0 + 2.0 * R[..., i, i] - trace
        squares[..., 0, 1 + i] = squares[..., 1 + i, 0] = R[..., k, j] - R[..., j, k]
        squares[..., 1 + i, 1 + j] = squares[..., 1 + j, 1 + i] = R[..., i, j] + R[..., j, i]
    largest = np.argmax(np.diagonal(squares, axis1=-2, axis2=-1), axis=-1)
    q = np.take_along_axis(squares, largest[..., None, None], axis=-1)[..., 0]
    q = np.where(q[..., :1] < 0.0, -q, q)
    sine = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    vectors: Array = 2.0 * np.arctan2(sine, q[..., :1]) / np.maximum(sine, TINY) * q[..., 1:]
    return vectors


def _half_sine(square: Any) -> Any:
    """Return sin(a/2) / a, given a^2."""
    a = sqrt(maximum(square, NEAR))
    return where(square - NEAR, sin(0.5 * a) / a, _series(SERIES_HALF_SINE, square))


def _series(coefficients: tuple[float, ...], x: Any) -> Any:
    total: Any = coefficients[-1]
    for c in reversed(coefficients[:-1]):
        total = total * x + c
    return total


def displacement(u: Values, v: Values) -> Vector:
    """Return how far a body's origin moves (3,), in its first axes, turning by ``u`` while it goes by ``v``.

    u, v (3,) are a constant body velocity over unit time: the displacement is
    v + (1 - cos a)/a^2 u x v + (a - sin a)/a^3 u x (u x v) with a = |u| (Murray, Li and Sastry 1994, 2.36).
    """
    square = dot(u, u)
    k = _half_sine(square)
    safe = maximum(square, NEAR)
    far = (1.0 - sin(sqrt(safe)) / sqrt(safe)) / safe
    third = where(square - NEAR, far, _series(SERIES_SINE, square))
    turned = cross(u, v)
    return vector(v) + 2.0 * k * k * turned + third * cross(u, turned)


def displacement_velocity(u: Values, p: Values) -> Vector:
    """Return the body velocity v (3,) that leads the origin to ``p`` while the body turns by ``u``: the inverse of
    ``displacement``, v = p - u x p / 2 + (1 - a/2 cot(a/2))/a^2 u x (u x p)."""
    square = dot(u, u)
    safe = maximum(square, NEAR)
    half = 0.5 * sqrt(safe)
    far = (1.0 - half * cos(half) / sin(half)) / safe
    second = where(square - NEAR, far, _series(SERIES_COTANGENT, square))
    turned = cross(u, p)
    return vector(p) - 0.5 * turned + second * cross(u, turned)
