"""Any rotation about a point."""

from __future__ import annotations

from robodyn_cli.joints.base import Freedom, Joint
from robodyn_cli.spatial import quaternion
from robodyn_cli.spatial.algebra import Transform, Vector, zeros


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
