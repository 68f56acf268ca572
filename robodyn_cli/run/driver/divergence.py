"""Which joint and which of its quantities a run broke down in."""

from __future__ import annotations

from typing import Any

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.integrators.runtime.integrator import Integrator

# kinds of failure that lie in the motion rather than in what the run may take
BREAKDOWNS = ("step_too_small", "not_finite", "not_solved")


def breakdown(problem: Problem, integrator: Integrator, status: str) -> tuple[str, dict[str, Any]]:
    """Return words for the message of a failed run, and ``joint`` and ``quantity`` for its details.

    Named is the first quantity that is not finite: position, rate, acceleration; where all are, the joint of the
    largest acceleration, over its rate where that is large too.
    """
    if status not in BREAKDOWNS:
        return "", {}
    model = problem.model
    system = integrator.system
    q, v, _ = system.split(integrator.y)
    with np.errstate(all="ignore"):
        rates = np.concatenate([np.zeros(system.nq), np.asarray(integrator._rates(), dtype=float)])
        a = system.split(rates)[1]
    for quantity, values, names in (
        ("position", q, model.q_names), ("rate", v, model.v_names), ("acceleration", a, model.v_names),
    ):  # fmt: skip
        bad = np.flatnonzero(~np.isfinite(values))
        if len(bad):
            joint = str(names[int(bad[0])])
            return f"; joint {joint!r} has no finite {quantity} there", {"joint": joint, "quantity": quantity}
    worst = int(np.argmax(np.abs(a) / (1.0 + np.abs(v))))
    joint = str(model.v_names[worst])
    units = f"{model.v_units[worst]}/s^2"
    words = f"; the largest acceleration there, {abs(a[worst]):.3g} {units}, is that of joint {joint!r}"
    return words, {"joint": joint, "quantity": "acceleration"}
