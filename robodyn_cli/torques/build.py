"""The equations of an inverse run: of an open chain here, of a mechanism with loops in ``closed``."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.expr.many import ManyNumbers
from robodyn_cli.given.motion import Planned, motion_duration, plan_motion
from robodyn_cli.model.consistency import refuse_immovable
from robodyn_cli.observe.evaluation import SampleFunction, without_idle_unknowns
from robodyn_cli.record import record
from robodyn_cli.results.result import Result
from robodyn_cli.scene import types as sc
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.torques.program import AlongMotion, InverseProgram, Sampled, expressions_of

if TYPE_CHECKING:
    from robodyn_cli.kernels.samples import SampleKernel


def build_inverse(scene: sc.Ready) -> InverseProgram:
    """Return the program of a scene's inverse dynamics.

    Raises
    ------
    SceneError, CapabilityError : motion or actuators do not suffice, or inverse dynamics does not support a part of
    the scene.
    """
    refuse_immovable(scene)
    problem = _problem_along(scene)
    if scene.loops or scene.couplers:
        from robodyn_cli.torques.closed import build_closed

        return build_closed(problem)
    _refuse_passive_joints(problem)
    return OpenChain(problem, motion_duration(scene), **expressions_of(problem))


def _problem_along(scene: sc.Scene) -> Problem:
    """Return the equations along a motion, on which payloads may come and go."""
    if not scene.payloads:
        return Problem(scene)
    from robodyn_cli.equations.payloads import switched_problem
    from robodyn_cli.torques.payloads import refuse_events

    refuse_events(scene)
    return switched_problem(scene)


@record
class OpenChain(InverseProgram):
    """Inverse dynamics of a robot without loops: every joint has an actuator, whose torque is the sum of the terms."""

    def plan(self, times: Array) -> Planned:
        return plan_motion(self.problem, times)

    def evaluate(self, planned: Planned, function: AlongMotion) -> Sampled:
        p = self.parameters(planned.times)
        arrays = function.along(planned.times, planned.motion, p)
        counters = {"operations": function.operations, "compiled": function.compiled, **planned.counters}
        return Sampled(planned.times, planned.motion, p, self.loads(arrays), arrays, counters)

    def forward(self, sampled: Sampled, numbers: ManyNumbers | None = None) -> tuple[Array, Array] | None:
        bias, q = sampled.arrays["bias"], np.concatenate([sampled.motion.q] * 2)
        a = self.free_accelerations
        if a is None:
            return None
        p, f = np.tile(sampled.p, (2, 1)), np.concatenate([sampled.applied - bias, -bias])
        if numbers is None:
            there = SampleFunction({"a": a}, ("q", "f", "p"), len(q))(q=q, f=f, p=p)["a"]
        else:
            kernel = self._kernel
            kernel.table = np.ascontiguousarray(numbers.table(kernel.program.numbers or (0.0,))[0])
            there = kernel(q=q, f=f, p=p)["a"]
        driven, free = np.split(there, 2)
        return driven, free

    @cached_property
    def free_accelerations(self) -> list[Scalar] | None:
        """The accelerations (nv,) that generalised forces f give; None where the mass matrix is singular."""
        problem = self.problem
        try:
            a = list(problem.free_accelerations(problem.graph.symbols(problem.model.v_names, "f")))
        except ZeroDivisionError:
            return None
        # unknown data that cancels in M may stand in articulated inertias
        return without_idle_unknowns(a, _entries_of_mass_matrix(problem))

    @cached_property
    def _kernel(self) -> SampleKernel:
        from robodyn_cli.kernels.samples import SampleKernel

        return SampleKernel({"a": self.free_accelerations or []}, ("q", "f", "p"))

    def row_multipliers(self, sampled: Sampled) -> None:
        return None

    def add_loops(self, result: Result, sampled: Sampled) -> None:
        return None


def _entries_of_mass_matrix(problem: Problem) -> Iterator[Scalar]:
    """Give the entries of M, which is built only if somebody asks: it grows with the square of the joints."""
    yield from problem.mass_matrix.flat


def _refuse_passive_joints(problem: Problem) -> None:
    """Refuse motion of joints without an actuator: passive joints of an open chain follow no given path.

    Raises
    ------
    CapabilityError
    """
    actuated = problem.scene.actuated
    passive = [n for n in problem.model.joint_names if actuated is not None and n not in actuated]
    if passive:
        raise CapabilityError(
            f"inverse dynamics needs every joint of an open chain to be actuated, and 'actuated' lacks "
            f"{passive[0]!r}; allowed: all of {', '.join(problem.model.joint_names)}",
            key="actuated",
        )
