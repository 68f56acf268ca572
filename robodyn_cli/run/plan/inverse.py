"""The plan of ``inverse``: the torques, and the other programs at the samples."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator
from typing import Any

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.graph import Scalar, count_operations
from robodyn_cli.kernels.crossover import CROSSOVER, prefer_rolled
from robodyn_cli.kernels.program import Program, make_program
from robodyn_cli.run.inverse.build import build_inverse
from robodyn_cli.run.inverse.dynamics import InverseDynamics
from robodyn_cli.run.mechanism.motion import point_task
from robodyn_cli.run.observation.evaluation import worth_compiling
from robodyn_cli.run.plan.programs import rolled, sampled
from robodyn_cli.run.plan.terms import Equations, Ledger, Term
from robodyn_cli.run.plan.words import listed, plural
from robodyn_cli.scene import types as sc
from robodyn_cli.trajectories.motion import TaskSpace


class Inverse:
    """The programs of inverse dynamics of one scene."""

    redundant: tuple[str, ...] = ()

    def __init__(self, scene: sc.Scene) -> None:
        self.program = build_inverse(scene)
        # equations of their own, for counts that the run does not need
        self.problem = Problem(scene)
        self.samples = scene.inverse.samples
        trajectory: Any = scene.trajectory
        leads = isinstance(trajectory, TaskSpace) and not self.problem.model.closures
        self.task = point_task(self.program.problem) if leads else None

    def outputs(self, problem: Problem) -> list[Scalar]:
        """Return the load on actuators and loops, and the rows of the loops, which share it."""
        tau: Any = problem.inverse_dynamics
        for term in problem.passive_forces(smooth=False).values():
            tau = tau - term
        rows = problem.constraints.loop_rows
        return [*tau, *(x for row in rows for x in row.psi)]

    @property
    def _operations(self) -> int:
        """Of all programs at a sample."""
        return count_operations([x for entries in self.program.outputs.values() for x in entries])

    def kernels(self) -> list[dict[str, Any]]:
        """Describe the compiled programs."""
        found = []
        function = self.program.compile(self.samples)
        if self.problem.model.closures:
            title = "torque terms, rows of the loops, energies, places"
        else:
            title = "torque terms, energies, places"
            with contextlib.suppress(CapabilityError):  # loads in time: no function of samples
                found.append(_torques(InverseDynamics(self.problem)))
        found.append(sampled(title, function.program, function.compiled))
        if self.task is not None and self.task.method == "newton":
            point = make_program(dict(self.task.kinematics().outputs()), ("q", "v"))
            found.append(sampled(f"kinematics of {self.task.trajectory.point}", point))
        return found

    def terms(self, equations: Equations) -> Iterator[Term]:
        """Yield the stages around the torques."""
        program, problem = self.program, self.program.problem
        less = dataclasses.replace(equations.here, accelerations=False)
        yield equations.kept("inertia forces", "the masses are accelerated", less)
        if not problem.model.closures:
            yield Term(
                "closed loops and their multipliers",
                False,
                "the joints form an open chain or tree: every torque follows from the motion alone",
            )
        if problem.scene.torques:
            yield Term("actuator torques of the scene", False, "inverse dynamics finds them")
        split = count_operations([x for entries in program.terms.values() for x in entries])
        together = count_operations(self.outputs(self.problem)[: problem.model.nv])
        reason = f"the result has them apart: {listed(program.terms)}"
        yield Term("torques split into terms", True, reason, split - together)
        places = [(len(problem.model.points), "named point"), (len(problem.model.frames), "frame")]
        what = ["energies", *(plural(n, what) for n, what in places if n), "outlines of the links"]
        reason = f"in the result: {', '.join(what)}"
        yield Term("energies, points and outlines", True, reason, self._operations - split)
        yield self._motion()
        yield Term("integration, events, projection", False, "the motion is given: nothing is integrated")

    def _motion(self) -> Term:
        """Return how the motion of all joints is found."""
        name = "inverse kinematics"
        if self.problem.model.closures:
            rows = self.program.problem.constraints.rows
            work = count_operations([x for row in rows for x in (row.eta, *row.psi, row.gamma, row.eta_t)])
            return Term(
                name, True, "the loops decide about the joints that are not led: by Newton's method", work
            )
        if self.task is None:
            return Term(name, False, "the trajectory gives the joints' motion itself")
        leads = f"the trajectory leads {self.task.trajectory.point}"
        if self.task.method == "analytic":
            return Term(name, True, f"{leads}: in closed form, a planar 2R arm")
        work = count_operations([x for part in self.task.kinematics().outputs().values() for x in part])
        return Term(name, True, f"{leads}: by Newton's method", work)

    def choices(self) -> list[dict[str, Any]]:
        """Describe the choices of the engine."""
        compiled = worth_compiling(self._operations, self.samples)
        first, second = ("compiling", "interpreting") if compiled else ("interpreting", "compiling")
        found = [{
            "choice": f"terms and energies at {self.samples} samples",
            "taken": "compiled" if compiled else "interpreted",
            "reason": f"{first} takes less time than {second}",
        }]  # fmt: skip
        if not self.problem.model.closures:
            found.append({
                "choice": "shape of the torque kernel",
                "taken": "rolled" if prefer_rolled(self.problem.model) else "unrolled",
                "reason": f"{plural(self.problem.model.nv, 'joint')}; a loop over the bodies pays from {CROSSOVER} on",
            })  # fmt: skip
        return found

    def equation_36(self, ledger: Ledger) -> dict[str, Any] | None:
        """Return nothing: inverse dynamics does not solve equation (36)."""
        return None


def _torques(function: InverseDynamics) -> dict[str, Any]:
    name = "torques (InverseDynamics)"
    if isinstance(function.code, Program):
        return sampled(name, function.code)
    return rolled(name, function.code, function.operations)
