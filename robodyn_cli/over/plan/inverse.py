"""The plan of ``inverse``: the torques, and the other programs at the samples."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any

from robodyn_cli.decision import Decision
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.graph import Scalar, count_operations
from robodyn_cli.given.motion import point_task
from robodyn_cli.kernels.crossover import CROSSOVER
from robodyn_cli.kernels.program import make_program
from robodyn_cli.observe.evaluation import SampleFunction
from robodyn_cli.over.plan.plane import at_samples
from robodyn_cli.over.plan.terms import Ledger, PlanEquations, Term
from robodyn_cli.over.plan.text import listed, plural
from robodyn_cli.scene import types as sc
from robodyn_cli.summaries.checks import Kernel, LoopCosts
from robodyn_cli.torques.dynamics import InverseDynamics
from robodyn_cli.trajectories.base import TaskSpaceTrajectory
from robodyn_cli.works.inverse import program_of


class InversePlan:
    """The programs of inverse dynamics of one scene."""

    inner = "torques"
    redundant: tuple[str, ...] = ()

    def __init__(self, scene: sc.Scene) -> None:
        self.fastest = scene.trajectory is not None and scene.trajectory.least_time
        self.program = program_of(scene)
        scene = self.program.problem.scene
        # equations of their own, for counts that the run does not need
        self.problem = Problem(scene)
        leads = isinstance(scene.trajectory, TaskSpaceTrajectory) and not self.problem.model.closures
        self.task = point_task(self.program.problem) if leads else None

    @cached_property
    def function(self) -> SampleFunction:
        """All that is evaluated at the samples."""
        return self.program.compile(self.problem.scene.inverse.samples)

    @cached_property
    def torques(self) -> InverseDynamics | None:
        """The torques as a function of samples, None where there is no such function."""
        with contextlib.suppress(CapabilityError):  # loops, loads in time
            return InverseDynamics(self.problem)
        return None

    def outputs(self, problem: Problem) -> list[Scalar]:
        """Return the load on actuators and loops, and the rows of the loops, which share it."""
        tau: Any = problem.inverse_dynamics
        for term in problem.passive_forces(smooth=False).values():
            tau = tau - term
        rows = problem.constraints.loop_rows
        return [*tau, *(x for row in rows for x in row.psi)]

    def kernels(self) -> list[Kernel]:
        """Return the compiled programs."""
        found, title = [], "torque terms, energies, places"
        if self.problem.model.closures:
            title = "torque terms, rows of the loops, energies, places"
        if self.torques is not None:
            code = self.torques.code
            beside = self.torques.operations - code.operations
            found.append(at_samples("torques (InverseDynamics)", code, beside=beside))
        found.append(at_samples(title, self.function.program, self.function.compiled))
        if self.task is not None and self.task.method == "newton":
            point = make_program(dict(self.task.kinematics().outputs()), ("q", "v"))
            found.append(at_samples(f"kinematics of {self.task.trajectory.point}", point))
        return found

    def choices(self) -> list[Decision]:
        """Return the decisions of the builders."""
        found = [self.function.decision]
        if self.torques is not None:
            joints = plural(self.problem.model.nv, "joint")
            reason = f"{joints}; a loop over the bodies pays from {CROSSOVER} on"
            found.append(Decision("shape of the torque kernel", self.torques.shape, reason))
        return found

    def terms(self, e: PlanEquations) -> Iterator[Term]:
        """Yield the stages around the torques."""
        program, model = self.program, self.program.problem.model
        less = dataclasses.replace(e.here, accelerations=False)
        yield e.kept("inertia forces", "the masses are accelerated", less)
        if not model.closures:
            reason = "the joints form an open chain or tree: every torque follows from the motion alone"
            yield Term("closed loops and their multipliers", False, reason)
        if program.problem.scene.torques:
            yield Term("actuator torques of the scene", False, "inverse dynamics finds them")
        split = _operations(program.terms)
        together = count_operations(self.outputs(self.problem)[: model.nv])
        reason = f"the result has them apart: {listed(program.terms)}"
        yield Term("torques split into terms", True, reason, split - together)
        places = [(len(model.points), "named point"), (len(model.frames), "frame")]
        what = ["energies", *(plural(n, what) for n, what in places if n), "outlines of the links"]
        reason = f"in the result: {', '.join(what)}"
        yield Term("energies, points and outlines", True, reason, _operations(program.outputs) - split)
        yield self._motion()
        if self.fastest:
            yield Term(
                "time law", True, "as fast as the limits allow: two passes over a grid, before the samples"
            )
        if self.task is not None and self.task.chosen:
            yield Term(
                "search for the first pose", True, "of those that reach the path's start, before the samples"
            )
        yield Term("integration, events, projection", False, "the motion is given: nothing is integrated")

    def _motion(self) -> Term:
        """Return how the motion of all joints is found."""
        problem = self.program.problem
        name, rows = "inverse kinematics", problem.constraints.rows
        if problem.model.closures:
            work = count_operations([x for row in rows for x in (row.eta, *row.psi, row.gamma, row.eta_t)])
            reason = "the loops decide about the joints that are not led: by Newton's method"
            return Term(name, True, reason, work)
        if self.task is None:
            gives = "the trajectory gives" if problem.scene.trajectory is not None else "formulas give"
            return Term(name, False, f"{gives} the joints' motion itself")
        leads = f"the trajectory leads {self.task.trajectory.point}"
        if self.task.method == "analytic":
            return Term(name, True, f"{leads}: in closed form, a planar 2R arm")
        return Term(name, True, f"{leads}: by Newton's method", _operations(self.task.kinematics().outputs()))

    def equation_36(self, ledger: Ledger) -> LoopCosts | None:
        """Return nothing: inverse dynamics does not solve equation (36)."""
        return None


def _operations(outputs: Mapping[str, Sequence[Scalar]]) -> int:
    return count_operations([x for entries in outputs.values() for x in entries])
