"""Linear spring in a joint."""

from __future__ import annotations

from typing import Any, ClassVar

from robodyn_cli.forces.element import InJoint
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Number, key


@record
class Spring(InJoint):
    """Torque ``tau = -k (q - q0)``; potential energy ``k (q - q0)^2 / 2``."""

    term: ClassVar[str] = "passive"

    stiffness: float = key(Number(minimum=0.0), unit="N m/rad or N/m", doc="Stiffness k.")
    rest: float = key(
        Number(angle=True), default=0.0, unit="rad or m", doc="Position q0 at which the torque is zero."
    )

    def torque(self, q: Any, qd: Any, gear_ratio: float, smooth: bool) -> Any:
        """Return the torque on the joint [N m or N] at position ``q`` and rate ``qd``."""
        return -self.stiffness * (q - self.rest)

    def potential(self, q: Any) -> Any:
        return 0.5 * self.stiffness * (q - self.rest) * (q - self.rest)
