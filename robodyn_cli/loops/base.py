"""What a loop closure gets to know, and what it gives back.

Everything is relative to the last common ancestor of the two bodies, in its coordinates; a closure inside one
branch then does not depend on the joints below it.
"""

from __future__ import annotations

import dataclasses
from typing import Any

from robodyn_cli.spatial.algebra import Matrix, Vector


@dataclasses.dataclass(frozen=True)
class LoopFrame:
    """One end of a closure.

    p, R : origin [m] and axes (columns). Jv, Jw : (3, nv) Jacobians of the origin's velocity and of the angular
    velocity. w : angular velocity. a, wd : linear and angular acceleration for qdd = 0.
    """

    p: Vector
    R: Matrix
    Jv: Matrix
    Jw: Matrix
    w: Vector
    a: Vector
    wd: Vector


@dataclasses.dataclass(frozen=True)
class Row:
    """One scalar constraint: eta = 0, Psi v + eta_t = 0, Psi v-dot + gamma = 0.

    gamma = Psi-dot v + d/dt eta_t. ``kind`` is what its multiplier is: ``force`` or ``moment``.
    """

    name: str
    eta: Any
    psi: Vector
    gamma: Any
    eta_t: Any = 0.0
    kind: str = "force"
