"""A motor of which nothing but its torques is known."""

from __future__ import annotations

from robodyn_cli.motors.electric import Curves, Motor, Problems, Supply
from robodyn_cli.motors.envelope import Envelope, curve_problems
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, ListOf, Vector, key


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
            for place, what in curve_problems(getattr(self, name)):
                yield (name, *place), what

    def curves(self, supply: Supply) -> Curves:
        curve = Envelope.through(self.peak)
        return Curves(curve, curve, Envelope.through(self.continuous))
