"""Close the loops: exact positions and consistent velocities from approximate initial values."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from robodyn_cli.errors import GeometryError
from robodyn_cli.model.manifold import Manifold
from robodyn_cli.model.model import Model
from robodyn_cli.record import record
from robodyn_cli.solve.closure import CLOSED, ClosureEquations, Numbers
from robodyn_cli.solve.independent_rows import generic_psi, independent_rows
from robodyn_cli.spatial.algebra import Array

if TYPE_CHECKING:
    from robodyn_cli.solve.closing.nearest import ClosedPose
    from robodyn_cli.solve.closing.open_loops import Closable
    from robodyn_cli.solve.closing.rates import RatesByLoops


@record
class Assembled:
    """A closed configuration: q (nq,), v (nv,), the largest residuals, independent rows, and the other rows.

    rates : how v followed, where loops decide.
    """

    q: Array
    v: Array
    position_residual: float
    velocity_residual: float
    independent: tuple[int, ...]
    redundant: tuple[str, ...]
    closure: ClosedPose | None = None
    rates: RatesByLoops | None = None


def assemble(
    equations: ClosureEquations,
    given: dict[str, float],
    rates: dict[str, float],
    hold: Sequence[str] = (),
    parameters: Sequence[float] = (),
) -> Assembled:
    """Close the loops at t = 0.

    Parameters
    ----------
    given : initial values by column of q; coordinates that are not given are found from many starts.
    rates : initial rates by column of v; the others follow from the velocity constraints, with least norm.
    hold : columns of q whose position stays exactly as given.

    Raises
    ------
    GeometryError : a loop cannot close (which, and by how much), or the rates contradict the constraints.
    SingularConfigurationError : the start is a singular configuration.
    """
    model = equations.model
    rate_place = {name: k for k, name in enumerate(model.v_names)}
    v = np.zeros(model.nv)
    for name, value in rates.items():
        v[rate_place[name]] = value
    q = _begin(model, given)
    if not equations.constraint_rows:
        return Assembled(q, v, 0.0, 0.0, (), ())
    numbers = Numbers(equations, parameters)
    from robodyn_cli.solve.closing.rates import RatesByLoops

    task, closure = _closed(numbers, q, given, hold)
    q = closure.q
    independent, redundant = independent_rows(numbers, q, closure.rank_tolerance)
    given_rates = frozenset(rate_place[name] for name in rates)
    rule = RatesByLoops(v, given_rates, frozenset(range(model.nv)) - frozenset(task.free), closure.cut)
    v, residual, closed = rule(numbers.psi(q), numbers.eta_t(q))
    remaining = float(np.abs(residual).max())
    if rates and not closed:
        row = numbers.rows[int(np.abs(residual).argmax())]
        unit = "m/s" if row.kind in ("force", "m") else "rad/s"
        raise GeometryError(
            f"the initial rates contradict the constraints: {row.name} moves at {remaining:.6g} {unit}; "
            "give fewer of initial.qd",
            key="initial.qd", row=row.name, residual=remaining,
        )  # fmt: skip
    return Assembled(
        q, v, float(np.abs(numbers.eta(q)).max()), remaining, independent,
        tuple(numbers.rows[i].name for i in redundant), closure, rule,
    )  # fmt: skip


def closed_start(
    equations: ClosureEquations, given: dict[str, float], hold: Sequence[str] = ()
) -> tuple[Array, float]:
    """Return the configuration (nq,) of ``assemble`` without a choice of rows, and the residual up to which its loops
    count as closed.

    Parameters, errors : as of ``assemble``.
    """
    model = equations.model
    q = _begin(model, given)
    if not equations.constraint_rows:
        return q, CLOSED
    numbers = Numbers(equations, ())
    _, closure = _closed(numbers, q, given, hold)
    generic_psi(numbers, closure.q, closure.rank_tolerance)
    return closure.q, closure.tolerance


def _begin(model: Model, given: dict[str, float]) -> Array:
    """Return the configuration (nq,) that Newton's method begins at: given values, others neutral."""
    neutral = zip(model.q_names, Manifold(model).neutral())
    return np.array([given.get(name, x) for name, x in neutral], dtype=float)


def _closed(
    numbers: Numbers, q: Array, given: dict[str, float], hold: Sequence[str]
) -> tuple[Closable, ClosedPose]:
    from robodyn_cli.solve.closing.nearest import close
    from robodyn_cli.solve.closing.open_loops import Closable

    task = Closable.of(numbers, q, given, hold)
    return task, close(numbers, q, task)
