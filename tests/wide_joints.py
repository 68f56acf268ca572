"""Joints with several freedoms, for tests only: what the registry's joints leave of the contract unused."""

from __future__ import annotations

from typing import Any

from robodyn_cli.expr.functions import atan2, cos, sin, sqrt
from robodyn_cli.joints.base import Joint
from robodyn_cli.spatial.algebra import Transform, Vector, identity, matrix, rotation_about, vector, zeros


class Universal(Joint):
    """Turn about z, then about the new x: the subspace depends on the position."""

    type = "universal"
    nq = nv = 2
    units = ("rad", "rad")

    def transform(self, q: Vector) -> Transform:
        return Transform((rotation_about(2, q[0]) @ rotation_about(0, q[1])).T, zeros(3))

    def S(self, q: Vector) -> Any:
        first = [0.0, sin(q[1]), cos(q[1]), 0.0, 0.0, 0.0]
        return matrix([first, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]]).T

    def S_rate(self, q: Vector, qd: Vector) -> Any:
        first = [0.0, cos(q[1]) * qd[1], -(sin(q[1]) * qd[1]), 0.0, 0.0, 0.0]
        return matrix([first, [0.0] * 6]).T

    def bias(self, q: Vector, qd: Vector) -> Vector:
        return self.S_rate(q, qd) @ qd


class Cylindrical(Joint):
    """Turn about z and slide along it."""

    type = "cylindrical"
    nq = nv = 2
    units = ("rad", "m")
    subspace = ((0.0, 0.0, 1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0, 0.0, 1.0))

    def transform(self, q: Vector) -> Transform:
        return Transform(rotation_about(2, q[0]).T, vector([0.0, 0.0, q[1]]))


class Polar(Joint):
    """Turn about z, then slide along the new x: turning moves the origin, so the subspace has lever arms."""

    type = "polar"
    nq = nv = 2
    units = ("rad", "m")

    def transform(self, q: Vector) -> Transform:
        R = rotation_about(2, q[0])
        return Transform(R.T, R @ vector([q[1], 0.0, 0.0]))

    def S(self, q: Vector) -> Any:
        return matrix([[0.0, 0.0, 1.0, 0.0, q[1], 0.0], [0.0, 0.0, 0.0, 1.0, 0.0, 0.0]]).T

    def S_rate(self, q: Vector, qd: Vector) -> Any:
        return matrix([[0.0, 0.0, 0.0, 0.0, qd[1], 0.0], [0.0] * 6]).T

    def bias(self, q: Vector, qd: Vector) -> Vector:
        return self.S_rate(q, qd) @ qd


class Spherical(Joint):
    """Turn freely: a unit quaternion (w, x, y, z), with the body's angular velocity as v."""

    type = "spherical"
    nq = 4
    nv = 3
    units = ("1", "1", "1", "1")
    subspace = tuple(tuple(float(i == j) for i in range(6)) for j in range(3))

    def transform(self, q: Vector) -> Transform:
        w, x, y, z = q
        R = identity()
        for i, j, a, b, c in ((0, 1, x, y, z), (1, 2, y, z, x), (2, 0, z, x, y)):
            R[i, i] = 1.0 - 2.0 * (b * b + c * c)
            R[i, j], R[j, i] = 2.0 * (a * b - w * c), 2.0 * (a * b + w * c)
        return Transform(R.T, zeros(3))

    def velocity_map(self, q: Vector, v: Vector) -> Vector:
        return product(q, vector([0.0, *(0.5 * e for e in v)]))

    def neutral(self) -> list[float]:
        return [1.0, 0.0, 0.0, 0.0]

    def integrate(self, q: Vector, dq: Vector) -> Vector:
        angle = sqrt(dq[0] * dq[0] + dq[1] * dq[1] + dq[2] * dq[2])
        if isinstance(angle, float) and angle == 0.0:
            return q
        s = sin(0.5 * angle) / angle
        return product(q, vector([cos(0.5 * angle), *(s * e for e in dq)]))

    def difference(self, q0: Vector, q1: Vector) -> Vector:
        w, *xyz = product(vector([q0[0], -q0[1], -q0[2], -q0[3]]), q1)
        s = sqrt(sum(e * e for e in xyz))
        return vector([2.0 * atan2(s, w) / s * e for e in xyz])

    def normalise(self, q: Vector) -> Vector:
        return vector([e / sqrt(sum(x * x for x in q)) for e in q])


def product(p: Vector, q: Vector) -> Vector:
    """Return the quaternion p q."""
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


wide_joints: dict[str, Joint] = {
    "universal": Universal(),
    "cylindrical": Cylindrical(),
    "polar": Polar(),
    "spherical": Spherical(),
}
