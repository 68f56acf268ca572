"""Proportional and derivative control of each joint."""

from __future__ import annotations

from typing import Any

from robodyn_cli.control.base import Follower, Situation, gain, tracking
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, Section, key


@record
class PdGains:
    """Gains of ``pd``."""

    kp: Any = gain("N m/rad or N/m", "Torque for each unit of error; a number, or a map by joint.")
    kd: Any = gain("N m s/rad or N s/m", "Torque for each unit of the error's rate; likewise.")


@record
class Pd(Follower):
    """``tau = kp e + kd e-dot`` with the error ``e = q_ref - q``."""

    type: str = key(Choice(("pd",)), doc="Kind of controller.")
    gains: PdGains = key(Section(PdGains), doc="Its gains.")

    def torques(self, at: Situation) -> list[Any]:
        return tracking(at, self.gains.kp, self.gains.kd)
