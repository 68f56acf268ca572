"""Numbers of a scene that remember where they stand: compiled code reads them from a table.

A ``Fixed`` is a float in every respect, so whatever asks for its value gets it. Arithmetic with it gives another
``Fixed`` that knows how it was computed. The graph keeps them as constants; a program has them in a table beside its
code (``Program.numbers``), so that a scene with another mass has the same code. A float of the program itself (a zero,
an entry of a rotation, a coefficient of an algorithm) has no place and is part of the code.

Two ``Fixed`` are the same object when they are computed alike from the same places, in whatever thread, but for
results of two calls of ``derived``, which are told apart. That two of them have equal values is an accident: they are
never merged, and 1 and -1 are numbers like any other. Only a sum that cancels is zero.

Whatever Python decides by comparing such numbers is structure. ``witnessed`` lists these comparisons, so that it can be
asked whether other values would have decided alike (``expr/many.py``). Each thread has a list of its own.
"""

from __future__ import annotations

import contextlib
import math
import operator
import threading
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextvars import ContextVar
from typing import Any, TypeGuard
from weakref import ref

# Of the larger term: a smaller sum is what rounding leaves of a zero. The inputs themselves are not known better.
CANCELLED = 1e-15
ROUNDED = 1e-25  # of the largest result of a function that computes with 32 digits


class Fixed(float):
    """A number of the scene, or a result of such numbers alone; made by ``literal`` and by arithmetic.

    op, args : how it is computed. ``literal`` has the place in the scene as its argument: ``robot.links.link1.mass``;
    ``entry`` is one result of ``derived``, with all the inputs and its number.
    rank : orders numbers by how they are computed, the same in each process; values have no part in it.
    """

    __slots__ = ("__weakref__", "args", "op", "rank")
    __array_priority__ = 1000.0  # numpy leaves arithmetic with it to the methods below

    op: str
    args: tuple[Any, ...]
    rank: int
    __hash__ = float.__hash__

    def __reduce__(self) -> Any:
        return float, (float(self),)

    def __add__(self, other: Any) -> Any:
        return _binary("add", self, other)

    def __radd__(self, other: Any) -> Any:
        return _binary("add", other, self)

    def __sub__(self, other: Any) -> Any:
        return _binary("sub", self, other)

    def __rsub__(self, other: Any) -> Any:
        return _binary("sub", other, self)

    def __mul__(self, other: Any) -> Any:
        return _binary("mul", self, other)

    def __rmul__(self, other: Any) -> Any:
        return _binary("mul", other, self)

    def __truediv__(self, other: Any) -> Any:
        return _binary("div", self, other)

    def __rtruediv__(self, other: Any) -> Any:
        return _binary("div", other, self)

    def __pow__(self, other: Any, modulo: None = None) -> Any:
        return _binary("pow", self, other)

    def __rpow__(self, other: Any, modulo: None = None) -> Any:
        return _binary("pow", other, self)

    def __neg__(self) -> Any:
        return self.args[0] if self.op == "neg" else _made("neg", (self,), -float(self))

    def __pos__(self) -> Fixed:
        return self

    def __abs__(self) -> Any:
        return _made("abs", (self,), abs(float(self)))


# comparisons made so far: operator, two numbers (or the entry of a derived one and None), and the outcome
Witness = tuple[str, Any, Any, bool]
_witnesses: ContextVar[list[Witness] | None] = ContextVar("_witnesses", default=None)


@contextlib.contextmanager
def witnessed() -> Iterator[list[Witness]]:
    """Give the list of all comparisons with numbers of the scene that this thread makes inside the block."""
    witnesses: list[Witness] = []
    token = _witnesses.set(witnesses)
    try:
        yield witnesses
    finally:
        _witnesses.reset(token)


def is_witnessed() -> bool:
    """Tell whether this thread lists its comparisons."""
    return _witnesses.get() is not None


def _value_with_array(name: str, reflected: str) -> Callable[[Any, Any], Any]:
    """Return a method of floats that also takes numpy's arrays, which leave it to us as they do arithmetic."""
    own = getattr(float, name)

    def method(self: Fixed, other: Any) -> Any:
        if hasattr(other, "dtype"):
            return getattr(other, reflected)(float(self))
        outcome = own(self, other)
        if (witnesses := _witnesses.get()) is not None and isinstance(outcome, bool):
            witnesses.append((name.strip("_"), self, other, outcome))
        return outcome

    return method


def _is_true(x: Fixed) -> bool:
    outcome = float(x) != 0.0
    if (witnesses := _witnesses.get()) is not None:
        witnesses.append(("ne", x, 0.0, outcome))
    return outcome


_MIRRORED = [
    ("lt", "gt"),
    ("le", "ge"),
    ("eq", "eq"),
    ("ne", "ne"),
    ("mod", "rmod"),
    ("floordiv", "rfloordiv"),
]
for _name, _other in {*_MIRRORED, *((b, a) for a, b in _MIRRORED)}:
    setattr(Fixed, f"__{_name}__", _value_with_array(f"__{_name}__", f"__{_other}__"))
Fixed.__bool__ = _is_true  # type: ignore[method-assign,assignment]

# those that are in use, by what they are computed from, and some that are not any more
_known: dict[Any, ref[Fixed]] = {}
_most = [4096]  # so many of both, then the others go: there may be a quarter of those in use
_making = threading.RLock()  # a finalizer that runs meanwhile may make a number too


def literal(value: float, place: str) -> float:
    """Return a number of the scene at its place; zero is structure and stays a plain float."""
    return _made("literal", (place, float(value)), float(value)) if value else 0.0


def free(value: float, place: str) -> Fixed:
    """Return a number of the scene that is no structure whatever it is: zero, a default, an angle of an attitude."""
    return _made("literal", (place, float(value), "free"), float(value))


def is_free(x: Any) -> bool:
    """Tell whether ``x`` is a number that ``free`` made."""
    return isinstance(x, Fixed) and x.op == "literal" and len(x.args) > 2


class _Inputs(list[float]):
    """What all results of one call of ``derived`` are computed from, and by which function."""

    function: Callable[[Sequence[float]], Sequence[float]]
    rank: int


def derived(function: Callable[[Sequence[float]], Sequence[float]], inputs: Sequence[float]) -> list[float]:
    """Return what a function of numbers gives, each entry as a number that is computed from the inputs."""
    shared = _Inputs(inputs)
    shared.function, shared.rank = function, _rank("derived", inputs)
    entries, kept = derive(shared, [float(x) for x in inputs])
    if (witnesses := _witnesses.get()) is not None:
        witnesses.extend(("kept", (shared, k), None, keeps) for k, keeps in enumerate(kept))
    return [
        _made("entry", (shared, k), float(x)) if keeps else 0.0
        for k, (x, keeps) in enumerate(zip(entries, kept))
    ]


def derive(inputs: _Inputs, values: Sequence[float]) -> tuple[Sequence[float], list[bool]]:
    """Return what the function of some inputs gives for other values, and which entries are no structural zeros.

    A zero that other numbers do not share is no structure, such as the difference of two equal moments of inertia.
    """
    entries = inputs.function(values)
    others = inputs.function(
        [
            value * (1.0 + 0.1 * math.sin(k + 1)) if isinstance(x, Fixed) else value
            for k, (x, value) in enumerate(zip(inputs, values))
        ]
    )
    least = ROUNDED * max([abs(x) for x in (*entries, *others)], default=0.0)
    return entries, [abs(x) > least or abs(y) > least for x, y in zip(entries, others)]


def is_plain(x: Any, value: float) -> bool:
    """Tell whether ``x`` is this number as structure, not a number of the scene that happens to have its value."""
    return not isinstance(x, Fixed) and bool(x == value)


def places(numbers: Iterable[object]) -> list[str]:
    """Return the places in the scene of all numbers that these are computed from, in order."""
    keys: set[str] = set()
    seen: set[int] = set()
    pending: list[object] = list(numbers)
    while pending:
        x = pending.pop()
        if not isinstance(x, (Fixed, _Inputs)) or id(x) in seen:
            continue
        seen.add(id(x))
        if isinstance(x, _Inputs):
            pending.extend(x)
        elif x.op == "literal":
            keys.add(x.args[0])
        else:
            pending.extend(x.args)
    return sorted(keys)


def is_negated(x: Any) -> TypeGuard[Fixed]:
    """Tell whether a number of the scene is the negative of another; signs are kept outside of tables."""
    return isinstance(x, Fixed) and x.op == "neg"


def applied(op: str, function: Callable[..., float], *args: float) -> float:
    """Return an elementary function of numbers at least one of which is ``Fixed``."""
    return _made(op, args, function(*[float(x) for x in args]))


def _made(op: str, args: tuple[Any, ...], value: float) -> Fixed:
    key = (op, *[id(x) if isinstance(x, (Fixed, _Inputs)) else ("plain", x) for x in args])
    known = _known.get(key)
    if known is not None and (found := known()) is not None:
        return found
    made = Fixed(value)
    made.op, made.args, made.rank = op, args, _rank(op, args)
    with _making:
        found = _known.setdefault(key, kept := ref(made))()  # another thread may have made it since
        if found is None:
            found, _known[key] = made, kept
        if len(_known) > _most[0]:
            for old, number in _known.copy().items():
                if number() is None:
                    del _known[old]
            _most[0] = max(5 * len(_known) // 4, _most[0])
    return found


def _rank(op: str, args: Iterable[Any]) -> int:
    """Return the rank of a number that is computed so; that of a literal follows from its place alone."""
    if op == "literal":
        args = [x for x in args if isinstance(x, str)]
    return hash((
        zlib.crc32(op.encode()),
        *[
            x.rank
            if isinstance(x, (Fixed, _Inputs))
            else zlib.crc32(x.encode())  # Python's own hashes of texts are others in each process
            if isinstance(x, str)
            else x
            for x in args
        ],
    ))  # fmt: skip


_PLAIN: dict[str, Callable[[Any, Any], Any]] = {
    "add": operator.add,
    "sub": operator.sub,
    "mul": operator.mul,
    "div": operator.truediv,
    "pow": operator.pow,
}


def _binary(op: str, a: Any, b: Any) -> Any:
    if not (isinstance(a, Fixed) and isinstance(b, Fixed)):
        plain = b if isinstance(a, Fixed) else a
        if not isinstance(plain, (float, int)):
            return _with_array(op, a, b) if hasattr(plain, "dtype") else NotImplemented
        if plain == 0.0 or plain == 1.0 or plain == -1.0:
            known = _neutral(op, a, b, plain)
            if known is not None:
                return known
    if op in ("add", "sub"):
        if is_negated(b):
            return a - b.args[0] if op == "add" else a + b.args[0]
        if is_negated(a):
            return b - a.args[0] if op == "add" else -(a.args[0] + b)
        total = _sum(op, a, b)
        return total if total or not (float(a) or float(b)) else 0.0  # a sum of zeros does not cancel
    if op != "pow":
        for k, z in enumerate((a, b)):
            if z.op == "neg" if isinstance(z, Fixed) else z < 0.0:
                positive = z.args[0] if isinstance(z, Fixed) else -z
                return -(_binary(op, positive, b) if k == 0 else _binary(op, a, positive))
    value = _PLAIN[op](float(a), float(b))
    return (
        _made(op, _sorted(op, a, b), value) if isinstance(value, float) and not math.isnan(value) else value
    )


def _neutral(op: str, a: Any, b: Any, plain: float) -> Any:
    """Return the result of arithmetic with a plain 0, 1 or -1 where that needs no new number, else None."""
    other = a if plain is b else b
    if op in ("add", "sub"):
        if plain != 0.0:
            return None
        return -b if op == "sub" and plain is a else other
    if op == "mul":
        return 0.0 if plain == 0.0 else other if plain == 1.0 else -other
    if plain is b:
        return a if plain == 1.0 else None
    return 0.0 if op == "div" and plain == 0.0 and float(b) else None


def _sum(op: str, a: float, b: float) -> Fixed:
    """Return a + b or a - b; where they cancel a number that is zero."""
    x, y = float(a), float(b)
    total = x + y if op == "add" else x - y
    if math.isfinite(total) and abs(total) <= CANCELLED * max(abs(x), abs(y)):
        total = 0.0
    return _made(op, _sorted(op, a, b), total)


def collected(op: str, a: float, b: float) -> float:
    """Return the number of a x + b x or a x - b x; two of the scene that happen to cancel are no structural zero."""
    if isinstance(a, Fixed) or isinstance(b, Fixed):
        return _sum(op, a, b)
    return a + b if op == "add" else a - b


def _sorted(op: str, a: float, b: float) -> tuple[float, float]:
    """Return the arguments, those of a commutative operation in an order that does not depend on the memory."""
    a, b = (x if isinstance(x, Fixed) else float(x) for x in (a, b))
    if op not in ("add", "mul"):
        return a, b
    if not isinstance(a, Fixed) or not isinstance(b, Fixed):
        return (a, b) if isinstance(b, Fixed) else (b, a)
    return (b, a) if (b.rank, id(b)) < (a.rank, id(a)) else (a, b)


def _with_array(op: str, a: Any, b: Any) -> Any:
    """Return the result of arithmetic with numpy's numbers: entry by entry with objects, else with the value alone."""
    if not all(isinstance(x, Fixed) or x.dtype == object for x in (a, b)):
        return _PLAIN[op](*[float(x) if isinstance(x, Fixed) else x for x in (a, b)])
    array = b if isinstance(a, Fixed) else a
    out = array.copy()
    for place, x in enumerate(array.flat):
        out.flat[place] = _PLAIN[op](a, x) if array is b else _PLAIN[op](x, b)
    return out
