"""Rotation about the joint's z axis and translation along it."""

from __future__ import annotations

from typing import Any

from robodyn_cli.joints.base import Joint
from robodyn_cli.spatial.algebra import Transform, Vector, rotation_about, vector


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
