"""Equations of motion as a module of Python that makes them in SymPy."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import Any

from robodyn_cli.version import __version__
from robodyn_cli.works.equations.names import Symbol
from robodyn_cli.works.equations.tree import EquationFormula
from robodyn_cli.works.equations.writer import (
    POWER,
    PRODUCT,
    FormWriter,
    Part,
    digits,
    origin_text,
    unknown_torques,
    value_text,
)
from robodyn_cli.works.equations.written import Written, WrittenTerm

WIDTH = 110
FUNCTIONS = {"abs": "Abs", "min": "Min", "max": "Max"}
HALVES = 64  # denominators up to which a fraction is written as one


class SympyForm(FormWriter):
    """Formulas in SymPy; ``sp`` is its module."""

    def number(self, value: float) -> str:
        return exact(value)

    def part(self, x: EquationFormula) -> Part:
        if x.op == "number" and not float(x.value).is_integer():
            text = exact(x.value)
            return text, PRODUCT if "/" in text else 4
        return super().part(x)

    def symbol(self, symbol: Symbol) -> str:
        return symbol.key

    def quotient(self, above: EquationFormula, below: EquationFormula) -> Part:
        return f"{self.inside(above, PRODUCT)}/{self.inside(below, POWER)}", PRODUCT

    def power(self, base: EquationFormula, exponent: Any) -> str:
        held = self.inside(base, POWER + 1)
        return f"{held}**{exponent}" if isinstance(exponent, int) else f"{held}**({self.formula(exponent)})"

    def choice(self, x: EquationFormula, a: EquationFormula, b: EquationFormula) -> str:
        return f"sp.Piecewise(({self.formula(a)}, {self.formula(x)} > 0), ({self.formula(b)}, True))"

    def table(self, table: Any, x: EquationFormula) -> str:
        return f"table{self.table_number(table)}({self.formula(x)})"

    def call(self, function: str, args: Sequence[EquationFormula]) -> str:
        inside = ", ".join(self.formula(a) for a in args)
        if function == "round":
            return f"sp.floor({inside} + sp.Rational(1, 2))"
        return f"sp.{FUNCTIONS.get(function, function)}({inside})"

    def inside(self, x: EquationFormula, held: int) -> str:
        text, own = self.part(x)
        return text if own >= held and not (held > PRODUCT and text.startswith("-")) else f"({text})"


def exact(value: float) -> str:
    """Return a number as SymPy keeps it: whole numbers and fractions by powers of two exactly."""
    if float(value).is_integer() and abs(value) < 2**53:
        return str(int(value))
    above, below = float(value).as_integer_ratio()
    return f"sp.Rational({above}, {below})" if below <= HALVES else digits(value)


def sympy_of(w: Written) -> str:
    """Return the text of a module."""
    writer = SympyForm()
    body: list[str] = []
    if w.where:
        body += ["", "# parts of the equations, each made of earlier ones"]
        body += ["where = []"]
        for symbol, formula in w.where:
            body += [
                f"{symbol.key} = sp.Symbol({symbol.key!r}, real=True)",
                *_lines(f"where.append(({symbol.key}, ", writer.formula(formula), "))"),
            ]
    for term in w.terms:
        body += ["", f"# {term.term.meaning}", *_term(writer, term)]
    body += _torques(w)
    tables = [line for k, table in enumerate(writer.tables) for line in _table(k + 1, table)]
    return "\n".join([*_head(w), *_symbols(w), *tables, *body, *_together(w)])


def _head(w: Written) -> list[str]:
    quasi = w.source.quasi
    rate, second = ("v", "vd") if quasi else ("qd", "qdd")
    names = {name for name in ("C", "G") if w.term(name)}
    left = " + ".join([f"M {second}", *sorted(names)])
    right = " + ".join(["tau", *(f"F_{x}" for x in w.forces), *(["Psi^T lam"] if w.term("Psi") else [])])
    lines = [f"{left} = {right}"]
    if w.term("eta"):
        moved = " + eta_t" if w.term("eta_t") else ""
        lines.append(f"eta = 0, Psi {rate}{moved} = 0, Psi {second} + gamma = 0")
    title = w.title.replace("\\", "/").replace('"', "'")
    out = [f'"""Equations of motion: {title}', "", *(f"    {line}" for line in lines), ""]
    if w.where:
        out += ["Matrices hold the names of ``where``: put these in from the last to the first, or evaluate them from "
                "the first", "to the last."]  # fmt: skip
    for note in w.source.notes:
        out += textwrap.wrap(f"Not part: {_plain(note)}.", WIDTH)
    return [*out, f'Written by robodyn {__version__}; ``values`` are those of the scene, in SI units.', '"""', "",
            "import sympy as sp"]  # fmt: skip


def _plain(text: str) -> str:
    return text.replace("\\", "/").replace('"""', "'''")


def _symbols(w: Written) -> list[str]:
    """Return the lines that make coordinates, rates, accelerations and numbers."""
    rate, second = ("v", "vd") if w.source.quasi else ("qd", "qdd")
    groups = [("q", w.positions), (rate, w.rates), (second, w.accelerations)]
    if w.multipliers:
        groups.append(("lam", w.multipliers))
    lines = ["", "# coordinates, rates, accelerations; multipliers of constraints"]
    for name, symbols in groups:
        lines += [f"{s.key} = sp.Symbol({s.key!r}, real=True)" for s in symbols]
        lines += _lines(f"{name} = sp.Matrix([", ", ".join(s.key for s in symbols), "])")
    lines += ["", "# numbers of the scene, and other names"]
    known = []
    for s in w.legend:
        origin = origin_text(s) if s.value is not None else value_text(s)
        note = textwrap.shorten(f"{f'[{s.unit}] ' if s.unit else ''}{_plain(origin)}", 80, placeholder=" ...")
        lines.append(f"{s.key} = sp.Symbol({s.key!r}, real=True)  # {printable(note)}")
        if s.value is not None:
            known.append(f"    {s.key}: {digits(s.value)},")
    return [*lines, "values = {", *known, "}"] if known else [*lines, "values = {}"]


def printable(text: str) -> str:
    return "".join(x if x.isprintable() else " " for x in text)


def _lines(start: str, text: str, end: str) -> list[str]:
    """Return a statement, long ones on lines of their own inside of its brackets."""
    if len(start) + len(text) + len(end) <= WIDTH:
        return [f"{start}{text}{end}"]
    return [start.rstrip(), *_wrapped(text, 4), end]


def _wrapped(text: str, indent: int) -> list[str]:
    room = " " * indent
    return textwrap.wrap(
        text,
        WIDTH,
        initial_indent=room,
        subsequent_indent=room,
        break_long_words=False,
        break_on_hyphens=False,
    )


def _term(writer: SympyForm, term: WrittenTerm) -> list[str]:
    lines = [f"{term.term.name} = sp.Matrix(["]
    for row in term.rows:
        entries = [writer.formula(x) for x in row]
        if len(together := ", ".join(entries)) + 7 <= WIDTH:
            lines.append(f"    [{together}],")
        else:
            inside = [line for entry in entries for line in _wrapped(f"{entry},", 8)]
            lines += ["    [", *inside, "    ],"]
    return [*lines, "])"]


def _torques(w: Written) -> list[str]:
    """Return the lines that add torques which the scene does not give to those that it gives."""
    writer, given = SympyForm(), w.term("tau")
    if given is not None and not unknown_torques(w):
        return []
    start = "tau = tau + sp.Matrix([" if given is not None else "tau = sp.Matrix(["
    return ["", "# torques of actuators that the scene does not give",
            *_lines(start, ", ".join(writer.formula(x) for x in w.unknown), "])")]  # fmt: skip


def _together(w: Written) -> list[str]:
    second = "vd" if w.source.quasi else "qdd"
    terms = [f"M @ {second}", *(name for name in ("C", "G") if w.term(name))]
    taken = ["tau", *(f"F_{x}" for x in w.forces), *(["Psi.T @ lam"] if w.term("Psi") else [])]
    return ["", "# zero along a motion", f"residual = {' + '.join(terms)} - ({' + '.join(taken)})", ""]


def _table(k: int, table: Any) -> list[str]:
    """Return the function of a table: polynomials of the segment that x lies in."""
    knots, rows, held = table
    lines = ["", "", f"def table{k}(x):", "    return sp.Piecewise("]
    if held is not None:
        lines.append(f"        ({float(held[0])!r}, x < {float(knots[0])!r}),")
    last = len(knots) - 2
    for j in range(last + 1):
        s = f"(x - {float(knots[j])!r})"
        terms = [f"{float(row[j])!r}{f'*{s}**{n}' if n else ''}" for n, row in enumerate(rows)]
        ends = held is None and j == last
        condition = "True" if ends else f"x < {float(knots[j + 1])!r}"
        lines.append(f"        ({' + '.join(terms)}, {condition}),")
    if held is not None:
        lines.append(f"        ({float(held[1])!r}, True),")
    return [*lines, "    )", ""]
