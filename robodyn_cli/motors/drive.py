"""The drive of a joint: motor, gear and brake of a catalogue, and how they are used."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property
from typing import Any

import numpy as np

from robodyn_cli.expr.graph import is_nonzero
from robodyn_cli.motors.electric import Curves, Motor, Part, Supply
from robodyn_cli.motors.gear import Transmission
from robodyn_cli.motors.heat import REFERENCE
from robodyn_cli.motors.registry import gear_types, motor_types
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Integer, MapOf, Name, Number, Section, Tagged, Text, Vector, key
from robodyn_cli.spatial.algebra import Array

NOWHERE = "none"  # as `mass_on`: the links' masses hold those of the drives


@record
class Brake(Part):
    """A brake on a motor's shaft that holds the joint without current."""

    holding_torque: float = key(
        Number(minimum=0.0, exclusive=True), unit="N m", doc="Torque that it holds at the motor's shaft."
    )
    inertia: float = key(Number(minimum=0.0), default=0.0, unit="kg m^2", doc="Moment of inertia.")


@record
class Catalogue:
    """Motors, gears and brakes by name."""

    title: str = key(Text(), default="", doc="Title of the catalogue, for reports.")
    motors: dict[str, Any] = key(
        MapOf(Tagged(lambda: motor_types), of="motor", minimum=0), default=None, doc="Motors."
    )
    gears: dict[str, Any] = key(
        MapOf(Tagged(lambda: gear_types), of="gear", minimum=0), default=None, doc="Gears."
    )
    brakes: dict[str, Brake] = key(MapOf(Section(Brake), of="brake", minimum=0), default=None, doc="Brakes.")

    def used_by(self, drives: Iterable[Drive]) -> Catalogue:
        """Return the catalogue with what these drives use alone."""
        names = {name for drive in drives for name in (drive.motor, drive.gear, drive.brake)}
        parts = [
            {n: x for n, x in group.items() if n in names} for group in (self.motors, self.gears, self.brakes)
        ]
        return Catalogue(self.title, *parts)


@record
class Drive:
    """What drives a joint, in place of its ``gear_ratio``, ``rotor_inertia`` and ``gear``."""

    motor: str = key(Name(of="motor"), doc="Motor of the catalogue.")
    gear: str | None = key(Name(of="gear"), default=None, doc="Gear of the catalogue; default: none.")
    brake: str | None = key(Name(of="brake"), default=None, doc="Brake of the catalogue; default: none.")
    count: int = key(
        Integer(minimum=1), default=1, unit="1", doc="Equal drives, each with its gear, that share the load."
    )
    coupling_inertia: float = key(
        Number(minimum=0.0),
        default=0.0,
        unit="kg m^2",
        doc="Moment of inertia of couplings and the like at the motor's shaft.",
    )
    mass: float | None = key(
        Number(minimum=0.0),
        default=None,
        unit="kg",
        doc="Mass of each drive; default: that of its parts in the catalogue.",
    )
    mass_on: str | None = key(
        Text(),
        default=None,
        doc="Link that carries the mass, or `none` where the links' masses hold it; default: the link that the joint "
        "hangs on.",
    )
    mass_at: tuple[float, ...] | None = key(
        Vector(3),
        default=None,
        unit="m",
        doc="Where on that link, in its frame; default: at the joint, on one of the links that it connects.",
    )
    voltage: float | None = key(
        Number(minimum=0.0, exclusive=True),
        default=None,
        unit="V",
        doc="Supply voltage; default: the motor's.",
    )
    ambient: float = key(
        Number(minimum=-100.0), default=REFERENCE, unit="degC", doc="Temperature of the surroundings."
    )
    margin: float = key(
        Number(minimum=0.0, maximum=0.99),
        default=0.0,
        unit="1",
        doc="Part of every limit that is to be left.",
    )


@record
class Train:
    """A drive with its parts: all that a joint's figures follow from."""

    drive: Drive
    motor: Motor
    gear: Transmission | None
    brake: Brake | None

    @staticmethod
    def of(drive: Drive, catalogue: Catalogue) -> Train:
        """Return a drive with its parts of a catalogue, whose names are known."""
        gear = None if drive.gear is None else catalogue.gears[drive.gear]
        brake = None if drive.brake is None else catalogue.brakes[drive.brake]
        return Train(drive, catalogue.motors[drive.motor], gear, brake)

    @property
    def parts(self) -> list[Any]:
        """Its parts."""
        return [part for part in (self.motor, self.gear, self.brake) if part is not None]

    @property
    def turns(self) -> Any:
        """Motor turns [rad] over the joint's coordinate [rad or m]."""
        return 1.0 if self.gear is None else self.gear.turns

    @property
    def inertia(self) -> Any:
        """Moment of inertia of one motor's shaft: rotor, gear, brake and couplings [kg m^2]."""
        inertia = self.motor.rotor_inertia
        for more in (*(part.inertia for part in self.parts[1:]), self.drive.coupling_inertia):
            if is_nonzero(more):
                inertia = inertia + more
        return inertia

    @property
    def reflected(self) -> Any:
        """What all shafts add to the inertia at the joint [kg m^2 or kg]."""
        return self.drive.count * (self.turns * self.turns * self.inertia)

    @property
    def mass(self) -> Any:
        """Mass of all drives of the joint [kg]."""
        own = (
            sum((part.mass for part in self.parts if is_nonzero(part.mass)), 0.0)
            if self.drive.mass is None
            else self.drive.mass
        )
        return own * self.drive.count

    @property
    def cost(self) -> float:
        """Price of all drives of the joint."""
        return self.drive.count * sum(part.cost for part in self.parts)

    def available(self, rate: Array) -> Array:
        """Return the torque or force that all drives of the joint can give it while they drive it, at its rate.

            count * min(efficiency N T(N |qd|), largest torque of the gear),   0 beyond the speeds of motor and gear

        rate : (...) [rad/s or m/s]. Returns (...) [N m or N], without what the shaft itself needs.
        """
        speed, curve, gear = np.abs(self.turns * rate), self.curves.driving, self.gear
        torque = self.turns * np.interp(speed, curve.speeds, curve.torques, right=0.0)
        if gear is not None:
            torque = gear.efficiency * torque
            torque = torque if gear.peak_torque is None else np.minimum(torque, gear.peak_torque)
            torque = torque if gear.max_speed is None else np.where(speed > gear.max_speed, 0.0, torque)
        return np.asarray(self.drive.count * torque)

    @property
    def corners(self) -> list[float]:
        """The rates of the joint [rad/s or m/s] at which ``available`` jumps or bends, first those where it does most:
        the largest speeds of motor and gear, where the gear begins to bear less, and vertices of the envelope."""
        curve, gear = self.curves.driving, self.gear
        speeds, torques = curve.speeds, curve.torques
        with np.errstate(divide="ignore"):  # an upright edge is a jump
            bends = np.abs(np.diff(np.diff(torques) / np.diff(speeds)))
        found = [curve.top_speed]
        if gear is not None and gear.max_speed is not None:
            found.append(gear.max_speed)
        if gear is not None and gear.peak_torque is not None:
            over = gear.efficiency * self.turns * torques - gear.peak_torque
            passes = np.flatnonzero(over[:-1] * over[1:] < 0.0)
            part = over[passes] / (over[passes] - over[passes + 1])
            found += (speeds[passes] + part * np.diff(speeds)[passes]).tolist()
        found += speeds[1:-1][np.argsort(-bends, kind="stable")].tolist()
        return [float(speed / self.turns) for speed in found]

    @property
    def supply(self) -> Supply:
        """What the motor runs on."""
        return Supply(self.drive.voltage, self.drive.ambient)

    @cached_property
    def curves(self) -> Curves:
        """Envelopes of one motor."""
        return self.motor.curves(self.supply)
