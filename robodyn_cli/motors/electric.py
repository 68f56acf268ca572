"""What motors have in common, and those whose torque is in proportion to their current."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from robodyn_cli.motors.heat import REFERENCE, Envelope, Thermal
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Number, Section, key
from robodyn_cli.spatial.algebra import Array

Problems = Iterable[tuple[tuple[Any, ...], str]]
Law = Callable[[float], float]


@record
class Supply:
    """What a motor runs on: voltage [V], None for the motor's own, and the temperature around it [degC]."""

    voltage: float | None = None
    ambient: float = REFERENCE


@record
class Part:
    """A part of a drive that has a mass and a price."""

    mass: float = key(Number(minimum=0.0), default=0.0, unit="kg", doc="Mass.")
    cost: float = key(Number(minimum=0.0), default=0.0, unit="1", doc="Price, in any currency.")

    def problems(self) -> Problems:
        """Yield what does not fit together: the path of a key, and what is wrong."""
        return ()


@record
class Curves:
    """Envelopes [rad/s, N m] of the torque at the shaft: while the motor drives, while it brakes, and for ever."""

    driving: Envelope
    braking: Envelope
    continuous: Envelope | None = None


@record
class Motor(Part):
    """A motor."""

    rotor_inertia: float = key(
        Number(minimum=0.0), default=0.0, unit="kg m^2", doc="Moment of inertia of the rotor."
    )

    @property
    def thermal(self) -> Thermal | None:
        """Thermal data, None where no temperatures can be computed."""
        return None

    def curves(self, supply: Supply) -> Curves:
        """Return the envelopes under a supply."""
        raise NotImplementedError


@record
class WarmMotor(Motor):
    """A motor whose winding gets warm by losses that are known."""

    thermal: Thermal | None = key(
        Section(Thermal), default=None, doc="Thermal data, without which no temperatures are computed."
    )


@record
class Electric(WarmMotor):
    """A motor with torque k_t I at the rotor, back-EMF in proportion to the speed, and friction of its bearings.

    T_shaft = k_t I - T_c sign(w) - b w
    """

    torque_constant: float = key(
        Number(minimum=0.0, exclusive=True), unit="N m/A", doc="Torque constant k_t."
    )
    resistance: float = key(
        Number(minimum=0.0, exclusive=True), unit="ohm", doc="Resistance between two terminals at 25 degC."
    )
    voltage: float = key(Number(minimum=0.0, exclusive=True), unit="V", doc="Supply voltage.")
    max_current: float = key(
        Number(minimum=0.0, exclusive=True), unit="A", doc="Largest current of motor and amplifier."
    )
    rated_current: float | None = key(
        Number(minimum=0.0, exclusive=True),
        default=None,
        unit="A",
        doc="Current that it bears for ever; default: what `thermal` allows at standstill.",
    )
    coulomb: float = key(Number(minimum=0.0), default=0.0, unit="N m", doc="Friction torque T_c.")
    viscous: float = key(Number(minimum=0.0), default=0.0, unit="N m s/rad", doc="Viscous friction b.")
    max_speed: float | None = key(
        Number(minimum=0.0, exclusive=True),
        default=None,
        unit="rad/s",
        doc="Largest speed of its mechanics; default: what the voltage allows.",
    )

    def problems(self) -> Problems:
        if self.rated_current is None and self.thermal is None:
            yield (), "has no continuous envelope: give 'rated_current' or 'thermal'"
            return
        problem = self.supply_problem(Supply())
        if problem is not None:
            yield (), problem

    # -- what the kinds of winding say ------------------------------------------------------------------
    @property
    def copper_factor(self) -> float:
        """Copper losses over resistance times current^2."""
        return 1.0

    def driving_current(self, speed: float, voltage: float) -> float:
        """Return the largest current [A] in the sense of the motion that the voltage drives at a speed."""
        raise NotImplementedError

    def braking_current(self, speed: float, voltage: float) -> float:
        """Return the largest current [A] against the motion."""
        raise NotImplementedError

    def no_load_speed(self, voltage: float) -> float:
        """Return the speed [rad/s] whose back-EMF is the voltage."""
        raise NotImplementedError

    # -- what follows from it -----------------------------------------------------------------------------
    def supply_problem(self, supply: Supply) -> str | None:
        """Return why the motor cannot run on a supply, None where it can."""
        if self.thermal is not None and not supply.ambient < self.thermal.max_temperature:
            return f"at {supply.ambient:g} degC its winding is too hot already"
        current = min(self.driving_current(0.0, self._voltage(supply)), self.max_current)
        if self.torque_constant * min(current, self.continuous_current(supply)) <= self.coulomb:
            return "its continuous torque does not overcome its own friction 'coulomb'"
        return None

    def _voltage(self, supply: Supply) -> float:
        return self.voltage if supply.voltage is None else supply.voltage

    def friction(self, speed: Array) -> Array:
        """Return the friction torque [N m] in the sense of the speed."""
        return self.coulomb * np.sign(speed) + self.viscous * speed

    def current(self, torque: Array, speed: Array) -> Array:
        """Return the current [A] that gives a torque at the shaft [N m] at a speed [rad/s]."""
        return (torque + self.friction(speed)) / self.torque_constant

    def copper(self, current: Array) -> Array:
        """Return the losses of the winding [W] at 25 degC."""
        return self.copper_factor * self.resistance * current * current

    def continuous_current(self, supply: Supply) -> float:
        """Return the current [A] that the motor bears for ever: its rating, or what its winding bears hot.

        I^2 = (theta_max - theta_ambient) / (c R (1 + alpha (theta_max - 25)) (R1 + R2))
        """
        if self.rated_current is not None:
            return self.rated_current
        thermal = self.thermal
        assert thermal is not None
        hot = (
            self.copper_factor * self.resistance * float(thermal.growth(np.asarray(thermal.max_temperature)))
        )
        return math.sqrt(max(0.0, thermal.max_temperature - supply.ambient) / (hot * thermal.whole))

    def curves(self, supply: Supply) -> Curves:
        voltage = self._voltage(supply)
        free = self.no_load_speed(voltage)
        top = free if self.max_speed is None else min(free, self.max_speed)
        most, rated = self.max_current, min(self.max_current, self.continuous_current(supply))
        drive, brake = self.driving_current, self.braking_current
        return Curves(
            driving=self._curve(top, lambda w: drive(w, voltage), most, -1.0),
            braking=self._curve(top, lambda w: brake(w, voltage), most, 1.0),
            continuous=self._curve(top, lambda w: drive(w, voltage), rated, -1.0),
        )

    def _curve(self, top: float, current: Law, most: float, friction: float) -> Envelope:
        """Return the torque at the shaft by speed, up to its zero or the top speed.

        current : that the voltage allows. most : that other limits allow. friction : its sign in the torque.
        """

        def torque(w: float) -> float:
            electric = self.torque_constant * min(most, current(w))
            return electric + friction * (self.coulomb + self.viscous * w)

        end = top if torque(top) >= 0.0 else _zero(torque, top)
        speeds = {end * k / self.pieces for k in range(self.pieces + 1)}
        if (current(0.0) > most) != (current(end) > most):
            speeds.add(_zero(lambda w: current(w) - most, end))
        points = [(w, max(0.0, torque(w))) for w in sorted(speeds)]
        return Envelope.through([p for p in points if p[1] > 0.0 or p[0] == end])

    @property
    def pieces(self) -> int:
        """In how many pieces the curves are drawn beside their corners."""
        return 1


def _zero(function: Law, end: float) -> float:
    """Return where a function that changes its sign between 0 and ``end`` does so."""
    low, high, positive = 0.0, end, function(0.0) > 0.0
    while low < (middle := 0.5 * (low + high)) < high:
        low, high = (middle, high) if (function(middle) > 0.0) == positive else (low, middle)
    return low
