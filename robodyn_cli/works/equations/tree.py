"""Formulas to be written: trees of sums, products, powers and functions over names and numbers.

Trees are made from the graph of the equations, either with a name for each value that is used twice (``Temporaries``)
or expanded (``expand.py``). Every writer prints these trees, so all forms say the same.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple, TypeVar

from robodyn_cli.expr.fixed import Fixed
from robodyn_cli.expr.graph import Expr, Scalar
from robodyn_cli.works.equations.names import Symbol, SymbolNames

Made = TypeVar("Made")

LONGEST = 12  # leaves of a formula that may stand inside another one
SIGNED = ("add", "sub", "neg")


class EquationFormula(NamedTuple):
    """One formula: ``number`` (value), ``name`` (value: its ``Symbol``), ``sum``, ``product``, ``neg``, ``quotient``,
    ``power``, ``table`` (value as in the graph, one argument) or a function of the graph."""

    op: str
    args: tuple[EquationFormula, ...] = ()
    value: Any = None

    @property
    def leaves(self) -> int:
        return sum(a.leaves for a in self.args) if self.args else 1


ZERO = EquationFormula("number", (), 0.0)


def number(value: float) -> EquationFormula:
    """Return a number without a place in the scene; a sign stands before it."""
    if value < 0.0:
        return EquationFormula("neg", (EquationFormula("number", (), -value),))
    return EquationFormula("number", (), abs(value))


def name(symbol: Symbol) -> EquationFormula:
    return EquationFormula("name", (), symbol)


def leaf(names: SymbolNames, op: str, value: Any) -> EquationFormula | None:
    """Return the formula of a leaf of the graph, None of an operation."""
    if op == "number" or (op == "literal" and "#" in value.args[0]):
        return number(float(value))
    if op == "sym":
        return name(names.symbol(*value))
    if op not in ("literal", "entry"):
        return None
    made = name(names.number(value))
    return negated(made) if op == "literal" and value.args[0] == names.down else made


def total(terms: Sequence[EquationFormula]) -> EquationFormula:
    """Return the sum of terms, sums among them opened."""
    flat: list[EquationFormula] = []
    for term in terms:
        flat += term.args if term.op == "sum" else (term,)
    return flat[0] if len(flat) == 1 else EquationFormula("sum", tuple(flat)) if flat else ZERO


def product(factors: Sequence[EquationFormula], in_order: bool = False) -> EquationFormula:
    """Return the product of factors: equal ones as powers, signs before it.

    in_order : whether factors stand as they are given, else numbers come first and functions last.
    """
    negative, flat = False, list[EquationFormula]()
    for factor in factors:
        if factor.op == "neg":
            negative, factor = not negative, factor.args[0]
        flat += factor.args if factor.op == "product" else (factor,)
    powers: dict[EquationFormula, int] = {}
    for factor in flat:
        base, exponent = factor, 1
        if factor.op == "power" and isinstance(factor.value, int):
            base, exponent = factor.args[0], factor.value
        powers[base] = powers.get(base, 0) + exponent
    factor = math.prod(base.value**n for base, n in powers.items() if base.op == "number")
    ordered = powers.items() if in_order else sorted(powers.items(), key=_rank)
    kept = [raised(base, n) for base, n in ordered if n and base.op != "number"]
    kept = [number(factor), *kept] if factor != 1.0 else kept
    made = kept[0] if len(kept) == 1 else EquationFormula("product", tuple(kept)) if kept else number(1.0)
    return negated(made) if negative else made


def _rank(power: tuple[EquationFormula, int]) -> int:
    """Return the order of factors: numbers, names, sums, functions last, so that no factor seems an argument."""
    base = power[0]
    if base.op == "name":
        return 0 if base.value.is_number else 1
    return 2 if base.op in ("sum", "power", "quotient") else 3


def raised(base: EquationFormula, exponent: int) -> EquationFormula:
    return base if exponent == 1 else EquationFormula("power", (base,), exponent)


def negated(x: EquationFormula) -> EquationFormula:
    """Return -x, its terms with the other sign where it is a sum."""
    if x.op == "neg":
        return x.args[0]
    if x.op == "sum":
        return EquationFormula("sum", tuple(negated(a) for a in x.args))
    return x if x == ZERO else EquationFormula("neg", (x,))


def symbols_of(formulas: Iterable[EquationFormula]) -> dict[str, Symbol]:
    """Return the symbols of formulas by key, in the order in which they are met."""
    found: dict[str, Symbol] = {}
    stack = list(formulas)[::-1]
    while stack:
        formula = stack.pop()
        if formula.op == "name":
            found.setdefault(formula.value.key, formula.value)
        elif formula.op == "table":
            found |= symbols_of(x for x in formula.value if isinstance(x, EquationFormula))
        stack += formula.args[::-1]
    return found


def identity(x: Any) -> Any:
    """Return what tells nodes and numbers apart."""
    if isinstance(x, Expr):
        return identity(x.value) if x.op == "const" else ("node", x.index)
    return ("fixed", id(x)) if isinstance(x, Fixed) else ("plain", float(x))


def worked_out(
    x: Any,
    names: SymbolNames,
    made: dict[Any, Made],
    of_node: Callable[[Any, str, Sequence[Made], Any], Made],
) -> Made:
    """Return what a node of a graph becomes, its arguments first (an explicit stack: graphs may be deep).

    made : what is known, by ``identity``, to which the new is added. of_node : f(node, op, what its arguments became,
    value).
    """
    stack = [x]
    while stack:
        top = stack[-1]
        op, args, value = names.parts(top)
        waiting = [a for a in args if identity(a) not in made]
        key = identity(top)
        if key in made or not waiting:
            stack.pop()
            if key not in made:
                made[key] = of_node(top, op, [made[identity(a)] for a in args], value)
        else:
            stack += reversed(waiting)
    return made[identity(x)]


class Temporaries:
    """Formulas of a graph in which a value that is used twice, or is long, has a name.

    ``where`` : the names with their formulas, each made of earlier ones.
    """

    def __init__(self, names: SymbolNames, outputs: Mapping[str, Sequence[Scalar]]) -> None:
        self.names = names
        self.where: list[tuple[Symbol, EquationFormula]] = []
        self._uses: dict[Any, int] = {}
        self._made: dict[Any, EquationFormula] = {}
        entries = [x for output in outputs.values() for x in output]
        self._count(entries)
        self.formulas = {name: [self._formula(x) for x in output] for name, output in outputs.items()}

    def _count(self, entries: Sequence[Any]) -> None:
        pending, seen = list(entries), set[Any]()
        while pending:
            x = pending.pop()
            key = identity(x)
            self._uses[key] = self._uses.get(key, 0) + 1
            if key not in seen:
                seen.add(key)
                pending += self.names.parts(x)[1]

    def _formula(self, x: Any) -> EquationFormula:
        return worked_out(x, self.names, self._made, self._of_node)

    def _of_node(self, x: Any, op: str, args: Sequence[EquationFormula], value: Any) -> EquationFormula:
        return self._named(leaf(self.names, op, value) or _applied(op, args, value), self._uses[identity(x)])

    def _named(self, formula: EquationFormula, uses: int) -> EquationFormula:
        """Return a name for a formula that others should not hold."""
        inner = formula.args[0] if formula.op == "neg" else formula
        simple = not inner.args or (len(inner.args) == 1 and inner.leaves == 1)
        if simple or (uses == 1 and formula.leaves <= LONGEST):
            return formula
        symbol = self.names.temporary(len(self.where) + 1)
        self.where.append((symbol, formula))
        return name(symbol)


def _applied(op: str, args: Sequence[EquationFormula], value: Any) -> EquationFormula:
    """Return the formula of an operation of the graph."""
    if op in ("add", "sub"):
        return total([args[0], args[1] if op == "add" else negated(args[1])])
    if op == "neg":
        return negated(args[0])
    if op == "mul":
        return product(args)
    if op == "div":
        return quotient(args[0], args[1])
    if op == "pow":
        return EquationFormula("power", tuple(args))
    return EquationFormula(op, tuple(args), value)


def quotient(a: EquationFormula, b: EquationFormula) -> EquationFormula:
    """Return a / b, signs before it."""
    negative = (a.op == "neg") != (b.op == "neg")
    a, b = (x.args[0] if x.op == "neg" else x for x in (a, b))
    made = EquationFormula("quotient", (a, b))
    return negated(made) if negative else made
