"""A permanent-magnet servo motor with sinusoidal currents."""

from __future__ import annotations

import math

from robodyn_cli.motors.electric import Electric, Problems
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, Integer, Number, key


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
