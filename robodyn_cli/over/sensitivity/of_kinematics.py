"""Exact derivatives of the figures of ``kinematics``: along a motion, and of places in many runs at once."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.many import ManyNumbers
from robodyn_cli.given.loop_conditions import Lead
from robodyn_cli.given.motion import Planned
from robodyn_cli.kernels.program import Program
from robodyn_cli.model.model import MOTION_GROUPS
from robodyn_cli.model.places import numbers_at_places
from robodyn_cli.observe.evaluation import SampleFunction
from robodyn_cli.over.many.kinematics import KinematicsStructure
from robodyn_cli.over.sensitivity.asked import AskedSlopes
from robodyn_cli.over.sensitivity.differences import Slope
from robodyn_cli.over.sensitivity.gradients import ALL, MotionGradients, every_nth, slopes_along
from robodyn_cli.over.sensitivity.led import LedCourse, LedMotion, LedSlopes
from robodyn_cli.record import record
from robodyn_cli.scene.checks.check import EXTREMES
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.extremes import Extremes
from robodyn_cli.summaries.facts import ABSENT, Absent
from robodyn_cli.summaries.mechanism import KinematicsSummary, PlacesAt
from robodyn_cli.trajectories.course import between
from robodyn_cli.works.design import Designed
from robodyn_cli.works.kinematic_figures import PLACES, between_samples
from robodyn_cli.works.kinematics import (
    closer_times,
    evaluated,
    extremes_of,
    leading,
    outputs,
    places_at,
    plan,
    problem_of,
    report,
    summarise,
)

AT_POINT = re.compile(r"at\.(\d+)\.points\.(.+)\.[xyz]")


@record
class FewFigures:
    """Keys of the summary of ``kinematics`` that take less time than all of it: places at times, extremes."""

    at: list[PlacesAt]
    extremes: dict[str, Extremes] | Absent


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
        self.design = {} if scene.kinematics.design is None else Designed.outputs(self.problem)
        self._reported = outputs(self.problem)
        self.gradients = MotionGradients(self.problem, {**self._reported, **self.design}, self.led.places)

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
        return plan(self.problem, self.led.course.times)

    @cached_property
    def arrays(self) -> dict[str, Array]:
        """What is evaluated along the motion."""
        planned = self.planned[0]
        arrays = evaluated(self.problem, planned)
        if self.design:
            function = SampleFunction(self.design, MOTION_GROUPS, len(planned.times))
            arrays |= function.along(planned.times, planned.motion)
        return arrays

    @cached_property
    def moved(self) -> dict[str, Array]:
        """Derivatives (T, n, K) of t, q, v, v-dot, and of what is evaluated along the motion, by name."""
        planned, _ = self.planned
        motion = planned.motion
        groups = {"t": planned.times[:, None], "q": motion.q, "v": motion.qd, "a": motion.qdd}
        moved = self.led.moved(groups)
        along = self.gradients(groups)
        return {**moved, **{name: along.change(name, moved) for name in self.arrays}}

    def _summary(self, k: int, step: float, every: int) -> KinematicsSummary | FewFigures:
        """Return the summary for a key changed by so much, along the derivatives of the samples."""
        (planned, led), moved = self.planned, self.moved
        wanted = self.asked.task.outputs
        if all(name.startswith("at.") for name in wanted):
            every = ALL  # these are no figures of samples
        part = every_nth(planned.times, every)
        there = {
            name: (x + step * moved[name][:, :, k])[part]
            for name, x in (
                ("t", planned.times[:, None]), ("q", planned.motion.q), ("v", planned.motion.qd),
                ("a", planned.motion.qdd), *self.arrays.items(),
            )
        }  # fmt: skip
        motion = dataclasses.replace(planned.motion, q=there["q"], qd=there["v"], qdd=there["a"])
        planned = dataclasses.replace(planned, times=there["t"][:, 0], motion=motion)
        result = report(self.problem, planned, led, {name: there[name] for name in self._reported})
        if all(name.startswith(("at.", EXTREMES)) for name in wanted):
            extremes = extremes_of(self.problem, planned, result)
            summary: Any = FewFigures(places_at(self.problem.scene, result), extremes)
        else:
            summary = summarise(self.problem, planned, result, None)
        if not self.design:
            return summary
        own = {} if isinstance(summary.extremes, Absent) else summary.extremes
        looked = Designed(self.problem, planned, there).extremes()
        return dataclasses.replace(summary, extremes={**own, **looked} or ABSENT)


class PlaceSlopes:
    """The derivatives of where points are at given times, in many runs of one structure side by side.

    Parameters
    ----------
    lead : None in an open chain, whose motion no key changes. times : of the samples (T,). wanted : times and points.
    places : of the keys, all of them numbers of the equations that do not change what leads.

    Raises
    ------
    CapabilityError : an operation, or a number, has no derivative.
    """

    def __init__(
        self,
        problem: Problem,
        lead: Lead | None,
        times: Array,
        wanted: Sequence[tuple[float, str]],
        places: Sequence[str],
    ) -> None:
        self._wanted = [(between_samples(t, times), point) for t, point in wanted]
        # of each time those of its two samples that count
        self.samples = np.unique(
            [j for (k, _, s), _ in self._wanted for j in {k + (s == 1.0), k + (s > 0.0)}]
        )
        self.times = times[self.samples]
        points, own = {point for _, point in wanted}, outputs(problem)
        self.paths = [path for path in own if path.partition("/")[2] in points]
        self.gradients = MotionGradients(problem, {path: own[path] for path in self.paths}, places)
        self.led = None if lead is None else LedMotion(problem, lead, places)
        self._keys = len(places)

    def __call__(self, numbers: ManyNumbers, motion: tuple[Array, Array, Array]) -> Array:
        """Return the derivatives (N, wanted, 3, K) in runs with motions q, v and v-dot (N, T, n).

        Raises
        ------
        CapabilityError : the conditions do not determine a motion.
        """
        shape = numbers.runs, len(self.samples)
        groups = dict(zip(("q", "v", "a"), (x[:, self.samples] for x in motion)))
        groups["t"] = np.broadcast_to(self.times[:, None], (*shape, 1))
        moved: dict[str, Array] = {}
        if self.led is not None:
            dt = np.zeros((shape[0] * shape[1], 1, self._keys))
            moved = self.led.changes(self.led.gradients(groups, numbers=numbers), dt)
        along = self.gradients(groups, numbers=numbers)
        changes = {path: along.change(path, moved).reshape(*shape, 3, -1) for path in self.paths}
        return np.stack([self._at(changes, *one) for one in self._wanted], axis=1)

    def _at(self, changes: Mapping[str, Array], at: tuple[int, float, float], point: str) -> Array:
        """Return the change (N, 3, K) of a point at a time, from those at samples."""
        (k, h, s), place = at, changes[f"points/{point}"]
        if s in (0.0, 1.0):
            return np.asarray(place[:, np.searchsorted(self.samples, k + int(s))])
        ways = [changes.get(f"{group}/{point}", np.zeros_like(place)) for group in PLACES]
        first = int(np.searchsorted(self.samples, k))
        (q, v, a), (q1, v1, a1) = ([x[:, first + j] for x in ways] for j in (0, 1))
        return between(((q, v, a), (q1, v1, a1)), h, s)[0]


class PlacesTogether:
    """Exact derivatives of where points are at given times, in all runs of a structure at once."""

    def __init__(self) -> None:
        self._known: dict[KinematicsStructure, PlaceSlopes] = {}

    def __call__(self, structure: KinematicsStructure, values: Array, of: Sequence[str]) -> Array:
        """Return the derivatives (N, of, keys) of outputs, always the same ones, in runs with rows of values (N, keys).

        Raises
        ------
        CapabilityError : something else is among the outputs, or a key that is no number of these equations.
        """
        if structure not in self._known:
            scene, places = structure.problem.scene, [key.place for key in structure.keys]
            of_points = [AT_POINT.fullmatch(key) for key in of]
            if not (all(of_points) and set(places) <= numbers_at_places(scene).keys()):
                raise CapabilityError("these derivatives are not found together")
            wanted = [(scene.kinematics.at[int(x[1])], x[2]) for x in of_points if x is not None]
            own = PlaceSlopes(structure.problem, structure.lead, structure.times, wanted, places)
            self._known[structure] = own
        motions = structure.motions(values)
        changes = self._known[structure](structure.numbers(values), (motions.q, motions.v, motions.a))
        axes = ["xyz".index(key.rpartition(".")[2]) for key in of]
        scales = np.array([key.scale for key in structure.keys])
        own = changes[:, np.arange(len(of)), axes] * scales
        return np.where(motions.good[:, None, None], own, np.nan)


def _course(scene: Scene) -> LedCourse:
    problem = problem_of(scene)
    lead, times = leading(problem)
    return LedCourse(problem, lambda: closer_times(problem, times), lead)
