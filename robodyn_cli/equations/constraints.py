"""All constraint rows of a scene together, and those that relate joint coordinates.

Constraint rows that depend on each other, and independent combinations of them.

In a planar loop modelled in space, or in Bennett's linkage, only r of m consistent rows are independent. Any r
independent combinations W eta with Jacobian W Psi, W (r, m) piecewise constant, give the same motion as all rows. The
entries of W are parameters p of the equations, chosen at a pose and again along the motion (see
``formulations.row_combinations``).

Inertias along constraint rows (braces), where the opened tree's M has no inverse, or a bad one, and the closed
mechanism is determined all the same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from robodyn_cli.algorithms.constraints import coordinate_row, gram
from robodyn_cli.algorithms.linear import LdlFactor, minimum_degree
from robodyn_cli.expr.graph import Graph, Scalar, free_symbols, is_nonzero
from robodyn_cli.loops.base import Row
from robodyn_cli.model.model import PARAMETER_GROUP, Model
from robodyn_cli.record import record
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array, Matrix, Values, Vector, dot, zeros


@record
class Constraints:
    """Rows eta = 0, Psi v + eta_t = 0, Psi v-dot + gamma = 0; ``dropped`` rows vanish identically.

    ``prescribed`` rows drive a joint; the others close loops.
    """

    rows: tuple[Row, ...]
    dropped: tuple[str, ...]
    prescribed: tuple[int, ...]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(r.name for r in self.rows)

    @property
    def eta(self) -> list[Scalar]:
        return [r.eta for r in self.rows]

    @property
    def eta_t(self) -> list[Scalar]:
        return [r.eta_t for r in self.rows]

    @property
    def gamma(self) -> list[Scalar]:
        return [r.gamma for r in self.rows]

    @property
    def of_loops(self) -> list[int]:
        """Indices of the rows that close loops or couple joints: all but the prescribed ones."""
        return [i for i in range(len(self.rows)) if i not in self.prescribed]

    @property
    def loop_rows(self) -> tuple[Row, ...]:
        """The rows that close loops or couple joints."""
        return tuple(self.rows[i] for i in self.of_loops)

    @cached_property
    def rheonomic(self) -> tuple[int, ...]:
        """Rows that depend on time itself."""
        # asked of all at once first: large mechanisms have hundreds, each of a long expression
        if not any(symbol.value[1] == "t" for symbol in free_symbols(row.eta for row in self.rows)):
            return self.prescribed
        return tuple(
            i
            for i, row in enumerate(self.rows)
            if i in self.prescribed or any(s.value[1] == "t" for s in free_symbols([row.eta]))
        )

    def velocity_residual(self, v: Values) -> list[Scalar]:
        """Return Psi v + eta_t."""
        out = []
        for row in self.rows:
            total: Scalar = row.eta_t
            for k, x in row.entries.items():
                total = total + x * v[k]
            out.append(total)
        return out

    def psi(self, nv: int) -> Matrix:
        """Return Psi (m, nv)."""
        out = zeros(len(self.rows), nv)
        for i, row in enumerate(self.rows):
            out[i] = row.psi
        return out

    def only(self, keep: Sequence[int]) -> Constraints:
        """Return the constraints with a subset of the rows."""
        place = {old: new for new, old in enumerate(keep)}
        return Constraints(
            tuple(self.rows[i] for i in keep),
            self.dropped,
            tuple(place[i] for i in self.prescribed if i in place),
        )


class MechanismParts(Protocol):
    """What rows of constraints and of latches are made of (satisfied by ``Problem``)."""

    scene: Scene
    model: Model
    q: Any
    v: Any
    dependent: Any
    latches: Any
    is_variant: bool

    @property
    def X(self) -> Any: ...
    @property
    def gravity(self) -> Any: ...
    @property
    def environment(self) -> dict[str, Any]: ...
    @property
    def mass_matrix(self) -> Matrix: ...
    @property
    def contact_joints(self) -> Any: ...


def constraints_of(problem: MechanismParts) -> Constraints:
    """Return the rows of the loop closures of a mechanism, then of couplers, then of prescribed joints."""
    rows: list[Row] = []
    dropped: list[str] = []
    if problem.model.loops:
        from robodyn_cli.algorithms.constraints import LoopRows, vanishes

        closures = LoopRows(problem.model, problem.X, problem.q, problem.v, problem.gravity)
        for row in (row for loop in problem.model.loops for row in closures.of(loop)):
            if vanishes(row):
                dropped.append(row.name)
            else:
                rows.append(row)
    env = problem.environment
    for coupler in problem.scene.couplers:
        value = 0.0 if coupler.value is None else coupler.value.evaluate(env)
        units = {problem.model.q_units[problem.model.q_names.index(name)] for name in coupler.terms}
        kind = "moment" if units == {"rad"} else "force"
        name = f"{coupler.name}.coupling"
        rows.append(coordinate_row(name, problem.model, problem.q, coupler.terms, value, kind))
    first = len(rows)
    if problem.scene.prescribed:
        from robodyn_cli.equations.prescribed import prescribed_rows

        rows += prescribed_rows(problem.model, problem.q, problem.v, problem.scene.prescribed, env)
    return Constraints(tuple(rows), tuple(dropped), tuple(range(first, len(rows))))


Braces = Mapping[str, float]  # b_i by the name of a row


def with_inertia(M: Matrix, braces: Braces, constraints: Constraints) -> Matrix:
    """Return M + Psi^T b Psi (nv, nv).

    The rows give Psi v-dot = -gamma, so an inertia b_i along a row, of any size, changes nothing but the force in the
    row, and what ``with_force`` adds to h takes that off again: accelerations and multipliers are the mechanism's.
    """
    M = M.copy()
    for b, row in _braced(braces, constraints):
        for i, x in row.entries.items():
            for j, y in row.entries.items():
                M[i, j] = M[i, j] + b * (x * y)
    return M


def with_force(h: Vector, braces: Braces, constraints: Constraints) -> Vector:
    """Return h + Psi^T b gamma (nv,)."""
    h = h.copy()
    for b, row in _braced(braces, constraints):
        for k, x in row.entries.items():
            h[k] = h[k] + b * (x * row.gamma)
    return h


def _braced(braces: Braces, constraints: Constraints) -> list[tuple[float, Row]]:
    return [(braces[row.name], row) for row in constraints.rows if row.name in braces]


def inertias_along(M: Matrix, psi: Matrix) -> list[Any]:
    """Return inertias b (m,) of the size of those that the rows Psi (m, nv) move.

    b_i is the mean of M_kk / Psi_ik^2 with weights Psi_ik^4, and that of the other rows where a row moves nothing with
    inertia. Of the digits of accelerations those are lost by which b is larger or smaller than what moves.
    """
    inertias: list[Any] = []
    for row in psi:
        square = [x * x for x in row]
        moved, length = dot(np.diag(M), square), sum(square)
        inertias.append(moved / (length * length) if is_nonzero(moved) and is_nonzero(length) else 0.0)
    heavy = [b for b in inertias if is_nonzero(b)]
    other = sum(heavy) / len(heavy) if heavy else 1.0
    return [b if is_nonzero(b) else other for b in inertias]


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
    mixes = []
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
        mixes.append(Combination(rows, W, graph.symbol(f"W[{last}]", PARAMETER_GROUP, last), first))
        first += group.numbers
    return mixes


def combined(rows: Sequence[Row], W: Matrix, name: str) -> list[Row]:
    """Return the rows W eta, W Psi, W gamma, W eta_t."""
    mixed = []
    for i in range(W.shape[0]):
        psi = zeros(len(rows[0].psi))
        eta: Any = 0.0
        gamma: Any = 0.0
        eta_t: Any = 0.0
        for w, row in zip(W[i], rows):
            psi = psi + w * row.psi
            eta, gamma, eta_t = eta + w * row.eta, gamma + w * row.gamma, eta_t + w * row.eta_t
        mixed.append(Row(f"{name}.{i + 1}", eta, psi, gamma, eta_t))
    return mixed


def _uncombined(every: Constraints, mixes: Sequence[Combination]) -> list[int]:
    """Return the rows that depend on no others, prescribed ones last."""
    mixed = {i for c in mixes for i in c.rows}
    return [i for i in range(len(every.rows)) if i not in mixed]


def independent_rows(every: Constraints, mixes: Sequence[Combination]) -> Constraints:
    """Return rows with the rank of all: the combinations, then the rows that depend on no others."""
    rows: list[Row] = []
    for k, c in enumerate(mixes, start=1):
        rows += combined([every.rows[i] for i in c.rows], c.W, f"combination{k}")
    rows += [every.rows[i] for i in _uncombined(every, mixes)]
    first = len(rows) - len(every.prescribed)
    return Constraints(tuple(rows), every.dropped, tuple(range(first, len(rows))))


def multipliers_of_rows(every: Constraints, mixes: Sequence[Combination], lam: Vector) -> Vector:
    """Return the multipliers of all rows (m,) from those of ``independent_rows``: W^T lambda."""
    out = zeros(len(every.rows))
    place = 0
    for c in mixes:
        for k, i in enumerate(c.rows):
            for w, x in zip(c.W[:, k], lam[place:]):
                out[i] = out[i] + w * x
        place += c.W.shape[0]
    for i, x in zip(_uncombined(every, mixes), lam[place:]):
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
