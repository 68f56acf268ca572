"""Places and directions of a drawing, collected as expressions and evaluated at once for all instants."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.graph import Scalar, free_symbols
from robodyn_cli.expr.rebuild import Interpreter
from robodyn_cli.model.model import FixedFrame
from robodyn_cli.spatial.algebra import Array, Vector, identity

KNOWN = ("t", "q", "v")  # groups of symbols that a result has values of
DIGITS = 9  # after the point by which places on a body are told apart [m]


class Expressions:
    """Vertices, axes and forces in the world, as expressions of t, q and v. The same place has one number."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self._vertices: dict[tuple[Any, ...], int] = {}
        self._axes: dict[tuple[Any, ...], int] = {}
        self._entries: dict[str, list[Vector]] = {"vertices": [], "axes": [], "forces": []}

    def vertex(self, body: int, p: Vector) -> int | None:
        """Return the number of a place on a body, p (3,) in its coordinates; None if data for it are unknown."""
        return self._number("vertices", self._vertices, body, p)

    def own_vertex(self, body: int, p: Vector) -> int | None:
        """Return the number of a place on a body that it shares with no other, None likewise."""
        return self._store("vertices", self.problem.world_point(FixedFrame(body, p, identity())))

    def axis(self, body: int, direction: Vector) -> int | None:
        """Return the number of a direction (3,) in a body's coordinates, None likewise."""
        return self._number("axes", self._axes, body, direction)

    def force(self, f: Vector) -> int | None:
        """Return the number of a force (3,) in the world, None likewise."""
        return self._store("forces", f)

    def rotated(self, body: int, direction: Vector) -> Vector:
        """Return world components of a direction on a body."""
        turned: Vector = self.problem.model.base.E.T @ (self.problem.pose[body].R @ direction)
        return turned

    def _number(self, kind: str, table: dict[tuple[Any, ...], int], body: int, p: Vector) -> int | None:
        key = (body, *(round(x, DIGITS) + 0.0 if isinstance(x, float) else id(x) for x in p))
        if key not in table:
            frame = FixedFrame(body, p, identity())
            entry = self.problem.world_point(frame) if kind == "vertices" else self.rotated(body, p)
            number = self._store(kind, entry)
            if number is None:
                return None
            table[key] = number
        return table[key]

    def _store(self, kind: str, entry: Vector) -> int | None:
        if any(symbol.value[1] not in KNOWN for symbol in free_symbols(list(entry))):
            return None
        self._entries[kind].append(entry)
        return len(self._entries[kind]) - 1

    def count(self, kind: str) -> int:
        """Return how many ``vertices``, ``axes`` or ``forces`` there are."""
        return len(self._entries[kind])

    def evaluate(self, t: Array, q: Array, v: Array) -> tuple[Array, Array, Array]:
        """Return vertices (T, N, 3), axes (T, M, 3) and forces (T, F, 3) at times t (T,), q (T, nq), v (T, nv)."""
        entries: Sequence[Scalar] = [x for kind in self._entries.values() for e in kind for x in e]
        with np.errstate(all="ignore"):
            values = Interpreter(entries)({"t": t[None, :], "q": q.T, "v": v.T})
        table = np.empty((len(t), len(values)))
        for k, value in enumerate(values):
            table[:, k] = value
        ends = np.cumsum([3 * len(kind) for kind in self._entries.values()])[:-1]
        found = [block.reshape(len(t), -1, 3) for block in np.split(table, ends, axis=1)]
        return found[0], found[1], found[2]
