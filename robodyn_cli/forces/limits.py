"""Stops at the ends of a joint's travel: springs and dampers, or rigid with restitution."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, ClassVar

from robodyn_cli.expr.functions import maximum, power, where
from robodyn_cli.expr.graph import Expr
from robodyn_cli.forces.element import InJoint
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, Number, Section, key


@record
class Stop:
    """How a stop gives way: ``stiffness`` (with damping), or ``restitution`` of a rigid one."""

    stiffness: float | None = key(
        Number(minimum=0.0, exclusive=True), default=None, unit="N m/rad or N/m", doc="Stiffness k."
    )
    damping: float = key(Number(minimum=0.0), default=0.0, unit="N m s/rad or N s/m", doc="Damping c.")
    law: str = key(
        Choice(("spring_damper", "hunt_crossley")),
        default="spring_damper",
        doc="`k delta + c delta-dot`, or `delta^n (k + c delta-dot)`; never pulls.",
    )
    exponent: float = key(
        Number(minimum=1.0),
        default=1.0,
        unit="1",
        doc="Exponent n of `hunt_crossley`; k and c are per unit^n.",
    )
    restitution: float | None = key(
        Number(minimum=0.0, maximum=1.0),
        default=None,
        unit="1",
        doc="Speed after over speed before an impact on a rigid stop.",
    )

    def problems(self) -> Iterable[tuple[tuple[str, ...], str]]:
        """Yield what does not fit together."""
        if (self.stiffness is None) == (self.restitution is None):
            yield (), "needs either 'stiffness' (with 'damping') or 'restitution'"
        elif self.restitution is not None and self.damping != 0.0:
            yield ("damping",), "does not go with 'restitution'"
        if self.exponent != 1.0 and self.law == "spring_damper":
            yield ("exponent",), "goes with 'law: hunt_crossley'"


@record
class Limits(InJoint):
    """Stops at ``lower`` and ``upper``: torque away from the stop while the joint is beyond it.

    delta is the depth beyond the stop. A rigid stop exerts no torque here: a simulation reverses the rate at impact,
    and holds the joint where it rests on the stop.
    """

    term: ClassVar[str] = "stops"

    lower: float | None = key(
        Number(angle=True), default=None, unit="rad or m", doc="Stop at small q; none by default."
    )
    upper: float | None = key(
        Number(angle=True), default=None, unit="rad or m", doc="Stop at large q; none by default."
    )
    stop: Stop = key(Section(Stop), default=Stop(), doc="How the stops give way.")

    def problems(self) -> Iterable[tuple[tuple[str, ...], str]]:
        """Yield what does not fit together."""
        if self.lower is None and self.upper is None:
            yield (), "needs 'lower' or 'upper'"
        if self.lower is not None and self.upper is not None and not self.lower < self.upper:
            yield ("upper",), f"must be above 'lower' (value {self.upper!r}, lower {self.lower!r})"
        for path, message in self.stop.problems():
            yield ("stop", *path), message

    @property
    def rigid(self) -> bool:
        return self.stop.restitution is not None

    def _sides(self, q: Any, qd: Any) -> list[tuple[float, Any, Any]]:
        """Return (direction of the push, depth, its rate) of each compliant stop."""
        if self.rigid:
            return []
        found: list[tuple[float, Any, Any]] = []
        if self.lower is not None:
            found.append((1.0, self.lower - q, -qd))
        if self.upper is not None:
            found.append((-1.0, q - self.upper, qd))
        return found

    def _law(self, depth: Any, rate: Any) -> Any:
        """Return the force beyond the stop, as if it could also pull."""
        k, c = self.stop.stiffness, self.stop.damping
        if self.stop.law == "spring_damper":
            return k * depth + c * rate
        return power(maximum(depth, 0.0), self.stop.exponent) * (k + c * rate)

    def torque(self, q: Any, qd: Any, gear_ratio: float, smooth: bool) -> Any:
        """Return the torque on the joint [N m or N]."""
        pushes = (
            push * where(depth, maximum(self._law(depth, rate), 0.0), 0.0)
            for push, depth, rate in self._sides(q, qd)
        )
        return sum(pushes, 0.0)

    def loss(self, q: Any, qd: Any, gear_ratio: float, smooth: bool) -> Any:
        """Return the part of the torque that is not the gradient of the potential energy."""
        total: Any = 0.0
        for push, depth, rate in self._sides(q, qd):
            elastic = self.stop.stiffness * power(maximum(depth, 0.0), self.stop.exponent)
            total = total + push * where(depth, maximum(self._law(depth, rate), 0.0) - elastic, 0.0)
        return total

    def potential(self, q: Any) -> Any:
        """Return the energy stored in the stops [J]: k delta^(n + 1) / (n + 1)."""
        n = self.stop.exponent + 1.0
        stored = (self.stop.stiffness * power(maximum(x, 0.0), n) / n for _, x, _ in self._sides(q, 0.0))
        return sum(stored, 0.0)

    def switches(self, q: Any, qd: Any) -> list[Expr]:
        """Return what changes its sign where a stop engages or lets go."""
        found = []
        for _, depth, rate in self._sides(q, qd):
            found.append(depth)
            if self.stop.damping != 0.0:
                beyond = self.stop.stiffness + self.stop.damping * rate  # sign of Hunt and Crossley's law
                found.append(self._law(depth, rate) if self.stop.law == "spring_damper" else beyond)
        return [x for x in found if isinstance(x, Expr)]
