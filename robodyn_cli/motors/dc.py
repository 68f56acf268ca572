"""A motor with brushes, or one that is commutated in blocks: U = R I + k_t w."""

from __future__ import annotations

from robodyn_cli.motors.electric import Electric
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, key


@record
class DcMotor(Electric):
    """A direct-current motor: ``U = R I + k_t w``, ``T = k_t I - T_c sign(w) - b w``, copper losses ``R I^2``.

    The voltage drives the current (U - k_t w) / R, and brakes with (U + k_t w) / R. Source: maxon academy, formulae
    handbook. Inductance is left out: its time constant is far below that of the motion.
    """

    type: str = key(Choice(("dc",)), doc="Kind of motor.")

    def driving_current(self, speed: float, voltage: float) -> float:
        return (voltage - self.torque_constant * speed) / self.resistance

    def braking_current(self, speed: float, voltage: float) -> float:
        return (voltage + self.torque_constant * speed) / self.resistance

    def no_load_speed(self, voltage: float) -> float:
        return voltage / self.torque_constant
