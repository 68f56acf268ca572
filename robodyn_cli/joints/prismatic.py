"""Translation along the joint's z axis."""

from __future__ import annotations

from typing import Any

from robodyn_cli.joints.base import Joint
from robodyn_cli.spatial.algebra import Transform, Vector, identity, vector, zeros
from robodyn_cli.spatial.inertia import RigidInertia


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

    def parent_inertia(self, inertia: RigidInertia) -> RigidInertia:
        """Return the rotational inertia: a body on a slide turns as its parent does."""
        return RigidInertia(0.0, zeros(3), inertia.I)

    def angle(self, q: Vector) -> Any:
        return 0.0
