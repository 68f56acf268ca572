"""Derivatives of expressions by steps along the joints' manifolds, and by symbols, as matrices."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from robodyn_cli.algorithms.kinematics import slice_q
from robodyn_cli.equations.linear.protocol import Equations
from robodyn_cli.expr.calculus import SparseRow, gradients
from robodyn_cli.spatial.algebra import Matrix, Values, identity, zeros


def step_seeds(problem: Equations) -> dict[int, SparseRow]:
    """Return the gradients of the position symbols by steps dq (nv,) along the joints' manifolds, by node.

    A step changes q by the rate that the velocity dq gives: the identity for joints with q-dot = v, half a product of
    quaternions for rotations in space.
    """
    seeds: dict[int, SparseRow] = {}
    for body in problem.model.bodies:
        q = slice_q(body, problem.q)
        rates = [body.joint.velocity_map(q, unit) for unit in identity(body.joint.nv)]
        for k, symbol in enumerate(q):
            seeds[symbol.index] = {body.v + j: rate[k] for j, rate in enumerate(rates)}
    return seeds


def by_steps(problem: Equations, entries: Values) -> Matrix:
    """Return d entries / d q (n, nv) by steps along the joints' manifolds."""
    return dense(gradients(list(entries), step_seeds(problem)), problem.model.nv)


def by_symbols(entries: Values, symbols: Sequence[Any]) -> Matrix:
    """Return d entries / d symbols (n, nv)."""
    seeds: dict[int, SparseRow] = {symbol.index: {k: 1.0} for k, symbol in enumerate(symbols)}
    return dense(gradients(list(entries), seeds), len(symbols))


def dense(rows: Sequence[SparseRow], columns: int) -> Matrix:
    """Return sparse rows as a matrix."""
    out = zeros(len(rows), columns)
    for row, entries in zip(out, rows):
        for k, entry in entries.items():
            row[k] = entry
    return out
