"""Feedback of joints and of a point: PD and PID, with what the model knows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from robodyn_cli.control.base import PER_JOINT, Follower, Problems, Situation, gain, tracking
from robodyn_cli.control.design import ControlDesign, Leading, Named, WithErrors, columns_of, diagonal
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Boolean, Choice, Number, Section, key
from robodyn_cli.trajectories.base import Lacks


@record
class PdGains:
    """Gains of ``pd``."""

    kp: Any = gain("N m/rad or N/m", "Torque for each unit of error; a number, or a map by joint.")
    kd: Any = gain("N m s/rad or N s/m", "Torque for each unit of the error's rate; likewise.")


class WithPdGains(Follower):
    """A law to which errors and their rates add torques."""

    gains: Any

    def written(self, of: Leading) -> ControlDesign | None:
        gains = diagonal(of, self.gains.kp, self.gains.kd)
        return ControlDesign(_loads(of), columns_of(of), WithErrors.exact(gains))


def _loads(of: Leading) -> tuple[Named, ...]:
    return tuple(map(Named, of.names, of.loads))


@record
class Pd(WithPdGains):
    """``tau = kp e + kd e-dot`` with the error ``e = q_ref - q``."""

    type: str = key(Choice(("pd",)), doc="Kind of controller.")
    gains: PdGains = key(Section(PdGains), doc="Its gains.")

    def torques(self, at: Situation) -> list[Any]:
        return tracking(at, self.gains.kp, self.gains.kd)


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

    def written(self, of: Leading) -> ControlDesign | None:
        gains = diagonal(of, self.gains.kp, self.gains.kd, self.gains.ki)
        return ControlDesign(_loads(of), columns_of(of, integrals=True), WithErrors.exact(gains))

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


@record
class Gravity(WithPdGains):
    """``tau = G(q) + kp e + kd e-dot``, with G of the controller's model; no gains: compensation alone."""

    shares: ClassVar[bool] = True

    type: str = key(Choice(("gravity",)), doc="Kind of controller.")
    gains: PdGains = key(Section(PdGains), default=PdGains(), doc="Its gains.")

    def torques(self, at: Situation) -> list[Any]:
        held = at.gravity()
        return [g + x for g, x in zip(held, tracking(at, self.gains.kp, self.gains.kd))]


@record
class FeedForward(WithPdGains):
    """``tau = ID(q_ref, qd_ref, qdd_ref) + kp e + kd e-dot``, with ID of the controller's model."""

    shares: ClassVar[bool] = True
    whole: ClassVar[bool] = True

    type: str = key(Choice(("feed_forward",)), doc="Kind of controller.")
    gains: PdGains = key(Section(PdGains), default=PdGains(), doc="Its gains.")

    def torques(self, at: Situation) -> list[Any]:
        return [x + y for x, y in zip(at.feed_forward(), tracking(at, self.gains.kp, self.gains.kd))]


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
    a belongs to the driven joints, and tau gives them just these accelerations (``algorithms/constraints.py``).
    """

    shares: ClassVar[bool] = True
    whole: ClassVar[bool] = True

    type: str = key(Choice(("computed_torque",)), doc="Kind of controller.")
    gains: AccelerationGains = key(Section(AccelerationGains), doc="Its gains.")

    def written(self, of: Leading) -> ControlDesign | None:
        gains = diagonal(of, self.gains.kp, self.gains.kd)
        rows = tuple(Named(f"qdd.{name}", f"{unit}/s^2") for name, unit in zip(of.names, of.units))
        poles = None
        if self.period is None:
            n = len(of.names)
            kp, kd = np.diag(gains[:, :n]), np.diag(gains[:, n:])
            poles = WithErrors.exact(
                np.concatenate([np.roots([1.0, d, p]) for p, d in zip(kp, kd)]).astype(complex)
            )
        return ControlDesign(rows, columns_of(of), WithErrors.exact(gains), poles)

    def torques(self, at: Situation) -> list[Any]:
        _, _, a = at.reference
        qdd = [x + y for x, y in zip(a, tracking(at, self.gains.kp, self.gains.kd))]
        return at.inverse_dynamics(qdd)


@record
class TaskGains:
    """Gains of ``task_pd``."""

    kp: float = key(Number(minimum=0.0), unit="N/m", doc="Force for each metre that the point is off.")
    kd: float = key(Number(minimum=0.0), default=0.0, unit="N s/m", doc="Force for each unit of its rate.")
    damping: Any = gain("N m s/rad or N s/m", "Damping of the joints; a number, or a map by joint.")


@record
class TaskPd(Follower):
    """``tau = J^T (kp (p_ref - p) + kd (p-dot_ref - p-dot)) - damping qd (+ G(q))``.

    p is the point that the reference leads, a path of a point; its attitude, where the path has one, is left free.
    """

    shares: ClassVar[bool] = True
    at_point: ClassVar[bool] = True

    type: str = key(Choice(("task_pd",)), doc="Kind of controller.")
    gains: TaskGains = key(Section(TaskGains), doc="Its gains.")
    gravity: bool = key(Boolean(), default=True, doc="Whether gravity is compensated.")

    def problems(self) -> Problems:
        if self.reference is not None and self.reference.lacks not in (Lacks.JOINTS, Lacks.TIMES):
            yield (
                ("reference", "type"),
                f"{self.reference.type!r} leads joints; allowed: a path of a point, such as circle, path or cartesian",
            )

    def written(self, of: Leading) -> ControlDesign | None:
        gains = diagonal(of, self.gains.kp, self.gains.kd)
        return ControlDesign(_loads(of), columns_of(of), WithErrors.exact(gains))

    def torques(self, at: Situation) -> list[Any]:
        task, kp, kd = at.point(), self.gains.kp, self.gains.kd
        force = [
            kp * (r - x) + kd * (rd - xd)
            for r, x, rd, xd in zip(task.wanted, task.p, task.wanted_rate, task.pd)
        ]
        damped = at.each(self.gains.damping, "gains.damping")
        held = at.gravity() if self.gravity else [0.0] * len(at.q)
        return [x + g - d * v for x, g, d, v in zip(task.torques(force), held, damped, at.qd)]
