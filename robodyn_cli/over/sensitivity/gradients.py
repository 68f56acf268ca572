"""Programs of derivatives: expressions at samples, with their exact derivatives by symbols and by keys of the scene;
and the derivatives of figures of sampled arrays along these.

    d figure / dk = d figure(y + s dy/dk) / ds  at s = 0

Peaks, ranges and integrals are formulas of the samples, so central differences with extrapolation give this to
rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.calculus import SparseRow, gradients
from robodyn_cli.expr.graph import Expr, Scalar
from robodyn_cli.expr.many import ByKeys, ManyNumbers
from robodyn_cli.expr.rebuild import Evaluator
from robodyn_cli.kernels.program import Program
from robodyn_cli.kernels.samples import SampleKernel
from robodyn_cli.over.batch.criteria import lookup_number
from robodyn_cli.over.sensitivity.asked import AskedSlopes
from robodyn_cli.over.sensitivity.differences import EXACT, NARROWER, Slope, extrapolated
from robodyn_cli.record import record
from robodyn_cli.results.summary import as_keys
from robodyn_cli.solve.quadrature import pieces
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

    def __call__(
        self, samples: int, groups: Mapping[str, Array], numbers: ManyNumbers | None = None
    ) -> dict[str, tuple[Array, Array]]:
        """Return values and derivatives by name at so many samples.

        With numbers of N runs, and groups (N, T, n) of each, they are those of one run behind those of another.
        """
        if numbers is None:
            outputs = self.kernel.evaluate(samples, groups)
        else:
            of_runs = self.kernel.of_tables(numbers.table(self.program.numbers or (0.0,)), samples, groups)
            samples *= numbers.runs
            outputs = {name: x.swapaxes(1, 2).reshape(samples, -1) for name, x in of_runs.items()}
        J = np.zeros((samples, sum(self.sizes.values()), self.columns.count))
        if len(self._rows):
            J[:, self._rows, self._columns] = outputs[""]
        out, first = {}, 0
        for name, size in self.sizes.items():
            values = outputs[name] if size else np.zeros((samples, 0))
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

    def __call__(
        self, groups: Mapping[str, Array], p: Sequence[float] = (), numbers: ManyNumbers | None = None
    ) -> Along:
        """Evaluate at samples: arrays (T, n) by group of symbols; with numbers of N runs (N, T, n), run by run."""
        samples = groups["t"].shape[-2]
        along = self._gradients(samples, {**groups, "p": np.array(p, dtype=float)}, numbers)
        return Along(along, self._columns)


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


WIDEST = 5e-3  # part of the arrays by which they are changed at most
LEVELS = 4
ALL, FEWER = 1, (-1, 2, 4)  # which samples to take, see ``every_nth``
ORDER = 6  # of what samples put peaks off by, in the time between them
ESTIMATES = ("error_estimate.",)
NOTHING = 1e-6  # part of a key, by which a change cannot be as large as all of an array
ROUNDING = 1e-15  # of a figure of many samples
MARGIN = 1.5  # of what extrapolated differences differ by, since these agree by chance
SOLVED = 1e-12  # of arrays, in which the solution of their equations is exact


# the summary record for a key, by its number, changed by so much, from every n-th sample
Give = Callable[[int, float, int], Any]


def slopes_along(
    asked: AskedSlopes, numbers: Sequence[int], give: Give, arrays: Sequence[tuple[Array, Array]]
) -> dict[str, list[Slope]]:
    """Return the derivatives of those outputs that a summary record has, by some keys.

    Parameters
    ----------
    give : the record, for a key by its place among ``numbers``. arrays : what it follows from (T, n), with derivatives
        (T, n, K).
    """
    keys = as_keys(give(0, 0.0, 1))
    wanted = asked.task.outputs
    own = [
        name for name in wanted if not name.startswith(ESTIMATES) and lookup_number(keys, name) is not None
    ]
    by_output: dict[str, list[Slope]] = {name: [] for name in own}
    for k, number in enumerate(numbers):
        scale = abs(asked.values[number]) or 1.0
        step = _step([(y, change[..., k]) for y, change in arrays], scale)
        for name, slope in zip(own, _slopes(own, partial(give, k), step)):
            by_output[name].append(slope)
    return by_output


def _step(arrays: Sequence[tuple[Array, Array]], scale: float) -> float:
    """Return the largest change of a key of this size that changes no array much.

    Arrays that are zero but for rounding say nothing about it.
    """
    sizes = [
        (float(np.abs(y).max(initial=0.0)), float(np.abs(slope).max(initial=0.0))) for y, slope in arrays
    ]
    parts = [y / slope for y, slope in sizes if slope and y / slope > NOTHING * scale]
    return WIDEST * min([scale, *parts])


def _slopes(outputs: Sequence[str], give: Callable[[float, int], Any], step: float) -> list[Slope]:
    """Return the derivatives of outputs by one key, changed by at most ``step``.

    How they differ with every second and every fourth sample tells how much of them is due to the samples, between
    which a peak may lie.
    """
    steps = np.array([step / NARROWER**level for level in range(LEVELS)])
    sides = np.array([[_numbers(outputs, give(way * x, 1)) for way in (1.0, -1.0)] for x in steps])
    raw = (sides[:, 0] - sides[:, 1]) / (2.0 * steps[:, None])
    size = np.where(
        np.any(raw, axis=0), np.abs(sides).max(axis=(0, 1)), 0.0
    )  # a figure that stays has no rounding
    values, errors = extrapolated(raw, ROUNDING * size / steps[:, None])
    there = np.array(
        [[_numbers(outputs, give(way * steps[1], every)) for way in (1.0, -1.0)] for every in FEWER]
    )
    fine, half, quarter = (there[:, 0] - there[:, 1]) / (2.0 * steps[1])
    # all and half of the samples may agree by chance, but hardly half and a quarter too
    sampled = np.maximum(np.abs(half - fine), np.abs(quarter - half) / 2**ORDER)
    solved = SOLVED * np.maximum(np.abs(values), size * WIDEST / step)
    return [Slope(float(y), float(e), EXACT) for y, e in zip(values, MARGIN * errors + sampled + solved)]


def every_nth(times: Array, every: int) -> NDArray[np.int_]:
    """Return which samples at times (T,) to take: all, or, of 4 n + 1 in each stretch of uniform ones, each (-1) or
    every second or fourth one."""
    if every == ALL or len(times) < 3:
        return np.arange(len(times))
    parts = [
        (part, np.arange((part.samples - 1) % FEWER[-1], part.samples, max(every, 1)))
        for part in pieces(times)
    ]
    return np.unique(np.concatenate([(part.first[:, None] + own).ravel() for part, own in parts]))


def _numbers(outputs: Sequence[str], record: Any) -> list[float]:
    keys = as_keys(record)
    return [np.nan if (x := lookup_number(keys, name)) is None else x for name in outputs]
