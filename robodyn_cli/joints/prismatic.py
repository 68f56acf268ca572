"""Translation along the joint's z axis."""

from __future__ import annotations

from robodyn_cli.joints.base import Joint
from robodyn_cli.spatial.algebra import Transform, Vector, identity, vector


class Prismatic(Joint):
    """One translation; r = (0, 0, q), S = (0, 0, 0, 0, 0, 1)."""

    type = "prismatic"
    nq = nv = 1
    units = ("m",)
    subspace = ((0.0, 0.0, 0.0, 0.0, 0.0, 1.0),)

    def transform(self, q: Vector) -> Transform:
        return Transform(identity(), vector([0.0, 0.0, q[0]]))
