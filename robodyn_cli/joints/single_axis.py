"""Joints about one axis, and the weld."""

from __future__ import annotations

from typing import Any, ClassVar

from robodyn_cli.joints.base import Joint
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Transform, Vector, identity, matrix, rotation_about, vector, zeros
from robodyn_cli.spatial.inertia import RigidInertia


class FixedJoint(Joint):
    """Rigid attachment; the model merges such a link into its parent."""

    type = "fixed"
    takes = ()
    by_dh = True

    def transform(self, q: Vector) -> Transform:
        return Transform.identity()

    def angle(self, q: Vector) -> Any:
        return 0.0


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

    def divided(self, inertia: RigidInertia) -> tuple[RigidInertia, RigidInertia]:
        """Return what turning moves, and the mass with its moment along the axis."""
        x, y, z = inertia.h
        return (
            RigidInertia(0.0, vector([x, y, 0.0]), inertia.I),
            RigidInertia(inertia.m, vector([0.0, 0.0, z]), zeros(3, 3)),
        )

    def parent_inertia(self, inertia: RigidInertia) -> RigidInertia:
        """Return the mass, its moment along the axis, and I_yy about x and y, which turning does not change."""
        _, moved = self.divided(inertia)
        I = zeros(3, 3)
        I[0, 0] = I[1, 1] = inertia.I[1, 1]
        return RigidInertia(moved.m, moved.h, I)

    def angle(self, q: Vector) -> Any:
        return q[0]


class Prismatic(Joint):
    """One translation; r = (0, 0, q), S = (0, 0, 0, 0, 0, 1)."""

    type = "prismatic"
    nq = nv = 1
    units = ("m",)
    needs = ("axis",)
    by_dh = True
    dh_variable = "d"
    subspace = ((0.0, 0.0, 0.0, 0.0, 0.0, 1.0),)

    def transform(self, q: Vector) -> Transform:
        return Transform(identity(), vector([0.0, 0.0, q[0]]))

    def divided(self, inertia: RigidInertia) -> tuple[RigidInertia, RigidInertia]:
        """Return the mass and its moments, and the rotational inertia: a body on a slide turns as its parent does."""
        return RigidInertia(inertia.m, inertia.h, zeros(3, 3)), RigidInertia(0.0, zeros(3), inertia.I)

    def angle(self, q: Vector) -> Any:
        return 0.0


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
