"""The same motion in other forms than v-dot = a(t, q, v, z), for methods that step those."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING

from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.graph import Scalar

if TYPE_CHECKING:
    from robodyn_cli.formulations.index3 import Index3
    from robodyn_cli.formulations.residual import Residual


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
