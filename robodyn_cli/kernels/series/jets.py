"""Taylor series of the solution of x-dot = f(x), emitted as a loop over orders from the program of f.

    x(t + h) = sum_n x_n h^n,    n x_n = f_{n-1}

Coefficients of operations follow from convolutions (Jorba and Zou 2005; for g, w and u see ``rules``):

    (u w)_n = sum_{i=0}^{n} u_i w_{n-i}
    (u / w)_n w_0 = u_n - sum_{i=1}^{n} w_i (u / w)_{n-i}
    n g_0 y_n = sum_k s_k sum_{i=1}^{n} (i u_k,i) w_k,n-i - sum_{j=1}^{n-1} (j y_j) g_{n-j}

All but a few terms of two orders are known before these begin. A loop sums them for both at once, which halves what is
loaded, and for several convolutions, so that no sum waits for another. A square has half the terms. What has kinks
takes the branch on which it is at the start.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from robodyn_cli.kernels.arrays import Array, Total
from robodyn_cli.kernels.ir import Condition, Function, Int, Value
from robodyn_cli.kernels.series.rules import Series

FLAT = frozenset({"sign", "round", "table"})  # slopes are zero but for jumps; of tables those of degree 0
KINKED = frozenset({"where", "min", "max", "abs"})
TOGETHER = 8  # sums of one loop: as many as keep two units busy that take four cycles for each term


class SeriesColumn(NamedTuple):
    """Coefficients of a series, or of its rate: each times its order."""

    series: int
    of_rate: bool = False


Pair = tuple[SeriesColumn, SeriesColumn]


class Coefficients:
    """Coefficients of states in memory, a row an order; of the first nq states there is one more.

    columns : where in a row of ``width`` entries each state is.
    """

    def __init__(self, rows: Array, width: int, columns: Sequence[int], order: int, nq: int) -> None:
        self.f, self.rows, self.width = rows.f, rows, width
        self.columns, self.order, self.nq = columns, order, nq

    def at(self, state: int, n: Int | int) -> Value:
        """Return coefficient n of a state."""
        return self.rows[n * self.width + self.columns[state]]

    def along(self, h: Value) -> Iterator[tuple[Value, Value]]:
        """Emit the value and the slope of each state at h by Horner's scheme."""
        f, zero = self.f, self.f.constant(0.0, h.width)
        for first in range(0, len(self.columns), TOGETHER // 2):
            states = range(len(self.columns))[first : first + TOGETHER // 2]
            values, slopes = (Array(f, f.slot(h.width, len(states)), h.width) for _ in range(2))
            for k, c in enumerate(states):
                x, slope = f.lift(self.at(c, self.order), h.width), zero
                if c < self.nq:
                    slope = f.lift(self.at(c, self.order + 1), h.width)
                    x = f.muladd(slope, h, x)
                values[k], slopes[k] = x, slope
            with f.count(self.order, down=True) as n:
                for k, c in enumerate(states):
                    slopes[k] = f.muladd(slopes[k], h, values[k])
                    values[k] = f.muladd(values[k], h, self.at(c, n))
            for k in range(len(states)):
                yield values[k], slopes[k]


class Jets:
    """Coefficients along a solution, emitted as a loop over their orders.

    Parameters
    ----------
    series : of the rates, outputs ``a`` (nv) and ``z``. start : the values of its instructions ``read``. state :
    x_0 = (q, v, z), where q-dot = v.
    """

    def __init__(
        self, f: Function, series: Series, start: Mapping[int, Value], state: Sequence[Value], nv: int
    ) -> None:
        self.f, self.series, self.width, self.nv = f, series, state[0].width, nv
        self.code = series.program.instructions
        self._start = {
            **start,
            **{len(self.code) + k: x for k, x in enumerate(state)},
        }  # states behind the code
        first, outputs = len(self.code), series.program.outputs
        self._states = range(first, first + len(state))
        rates: list[int | float] = [first + nv + k for k in range(nv)]
        rates += [*outputs.get("a", ()), *outputs.get("z", ())]
        self._rates = dict(zip(self._states, rates))  # a series, or a number
        places = {"q": first, "v": first + nv, "z": first + 2 * nv}
        # the state that an instruction is
        self._state_of = {
            k: places[i.value[0]] + i.value[1]
            for k, i in enumerate(self.code)
            if i.op == "sym" and i.value[0] in places
        }
        self._still = self._without_rate()
        self._pairs = [list(map(_key, self._pairs_of(k))) for k in range(len(self.code))]
        self._sums = _shared([pair for pairs in self._pairs for pair in pairs])
        kept = [SeriesColumn(k) for k in self._states]
        kept += [self._column(r) for r in rates if isinstance(r, int)]
        kept += [column for pair in self._sums for column in pair]
        # n q_n = v_{n-1} is there already: in the row before
        before = {SeriesColumn(q, True): SeriesColumn(q + nv) for q in self._states[:nv]}
        own = [column for column in dict.fromkeys(kept) if column not in before]
        self._stored = {column: place for place, column in enumerate(own)}
        self._places = {**self._stored, **{x: self._stored[v] - len(own) for x, v in before.items()}}
        # of the order at hand: coefficients, None where they are zero, sums of inner terms, the order and 1 over it
        self._now: dict[SeriesColumn, Any] = {SeriesColumn(k): x for k, x in self._start.items()}
        self._inner: dict[Pair, Value | None] = {}
        self._order = self._share = f.constant(1.0)
        self._inverse: dict[int, Value] = {}
        self._sides: dict[int, Condition] = {}

    def up_to(self, order: int) -> Coefficients:
        """Emit coefficients up to this order, of q one more; return those of the states."""
        f, columns = self.f, len(self._stored)
        rows = Array(f, f.slot(self.width, columns * (order + 2)), self.width)
        self._shares = Array(f, f.table(f.fresh("shares"), [0.0, *(1.0 / n for n in range(1, order + 1))]))
        for column, place in self._stored.items():
            if not column.of_rate:
                rows[place] = self._start[column.series]
        self._prepare()
        self._add_order(rows.part(columns), 1)
        with f.count(-(-order // 2), start=1) as half:
            m = half * 2
            following = self._sum_inner_terms(rows, half)
            self._now = self._row(rows, m - 1)
            self._add_order(rows.part(m * columns), m)
            self._inner = {
                pair: _total([total, *self._newest(rows.part(columns), pair)])
                for pair, total in following.items()
            }
            self._add_order(rows.part((m + 1) * columns), m + 1)
        self._now = self._row(rows, order - 1)
        self._step_states(rows.part(order * columns), f.integer(order))
        last = rows.part((order + 1) * columns)
        for q in self._states[: self.nv]:
            v = self._now[SeriesColumn(q + self.nv)]
            last[self._places[SeriesColumn(q)]] = 0.0 if v is None else v * (1.0 / (order + 1))
        return Coefficients(
            rows, columns, [self._places[SeriesColumn(k)] for k in self._states], order, self.nv
        )

    # -- what is summed -------------------------------------------------------------------------------
    def _column(self, k: int, of_rate: bool = False) -> SeriesColumn:
        return SeriesColumn(self._state_of.get(k, k), of_rate)

    def _without_rate(self) -> list[bool]:
        """Return which instructions have a coefficient of order 0 alone."""
        found: list[bool] = []
        for k, i in enumerate(self.code):
            if k in self.series.chains:
                still = all(found[term.u] for term in self.series.chains[k].terms)
            elif i.op in FLAT or i.op == "sym":
                still = i.op in FLAT or self.series.constant[k]
            else:
                still = all(found[a] for a in i.args[i.op == "where" :])
            found.append(still)
        return found

    def _pairs_of(self, k: int) -> list[Pair]:
        """Return what is convolved in the coefficients of an instruction."""
        i, still = self.code[k], self._still
        if still[k]:
            return []
        if k in self.series.chains:
            terms, g = self.series.chains[k]
            pairs = [
                (self._column(u, True), self._column(w))
                for _, w, u in terms
                if w is not None and not still[u] and not still[w]
            ]
            return pairs if g is None or still[g] else [*pairs, (self._column(k, True), self._column(g))]
        if i.op not in ("mul", "div"):
            return []
        a, b = i.args if i.op == "mul" else (i.args[1], k)
        return [] if still[a] or still[b] else [(self._column(a), self._column(b))]

    def _sum_inner_terms(self, rows: Array, half: Int) -> dict[Pair, Value | None]:
        """Sum x_i y_{m-i} for 0 < i < m = 2 half, which is all but the ends of order m; return the same of order m + 1
        without the terms that order m gives, sum x_{i+1} y_{m-i} for 0 < i < m - 1."""
        m, following = half * 2, dict[Pair, Value | None]()
        squares = [pair for pair in self._sums if pair[0] == pair[1]]
        products = [pair for pair in self._sums if pair[0] != pair[1]]
        for pairs, count in ((products, m - 1), (squares, half)):
            for part in _parts(pairs, TOGETHER // 2):
                sums = self._sum_up_to(rows, part, m, count)
                x, y = self._row(rows, count), self._row(rows, m - count)
                for (a, b), (this, next_one) in zip(part, sums):
                    twice = 2.0 if a == b else 1.0
                    last = x[a] * y[b]
                    self._inner[_key((a, b))] = _total([_product(this, twice), last])
                    following[_key((a, b))] = _product(next_one, twice)
        return following

    def _sum_up_to(self, rows: Array, pairs: Sequence[Pair], m: Int, count: Int) -> list[tuple[Value, Value]]:
        """Sum x_i y_{m-i} and x_{i+1} y_{m-i} for 0 < i < count, of the pairs at once."""
        f, w = self.f, self.width
        sums = [(Total(f, w), Total(f, w)) for _ in pairs]
        x = self._row(rows, 1)
        held = {a: Array(f, f.slot(w), w) for a, _ in pairs}
        for a, slot in held.items():
            slot[0] = x[a]
        with f.count(count, start=1) as i:
            x, y = self._row(rows, i + 1), self._row(rows, m - i)
            for (a, b), (this, next_one) in zip(pairs, sums):
                this.add_product(held[a][0], y[b])
                next_one.add_product(x[a], y[b])
            for a, slot in held.items():
                slot[0] = x[a]
        return [(this.value, next_one.value) for this, next_one in sums]

    def _row(self, rows: Array, n: Int | int) -> _Row:
        return _Row(self._places, rows.part(n * len(self._stored)))

    def _newest(self, first: Array, pair: Pair) -> list[Value]:
        """Return the products of coefficients of order 1 with those of the order at hand."""
        a, b = pair
        found = [(a, b), (b, a)]
        return [first[self._places[x]] * y for x, c in found if (y := self._at(c)) is not None]

    # -- one order ------------------------------------------------------------------------------------
    def _add_order(self, row: Array, m: Int | int) -> None:
        """Emit coefficients m of the states and of all that moves, and keep in a row what is read later."""
        self._step_states(row, m)
        for k, i in enumerate(self.code):
            if k not in self._state_of and not self._still[k]:
                one = self.f.constant(1.0, self.width) if m == 1 else None
                self._note(row, k, one if i.op == "sym" else self._coefficient(k))

    def _step_states(self, row: Array, m: Int | int) -> None:
        """Emit coefficients m of the states from those of their rates before, with which ``_now`` begins."""
        f, before = self.f, self._now
        self._order = f.to_double(m) if isinstance(m, Int) else f.constant(float(m))
        self._share, self._now = f.splat(self._shares[m], self.width), {}
        for k, rate in self._rates.items():
            if isinstance(rate, float):
                x = f.constant(rate, self.width) if m == 1 and rate else None
            elif rate < len(self.code) and self._still[rate]:
                x = self._start[rate] if m == 1 else None
            else:
                x = before[self._column(rate)]
            self._now[SeriesColumn(k, True)] = x
            self._note(row, k, None if x is None else x * self._share)

    def _note(self, row: Array, k: int, x: Value | None) -> None:
        """Keep a coefficient and that of its rate, in memory as well where they are read later."""
        self._now[SeriesColumn(k)] = x
        for column in (SeriesColumn(k), SeriesColumn(k, True)):
            if column in self._stored:
                value = self._at(column)
                row[self._stored[column]] = 0.0 if value is None else value

    def _at(self, column: SeriesColumn) -> Value | None:
        """Return what is known of the order at hand."""
        if column not in self._now:
            assert column.of_rate, "a coefficient is asked for before it is known"
            x = self._now[SeriesColumn(column.series)]
            self._now[column] = None if x is None else x * self._order
        return self._now[column]

    # -- rules ----------------------------------------------------------------------------------------
    def _prepare(self) -> None:
        """Emit what is the same at all orders: inverses of divisors, and on which sides kinks are."""
        f = self.f
        for k, i in enumerate(self.code):
            if self._still[k]:
                continue
            under = (
                i.args[1] if i.op == "div" else self.series.chains[k].g if k in self.series.chains else None
            )
            if under is not None and under not in self._inverse:
                with f.strict():  # else LLVM divides by it at each order
                    self._inverse[under] = 1.0 / self._start[under]
            if i.op in KINKED:
                a, b = self._start[i.args[0]], f.constant(0.0, self.width)
                if i.op in ("min", "max"):
                    b = self._start[i.args[1]]
                self._sides[k] = f.compare("olt" if i.op == "min" else "ogt", a, b)

    def _of(self, k: int) -> Value | None:
        """Return the coefficient of an instruction."""
        return None if self._still[k] else self._at(self._column(k))

    def _coefficient(self, k: int) -> Value | None:
        """Return the coefficient of an instruction that is neither a state nor still."""
        i, zero = self.code[k], self.f.constant(0.0, self.width)
        if k in self.series.chains:
            return self._of_rule(k)
        inner = [self._inner.get(pair) for pair in self._pairs[k]]
        args = [self._of(a) for a in i.args]
        if i.op == "mul":
            others = [self._start[a] for a in reversed(i.args)]
            return _total([*inner, *map(_product, args, others)])
        if i.op == "div":
            top, under = args
            rest = _total([*inner, _product(under, self._start[k])])
            return _product(_total([top, _product(rest, -1.0)]), self._inverse[i.args[1]])
        if i.op in KINKED:
            a, b = args[-2:] if i.op != "abs" else (args[0], _product(args[0], -1.0))
            if a is None and b is None:
                return None
            return self.f.select(self._sides[k], zero if a is None else a, zero if b is None else b)
        if i.op != "add":
            assert i.op in ("sub", "neg"), i.op
            args[-1] = _product(args[-1], -1.0)
        return _total(args)

    def _of_rule(self, k: int) -> Value | None:
        terms, g = self.series.chains[k]
        inner = iter(self._pairs[k])
        found: list[Value | None] = []
        for s, w, u in terms:
            own = None if self._still[u] else self._at(self._column(u, True))
            if w is not None:
                own = _product(own, self._start[w])
                if not (self._still[u] or self._still[w]):
                    own = _total([self._inner.get(next(inner)), own])
            found.append(_product(own, s))
        if g is not None:
            found += [_product(self._inner.get(pair), -1.0) for pair in inner]
        total = _total(found)
        if g is not None:
            total = _product(total, self._inverse[g])
        self._now[SeriesColumn(k, True)] = total
        return _product(total, self._share)


class _Row(dict["SeriesColumn", Value]):
    """Entries of a row, each loaded once."""

    def __init__(self, places: Mapping[SeriesColumn, int], row: Array) -> None:
        super().__init__()
        self.places, self.row = places, row

    def __missing__(self, column: SeriesColumn) -> Value:
        self[column] = self.row[self.places[column]]
        return self[column]


def _key(pair: Pair) -> Pair:
    """Return two columns in the order in which their sum is known: it is that of the other order, too."""
    x, y = pair
    return (x, y) if x <= y else (y, x)


def _product(x: Value | None, factor: Value | float) -> Value | None:
    if x is None or (isinstance(factor, float) and factor == 1.0):
        return x
    return -x if isinstance(factor, float) and factor == -1.0 else x * factor


def _total(terms: Sequence[Value | None]) -> Value | None:
    """Return the sum of what is not zero."""
    found = [x for x in terms if x is not None]
    return sum(found[1:], start=found[0]) if found else None


def _parts(pairs: Sequence[Pair], most: int) -> Iterator[Sequence[Pair]]:
    """Return pairs in parts of about the same size."""
    count = max(1, round(len(pairs) / most)) if pairs else 0
    for k in range(count):
        yield pairs[k * len(pairs) // count : (k + 1) * len(pairs) // count]


def _shared(pairs: Sequence[Pair]) -> list[Pair]:
    """Return pairs, each once, in an order and with sides in which neighbours share columns: these are loaded once."""
    once = dict.fromkeys(pairs)
    used = Counter(column for pair in once for column in pair)
    sided = [max((x, y), (y, x), key=lambda pair: (used[pair[0]], pair)) for x, y in once]
    return sorted(sided, key=lambda pair: (-used[pair[0]], pair))
