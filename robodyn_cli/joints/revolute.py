"""Rotation about the joint's z axis."""

from __future__ import annotations

from typing import Any

from robodyn_cli.joints.base import Joint
from robodyn_cli.spatial.algebra import Transform, Vector, rotation_about, zeros
from robodyn_cli.spatial.inertia import RigidInertia


class Revolute(Joint):
    """One rotation; E = Rz(q)^T, S = (0, 0, 1, 0, 0, 0)."""

    type = "revolute"
    nq = nv = 1
    units = ("rad",)
    needs = ("axis",)
    by_dh = True
    dh_variable = "theta"
    subspace = ((0.0, 0.0, 1.0, 0.0, 0.0, 0.0),)

    def transform(self, q: Vector) -> Transform:
        return Transform(rotation_about(2, q[0]).T, zeros(3))

    def parent_inertia(self, inertia: RigidInertia) -> RigidInertia:
        """Return the mass, its moment along the axis, and I_yy about x and y, which turning does not change."""
        h, I = zeros(3), zeros(3, 3)
        h[2] = inertia.h[2]
        I[0, 0] = I[1, 1] = inertia.I[1, 1]
        return RigidInertia(inertia.m, h, I)

    def angle(self, q: Vector) -> Any:
        return q[0]
