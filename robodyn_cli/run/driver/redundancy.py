"""Constraints that say things twice: which rows depend on each other, and whether they do so all along the motion."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.equations.dependence import Dependence
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import GeometryError
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.solve.assembly import RANK_TOLERANCE, Assembled, mechanism_size

if TYPE_CHECKING:
    from robodyn_cli.run.observation.recorder import Recorder

Array = NDArray[np.float64]
OPEN = 1e-6  # rad, or part of the size of the mechanism, from which on a constraint is violated


def dependent_rows(problem: Problem, assembled: Assembled) -> tuple[Dependence, ...]:
    """Return the rows that depend on each other at the start, loop by loop where they do so within loops.

    Empty where rows of loops depend on prescribed motions too: those cannot be combined.
    """
    constraints = problem.constraints
    loops = [i for i in range(len(constraints.rows)) if i not in constraints.prescribed]
    values = {"q": assembled.q.tolist(), "t": [0.0], "p": []}
    psi = np.array(evaluate(list(problem.psi.ravel()), values), dtype=float).reshape(problem.psi.shape)
    whole = _rank(psi[loops])
    if whole + len(constraints.prescribed) != len(assembled.independent):
        return ()
    names = constraints.names
    groups: dict[str, list[int]] = {}
    for i in loops:
        groups.setdefault(names[i].rsplit(".", 1)[0], []).append(i)
    ranks = {loop: _rank(psi[rows]) for loop, rows in groups.items()}
    if sum(ranks.values()) != whole:
        return (Dependence(tuple(names[i] for i in loops), whole),)
    return tuple(
        Dependence(tuple(names[i] for i in rows), ranks[loop])
        for loop, rows in groups.items()
        if ranks[loop] < len(rows)
    )


def _rank(psi: Array) -> int:
    sigma = np.linalg.svd(psi, compute_uv=False)
    return int((sigma > RANK_TOLERANCE * sigma[0]).sum())


def describe_dependence(problem: Problem, renewals: int) -> dict[str, Any]:
    """Return what the summary says about the multipliers: unique, or of least norm and why."""
    if not problem.dependent:
        return {"unique": True}
    return {
        "unique": False,
        "choice": "least norm",
        "dependent": [
            {"loops": sorted({n.rsplit(".", 1)[0] for n in g.rows}), "rows": list(g.rows), "rank": g.rank}
            for g in problem.dependent
        ],
        "renewals": renewals,
    }


def check_redundant(
    problem: Problem, assembled: Assembled, recorder: Recorder, summary: dict[str, Any]
) -> GeometryError | None:
    """Report the largest residual of the rows that were left out; an error if they are violated."""
    if not assembled.redundant or not recorder.samples:
        return None
    whole = Problem(problem.scene, model=problem.model)
    # combined rows are solved together, so each may be the one that opens
    named = problem.constraints.names if problem.dependent else assembled.redundant
    rows = [row for row in whole.constraint_rows if row.name in named]
    q, t = recorder.array("q"), recorder.array("time")
    values = evaluate([row.eta for row in rows], {"q": list(q.T), "t": [t], "p": []})
    residual = np.abs(np.column_stack([np.broadcast_to(value, t.shape) for value in values]))
    summary["constraint_residual"]["redundant"] = float(residual.max())
    size = mechanism_size(problem.model)
    limits = np.array([OPEN * (size if row.kind in ("force", "m") else 1.0) for row in rows])
    broken = np.argwhere(residual > limits)
    if not len(broken):
        return None
    k, i = (int(x) for x in broken[0])
    row = rows[i]
    unit = "m" if row.kind in ("force", "m") else "rad"
    return GeometryError(
        f"the scene asks for more than the mechanism can do: {row.name}, which followed from the other constraints at "
        f"the start, is violated from t = {t[k]:.6g} s on, by up to {residual[:, i].max():.3g} {unit}",
        time=float(t[k]), row=row.name, residual=float(residual[:, i].max()),
    )  # fmt: skip
