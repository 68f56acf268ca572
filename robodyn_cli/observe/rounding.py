"""What rounding does to figures: they are computed again with every number and every result slightly off.

Each constant, input and result of an operation is changed by a random part of one unit of rounding. What that makes of
the outputs is how they may be off, cancellations and conditioning included (Vignes 1993, "A stochastic arithmetic for
reliable scientific computation"). The changes are enlarged, so that the rounding of this computation itself does not
count, and the differences divided by the same.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from robodyn_cli.expr.fixed import Fixed
from robodyn_cli.expr.graph import Expr, Scalar, reachable
from robodyn_cli.expr.many import ManyNumbers
from robodyn_cli.expr.rebuild import APPLY, apply
from robodyn_cli.results.result import evenly
from robodyn_cli.spatial.algebra import Array

UNIT = 2.0**-53
ENLARGED = 2.0**13
DRAWS = 4
PATTERNS = 61  # of changes, which nodes take in turn
MOST_SAMPLES = 9  # that are looked at
SHORT = 1024.0  # numbers with so few binary places are exact
EXACT = frozenset({"neg", "abs", "sign", "min", "max", "where"})


class Rounded:
    """Expressions at a few samples, as they are (draw 0), and as rounding might make them (draws 1 to DRAWS).

    Numbers of the scene count as exact; what is computed of them, while the graph is built, does not.
    """

    def __init__(self, outputs: Sequence[Scalar]) -> None:
        self.outputs = list(outputs)
        self.nodes = reachable(self.outputs)

    def __call__(self, inputs: Mapping[str, Array], runs: ManyNumbers | None = None) -> Array:
        """Return the outputs (draw, sample, output) at inputs (T, n) by group.

        runs : numbers of the scene in many runs, in place of its own; then the outputs are (run, draw, sample, output),
        and so they are where inputs (N, T, n) are those of runs.
        """
        first = next(iter(inputs.values()))
        many = [len(first)] if first.ndim == 3 else [] if runs is None else [runs.runs]
        samples = first.shape[-2]
        shape = (*many, DRAWS + 1, samples)
        factors = itertools.cycle(1.0 + ENLARGED * UNIT * _changes(PATTERNS, samples))
        numbers = RoundedNumbers(runs, factors)
        with np.errstate(all="ignore"):
            columns = self.made(lambda group, position: _column(inputs[group], position), numbers, factors)
        out = np.empty((*shape, len(columns)))
        for k, x in enumerate(columns):
            out[..., k] = x
        return out

    def made(
        self, symbol: Callable[[str, int], Any], numbers: RoundedNumbers, factors: Iterator[Any]
    ) -> list[Any]:
        """Return the outputs; symbol : of a group, by its position. Symbols and factors are arrays, or expressions."""
        value: dict[int, Any] = {}
        for node in self.nodes:
            if node.op == "sym":
                _, group, position = node.value
                value[node.index] = symbol(group, position) * next(factors)
            elif node.op == "const":
                value[node.index] = numbers(node.value)
            else:
                exact = numbers.apply(node, [value[a.index] for a in node.args])
                value[node.index] = exact if node.op in EXACT else exact * next(factors)
        return [value[e.index] if isinstance(e, Expr) else numbers(e) for e in self.outputs]


class RoundedNumbers:
    """Numbers of a graph as rounding might make them (draw, sample), or (run, draw, sample) of many runs.

    Parameters
    ----------
    runs : numbers of the scene in many runs; None: as they are. factors : what each result is multiplied by.
    """

    def __init__(self, runs: ManyNumbers | None, factors: Iterator[Any]) -> None:
        self._runs, self._factors = runs, factors
        self._known: dict[int, Any] = {}  # numbers of the scene, by identity

    def __call__(self, x: float) -> Any:
        """Return a number."""
        known = self._known
        if not isinstance(x, Fixed):
            return x if float(x * SHORT).is_integer() else x * next(self._factors)
        stack = [x]
        while stack:
            top = stack[-1]
            computed = top.op not in ("literal", "entry")
            inputs = [a for a in top.args if isinstance(a, Fixed)] if computed else []
            if missing := [a for a in inputs if id(a) not in known]:
                stack += missing
                continue
            stack.pop()
            if id(top) in known:
                continue
            if not computed:
                given = self._given(top)
                known[id(top)] = given if top.op == "literal" else given * next(self._factors)
                continue
            exact = APPLY[top.op](*(known[id(a)] if isinstance(a, Fixed) else a for a in top.args))
            known[id(top)] = exact if top.op in EXACT else exact * next(self._factors)
        return known[id(x)]

    def _given(self, x: Fixed) -> Any:
        """Return a number as the scene, or each run, has it."""
        if self._runs is None:
            return float(x)
        own = self._runs.value(x)
        return own if np.ndim(own) == 0 else own[:, None, None]

    def apply(self, node: Expr, args: Sequence[Any]) -> Any:
        """Return the operation of a node; tables may be others in each run."""
        if node.op == "table" and self._runs is not None:
            x = np.broadcast_to(args[0], (self._runs.runs, *np.shape(args[0])[-2:]))
            return self._runs.looked_up(x, node.value)
        return apply(node, args)


def _column(inputs: Array, position: int) -> Array:
    """Return one of the inputs (T, n), or (N, T, n) of runs, beside draws."""
    own: Array = inputs[..., position]
    return own if inputs.ndim == 2 else own[:, None]


def _changes(patterns: int, samples: int) -> Array:
    """Return numbers between -1 and 1 without order (pattern, draw, sample), zero in draw 0; the same in each run."""
    count = np.arange(1.0, 1.0 + patterns * (DRAWS + 1) * samples).reshape(patterns, DRAWS + 1, samples)
    noise = 2.0 * np.modf(np.abs(np.sin(12.9898 * count)) * 43758.5453)[0] - 1.0
    noise[:, 0] = 0.0
    return noise


def more_changes(count: int) -> Array:
    """Return changes as those of numbers and results for what is not computed by a graph (draw, count)."""
    return _changes(PATTERNS + count, 1)[PATTERNS:, 1:, 0].T


def largest_difference(draws: Array) -> float | None:
    """Return how far draws (draw, ...) of a figure lie from draw 0 at most; None if not finite."""
    largest = float(largest_differences(draws[None])[0])
    return largest if np.isfinite(largest) else None


def largest_differences(draws: Array) -> Array:
    """Return how far draws (run, draw, ...) of a figure lie from draw 0 at most (run,)."""
    away = np.abs(draws[:, 1:] - draws[:, :1])
    most: Array = away.reshape(len(draws), -1).max(axis=1, initial=0.0) / ENLARGED
    return most


def few(samples: int) -> Array:
    """Return indices of a few samples out of many, the first and the last among them."""
    return evenly(samples, MOST_SAMPLES)
