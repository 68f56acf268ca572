"""Taylor series of the solution of x-dot = f(x), emitted order by order from the program of f.

    x(t + h) = sum_n x_n h^n,    n x_n = f_{n-1}

Coefficients of operations follow from convolutions (Jorba and Zou 2005; for g, w and u see ``rules``):

    (u w)_n = sum_{i=0}^{n} u_i w_{n-i}
    (u / w)_n w_0 = u_n - sum_{i=1}^{n} w_i (u / w)_{n-i}
    n g_0 y_n = sum_k s_k sum_{i=1}^{n} (i u_k,i) w_k,n-i - sum_{j=1}^{n-1} (j y_j) g_{n-j}

What has kinks takes the branch on which it is at the start.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from robodyn_cli.kernels.ir import Condition, Function, Value
from robodyn_cli.kernels.lower import Inputs, loaded, values_of
from robodyn_cli.kernels.program import Instruction, Program
from robodyn_cli.kernels.series.rules import Series

FLAT = frozenset({"sign", "round", "table"})  # slopes are zero but for jumps; of tables those of degree 0
KINKED = frozenset({"where", "min", "max", "abs"})


class Factor(NamedTuple):
    """Coefficient ``order`` of a series, or that many times it: that of its rate."""

    series: int
    order: int
    of_rate: bool = False


class Jets:
    """Coefficients along a solution, emitted order by order in one piece of straight-line code.

    Parameters
    ----------
    program : of the rates, outputs ``a`` (nv) and ``z``. inputs : of it at the start, as of ``lower`` or arrays in
    memory. state : x_0 = (q, v, z), where q-dot = v.
    """

    def __init__(
        self, f: Function, program: Program, inputs: Inputs, state: Sequence[Value], nv: int, fused: bool
    ) -> None:
        self.f, self.series, self.width = f, Series.of(program), state[0].width
        self.code = self.series.program.instructions
        read = loaded(f, self.series.program, inputs, self.width)
        values = values_of(f, self.series.program, read, self.width, fused)
        # series by number: the instructions, then the states; an instruction that is a state shares its coefficients
        self._c: list[list[Value | None]] = [[x] for x in [*values, *state]]
        self._d: dict[Factor, Value | None] = {}
        first, outputs = len(self.code), self.series.program.outputs
        rates: list[int | float] = [first + nv + k for k in range(nv)]
        rates += [*outputs.get("a", ()), *outputs.get("z", ())]
        self._rate = {first + k: rate for k, rate in enumerate(rates)}  # a series, or a number
        places = {"q": first, "v": first + nv, "z": first + 2 * nv}
        for k, i in enumerate(self.code):
            if i.op == "sym" and i.value[0] in places:
                place = places[i.value[0]] + i.value[1]
                self._c[k], self._rate[k] = self._c[place], self._rate[place]
        self._inverse: dict[int, Value] = {}
        self._sides: dict[int, Condition] = {}

    def up_to(self, order: int) -> list[list[Value | None]]:
        """Emit coefficients up to this order, of q one more; return those of the states, None where they are zero."""
        for m in range(1, order):
            for k in range(len(self.code)):
                if k not in self._rate and not self.series.constant[k]:
                    self._c[k].append(self._coefficient(k, m))
        states = range(len(self.code), len(self._c))
        return [[self.at(Factor(k, n)) for n in range(order + 1 + (self._rate[k] in states))] for k in states]

    # -- what is known --------------------------------------------------------------------------------
    def at(self, x: Factor) -> Value | None:
        """Return a coefficient, None where it is zero."""
        if x.of_rate:
            return self._at_rate(x)
        own = self._c[x.series]
        if x.order >= len(own) and x.series in self._rate:
            for n in range(len(own), x.order + 1):
                own.append(_scaled(self.at(Factor(x.series, n, of_rate=True)), 1.0 / n))
        if x.order < len(own):
            return own[x.order]
        assert self.series.constant[x.series], "a coefficient is asked for before it is known"
        return None

    def _at_rate(self, x: Factor) -> Value | None:
        if x not in self._d:
            source = self._rate.get(x.series)
            if source is None:
                self._d[x] = _scaled(self.at(Factor(x.series, x.order)), float(x.order))
            elif isinstance(source, float):
                self._d[x] = self.f.constant(source, self.width) if x.order == 1 and source else None
            else:
                self._d[x] = self.at(Factor(source, x.order - 1))
        return self._d[x]

    # -- rules ----------------------------------------------------------------------------------------
    def _convolution(self, a: int, b: int, orders: range, total: int, of_rate: bool = False) -> Value | None:
        """Return the sum of coefficients of these orders of a, or of its rate, times those of b up to a total order.

        LLVM puts the terms into an order in which what is known last waits for nothing.
        """
        found: Value | None = None
        for n in orders:
            x, y = self.at(Factor(a, n, of_rate)), self.at(Factor(b, total - n))
            if x is not None and y is not None:
                found = _added(found, x * y)
        return found

    def _coefficient(self, k: int, m: int) -> Value | None:
        """Return coefficient m of an instruction that is neither a state nor constant."""
        i = self.code[k]
        if k in self.series.chains:
            return self._of_rule(k, m)
        args = [self.at(Factor(a, m)) for a in i.args]
        if i.op == "add":
            return _added(*args)
        if i.op == "sub":
            return _subtracted(*args)
        if i.op == "neg":
            return _scaled(args[0], -1.0)
        if i.op == "mul":
            return self._of_product(i.args[0], i.args[1], m)
        if i.op == "div":
            top, under = args[0], i.args[1]
            if not self.series.constant[under]:
                top = _subtracted(top, self._convolution(under, k, range(1, m + 1), m))
            return None if top is None else top * self._inverse_of(under)
        if i.op in KINKED:
            return self._on_side(k, i, args)
        assert i.op in FLAT or i.op == "sym", i.op
        return self.f.constant(1.0, self.width) if i.op == "sym" and m == 1 else None

    def _of_product(self, a: int, b: int, m: int) -> Value | None:
        for x, y in ((a, b), (b, a)):
            if self.series.constant[x]:
                factor, coefficient = self._c[x][0], self.at(Factor(y, m))
                return None if coefficient is None or factor is None else factor * coefficient
        if a != b:
            return self._convolution(a, b, range(m + 1), m)
        twice = _scaled(self._convolution(a, a, range((m + 1) // 2), m), 2.0)
        middle = self.at(Factor(a, m // 2)) if m % 2 == 0 else None
        return twice if middle is None else _added(twice, middle * middle)

    def _of_rule(self, k: int, m: int) -> Value | None:
        rule, total = self.series.chains[k], None
        for term in rule.terms:
            if term.w is None:
                own = self.at(Factor(term.u, m, of_rate=True))
            else:
                own = self._convolution(term.u, term.w, range(1, m + 1), m, of_rate=True)
            total = _subtracted(total, own) if term.s == -1.0 else _added(total, _scaled(own, term.s))
        if rule.g is not None:
            total = _subtracted(total, self._convolution(k, rule.g, range(1, m), m, of_rate=True))
            total = None if total is None else total * self._inverse_of(rule.g)
        self._d[Factor(k, m, of_rate=True)] = total
        return _scaled(total, 1.0 / m)

    def _inverse_of(self, k: int) -> Value:
        if k not in self._inverse:
            value = self._c[k][0]
            assert value is not None
            self._inverse[k] = 1.0 / value
        return self._inverse[k]

    def _on_side(self, k: int, i: Instruction, args: Sequence[Value | None]) -> Value | None:
        """Return the coefficient of the branch that is taken at the start."""
        f, zero = self.f, self.f.constant(0.0, self.width)
        if k not in self._sides:
            at_start = [self._c[a][0] for a in i.args]
            other = zero if i.op in ("abs", "where") else at_start[1]
            assert at_start[0] is not None and other is not None
            self._sides[k] = f.compare("olt" if i.op == "min" else "ogt", at_start[0], other)
        a, b = args[-2:] if i.op != "abs" else (args[0], _scaled(args[0], -1.0))
        if a is None and b is None:
            return None
        return f.select(self._sides[k], zero if a is None else a, zero if b is None else b)


def _scaled(x: Value | None, factor: float) -> Value | None:
    if x is None or factor == 1.0:
        return x
    return -x if factor == -1.0 else x * factor


def _added(x: Value | None, y: Value | None) -> Value | None:
    return y if x is None else x if y is None else x + y


def _subtracted(x: Value | None, y: Value | None) -> Value | None:
    return x if y is None else -y if x is None else x - y
