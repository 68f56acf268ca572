"""What is doubtful about the configuration in which a simulation starts."""

from __future__ import annotations

from collections.abc import Sequence

from robodyn_cli.equations.problem import Problem
from robodyn_cli.ready.singularity import is_dead_point
from robodyn_cli.spatial.algebra import Array

NEAR = 1e-6  # distance from a dead point that counts as none (see ``is_dead_point``)


def start_warnings(problem: Problem, q: Array, passive: Sequence[int]) -> list[str]:
    """Return warnings about the closed configuration ``q`` (nq,) at t = 0.

    A dead point of the input, where the block of Psi of the ``passive`` coordinates is singular, is no obstacle to a
    simulation. But the loops may have closed there because ``initial.q`` left them the choice, and then the input moves
    nothing: the passive joints alone can move, the driven ones at rest.
    """
    if len(passive) == problem.model.nv or not is_dead_point(problem, q, passive, NEAR):
        return []
    pose = ", ".join(f"{name} {x:.6g}" for name, x in zip(problem.model.q_names, q))
    remedy = (
        ""
        if problem.scene.initial.hold
        else "; if it is not meant, keep joints at their value with initial.hold"
    )
    return [
        f"the loops have closed in a dead point of the input ({pose}): there the driven joints cannot "
        f"move the mechanism, and small errors decide where it goes{remedy}"
    ]
