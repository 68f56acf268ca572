"""Mobility of a mechanism: by counting, and by rank."""

from __future__ import annotations

from robodyn_cli.equations.problem import Problem
from robodyn_cli.solve.closure import rank
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.mechanism import Mobility


def mobility(problem: Problem, psi: Array) -> Mobility:
    """Return degrees of freedom by Gruebler's count and by the rank of the loops' Psi (m, nv), or (T, m, nv).

    count : velocity coordinates of the tree less all rows of the closures, as Gruebler and Kutzbach count links
    and joints in space (6 (n - 1) - sum of the joints' constraints). planar_count : less only the rows that do not
    vanish identically, which for a mechanism in a plane is 3 (n - 1) - 2 j. actual : less the rank.
    """
    nv, rows = problem.model.nv, len(problem.constraints.of_loops)
    vanishing = len(problem.constraints.dropped)
    independent = rank(psi)
    return Mobility(
        coordinates=nv,
        rows=rows + vanishing,
        vanishing_rows=vanishing,
        rank=independent,
        redundant_rows=rows - independent,
        count=nv - rows - vanishing,
        planar_count=nv - rows,
        actual=nv - independent,
    )
