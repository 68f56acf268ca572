"""The accelerations as corrections of a guess, for methods that iterate on them.

    f(t, q, v) = a + M^-1 (tau(t, q, v) - M a - h(q, v))   for any a,

so the iteration a <- f(t, q(a), v(a)) can add M^-1 times the residual of inverse dynamics. Then M decides how fast the
iteration converges but not its limit, and its factors may be some rounds old: a change of dq in the positions since
then makes the correction wrong by a part of the size of dq. A round takes inverse dynamics and a triangular solve
instead of forward dynamics, half the operations for an arm of seven joints. The rounding error is that of the
residual, as in iterative refinement.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

from robodyn_cli.algorithms.composite import crba
from robodyn_cli.algorithms.linear import LdlFactor
from robodyn_cli.algorithms.rnea import rnea
from robodyn_cli.decision import Decision
from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.kernels.program import Program, make_program
from robodyn_cli.model.model import STATE_GROUPS
from robodyn_cli.spatial.algebra import Vector

INPUTS = (*STATE_GROUPS, "a", "l")
LARGEST = 12  # velocities up to which M is factored as a dense matrix


class Residual:
    """The equations of an open tree in this form.

    ``factors`` has the output ``l``, M(q) factored; ``correction`` has ``d`` (nv,), what to add to the accelerations
    ``a`` with factors ``l``, and ``z``, the rates of the further states.

    Limits: no constraints, because their multipliers would have to be iterated as well; no joints with a contact
    state, whose accelerations follow a constraint while they are held.
    """

    def __init__(self, problem: Problem, z_rate: Sequence[Scalar] = ()) -> None:
        self.problem = problem
        self.z_rate = tuple(z_rate)

    @staticmethod
    def fits(problem: Problem) -> bool:
        """Tell whether a mechanism's equations can be written so."""
        return not problem.independent_rows.rows and not problem.is_held and problem.model.nv <= LARGEST

    @cached_property
    def _factor(self) -> LdlFactor:
        M = crba(self.problem.lumped, self.problem.q, self.problem.X)
        return LdlFactor.of(M, self.problem.elimination_order)

    @property
    def entries(self) -> list[Scalar]:
        """The factors of M(q)."""
        return self._factor.entries

    @cached_property
    def corrections(self) -> Vector:
        """M^-1 (tau - M a - h) (nv,), with the factors and a as symbols."""
        p = self.problem
        known = p.graph.symbols([f"l{k}" for k in range(len(self.entries))], "l")
        needed = rnea(p.lumped, p.q, p.v, p.a, p.gravity, p.X)
        return self._factor.replaced(known).solve(p.applied - needed)

    @cached_property
    def factors(self) -> Program:
        return make_program({"l": self.entries}, STATE_GROUPS)

    @cached_property
    def correction(self) -> Program:
        outputs: dict[str, Sequence[Scalar]] = {"d": list(self.corrections), "z": self.z_rate}
        return make_program({k: v for k, v in outputs.items() if len(v)}, INPUTS)

    def decision(self, direct: Program) -> Decision:
        """Return why corrections are made instead of evaluating ``direct``."""
        taken = "corrections by inverse dynamics"
        operations = {
            taken: self.correction.operations,
            "forward dynamics": direct.operations,
            "factors of the mass matrix, once": self.factors.operations,
        }
        reason = "fewer operations over the rounds of a step"
        return Decision("accelerations in the stages", taken, reason, operations)

    def pays(self, direct: Program, rounds: int) -> bool:
        """Tell whether ``rounds`` corrections with factors made once take fewer operations than ``direct`` as often."""
        return self.factors.operations + rounds * self.correction.operations < rounds * direct.operations
