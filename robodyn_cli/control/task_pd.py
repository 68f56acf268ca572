"""PD control of a point in space, by J^T."""

from __future__ import annotations

from typing import Any, ClassVar

from robodyn_cli.control.base import Follower, Problems, Situation, gain
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Boolean, Choice, Number, Section, key
from robodyn_cli.trajectories.base import Lacks


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

    def torques(self, at: Situation) -> list[Any]:
        task, kp, kd = at.point(), self.gains.kp, self.gains.kd
        force = [
            kp * (r - x) + kd * (rd - xd)
            for r, x, rd, xd in zip(task.wanted, task.p, task.wanted_rate, task.pd)
        ]
        damped = at.each(self.gains.damping, "gains.damping")
        held = at.gravity() if self.gravity else [0.0] * len(at.q)
        return [x + g - d * v for x, g, d, v in zip(task.torques(force), held, damped, at.qd)]
