"""Index 3: the equations of motion as they stand, for methods that solve for positions and multipliers at once.

    r = M(q) a + h(q, v) - tau(t, q, v) - Psi^T lambda = 0,   eta(q, t) = 0

A method with Newmark's relations has q, v and z at the end of a step as linear functions of the accelerations there,
dq = g_q da, dv = g_v da, so that Newton's step solves

    [ M + g_v dr/dv + g_q dr/dq   -Psi^T ] [ da      ]     [ r         ]
    [ Psi                          0     ] [ dlambda ] = - [ eta / g_q ]

eta is divided by g_q, which is of the size of h^2, and the unknowns are accelerations, not positions: that is the
scaling of Bottasso, Dopico and Trainelli (2008), with which the condition of the matrix does not grow as h falls.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

from robodyn_cli.algorithms.linear import LuFactor
from robodyn_cli.equations.latches import moving, without_held
from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.calculus import jacobian
from robodyn_cli.expr.graph import Expr, Graph, Scalar, free_symbols
from robodyn_cli.kernels.program import Program, make_program
from robodyn_cli.model.model import STATE_GROUPS
from robodyn_cli.spatial.algebra import Matrix, identity, zeros

INPUTS = (*STATE_GROUPS, "a", "l", "g")
Column = tuple[Expr, int, Scalar]  # a state, the unknown it moves with, and how far


class Index3:
    """The equations of one mechanism at index 3.

    rows : how many multipliers there are. program : one step of Newton's iteration, see ``newton_step``.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem

    @property
    def rows(self) -> int:
        return len(self.problem.independent_rows.rows)

    @property
    def obstacle(self) -> str:
        """What of a mechanism index 3 does not take, "" where there is nothing."""
        if any(latch.rigid and latch.v is None for latch in self.problem.latches):
            return "a rigid latch holds the links of a closure, of whose turn no position is known"
        if (
            self.problem.sprung
        ):  # with steps as short as it takes to come there, rounding of eta / g_q is large
            return "a latch of a closed mechanism has a spring, whose contacts are met by steps too short for index 3"
        return ""

    @cached_property
    def program(self) -> Program:
        p, constraints = self.problem, self.problem.independent_rows
        psi = constraints.psi(p.model.nv)
        multipliers = p.graph.symbols([f"lambda{k}" for k in range(self.rows)], "l")
        mass, torques, psi = without_held(p, p.inverse_dynamics - p.applied, psi)
        r = list(torques)
        for k, moves in moving(p).items():
            r[k] = r[k] + (1.0 - moves) * (p.mass_matrix[k, k] * p.a[k])
        for row, multiplier in zip(psi, multipliers):
            r = [total - x * multiplier for total, x in zip(r, row)]
        g = weights(p.graph)
        columns: list[Column] = [(x, k, g[0]) for k, x in enumerate(p.q)]
        columns += [(x, k, g[1]) for k, x in enumerate(p.v)]
        return newton_step(r, mass, columns, psi, [e / g[0] for e in constraints.eta], p.elimination_order)


def first_order_step(f: Sequence[Scalar], nv: int) -> Program:
    """Return a step of Newton's iteration without constraints; see ``newton_step``.

    f : v-dot (nv,), then z-dot, as expressions.
    """
    graph = next((e.graph for e in f if isinstance(e, Expr)), Graph())
    rates = graph.symbols([f"rate{k}" for k in range(len(f))], "a")
    g = dict(zip("qvz", weights(graph)))
    first = {"q": 0, "v": 0, "z": nv}
    columns: list[Column] = []
    for e in free_symbols(f):
        _, group, place = e.value
        if group in first:
            columns.append((e, first[group] + place, g[group]))
    r = [rate - x for rate, x in zip(rates, f)]
    return newton_step(r, identity(len(f)), columns, zeros(0, len(f)), [], range(len(f)))


def weights(graph: Graph) -> list[Expr]:
    """Return g_q, g_v and g_z: the changes of q, v and z for a unit of acceleration (or of z-dot)."""
    return graph.symbols(("g.q", "g.v", "g.z"), "g")


def newton_step(
    r: Sequence[Scalar],
    mass: Matrix,
    columns: Sequence[Column],
    psi: Matrix,
    eta: Sequence[Scalar],
    order: Sequence[int],
) -> Program:
    """Return outputs ``a`` (n,) and ``l`` (m,): the changes of the accelerations and multipliers.

    The Jacobian is exact. It is eliminated without pivoting, the accelerations first, in ``order``: in steps that
    resolve the motion their block is close to the mass matrix, which is positive definite.

    Parameters
    ----------
    r : residual (n,). mass : dr/da where the states stay. eta : constraints (m,), scaled.

    Inputs of the program are t, q, v, z, p at the end of the step, ``a``, ``l``, and ``g``, see ``weights``.
    """
    n, m = len(r), len(eta)
    S = mass.copy()
    for i, row in enumerate(jacobian(r, [x for x, _, _ in columns])):
        for k, entry in row.items():
            _, place, weight = columns[k]
            S[i, place] = S[i, place] + weight * entry
    A, b = zeros(n + m, n + m), zeros(n + m)
    for i, here in enumerate(order):
        b[i] = -r[here]
        for j, there in enumerate(order):
            A[i, j] = S[here, there]
        for k in range(m):
            # the multipliers change by the negative of what this solves for, so that the borders are alike
            A[i, n + k] = A[n + k, i] = psi[k, here]
    for k in range(m):
        b[n + k] = -eta[k]
    x = LuFactor.of(A).solve(b)
    changes = zeros(n)
    for i, here in enumerate(order):
        changes[here] = x[i]
    return make_program({"a": list(changes), "l": [-value for value in x[n:]]}, INPUTS)
