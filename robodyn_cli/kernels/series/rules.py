"""What Taylor series of the operations of a program follow from: one rule for each operation.

Every operation is a sum, a product, a quotient, a choice or a solution of

    g y' = sum_k s_k w_k u_k'

Sine and cosine are each other's w; exp is its own; tan has w = 1 + y^2; log has g = u, and so on (Moore 1966; Griewank
and Walther 2008, section 13.2).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from functools import cached_property
from typing import Any, NamedTuple

from robodyn_cli.kernels.program import PARAMETERS, Instruction, Program
from robodyn_cli.record import record

PAIRS = {
    "sin": ("cos", 1.0, -1.0),
    "cos": ("sin", -1.0, 1.0),
    "sinh": ("cosh", 1.0, 1.0),
    "cosh": ("sinh", 1.0, 1.0),
}


class RateTerm(NamedTuple):
    """One term s w u' of a rule; w None: 1."""

    s: float
    w: int | None
    u: int


class RateRule(NamedTuple):
    """g y' = sum of terms; g None: 1."""

    terms: tuple[RateTerm, ...]
    g: int | None = None


@record
class Series:
    """A program with all that the rules need beside its own instructions.

    chains : of those instructions that are solutions, by number.
    """

    program: Program
    chains: dict[int, RateRule]

    @staticmethod
    def of(program: Program) -> Series:
        """Return the series of a program."""
        return _Expansion(program).series

    @cached_property
    def constant(self) -> list[bool]:
        """Which instructions do not change along a solution."""
        found: list[bool] = []
        for i in self.program.instructions:
            is_parameter = i.op == "sym" and i.value[0] == PARAMETERS
            found.append(is_parameter or (i.op != "sym" and all(found[a] for a in i.args)))
        return found

    @cached_property
    def read(self) -> list[int]:
        """Instructions whose values at the start coefficients follow from: factors, divisors, kinks, and the rates."""
        found = {e for entries in self.program.outputs.values() for e in entries if not isinstance(e, float)}
        for k, i in enumerate(self.program.instructions):
            if k in self.chains:
                terms, g = self.chains[k]
                found.update(x for x in (g, *(t.w for t in terms)) if x is not None)
            elif i.op not in ("add", "sub", "neg"):
                found.update(i.args, [k] if i.op == "div" else [])
        return sorted(found)

    def work(self, order: int) -> float:
        """Return about how many operations coefficients up to an order take: a convolution half of its square."""
        moving = [
            k for k, i in enumerate(self.program.instructions) if not self.constant[k] and i.op != "sym"
        ]
        return len(moving) * order + sum(map(self._convolutions, moving)) * 0.5 * order**2

    def _convolutions(self, k: int) -> int:
        """Return how many convolutions an instruction takes."""
        if k in self.chains:
            terms, g = self.chains[k]
            return sum(t.w is not None for t in terms) + (g is not None)
        i = self.program.instructions[k]
        if i.op == "mul" and not any(self.constant[a] for a in i.args):
            return 1
        return int(i.op == "div" and not self.constant[i.args[1]])


class _Expansion:
    """Adds what rules need to a program: w and g of its functions. Reciprocals that serve in products become quotients,
    which take no convolution of their own."""

    def __init__(self, program: Program) -> None:
        self.code: list[Instruction] = []
        self.chains: dict[int, RateRule] = {}
        self._known: dict[Instruction, int] = {}
        self._source = program
        self._reciprocals = _reciprocals(program)
        self.place: list[int] = []
        for i in program.instructions:
            self.place.append(self._take(i))
        outputs = {
            name: tuple(e if isinstance(e, float) else self.place[e] for e in entries)
            for name, entries in program.outputs.items()
        }
        self.series = self._used(Program(tuple(self.code), outputs, program.numbers))

    def _used(self, whole: Program) -> Series:
        """Return the series without what no output needs: reciprocals."""
        needed = [e for entries in whole.outputs.values() for e in entries if not isinstance(e, float)]
        kept: set[int] = set()
        while needed:
            k = needed.pop()
            if k not in kept:
                kept.add(k)
                needed += whole.instructions[k].args
                if k in self.chains:
                    terms, g = self.chains[k]
                    needed += [a for a in (*(x for t in terms for x in (t.w, t.u)), g) if a is not None]
        place = {k: n for n, k in enumerate(sorted(kept))}

        def moved(x: Any) -> Any:
            return x if x is None or isinstance(x, float) else place[x]

        code = [
            i._replace(args=tuple(map(moved, i.args))) for k, i in enumerate(whole.instructions) if k in kept
        ]
        chains = {
            place[k]: RateRule(tuple(RateTerm(t.s, moved(t.w), moved(t.u)) for t in c.terms), moved(c.g))
            for k, c in self.chains.items()
            if k in kept
        }
        outputs = {name: tuple(map(moved, entries)) for name, entries in whole.outputs.items()}
        return Series(Program(tuple(code), outputs, whole.numbers), chains)

    def _add(self, op: str, *args: int, value: Any = None) -> int:
        key = Instruction(op, args, value)
        if key not in self._known:
            self._known[key] = len(self.code)
            self.code.append(key)
        return self._known[key]

    def _take(self, i: Instruction) -> int:
        args = tuple(self.place[a] for a in i.args)
        if i.op == "mul":
            for x, y in (i.args, i.args[::-1]):
                if x in self._reciprocals:
                    return self._quotient(self.place[y], *self._source.instructions[x].args)
        if i.op == "table":
            return self.looked_up(i.value, *args)
        if i.op in _RULES:
            return _RULES[i.op](self, i.op, *args)
        return self._add(i.op, *args, value=i.value)

    def _quotient(self, factor: int, over: int, under: int) -> int:
        one = self._source.instructions[over]
        top = factor if one.value == 1.0 else self._add("mul", self.place[over], factor)
        return self._add("div", top, self.place[under])

    def _solution(self, op: str, args: tuple[int, ...], chain: Callable[[int], RateRule]) -> int:
        """Add an operation whose series is that of a chain; chain : of its number."""
        y = self._add(op, *args)
        if y not in self.chains:
            self.chains[y] = chain(y)
        return y

    def one(self) -> int:
        return self._add("const", value=1.0)

    # -- rules: w and g by function -------------------------------------------------------------------
    def pair(self, op: str, u: int) -> int:
        other, sign, back = PAIRS[op]
        y = self._add(op, u)
        if y not in self.chains:
            w = self._add(other, u)
            self.chains[y], self.chains[w] = (
                RateRule((RateTerm(sign, w, u),)),
                RateRule((RateTerm(back, y, u),)),
            )
        return y

    def exponential(self, op: str, u: int) -> int:
        return self._solution(op, (u,), lambda y: RateRule((RateTerm(1.0, y, u),)))

    def tangent(self, op: str, u: int) -> int:
        """tan' = (1 + tan^2) u', tanh' = (1 - tanh^2) u'."""

        def chain(y: int) -> RateRule:
            square = self._add("mul", y, y)
            return RateRule(
                (RateTerm(1.0, self._add("add" if op == "tan" else "sub", self.one(), square), u),)
            )

        return self._solution(op, (u,), chain)

    def logarithm(self, op: str, u: int) -> int:
        return self._solution(op, (u,), lambda y: RateRule((RateTerm(1.0, None, u),), u))

    def root(self, op: str, u: int) -> int:
        """2 y y' = u'."""
        return self._solution(op, (u,), lambda y: RateRule((RateTerm(1.0, None, u),), self._add("add", y, y)))

    def arc(self, op: str, u: int) -> int:
        """(1 + u^2) atan' = u', sqrt(1 - u^2) asin' = u' = -sqrt(1 - u^2) acos'."""
        square = self._add("mul", u, u)
        if op == "atan":
            g = self._add("add", self.one(), square)
        else:
            g = self.root("sqrt", self._add("sub", self.one(), square))
        return self._solution(
            op, (u,), lambda y: RateRule((RateTerm(-1.0 if op == "acos" else 1.0, None, u),), g)
        )

    def direction(self, op: str, y: int, x: int) -> int:
        """(x^2 + y^2) atan2' = x y' - y x'."""
        g = self._add("add", self._add("mul", x, x), self._add("mul", y, y))
        return self._solution(op, (y, x), lambda _: RateRule((RateTerm(1.0, x, y), RateTerm(-1.0, y, x)), g))

    def looked_up(self, table: tuple[Any, ...], u: int, derivative: int = 0) -> int:
        """The slope of a piecewise polynomial is one of the next lower degree."""
        first, n, degree, held = table
        y = self._add("table", u, value=(first, n, degree, held, derivative))
        if derivative < degree and y not in self.chains:
            self.chains[y] = RateRule((RateTerm(1.0, self.looked_up(table, u, derivative + 1), u),))
        return y

    def power(self, op: str, u: int, b: int) -> int:
        """u y' = b y u' of a constant exponent b, else exp(b log u)."""
        if self.code[b].op == "const":
            s = float(self.code[b].value)
            return self._solution(op, (u, b), lambda y: RateRule((RateTerm(s, y, u),), u))
        exponent = self._add("mul", b, self.logarithm("log", u))
        return self._solution(op, (u, b), lambda y: RateRule((RateTerm(1.0, y, exponent),)))


_RULES: dict[str, Callable[..., int]] = {
    **dict.fromkeys(PAIRS, _Expansion.pair),
    **dict.fromkeys(("tan", "tanh"), _Expansion.tangent),
    **dict.fromkeys(("asin", "acos", "atan"), _Expansion.arc),
    "exp": _Expansion.exponential,
    "log": _Expansion.logarithm,
    "sqrt": _Expansion.root,
    "atan2": _Expansion.direction,
    "pow": _Expansion.power,
}


def _reciprocals(program: Program) -> set[int]:
    """Return the quotients of constants that serve as factors alone."""
    code = program.instructions
    users = Counter(a for i in code for a in i.args)
    factors = Counter(a for i in code if i.op == "mul" and i.args[0] != i.args[1] for a in i.args)
    given = {e for entries in program.outputs.values() for e in entries if not isinstance(e, float)}
    return {
        k
        for k, i in enumerate(code)
        if i.op == "div"
        and code[i.args[0]].op in ("const", "number")
        and users[k] == factors[k]
        and k not in given
    }
