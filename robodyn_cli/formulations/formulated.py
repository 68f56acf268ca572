"""What a formulation makes of a mechanism's equations, in the mechanism's own symbols t, q, v, p."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.formulations.dynamics import Dynamics
from robodyn_cli.formulations.forms import OtherForms
from robodyn_cli.formulations.system import NO_CORRECTIONS, Corrections, Partition
from robodyn_cli.record import record


@record
class Formulated:
    """Rates, and what goes with them; see ``System`` for the meaning of the fields."""

    dynamics: Dynamics
    corrections: Corrections = NO_CORRECTIONS
    partition: Partition | None = None
    forms: OtherForms | None = None


# (problem, rates of the further states z, what ``simulate.stabilisation`` says)
Formulation = Callable[[Problem, Sequence[Scalar], Any], Formulated]
