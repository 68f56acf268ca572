"""Constraints that were left out as redundant at the start: they must hold all along the motion."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import GeometryError
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.run.observe import Recorder
from robodyn_cli.solve.assembly import Assembled, mechanism_size

Array = NDArray[np.float64]
OPEN = 1e-6  # rad, or part of the size of the mechanism, from which on a constraint is violated


def check_redundant(
    problem: Problem, assembled: Assembled, recorder: Recorder, summary: dict[str, Any]
) -> GeometryError | None:
    """Report the largest residual of the rows that were left out; an error if they are violated."""
    if not assembled.redundant or not recorder.samples:
        return None
    whole = Problem(problem.scene, model=problem.model)
    rows = [row for row in whole.constraint_rows if row.name in assembled.redundant]
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
