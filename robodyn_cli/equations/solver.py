"""How the equations are solved for the accelerations."""

from __future__ import annotations

from robodyn_cli.decision import Decision
from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.graph import count_operations


def solver(problem: Problem) -> Decision:
    """Return the way that ``Problem.forward`` takes, and why."""
    what = "accelerations"
    if problem.has_multipliers:
        return Decision(what, "factored mass matrix", "the multipliers need the factor of M")
    ways = problem.ways_to_accelerations(problem.applied - problem.bias)
    counts = {name: count_operations(list(a)) for name, a in ways.items()}
    reason = "fewer operations"
    if len(counts) == 1:
        reason = f"{problem.model.nv} joints: the factored mass matrix grows with their cube"
    return Decision(what, min(counts, key=counts.__getitem__), reason, counts)
