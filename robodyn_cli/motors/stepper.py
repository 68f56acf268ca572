"""A stepper motor, by its pull-out curve."""

from __future__ import annotations

from robodyn_cli.motors.electric import Curves, Problems, Supply, WarmMotor
from robodyn_cli.motors.envelope import Envelope, curve_problems
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, Integer, ListOf, Number, Vector, key


@record
class Stepper(WarmMotor):
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
        for place, what in curve_problems(self.pull_out):
            yield ("pull_out", *place), what
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
