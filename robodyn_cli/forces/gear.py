"""Losses in a joint's gear, in proportion to the load that it passes on."""

from __future__ import annotations

from typing import Any, ClassVar

from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.functions import absolute, sign, tanh, where
from robodyn_cli.forces.element import InJoint
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Number, key


@record
class Gear(InJoint):
    """Losses of a gear: of the power that goes in, the part ``efficiency`` comes out.

    With T the torque on the motor's side, seen at the joint, and L the one that the joint gets: L = eta T while the
    motor drives (L qd > 0), T = eta' L while the load drives (L qd < 0). The difference opposes the motion.
    """

    term: ClassVar[str] = "gear"
    dissipative: ClassVar[bool] = True
    of_load: ClassVar[bool] = True

    efficiency: float = key(
        Number(minimum=0.0, maximum=1.0, exclusive=True),
        unit="1",
        doc="eta, while the motor drives the load.",
    )
    back_driving: float | None = key(
        Number(minimum=0.0, maximum=1.0),
        default=None,
        unit="1",
        doc="eta', while the load drives the motor; default: `efficiency`.",
    )
    transition_speed: float | None = key(
        Number(minimum=0.0, exclusive=True),
        default=None,
        unit="rad/s or m/s",
        doc="Joint speed over which a simulation smooths the sign of qd; required there.",
    )

    @property
    def _back(self) -> float:
        return self.efficiency if self.back_driving is None else self.back_driving

    def torque_of_load(self, load: Any, qd: Any) -> Any:
        """Return the torque of the losses on the joint for the load L that the joint gets, 0 at rest."""
        part = where(load * qd, 1.0 / self.efficiency - 1.0, 1.0 - self._back)
        return -sign(qd) * absolute(load) * part

    def torque_of_drive(self, drive: Any, qd: Any) -> Any:
        """Return the torque of the losses on the joint for the torque T on the motor's side, as simulations have it.

        Raises
        ------
        CapabilityError : there is no ``transition_speed``, or the gear locks itself (back-driving efficiency 0).
        """
        if self.transition_speed is None:
            raise CapabilityError(
                "gear losses in a simulation need gear.transition_speed, the speed over which the sign of the rate is "
                "smoothed"
            )
        if self._back == 0.0:
            raise CapabilityError("a gear that locks itself (gear.back_driving: 0) cannot be simulated")
        part = where(drive * qd, 1.0 - self.efficiency, 1.0 / self._back - 1.0)
        return -tanh(qd / self.transition_speed) * absolute(drive) * part
