"""The result of a formulation: equations to integrate, in the mechanism's own symbols t, q, v, p."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.formulations.dynamics import Dynamics
from robodyn_cli.formulations.system import NO_CORRECTIONS, Corrections, Partition
from robodyn_cli.record import record

if TYPE_CHECKING:
    from robodyn_cli.formulations.index3 import Index3
    from robodyn_cli.formulations.residual import Residual


@record
class Formulated:
    """Rates with their corrections and partition; see ``System`` for the meaning of the fields."""

    dynamics: Dynamics
    corrections: Corrections = NO_CORRECTIONS
    partition: Partition | None = None
    forms: OtherForms | None = None


class OtherForms:
    """Other forms of one mechanism's equations, each built when a method asks for it."""

    def __init__(self, problem: Problem, z_rate: Sequence[Scalar]) -> None:
        self.problem = problem
        self.z_rate = tuple(z_rate)

    @cached_property
    def index3(self) -> Index3:
        """Positions and multipliers as unknowns."""
        from robodyn_cli.formulations.index3 import Index3

        return Index3(self.problem)

    @cached_property
    def residual(self) -> Residual | None:
        """Accelerations as corrections of a guess, None where the equations cannot be written so."""
        from robodyn_cli.formulations.residual import Residual

        return Residual(self.problem, self.z_rate) if Residual.fits(self.problem) else None


# (problem, rates of the further states z, what ``simulate.stabilisation`` says)
Formulation = Callable[[Problem, Sequence[Scalar], Any], Formulated]
