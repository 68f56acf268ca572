"""No motion: the link is part of its parent."""

from __future__ import annotations

from typing import Any

from robodyn_cli.joints.base import Joint
from robodyn_cli.spatial.algebra import Transform, Vector


class Fixed(Joint):
    """Rigid attachment; the model merges such a link into its parent."""

    type = "fixed"
    takes = ()
    by_dh = True

    def transform(self, q: Vector) -> Transform:
        return Transform.identity()

    def angle(self, q: Vector) -> Any:
        return 0.0
