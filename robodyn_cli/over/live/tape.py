"""Arrays that record what functions of numpy do with them.

What is recorded is a list of operations on flat arrays of doubles, which ``report/page/rules.js`` works off: all
shapes, axes and indices are known while it is recorded, so that they become indices. An array carries values of an
example, which give shapes and tell a test what has to come out.

Branches of a rule must not depend on values. Two ways of asking are answered so that no short cut is taken: something
holds in some run, and not in all; and rows that a condition selects are all there, with the condition as a value.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Values = NDArray[Any]
# the same element by element, with an entry of each argument
ELEMENTWISE = frozenset({
    "add", "subtract", "multiply", "divide", "negative", "absolute", "sqrt", "power", "minimum", "maximum", "rint",
    "floor", "sign", "isfinite", "isnan", "less", "less_equal", "greater", "greater_equal", "equal", "not_equal",
    "logical_and", "logical_or", "logical_not", "where", "exp", "log", "arctan2", "degrees",
})  # fmt: skip
LOGICAL = {"bitwise_and": "logical_and", "bitwise_or": "logical_or", "invert": "logical_not"}
REDUCED = {"amax": "max", "max": "max", "amin": "min", "min": "min", "sum": "sum", "all": "all", "any": "any"}
# functions that only put entries elsewhere
MOVED = frozenset({
    "reshape", "transpose", "swapaxes", "concatenate", "stack", "vstack", "append", "delete", "broadcast_to", "copy",
    "expand_dims", "atleast_1d", "ravel", "moveaxis", "repeat", "tile",
    "hstack",
})  # fmt: skip


# functions that are recorded in a way of their own, by name (over/live/rules.py)
SPECIAL: dict[str, Callable[..., Any]] = {}


class Tape:
    """The operations in order: name, places of the arguments, data."""

    def __init__(self) -> None:
        self.code: list[list[Any]] = []
        self.examples: dict[str, Values] = {}  # of what is given, by name
        self.assumed: list[Recorded] = []  # what has to hold where the rule goes one of several ways
        self.doubts: list[Recorded] = []  # which columns may jump where the rule takes it that they do not
        self._constants: dict[Any, int] = {}  # places, by shape and values

    def input(self, name: str, example: Any) -> Recorded:
        """Return what is given under a name; example : what has its shape."""
        values = np.asarray(example)
        self.examples[name] = values
        return self._note(values, "input", [], name)

    def constant(self, x: Any) -> Recorded:
        values = np.asarray(x)
        numbers = values.ravel().tolist()
        known = self._constants.get(tuple(numbers))
        if known is not None:
            return Recorded(self, known, values)
        made = self._note(values, "constant", [], plain(numbers))
        self._constants[tuple(numbers)] = made.place
        return made

    def lift(self, x: Any) -> Recorded:
        return x if isinstance(x, Recorded) else self.constant(x)

    def _note(self, values: Values, op: str, args: Sequence[Recorded], *data: Any) -> Recorded:
        self.code.append([op, [a.place for a in args], *data])
        return Recorded(self, len(self.code) - 1, values)

    # -- operations -----------------------------------------------------------------------------------
    def elementwise(self, op: str, args: Sequence[Any], values: Values) -> Recorded:
        """Return a function entry by entry; arguments of one entry serve all."""
        own = [self.lift(a) for a in args]
        spread = [
            a if a.size == 1 or a.shape == values.shape else self.moved(np.broadcast_to, [a], values.shape)
            for a in own
        ]
        return self._note(values, op, spread)

    def moved(
        self, function: Callable[..., Any], arrays: Sequence[Recorded], *more: Any, **named: Any
    ) -> Recorded:
        """Return what a function makes of entries that it only puts elsewhere; it gets arrays of their numbers."""
        starts = np.cumsum([0, *(a.size for a in arrays)])
        numbers = [s + np.arange(a.size).reshape(a.shape) for s, a in zip(starts, arrays)]
        places = np.asarray(function(*numbers, *more, **named))
        entries = np.concatenate([a.example.ravel() for a in arrays])[places]
        flat = places.ravel().tolist()
        if len(arrays) == 1 and flat == list(range(arrays[0].size)):
            return Recorded(self, arrays[0].place, entries)
        return self._note(entries, "take", arrays, _packed(places))

    def reduced(self, op: str, x: Recorded, axis: Any, values: Values, initial: Any = None) -> Recorded:
        """Return rows combined to one entry each."""
        axes = range(x.ndim) if axis is None else np.atleast_1d(axis).tolist()
        axes = [k % x.ndim for k in axes]
        kept = [k for k in range(x.ndim) if k not in axes]
        rows = self.moved(np.transpose, [x], [*kept, *axes])
        length = math.prod(x.shape[k] for k in axes)
        return self._note(np.asarray(values), op, [rows], length, None if initial is None else float(initial))

    def gathered(self, x: Recorded, index: Sequence[Any]) -> Recorded:
        """Return the entries of x (T, n) in rows and columns (...) of which values decide."""
        rows, columns = index
        places = rows * x.shape[1] + columns
        return self._note(x.example[tuple(map(example_of, index))], "gather", [x, self.lift(places)])

    def scattered(self, x: Recorded, index: Sequence[Any], value: float) -> Recorded:
        """Return x (T, n) with a number in rows and columns (...) of which values decide."""
        rows, columns = index
        entries = x.example.copy()
        entries[tuple(map(example_of, index))] = value
        places = self.lift(rows * x.shape[1] + columns)
        return self._note(entries, "scatter", [x, places], *plain([value]))

    def holds(self, condition: Recorded) -> bool:
        """Take it that a condition holds: an output of the rule says whether it does."""
        self.assumed.append(condition)
        return True

    def matrices(self, op: str, args: Sequence[Any], values: Values, *data: Any) -> Recorded:
        """Return an operation on matrices, one a leading index."""
        return self._note(np.asarray(values), op, [self.lift(a) for a in args], *data)

    def assigned(self, x: Recorded, index: Any, value: Any) -> Recorded:
        """Return an array with other entries in some places."""
        places = np.arange(x.size).reshape(x.shape)[index]
        own = self.lift(value)
        if own.size != places.size:
            own = self.moved(np.broadcast_to, [own], places.shape)
        merged = np.arange(x.size)
        merged[places.ravel()] = x.size + np.arange(places.size)
        joined = [x, own]
        entries = np.concatenate([a.example.ravel() for a in joined])[merged].reshape(x.shape)
        return self._note(entries, "take", joined, _packed(merged))


class Recorded(np.lib.mixins.NDArrayOperatorsMixin):
    """An array whose entries are known later. example : one of its values. place : of what made it on the tape."""

    def __init__(self, tape: Tape, place: int, example: Values) -> None:
        self.tape, self.place, self.example = tape, place, np.asarray(example)

    shape = property(lambda self: self.example.shape)
    ndim = property(lambda self: self.example.ndim)
    size = property(lambda self: self.example.size)
    dtype = property(lambda self: self.example.dtype)

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **named: Any) -> Any:
        name = LOGICAL.get(ufunc.__name__, ufunc.__name__)
        values = getattr(ufunc, method)(*map(example_of, inputs))
        if name == "matmul":
            return _matmul(self.tape, inputs, values)
        if method != "__call__" or name not in ELEMENTWISE:
            return NotImplemented
        return self.tape.elementwise(name, inputs, values)

    def __array_function__(self, function: Any, types: Any, args: Any, named: Any) -> Any:
        name = function.__name__
        if name in SPECIAL:
            return SPECIAL[name](self.tape, *args, **named)
        if name in MOVED:
            first = args[0]
            arrays = [self.tape.lift(a) for a in (first if isinstance(first, (list, tuple)) else [first])]
            if name in ("concatenate", "stack", "vstack", "hstack"):
                return self.tape.moved(
                    lambda *x: function(x[: len(arrays)], *x[len(arrays) :], **named), arrays, *args[1:]
                )
            if name == "append":
                return self.tape.moved(function, [self.tape.lift(a) for a in args[:2]], *args[2:], **named)
            return self.tape.moved(function, arrays, *args[1:], **named)
        if name in REDUCED:
            return _reduce(self.tape, REDUCED[name], *args, **named)
        return NotImplemented

    # -- methods of arrays ----------------------------------------------------------------------------
    def max(self, axis: Any = None, **named: Any) -> Any:
        return _reduce(self.tape, "max", self, axis, **named)

    def min(self, axis: Any = None, **named: Any) -> Any:
        return _reduce(self.tape, "min", self, axis, **named)

    def sum(self, axis: Any = None, **named: Any) -> Any:
        return _reduce(self.tape, "sum", self, axis, **named)

    def all(self, axis: Any = None, **named: Any) -> Any:
        return _reduce(self.tape, "all", self, axis, **named)

    def any(self, axis: Any = None, **named: Any) -> Any:
        return _reduce(self.tape, "any", self, axis, **named)

    def copy(self) -> Recorded:
        return Recorded(self.tape, self.place, self.example)

    def reshape(self, *shape: Any) -> Recorded:
        return self.tape.moved(np.reshape, [self], shape[0] if len(shape) == 1 else shape)

    def ravel(self) -> Recorded:
        return self.reshape(-1)

    def transpose(self, *axes: int) -> Recorded:
        return self.tape.moved(np.transpose, [self], axes or None)

    T = property(transpose)

    def __len__(self) -> int:
        return len(self.example)

    def __bool__(self) -> bool:
        """Answer a question about all runs so that nothing is left out."""
        op, args = self.tape.code[self.place][:2]
        if op == "all" and self.tape.code[args[0]][0] == "isfinite":
            return self.tape.holds(self)
        if op in ("any", "all"):
            return bool(op == "any")
        raise TypeError(f"a rule branches on values: {op}")

    def __getitem__(self, index: Any) -> Recorded:
        if isinstance(index, ChosenRows):
            return self
        if _is_told_by_values(index):
            return self.tape.gathered(self, index)
        return self.tape.moved(lambda x: x[index], [self])

    def __setitem__(self, index: Any, value: Any) -> None:
        if isinstance(index, ChosenRows):
            changed = self.tape.lift(value)
        elif _is_told_by_values(index):
            changed = self.tape.scattered(self, index, value)
        else:
            changed = self.tape.assigned(self, index, value)
        self.place, self.example = changed.place, changed.example


class ChosenRows(Recorded):
    """The rows that a condition holds for: of one run it or none. It stands for all of them."""

    def __len__(self) -> int:
        return 1


def _is_told_by_values(index: Any) -> bool:
    return isinstance(index, tuple) and any(isinstance(x, Recorded) for x in index)


def example_of(x: Any) -> Any:
    return x.example if isinstance(x, Recorded) else x


def plain(xs: Iterable[float]) -> list[Any]:
    """Return numbers as JSON has them: whole ones short, and what JSON lacks as words of JavaScript."""
    words = {math.inf: "Infinity", -math.inf: "-Infinity"}
    return [
        (int(x) if x == int(x) and abs(x) < 1e15 else x) if math.isfinite(x) else words.get(x, "NaN")
        for x in map(float, xs)
    ]


def _packed(places: NDArray[Any]) -> dict[str, Any] | list[int]:
    """Return places as those of a strided array where they are one, else as runs: first, count, and so on."""
    if places.size and places.ndim:
        axes = [axis for axis in range(places.ndim) if places.shape[axis] > 1]
        first, shape = int(places.flat[0]), [places.shape[axis] for axis in axes]
        beside = [tuple(int(k == axis) for k in range(places.ndim)) for axis in axes]
        strides = [int(places[at]) - first for at in beside]
        whole = first + sum((np.arange(n).reshape(-1, *[1] * (len(shape) - k - 1)) * s
                             for k, (n, s) in enumerate(zip(shape, strides))), start=np.array(0))  # fmt: skip
        if (np.ravel(whole) == places.ravel()).all():
            return {"first": first, "shape": shape, "strides": strides}
    runs: list[list[int]] = []
    for k in places.ravel().tolist():
        if runs and runs[-1][0] + runs[-1][1] == k:
            runs[-1][1] += 1
        else:
            runs.append([k, 1])
    return [x for run in runs for x in run]


def _reduce(
    tape: Tape, op: str, x: Any, axis: Any = None, initial: Any = None, keepdims: bool = False
) -> Any:
    more = {} if initial is None else {"initial": initial}
    values = getattr(x.example, op)(axis=axis, keepdims=keepdims, **more)
    return tape.reduced(op, x, axis, values, initial)


def _matmul(tape: Tape, inputs: Sequence[Any], values: Values) -> Recorded:
    a, b = (tape.lift(x) for x in inputs)
    if a.ndim == 1:
        return _matmul(tape, (a[None], b), values[None])[0]
    lead = values.shape[:-2]
    a, b = (tape.moved(np.broadcast_to, [x], (*lead, *x.shape[-2:])) for x in (a, b))
    return tape.matrices("matmul", [a, b], values, a.shape[-2], a.shape[-1], b.shape[-1])
