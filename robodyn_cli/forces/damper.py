"""Linear damper in a joint."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, ClassVar

from robodyn_cli.forces.element import InJoint
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Number, key


@record
class Damper(InJoint):
    """Torque ``tau = -c qd``; in a ball joint ``-c w``, against the angular velocity."""

    term: ClassVar[str] = "passive"
    dissipative: ClassVar[bool] = True

    damping: float = key(Number(minimum=0.0), unit="N m s/rad or N s/m", doc="Damping c.")

    def problems_along(self, in_space: bool) -> Iterable[tuple[tuple[Any, ...], str]]:
        return ()

    def torque(self, q: Any, qd: Any, gear_ratio: float, smooth: bool) -> Any:
        """Return the torque on the joint [N m or N]."""
        return -self.damping * qd
