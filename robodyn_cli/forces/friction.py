"""Losses in a joint: viscous, Coulomb and Stribeck friction, and what its gear loses in proportion to the load."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, ClassVar

import numpy as np

from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.functions import absolute, exp, maximum, sign, sqrt, tanh, where
from robodyn_cli.forces.element import InJoint
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, Either, Number, Section, key, role_key
from robodyn_cli.spatial.algebra import dot

SMALL = 1e-2  # x^2 below which a series replaces tanh(x) / x
TANH = (1.0, -1 / 3, 2 / 15, -17 / 315, 62 / 2835, -1382 / 155925, 21844 / 6081075)  # in even powers
AT_REST = 1e-300  # keeps the quotient at rest finite


@record
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


def _signed(level: Any) -> tuple[float, float]:
    return (level.positive, level.negative) if isinstance(level, CoulombPair) else (level, -level)


@record
class Friction(InJoint):
    """Torque ``tau = -(b qd + tau_c(sign qd))``.

    tau_c falls from ``static`` to ``coulomb`` as exp(-(qd / stribeck_speed)^2). On the motor side the torque is
    reflected: ``N^2 b`` and ``|N| tau_c`` (Corke and Armstrong-Helouvry 1994). ``inverse`` uses the exact sign (0 at
    rest). A simulation either smooths it, with ``transition_speed`` v, to ``tanh(qd / v)``, or holds the joint at rest
    (``law: set_valued``). In a ball joint, and on any other motion in space, it acts against the angular velocity w or
    the velocity, with |w| as qd.
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
        doc="Joint speed over which a simulation smooths the sign of qd; required there with `law: smooth`.",
    )
    law: str = key(
        Choice(("smooth", "set_valued")),
        default="smooth",
        doc="Coulomb friction in simulations: smoothed, or with exact sticking and slipping.",
    )
    static: Any = key(
        Either((Number(minimum=0.0), Section(CoulombPair))),
        default=None,
        unit="N m or N",
        doc="Level at rest (break-away), or {positive, negative}; default: `coulomb`.",
    )
    stribeck_speed: float | None = key(
        Number(minimum=0.0, exclusive=True),
        default=None,
        unit="rad/s or m/s",
        doc="Joint speed over which friction falls from `static` to `coulomb`.",
    )
    role: str = role_key("friction")

    def levels(self) -> tuple[float, float]:
        """Return the Coulomb levels (for qd > 0, for qd < 0), signed so that they oppose the motion."""
        return _signed(self.coulomb)

    @property
    def dry(self) -> bool:
        """Whether there is Coulomb friction, or friction at rest."""
        return self.levels() != (0.0, 0.0) or self.static is not None

    @property
    def set_valued(self) -> bool:  # type: ignore[override]
        """Whether a simulation holds the joint at rest by events."""
        return self.law == "set_valued" and self.dry

    @property
    def is_smoothed(self) -> bool:
        """Whether a simulation smooths the sign of the rate."""
        return self.law == "smooth" and self.dry

    def problems(self) -> Iterable[tuple[tuple[str, ...], str]]:
        if self.law == "set_valued" and self.transition_speed is not None:
            yield ("transition_speed",), "does not go with 'law: set_valued', which smooths nothing"
        if self.stribeck_speed is not None and self.static is None:
            yield ("stribeck_speed",), "needs 'static', the level from which friction falls"
        if self.static is not None and self.law == "smooth" and self.stribeck_speed is None:
            yield ("static",), "needs 'stribeck_speed' beside it, or 'law: set_valued'"
        levels = [self.levels()] if self.static is None else [self.levels(), _signed(self.static)]
        if self.law == "set_valued" and any(plus < 0.0 or minus > 0.0 for plus, minus in levels):
            yield ("law",), "'set_valued' needs levels that oppose the motion: positive >= 0, negative <= 0"
        if self.static is not None and any(abs(s) < abs(c) for c, s in zip(*levels)):
            yield ("static",), "must not be below 'coulomb'"

    def problems_along(self, in_space: bool) -> Iterable[tuple[tuple[str, ...], str]]:
        if not in_space:
            return
        if self.law == "set_valued":
            yield ("law",), "'set_valued' holds single coordinates at rest; allowed here: smooth"
        if not self._symmetric:
            key = "coulomb" if isinstance(self.coulomb, CoulombPair) else "static"
            yield (
                (key,),
                "differs with the direction, and a motion in space has no forwards; allowed here: a number",
            )
        if self.side == "motor":
            yield ("side",), "is 'motor', and no gear drives a motion in space; allowed here: joint"

    def scale(self, gear_ratio: float) -> float:
        """Return the factor by which a level is seen at the joint."""
        return abs(gear_ratio) if self.side == "motor" else 1.0

    def breakaway(self, gear_ratio: float) -> tuple[float, float]:
        """Return the largest torques against motion forwards and backwards at rest, both >= 0 [N m or N]."""
        plus, minus = _signed(self.coulomb if self.static is None else self.static)
        return self.scale(gear_ratio) * plus, -self.scale(gear_ratio) * minus

    def sliding(self, qd: Any, gear_ratio: float) -> tuple[Any, Any]:
        """Return the levels against motion forwards and backwards at rate ``qd``, signed as ``levels``."""
        factor = self.scale(gear_ratio)
        plus, minus = (factor * level for level in self.levels())
        if self.static is None or self.stribeck_speed is None:
            return plus, minus
        ratio = qd / self.stribeck_speed
        falling = exp(-(dot(ratio, ratio) if isinstance(qd, np.ndarray) else ratio * ratio))
        over = [factor * s - c for s, c in zip(_signed(self.static), (plus, minus))]
        return plus + over[0] * falling, minus + over[1] * falling

    def viscous_torque(self, qd: Any, gear_ratio: float) -> Any:
        """Return -b qd [N m or N]."""
        return -self.viscous * (gear_ratio * gear_ratio if self.side == "motor" else 1.0) * qd

    def torque(self, q: Any, qd: Any, gear_ratio: float, smooth: bool) -> Any:
        """Return the torque on the joint [N m or N]; ``smooth`` for simulations. In space ``qd`` is a vector.

        Raises
        ------
        CapabilityError : Coulomb friction in a simulation without ``transition_speed``.
        """
        plus, minus = self.sliding(qd, gear_ratio)
        drag = self.viscous_torque(qd, gear_ratio)
        if not self.dry:
            return drag
        if smooth and self.transition_speed is None:
            raise CapabilityError(
                "Coulomb friction in a simulation needs friction.transition_speed, the speed over which the "
                "sign of the rate is smoothed, or 'law: set_valued'"
            )
        direction = self._direction(qd, smooth)
        if self._symmetric:
            return drag - plus * direction
        # the two levels meet in the mean of their magnitudes at rest, where direction is 0
        return drag - direction * where(qd, plus, -minus)

    def _direction(self, qd: Any, smooth: bool) -> Any:
        """Return the sign of the rate, or in space the unit vector along it; smoothed by tanh."""
        if not isinstance(qd, np.ndarray):
            return tanh(qd / self.transition_speed) if smooth else sign(qd)
        square = dot(qd, qd)
        if not smooth:
            return qd * where(square, 1.0 / sqrt(maximum(square, AT_REST)), 0.0)
        assert self.transition_speed is not None
        x2 = square / (self.transition_speed * self.transition_speed)
        x = sqrt(maximum(x2, SMALL))
        near: Any = 0.0
        for a in reversed(TANH):
            near = near * x2 + a
        return qd * (where(x2 - SMALL, tanh(x) / x, near) / self.transition_speed)

    @property
    def _symmetric(self) -> bool:
        pairs = [self.levels()] if self.static is None else [self.levels(), _signed(self.static)]
        return all(plus == -minus for plus, minus in pairs)

    def slip_torque(self, qd: Any, gear_ratio: float, direction: Any) -> Any:
        """Return the torque while the joint slips in ``direction`` +1 or -1, and of viscous drag at 0."""
        plus, minus = self.sliding(qd, gear_ratio)
        drag = self.viscous_torque(qd, gear_ratio)
        if self._symmetric:
            return drag - plus * direction
        forwards, backwards = 0.5 * direction * (direction + 1.0), 0.5 * direction * (direction - 1.0)
        return drag - plus * forwards - minus * backwards


@record
class Gear(InJoint):
    """Losses of a gear: of the power that goes in, the part ``efficiency`` comes out.

    With T the torque on the motor's side, seen at the joint, and L the one that the joint gets: L = eta T while the
    motor drives (L qd > 0), T = eta' L while the load drives (L qd < 0). The difference opposes the motion.
    """

    term: ClassVar[str] = "gear"
    dissipative: ClassVar[bool] = True
    of_load: ClassVar[bool] = True

    efficiency: float = key(
        Number(minimum=0.0, maximum=1.0, exclusive=True),
        unit="1",
        doc="eta, while the motor drives the load.",
    )
    back_driving: float | None = key(
        Number(minimum=0.0, maximum=1.0),
        default=None,
        unit="1",
        doc="eta', while the load drives the motor; default: `efficiency`.",
    )
    transition_speed: float | None = key(
        Number(minimum=0.0, exclusive=True),
        default=None,
        unit="rad/s or m/s",
        doc="Joint speed over which a simulation smooths the sign of qd; required there.",
    )

    @property
    def _back(self) -> float:
        return self.efficiency if self.back_driving is None else self.back_driving

    def torque_of_load(self, load: Any, qd: Any) -> Any:
        """Return the torque of the losses on the joint for the load L that the joint gets, 0 at rest."""
        part = where(load * qd, 1.0 / self.efficiency - 1.0, 1.0 - self._back)
        return -sign(qd) * absolute(load) * part

    def torque_of_drive(self, drive: Any, qd: Any) -> Any:
        """Return the torque of the losses on the joint for the torque T on the motor's side, as simulations have it.

        Raises
        ------
        CapabilityError : there is no ``transition_speed``, or the gear locks itself (back-driving efficiency 0).
        """
        if self.transition_speed is None:
            raise CapabilityError(
                "gear losses in a simulation need gear.transition_speed, the speed over which the sign of the rate is "
                "smoothed"
            )
        if self._back == 0.0:
            raise CapabilityError("a gear that locks itself (gear.back_driving: 0) cannot be simulated")
        part = where(drive * qd, 1.0 - self.efficiency, 1.0 / self._back - 1.0)
        return -tanh(qd / self.transition_speed) * absolute(drive) * part
