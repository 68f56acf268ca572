"""Spatial algebra over any scalar: vectors, rotations, transforms, twists and wrenches of numbers or expressions.

Arrays have dtype ``object`` so that their entries may be Python floats and graph expressions side by side; a
float 0.0 anywhere removes the terms it multiplies. Notation follows Featherstone, Rigid Body Dynamics
Algorithms (2008), chapter 2: a transform X from A to B has E (rotation, B coordinates from A coordinates) and r
(origin of B in A coordinates). A twist is a motion vector (w, v), a wrench a force vector (n, f), both about the
origin of the frame in whose coordinates they are given.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.expr.fixed import Fixed, is_free
from robodyn_cli.expr.functions import cos, sin
from robodyn_cli.record import record

Array = NDArray[Any]  # of numbers; shape and unit are stated where it is used
Vector = NDArray[Any]  # dtype object, shape (3,)
Matrix = NDArray[Any]  # dtype object, shape (3, 3)
Values = Sequence[Any] | NDArray[Any]  # numbers or expressions in order

PARALLEL = 1e-12  # sine of the angle up to which two axes count as parallel


def vector(xs: Iterable[Any]) -> Vector:
    """Return a vector of numbers or expressions."""
    xs = list(xs)
    out = np.empty(len(xs), dtype=object)
    for k, x in enumerate(xs):
        out[k] = float(x) if isinstance(x, (int, float)) and not isinstance(x, Fixed) else x
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
    """Return a x b (3,); of each column (3, n) of the one that has several."""
    return rows([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def rows(xs: Sequence[Any]) -> Vector | Matrix:
    """Return a vector of numbers or expressions, or a matrix of such rows."""
    return np.stack(xs) if len(xs) and isinstance(xs[0], np.ndarray) else vector(xs)


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
    """Return x, or exactly 0, 1 or -1 where x differs from it by rounding only: exact values fold away."""
    for exact in (0.0, 1.0, -1.0):
        if abs(x - exact) < 1e-15:
            return exact
    return x


def rotation_about(axis: int, angle: Any) -> Matrix:
    """Return the rotation by ``angle`` [rad] about coordinate axis 0, 1 or 2: new axes as columns.

    A known angle is structure, if it is not asked to be none: its sine and cosine are plain numbers, zeros and ones
    among them.
    """
    if isinstance(angle, (float, int)) and not is_free(angle):
        c, s = snap(math.cos(angle)), snap(math.sin(angle))
    else:
        c, s = cos(angle), sin(angle)
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
    i, j = (k + 1) % 3, (k + 2) % 3
    if z[i] == z[j] == 0.0:  # z[k] alone is 1 by rounding for axes up to 1e-8 rad away too
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
        """Return the transform from a frame to itself."""
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


@record
class Twist:
    """Motion vector: angular part w and linear part v of the point at the frame's origin.

    A body's spatial velocity [rad/s, m/s], its spatial acceleration [rad/s^2, m/s^2], or a column of a joint's
    motion subspace S. Source: Featherstone (2008), sections 2.2 and 2.8.
    """

    w: Vector
    v: Vector

    @staticmethod
    def zero() -> Twist:
        """Return the twist of a body at rest."""
        return Twist(zeros(3), zeros(3))

    @staticmethod
    def of(S: Matrix) -> Twist:
        """Return the columns of a motion subspace S (6, n) side by side, w and v (3, n)."""
        return Twist(S[:3], S[3:])

    @staticmethod
    def along(S: Matrix, rates: Vector) -> Twist:
        """Return S qd for a motion subspace S (6, nv), angular rows first, and rates qd (nv,)."""
        return Twist(S[:3] @ rates, S[3:] @ rates)

    @property
    def components(self) -> Vector:
        """The six components, angular ones first."""
        return np.concatenate([self.w, self.v])

    def __add__(self, other: Twist) -> Twist:
        return Twist(self.w + other.w, self.v + other.v)

    def __sub__(self, other: Twist) -> Twist:
        return Twist(self.w - other.w, self.v - other.v)

    def shifted(self, p: Vector) -> Twist:
        """Return the same motion about the point p: (w, v + w x p)."""
        return Twist(self.w, self.v + cross(self.w, p))

    def rotated(self, E: Matrix) -> Twist:
        """Return the twist in rotated coordinates: (E w, E v)."""
        return Twist(E @ self.w, E @ self.v)

    def to_child(self, X: Transform) -> Twist:
        """Return X m, the B coordinates of a motion given in A (X from A to B): E w, E (v + w x r)."""
        return self.shifted(X.r).rotated(X.E)

    def cross(self, m: Twist) -> Twist:
        """Return self x m, the rate of a motion m that is fixed in a body with this velocity (equation 2.31)."""
        return Twist(cross(self.w, m.w), cross(self.w, m.v) + cross(self.v, m.w))


@record
class Wrench:
    """Force vector: moment n [N m] about the frame's origin and force f [N]; or a momentum, times seconds.

    Several at once stand side by side as the columns of n and f (3, n).

    Source: Featherstone (2008), sections 2.3 and 2.8.
    """

    n: Vector
    f: Vector

    @staticmethod
    def zero() -> Wrench:
        """Return the zero wrench."""
        return Wrench(zeros(3), zeros(3))

    @staticmethod
    def along(U: Matrix, amounts: Vector) -> Wrench:
        """Return U x for force vectors as the columns of U (6, n), moments first, and amounts x (n,)."""
        return Wrench(U[:3] @ amounts, U[3:] @ amounts)

    @property
    def components(self) -> Vector:
        """The six components, those of the moment first."""
        return np.concatenate([self.n, self.f])

    def __add__(self, other: Wrench) -> Wrench:
        return Wrench(self.n + other.n, self.f + other.f)

    def __sub__(self, other: Wrench) -> Wrench:
        return Wrench(self.n - other.n, self.f - other.f)

    def __neg__(self) -> Wrench:
        return Wrench(-self.n, -self.f)

    def shifted(self, p: Vector) -> Wrench:
        """Return the same wrench about the origin, given about the point p: (n + p x f, f)."""
        return Wrench(self.n + cross(p, self.f), self.f)

    def rotated(self, E: Matrix) -> Wrench:
        """Return the wrench in rotated coordinates: (E n, E f)."""
        return Wrench(E @ self.n, E @ self.f)

    def to_parent(self, X: Transform) -> Wrench:
        """Return X^T f, the A coordinates of a force given in B (X from A to B): E^T n + r x E^T f, E^T f."""
        return self.rotated(X.E.T).shifted(X.r)

    def dot(self, m: Twist) -> Any:
        """Return n.w + f.v: the power [W] of the wrench on a body with velocity m."""
        return dot(m.w, self.n) + dot(m.v, self.f)

    def project(self, S: Matrix) -> Vector:
        """Return S^T f (nv,), the wrench's part along each column of a motion subspace S (6, nv)."""
        return rows([self.dot(s) for s in columns(S)])

    @staticmethod
    def beside(wrenches: Sequence[Wrench]) -> Wrench:
        """Return several wrenches, or groups of them, side by side."""
        n, f = ([getattr(w, part).reshape(3, -1) for w in wrenches] for part in ("n", "f"))
        return Wrench(np.concatenate(n, axis=1), np.concatenate(f, axis=1))


def columns(S: Matrix) -> list[Twist]:
    """Return the columns of a motion subspace S (6, nv) as twists."""
    return [Twist(S[:3, j], S[3:, j]) for j in range(S.shape[1])]
