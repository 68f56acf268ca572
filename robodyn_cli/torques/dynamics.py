"""Inverse and forward dynamics of open chains as compiled functions of arrays of samples."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from robodyn_cli.equations.gears import geared
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.graph import free_symbols
from robodyn_cli.kernels.crossover import prefer_rolled
from robodyn_cli.model.model import Model
from robodyn_cli.scene import types as sc
from robodyn_cli.spatial.algebra import Array, Vector, zeros
from robodyn_cli.torques.build import open_problem
from robodyn_cli.torques.function import Arguments

if TYPE_CHECKING:
    from robodyn_cli.kernels.program import Program
    from robodyn_cli.kernels.rolled.kernels import RolledPlan


def timeless(problem: Problem) -> list[Vector]:
    """Return the torques beside those of the actuators by term, friction with the exact sign.

    Raises
    ------
    CapabilityError : some depend on time, which functions of samples do not take.
    """
    terms = list(problem.passive_forces(smooth=False).values())
    if any(symbol is problem.t for symbol in free_symbols([x for term in terms for x in term])):
        effects = zip(problem.model.forces, problem.elements.effects)
        acting = {
            force.name: [x for a in effect.actions for x in a.wrench.components] for force, effect in effects
        }
        names = ", ".join(n for n, xs in acting.items() if any(s is problem.t for s in free_symbols(xs)))
        raise CapabilityError(
            f"forces that depend on time ({names}) are not allowed in a function of q, qd and qdd; "
            "allowed: forces of constants, positions and rates"
        )
    return terms


def needed_torques(problem: Problem) -> Vector:
    """Return the torques that a motion needs, tau = M a + C v + G - tau_passive - tau_friction - tau_external (nv,).

    Raises
    ------
    CapabilityError : as ``timeless``.
    """
    tau = problem.inverse_dynamics
    for term in timeless(problem):
        tau = tau - term
    return tau


def forward_problem(source: sc.Scene | Model | Problem) -> Problem:
    """Return the equations of an open chain whose accelerations follow from its torques.

    Raises
    ------
    CapabilityError : it has loops, prescribed joints or gears with losses.
    """
    problem = open_problem(source, "forward dynamics")
    if geared(problem.model):
        raise CapabilityError("gear losses depend on the drive, so they have no forward dynamics of samples")
    return problem


Samples = Callable[[Array, Array, Array], Array]


class _Unrolled:
    """One expression graph as straight-line code; the third array of samples is symbol group ``group``."""

    def __init__(self, entries: Any, group: str) -> None:
        from robodyn_cli.kernels.samples import SampleKernel

        self.group = group
        self.kernel = SampleKernel({"out": list(entries)}, ("q", "v", group))
        self.operations = self.kernel.program.operations

    def __call__(self, q: Array, qd: Array, x: Array) -> Array:
        return self.kernel(q=q, v=qd, **{self.group: x})["out"]


class _JointForces:
    """The torques of springs, dampers and friction at many samples, if there are any."""

    def __init__(self, problem: Problem) -> None:
        from robodyn_cli.kernels.samples import SampleKernel

        terms = timeless(problem)
        self.kernel = SampleKernel({"f": list(sum(terms[1:], terms[0]))}, ("q", "v")) if terms else None
        self.operations = self.kernel.program.operations if self.kernel else 0

    def add_to(self, tau: Array, q: Array, qd: Array) -> Array:
        return tau + self.kernel(q=q, v=qd)["f"] if self.kernel else tau

    def take_from(self, tau: Array, q: Array, qd: Array) -> Array:
        return tau - self.kernel(q=q, v=qd)["f"] if self.kernel else tau


class _Samples:
    """A function of samples: q (T, nq) and two arrays (T, nv), whose columns are the joints of one model."""

    names: tuple[str, str, str]
    _call: Samples

    def _open(self, problem: Problem) -> None:
        self.joints = problem.model.v_names
        self._arguments = Arguments.of(problem, self.names)

    def _evaluate(self, *arrays: Any) -> Array:
        """Return the function's result (T, nv), or (nv,) of one state.

        Raises
        ------
        CapabilityError : arrays of shapes that do not fit.
        """
        rows, one = self._arguments.rows(arrays)
        found = self._call(*rows.values())
        return found[0] if one else found


class InverseDynamics(_Samples):
    """Joint torques that a motion needs, tau = M qdd + C qd + G - tau_passive - tau_friction - tau_external.

    Calling it takes q (T, nq), qd and qdd (T, nv) and returns tau (T, nv) [N m or N], columns in the order of
    the joints; of one state it takes (nq,) and (nv,) and returns (nv,). Column-ordered arrays (``order="F"``) of
    float64 are read in place, others are copied first; the result is column-ordered.

    Short chains become straight-line code, long ones a loop over their bodies (attribute ``shape``:
    ``unrolled`` or ``rolled``; attribute ``code``: the program, or the tables of the loop).
    """

    names = ("q", "qd", "qdd")

    def __init__(self, source: sc.Scene | Model | Problem) -> None:
        problem = open_problem(source, "inverse dynamics")
        self._open(problem)
        self.shape, self._call, self.operations, self.code = self._compile(problem)

    @staticmethod
    def _compile(problem: Problem) -> tuple[str, Samples, int, Program | RolledPlan]:
        if prefer_rolled(problem.model):
            from robodyn_cli.kernels.rolled.kernels import RolledInverseDynamics

            if geared(problem.model):
                raise CapabilityError(
                    "loops over bodies do not support gear losses; allowed: the command inverse"
                )

            rigid, forces = RolledInverseDynamics(problem.model), _JointForces(problem)
            operations = rigid.plan.operations + forces.operations
            call = lambda q, qd, qdd: forces.take_from(rigid(q, qd, qdd), q, qd)  # noqa: E731
            return "rolled", call, operations, rigid.plan
        unrolled = _Unrolled(needed_torques(problem), "a")
        return "unrolled", unrolled, unrolled.operations, unrolled.kernel.program

    def __call__(self, q: Array, qd: Array, qdd: Array) -> Array:
        """Return tau (T, nv), or (nv,) of one state."""
        return self._evaluate(q, qd, qdd)


class ForwardDynamics(_Samples):
    """Joint accelerations that torques cause, qdd = M^-1 (tau + tau_passive + tau_friction + tau_external - C qd - G).

    Calling it takes q (T, nq), qd and tau (T, nv) and returns qdd (T, nv); arrays and attributes as for
    ``InverseDynamics``, whose inverse it is: friction has the exact sign of the rate, and is 0 at rest.
    """

    names = ("q", "qd", "tau")

    def __init__(self, source: sc.Scene | Model | Problem) -> None:
        problem = forward_problem(source)
        self._open(problem)
        self.shape, self._call, self.operations = self._compile(problem)

    @staticmethod
    def _compile(problem: Problem) -> tuple[str, Samples, int]:
        if prefer_rolled(problem.model):
            from robodyn_cli.kernels.rolled.kernels import RolledForwardDynamics

            rigid, forces = RolledForwardDynamics(problem.model), _JointForces(problem)
            operations = rigid.plan.operations + forces.operations
            return "rolled", lambda q, qd, tau: rigid(q, qd, forces.add_to(tau, q, qd)), operations
        model = problem.model
        f: Any = zeros(model.nv)
        for k, symbol in enumerate(problem.graph.symbols(model.v_names, "tau")):
            f[k] = symbol
        for term in timeless(problem):
            f = f + term
        unrolled = _Unrolled(problem.free_accelerations(f - problem.bias), "tau")
        return "unrolled", unrolled, unrolled.operations

    def __call__(self, q: Array, qd: Array, tau: Array) -> Array:
        """Return qdd (T, nv), or (nv,) of one state."""
        return self._evaluate(q, qd, tau)
