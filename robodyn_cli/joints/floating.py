"""Any motion: a body that no joint holds."""

from __future__ import annotations

import numpy as np

from robodyn_cli.joints.base import Freedom, Joint
from robodyn_cli.spatial import quaternion
from robodyn_cli.spatial.algebra import Transform, Vector


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
