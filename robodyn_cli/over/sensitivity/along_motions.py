"""Exact derivatives of the figures of ``inverse`` and ``kinematics``: of a motion, of points, loops and torques along
it.

    d tau / dk = tau_k + tau_t dt + tau_q dq + tau_v dv + tau_a da

in an open chain; with loops it is the change of the load B tau + Psi^T lambda, which actuators and loops share.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from robodyn_cli.equations.gears import geared
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.expr.many import ManyNumbers
from robodyn_cli.given.loop_conditions import Lead
from robodyn_cli.given.motion import Planned
from robodyn_cli.kernels.program import Program
from robodyn_cli.model.model import MOTION_GROUPS
from robodyn_cli.observe.evaluation import SampleFunction
from robodyn_cli.observe.reactions import ReactionSamples
from robodyn_cli.observe.reactions import figures as largest_loads
from robodyn_cli.over.many.inverse import figure_of
from robodyn_cli.over.sensitivity.asked import AskedSlopes
from robodyn_cli.over.sensitivity.differences import Slope
from robodyn_cli.over.sensitivity.gradients import ALL, MotionGradients, every_second, slopes_along
from robodyn_cli.over.sensitivity.led import LedCourse, LedMotion, LedSlopes
from robodyn_cli.record import record
from robodyn_cli.scene.checks.check import EXTREMES
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.load_sharing import share_change
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.drives import DriveFigures
from robodyn_cli.summaries.extremes import Extremes
from robodyn_cli.summaries.facts import ABSENT, Absent, PeakLoads, Termination
from robodyn_cli.summaries.inverse import JointFigures
from robodyn_cli.summaries.mechanism import KinematicsSummary, PlacesAt
from robodyn_cli.torques.checks import Loaded, breaks_of, joint_figures
from robodyn_cli.torques.closed import ClosedLoops
from robodyn_cli.torques.program import InverseProgram, Sampled
from robodyn_cli.trajectories.course import between
from robodyn_cli.works.design import Designed
from robodyn_cli.works.inverse import evaluated_at, program_of
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


@record
class InverseFigures:
    """The keys of the summary of ``inverse`` that are figures of its samples."""

    termination: Termination
    joints: dict[str, JointFigures]
    reactions: PeakLoads | Absent = ABSENT
    drives: dict[str, DriveFigures] | Absent = ABSENT


class InverseSlopes:
    """The samples of an inverse run, and their derivatives by some keys, which are named by their numbers.

    Raises
    ------
    CapabilityError : they cannot be computed exactly.
    """

    def __init__(self, asked: AskedSlopes, scene: Scene, numbers: Sequence[int]) -> None:
        self.asked, self.numbers = asked, numbers
        self.led = LedSlopes(asked, scene, numbers, self._course)
        self.program = program_of(scene)
        self.problem = self.program.problem
        _refuse(self.program)
        self.loads = (
            ReactionSamples(self.problem, len(self.led.course.times)) if scene.outputs.reactions else None
        )
        self.gradients = MotionGradients(self.problem, self._outputs(), self.led.places)

    def _outputs(self) -> dict[str, Sequence[Scalar]]:
        terms = self.program.terms.values()
        found: dict[str, Sequence[Scalar]] = {"load": [sum(parts) for parts in zip(*terms)]}
        if isinstance(self.program, ClosedLoops):
            found["psi"] = self.program.others["psi"]
        if self.loads is not None:
            found |= self.loads.function.outputs
        return found

    @property
    def programs(self) -> list[Program]:
        """The code of values and derivatives."""
        return [self.gradients.program, *self.led.programs]

    def slopes(self) -> dict[str, list[Slope]]:
        """Return the derivatives of those outputs that are figures of the samples."""
        sampled, moved = self.sampled, self.moved
        arrays = [
            (sampled.motion.qd, moved["v"]),
            (sampled.motion.qdd, moved["a"]),
            (sampled.tau, moved["tau"]),
        ]
        arrays += [(wrench, moved[path]) for path, wrench in self.wrenches.items()]
        return slopes_along(self.asked, self.numbers, self._figures, arrays)

    @cached_property
    def sampled(self) -> Sampled:
        """The run of the scene as it stands."""
        return evaluated_at(self.program, self.led.course.times)[1]

    @cached_property
    def moved(self) -> dict[str, Array]:
        """Derivatives (T, n, K) of t, q, v, v-dot, of the torques, and of the wrenches that are wanted by path."""
        sampled, motion = self.sampled, self.sampled.motion
        groups = {"t": sampled.times[:, None], "q": motion.q, "v": motion.qd, "a": motion.qdd}
        moved = self.led.moved(groups)
        lam = self.program.row_multipliers(sampled)
        groups["lam"] = (
            np.zeros((len(sampled.times), len(self.problem.constraints.rows))) if lam is None else lam
        )
        along = self.gradients(groups)
        tau = along.change("load", moved)
        if sampled.loops is not None:
            tau, moved["lam"] = self._shared(along.change("psi", moved), tau)
        paths = self.loads.names if self.loads is not None else ()
        return {**moved, "tau": tau, **{path: along.change(path, moved) for path in paths}}

    def _shared(self, psi_change: Array, load_change: Array) -> tuple[Array, Array]:
        """Return the change of torques (T, nv, K), and of the multipliers of all rows (T, m, K)."""
        loops, constraints = self.sampled.loops, self.problem.constraints
        assert loops is not None
        tau = np.zeros_like(load_change)
        lam = np.zeros((len(tau), len(constraints.rows), len(self.numbers)))
        for k in range(len(self.numbers)):
            psi = psi_change[:, :, k].reshape(loops.psi.shape)
            tau[:, :, k], lam[:, constraints.of_loops, k] = share_change(
                loops.psi, loops.driven, loops.shared, psi, load_change[:, :, k]
            )
        return tau, lam

    @staticmethod
    def _course(scene: Scene) -> LedCourse:
        program = program_of(scene)
        lead = program.lead if isinstance(program, ClosedLoops) else None
        return LedCourse.of(program.problem, program.looked_at(scene.inverse.samples), lead)

    @cached_property
    def _wanted(self) -> set[str]:
        """The figures of joints that are asked for."""
        return {own[1] for name in self.asked.task.outputs if (own := figure_of(name)) is not None}

    def _figures(self, k: int, step: float, every: int) -> InverseFigures:
        """Return the figures for a key changed by so much, along the derivatives of the samples."""
        sampled, moved = self.sampled, self.moved
        motion, part = sampled.motion, every_second(sampled.times, every)
        arrays = {"q": motion.q, "v": motion.qd, "a": motion.qdd, "tau": sampled.tau, **self.wrenches}
        there = {name: (x + step * moved[name][:, :, k])[part] for name, x in arrays.items()}
        times = (sampled.times + step * moved["t"][:, 0, k])[part]
        motion = dataclasses.replace(motion, q=there["q"], qd=there["v"], qdd=there["a"])
        sampled = dataclasses.replace(sampled, times=times, motion=motion, terms={"all": there["tau"]})
        loaded = Loaded.of(self.problem, sampled)
        figures = InverseFigures(
            Termination("end of the trajectory", float(times[-1])),
            joint_figures(self.problem, sampled, loaded, self._wanted),
        )
        if self.loads is not None:
            data = {path: there[path] for path in self.loads.names}
            figures = dataclasses.replace(
                figures,
                reactions=PeakLoads(
                    ABSENT, ABSENT, largest_loads(times, data, self.loads.names, loaded.breaks)
                ),
            )
        if self.asked.scene.drives and any(name.startswith("drives.") for name in self.asked.task.outputs):
            figures = dataclasses.replace(figures, drives=self._drives(sampled, step, k))
        return figures

    @cached_property
    def wrenches(self) -> Mapping[str, Array]:
        """Forces and moments (T, n) by path, where they are wanted."""
        if self.loads is None:
            return {}
        sampled, motion = self.sampled, self.sampled.motion
        lam = self.program.row_multipliers(sampled)
        return self.loads(sampled.times, motion.q, motion.qd, motion.qdd, lam, sampled.p)

    def _drives(self, sampled: Sampled, step: float, k: int) -> dict[str, DriveFigures]:
        """Return the figures of the drives along samples, for a key changed by so much."""
        from robodyn_cli.drives.report import Drives, Moved

        number = self.numbers[k]
        part = step / (abs(self.asked.values[number]) or 1.0)
        scene = self.asked.changed([number], part) if step else self.asked.scene
        motion = sampled.motion
        breaks = tuple(breaks_of(self.problem, sampled.times, motion))
        moved = Moved(sampled.times, motion.q, motion.qd, motion.qdd, sampled.tau, breaks)
        return Drives.of(scene, program_of(scene).problem if step else self.problem, moved).figures()


def _refuse(program: InverseProgram) -> None:
    """Refuse runs whose torques do not follow from t, q, v and v-dot alone.

    Raises
    ------
    CapabilityError
    """
    if program.problem.model.switched:
        raise CapabilityError("payloads are gripped or released on the way")
    if isinstance(program, ClosedLoops) and geared(program.problem.model):
        raise CapabilityError("the losses of gears depend on how loops share the load")


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
        part = every_second(planned.times, every)
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
        self.led = None if lead is None else LedMotion(problem, lead, self.times, places)
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


def _course(scene: Scene) -> LedCourse:
    problem = problem_of(scene)
    lead, times = leading(problem)
    return LedCourse.of(problem, closer_times(problem, times), lead)
