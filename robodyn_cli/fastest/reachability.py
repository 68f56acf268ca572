"""The fastest way through a chain of segments, as one compiled loop: a pass backward and a pass forward.

A point i of the chain has a number x_i >= 0. In a segment between x0 and x1 every row j bounds a number m twice,

    k0_j x0 + low0_j <= m <= k0_j x0 + high0_j,    k1_j x1 + low1_j <= m <= k1_j x1 + high1_j

and some m has to be left. In an ``even`` segment the first bounds hold for x1 in place of m, the second ones for x0.
"""

from __future__ import annotations

import ctypes
import hashlib
from collections.abc import Callable
from functools import lru_cache

import numpy as np

from robodyn_cli.kernels.arrays import Array as Numbers
from robodyn_cli.kernels.compiler import compile_module
from robodyn_cli.kernels.ir import STRICT, Condition, Function, Int, Value, module
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

FAR = 1e30  # stands for no bound
NEWTON = 100
ROUNDING = 1e-13  # of two bounds, as far as they may seem to cross
EMPTY = 1e-12  # of a bound, as far as rounding may turn an interval over
ROWS = ("k0", "low0", "high0", "k1", "low1", "high1")
ARRAYS = (*ROWS, "even", "low", "high", "x")


@record
class PassChain:
    """The rows of K segments, each (K, n), and which segments are ``even`` (K,)."""

    k0: Array
    low0: Array
    high0: Array
    k1: Array
    low1: Array
    high1: Array
    even: Array


def fastest_through(chain: PassChain, most: Array, start: float, end: float) -> Array | int:
    """Return the largest x (K + 1,) from ``start`` to ``end`` with x <= ``most``, or the point that none can pass."""
    count, n = chain.k0.shape
    low, high = np.zeros(count + 1), np.minimum(most, FAR)
    if end > high[-1]:
        return count
    low[-1] = high[-1] = end
    x = np.full(count + 1, float(start))
    arrays = [np.ascontiguousarray(getattr(chain, name), dtype=float) for name in (*ROWS, "even")]
    stopped = int(_passes()(*(a.ctypes.data for a in (*arrays, low, high, x)), count, n))
    return x if stopped < 0 else stopped


@lru_cache(maxsize=1)
def _passes() -> Callable[..., int]:
    text = write_passes()
    compiled = compile_module(f"passes {hashlib.sha256(text.encode()).hexdigest()}", lambda: text)
    types = [*[ctypes.c_void_p] * len(ARRAYS), ctypes.c_int64, ctypes.c_int64]
    return compiled.function("passes", *types, result=ctypes.c_int64)


def write_passes() -> str:
    """Return the IR of ``passes(rows..., even, low, high, x, K, n)``; -1, or the point that none can pass.

    low, high : (K + 1,), the interval of each x, which is narrowed. x : (K + 1,), the first of them given.
    """
    f = Function(
        "passes",
        [*(f"ptr noalias %{name}" for name in ARRAYS), "i64 %K", "i64 %n"],
        result="i64",
        flags=STRICT,
    )
    low, high, x = (Numbers(f, f"%{name}") for name in ("low", "high", "x"))
    count = f.int_argument("K")
    with f.count(count, down=True) as i:
        segment = _Segment(f, i)
        _narrow(f, i + 1, lambda at: segment.end("1", at))
        _narrow(f, i, lambda at: segment.end("0", at))
        _narrow(f, i, segment.ahead)
    with f.when(f.compare("olt", x[0], low[0]) | f.compare("ogt", x[0], high[0])):
        f.ret(0)
    with f.count(count) as i:
        _, most = _Segment(f, i).ahead(x[i])
        x[i + 1] = f.max(most.value, low[i + 1])
    f.ret(-1)
    return module([f])


class _Bound:
    """The tightest of many lines at x, offset + slope x."""

    def __init__(self, f: Function, x: Value, upper: bool) -> None:
        self.f, self.x, self.tighter = f, x, "olt" if upper else "ogt"
        self.slots = [f.slot() for _ in range(3)]
        far = FAR if upper else -FAR
        for slot, start in zip(self.slots, (far, 0.0, far)):
            f.store(start, slot)

    offset = property(lambda self: self.f.load(self.slots[0]))
    slope = property(lambda self: self.f.load(self.slots[1]))
    value = property(lambda self: self.f.load(self.slots[2]))

    def take(self, offset: Value, slope: Value, where: Condition | None = None) -> None:
        """Take a line, where it is allowed to count, if it is tighter."""
        f, value = self.f, offset + slope * self.x
        better = f.compare(self.tighter, value, self.value)
        better = better if where is None else better & where
        for slot, new in zip(self.slots, (offset, slope, value)):
            f.store(f.select(better, new, f.load(slot)), slot)


Bounds = tuple[_Bound, _Bound]  # lower, upper


class _Segment:
    """Code for the rows of segment ``i``."""

    def __init__(self, f: Function, i: Int) -> None:
        self.f, self.i, self.n = f, i, f.int_argument("n")
        self.rows = {name: Numbers(f, f.offset(f"%{name}", i * self.n)) for name in ROWS}
        self.even = f.compare("one", f.load(f.offset("%even", i)), 0.0)

    def end(self, which: str, x: Value) -> Bounds:
        """Return the bounds of m by the rows at one end."""
        f, (k, low, high) = self.f, (self.rows[name + which] for name in ("k", "low", "high"))
        least, most = _Bound(f, x, upper=False), _Bound(f, x, upper=True)
        with f.count(self.n) as j:
            slope = k[j]
            least.take(low[j], slope)
            most.take(high[j], slope)
        return least, most

    def ahead(self, x: Value) -> Bounds:
        """Return the bounds of x1 at x0 = x."""
        f, rows = self.f, self.rows
        zero, one = f.constant(0.0), f.constant(1.0)
        least, most = _Bound(f, x, upper=False), _Bound(f, x, upper=True)
        middle = []
        for bound, own, name in zip((least, most), self.end("0", x), ("%low", "%high")):
            bound.take(f.load(f.offset(name, self.i + 1)), zero)
            bound.take(own.offset, own.slope, self.even)
            middle.append((f.select(self.even, zero, own.offset), f.select(self.even, one, own.slope)))
        # the rows at the end hold for some number between these
        (low, low_slope), (high, high_slope) = middle
        with f.count(self.n) as j:
            k = rows["k1"][j]
            rising, counts = f.compare("ogt", k, 0.0), f.compare("one", k, 0.0)
            above, below = (high - rows["low1"][j]) / k, (low - rows["high1"][j]) / k
            steep, flat = high_slope / k, low_slope / k
            most.take(f.select(rising, above, below), f.select(rising, steep, flat), counts)
            least.take(f.select(rising, below, above), f.select(rising, flat, steep), counts)
        return least, most


def _narrow(f: Function, point: Int, bounds: Callable[[Value], Bounds]) -> None:
    """Shrink the interval of a point to where lower bounds lie below upper ones; return the point if none is left.

    The gap between the bounds is concave, so that Newton's method comes closer from outside on both sides.
    """
    low, high = (f.offset(name, point) for name in ("%low", "%high"))
    for address, inward in ((low, "ogt"), (high, "olt")):
        rounds = f.int_slot()
        f.store_int(0, rounds)
        with f.loop() as newton:
            x = f.load(address)
            least, most = bounds(x)
            size = f.abs(least.value) + f.abs(most.value)
            newton.leave(f.compare("oge", most.value - least.value, -ROUNDING * size))
            root = (least.offset - most.offset) / (most.slope - least.slope)
            newton.leave(unless=f.compare(inward, root, x))
            f.store(root, address)
            newton.leave(f.compare_int("sge", f.bump(rounds), NEWTON))
    least_x, most_x = f.load(low), f.load(high)
    with f.when(f.compare("ogt", least_x, most_x * (1.0 + EMPTY))):
        f.ret(point)
    f.store(f.min(least_x, most_x), low)
