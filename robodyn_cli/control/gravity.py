"""PD control with compensation of gravity."""

from __future__ import annotations

from typing import Any, ClassVar

from robodyn_cli.control.base import Follower, Situation, tracking
from robodyn_cli.control.pd import PdGains
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, Section, key


@record
class Gravity(Follower):
    """``tau = G(q) + kp e + kd e-dot``, with G of the controller's model; no gains: compensation alone."""

    shares: ClassVar[bool] = True

    type: str = key(Choice(("gravity",)), doc="Kind of controller.")
    gains: PdGains = key(Section(PdGains), default=PdGains(), doc="Its gains.")

    def torques(self, at: Situation) -> list[Any]:
        held = at.gravity()
        return [g + x for g, x in zip(held, tracking(at, self.gains.kp, self.gains.kd))]
