"""Programs of derivatives: expressions at samples, with their exact derivatives by symbols and by keys of the scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.calculus import SparseRow, gradients
from robodyn_cli.expr.graph import Expr, Scalar
from robodyn_cli.expr.many import ByKeys
from robodyn_cli.expr.rebuild import Evaluator
from robodyn_cli.kernels.program import Program
from robodyn_cli.kernels.samples import SampleKernel
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array


@record
class Columns:
    """What derivatives are taken by: symbols (node index: its column), then the numbers at places of the scene.

    size : columns of symbols, behind which those of the places lie; an empty place has no number, and its column is 0.
    """

    symbols: Mapping[int, int]
    size: int
    places: tuple[str, ...]

    def of(self, outputs: Sequence[Scalar]) -> list[SparseRow]:
        """Return the derivatives of expressions as sparse rows.

        Raises
        ------
        CapabilityError : an operation, or a number, has no derivative.
        """
        by_keys = ByKeys({place: self.size + k for k, place in enumerate(self.places) if place})
        return gradients(outputs, {node: {column: 1.0} for node, column in self.symbols.items()}, by_keys)

    @property
    def count(self) -> int:
        return self.size + len(self.places)


class Gradients:
    """Named expressions as a function of samples: values (T, n) and derivatives (T, n, columns)."""

    def __init__(
        self, outputs: Mapping[str, Sequence[Scalar]], columns: Columns, known: Sequence[str]
    ) -> None:
        self.sizes, self.columns = {name: len(x) for name, x in outputs.items()}, columns
        rows = columns.of([x for entries in outputs.values() for x in entries])
        places = [(i, k) for i, row in enumerate(rows) for k in row]
        self._rows, self._columns = np.array(places, dtype=int).reshape(-1, 2).T
        programs = {**outputs, "": [x for row in rows for x in row.values()]}
        self.kernel = SampleKernel({name: x for name, x in programs.items() if x}, known)

    @property
    def program(self) -> Program:
        """The code of values and derivatives, with its numbers."""
        return self.kernel.program

    def __call__(self, samples: int, groups: Mapping[str, Array]) -> dict[str, tuple[Array, Array]]:
        """Return values and derivatives by name at so many samples."""
        found = self.kernel.evaluate(samples, groups)
        J = np.zeros((samples, sum(self.sizes.values()), self.columns.count))
        if len(self._rows):
            J[:, self._rows, self._columns] = found[""]
        out, first = {}, 0
        for name, size in self.sizes.items():
            values = found[name] if size else np.zeros((samples, 0))
            out[name] = values, J[:, first : first + size]
            first += size
        return out


def at_one_point(outputs: Sequence[Scalar], columns: Columns) -> Any:
    """Return expressions and their derivatives as a function of one point: symbols by group -> (n,), (n, columns)."""
    rows = columns.of(outputs)
    places = [(i, k) for i, row in enumerate(rows) for k in row]
    evaluate = Evaluator([*outputs, *(e for row in rows for e in row.values())])

    def function(groups: Mapping[str, Any]) -> tuple[Array, Array]:
        values = evaluate(groups)
        J = np.zeros((len(outputs), columns.count))
        for place, value in zip(places, values[len(outputs) :]):
            J[place] = value
        return np.array(values[: len(outputs)], dtype=float), J

    return function


class MotionGradients:
    """Named expressions along a motion that may depend on keys itself: by t, q, v, v-dot, the multipliers, and keys."""

    def __init__(
        self, problem: Problem, outputs: Mapping[str, Sequence[Scalar]], places: Sequence[str]
    ) -> None:
        symbols: dict[str, list[Expr]] = {
            "t": [problem.t], "q": list(problem.q), "v": list(problem.v), "a": list(problem.a),
            "lam": problem.graph.symbols(list(problem.constraints.names), "lam"),
        }  # fmt: skip
        columns: dict[int, int] = {}
        self._columns: dict[str, slice] = {}
        for group, own in symbols.items():
            self._columns[group] = slice(len(columns), len(columns) + len(own))
            columns |= {x.index: len(columns) + k for k, x in enumerate(own)}
        self._columns[KEYS] = slice(len(columns), None)
        self._gradients = Gradients(outputs, Columns(columns, len(columns), tuple(places)), [*symbols, "p"])
        self.program = self._gradients.program

    def __call__(self, groups: Mapping[str, Array], p: Sequence[float] = ()) -> Along:
        """Evaluate at samples: arrays (T, n) by group of symbols."""
        found = self._gradients(len(groups["t"]), {**groups, "p": np.array(p, dtype=float)})
        return Along(found, self._columns)


KEYS = "keys"


@record
class Along:
    """Expressions along a motion: values and derivatives by name; the columns of each group of symbols."""

    found: Mapping[str, tuple[Array, Array]]
    columns: Mapping[str, slice]

    def __getitem__(self, name: str) -> Array:
        """Values (T, n)."""
        return self.found[name][0]

    def by(self, name: str, group: str) -> Array:
        """Derivatives (T, n, m) by the symbols of a group, or by the keys."""
        return self.found[name][1][:, :, self.columns[group]]

    def change(self, name: str, moved: Mapping[str, Array]) -> Array:
        """Return derivatives by keys (T, n, K), with those of the motion (T, m, K) by group of symbols."""
        total = self.by(name, KEYS).copy()
        for group, own in moved.items():
            total += self.by(name, group) @ own
        return total
