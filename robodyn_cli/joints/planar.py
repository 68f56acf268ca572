"""Translation in the joint's xy plane and rotation about its z axis."""

from __future__ import annotations

from typing import Any

from robodyn_cli.expr.functions import cos, sin
from robodyn_cli.joints.base import Joint
from robodyn_cli.spatial.algebra import Transform, Vector, matrix, rotation_about, vector


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
