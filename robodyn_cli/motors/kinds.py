"""The kinds of motor: with brushes, servo, stepper, and one of which nothing but torques is known."""

from __future__ import annotations

import math

from robodyn_cli.motors.electric import Curves, Electric, Motor, Problems, Supply, WarmMotor
from robodyn_cli.motors.heat import Envelope, curve_problems
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, Integer, ListOf, Number, Vector, key


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


@record
class BrushlessMotor(Electric):
    """A synchronous servo motor with sinusoidal currents in quadrature: three phases, currents and k_t per ampere rms.

    Power gives the back-EMF of a phase: 3 E I = k_t I w, so E = k_t w / 3 (rms). From the DC voltage U space-vector
    modulation makes U / sqrt(6) a phase (rms). With half the terminals' resistance and inductance a phase

        (E + R I / 2)^2 + (p w L I / 2)^2 <= U^2 / 6,    copper losses 3/2 R I^2.

    The field is not weakened: currents along the axis of the magnets are zero. Source: D. W. Novotny and T. A. Lipo,
    Vector Control and Dynamics of AC Drives, 1996.
    """

    type: str = key(Choice(("brushless",)), doc="Kind of motor.")
    inductance: float = key(
        Number(minimum=0.0), default=0.0, unit="H", doc="Inductance between two terminals."
    )
    pole_pairs: int | None = key(
        Integer(minimum=1), default=None, unit="1", doc="Pairs of poles p; needed with an inductance."
    )

    def problems(self) -> Problems:
        yield from super().problems()
        if self.inductance and self.pole_pairs is None:
            yield ("inductance",), "needs the number of pole pairs: key 'pole_pairs' beside it"
        if self.pole_pairs is not None and not self.inductance:
            yield ("pole_pairs",), "does nothing without an 'inductance'"

    @property
    def copper_factor(self) -> float:
        return 1.5

    @property
    def pieces(self) -> int:
        return 1 if self.inductance == 0.0 else 32

    def driving_current(self, speed: float, voltage: float) -> float:
        return self._current(speed, voltage, 1.0)

    def braking_current(self, speed: float, voltage: float) -> float:
        return self._current(speed, voltage, -1.0)

    def _current(self, speed: float, voltage: float, sense: float) -> float:
        """Return the larger root I of (s E + R I / 2)^2 + (p w L I / 2)^2 = U^2 / 6; 0 beyond the no-load speed."""
        E, R = sense * self.torque_constant * speed / 3.0, 0.5 * self.resistance
        X = 0.5 * (self.pole_pairs or 0) * speed * self.inductance
        rest = voltage * voltage / 6.0 - E * E
        if rest < 0.0:
            return 0.0
        a, b = R * R + X * X, E * R
        root = math.sqrt(b * b + a * rest)
        # the form without cancellation
        return rest / (b + root) if b > 0.0 else (root - b) / a

    def no_load_speed(self, voltage: float) -> float:
        return 3.0 * voltage / (math.sqrt(6.0) * self.torque_constant)


@record
class StepperMotor(WarmMotor):
    """A stepper motor: beyond its pull-out torque it loses steps. Its currents are always the same.

    The losses are ``phases R I^2``, whatever the load. The maker's curve holds for one driver and voltage.
    """

    type: str = key(Choice(("stepper",)), doc="Kind of motor.")
    pull_out: tuple[tuple[float, float], ...] = key(
        ListOf(Vector(2), minimum=2),
        unit="rad/s, N m",
        doc="Pull-out curve: rows of speed and torque, from 0 on.",
    )
    current: float | None = key(
        Number(minimum=0.0, exclusive=True), default=None, unit="A", doc="Current of a phase (rms)."
    )
    resistance: float | None = key(
        Number(minimum=0.0, exclusive=True),
        default=None,
        unit="ohm",
        doc="Resistance of a phase at 25 degC; needed, with the current, for temperatures.",
    )
    phases: int = key(Integer(minimum=2), default=2, unit="1", doc="Phases that carry current.")

    def problems(self) -> Problems:
        for place, fault in curve_problems(self.pull_out):
            yield ("pull_out", *place), fault
        given = [self.current is not None, self.resistance is not None]
        if self.thermal is not None and not all(given):
            yield ("thermal",), "needs the losses of the winding: keys 'current' and 'resistance'"
        if self.thermal is None and any(given):
            name = "current" if self.current is not None else "resistance"
            yield (name,), "does nothing without 'thermal'"

    @property
    def losses(self) -> float | None:
        """Losses of the windings at 25 degC [W], None where they are not known."""
        if self.current is None or self.resistance is None:
            return None
        return self.phases * self.resistance * self.current**2

    def curves(self, supply: Supply) -> Curves:
        curve = Envelope.through(self.pull_out)
        return Curves(curve, curve)


@record
class TorqueTable(Motor):
    """A motor by its curves of torque over speed at the shaft, the same for driving and braking."""

    type: str = key(Choice(("envelope",)), doc="Kind of motor.")
    peak: tuple[tuple[float, float], ...] = key(
        ListOf(Vector(2), minimum=2),
        unit="rad/s, N m",
        doc="Rows of speed and largest torque, speeds from 0 on.",
    )
    continuous: tuple[tuple[float, float], ...] = key(
        ListOf(Vector(2), minimum=2),
        unit="rad/s, N m",
        doc="Rows of speed and the torque that it bears for ever.",
    )

    def problems(self) -> Problems:
        for name in ("peak", "continuous"):
            for place, fault in curve_problems(getattr(self, name)):
                yield (name, *place), fault

    def curves(self, supply: Supply) -> Curves:
        curve = Envelope.through(self.peak)
        return Curves(curve, curve, Envelope.through(self.continuous))
