r"""Equations expanded into sums of products, with sines and cosines of sums of angles.

An expression becomes sum_i c_i prod_k x_k^n_k {1, cos a_i, sin a_i}: c_i a number, x_k names, a_i a combination of
angles. Products of sines and cosines become those of sums and differences,

    2 cos a cos b = cos(a - b) + cos(a + b),   2 sin a sin b = cos(a - b) - cos(a + b),
    2 sin a cos b = sin(a + b) + sin(a - b),

so that the form is unique: sin^2 + cos^2 is 1, and what cancels is gone. What is no such sum (roots, friction,
formulas) is a name for a function of expanded arguments.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from robodyn_cli.expr.graph import Scalar
from robodyn_cli.works.equations.names import Symbol, SymbolNames
from robodyn_cli.works.equations.tree import (
    LONGEST,
    EquationFormula,
    leaf,
    name,
    negated,
    number,
    product,
    raised,
    total,
    worked_out,
)

MOST_TERMS, MOST_PAIRS, MOST_ALL = 400, 20_000, 600  # of one expression, of one product, of all entries
CANCELLED = 1e-13  # of the terms that a sum is made of: what is smaller is rounding
MOST_ROOT = 200  # number under a root
PHASE = -1  # in place of a name in an angle: a constant part

Powers = tuple[tuple[int, int], ...]  # names by number, with exponents
Angle = tuple[str, tuple[tuple[int, float], ...]]  # "cos" or "sin", and names with factors
Monomial = tuple[Powers, Angle | None]
Sum = dict[Monomial, float]
Constants = dict[Powers, float]  # a sum without angles
ONE: Monomial = ((), None)


class TooLong(Exception):
    """Expressions have more terms than anybody reads."""


class ExpandedFormulas:
    """The formulas of entries of a graph, expanded.

    Raises
    ------
    TooLong
    """

    def __init__(self, names: SymbolNames, outputs: Mapping[str, Sequence[Scalar]]) -> None:
        self.names = names
        self.where: list[tuple[Symbol, EquationFormula]] = []  # names for long arguments of functions
        self._long: dict[EquationFormula, EquationFormula] = {}
        self._atoms: list[EquationFormula] = []
        self._numbers: list[bool] = []  # whether an atom is constant along a motion
        self._place: dict[EquationFormula, int] = {}
        self._made: dict[Any, Sum] = {}
        for symbol in names.motion:
            self._atom(name(symbol), False)
        sums = {output: [self._sum(x) for x in entries] for output, entries in outputs.items()}
        if sum(len(x) for entries in sums.values() for x in entries) > MOST_ALL:
            raise TooLong
        self.formulas = {output: [self.formula(x) for x in entries] for output, entries in sums.items()}

    # -- from the graph to sums -----------------------------------------------------------------------
    def _sum(self, x: Any) -> Sum:
        return worked_out(x, self.names, self._made, lambda node, *parts: self._applied(*parts))

    def _applied(self, op: str, args: Sequence[Sum], value: Any) -> Sum:
        if op == "number" or (not args and op == "const"):
            return constant(float(value))
        if not args:
            known = leaf(self.names, op, value)
            assert known is not None
            return self._leaf(known)
        if op in ("add", "sub"):
            return added(args[0], args[1], 1.0 if op == "add" else -1.0)
        if op == "neg":
            return added({}, args[0], -1.0)
        if op == "mul":
            return multiplied(args[0], args[1])
        if op == "div":
            return multiplied(args[0], self._inverse(args[1]))
        if op in ("sin", "cos") and (angle := self._angle(op, args[0])) is not None:
            return angle
        return self._function(op, args, value)

    def _leaf(self, formula: EquationFormula) -> Sum:
        if formula.op == "neg":
            return added({}, self._leaf(formula.args[0]), -1.0)
        if formula.op == "number":
            return constant(formula.value)
        symbol = formula.value
        return {(((self._atom(formula, symbol.is_number), 1),), None): 1.0}

    def _atom(self, formula: EquationFormula, is_number: bool) -> int:
        if formula not in self._place:
            self._place[formula] = len(self._atoms)
            self._atoms.append(formula)
            self._numbers.append(is_number)
        return self._place[formula]

    def _function(self, op: str, args: Sequence[Sum], value: Any) -> Sum:
        """Return a function of expanded arguments as one name."""
        if all(set(a) <= {ONE} for a in args) and op in NUMERIC:
            return constant(NUMERIC[op](*[a.get(ONE, 0.0) for a in args]))
        inside = [self.formula(a) for a in args]
        if op == "where":  # which is written on one line
            inside = [self._short_of(a) for a in inside]
        made = self._short_of(EquationFormula("power" if op == "pow" else op, tuple(inside), value))
        is_number = all(self._is_number(a) for a in args)
        return {(((self._atom(made, is_number), 1),), None): 1.0}

    def _is_number(self, x: Sum) -> bool:
        return all(angle is None and all(self._numbers[k] for k, _ in powers) for powers, angle in x)

    def _inverse(self, x: Sum) -> Sum:
        """Return 1 / x: of one product that of its factors, of a sum a name to a negative power."""
        if len(x) == 1:
            (((powers, angle), factor),) = x.items()
            if angle is None:
                return {(tuple((k, -n) for k, n in powers), None): 1.0 / factor}
        if not x:
            raise ZeroDivisionError
        return {(((self._atom(self._short_of(self.formula(x)), self._is_number(x)), -1),), None): 1.0}

    def _short_of(self, formula: EquationFormula) -> EquationFormula:
        """Return a name for a formula that is too long to stand inside others."""
        if formula.leaves <= LONGEST:
            return formula
        if formula not in self._long:
            symbol = self.names.temporary(len(self.where) + 1)
            self.where.append((symbol, formula))
            self._long[formula] = name(symbol)
        return self._long[formula]

    def _angle(self, op: str, x: Sum) -> Sum | None:
        """Return a sine or cosine of a sum of names with factors; None of anything else."""
        parts_of: dict[int, float] = {}
        for (powers, angle), factor in x.items():
            if angle is not None or len(powers) > 1 or (powers and powers[0][1] != 1):
                return None
            parts_of[powers[0][0] if powers else PHASE] = factor
        return turned(op, parts_of, 1.0)

    # -- from sums to formulas ------------------------------------------------------------------------
    def formula(self, x: Sum) -> EquationFormula:
        """Return the formula of a sum: for each angle the numbers that have it together, common factors before."""
        if not x:
            return number(0.0)
        by_angle: dict[Angle | None, dict[Powers, Constants]] = {}
        for (powers, angle), factor in x.items():
            fixed = tuple(p for p in powers if self._numbers[p[0]])
            rest = tuple(p for p in powers if not self._numbers[p[0]])
            by_angle.setdefault(angle, {}).setdefault(rest, {})[fixed] = factor
        terms = []
        for angle in sorted(by_angle, key=_order):
            for constants, moving in alike(by_angle[angle]):
                terms.append(self._product(constants, moving, angle))
        return total(unsigned_first(terms))

    def _product(self, constants: Constants, moving: Constants, angle: Angle | None) -> EquationFormula:
        factor, common, rest = factored(constants)
        scale, shared, others = factored(moving)
        factor *= scale
        before = [*coefficient(factor), *self._raised(common)]
        sums = [[] if constants_only(x) else self._terms(x) for x in (rest, others)]
        if not (before or shared or angle) and [] in sums and sums != [[], []]:
            return total([negated(term) if factor < 0.0 else term for term in (*sums[0], *sums[1])])
        first, second = ([total(terms)] if terms else [] for terms in sums)
        turned_by = [] if angle is None else [self._trigonometric(*angle)]
        made = fraction([*before, *first, *self._raised(shared), *second, *turned_by])
        return negated(made) if factor < 0.0 else made

    def _terms(self, x: Constants) -> list[EquationFormula]:
        terms = []
        for powers in sorted(x, key=lambda one: (len(one), sorted(map(self._rank, one)))):
            factor = x[powers]
            factors = coefficient(factor) or ([] if powers else [number(1.0)])
            made = fraction([*factors, *self._raised(powers)])
            terms.append(negated(made) if factor < 0.0 else made)
        return unsigned_first(terms)

    def _raised(self, powers: Powers) -> list[EquationFormula]:
        return [raised(self._atoms[k], n) for k, n in sorted(powers, key=self._rank)]

    def _rank(self, power: tuple[int, int]) -> tuple[int, str]:
        """Return the order of factors: masses, other numbers by name, then what moves."""
        place = power[0]
        key = self._atoms[place].value.key if self._atoms[place].op == "name" else "~"
        if not self._numbers[place]:
            return 4, f"{place:6}"
        return (0 if key.startswith("m_") else 1 if key in ("g", "gx", "gy", "gz") else 2), key

    def _trigonometric(self, op: str, angle: Sequence[tuple[int, float]]) -> EquationFormula:
        terms = []
        for k, factor in angle:
            atom = number(abs(factor)) if k == PHASE else self._atoms[k]
            term = atom if k == PHASE or abs(factor) == 1.0 else product([number(abs(factor)), atom])
            terms.append(negated(term) if factor < 0.0 else term)
        return EquationFormula(op, (total(terms),))


def coefficient(value: float) -> list[EquationFormula]:
    """Return the size of a number as factors, none of 1: roots of small numbers, as attitudes have, as such."""
    value = float(f"{abs(value):.15g}")
    if value == 1.0:
        return []
    for below in (1, 2, 4, 8, 16):
        square = round((value * below) ** 2)
        if 0 < square <= MOST_ROOT and abs(math.sqrt(square) / below - value) <= 2e-15 * value:
            whole = max(k for k in range(1, math.isqrt(square) + 1) if square % (k * k) == 0)
            if square == whole * whole:
                break
            root = EquationFormula("sqrt", (number(square / (whole * whole)),))
            return [root] if whole == below else [number(whole / below), root]
    return [number(value)]


def unsigned_first(terms: list[EquationFormula]) -> list[EquationFormula]:
    """Return terms so that their sum begins with no sign if it need not."""
    first = next((k for k, term in enumerate(terms) if term.op != "neg"), 0)
    return [terms[first], *terms[:first], *terms[first + 1 :]]


def _order(angle: Angle | None) -> Any:
    """Return the order of terms: without an angle, then by how many names and which."""
    return (0, ()) if angle is None else (len(angle[1]), angle[1], angle[0])


NUMERIC: dict[str, Callable[..., float]] = {
    "sin": math.sin, "cos": math.cos, "tan": math.tan, "exp": math.exp, "abs": abs, "min": min, "max": max,
}  # fmt: skip


def fraction(factors: Sequence[EquationFormula]) -> EquationFormula:
    """Return a product, its factors with negative exponents below a line."""
    below = [raised(f.args[0], -f.value) for f in factors if _is_below(f)]
    above = product([f for f in factors if not _is_below(f)], in_order=True)
    return EquationFormula("quotient", (above, product(below, in_order=True))) if below else above


def _is_below(f: EquationFormula) -> bool:
    return f.op == "power" and isinstance(f.value, int) and f.value < 0


def constants_only(x: Mapping[Powers, float]) -> bool:
    """Tell whether a primitive sum is 1."""
    return list(x) == [()]


def constant(value: float) -> Sum:
    return {ONE: value} if value else {}


def added(a: Sum, b: Sum, factor: float) -> Sum:
    """Return a + factor b."""
    out = dict(a)
    for key, x in b.items():
        _add(out, key, factor * x)
    return _short(out)


def multiplied(a: Sum, b: Sum) -> Sum:
    """Return a b."""
    if len(a) * len(b) > MOST_PAIRS:
        raise TooLong
    out: Sum = {}
    for (left, angle), x in a.items():
        for (right, other), y in b.items():
            powers = joined(left, right)
            for turn, factor in together(angle, other):
                _add(out, (powers, turn), factor * x * y)
    return _short(out)


def _add(out: Sum, key: Monomial, x: float) -> None:
    before = out.get(key, 0.0)
    after = before + x
    if abs(after) <= CANCELLED * abs(x):
        out.pop(key, None)
    else:
        out[key] = after


def _short(x: Sum) -> Sum:
    if len(x) > MOST_TERMS:
        raise TooLong
    return x


def joined(a: Powers, b: Powers) -> Powers:
    if not a or not b:
        return a or b
    powers = dict(a)
    for k, n in b:
        powers[k] = powers.get(k, 0) + n
    return tuple(sorted((k, n) for k, n in powers.items() if n))


def together(a: Angle | None, b: Angle | None) -> list[tuple[Angle | None, float]]:
    """Return the product of two sines or cosines as a sum of such, each with its factor."""
    if a is None or b is None:
        return [(a or b, 1.0)]
    (first, x), (second, y) = a, b
    if first != second and first == "cos":
        (first, x), (second, y) = b, a
    op = "cos" if first == second else "sin"
    sign = -1.0 if (first, second) == ("sin", "sin") else 1.0
    out: list[tuple[Angle | None, float]] = []
    for side, factor in ((-1.0, 0.5), (1.0, 0.5 * sign)):
        angle = dict(x)
        for k, c in y:
            angle[k] = angle.get(k, 0.0) + side * c
        out += [(turn, factor * c) for ((_, turn), c) in turned(op, angle, 1.0).items()]
    return out


def turned(op: str, angle: Mapping[int, float], factor: float) -> Sum:
    """Return factor sin or cos of an angle in one form: its first name with a factor above zero, no quarter turns."""
    angle = {k: c for k, c in angle.items() if abs(c) > CANCELLED}
    phase = angle.pop(PHASE, 0.0)
    quarters = round(phase / (math.pi / 2))
    if abs(phase - quarters * math.pi / 2) < CANCELLED or not angle:
        rest = phase - quarters * math.pi / 2
        phase = 0.0 if abs(rest) < CANCELLED else rest
        for _ in range(quarters % 4):
            op, factor = ("sin", -factor) if op == "cos" else ("cos", factor)
    if not angle:
        return constant(factor * (math.cos(phase) if op == "cos" else math.sin(phase)))
    ordered = sorted(angle.items())
    if ordered[0][1] < 0.0:
        ordered, phase = [(k, -c) for k, c in ordered], -phase
        factor = factor if op == "cos" else -factor
    if phase:
        ordered.append((PHASE, phase))
    return {((), (op, tuple(ordered))): factor}


def factored(x: Mapping[Powers, float]) -> tuple[float, Powers, Constants]:
    """Return a number, common powers, and the sum that is left: x = number powers rest."""
    least = min(abs(c) for c in x.values())
    whole = all(c.is_integer() for c in x.values()) or all(abs(c) == least for c in x.values())
    whole = whole and all((c / least).is_integer() for c in x.values())
    sign = -1.0 if all(c < 0.0 for c in x.values()) else 1.0
    factor = sign * least if whole else sign
    names = set.intersection(*[{k for k, _ in powers} for powers in x])
    common = []
    for k in sorted(names):
        exponents = [dict(powers)[k] for powers in x]
        if min(exponents) > 0 or max(exponents) < 0:
            common.append((k, min(exponents) if min(exponents) > 0 else max(exponents)))
    taken = tuple((k, -n) for k, n in common)
    return factor, tuple(common), {joined(powers, taken): c / factor for powers, c in x.items()}


def alike(x: Mapping[Powers, Constants]) -> list[tuple[Constants, Constants]]:
    """Return sums of numbers with what moves and has them, where several have multiples of the same numbers."""
    groups: dict[Any, list[tuple[Constants, Powers, float]]] = {}
    for moving, constants in x.items():
        first = min(constants)
        scale = constants[first] if first or len(constants) > 1 else 1.0
        key = tuple(sorted((powers, round(c / scale, 12)) for powers, c in constants.items()))
        if constants_only(constants):
            key, scale, constants = (), constants[()], {(): 1.0}
        groups.setdefault(key, []).append((constants, moving, scale))
    out = []
    for members in groups.values():
        constants, _, least = min(members, key=lambda member: abs(member[2]))
        if constants_only(constants):
            least = 1.0
        out.append((constants, {moving: scale / least for _, moving, scale in members}))
    return out
