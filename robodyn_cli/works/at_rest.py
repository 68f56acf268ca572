"""A mechanism at rest: its configuration, and the torques that hold it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import unknown_data
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.model.model import unknown_among
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.mechanism import Balanced, Held


@record
class AtRest:
    """A configuration at rest with the torques (nv,) and the multipliers (m,) of the loops that hold it.

    terms : the torques (nv,) by term, where actuators hold it.
    """

    problem: Problem
    q: Array
    tau: Array
    lam: Array
    facts: Balanced | Held
    terms: Mapping[str, Array]


def refuse_unknown(entries: Sequence[Scalar]) -> None:
    """Refuse expressions that depend on data which the scene does not give.

    Raises
    ------
    SceneError
    """
    if missing := unknown_among(entries):
        raise unknown_data(missing)
