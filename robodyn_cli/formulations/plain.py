"""Index 1 as it stands: accelerations and multipliers from equation (36); loops drift apart by rounding and error."""

from __future__ import annotations

from collections.abc import Sequence

from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.formulations.dynamics import Expanded
from robodyn_cli.formulations.formulated import Formulated, OtherForms


def plain(problem: Problem, z_rate: Sequence[Scalar], asked: object = None) -> Formulated:
    """Return the equations of index 1 with nothing added."""
    dynamics = Expanded(tuple(problem.forward.qdd), tuple(z_rate))
    return Formulated(dynamics, forms=OtherForms(problem, z_rate))
