"""Programs of derivatives: expressions at samples, with their exact derivatives by symbols and by keys of the scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.by_keys import ByKeys
from robodyn_cli.expr.calculus import SparseRow, gradients
from robodyn_cli.expr.graph import Expr, Scalar
from robodyn_cli.expr.rebuild import Evaluator
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

    def __init__(self, outputs: Mapping[str, Sequence[Scalar]], columns: Columns, known: Sequence[str]) -> None:
        self.sizes, self.columns = {name: len(x) for name, x in outputs.items()}, columns
        rows = columns.of([x for entries in outputs.values() for x in entries])
        places = [(i, k) for i, row in enumerate(rows) for k in row]
        self._rows, self._columns = np.array(places, dtype=int).reshape(-1, 2).T
        programs = {**outputs, "": [x for row in rows for x in row.values()]}
        self.kernel = SampleKernel({name: x for name, x in programs.items() if x}, known)

    @property
    def digest(self) -> str:
        """Key of everything that decides the code of values and derivatives."""
        return self.kernel.program.digest

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


@record
class Moved:
    """A motion at samples, and how it changes with keys: arrays (T, n) by group of symbols (t, q, v, a, lam), and
    their derivatives (T, n, K).
    """

    groups: Mapping[str, Array]
    changes: Mapping[str, Array]

    @property
    def times(self) -> Array:
        found: Array = self.groups["t"][:, 0]
        return found

    def plus(self, step: float, key: int) -> dict[str, Array]:
        """Return the motion for a key changed by so much, to first order."""
        return {name: x + step * self.changes[name][:, :, key] for name, x in self.groups.items()}


class MotionGradients:
    """Expressions along a motion that depends on keys itself."""

    def __init__(self, problem: Problem, outputs: Mapping[str, Sequence[Scalar]], places: Sequence[str]) -> None:
        graph = problem.graph
        rows = problem.constraints.names
        symbols: dict[str, list[Expr]] = {
            "t": [problem.t], "q": list(problem.q), "v": list(problem.v), "a": list(problem.a),
            "lam": graph.symbols(list(rows), "lam"),
        }  # fmt: skip
        self.first: dict[str, int] = {}
        columns: dict[int, int] = {}
        for group, own in symbols.items():
            self.first[group] = len(columns)
            columns |= {x.index: len(columns) + k for k, x in enumerate(own)}
        self.counts = {group: len(own) for group, own in symbols.items()}
        self.size = len(columns)
        self.program = Gradients(outputs, Columns(columns, self.size, tuple(places)), [*symbols, "p"])

    def __call__(self, moved: Moved, p: Sequence[float] = ()) -> tuple[dict[str, Array], dict[str, Array]]:
        """Return values (T, n) and derivatives by keys (T, n, K) by name; what has no change stays as it is."""
        found = self.program(len(moved.times), {**moved.groups, "p": np.array(p, dtype=float)})
        values, changes = {}, {}
        for name, (value, J) in found.items():
            change = J[:, :, self.size :].copy()
            for group, own in moved.changes.items():
                first = self.first[group]
                change += J[:, :, first : first + self.counts[group]] @ own
            values[name], changes[name] = value, change
        return values, changes
