"""Small dense linear algebra on numbers or expressions, without pivoting.

Complex numbers whose parts are numbers or expressions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from heapq import heapify, heappop, heappush
from typing import Any

from robodyn_cli.expr.graph import is_nonzero, nonzero_entries
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Matrix, Values, Vector, zeros

SMALLEST_ORDERED = 8  # with at least so many rows, an order of elimination pays


def minimum_degree(A: Matrix) -> tuple[int, ...]:
    """Return an order of elimination that keeps the factor of a symmetric matrix sparse.

    Always the row with the fewest neighbours left, the first of several (Tinney and Walker 1967); eliminating it
    joins its neighbours. A small matrix keeps its own order.
    """
    n = A.shape[0]
    if n < SMALLEST_ORDERED:
        return tuple(range(n))
    near = [{k for k in nonzero_entries(row) if k != i} for i, row in enumerate(A)]
    waiting = [(len(neighbours), i) for i, neighbours in enumerate(near)]
    heapify(waiting)
    order: dict[int, None] = {}
    while waiting:
        degree, i = heappop(waiting)
        if i in order or degree != len(near[i]):  # it has come in again since, with other neighbours
            continue
        order[i] = None
        for j in near[i]:
            near[j] = (near[j] | near[i]) - {i, j}
            heappush(waiting, (len(near[j]), j))
    return tuple(order)


@record
class LdlFactor:
    """Symmetric positive definite A = P^T L D L^T P; zeros of A that stay zero cost nothing.

    rows, columns : unit lower triangle below the diagonal, {k: L[i, k]} of each row i and {i: L[i, k]} of each
    column k. inverse : inverses of the pivots D. order : the permutation; position k of the factor is row order[k]
    of A.
    """

    rows: tuple[dict[int, Any], ...]
    columns: tuple[dict[int, Any], ...]
    inverse: tuple[Any, ...]
    order: tuple[int, ...]

    @staticmethod
    def of(A: Matrix, order: Sequence[int] | None = None) -> LdlFactor:
        """Factor A. Eliminating the leaves of a tree first keeps the branches apart."""
        n = A.shape[0]
        order = tuple(range(n)) if order is None else tuple(order)
        L: list[dict[int, Any]] = [{} for _ in range(n)]
        LD: list[dict[int, Any]] = [{} for _ in range(n)]  # L times D, known before the division
        columns: list[dict[int, Any]] = [{} for _ in range(n)]
        inverse: list[Any] = []
        place = {row: i for i, row in enumerate(order)}
        for j in range(n):
            pivot = A[order[j], order[j]]
            for k, x in L[j].items():
                pivot = pivot - x * LD[j][k]
            inverse.append(1.0 / pivot)
            below = {i for k in L[j] for i in columns[k] if i > j}
            below.update(place[k] for k in nonzero_entries(A[:, order[j]]) if place[k] > j)
            for i in sorted(below):
                entry = A[order[i], order[j]]
                for k, x in L[i].items():
                    if k in LD[j]:
                        entry = entry - x * LD[j][k]
                if is_nonzero(entry):
                    LD[i][j] = entry
                    L[i][j] = columns[j][i] = entry * inverse[j]
        return LdlFactor(tuple(L), tuple(columns), tuple(inverse), order)

    @property
    def entries(self) -> list[Any]:
        """The entries of the factor as one list: L row by row, then the inverse pivots."""
        return [*(x for row in self.rows for x in row.values()), *self.inverse]

    def replaced(self, entries: Sequence[Any]) -> LdlFactor:
        """Return a factor of the same pattern with other ``entries``."""
        rest = iter(entries)
        rows = tuple({k: next(rest) for k in row} for row in self.rows)
        columns = tuple({i: rows[i][k] for i in column} for k, column in enumerate(self.columns))
        return LdlFactor(rows, columns, tuple(rest), self.order)

    def forward(self, b: Values) -> Vector:
        """Return L^-1 P b."""
        n = len(self.inverse)
        x = zeros(n)
        for i in range(n):
            entry = b[self.order[i]]
            for k, factor in self.rows[i].items():
                entry = entry - factor * x[k]
            x[i] = entry
        return x

    def forward_entries(self, b: Mapping[int, Any]) -> dict[int, Any]:
        """Return the nonzero entries of L^-1 P b from those of b: rows that these do not reach are not looked at."""
        x: dict[int, Any] = {}
        place = {row: i for i, row in enumerate(self.order)}
        reached = {place[k] for k in b}
        waiting = list(reached)
        heapify(waiting)
        while waiting:
            i = heappop(waiting)
            entry = b.get(self.order[i], 0.0)
            for k, factor in self.rows[i].items():
                if k in x:
                    entry = entry - factor * x[k]
            if is_nonzero(entry):
                x[i] = entry
                for j in self.columns[i].keys() - reached:
                    reached.add(j)
                    heappush(waiting, j)
        return x

    def backward(self, y: Values) -> Vector:
        """Return P^T L^-T y."""
        n = len(self.inverse)
        x = zeros(n)
        for i in reversed(range(n)):
            entry = y[i]
            for k, factor in self.columns[i].items():
                entry = entry - factor * x[k]
            x[i] = entry
        out = zeros(n)
        for i in range(n):
            out[self.order[i]] = x[i]
        return out

    def solve(self, b: Values) -> Vector:
        """Return A^-1 b."""
        return self.backward([x * d for x, d in zip(self.forward(b), self.inverse)])

    def inverse_trace(self) -> Any:
        """Return tr A^-1, from those entries of the inverse that lie where L has entries.

        Z = A^-1 obeys Z = D^-1 L^-1 + (E - L^T) Z, which gives them column by column from the last to the first
        (Takahashi, Fagan and Chin 1973).
        """
        n = len(self.inverse)
        Z: list[dict[int, Any]] = [{} for _ in range(n)]
        total: Any = 0.0
        for i in reversed(range(n)):
            below = self.columns[i]
            for j in sorted(below, reverse=True):
                entry: Any = 0.0
                for k, factor in below.items():
                    entry = entry - factor * (Z[j][k] if k <= j else Z[k][j])
                Z[j][i] = entry
            diagonal = self.inverse[i]
            for k, factor in below.items():
                diagonal = diagonal - factor * Z[k][i]
            Z[i][i] = diagonal
            total = total + diagonal
        return total


@record
class LuFactor:
    """A = L U without pivoting, L with unit diagonal; zeros of A that stay zero cost nothing.

    entries : L below and U on and above the diagonal, the diagonal of U inverted.
    """

    entries: Matrix

    @staticmethod
    def of(A: Matrix) -> LuFactor:
        """Factor A by Crout's scheme, row by row."""
        n = A.shape[0]
        F = zeros(n, n)
        for i in range(n):
            for j in range(n):
                entry = A[i, j]
                for k in range(min(i, j)):
                    entry = entry - F[i, k] * F[k, j]
                if j < i:
                    entry = entry * F[j, j]
                F[i, j] = 1.0 / entry if i == j else entry
        return LuFactor(F)

    def solve(self, b: Values) -> Vector:
        """Return A^-1 b."""
        n = self.entries.shape[0]
        x = zeros(n)
        for i in range(n):
            entry = b[i]
            for k in range(i):
                entry = entry - self.entries[i, k] * x[k]
            x[i] = entry
        for i in reversed(range(n)):
            entry = x[i]
            for k in range(i + 1, n):
                entry = entry - self.entries[i, k] * x[k]
            x[i] = entry * self.entries[i, i]
        return x


@record
class Complex:
    """re + i im; parts that are float zeros leave nothing behind in a product."""

    re: Any
    im: Any = 0.0

    def __add__(self, other: Complex) -> Complex:
        return Complex(self.re + other.re, self.im + other.im)

    def __sub__(self, other: Complex) -> Complex:
        return Complex(self.re - other.re, self.im - other.im)

    def __mul__(self, other: Complex) -> Complex:
        return Complex(
            self.re * other.re - self.im * other.im,
            self.re * other.im + self.im * other.re,
        )

    def __rtruediv__(self, number: float) -> Complex:
        """Return number / self."""
        size = self.re * self.re + self.im * self.im
        return Complex(number * self.re / size, -(number * self.im) / size)
