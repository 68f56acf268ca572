"""Joints with several freedoms, and one for tests only: of what the registry leaves unused, lever arms in S."""

from __future__ import annotations

from typing import Any

from robodyn_cli.joints.base import Joint
from robodyn_cli.joints.registry import joint_types
from robodyn_cli.spatial.algebra import Transform, Vector, matrix, rotation_about, vector


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

    def angle(self, q: Vector) -> Any:
        return q[0]


wide_joints: dict[str, Joint] = {
    "polar": Polar(),
    **{name: joint_types[name] for name in ("universal", "cylindrical", "planar", "spherical", "floating")},
}
