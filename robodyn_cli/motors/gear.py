"""What stands between a motor and its joint: gears, belts and ball screws."""

from __future__ import annotations

import math
from typing import Any

from robodyn_cli.forces.friction import Gear
from robodyn_cli.motors.electric import Part
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, Number, key
from robodyn_cli.spatial.algebra import Array


@record
class Transmission(Part):
    """What gears of all kinds have. ``ratio`` : motor turns [rad] over the joint's coordinate [rad or m]."""

    efficiency: float = key(
        Number(minimum=0.01, maximum=1.0),
        default=1.0,
        unit="1",
        doc="Part of the power that comes out while the motor drives the load.",
    )
    back_driving: float | None = key(
        Number(minimum=0.0, maximum=1.0),
        default=None,
        unit="1",
        doc="The same while the load drives the motor, 0 for one that locks itself; default: `efficiency`.",
    )
    inertia: float = key(
        Number(minimum=0.0), default=0.0, unit="kg m^2", doc="Its own moment of inertia at the motor's shaft."
    )
    peak_torque: float | None = key(
        Number(minimum=0.0, exclusive=True),
        default=None,
        unit="N m or N",
        doc="Largest torque or force on the joint that it bears.",
    )
    rated_torque: float | None = key(
        Number(minimum=0.0, exclusive=True),
        default=None,
        unit="N m or N",
        doc="Mean torque or force (root mean cube, weighted by the speed) that it bears for its life.",
    )
    max_speed: float | None = key(
        Number(minimum=0.0, exclusive=True),
        default=None,
        unit="rad/s",
        doc="Largest speed at the motor's shaft.",
    )
    stiffness: float | None = key(
        Number(minimum=0.0, exclusive=True),
        default=None,
        unit="N m/rad or N/m",
        doc="Stiffness at the joint, for the wind-up under load; in the equations of motion it is rigid.",
    )

    @property
    def drives(self) -> str:
        """Unit of the joints that it drives: ``rad`` or ``m``."""
        return "rad"

    @property
    def turns(self) -> Any:
        """Motor turns [rad] over the joint's coordinate [rad or m]."""
        raise NotImplementedError

    def input_load(self, load: Array, rate: Array) -> Array:
        """Return the torque or force on the motor's side, in joint terms, for what the joint gets and its rate.

        The equations are those of the key ``gear`` of a joint (see ``forces.gear``).
        """
        return load - Gear(self.efficiency, self.back_driving).torque_of_load(load, rate)


@record
class RotaryGear(Transmission):
    """A gear with a fixed ratio: planetary, spur, worm, strain wave."""

    type: str = key(Choice(("gear",)), doc="Kind of gear.")
    ratio: float = key(
        Number(minimum=0.0, exclusive=True), unit="1", doc="Turns of the motor a turn of the joint."
    )

    @property
    def turns(self) -> Any:
        return self.ratio


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


@record
class BallScrew(Transmission):
    """A ball screw, roller screw or trapezoidal screw, which turns a motor's turns into a slide's way."""

    type: str = key(Choice(("ball_screw",)), doc="Kind of gear.")
    lead: float = key(Number(minimum=0.0, exclusive=True), unit="m", doc="Way of the slide a turn.")

    @property
    def drives(self) -> str:
        return "m"

    @property
    def turns(self) -> Any:
        return 2.0 * math.pi / self.lead
