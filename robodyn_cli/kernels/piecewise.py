"""Piecewise polynomials in generated code: knots and coefficients lie in a program's table of numbers.

n knots, n - 1 coefficients of each power from the lowest on, and the values held beyond the ends lie one after another.
"""

from __future__ import annotations

from robodyn_cli.kernels.ir import Function, Int, Value


def halvings(n: int) -> int:
    """Return how many halvings find one of n - 1 segments; so many need no test of their own."""
    return max(1, (n - 1).bit_length())


def piecewise(f: Function, x: Value, at: str, n: int, degree: int, held: bool) -> Value:
    """Return the polynomial at x, lane by lane; the numbers begin at the address ``at``."""
    rows = [f.offset(at, n + power * (n - 1)) for power in range(degree + 2)]
    results = []
    for k in range(x.width):
        u = f.lane(x, k)
        search = Search(f, u, at, n)
        for _ in range(halvings(n)):
            search.halve()
        i, s = search.found()
        value = f.load(f.offset(rows[degree], i))
        for power in reversed(range(degree)):
            value = f.load(f.offset(rows[power], i)) + s * value
        if held:
            value = beyond_ends(f, u, value, at, f.offset(at, n - 1), rows[-1])
        results.append(value)
    return f.pack(results, x.width)


def piecewise_of_shape(f: Function, u: Value, at: str, shape: list[Int], target: str) -> None:
    """Store the polynomial at u, one number, of which the code reads the shape: n, degree, held, halvings."""
    n, degree, held, times = shape
    search = Search(f, u, at, n)
    with f.count(times):
        search.halve()
    i, s = search.found()
    segments = n - 1
    row = f.offset(f.offset(at, n), i)
    f.store(f.load(f.offset(row, segments * degree)), target)
    with f.count(degree, down=True) as power:
        f.store(f.load(f.offset(row, segments * power)) + s * f.load(target), target)
    with f.when(f.compare_int("sgt", held, 0)):
        ends = f.offset(f.offset(at, n), segments * (degree + 1))
        f.store(beyond_ends(f, u, f.load(target), at, f.offset(at, segments), ends), target)


class Search:
    """The segment that a number lies in, by bisection of the n knots at an address."""

    def __init__(self, f: Function, u: Value, at: str, n: Int | int) -> None:
        self.f, self.u, self.at = f, u, at
        self.low, self.high = f.int_slot(), f.int_slot()
        f.store_int(0, self.low)
        f.store_int(n - 1, self.high)

    def halve(self) -> None:
        """Halve the interval, unless it is one segment."""
        f = self.f
        a, b = f.load_int(self.low), f.load_int(self.high)
        middle = f.emit_int(f"lshr i64 {(a + b).ref}, 1")
        right = f.compare("oge", self.u, f.load(f.offset(self.at, middle)))
        wider = f.compare_int("sgt", b - a, 1)
        f.store_int(f.select_int(right & wider, middle, a), self.low)
        f.store_int(f.select_int((~right) & wider, middle, b), self.high)

    def found(self) -> tuple[Int, Value]:
        """Return the segment, and how far behind its first knot the number lies."""
        i = self.f.load_int(self.low)
        return i, self.u - self.f.load(self.f.offset(self.at, i))


def beyond_ends(f: Function, u: Value, value: Value, first: str, last: str, ends: str) -> Value:
    """Return the value between the first and the last knot, and those held before and behind; u itself if NaN."""
    begin, end = f.load(first), f.load(last)
    inside = f.compare("oge", u, begin) & f.compare("olt", u, end)
    held = f.select(f.compare("olt", u, begin), f.load(ends), f.load(f.offset(ends, 1)))
    return f.select(inside, value, f.select(f.compare("uno", u, 0.0), u, held))
