"""The exact Jacobian of a system, and the factored matrices g E - J that implicit methods solve with.

The state is x = (q, v, z). Positions come first, so elimination without pivoting takes their rows, which are sparse,
before those of the rates: where q-dot = v this is the usual elimination B = g E - df/dv - (df/dq) / g.

For a small system, entries and elimination are expressions, in which nothing is left that is zero. For a large one
they would be a hundred thousand operations. There the rates are differentiated along a direction, ``tangents``; the
compiled code takes one column of J after another from it, several at once, and eliminates in loops
(``integrators/stepping/factors.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from numpy.typing import NDArray

from robodyn_cli.algorithms.linear import Complex, LuFactor
from robodyn_cli.expr.calculus import directional, jacobian
from robodyn_cli.expr.graph import Expr, Graph, Scalar, free_symbols
from robodyn_cli.kernels.program import Program, make_program
from robodyn_cli.model.model import STATE_GROUPS
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import zeros

LARGE = 20_000  # states times operations of the rates: with more, J is taken in columns
DIRECTION = "dx"  # group of inputs of ``tangents``


@record
class Jacobian:
    """J = df/dx (n, n) and df/dt (n,) of x-dot = f(t, x), as numbers and expressions of ``graph``."""

    J: NDArray[Any]
    t: NDArray[Any]
    graph: Graph


def differentiate(f: Sequence[Scalar], nq: int, nv: int) -> Jacobian:
    """Return the exact Jacobian of the whole state.

    f : v-dot (nv,), then z-dot, as expressions; q-dot = v.
    """
    size = nq + len(f)
    symbols = {e.value[1:]: e for e in free_symbols(f)}
    first = {"q": 0, "v": nq, "z": nq + nv}
    columns = [(first[group] + k, e) for (group, k), e in symbols.items() if group in first]
    if ("t", 0) in symbols:
        columns.append((size, symbols["t", 0]))
    wide = zeros(size, size + 1)
    for k in range(nq):
        wide[k, nq + k] = 1.0
    for i, row in enumerate(jacobian(f, [e for _, e in columns])):
        for k, entry in row.items():
            wide[nq + i, columns[k][0]] = entry
    graph = next((e.graph for e in f if isinstance(e, Expr)), Graph())
    return Jacobian(wide[:, :size], wide[:, size], graph)


def tangents(f: Sequence[Scalar], nq: int, nv: int) -> Program:
    """Return output ``d`` (nv + nz,): the change of v-dot and z-dot along a direction in x and t.

    f : as of ``differentiate``. Input group ``dx`` (n + 1,): the direction, t last.
    """
    size = nq + len(f)
    first = {"q": 0, "v": nq, "z": nq + nv, "t": size}
    states = [e for e in free_symbols(f) if e.value[1] in first]
    direction = []
    for e in states:
        _, group, k = e.value
        place = first[group] + k
        direction.append(e.graph.symbol(f"d{place}", DIRECTION, place))
    return make_program({"d": directional(f, states, direction)}, (*STATE_GROUPS, DIRECTION))


def real_factors(matrix: Jacobian) -> Program:
    """Return outputs ``lu`` (n n): g E - J factored, row by row, and ``ft`` = df/dt (n,); input group ``g`` (1,)."""
    g = matrix.graph.symbol("g", "g")
    B = -matrix.J
    for i in range(len(B)):
        B[i, i] = B[i, i] + g
    return make_program(
        {"lu": list(LuFactor.of(B).entries.ravel()), "ft": list(matrix.t)}, (*STATE_GROUPS, "g")
    )


def complex_factors(matrix: Jacobian) -> Program:
    """Return outputs ``re``, ``im`` (n n): g E - J factored for a complex g; input group ``g`` = (re, im)."""
    g = Complex(matrix.graph.symbol("g.re", "g", 0), matrix.graph.symbol("g.im", "g", 1))
    size = len(matrix.J)
    B = zeros(size, size)
    for i in range(size):
        for k in range(size):
            B[i, k] = Complex(-matrix.J[i, k]) + g if i == k else Complex(-matrix.J[i, k])
    lu = LuFactor.of(B).entries.ravel()
    return make_program({"re": [e.re for e in lu], "im": [e.im for e in lu]}, (*STATE_GROUPS, "g"))
