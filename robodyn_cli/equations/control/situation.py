"""What a law sees: measured state, reference, states of its own and the model, as expressions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from robodyn_cli.control.base import Linear, PointTask
from robodyn_cli.equations.control.equations import Equations
from robodyn_cli.equations.control.model import ControllerModel
from robodyn_cli.equations.control.reference import Columns, Sampled
from robodyn_cli.record import record
from robodyn_cli.solve.inverse_kinematics import moving_reference, target_of
from robodyn_cli.spatial.algebra import Array


@record
class Measured:
    """Positions (nq,) and rates (nv,) of all joints as the controller sees them."""

    q: list[Any]
    v: list[Any]


class At:
    """A ``Situation`` of ``control/base.py``.

    Parameters
    ----------
    problem : the mechanism. seen : its measured state. reference : of the driven joints. states : of the law, by name.
    start : positions at t = 0, by column. env : values for formulas that are no state: t, parameters, distances.
    """

    def __init__(
        self, problem: Equations, seen: Measured, reference: Columns, states: Mapping[str, Any],
        start: Mapping[str, float], env: Mapping[str, Any],
    ) -> None:  # fmt: skip
        self.problem, self.seen, self.reference, self.start, self.env = problem, seen, reference, start, env
        model = problem.model
        self.controller = problem.scene.control
        self.joints: tuple[str, ...] = self.controller.joints
        self.t = problem.t
        self.q = [seen.q[model.q_names.index(name)] for name in self.joints]
        self.qd = [seen.v[model.v_names.index(name)] for name in self.joints]
        self.state_names, self.states = tuple(states), list(states.values())

    def each(self, value: Any, name: str) -> list[Any]:
        """Return a gain for each driven joint."""
        return [value[joint] if isinstance(value, dict) else value for joint in self.joints]

    def names(self) -> dict[str, Any]:
        """Return what formulas may ask for, by name."""
        model, found = self.problem.model, dict(self.env)
        found |= {f"q.{name}": x for name, x in zip(model.q_names, self.seen.q)}
        found |= {f"qd.{name}": x for name, x in zip(model.v_names, self.seen.v)}
        for group, entries in zip(("ref", "refd", "refdd"), self.reference):
            found |= {f"{group}.{name}": x for name, x in zip(self.joints, entries)}
        return found | {f"s.{name}": x for name, x in zip(self.state_names, self.states)}

    # -- the controller's model -----------------------------------------------------------------------
    @cached_property
    def model(self) -> ControllerModel:
        return ControllerModel(self.problem, self.problem.of)

    def _of_all(self, driven: Sequence[Any], others: Sequence[Any]) -> list[Any]:
        """Return entries for all joints, of which the driven ones are given."""
        found = list(others)
        for name, x in zip(self.joints, driven):
            found[self.problem.model.v_names.index(name)] = x
        return found

    def _driven(self, entries: Sequence[Any]) -> list[Any]:
        return [entries[self.problem.model.v_names.index(name)] for name in self.joints]

    def inverse_dynamics(self, q: Sequence[Any], qd: Sequence[Any], qdd: Sequence[Any]) -> list[Any]:
        nothing = [0.0] * self.problem.model.nv
        q, qd, qdd = self._of_all(q, self.seen.q), self._of_all(qd, self.seen.v), self._of_all(qdd, nothing)
        return self._driven(self.model.inverse_dynamics(q, qd, qdd))

    def gravity(self) -> list[Any]:
        return self._driven(self.model.gravity(self.seen.q))

    def point(self) -> PointTask:
        trajectory, scene = self.controller.reference, self.problem.scene
        if not hasattr(trajectory, "target"):
            self.model.refuse("'task_pd' follows a path of a point: key 'reference' or 'trajectory'")

        if moving_reference(self.model.problem.model, trajectory) is not None:
            self.model.refuse(
                f"'task_pd' follows a path in the world, and {trajectory.relative_to!r} is on a link that moves; "
                "allowed: a place on the base"
            )

        def motion(times: Array) -> tuple[Array, Array, Array]:
            found = target_of(self.model.problem.model, trajectory, times, scene.parameters)
            return found.p, found.pd, found.pdd

        course = Sampled(motion, trajectory.duration).course
        wanted, rate = course.expressions(self.t), course.derivative().expressions(self.t)
        return self.model.point(self.seen.q, self.seen.v, wanted, rate)

    def linear(self, pose: dict[str, float]) -> Linear:
        names = self.problem.model.q_names
        given = {**self.start, **pose}
        lacking = [name for name in names if name not in given]
        if lacking:
            self.model.refuse(
                f"the pose of 'lqr' lacks joint {lacking[0]!r}, which 'initial.q' does not give either"
            )
        return self.model.linear(np.array([float(given[name]) for name in names]), self.seen.q, self.seen.v)
