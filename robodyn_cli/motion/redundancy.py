"""Redundant constraint rows, left out since they follow from others at the start: do they hold along the motion?"""

from __future__ import annotations

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import GeometryError
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.observe.recorder import Recorder
from robodyn_cli.record import record
from robodyn_cli.solve.assembly import Assembled
from robodyn_cli.solve.closure import mechanism_size

OPEN = 1e-6  # rad, or part of the size of the mechanism, from which on a constraint is violated


@record
class Redundant:
    """Largest residual of the redundant rows, and the error where they are violated."""

    residual: float
    violated: GeometryError | None = None


def check_redundant(problem: Problem, assembled: Assembled, recorder: Recorder) -> Redundant:
    """Evaluate the residuals of the redundant rows along the samples."""
    whole = Problem(problem.scene, model=problem.model)
    # combined rows are solved together, so each may be the one that opens
    named = problem.constraints.names if problem.dependent else assembled.redundant
    rows = [row for row in whole.constraints.rows if row.name in named]
    q, t = recorder.array("q"), recorder.array("time")
    values = evaluate([row.eta for row in rows], {"q": list(q.T), "t": [t], "p": []})
    residual = np.abs(np.column_stack([np.broadcast_to(value, t.shape) for value in values]))
    size = mechanism_size(problem.model)
    limits = np.array([OPEN * (size if row.kind in ("force", "m") else 1.0) for row in rows])
    broken = np.argwhere(residual > limits)
    largest = float(residual.max())
    if not len(broken):
        return Redundant(largest)
    k, i = (int(x) for x in broken[0])
    row = rows[i]
    unit = "m" if row.kind in ("force", "m") else "rad"
    error = GeometryError(
        f"the scene asks for more than the mechanism can do: {row.name}, which followed from the other constraints at "
        f"the start, is violated from t = {t[k]:.6g} s on, by up to {residual[:, i].max():.3g} {unit}",
        time=float(t[k]), row=row.name, residual=float(residual[:, i].max()),
    )  # fmt: skip
    return Redundant(largest, error)
