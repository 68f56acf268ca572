"""Joints with several coordinates."""

from __future__ import annotations

from typing import Any

import numpy as np

from robodyn_cli.expr.functions import cos, sin
from robodyn_cli.joints.base import Freedom, Joint
from robodyn_cli.spatial import quaternion
from robodyn_cli.spatial.algebra import Transform, Vector, matrix, rotation_about, vector, zeros


class Cylindrical(Joint):
    """q = (theta, d): E = Rz(theta)^T, r = (0, 0, d), each coordinate as the D-H variable of that name."""

    type = "cylindrical"
    nq = nv = 2
    units = ("rad", "m")
    needs = ("axis",)
    names = ("theta", "d")
    subspace = ((0.0, 0.0, 1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0, 0.0, 1.0))

    def transform(self, q: Vector) -> Transform:
        return Transform(rotation_about(2, q[0]).T, vector([0.0, 0.0, q[1]]))

    def angle(self, q: Vector) -> Any:
        return q[0]


class Universal(Joint):
    """q = (theta1, theta2): E = (Rz(theta1) Rx(theta2))^T.

    The first axis in body coordinates is (0, sin theta2, cos theta2), the second (1, 0, 0).
    """

    type = "universal"
    nq = nv = 2
    takes = ("axis", "axis2")
    units = ("rad", "rad")
    names = ("theta1", "theta2")

    def transform(self, q: Vector) -> Transform:
        return Transform((rotation_about(2, q[0]) @ rotation_about(0, q[1])).T, zeros(3))

    def S(self, q: Vector) -> Any:
        return matrix([[0.0, sin(q[1]), cos(q[1]), 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]]).T

    def S_rate(self, q: Vector, qd: Vector) -> Any:
        first = [0.0, cos(q[1]) * qd[1], -(sin(q[1]) * qd[1]), 0.0, 0.0, 0.0]
        return matrix([first, [0.0] * 6]).T


class Planar(Joint):
    """q = (x, y, theta): r = (x, y, 0), E = Rz(theta)^T; x and y along axes that do not turn with the body."""

    type = "planar"
    nq = nv = 3
    takes = ("axis", "axis2")
    units = ("m", "m", "rad")
    names = ("x", "y", "theta")

    def transform(self, q: Vector) -> Transform:
        return Transform(rotation_about(2, q[2]).T, vector([q[0], q[1], 0.0]))

    def S(self, q: Vector) -> Any:
        c, s = cos(q[2]), sin(q[2])
        return matrix(
            [[0.0, 0.0, 0.0, c, -s, 0.0], [0.0, 0.0, 0.0, s, c, 0.0], [0.0, 0.0, 1.0, 0.0, 0.0, 0.0]]
        ).T

    def S_rate(self, q: Vector, qd: Vector) -> Any:
        c, s = cos(q[2]) * qd[2], sin(q[2]) * qd[2]
        return matrix([[0.0, 0.0, 0.0, -s, -c, 0.0], [0.0, 0.0, 0.0, c, -s, 0.0], [0.0] * 6]).T

    def angle(self, q: Vector) -> Any:
        return q[2]


class Spherical(Joint):
    """q = (qw, qx, qy, qz), a unit quaternion; v = (wx, wy, wz), the angular velocity in body coordinates.

    Four numbers for three freedoms, so that no attitude is singular; v is not the rate of any position.
    """

    type = "spherical"
    nq = 4
    nv = 3
    quasi = True
    units = ("1", "1", "1", "1")
    names = ("qw", "qx", "qy", "qz")
    takes = ()
    v_units = ("rad", "rad", "rad")
    v_names = ("wx", "wy", "wz")
    subspace = tuple(tuple(float(i == j) for i in range(6)) for j in range(3))

    @property
    def freedoms(self) -> tuple[Freedom, ...]:
        return (Freedom("", slice(0, 4), slice(0, 3), "rad"),)

    def transform(self, q: Vector) -> Transform:
        return Transform(quaternion.rotation(q).T, zeros(3))

    def velocity_map(self, q: Vector, v: Vector) -> Vector:
        return quaternion.rate(q, v)

    def neutral(self) -> list[float]:
        return [1.0, 0.0, 0.0, 0.0]

    def integrate(self, q: Vector, dq: Vector) -> Vector:
        return quaternion.product(q, quaternion.from_rotation_vector(dq))

    def difference(self, q0: Vector, q1: Vector) -> Vector:
        return quaternion.rotation_vector(quaternion.product(quaternion.conjugate(q0), q1))

    def normalise(self, q: Vector) -> Vector:
        return quaternion.unit(q)


class Floating(Joint):
    """q = (x, y, z, qw, qx, qy, qz): origin r in the frame before the joint, and a unit quaternion.

    v = (vx, vy, vz, wx, wy, wz): velocity of the body's origin and angular velocity, both in body coordinates.
    """

    type = "floating"
    nq = 7
    nv = 6
    quasi = True
    units = ("m", "m", "m", "1", "1", "1", "1")
    names = ("x", "y", "z", "qw", "qx", "qy", "qz")
    takes = ()
    v_units = ("m", "m", "m", "rad", "rad", "rad")
    v_names = ("vx", "vy", "vz", "wx", "wy", "wz")
    subspace = tuple(tuple(float((j + 3) % 6 == i) for i in range(6)) for j in range(6))

    @property
    def freedoms(self) -> tuple[Freedom, ...]:
        return (
            Freedom("translation", slice(0, 3), slice(0, 3), "m"),
            Freedom("rotation", slice(3, 7), slice(3, 6), "rad"),
        )

    def transform(self, q: Vector) -> Transform:
        return Transform(quaternion.rotation(q[3:]).T, q[:3])

    def velocity_map(self, q: Vector, v: Vector) -> Vector:
        return np.concatenate([quaternion.rotation(q[3:]) @ v[:3], quaternion.rate(q[3:], v[3:])])

    def neutral(self) -> list[float]:
        return [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]

    def integrate(self, q: Vector, dq: Vector) -> Vector:
        """Return the position reached by a screw motion of constant body velocity ``dq`` (6,)."""
        R = quaternion.rotation(q[3:])
        turned = quaternion.product(q[3:], quaternion.from_rotation_vector(dq[3:]))
        return np.concatenate([q[:3] + R @ quaternion.displacement(dq[3:], dq[:3]), turned])

    def difference(self, q0: Vector, q1: Vector) -> Vector:
        u = quaternion.rotation_vector(quaternion.product(quaternion.conjugate(q0[3:]), q1[3:]))
        moved = quaternion.rotation(q0[3:]).T @ (q1[:3] - q0[:3])
        return np.concatenate([quaternion.displacement_velocity(u, moved), u])

    def normalise(self, q: Vector) -> Vector:
        return np.concatenate([q[:3], quaternion.unit(q[3:])])
