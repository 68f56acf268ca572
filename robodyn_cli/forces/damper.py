"""Linear damper in a joint."""

from __future__ import annotations

from typing import Any, ClassVar

from robodyn_cli.forces.element import InJoint
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Number, key


@record
class Damper(InJoint):
    """Torque ``tau = -c qd``."""

    term: ClassVar[str] = "passive"
    dissipative: ClassVar[bool] = True

    damping: float = key(Number(minimum=0.0), unit="N m s/rad or N s/m", doc="Damping c.")

    def torque(self, q: Any, qd: Any, gear_ratio: float, smooth: bool) -> Any:
        """Return the torque on the joint [N m or N]."""
        return -self.damping * qd
