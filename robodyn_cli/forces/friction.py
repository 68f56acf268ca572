"""Viscous and Coulomb friction in a joint."""

from __future__ import annotations

import dataclasses
from typing import Any, ClassVar

from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.functions import sign, tanh, where
from robodyn_cli.schema.fields import Choice, Either, Number, Section, key


@dataclasses.dataclass(frozen=True)
class CoulombPair:
    """Coulomb friction that differs with the direction; both values are magnitudes or carry their own sign."""

    positive: float = key(
        Number(), unit="N m or N", doc="Level for qd > 0 (opposes the motion when positive)."
    )
    negative: float = key(
        Number(),
        unit="N m or N",
        doc="Level for qd < 0 (opposes the motion when negative, as in Puma's Tc-).",
    )


@dataclasses.dataclass(frozen=True)
class Friction:
    """Torque ``tau = -(b qd + tau_c(sign qd))``.

    On the motor side the torque is reflected: ``N^2 b`` and ``|N| tau_c`` (Corke and Armstrong-Helouvry 1994).
    ``inverse`` uses the exact sign (0 at rest). A simulation needs ``transition_speed`` v: the sign becomes
    ``tanh(qd / v)``.
    """

    term: ClassVar[str] = "friction"
    dissipative: ClassVar[bool] = True

    viscous: float = key(
        Number(minimum=0.0), default=0.0, unit="N m s/rad or N s/m", doc="Viscous coefficient b."
    )
    coulomb: Any = key(
        Either((Number(minimum=0.0), Section(CoulombPair))),
        default=0.0,
        unit="N m or N",
        doc="Coulomb level, or {positive, negative}.",
    )
    side: str = key(Choice(("joint", "motor")), default="joint", doc="Side of the gear on which it acts.")
    transition_speed: float | None = key(
        Number(minimum=0.0, exclusive=True),
        default=None,
        unit="rad/s or m/s",
        doc="Joint speed over which a simulation smooths the sign of qd; required there with Coulomb friction.",
    )

    def levels(self) -> tuple[float, float]:
        """Return the Coulomb levels (for qd > 0, for qd < 0), signed so that they oppose the motion."""
        if isinstance(self.coulomb, CoulombPair):
            return self.coulomb.positive, self.coulomb.negative
        return self.coulomb, -self.coulomb

    def torque(self, q: Any, qd: Any, gear_ratio: float, smooth: bool) -> Any:
        """Return the torque on the joint [N m or N]; ``smooth`` for simulations.

        Raises
        ------
        CapabilityError : Coulomb friction in a simulation without ``transition_speed``.
        """
        motor = self.side == "motor"
        b = self.viscous * (gear_ratio**2 if motor else 1.0)
        scale = abs(gear_ratio) if motor else 1.0
        plus, minus = (scale * level for level in self.levels())
        if plus == 0.0 and minus == 0.0:
            return -b * qd
        if not smooth:
            direction = sign(qd)
        elif self.transition_speed is None:
            raise CapabilityError(
                "Coulomb friction in a simulation needs friction.transition_speed, the speed over which the "
                "sign of the rate is smoothed"
            )
        else:
            direction = tanh(qd / self.transition_speed)
        if plus == -minus:
            return -b * qd - plus * direction
        # the two levels meet in the mean of their magnitudes at rest, where direction is 0
        return -b * qd - direction * where(qd, plus, -minus)

    def potential(self, q: Any) -> Any:
        """Return the potential energy [J]: none."""
        return 0.0
