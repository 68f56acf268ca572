"""Watchers that keep times for warnings: joints beyond their limits, half turns."""

from __future__ import annotations

import copy
from collections.abc import Mapping

from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.fixed import literal
from robodyn_cli.expr.functions import sqrt
from robodyn_cli.expr.graph import Expr, Scalar
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.forces.element import half_turn_warning
from robodyn_cli.formulations.events import GO_ON, Event, EventFunction, EventKind, Outcome
from robodyn_cli.integrators.runtime.options import Options
from robodyn_cli.model.model import TORQUE
from robodyn_cli.motion.motion import Motion, Watcher
from robodyn_cli.observe.joint_limits import ROUNDING, LimitedJoint, limited_joints
from robodyn_cli.record import record
from robodyn_cli.schema.spans import Span, span_text
from robodyn_cli.spatial.algebra import Array


@record
class LimitFunction(EventFunction):
    """Positive within a limit of ``joint``; ``words`` : the limit with its value."""

    joint: str = ""
    words: str = ""

    @property
    def of_position(self) -> bool:
        return self.name.endswith((".lower", ".upper"))


def _inside(x: Scalar, limit: Span, name: str, place: str) -> Scalar:
    """Return what is positive while x is within a limit, whose number stands at a place of the scene.

    What stays on a limit, such as the torque of a controller at its bound, passes it by rounding.
    """
    if isinstance(limit, tuple):
        low, high = (literal(bound, f"{place}.{k}") for k, bound in enumerate(limit))
        return (x - low + _margin(low)) * (high + _margin(high) - x)
    bound = literal(limit, place)
    margin = _margin(bound)
    if name in ("lower", "upper"):
        return x - bound + margin if name == "lower" else bound + margin - x
    return (bound + margin) * (bound + margin) - x * x


def _margin(bound: Scalar) -> Scalar:
    return ROUNDING * sqrt(bound * bound)


class LimitWatcher(Watcher):
    """Owns the events at which joints pass limits of position, speed and effort, and warns of the first of each."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        joints = limited_joints(problem.scene, problem.model)
        self.limits = [f for joint in joints for f in self._of(joint)]
        # a constant torque is within its limit, or not
        self.functions = tuple(f for f in self.limits if isinstance(f.value, Expr))
        self.first: dict[str, tuple[LimitFunction, float]] = {}

    def _of(self, joint: LimitedJoint) -> list[LimitFunction]:
        """Return the functions of a joint; those of stops belong to the equations."""
        problem, limits, unit = self.problem, joint.limits, joint.unit
        q, v = problem.q[joint.place], problem.v[joint.velocity]
        tau = problem.actuator_torques[joint.velocity]
        inside: dict[str, Span | None] = (
            {"lower": limits.lower, "upper": limits.upper} if not limits.acts else {}
        )
        inside |= {"speed": limits.speed, "effort": limits.effort}
        functions = []
        for name, x in inside.items():
            if x is not None:
                measured, measure = {
                    "lower": (q, unit), "upper": (q, unit), "speed": (v, f"{unit}/s"), "effort": (tau, TORQUE[unit]),
                }[name]  # fmt: skip
                value = _inside(measured, x, name, f"robot.joints.{joint.name}.limits.{name}")
                words = f"{name} limit of {span_text(x)} {measure}"
                path = f"limits.{joint.name}.{name}"
                functions.append(LimitFunction(path, value, -1, EventKind.MARK, self, joint.name, words))
        return functions

    @property
    def warnings(self) -> list[str]:
        return [
            f"joint {f.joint!r} passes its {f.words} at t = {time:.6g} s" if time > 0.0
            else f"joint {f.joint!r} starts beyond its {f.words}"
            for f, time in self.first.values()
        ]  # fmt: skip

    @property
    def noted(self) -> dict[str, float]:
        return {name: time for name, (_, time) in self.first.items()}

    def recall(self, noted: Mapping[str, float]) -> None:
        functions = {f.name: f for f in self.limits}
        self.first = {name: (functions[name], time) for name, time in noted.items()}

    def follow(self, motion: Motion) -> None:
        self.system = motion.system

    def begin(self, t: float, x: Array, options: Options) -> Array:
        """Note the limits that the start is beyond, by more than rounding of a position of 1 rad or m."""
        self.first = {}
        system = self.system
        given = system.groups([t], x, system.parameters_at(t, system.split(x)[0]))
        values = evaluate([f.value for f in self.limits], given)
        for function, value in zip(self.limits, values):
            if value < (-ROUNDING if function.of_position else 0.0):
                self.first[function.name] = (function, t)
        return x

    def handle(self, event: Event) -> Outcome:
        """Keep the time of the first passage of each limit; the run goes on."""
        function = event.function
        assert isinstance(function, LimitFunction)
        self.first.setdefault(function.name, (function, event.time))
        return GO_ON


@record
class HalfTurnFunction(EventFunction):
    """Changes its sign where the angle of ``force`` jumps; ``there`` : > 0 only there (see ``forces.element``)."""

    force: str = ""
    there: Scalar = 0.0


class HalfTurns(Watcher):
    """Owns the events at which the angle of a force between bodies jumps, and warns of those that happened."""

    def __init__(self, problem: Problem) -> None:
        self.functions = tuple(
            HalfTurnFunction(
                f"forces.{name}", jump.switch, 0, EventKind.DISCONTINUITY, self, name, jump.there
            )
            for name, jump in problem.elements.half_turns
        )
        self.first: dict[str, float] = {}

    @property
    def warnings(self) -> list[str]:
        return [half_turn_warning(name, time) for name, time in self.first.items()]

    @property
    def noted(self) -> dict[str, float]:
        return dict(self.first)

    def recall(self, noted: Mapping[str, float]) -> None:
        self.first = dict(noted)

    def follow(self, motion: Motion) -> None:
        self.system = motion.system

    def handle(self, event: Event) -> Outcome:
        """Keep the time of the first jump of each force; the run goes on."""
        function = event.function
        assert isinstance(function, HalfTurnFunction)
        if function.force not in self.first:
            q, v, _ = self.system.split(event.state)
            values = {"t": [event.time], "q": q.tolist(), "v": v.tolist(), "p": []}
            if evaluate([function.there], values)[0] > 0.0:
                self.first[function.force] = event.time
        return GO_ON

    def again(self) -> HalfTurns:
        """Return the watcher of a second integration, which warns of nothing."""
        other = copy.copy(self)
        other.first = {}
        return other
