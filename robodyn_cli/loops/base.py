"""What a loop closure gets to know, and what it gives back.

Everything is relative to the last common ancestor of the two bodies, in its coordinates; a closure inside one
branch then does not depend on the joints below it.
"""

from __future__ import annotations

import dataclasses
from functools import cached_property
from typing import Any

from robodyn_cli.expr.graph import nonzero_entries
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Matrix, Values, Vector, dot, zeros


@record
class LoopFrame:
    """One end of a closure.

    p, R : origin [m] and axes (columns). Jv, Jw : (3, nv) Jacobians of the origin's velocity and of the
    angular velocity. w : angular velocity. a, wd : linear and angular acceleration for qdd = 0; both ends' a
    may contain the same further acceleration (gravity): only their difference has a meaning. qd : (nv,) rates.
    drift : velocity of the origin beside Jv qd, where a motion of the ground is prescribed.
    """

    p: Vector
    R: Matrix
    Jv: Matrix
    Jw: Matrix
    w: Vector
    a: Vector
    wd: Vector
    qd: Values
    drift: Vector = dataclasses.field(default_factory=lambda: zeros(3))

    @property
    def v(self) -> Vector:
        """Velocity of the origin."""
        return self.Jv @ self.qd + self.drift


class LoopClosure:
    """What every kind of closure answers: ``axis`` in the frame of each end (``axis2`` : in that of the second).

    ``length`` of a bar [m], ``rpy`` [rad] of the second link in the first.

    It has no fields, so that records derive from it; a field of the same name wins.
    """

    axis: tuple[float, ...] | None = None
    axis2: tuple[float, ...] | None = None
    rpy: tuple[float, ...] = (0.0, 0.0, 0.0)
    length: float = 0.0

    def rows(self, first: LoopFrame, second: LoopFrame) -> list[Row]:
        """Return the scalar constraints."""
        raise NotImplementedError


@record
class Attitude:
    """Two frames that a closure holds aligned, or of which it holds the axes z alone parallel.

    e, f : (3, 3) axes as columns. Jw : (3, nv) Jacobian of the angular velocity of f relative to e. of_axes : whether
    it is the axes alone.
    """

    e: Matrix
    f: Matrix
    Jw: Matrix
    of_axes: bool = False

    @property
    def cosine(self) -> Any:
        """Cosine of the angle between the axes, or between the frames: (trace of e^T f - 1) / 2."""
        if self.of_axes:
            return dot(self.e[:, 2], self.f[:, 2])
        return (sum(dot(self.e[:, k], self.f[:, k]) for k in range(3)) - 1.0) * 0.5


@record
class Row:
    """One scalar constraint: eta = 0, Psi v + eta_t = 0, Psi v-dot + gamma = 0.

    gamma = Psi-dot v + d/dt eta_t. ``kind`` is what its multiplier is: ``force`` or ``moment``.
    attitude : of a row that is a sine between two frames; such rows also vanish where the frames are not aligned.
    """

    name: str
    eta: Any
    psi: Vector
    gamma: Any
    eta_t: Any = 0.0
    kind: str = "force"
    attitude: Attitude | None = None

    @cached_property
    def entries(self) -> dict[int, Any]:
        """The nonzero entries of Psi by column."""
        return nonzero_entries(self.psi)

    @property
    def cosine(self) -> Any:
        """1 where the row is closed as it is meant, at most 0 where it vanishes in another attitude."""
        return 1.0 if self.attitude is None else self.attitude.cosine

    @property
    def closure(self) -> str:
        """The closure or coupler that the row belongs to."""
        return closure_of(self.name)

    @property
    def unit(self) -> str:
        """The unit of its residual, ``m`` or ``rad``: its multiplier is a force or a moment."""
        return "m" if self.kind in ("force", "m") else "rad"


def closure_of(row: str) -> str:
    """Return the closure or coupler of a row by its name: ``pin`` of ``pin.x``."""
    return row.rsplit(".", 1)[0]
