"""A belt between a motor and a turning joint, or one that pulls a slide."""

from __future__ import annotations

from typing import Any

from robodyn_cli.motors.gear import Transmission
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, Number, key


@record
class Belt(Transmission):
    """A belt: of a turning joint by the radii of its pulleys, of a slide by that of the motor's pulley alone.

    Its own ``inertia`` is that of pulleys and belt, seen from the motor.
    """

    type: str = key(Choice(("belt",)), doc="Kind of gear.")
    motor_radius: float = key(
        Number(minimum=0.0, exclusive=True), unit="m", doc="Radius of the pulley on the motor."
    )
    joint_radius: float | None = key(
        Number(minimum=0.0, exclusive=True),
        default=None,
        unit="m",
        doc="Radius of the pulley on a turning joint; left out where the belt pulls a slide.",
    )

    @property
    def drives(self) -> str:
        return "m" if self.joint_radius is None else "rad"

    @property
    def turns(self) -> Any:
        return (1.0 if self.joint_radius is None else self.joint_radius) / self.motor_radius
