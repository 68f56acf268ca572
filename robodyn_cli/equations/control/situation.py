"""What a law sees: measured state, reference, states of its own and the model, as expressions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

from robodyn_cli.control.base import PointTask
from robodyn_cli.equations.control.model import ControlledEquations, ControllerModel, Reference
from robodyn_cli.expr.rebuild import renamed
from robodyn_cli.record import record
from robodyn_cli.solve.inverse_kinematics import moving_reference, target_of
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.trajectories.base import TaskSpaceTrajectory
from robodyn_cli.trajectories.course import interpolated


@record
class Measured:
    """Positions (nq,) and rates (nv,) of all joints as the controller sees them."""

    q: list[Any]
    v: list[Any]


class At:
    """A ``Situation`` of ``control/base.py``.

    Parameters
    ----------
    problem : the mechanism. seen : its measured state. followed : what the driven joints follow. states : of the law,
    by name.
    """

    def __init__(
        self, problem: ControlledEquations, seen: Measured, followed: Reference, states: Mapping[str, Any]
    ) -> None:
        self.problem, self.seen, self.followed = problem, seen, followed
        self.env = problem.environment
        self.reference = followed.at(problem.t, self.env)
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
        model, values = self.problem.model, {**self.env, **self._of_points()}
        values |= {f"q.{name}": x for name, x in zip(model.q_names, self.seen.q)}
        values |= {f"qd.{name}": x for name, x in zip(model.v_names, self.seen.v)}
        for group, entries in zip(("ref", "refd", "refdd"), self.reference):
            values |= {f"{group}.{name}": x for name, x in zip(self.joints, entries)}
        return values | {f"s.{name}": x for name, x in zip(self.state_names, self.states)}

    def _of_points(self) -> dict[str, Any]:
        """Return what formulas ask of points, at the positions and rates that the controller sees."""
        given = self.problem.of_points
        seen = {"q": dict(enumerate(self.seen.q)), "v": dict(enumerate(self.seen.v))}
        return dict(zip(given, renamed(list(given.values()), seen)))

    # -- the controller's model -----------------------------------------------------------------------
    @cached_property
    def model(self) -> ControllerModel:
        return ControllerModel(self.problem, self.problem.of)

    def seen_of(self, name: str) -> tuple[Any, Any]:
        """Return measured position and rate of a joint."""
        model = self.problem.model
        return self.seen.q[model.q_names.index(name)], self.seen.v[model.v_names.index(name)]

    def inverse_dynamics(self, accelerations: Sequence[Any]) -> list[Any]:
        return self.model.inverse_dynamics(self.seen.q, self.seen.v, accelerations)

    def feed_forward(self) -> list[Any]:
        q, v = self.followed.of_all(self.problem.model, self.t, self.env)
        return self.model.inverse_dynamics(q, v, self.reference[2])

    def gravity(self) -> list[Any]:
        return self.model.gravity(self.seen.q)

    def point(self) -> PointTask:
        trajectory, scene = self.controller.reference, self.problem.scene
        if not isinstance(trajectory, TaskSpaceTrajectory):
            self.model.refuse("'task_pd' follows a path of a point: key 'reference' or 'trajectory'")

        if moving_reference(self.model.problem.model, trajectory) is not None:
            self.model.refuse(
                f"'task_pd' follows a path in the world, and {trajectory.relative_to!r} is on a link that moves; "
                "allowed: a place on the base"
            )

        def motion(times: Array) -> tuple[Array, Array, Array]:
            target = target_of(self.model.problem.model, trajectory, times, scene.parameters)
            return target.p, target.pd, target.pdd

        course = interpolated(
            motion, trajectory.duration, trajectory.knots, "the path that 'task_pd' follows"
        )
        course = course.at_rest_outside()
        wanted, rate = course.expressions(self.t), course.derivative().expressions(self.t)
        return self.model.point(self.seen.q, self.seen.v, wanted, rate)
