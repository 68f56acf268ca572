"""Linear spring in a joint."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, ClassVar

from robodyn_cli.forces.element import InJoint
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Either, Number, Vector, key


@record
class Spring(InJoint):
    """Torque ``tau = -k (q - q0)``; potential energy ``k (q - q0)^2 / 2``.

    On a rotation or translation in space it is a bushing with the same stiffness in all directions: ``-k phi``, phi the
    rotation vector from the attitude at rest, and ``k |phi|^2 / 2``.
    """

    term: ClassVar[str] = "passive"

    stiffness: float = key(Number(minimum=0.0), unit="N m/rad or N/m", doc="Stiffness k.")
    rest: Any = key(
        Either((Number(angle=True), Vector(3, angle=True))),
        default=0.0,
        unit="rad or m",
        doc="Position q0 at which the torque is zero; in space a rotation vector or a displacement.",
    )

    def problems_along(self, in_space: bool) -> Iterable[tuple[tuple[Any, ...], str]]:
        if in_space and not isinstance(self.rest, tuple) and self.rest != 0.0:
            yield ("rest",), "must be three numbers here, a rotation vector or a displacement"
        if not in_space and isinstance(self.rest, tuple):
            yield ("rest",), "must be one number here, the position of the coordinate"

    def torque(self, q: Any, qd: Any, gear_ratio: float, smooth: bool) -> Any:
        """Return the torque on the joint [N m or N] at position ``q`` and rate ``qd``."""
        return -self.stiffness * (q - self.rest)

    def potential(self, q: Any) -> Any:
        return 0.5 * self.stiffness * (q - self.rest) * (q - self.rest)
