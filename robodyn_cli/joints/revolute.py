"""Rotation about the joint's z axis."""

from __future__ import annotations

from robodyn_cli.joints.base import Joint
from robodyn_cli.spatial.algebra import Transform, Vector, rotation_about, zeros


class Revolute(Joint):
    """One rotation; E = Rz(q)^T, S = (0, 0, 1, 0, 0, 0)."""

    type = "revolute"
    nq = nv = 1
    units = ("rad",)
    subspace = ((0.0, 0.0, 1.0, 0.0, 0.0, 0.0),)

    def transform(self, q: Vector) -> Transform:
        return Transform(rotation_about(2, q[0]).T, zeros(3))
