"""Tell singular configurations apart: dead point of the input, bifurcation, neither.

Dead point: Psi keeps its rank, its block of passive coordinates loses it; the input cannot move the mechanism.
Bifurcation: Psi itself loses rank; the constraints no longer decide how the motion goes on.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.algorithms.constraints import determinant
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError, SingularConfigurationError
from robodyn_cli.expr.calculus import directional
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.formulations.system import EventFunction
from robodyn_cli.integrators.integrator import Event

Array = NDArray[np.float64]
RANK = 1e-6  # ratio of singular values below which a located pose counts as having lost rank
LARGEST = 8  # rows up to which the determinant of Psi Psi^T is followed along the motion


@dataclasses.dataclass(frozen=True)
class Singularity:
    """What kind of configuration it is, and the singular values that say so (largest first)."""

    kind: str
    psi: Array
    passive: Array


def loop_rows(problem: Problem) -> list[int]:
    """Return the indices of rows that close loops (not those that prescribe a joint)."""
    constraints = problem.constraints
    return [i for i in range(len(constraints.rows)) if i not in constraints.prescribed]


def passive_determinant(problem: Problem, passive: Sequence[int]) -> Scalar:
    """Return the determinant of the passive block of Psi, whose sign change is a dead point.

    Raises
    ------
    CapabilityError : the block is not square, so the input does not determine the configuration.
    """
    rows = loop_rows(problem)
    if len(passive) != len(rows):
        freedom = problem.model.nv - len(rows)
        raise CapabilityError(
            f"a dead point needs as many driven joints as degrees of freedom: the mechanism has {freedom}, and "
            f"{problem.model.nv - len(passive)} joints are actuated or prescribed; set `actuated`, or use "
            "deploy.criterion: multipliers"
        )
    value: Scalar = determinant(problem.psi[rows][:, list(passive)])
    return value


def rank_loss_event(problem: Problem) -> tuple[EventFunction, ...]:
    """Return the event of a minimum of det(Psi Psi^T) along the motion, where a loss of rank must lie."""
    rows = loop_rows(problem)
    if not rows or len(rows) > LARGEST:
        return ()
    psi = problem.psi[rows]
    gram: Scalar = determinant(psi @ psi.T)
    rate = directional([gram], problem.q, problem.v)[0]
    return (EventFunction("rank", rate, direction=+1, terminal=False),)


def psi_at(problem: Problem, q: Array, t: float = 0.0) -> Array:
    """Return Psi of the loops at a configuration, as numbers."""
    rows = loop_rows(problem)
    flat = evaluate(list(problem.psi[rows].ravel()), {"q": q.tolist(), "t": [t], "p": []})
    return np.array(flat, dtype=float).reshape(len(rows), problem.model.nv)


def classify(problem: Problem, q: Array, passive: Sequence[int]) -> Singularity:
    """Return the kind of configuration: ``bifurcation``, ``dead_point`` or ``regular``."""
    psi = psi_at(problem, q)
    whole = np.linalg.svd(psi, compute_uv=False)
    block = np.linalg.svd(psi[:, list(passive)], compute_uv=False) if len(passive) else np.zeros(0)
    if whole[-1] < RANK * whole[0]:
        return Singularity("bifurcation", whole, block)
    if len(block) and block[-1] < RANK * whole[0]:
        return Singularity("dead_point", whole, block)
    return Singularity("regular", whole, block)


def stop_at_rank_loss(problem: Problem, event: Event) -> None:
    """Raise if the minimum that was met is a loss of rank; an ordinary minimum passes.

    Raises
    ------
    SingularConfigurationError : Psi has lost rank.
    """
    q = event.state[: problem.model.nq]
    found = classify(problem, q, ())
    if found.kind != "bifurcation":
        return
    loops = ", ".join(loop.name for loop in problem.model.loops)
    raise SingularConfigurationError(
        f"bifurcation at t = {event.time:.9g} s: the constraint Jacobian of loop {loops} loses rank, so the "
        "multipliers are not unique and the motion may branch; set simulate.singular: pass to go on",
        time=event.time, kind="bifurcation", singular_values=found.psi.tolist(), q=q.tolist(),
    )  # fmt: skip
