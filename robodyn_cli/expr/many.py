"""Numbers of a scene for many runs at once: what a program's table holds for other values of some keys.

A ``Fixed`` remembers how it was computed, so the same arithmetic on arrays, an entry a run, gives its values in all
runs. This holds for runs whose graph is the same, that is where every comparison with such numbers that was made while
the graph was built (``fixed.witnessed``) turns out as it did there.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.expr.fixed import CANCELLED, Fixed, Witness, derive
from robodyn_cli.expr.graph import Expr, Scalar, reachable
from robodyn_cli.expr.rebuild import APPLY, piecewise

Array = NDArray[Any]
COMPARE: dict[str, Callable[[Any, Any], Any]] = {
    name: getattr(operator, name) for name in ("lt", "le", "gt", "ge", "eq", "ne")
}
CONSTANT = -1
Argument = tuple[int, Any]  # number of a step and nothing, or ``CONSTANT`` and a value
Decision = tuple[
    Callable[[Any, Any], Any], Argument, Argument, Any
]  # a comparison, its sides, how it turned out


class Recipe:
    """How numbers follow from those at places that vary: steps, each from steps before it.

    Parameters
    ----------
    places : in the scene, that vary.
    """

    def __init__(self, places: Collection[str]) -> None:
        self.places = frozenset(places)
        self.steps: list[tuple[str, Any, list[Argument]]] = []  # operation, data, arguments
        # by identity: the number itself, so that its identity stays its own, and its step
        self._known: dict[int, tuple[Any, int]] = {}
        self._arguments: dict[int, tuple[Any, list[Argument]]] = {}

    def step_of(self, x: Any) -> int:
        """Return the step that computes a number, ``CONSTANT`` where it is the same in all runs."""
        if not isinstance(x, Fixed):
            return CONSTANT
        known = self._known.get(id(x))
        if known is not None:
            return known[1]
        stack: list[Fixed] = [x]
        while stack:
            top = stack[-1]
            if id(top) not in self._known:
                waiting = [a for a in _inputs(top) if isinstance(a, Fixed) and id(a) not in self._known]
                if waiting:
                    stack += waiting
                    continue
                self._known[id(top)] = top, self._add(top)
            stack.pop()
        return self._known[id(x)][1]

    def _add(self, x: Fixed) -> int:
        """Add the step of a number whose inputs are known."""
        if x.op == "literal":
            return self._append("literal", x.args[0], []) if x.args[0] in self.places else CONSTANT
        args = [self._argument(a) for a in _inputs(x)]
        if all(step == CONSTANT for step, _ in args):
            return CONSTANT
        if x.op != "entry":
            return self._append(x.op, None, args)
        shared, k = x.args
        return self._append("entry", k, [(self.derived(shared), None)])

    def derived(self, shared: Any) -> int:
        """Return the step that computes all results of one call of ``derived``, from what they share."""
        if id(shared) not in self._known:
            step = self._append("derived", shared, [self._argument(x) for x in shared])
            self._known[id(shared)] = shared, step
        return self._known[id(shared)][1]

    def _argument(self, x: Any) -> Argument:
        step = self.step_of(x)
        return step, float(x) if step == CONSTANT else None

    def _append(self, op: str, data: Any, args: list[Argument]) -> int:
        self.steps.append((op, data, args))
        return len(self.steps) - 1

    def arguments(self, numbers: Sequence[Any]) -> list[Argument]:
        """Return where the values of numbers come from; asked for again and again, they are looked up once."""
        known = self._arguments.get(id(numbers))
        if known is None:
            known = self._arguments[id(numbers)] = numbers, [self._argument(x) for x in numbers]
        return known[1]

    def deciding(self, witnesses: Sequence[Witness]) -> list[Decision]:
        """Return the comparisons that may turn out otherwise in other runs, each once."""
        each = {
            (w[0], *((id(w[1][0]), w[1][1]) if w[0] == "kept" else map(id, w[1:3]))): w for w in witnesses
        }
        found: list[Decision] = []
        for name, a, b, outcome in each.values():
            if name == "kept":
                shared, k = a
                if any(self.step_of(x) != CONSTANT for x in shared):
                    found.append((partial(_kept, k), (self.derived(shared), None), (CONSTANT, None), outcome))
            elif any(self.step_of(x) != CONSTANT for x in (a, b)):
                found.append((COMPARE[name], self._argument(a), self._argument(b), outcome))
        return found


def _kept(k: int, derived: tuple[Array, Array], _: None) -> Array:
    """Return in which runs a call of ``derived`` kept its k-th result."""
    return derived[1][:, k]


class ManyNumbers:
    """The values of numbers of a scene in many runs.

    Parameters
    ----------
    given : values (N,) by place in the scene (``robot.links.link1.mass``), of all that vary in the recipe.
    """

    def __init__(self, recipe: Recipe, given: Mapping[str, Array], runs: int) -> None:
        # numbers take a tenth of the time of arrays of one
        self.given = {place: x[0] for place, x in given.items()} if runs == 1 else given
        self.recipe, self.runs = recipe, runs
        self._values: list[Any] = []  # by step

    def table(self, numbers: Sequence[float]) -> Array:
        """Return the values (N, n) of n numbers."""
        return self._joined(self._take(self.recipe.arguments(numbers)))

    def _joined(self, columns: Sequence[Any]) -> Array:
        """Return columns, arrays or numbers, as one array (N, n)."""
        if self.runs == 1:
            return np.array([x[0] if isinstance(x, np.ndarray) else x for x in columns], dtype=float)[None]
        out = np.empty((self.runs, len(columns)))
        for k, x in enumerate(columns):
            out[:, k] = x
        return out

    def evaluate(self, expressions: Expressions, inputs: Mapping[str, Sequence[Any]]) -> Array:
        """Return the values (N, outputs) of expressions.

        inputs : for each symbol of a group its values (N,), or a number, by group.
        """
        constants = iter(self._take(self.recipe.arguments(expressions.constants)))
        value: list[Any] = []
        with np.errstate(all="ignore"):
            for op, function, args, data in expressions.code:
                if function is not None:
                    value.append(function(*[value[k] for k in args]))
                elif op == "const":
                    value.append(next(constants))
                elif op == "table":
                    value.append(self._looked_up(value[args[0]], data))
                else:
                    _, group, position = data
                    x = inputs[group][position]
                    value.append(x[0] if self.runs == 1 and isinstance(x, np.ndarray) else x)
        outputs = self._take(self.recipe.arguments(expressions.outputs))
        return self._joined([x if k is None else value[k] for k, x in zip(expressions.places, outputs)])

    def decided_alike(self, decisions: Sequence[Decision]) -> NDArray[np.bool_]:
        """Return in which runs (N,) all comparisons turn out as they did."""
        alike: Any = np.ones(self.runs, dtype=bool)
        first, second = self._take([d[1] for d in decisions]), self._take([d[2] for d in decisions])
        with np.errstate(all="ignore"):
            for decision, a, b in zip(decisions, first, second):
                alike &= decision[0](a, b) == decision[3]
        return np.asarray(alike)

    def _take(self, arguments: Sequence[Argument]) -> list[Any]:
        """Return values, each an array (N,), or a number where one holds for all runs."""
        values = self._values
        if len(values) < len(self.recipe.steps):
            with np.errstate(all="ignore"):
                for op, data, args in self.recipe.steps[len(values) :]:
                    taken = [x if k == CONSTANT else values[k] for k, x in args]
                    values.append(self._computed(op, data, taken))
        return [x if k == CONSTANT else values[k] for k, x in arguments]

    def _computed(self, op: str, data: Any, args: list[Any]) -> Any:
        if op == "literal":
            return self.given[data]
        if op == "entry":
            found = args[0][0][:, data]
            return found[0] if self.runs == 1 else found
        if op == "derived":
            rows = np.stack([np.broadcast_to(x, self.runs) for x in args], axis=1).tolist()
            lists = [derive(data, row) for row in rows]
            return np.array([x for x, _ in lists], dtype=float), np.array([kept for _, kept in lists])
        try:
            found = APPLY[op](*args)
        except (ArithmeticError, ValueError):  # plain numbers raise where arrays have no value
            return np.float64("nan")
        if op not in ("add", "sub"):
            return found
        # what cancels is zero, as in the arithmetic of one
        if self.runs == 1:
            return 0.0 if abs(found) <= CANCELLED * max(abs(args[0]), abs(args[1])) else found
        largest = np.maximum(np.abs(args[0]), np.abs(args[1]))
        return np.where(np.abs(found) <= CANCELLED * largest, 0.0, found)

    def _looked_up(self, x: Any, table: Any) -> Array:
        """Return the values of a piecewise polynomial whose knots and coefficients may be others in each run."""
        knots, rows, held = table
        own = self.table(knots), [self.table(row) for row in rows], None if held is None else self.table(held)
        xs = np.broadcast_to(x, self.runs)
        return np.array([
            piecewise(xs[k], (own[0][k], [row[k] for row in own[1]], None if own[2] is None else own[2][k]))
            for k in range(self.runs)
        ])  # fmt: skip


class Expressions:
    """Expressions to be evaluated for many runs; their order of evaluation is found once.

    code : operations in order: name, function, places of arguments, data. places : of the outputs; None where one is a
    number, which ``outputs`` holds. constants : numbers of the scene, in order.
    """

    def __init__(self, outputs: Sequence[Scalar]) -> None:
        nodes = reachable(list(outputs))
        place = {node.index: k for k, node in enumerate(nodes)}
        functions = {op: function for op, function in APPLY.items() if op != "table"}
        self.code = [
            (node.op, functions.get(node.op), [place[a.index] for a in node.args], node.value)
            for node in nodes
        ]
        self.places = [place[e.index] if isinstance(e, Expr) else None for e in outputs]
        self.outputs = [0.0 if isinstance(e, Expr) else e for e in outputs]
        self.constants = [node.value for node in nodes if node.op == "const"]


def _inputs(x: Fixed) -> Sequence[Any]:
    """Return what a number is computed from."""
    if x.op == "literal":
        return ()
    inputs: Sequence[Any] = x.args[0] if x.op == "entry" else x.args
    return inputs
