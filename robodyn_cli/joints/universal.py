"""Rotation about the joint's z axis, then about the x axis that it has turned (a cross between two forks)."""

from __future__ import annotations

from typing import Any

from robodyn_cli.expr.functions import cos, sin
from robodyn_cli.joints.base import Joint
from robodyn_cli.spatial.algebra import Transform, Vector, matrix, rotation_about, zeros


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
