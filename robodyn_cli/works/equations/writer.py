"""What all forms of written equations share: how formulas are put together, what is listed and in which order."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from robodyn_cli.works.equations.names import Symbol
from robodyn_cli.works.equations.tree import EquationFormula
from robodyn_cli.works.equations.written import Written, WrittenTerm

# how tightly an expression holds its parts together
SUM, PRODUCT, POWER, WHOLE = 1, 2, 3, 4
Part = tuple[str, int]


def digits(value: float) -> str:
    """Return a number with all its digits, a whole one without a point; what rounding leaves behind 15 is dropped."""
    short = f"{value:.15g}"
    return short if abs(float(short) - value) <= 4e-16 * abs(value) else repr(value)


class FormWriter:
    """Formulas in one form. tables : functions that are given by tables, in the order in which they are met."""

    TIMES, PLUS, MINUS = "*", " + ", " - "

    def __init__(self) -> None:
        self.tables: list[Any] = []

    def formula(self, x: EquationFormula) -> str:
        """Return a formula on its own."""
        return self.part(x)[0]

    def plain(self, text: str) -> str:
        """Return a formula on one line, without marks where lines may end."""
        return text

    def part(self, x: EquationFormula) -> Part:
        """Return a formula as a part of another one."""
        if x.op == "number":
            return self.number(x.value), WHOLE
        if x.op == "name":
            return self.symbol(x.value), WHOLE
        if x.op == "neg":
            return f"-{self.inside(x.args[0], PRODUCT)}", SUM
        if x.op == "sum":
            return self.sum(x.args), SUM
        if x.op == "product":
            return self.TIMES.join(self.inside(a, PRODUCT) for a in x.args), PRODUCT
        if x.op == "quotient":
            return self.quotient(*x.args)
        if x.op == "power":
            exponent = x.value if x.value is not None else x.args[1]
            return self.power(x.args[0], exponent), POWER
        if x.op == "where":
            return self.choice(*x.args), WHOLE
        if x.op == "table":
            return self.table(x.value, x.args[0]), WHOLE
        return self.call(x.op, x.args), WHOLE

    def inside(self, x: EquationFormula, held: int) -> str:
        """Return a formula as a part of one that holds so tightly."""
        text, own = self.part(x)
        return text if own >= held else f"({text})"

    def sum(self, terms: Sequence[EquationFormula]) -> str:
        text = self.formula(terms[0])
        for term in terms[1:]:
            if term.op == "neg":
                text += self.MINUS + self.inside(term.args[0], PRODUCT)
            else:
                text += self.PLUS + self.inside(term, SUM)
        return text

    def number(self, value: float) -> str:
        return digits(value)

    def symbol(self, symbol: Symbol) -> str:
        raise NotImplementedError

    def quotient(self, above: EquationFormula, below: EquationFormula) -> Part:
        return f"{self.inside(above, PRODUCT)}/{self.inside(below, POWER)}", PRODUCT

    def power(self, base: EquationFormula, exponent: Any) -> str:
        raise NotImplementedError

    def choice(self, x: EquationFormula, a: EquationFormula, b: EquationFormula) -> str:
        raise NotImplementedError

    def table(self, table: Any, x: EquationFormula) -> str:
        raise NotImplementedError

    def call(self, function: str, args: Sequence[EquationFormula]) -> str:
        return f"{function}({', '.join(self.formula(a) for a in args)})"

    def table_number(self, table: Any) -> int:
        """Return the number of a table, counted from one."""
        for k, known in enumerate(self.tables):
            if known is table:
                return k + 1
        self.tables.append(table)
        return len(self.tables)


def listed(term: WrittenTerm) -> Iterator[tuple[int, int, EquationFormula]]:
    """Yield rows, columns and entries that are not zero; of a symmetric matrix the upper half."""
    for i, row in enumerate(term.rows):
        for k, entry in enumerate(row):
            if term.term.name == "M" and k < i:
                continue
            if entry.op != "number" or entry.value != 0.0:
                yield i, k, entry


def table_text(table: Any) -> str:
    """Return what a function by a table is, in words."""
    knots, rows, held = table
    kind = {1: "steps", 2: "straight lines"}.get(len(rows), f"polynomials of degree {len(rows) - 1}")
    ends = "held beyond" if held is not None else "going on beyond"
    return f"{kind} between {len(knots)} knots from {digits(float(knots[0]))} to {digits(float(knots[-1]))}, {ends}"


def value_text(symbol: Symbol) -> str:
    """Return the value of a number with its unit, or what a symbol means."""
    if symbol.value is None:
        return symbol.meaning
    unit = symbol.unit if symbol.unit != "1" else ""
    return f"{digits(symbol.value)} {unit}".strip()


def origin_text(symbol: Symbol) -> str:
    """Return where a number comes from."""
    if symbol.value is None:
        return ""
    return (
        f"{symbol.place}, {symbol.meaning}"
        if symbol.place and symbol.meaning
        else symbol.place or symbol.meaning
    )


def unknown_torques(w: Written) -> bool:
    return any(x.op == "name" for x in w.unknown)
