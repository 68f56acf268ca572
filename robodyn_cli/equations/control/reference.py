"""The motion that a controller follows, as expressions of time with exact derivatives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from robodyn_cli.equations.discontinuities import is_of_time, switches, switching_times
from robodyn_cli.equations.time_structure import beside, structure
from robodyn_cli.expr.calculus import directional
from robodyn_cli.expr.fixed import literal
from robodyn_cli.expr.graph import Expr
from robodyn_cli.model.model import Model
from robodyn_cli.scene.types import Scene
from robodyn_cli.trajectories.attitudes import joint_expressions
from robodyn_cli.trajectories.led import Followed

Columns = tuple[list[Any], list[Any], list[Any]]


class Reference:
    """Positions, rates and accelerations of joints over time; held at the end of the motion.

    Parameters
    ----------
    motion : a trajectory in joint space; None for the pose ``start`` (by column of q).
    """

    def __init__(self, motion: Any, joints: Sequence[str], start: Mapping[str, float], until: float) -> None:
        self.motion, self.joints, self.start, self.until = motion, tuple(joints), start, until

    @property
    def known(self) -> bool:
        """Whether there is a motion, or a pose of all the joints, to follow."""
        return self.motion is not None or all(name in self.start for name in self.joints)

    def at(self, t: Expr, env: Mapping[str, Any]) -> Columns:
        """Return (q, qd, qdd) of the joints, each (n,), as expressions of t; env : values for formulas."""
        n, q = len(self.joints), self.positions(self.joints, t, env)
        if self.motion is None:
            return q, [0.0] * n, [0.0] * n
        qd = directional(q, [t], [1.0])
        return q, qd, directional(qd, [t], [1.0])

    def positions(self, names: Sequence[str], t: Expr, env: Mapping[str, Any]) -> list[Any]:
        """Return the positions of some joints of one coordinate, as expressions of t."""
        if self.motion is None:
            return self._held(names)
        given = Followed(self.motion, self.until).expressions({**env, "t": t})
        return [given[name] for name in names]

    def of_all(self, model: Model, t: Expr, env: Mapping[str, Any]) -> tuple[list[Any], list[Any]]:
        """Return positions (nq,) and rates (nv,) of all joints, as expressions of t; the motion must give all."""
        if self.motion is None:
            return self._held(model.q_names), [0.0] * model.nv
        given = Followed(self.motion, self.until).expressions({**env, "t": t})
        found = joint_expressions(given, model.q_names, t)
        return found.q, found.v

    def _held(self, names: Sequence[str]) -> list[Any]:
        return [literal(float(self.start.get(name, 0.0)), f"initial.q.{name}") for name in names]

    def breakpoints(self, t: Expr, env: Mapping[str, Any]) -> list[float]:
        """Return the times at which the motion is not smooth, where steps have to end."""
        if self.motion is None:
            return []
        known = Followed(self.motion, self.until).breakpoints
        if known is not None:
            return [float(x) for x in known]
        found: set[float] = {self.motion.duration} if self.until > self.motion.duration else set()
        entries = [x for x in self.at(t, env)[0] if isinstance(x, Expr)]
        for switch in switches(entries):
            if is_of_time(switch, t):
                found.update(switching_times(switch, t, self.until))
        for x in entries:
            found.update(beside(structure(x, t, self.until), found, self.until))
        return sorted(found)


def reference_of(scene: Scene, start: Mapping[str, float]) -> Reference:
    """Return what the controller of a scene follows."""
    controller = scene.control
    own = controller.reference
    motion = None if own is None or own.lacks else own
    return Reference(motion, controller.joints, start, scene.simulate.duration)


def tracked_joints(reference: Reference, pose: Mapping[str, float], model: Model) -> tuple[str, ...]:
    """Return the joints of one coordinate that have a position to be at: the driven ones, and others that the motion
    leads, or that are held in a ``pose`` of all joints."""
    single = [name for name in model.v_names if name in model.q_names]
    given = pose if reference.motion is None else dict.fromkeys(reference.motion.joints)
    return (*reference.joints, *(name for name in single if name in given and name not in reference.joints))
