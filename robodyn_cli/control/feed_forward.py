"""Feed-forward: the torques of the reference by inverse dynamics, with feedback of what is left."""

from __future__ import annotations

from typing import Any, ClassVar

from robodyn_cli.control.base import Follower, Situation, tracking
from robodyn_cli.control.pd import PdGains
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, Section, key


@record
class FeedForward(Follower):
    """``tau = ID(q_ref, qd_ref, qdd_ref) + kp e + kd e-dot``, with ID of the controller's model."""

    shares: ClassVar[bool] = True
    whole: ClassVar[bool] = True

    type: str = key(Choice(("feed_forward",)), doc="Kind of controller.")
    gains: PdGains = key(Section(PdGains), default=PdGains(), doc="Its gains.")

    def torques(self, at: Situation) -> list[Any]:
        return [x + y for x, y in zip(at.feed_forward(), tracking(at, self.gains.kp, self.gains.kd))]
