"""PID control of each joint, with an integral that does not wind up where torques are limited."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from robodyn_cli.control.base import PER_JOINT, Follower, Situation, gain, tracking
from robodyn_cli.control.pd import PdGains
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, Section, key


@record
class PidGains(PdGains):
    """Gains of ``pid``."""

    ki: Any = gain("N m/(rad s) or N/(m s)", "Rate of the torque for each unit of error; likewise.")
    anti_windup: Any = key(
        PER_JOINT,
        default=None,
        unit="1/s",
        doc="Rate at which the integral gives way while the torque is limited; by default ki / kp. 0: it winds up.",
    )


@record
class Pid(Follower):
    """``tau = kp e + kd e-dot + s``, ``s-dot = ki e + w (tau_given - tau)``.

    The integral s [N m or N] goes on as if the torque asked for were the one that the limits leave (back-calculation,
    Astrom and Hagglund 2006, section 3.5); w is ``anti_windup``.
    """

    type: str = key(Choice(("pid",)), doc="Kind of controller.")
    gains: PidGains = key(Section(PidGains), doc="Its gains.")

    def states(self, joints: Sequence[str]) -> list[tuple[str, float]]:
        return [(f"integral.{name}", 0.0) for name in joints]

    def torques(self, at: Situation) -> list[Any]:
        return [x + s for x, s in zip(tracking(at, self.gains.kp, self.gains.kd), at.states)]

    def rates(self, at: Situation, asked: Sequence[Any], given: Sequence[Any]) -> list[Any]:
        q, _, _ = at.reference
        ki = at.each(self.gains.ki, "gains.ki")
        w = self._back_calculation(at, ki)
        return [
            k * (r - x) + a * (least - most) for k, r, x, a, least, most in zip(ki, q, at.q, w, given, asked)
        ]

    def _back_calculation(self, at: Situation, ki: Sequence[float]) -> list[Any]:
        kp, given = at.each(self.gains.kp, "gains.kp"), self.gains.anti_windup
        usual = [i / p if float(p) > 0.0 else 0.0 for i, p in zip(ki, kp)]
        own = given if isinstance(given, dict) else dict.fromkeys(at.joints, given)
        return [own.get(name, w) for name, w in zip(at.joints, usual)]
