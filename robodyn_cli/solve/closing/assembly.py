"""Close the loops: exact positions and consistent velocities from approximate initial values."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from robodyn_cli.errors import GeometryError
from robodyn_cli.model.manifold import Manifold
from robodyn_cli.record import record
from robodyn_cli.solve.closure import ClosureEquations, Numbers
from robodyn_cli.solve.independent_rows import independent_rows
from robodyn_cli.spatial.algebra import Array

if TYPE_CHECKING:
    from robodyn_cli.solve.closing.nearest import ClosedPose


@record
class Assembled:
    """A closed configuration: q (nq,), v (nv,), the largest residuals, independent rows, and the other rows."""

    q: Array
    v: Array
    position_residual: float
    velocity_residual: float
    independent: tuple[int, ...]
    redundant: tuple[str, ...]
    closure: ClosedPose | None = None


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
    manifold = Manifold(model)
    place = {name: k for k, name in enumerate(model.q_names)}
    rate_place = {name: k for k, name in enumerate(model.v_names)}
    q = manifold.neutral()
    for name, value in given.items():
        q[place[name]] = value
    v = np.zeros(model.nv)
    for name, value in rates.items():
        v[rate_place[name]] = value
    if not equations.constraint_rows:
        return Assembled(q, v, 0.0, 0.0, (), ())
    numbers = Numbers(equations, parameters)
    from robodyn_cli.solve.closing.nearest import close
    from robodyn_cli.solve.closing.open_loops import Closable

    task = Closable.of(numbers, q, given, hold)
    held = [k for k in range(model.nv) if k not in task.free]
    closure = close(numbers, q, task)
    q = closure.q
    independent, redundant = independent_rows(numbers, q, closure.rank_tolerance)
    v, remaining = _close_rates(numbers, closure, v, [rate_place[n] for n in rates], held)
    return Assembled(
        q, v, float(np.abs(numbers.eta(q)).max()), remaining, independent,
        tuple(numbers.rows[i].name for i in redundant), closure,
    )  # fmt: skip


def _close_rates(
    numbers: Numbers, closure: ClosedPose, v: Array, given: list[int], hold: list[int]
) -> tuple[Array, float]:
    """Return rates that satisfy Psi v + eta_t = 0, changing as few of the given ones as possible."""
    psi, eta_t = numbers.psi(closure.q), numbers.eta_t(closure.q)
    agrees = max(1e-10, closure.cut)
    scale = max(float(np.abs(psi).max()), 1e-300) * max(float(np.abs(v).max()), 1.0)
    nv = len(v)
    for fixed in (set(given) | set(hold), set(hold) if not given else set(given), set()):
        free = [k for k in range(nv) if k not in fixed]
        new = v.copy()
        residual = psi @ new + eta_t
        for _ in range(3):
            if not free:
                break
            step, *_ = np.linalg.lstsq(psi[:, free], -residual, rcond=closure.cut)
            new[free] += step
            residual = psi @ new + eta_t
        remaining = float(np.abs(residual).max())
        if remaining <= agrees * scale:
            return new, remaining
        if fixed and given and fixed == set(given):
            row = numbers.rows[int(np.abs(residual).argmax())]
            unit = "m/s" if row.kind in ("force", "m") else "rad/s"
            raise GeometryError(
                f"the initial rates contradict the constraints: {row.name} moves at {remaining:.6g} {unit}; "
                "give fewer of initial.qd",
                key="initial.qd", row=row.name, residual=remaining,
            )  # fmt: skip
    return new, remaining
