"""The equations of ``inverse`` with the numbers of any run of a structure: its motion, and the torques along it."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.drives.motorisation import ActingTorques, JointMargins
from robodyn_cli.drives.report import Drives, Moved, StandingStill
from robodyn_cli.equations.gears import geared
from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.fixed import witnessed
from robodyn_cli.expr.many import Decision, ManyNumbers
from robodyn_cli.given.guided_motion import with_target
from robodyn_cli.given.loop_conditions import Lead, leads_apart, velocity_places
from robodyn_cli.given.motion import Planned
from robodyn_cli.integrators.stepping.writer import Tables
from robodyn_cli.kernels.samples import SampleKernel
from robodyn_cli.model.model import MOTION_GROUPS
from robodyn_cli.observe.evaluation import refuse_sampled
from robodyn_cli.observe.reactions import Loads, ReactionSamples
from robodyn_cli.observe.rounding import largest_differences
from robodyn_cli.over.many.groups import Built, first_of
from robodyn_cli.over.many.guides import LED, Guided, changes_lengths, guided_reasons
from robodyn_cli.over.many.keys import NUMBER, Key, settings
from robodyn_cli.record import record
from robodyn_cli.scene.load import Family
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.quadrature import Breaks
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.design import BalanceKeys
from robodyn_cli.summaries.drives import DriveKeys, MotorisationKeys
from robodyn_cli.summaries.facts import ABSENT, Absent, PeakLoads
from robodyn_cli.torques.build import OpenChain
from robodyn_cli.torques.checks import crowded_turns
from robodyn_cli.torques.closed import ClosedLoops
from robodyn_cli.torques.program import InverseProgram, Sampled
from robodyn_cli.trajectories.base import TaskSpaceTrajectory
from robodyn_cli.trajectories.motion import JointMotion
from robodyn_cli.works.balance import Shaking, Wheel
from robodyn_cli.works.inverse import at_rest, planned_at, program_of

ENTRIES = 4_000_000  # of evaluated arrays at a time: 32 MB


class InverseStructure(Built):
    """The equations of a scene with one row of values, compiled once.

    Raises
    ------
    RobodynError : there are no inverse dynamics with these values.
    """

    def __init__(self, family: Family, keys: Sequence[Key], row: Array) -> None:
        scene = family.scene(settings([key.name for key in keys], row))
        with witnessed() as witnesses:
            self.program = program_of(scene)
            outputs = list(self.program.outputs.values())
            # without names from the scene, scenes with equal equations share their code
            self.kernel = SampleKernel({f"o{k}": x for k, x in enumerate(outputs)}, MOTION_GROUPS)
            self.lead = self.program.lead if isinstance(self.program, ClosedLoops) else None
            self._guided: dict[bytes, Guided] = {}
            self.reactions = None
            if scene.outputs.reactions:
                self.reactions = ReactionSamples(self.program.problem, scene.inverse.samples)
            self.beside = Burdens(self.program.problem, scene)
            if not (why := obstacle(self.program, self.lead, scene, keys)) and self.lead is not None:
                self.guide(self.program.looked_at(scene.inverse.samples))
        names = list(self.program.outputs)
        self.terms = [f"o{names.index(f'torque_terms/{name}')}" for name in self.program.terms]
        self.size = sum(len(x) for x in outputs)
        super().__init__(keys, row, Tables([self.kernel.program]), witnesses, why)
        self._planned: dict[bytes, Planned] = {}

    @cached_property
    def forward(self) -> list[Decision]:
        """The comparisons of numbers that forward dynamics of an open chain asks for."""
        with witnessed() as witnesses:
            if isinstance(self.program, OpenChain):
                self.program.free_accelerations  # noqa: B018
        return self.recipe.deciding(witnesses)

    @property
    def driven(self) -> list[int]:
        """Velocity coordinates of the joints that have figures."""
        model = self.program.problem.model
        closed = isinstance(self.program, ClosedLoops)
        return velocity_places(model, self.program.actuated) if closed else list(range(model.nv))  # type: ignore[attr-defined]

    def planned(self, times: Array) -> Planned:
        """Return the motion at times (T,), which is the same in all runs of an open chain."""
        key = times.tobytes()
        if key not in self._planned:
            self._planned[key] = planned_at(self.program, times)
        return self._planned[key]

    def turns_in_crowds(self, planned: Planned) -> bool:
        """Whether joints of a mechanism turn back where the command would look at more samples."""
        return self.lead is not None and bool(
            crowded_turns(self.program.problem, planned.times, planned.motion)
        )

    def guide(self, times: Array) -> Guided:
        """Return the equations of the motion of a mechanism at times (T,)."""
        key = times.tobytes()
        if key not in self._guided:
            assert self.lead is not None
            self._guided[key] = Guided(self, self.program.problem, self.lead, times)
        return self._guided[key]

    def motions(self, values: Array, times: Array) -> list[Planned | None]:
        """Return the motions at times (T,) of runs with rows of values (N, keys); None of those that do not come to
        the end."""
        if self.lead is None:
            return [self.planned(times)] * len(values)
        problem, guided = self.program.problem, self.guide(times)
        motions = guided.follow(values)
        off = guided.residuals(values, motions)
        planned: list[Planned | None] = []
        for k in range(len(values)):
            motion = JointMotion(*(np.asfortranarray(x[k]) for x in (motions.q, motions.v, motions.a)))
            own = Planned(times, motion, residuals={level: float(x[k]) for level, x in off.items()})
            good = motions.good[k]
            planned.append(at_rest(problem, with_target(problem, self.lead, own)) if good else None)
        return planned

    def sampled(self, planned: Planned, table: Array) -> Sampled:
        """Return what is evaluated along the motion of a run with a row of the tables.

        Raises
        ------
        RobodynError : loops or actuators lose their hold, or a number is not finite.
        """
        return self.program.evaluate(planned, _OfRun(self, table))

    def loads(self, sampled: Sampled, values: Array, breaks: Breaks) -> PeakLoads | Absent:
        """Return the largest forces and moments in joints and closures of a run with a row of values (1, keys)."""
        if self.reactions is None:
            return ABSENT
        numbers, function = self.numbers(values), self.reactions.function
        function.take([numbers.table(x)[0] for x in function.numbers])
        motion, lam = sampled.motion, self.program.row_multipliers(sampled)
        data = self.reactions(sampled.times, motion.q, motion.qd, motion.qdd, lam, sampled.p)
        return Loads(self.reactions, sampled.times, data).summary(breaks)

    def torques(self, planned: Planned, tables: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Return the torques (N, nv, T) along a motion with rows of tables, and where all of a run is finite (N,)."""
        motion, times = planned.motion, planned.times
        groups = {"t": times[:, None], "q": motion.q, "v": motion.qd, "a": motion.qdd}
        arrays = self.kernel.of_tables(tables, len(times), groups)
        tau = np.sum([arrays[name] for name in self.terms], axis=0)
        good = np.isfinite(tau).all(axis=(1, 2))
        for array in arrays.values():
            good &= np.isfinite(array).all(axis=(1, 2))
        return tau, good

    def rounding(self, sampled: Sampled, values: Array) -> Array:
        """Return how far rounding may have put any torque off in runs of a motion with rows of values (N, keys)."""
        program = self.program
        off = np.empty(len(values))
        runs = max(1, ENTRIES // program.rounded_size)
        for first in range(0, len(values), runs):
            part = slice(first, first + runs)
            draws = program.torques_by_draw(sampled, self.numbers(values[part]))
            off[part] = np.nan if draws is None else largest_differences(draws)
        return np.where(np.isfinite(off), off, np.nan)


class Burdens:
    """What drives, margins of motorisation, shaking forces and a flywheel follow from beside the torques, as far as the
    scene asks for them. scene : as it is written, whose numbers are plain ones."""

    def __init__(self, problem: Problem, scene: Scene) -> None:
        asked = scene.inverse
        self.problem, samples = problem, asked.samples
        self.drives = StandingStill(scene, problem, samples) if scene.drives else None
        self.margins = ActingTorques(problem, True, samples) if scene.motorisation is not None else None
        self.shaking = Shaking(problem, asked.shaking, samples) if asked.shaking is not None else None
        self.wheel = Wheel(problem, samples) if asked.flywheel is not None else None
        parts = (self.drives, self.margins, self.shaking, self.wheel)
        self._functions = [part.function for part in parts if part is not None and part.function is not None]

    @property
    def judges(self) -> bool:
        """Whether limits decide the exit code."""
        return self.drives is not None or self.margins is not None

    def records(self, sampled: Sampled, numbers: ManyNumbers, breaks: Breaks) -> tuple[list[Any], bool]:
        """Return the records of a run with these numbers, and whether drives and margins suffice.

        Raises
        ------
        CapabilityError : the command refuses the run.
        """
        for function in self._functions:
            function.take([numbers.table(x)[0] for x in function.numbers])
        motion, suffice = sampled.motion, True
        records: list[Any] = []
        moved = Moved(sampled.times, motion.q, motion.qd, motion.qdd, sampled.tau, tuple(breaks))
        if self.drives is not None:
            figures = Drives.of(self.problem.scene, self.problem, moved, self.drives).figures()
            records.append(DriveKeys(figures, self.problem.scene.catalogue.title or ABSENT))
            suffice = all(one.passes for one in figures.values())
        if self.margins is not None:
            margins = JointMargins.along(self.margins, moved).figures()
            records.append(MotorisationKeys(margins))
            suffice = suffice and all(one.met for one in margins.values())
        if self.shaking is not None or self.wheel is not None:
            shaking = ABSENT if self.shaking is None else self.shaking.figures(sampled, list(breaks))
            wheel = ABSENT if self.wheel is None else self.wheel.figures(sampled, list(breaks))
            records.append(BalanceKeys(shaking, wheel))
        return records, suffice


@record
class _OfRun:
    """The code of a structure with the table of a run."""

    structure: InverseStructure
    table: Array

    operations = 0
    compiled = True

    def along(self, times: Array, motion: JointMotion, p: Array | None = None) -> dict[str, Array]:
        """Return the outputs along a motion.

        Raises
        ------
        NumericalError : a number is not finite.
        """
        kernel, outputs = self.structure.kernel, self.structure.program.outputs
        kernel.table = np.ascontiguousarray(self.table)
        inputs = {"t": times[:, None], "q": motion.q, "v": motion.qd, "a": motion.qdd}
        found = kernel.evaluate(len(times), inputs)
        arrays = {name: found[f"o{k}"] for k, name in enumerate(outputs)}
        refuse_sampled(inputs, outputs, arrays)
        return arrays


def obstacle(program: InverseProgram, lead: Lead | None, scene: Scene, keys: Sequence[Key]) -> str:
    """Return why runs are made one by one; nothing where their torques are evaluated together."""
    point = isinstance(scene.trajectory, TaskSpaceTrajectory)
    reasons = {
        LED: point and (lead is None or leads_apart(program.problem)) and changes_lengths(keys),
        "a frame's attitude is led": lead is not None and lead.led is not None and lead.led.oriented,
        "gears of a mechanism lose power": lead is not None and bool(geared(program.problem.model)),
        **motion_reasons(scene, program, keys),
        **(guided_reasons(program.problem, lead, keys) if lead is not None else {}),
    }
    return first_of(reasons)


def motion_reasons(scene: Scene, program: InverseProgram, keys: Sequence[Key]) -> dict[str, bool]:
    """Return what makes the motion or the load another one than its equations say, by whether that holds."""
    return {
        "limits of torques or paths decide the motion": scene.trajectory is not None
        and not scene.trajectory.in_time,
        "parameters may change the motion": any(
            key.sort == NUMBER and key.place.startswith("parameters.") for key in keys
        ),
        "a prescribed motion changes": any(key.place.startswith("prescribed.") for key in keys),
        "payloads are gripped or released": bool(program.problem.model.switched),
        "data of drives or of margins vary": any(
            key.sort == NUMBER and key.place.startswith(("drives.", "motorisation.", "inverse."))
            for key in keys
        ),
    }
