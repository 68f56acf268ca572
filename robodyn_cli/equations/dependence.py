"""Constraint rows that depend on each other, and independent combinations of them.

In a planar loop modelled in space, or in Bennett's linkage, only r of m consistent rows are independent. Any r
independent combinations W eta with Jacobian W Psi, W (r, m) piecewise constant, give the same motion as all rows. The
entries of W are parameters p of the equations, chosen at a pose and again along the motion (see
``formulations.row_combinations``).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from robodyn_cli.algorithms.constraints import gram
from robodyn_cli.algorithms.linear import LdlFactor, minimum_degree
from robodyn_cli.equations.constraints import Constraints
from robodyn_cli.expr.graph import Graph, Scalar
from robodyn_cli.loops.base import Row
from robodyn_cli.model.model import PARAMETER_GROUP
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array, Matrix, Vector, dot, zeros

FLOOR = 1e-12  # closeness below which the rows themselves have lost rank


@record
class Dependence:
    """Names of rows of which only ``rank`` are independent."""

    rows: tuple[str, ...]
    rank: int

    @property
    def numbers(self) -> int:
        """Number of parameters: the entries of W, and the threshold at which W is chosen again."""
        return self.rank * len(self.rows) + 1


@record
class Combination:
    """Combinations of some rows.

    rows : their indices among all rows. W : (r, len(rows)). threshold : of ``closeness``. place : first of its
    parameters.
    """

    rows: tuple[int, ...]
    W: Matrix
    threshold: Scalar
    place: int


def combinations(
    graph: Graph, groups: Sequence[Dependence], names: Sequence[str], first: int
) -> list[Combination]:
    """Return the combinations of the rows called ``names``, their parameters numbered from ``first``."""
    found = []
    for group in groups:
        rows = tuple(names.index(name) for name in group.rows if name in names)
        if len(rows) <= group.rank:  # variants of the equations may lack rows
            first += group.numbers
            continue
        W = zeros(group.rank, len(rows))
        for i in range(group.rank):
            for k in range(len(rows)):
                place = first + i * len(group.rows) + k
                W[i, k] = graph.symbol(f"W[{place}]", PARAMETER_GROUP, place)
        last = first + group.numbers - 1
        found.append(Combination(rows, W, graph.symbol(f"W[{last}]", PARAMETER_GROUP, last), first))
        first += group.numbers
    return found


def combined(rows: Sequence[Row], W: Matrix, name: str) -> list[Row]:
    """Return the rows W eta, W Psi, W gamma, W eta_t."""
    found = []
    for i in range(W.shape[0]):
        psi = zeros(len(rows[0].psi))
        eta: Any = 0.0
        gamma: Any = 0.0
        eta_t: Any = 0.0
        for w, row in zip(W[i], rows):
            psi = psi + w * row.psi
            eta, gamma, eta_t = eta + w * row.eta, gamma + w * row.gamma, eta_t + w * row.eta_t
        found.append(Row(f"{name}.{i + 1}", eta, psi, gamma, eta_t))
    return found


def _uncombined(every: Constraints, found: Sequence[Combination]) -> list[int]:
    """Return the rows that depend on no others, prescribed ones last."""
    mixed = {i for c in found for i in c.rows}
    return [i for i in range(len(every.rows)) if i not in mixed]


def independent_rows(every: Constraints, found: Sequence[Combination]) -> Constraints:
    """Return rows with the rank of all: the combinations, then the rows that depend on no others."""
    rows: list[Row] = []
    for k, c in enumerate(found, start=1):
        rows += combined([every.rows[i] for i in c.rows], c.W, f"combination{k}")
    rows += [every.rows[i] for i in _uncombined(every, found)]
    first = len(rows) - len(every.prescribed)
    return Constraints(tuple(rows), every.dropped, tuple(range(first, len(rows))))


def multipliers_of_rows(every: Constraints, found: Sequence[Combination], lam: Vector) -> Vector:
    """Return the multipliers of all rows (m,) from those of ``independent_rows``: W^T lambda."""
    out = zeros(len(every.rows))
    place = 0
    for c in found:
        for k, i in enumerate(c.rows):
            for w, x in zip(c.W[:, k], lam[place:]):
                out[i] = out[i] + w * x
        place += c.W.shape[0]
    for i, x in zip(_uncombined(every, found), lam[place:]):
        out[i] = x
    return out


def closeness(psi: Matrix, whole: Matrix | None = None) -> Scalar:
    """Return how far the rows of Psi (m, nv) are from losing rank: 1 / (tr B tr A^-1) of A = Psi Psi^T, B = A.

    It lies between the squared ratio of smallest to largest singular value and m^2 times less.

    Parameters
    ----------
    whole : rows that Psi is part of, or is combined from; then B is the square of these, so that a single row is
    measured too.
    """
    A = gram(psi)
    entries = (psi if whole is None else whole).ravel()
    trace = dot(entries, entries)
    value: Scalar = 1.0 / (trace * LdlFactor.of(A, minimum_degree(A)).inverse_trace())
    return value


def threshold(square: float, sigma: Array, worn: float) -> float:
    """Return the closeness at which a choice is made anew: ``worn`` times that at the choice.

    Where the loops themselves have lost rank there, it is one that is soon met behind the pose.

    Parameters
    ----------
    square : tr B, of ``closeness``. sigma : singular values of Psi where the choice is made.
    """
    close = float(1.0 / (square * (1.0 / np.maximum(sigma, 1e-150) ** 2).sum()))
    return worn * close if close > FLOOR else 2.0 * FLOOR
