"""Numbers of a scene for many runs at once: what a program's table holds for other values of some keys.

A ``Fixed`` remembers how it was computed, so the same arithmetic on arrays, an entry a run, gives its values in all
runs. This holds for runs whose graph is the same, that is where every comparison with such numbers that was made while
the graph was built (``fixed.witnessed``) turns out as it did there.

Derivatives of the numbers of a scene by its keys.

A ``Fixed`` remembers how it was computed, so its derivative follows by the chain rule from the rules of ``calculus``.
It is made of such numbers again: code of derivatives serves other values of the keys too.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.calculus import SparseRow, rules
from robodyn_cli.expr.fixed import CANCELLED, Fixed, Witness, derive
from robodyn_cli.expr.functions import NUMPY, where
from robodyn_cli.expr.graph import Expr, Scalar, is_nonzero, reachable
from robodyn_cli.expr.rebuild import APPLY, piecewise

Array = NDArray[Any]
COMPARE: dict[str, Callable[[Any, Any], Any]] = {
    name: getattr(operator, name) for name in ("lt", "le", "gt", "ge", "eq", "ne")
}
CONSTANT = "constant"
# a comparison, the values of its sides, and how it turned out
Decision = tuple[Callable[[Any, Any], Any], int, int, Any]


class Recipe:
    """How numbers follow from those at places that vary: values, each computed from values before it.

    Parameters
    ----------
    places : in the scene, that vary.
    """

    def __init__(self, places: Collection[str]) -> None:
        self.places = frozenset(places)
        # operation, data, the values that it takes; a ``CONSTANT`` is the same in all runs
        self.steps: list[tuple[str, Any, list[int]]] = []
        # the number itself, so that its identity stays its own, and its value, by ``_key``
        self._known: dict[int | str, tuple[Any, int]] = {}
        self._asked: dict[int, tuple[Any, list[int]]] = {}

    def varies(self, x: Any) -> bool:
        """Tell whether a number is another one in other runs."""
        return self.steps[self.value_of(x)][0] != CONSTANT

    def value_of(self, x: Any) -> int:
        """Return which value a number is."""
        stack: list[Any] = [x]
        while stack:
            top = stack[-1]
            if _key(top) not in self._known:
                waiting = [a for a in _inputs(top) if _key(a) not in self._known]
                if waiting:
                    stack += waiting
                    continue
                self._add(top)
            stack.pop()
        return self._known[_key(x)][1]

    def _add(self, x: Any) -> int:
        """Add the value of a number whose inputs are known."""
        if isinstance(x, Fixed) and x.op == "literal" and x.args[0] in self.places:
            return self._keep(x, "literal", x.args[0], [])
        if not any(self.varies(a) for a in _inputs(x)):
            return self._keep(x, CONSTANT, float(x), [])
        if x.op != "entry":
            return self._keep(x, x.op, None, [self.value_of(a) for a in x.args])
        shared, k = x.args
        return self._keep(x, "entry", k, [self.derived(shared)])

    def derived(self, shared: Any) -> int:
        """Return which value holds all results of one call of ``derived``, from what they share."""
        known = self._known.get(_key(shared))
        if known is not None:
            return known[1]
        return self._keep(shared, "derived", shared, [self.value_of(x) for x in shared])

    def _keep(self, x: Any, op: str, data: Any, values: list[int]) -> int:
        self.steps.append((op, data, values))
        self._known[_key(x)] = x, len(self.steps) - 1
        return len(self.steps) - 1

    def values_of(self, numbers: Sequence[Any]) -> list[int]:
        """Return which values numbers are; asked for again and again, they are looked up once."""
        known = self._asked.get(id(numbers))
        if known is None:
            known = self._asked[id(numbers)] = numbers, [self.value_of(x) for x in numbers]
        return known[1]

    def deciding(self, witnesses: Sequence[Witness]) -> list[Decision]:
        """Return the comparisons that may turn out otherwise in other runs, each once."""
        decisions: dict[tuple[Any, ...], Decision] = {}
        for name, a, b, outcome in witnesses:
            if name == "kept":
                shared, k = a
                if any(self.varies(x) for x in shared):
                    value = self.derived(shared)
                    decisions[name, value, k] = partial(_kept, k), value, value, outcome
            elif self.varies(a) or self.varies(b):
                one, two = self.value_of(a), self.value_of(b)
                decisions[name, one, two] = COMPARE[name], one, two, outcome
        return list(decisions.values())


def _kept(k: int, derived: tuple[Array, Array], _: Any) -> Any:
    """Return in which runs a call of ``derived`` kept its k-th result."""
    return derived[1][:, k]


class ManyNumbers:
    """The values of numbers of a scene in many runs, each an array (N,), or a number where one holds for all runs.

    A single run has numbers instead of arrays, which take a tenth of the time; they are the same to the bit.

    Parameters
    ----------
    given : values (N,) by place in the scene (``robot.links.link1.mass``), of all that vary in the recipe.
    """

    def __init__(self, recipe: Recipe, given: Mapping[str, Array], runs: int) -> None:
        self.recipe, self.runs = recipe, runs
        self.given = {place: self._taken(x) for place, x in given.items()}
        self._values: Any = []  # of the recipe's steps

    def _taken(self, x: Any) -> Any:
        """Return values as arrays, or as the number of a single run."""
        if self.runs == 1:
            return float(x if isinstance(x, float) else x[0])
        return np.atleast_1d(x)

    def rows(self, runs: NDArray[np.intp]) -> ManyNumbers:
        """Return the numbers of some of the runs (n,), each as often as it is named."""
        rows = ManyNumbers(self.recipe, {}, len(runs))
        rows._values = _Rows(self, runs)
        return rows

    def table(self, numbers: Sequence[float]) -> Array:
        """Return the values (N, n) of n numbers."""
        return self._joined(self._take(self.recipe.values_of(numbers)))

    def value(self, number: float) -> Any:
        """Return the values (N,) of one number, or a number where it is the same in all runs."""
        return self._take([self.recipe.value_of(number)])[0]

    def _joined(self, columns: Sequence[Any]) -> Array:
        """Return columns, arrays or numbers, as one array (N, n)."""
        if self.runs == 1:
            return np.array(columns, dtype=float)[None]
        out = np.empty((self.runs, len(columns)))
        for k, x in enumerate(columns):
            out[:, k] = x
        return out

    @np.errstate(all="ignore")
    def evaluate(self, expressions: Expressions, inputs: Mapping[str, Sequence[Any]]) -> Array:
        """Return the values (N, outputs) of expressions.

        inputs : for each symbol of a group its values (N,), or a number, by group.
        """
        functions = ALONE if self.runs == 1 else TOGETHER
        values = self._take(self.recipe.values_of(expressions.constants))
        values += [self._taken(inputs[group][position]) for _, group, position in expressions.symbols]
        take = values.__getitem__
        for op, args, data in expressions.code:
            if op == "table":
                values.append(self.looked_up(values[args[0]], data))
            else:
                values.append(functions[op](*map(take, args)))
        outputs = self._take(self.recipe.values_of(expressions.outputs))
        return self._joined([x if k is None else values[k] for k, x in zip(expressions.places, outputs)])

    def decided_alike(self, decisions: Sequence[Decision]) -> NDArray[np.bool_]:
        """Return in which runs (N,) all comparisons turn out as they did."""
        values = self._computed()
        alike = np.ones(self.runs, dtype=bool)
        for compare, a, b, outcome in decisions:
            same = compare(values[a], values[b]) == outcome
            if same is not True:
                alike &= same
        return alike

    def _take(self, places: Sequence[int]) -> list[Any]:
        values = self._computed()
        return [values[k] for k in places]

    def _computed(self) -> list[Any]:
        """Return the values of all steps."""
        if len(self._values) < len(self.recipe.steps):
            self._compute()
        return self._values

    @np.errstate(all="ignore")
    def _compute(self) -> None:
        """Add the values of steps that have come since."""
        values = self._values
        functions, sums = (ALONE, SUMS_ALONE) if self.runs == 1 else (TOGETHER, SUMS_TOGETHER)
        take = values.__getitem__
        for op, data, args in self.recipe.steps[len(values) :]:
            if op == CONSTANT:
                values.append(data)
            elif op == "literal":
                values.append(self.given[data])
            elif op == "entry":
                values.append(self._taken(values[args[0]][0][:, data]))
            elif op == "derived":
                values.append(self._derived(data, [values[k] for k in args]))
            else:
                values.append((sums.get(op) or functions[op])(*map(take, args)))

    def _derived(self, shared: Any, args: Sequence[Any]) -> tuple[Array, Array]:
        """Return all results of a call of ``derived`` in all runs (N, n), and which of them are kept."""
        rows = np.stack([np.broadcast_to(x, self.runs) for x in args], axis=1).tolist()
        lists = [derive(shared, row) for row in rows]
        return np.array([x for x, _ in lists], dtype=float), np.array([kept for _, kept in lists])

    def looked_up(self, x: Any, table: Any) -> Any:
        """Return a piecewise polynomial at x (N, ...), whose knots and coefficients may be others in each run; a number
        of a single run is one."""
        knots, rows, held = table
        own = self.table(knots), [self.table(row) for row in rows], None if held is None else self.table(held)
        xs = np.broadcast_to(x, (self.runs, *np.shape(x)[1:]))
        found = np.array([
            piecewise(xs[k], (own[0][k], [row[k] for row in own[1]], None if own[2] is None else own[2][k]))
            for k in range(self.runs)
        ])  # fmt: skip
        return float(found[0]) if self.runs == 1 and np.ndim(x) == 0 else found


class _Rows(Sequence[Any]):
    """The values of the recipe's steps in some of the runs (n,), each taken when it is asked for."""

    def __init__(self, whole: ManyNumbers, runs: NDArray[np.intp]) -> None:
        self._whole, self._runs = whole, runs
        self._known: dict[int, Any] = {}

    def __len__(self) -> int:
        return len(self._whole.recipe.steps)

    def __getitem__(self, k: Any) -> Any:
        if k not in self._known:
            self._known[k] = self._own(self._whole._computed()[k])
        return self._known[k]

    def _own(self, x: Any) -> Any:
        if isinstance(x, tuple):
            return tuple(map(self._own, x))
        if not isinstance(x, np.ndarray) or not x.ndim or len(x) != self._whole.runs:
            return x
        # a single run has numbers
        return float(x[self._runs[0]]) if x.ndim == 1 and len(self._runs) == 1 else x[self._runs]


class Expressions:
    """Expressions to be evaluated for many runs; their order of evaluation is found once.

    Values are those of constants, of symbols, and of operations, one after another.

    code : operations in order: name, places of arguments, data. places : of the outputs; None where one is a number,
    which ``outputs`` holds.
    """

    def __init__(self, outputs: Sequence[Scalar]) -> None:
        nodes = reachable(list(outputs))
        leaves = {op: [node for node in nodes if node.op == op] for op in ("const", "sym")}
        self.constants, self.symbols = ([node.value for node in group] for group in leaves.values())
        inner = [node for node in nodes if node.op not in leaves]
        place = {node.index: k for k, node in enumerate([*leaves["const"], *leaves["sym"], *inner])}
        self.code = [(node.op, [place[a.index] for a in node.args], node.value) for node in inner]
        self.places = [place[e.index] if isinstance(e, Expr) else None for e in outputs]
        self.outputs = [0.0 if isinstance(e, Expr) else e for e in outputs]


def _key(x: Any) -> int | str:
    """Return what tells numbers apart: those of the scene by how they are computed, others by their value."""
    return float(x).hex() if not isinstance(x, Fixed) and isinstance(x, (float, int)) else id(x)


def _inputs(x: Any) -> Sequence[Any]:
    """Return what a number is computed from."""
    if not isinstance(x, Fixed) or x.op == "literal":
        return ()
    inputs: Sequence[Any] = x.args[0] if x.op == "entry" else x.args
    return inputs


# -- operations -----------------------------------------------------------------------------------------
Operations = dict[str, Callable[..., Any]]


def _quotient(a: float, b: float) -> float:
    return a / b if b else float(np.divide(a, b))


def _summed(add: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    """Return a sum of numbers of the scene: what cancels is zero, as in the arithmetic of one of them."""

    def function(a: float, b: float) -> float:
        total: float = add(a, b)
        return 0.0 if abs(total) <= CANCELLED * max(abs(a), abs(b)) else total

    return function


def _summed_together(add: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    def function(a: Any, b: Any) -> Array:
        total = add(a, b)
        return np.where(np.abs(total) <= CANCELLED * np.maximum(np.abs(a), np.abs(b)), 0.0, total)

    return function


_SUMS: Operations = {"add": operator.add, "sub": operator.sub}
_PLAIN: Operations = {**_SUMS, "mul": operator.mul, "neg": operator.neg}
TOGETHER: Operations = {**APPLY, **_PLAIN}
# of numbers, which come out as they do in an array, to the bit
ALONE: Operations = {**_PLAIN, "div": _quotient, "where": where}
ALONE |= {op: getattr(np, NUMPY.get(op, op)) for op in TOGETHER if op not in ALONE}
SUMS_ALONE: Operations = {op: _summed(add) for op, add in _SUMS.items()}
SUMS_TOGETHER: Operations = {op: _summed_together(add) for op, add in _SUMS.items()}


class ByKeys:
    """d number / d place for places in the scene, as sparse rows {column: derivative}.

    Parameters
    ----------
    columns : of the places, such as ``robot.links.link1.mass``.

    Raises
    ------
    CapabilityError : on use, where a number follows from a place by a function without a derivative (base inertial
        parameters).
    """

    def __init__(self, columns: Mapping[str, int]) -> None:
        self.columns = dict(columns)
        self._known: dict[
            int, tuple[Any, SparseRow]
        ] = {}  # by identity, with the number, so that it stays its own

    def __call__(self, x: float) -> SparseRow:
        """Return the derivatives of one number."""
        if not isinstance(x, Fixed):
            return {}
        if x.op == "literal":
            column = self.columns.get(x.args[0])
            return {} if column is None else {column: 1.0}
        known = self._known.get(id(x))
        if known is None:
            known = self._known[id(x)] = x, self._of(x)
        return known[1]

    def _of(self, x: Fixed) -> SparseRow:
        if x.op == "entry":
            if any(self(y) for y in x.args[0]):
                raise CapabilityError("a base inertial parameter has no derivative by its numbers")
            return {}
        inner = [self(a) for a in x.args]
        row: SparseRow = {}
        if not any(inner):
            return row
        for k, slope in rules(x.op, x.args, x):
            for column, entry in inner[k].items():
                row[column] = row.get(column, 0.0) + slope * entry
        return {column: e for column, e in row.items() if is_nonzero(e)}
