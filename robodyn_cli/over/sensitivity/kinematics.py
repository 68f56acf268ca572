"""Exact derivatives of the figures of ``kinematics``: of the motion, and of points and loops along it."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cached_property

from robodyn_cli.given.motion import Planned
from robodyn_cli.kernels.program import Program
from robodyn_cli.model.model import MOTION_GROUPS
from robodyn_cli.observe.evaluation import SampleFunction
from robodyn_cli.over.sensitivity.asked import AskedSlopes
from robodyn_cli.over.sensitivity.differences import Slope
from robodyn_cli.over.sensitivity.gradients import MotionGradients, every_second, slopes_along
from robodyn_cli.over.sensitivity.led import LedCourse, LedSlopes
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.mechanism import KinematicsSummary
from robodyn_cli.works.kinematics import leading, outputs, plan, problem_of, report, summarise


class KinematicsSlopes:
    """The samples of a kinematic analysis, and their derivatives by some keys, which are named by their numbers.

    Raises
    ------
    CapabilityError : they cannot be computed exactly.
    """

    def __init__(self, asked: AskedSlopes, scene: Scene, numbers: Sequence[int]) -> None:
        self.asked, self.numbers = asked, numbers
        self.led = LedSlopes(asked, scene, numbers, _course)
        self.problem = self.led.course.problem
        self.gradients = MotionGradients(self.problem, outputs(self.problem), self.led.places)

    @property
    def programs(self) -> list[Program]:
        """The code of values and derivatives."""
        return [self.gradients.program, *self.led.programs]

    def slopes(self) -> dict[str, list[Slope]]:
        """Return the derivatives of those outputs that are figures of the samples."""
        motion, moved = self.planned[0].motion, self.moved
        arrays = [(motion.q, moved["q"]), (motion.qd, moved["v"])]
        arrays += [(array, moved[name]) for name, array in self.arrays.items() if name != "eta"]
        return slopes_along(self.asked, self.numbers, self._summary, arrays)

    @cached_property
    def planned(self) -> tuple[Planned, tuple[str, ...]]:
        """The motion of the scene as it stands, and the velocity coordinates that lead it."""
        return plan(self.problem)

    @cached_property
    def arrays(self) -> dict[str, Array]:
        """What is evaluated along the motion."""
        planned, _ = self.planned
        function = SampleFunction(outputs(self.problem), MOTION_GROUPS, len(planned.times))
        return function.along(planned.times, planned.motion)

    @cached_property
    def moved(self) -> dict[str, Array]:
        """Derivatives (T, n, K) of t, q, v, v-dot, and of what is evaluated along the motion, by name."""
        planned, _ = self.planned
        motion = planned.motion
        groups = {"t": planned.times[:, None], "q": motion.q, "v": motion.qd, "a": motion.qdd}
        moved = self.led.moved(groups)
        along = self.gradients(groups)
        return {**moved, **{name: along.change(name, moved) for name in self.arrays}}

    def _summary(self, k: int, step: float, every: int) -> KinematicsSummary:
        """Return the summary for a key changed by so much, along the derivatives of the samples."""
        (planned, led), moved = self.planned, self.moved
        part = every_second(len(planned.times), every)
        there = {
            name: (x + step * moved[name][:, :, k])[part]
            for name, x in (
                ("t", planned.times[:, None]), ("q", planned.motion.q), ("v", planned.motion.qd),
                ("a", planned.motion.qdd), *self.arrays.items(),
            )
        }  # fmt: skip
        motion = dataclasses.replace(planned.motion, q=there["q"], qd=there["v"], qdd=there["a"])
        planned = dataclasses.replace(planned, times=there["t"][:, 0], motion=motion)
        result = report(self.problem, planned, led, {name: there[name] for name in self.arrays})
        return summarise(self.problem, planned, result, None)


def _course(scene: Scene) -> LedCourse:
    problem = problem_of(scene)
    lead, times = leading(problem)
    return LedCourse.of(problem, times, lead)
