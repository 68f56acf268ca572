"""Screw motion about and along the joint's z axis."""

from __future__ import annotations

from typing import Any, ClassVar

from robodyn_cli.joints.base import Joint
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Transform, Vector, matrix, rotation_about, vector


@record
class Helical(Joint):
    """One rotation that advances with it; E = Rz(q)^T, r = (0, 0, h q), S = (0, 0, 1, 0, 0, h).

    pitch : h [m/rad], the lead of the thread over 2 pi; positive for a right-handed one.
    """

    pitch: float = 0.1

    type: ClassVar[str] = "helical"
    nq: ClassVar[int] = 1
    nv: ClassVar[int] = 1
    units: ClassVar[tuple[str, ...]] = ("rad",)
    needs: ClassVar[tuple[str, ...]] = ("axis", "pitch")

    def transform(self, q: Vector) -> Transform:
        return Transform(rotation_about(2, q[0]).T, vector([0.0, 0.0, self.pitch * q[0]]))

    def S(self, q: Vector) -> Any:
        return matrix([[0.0, 0.0, 1.0, 0.0, 0.0, self.pitch]]).T

    def angle(self, q: Vector) -> Any:
        return q[0]
