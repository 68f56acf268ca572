"""Computed torque: inverse dynamics inside the loop, which leaves linear and decoupled errors."""

from __future__ import annotations

from typing import Any, ClassVar

from robodyn_cli.control.base import Follower, Situation, gain, tracking
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, Section, key


@record
class AccelerationGains:
    """Gains that give accelerations."""

    kp: Any = gain("1/s^2", "Acceleration for each unit of error; a number, or a map by joint.")
    kd: Any = gain("1/s", "Acceleration for each unit of the error's rate; likewise.")


@record
class ComputedTorque(Follower):
    """``tau = M(q) a + C(q, qd) qd + G(q) - tau_f``, ``a = qdd_ref + kd e-dot + kp e``.

    M, C, G and tau_f (springs, dampers, friction) are those of the controller's model. Where it is exact, the error of
    each joint obeys ``e-ddot + kd e-dot + kp e = 0`` (Siciliano et al. 2009, section 8.5.2). In a mechanism with loops
    a belongs to the driven joints, and tau gives them just these accelerations (``algorithms/driven.py``).
    """

    shares: ClassVar[bool] = True
    whole: ClassVar[bool] = True

    type: str = key(Choice(("computed_torque",)), doc="Kind of controller.")
    gains: AccelerationGains = key(Section(AccelerationGains), doc="Its gains.")

    def torques(self, at: Situation) -> list[Any]:
        _, _, a = at.reference
        asked = [x + y for x, y in zip(a, tracking(at, self.gains.kp, self.gains.kd))]
        return at.inverse_dynamics(asked)
