"""Limits of a joint, and stops at the ends of its travel: springs and dampers, or rigid with restitution."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, ClassVar

from robodyn_cli.expr.functions import maximum, power, where
from robodyn_cli.expr.graph import Expr
from robodyn_cli.forces.element import InJoint
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, Number, Section, key
from robodyn_cli.schema.spans import SPAN, Span, span_fault

BOUNDS = ("lower", "upper", "speed", "acceleration", "jerk", "effort")


@record
class JointStop:
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
    """What a joint may do, and the stops at ``lower`` and ``upper``, where there are any.

    A stop exerts a torque away from it while the joint is beyond it; delta is the depth. A rigid one exerts no torque
    here: a simulation reverses the rate at impact, and holds the joint where it rests on the stop. Limits without a
    stop exert nothing: motions that pass them are reported.
    """

    term: ClassVar[str] = "stops"

    lower: float | None = key(Number(), default=None, unit="rad or m", doc="Least q; none by default.")
    upper: float | None = key(Number(), default=None, unit="rad or m", doc="Largest q; none by default.")
    speed: Span | None = key(
        SPAN,
        default=None,
        unit="rad/s or m/s",
        doc="Largest speed, either way; or least and largest rate.",
    )
    acceleration: Span | None = key(
        SPAN,
        default=None,
        unit="rad/s^2 or m/s^2",
        doc="Largest acceleration, either way; or the least and the largest one.",
    )
    jerk: float | None = key(
        Number(minimum=0.0, exclusive=True),
        default=None,
        unit="rad/s^3 or m/s^3",
        doc="Largest rate of the acceleration, either way.",
    )
    effort: Span | None = key(
        SPAN,
        default=None,
        unit="N m or N",
        doc="Largest torque or force of the drive, either way; or the least and the largest one.",
    )
    stop: JointStop | None = key(
        Section(JointStop),
        default=None,
        doc="How stops at `lower` and `upper` give way; without it there are none.",
    )

    def problems(self) -> Iterable[tuple[tuple[str, ...], str]]:
        """Yield what does not fit together."""
        if self.stop is None and all(getattr(self, name) is None for name in BOUNDS):
            yield (), f"needs one of {', '.join(repr(name) for name in BOUNDS)}"
        if self.lower is not None and self.upper is not None and not self.lower < self.upper:
            yield ("upper",), f"must be above 'lower' (value {self.upper!r}, lower {self.lower!r})"
        for name in ("speed", "acceleration", "effort"):
            limit = getattr(self, name)
            if limit is not None and (fault := span_fault(limit, with_zero=name != "effort")):
                yield (name,), fault
        if self.stop is None:
            return
        if self.lower is None and self.upper is None:
            yield ("stop",), "needs 'lower' or 'upper' beside it, where it stands"
        for path, message in self.stop.problems():
            yield ("stop", *path), message

    @property
    def acts(self) -> bool:  # type: ignore[override]
        """Whether there are stops, so that the equations of motion know of them."""
        return self.stop is not None

    @property
    def rigid(self) -> bool:  # type: ignore[override]
        return self.stop is not None and self.stop.restitution is not None

    def _sides(self, q: Any, qd: Any) -> list[tuple[float, Any, Any]]:
        """Return (direction of the push, depth, its rate) of each compliant stop."""
        if self.stop is None or self.rigid:
            return []
        sides: list[tuple[float, Any, Any]] = []
        if self.lower is not None:
            sides.append((1.0, self.lower - q, -qd))
        if self.upper is not None:
            sides.append((-1.0, q - self.upper, qd))
        return sides

    def _law(self, depth: Any, rate: Any) -> Any:
        """Return the force beyond the stop, as if it could also pull."""
        assert self.stop is not None
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
            elastic = self._elastic(depth)
            total = total + push * where(depth, maximum(self._law(depth, rate), 0.0) - elastic, 0.0)
        return total

    def _elastic(self, depth: Any) -> Any:
        assert self.stop is not None
        return self.stop.stiffness * power(maximum(depth, 0.0), self.stop.exponent)

    def potential(self, q: Any) -> Any:
        """Return the energy stored in the stops [J]: k delta^(n + 1) / (n + 1)."""
        if self.stop is None:
            return 0.0
        n = self.stop.exponent + 1.0
        stored = (self.stop.stiffness * power(maximum(x, 0.0), n) / n for _, x, _ in self._sides(q, 0.0))
        return sum(stored, 0.0)

    def switches(self, q: Any, qd: Any) -> list[Expr]:
        """Return what changes its sign where a stop engages or lets go."""
        values = []
        for _, depth, rate in self._sides(q, qd):
            assert self.stop is not None
            values.append(depth)
            if self.stop.damping != 0.0:
                beyond = self.stop.stiffness + self.stop.damping * rate  # sign of Hunt and Crossley's law
                values.append(self._law(depth, rate) if self.stop.law == "spring_damper" else beyond)
        return [x for x in values if isinstance(x, Expr)]
