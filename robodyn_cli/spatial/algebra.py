"""Vectors, rotations and coordinate transforms over any scalar: numbers or expressions.

Arrays have dtype ``object`` so that their entries may be Python floats and graph expressions side by side; a
float 0.0 anywhere removes the terms it multiplies. Notation follows Featherstone, Rigid Body Dynamics
Algorithms (2008): a transform from A to B has E (rotation, B coordinates from A coordinates) and r (origin of
B in A coordinates).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.expr.functions import cos, sin
from robodyn_cli.record import record

Vector = NDArray[Any]  # dtype object, shape (3,)
Matrix = NDArray[Any]  # dtype object, shape (3, 3)
Values = Sequence[Any] | NDArray[Any]  # numbers or expressions in order


def vector(xs: Iterable[Any]) -> Vector:
    """Return a vector of numbers or expressions."""
    xs = list(xs)
    out = np.empty(len(xs), dtype=object)
    for k, x in enumerate(xs):
        out[k] = float(x) if isinstance(x, (int, float)) else x
    return out


def matrix(rows: Iterable[Iterable[Any]]) -> Matrix:
    """Return a matrix of numbers or expressions."""
    return np.stack([vector(row) for row in rows])


def zeros(*shape: int) -> NDArray[Any]:
    """Return an array of float zeros with dtype object."""
    out = np.empty(shape, dtype=object)
    out.fill(0.0)
    return out


def identity(n: int = 3) -> Matrix:
    """Return the identity matrix."""
    out = zeros(n, n)
    for k in range(n):
        out[k, k] = 1.0
    return out


def cross(a: Sequence[Any] | Vector, b: Sequence[Any] | Vector) -> Vector:
    """Return a x b."""
    return vector([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def skew(a: Sequence[Any] | Vector) -> Matrix:
    """Return the matrix of a x ."""
    return matrix([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])


def dot(a: Sequence[Any] | Vector, b: Sequence[Any] | Vector) -> Any:
    """Return a . b."""
    total: Any = 0.0
    for x, y in zip(a, b):
        total = total + x * y
    return total


def congruence(A: Matrix, B: Matrix) -> Matrix:
    """Return A^T B A for symmetric B, exploiting that the product is symmetric."""
    right = B @ A
    n = A.shape[1]
    out = zeros(n, n)
    for i in range(n):
        for j in range(i, n):
            out[i, j] = out[j, i] = dot(A[:, i], right[:, j])
    return out


def snap(x: float) -> float:
    """Return x, with what is 0 or +-1 but for rounding made exact, so that it is seen as structure."""
    for exact in (0.0, 1.0, -1.0):
        if abs(x - exact) < 1e-15:
            return exact
    return x


def rotation_about(axis: int, angle: Any) -> Matrix:
    """Return the rotation by ``angle`` [rad] about coordinate axis 0, 1 or 2: new axes as columns."""
    c, s = cos(angle), sin(angle)
    if isinstance(angle, (float, int)):
        c, s = snap(c), snap(s)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R = identity()
    R[i, i] = R[j, j] = c
    R[i, j], R[j, i] = -s, s
    return R


def rotation_rpy(rpy: Sequence[float]) -> Matrix:
    """Return Rz(yaw) Ry(pitch) Rx(roll)."""
    return rotation_about(2, rpy[2]) @ rotation_about(1, rpy[1]) @ rotation_about(0, rpy[0])


def rotation_to_z(axis: Sequence[float]) -> Matrix:
    """Return a rotation R with R e_z = axis / |axis|; a permutation with signs for a coordinate axis.

    Raises
    ------
    ValueError : the axis is zero.
    """
    a = np.asarray(axis, dtype=float)
    length = float(np.linalg.norm(a))
    if length == 0.0:
        raise ValueError("the axis is zero")
    z = [snap(float(x)) for x in a / length]
    k = int(np.argmax(np.abs(z)))
    if abs(z[k]) == 1.0:
        i = (k + 1) % 3
        x = [0.0, 0.0, 0.0]
        x[i] = 1.0
    else:
        helper = np.zeros(3)
        helper[int(np.argmin(np.abs(z)))] = 1.0
        v = np.cross(helper, z)
        x = [float(c) for c in v / np.linalg.norm(v)]
    y = cross(z, x)
    return np.stack([vector(x), vector(y), vector(z)], axis=1)


@record
class Transform:
    """Coordinate transform from frame A to frame B (Featherstone 2008, section 2.8).

    E : (3, 3) rotation that takes A coordinates to B coordinates.
    r : (3,) origin of B in A coordinates [m].
    """

    E: Matrix
    r: Vector

    @staticmethod
    def identity() -> Transform:
        return Transform(identity(), zeros(3))

    @staticmethod
    def from_pose(R: Matrix, p: Vector) -> Transform:
        """Return the transform to a frame whose axes are the columns of R and whose origin is p, in A."""
        return Transform(R.T, p)

    def __matmul__(self, first: Transform) -> Transform:
        """Compose: (self @ first) goes through ``first`` and then through ``self``."""
        return Transform(self.E @ first.E, first.r + first.E.T @ self.r)

    def inverse(self) -> Transform:
        """Return the transform from B to A."""
        return Transform(self.E.T, -(self.E @ self.r))

    def point(self, p: Vector) -> Vector:
        """Return the A coordinates of a point given in B coordinates."""
        return self.r + self.E.T @ p

    def force_to_parent(self, n: Vector, f: Vector) -> tuple[Vector, Vector]:
        """Return moment about A's origin and force in A coordinates, from those about B's origin (X^T f)."""
        fa = self.E.T @ f
        return self.E.T @ n + cross(self.r, fa), fa


def is_finite_vector(xs: Iterable[float]) -> bool:
    """Tell whether all entries are ordinary numbers."""
    return all(math.isfinite(x) for x in xs)
