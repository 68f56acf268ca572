"""Equations of motion as a LaTeX document, with amsmath alone."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable, Sequence
from typing import Any

from robodyn_cli.works.equations.names import Symbol, latex_text
from robodyn_cli.works.equations.text import columns
from robodyn_cli.works.equations.tree import EquationFormula
from robodyn_cli.works.equations.writer import (
    POWER,
    PRODUCT,
    WHOLE,
    FormWriter,
    Part,
    digits,
    listed,
    origin_text,
    table_text,
    unknown_torques,
    value_text,
)
from robodyn_cli.works.equations.written import Written, WrittenTerm

BREAK = "\0"  # where a line may end
LONGEST = 62  # letters of a line of a formula, as they are printed
LETTERS = {"M": "M", "C": "C", "G": "G", "tau": r"\tau", "eta": r"\eta", "Psi": r"\Psi", "gamma": r"\gamma",
           "eta_t": r"\eta_{t}", "qdot": r"\dot{q}"}  # fmt: skip
FUNCTIONS = {name: rf"\{name}" for name in ("sin", "cos", "tan", "sinh", "cosh", "tanh", "exp", "min", "max")} | {
    "log": r"\ln", "asin": r"\arcsin", "acos": r"\arccos", "atan": r"\arctan",
}  # fmt: skip


class LatexForm(FormWriter):
    """Formulas in LaTeX."""

    TIMES, PLUS, MINUS = r"\,", f"{BREAK} + ", f"{BREAK} - "

    def number(self, value: float) -> str:
        mantissa, e, exponent = digits(value).partition("e")
        if not e:
            return mantissa
        return rf"{mantissa} \cdot 10^{{{int(exponent)}}}"

    def plain(self, text: str) -> str:
        return _tied(text)

    def symbol(self, symbol: Symbol) -> str:
        return symbol.latex

    def quotient(self, above: EquationFormula, below: EquationFormula) -> Part:
        parts = self.formula(above), self.formula(below)
        if max(map(printed, parts)) > LONGEST:
            return f"{self.inside(above, PRODUCT)} / {self.inside(below, WHOLE)}", PRODUCT
        return rf"\frac{{{_tied(parts[0])}}}{{{_tied(parts[1])}}}", PRODUCT

    def power(self, base: EquationFormula, exponent: Any) -> str:
        held = self.inside(base, POWER + 1)
        if base.op in ("sin", "cos") and isinstance(exponent, int):
            return held.replace(rf"\{base.op}", rf"\{base.op}^{{{exponent}}}", 1)
        # an accent or index of the base must not run into the exponent
        text = str(exponent) if isinstance(exponent, int) else _tied(self.formula(exponent))
        return rf"{{{held}}}^{{{text}}}" if base.op == "name" else f"{held}^{{{text}}}"

    def choice(self, x: EquationFormula, a: EquationFormula, b: EquationFormula) -> str:
        x_, a_, b_ = (_tied(self.formula(one)) for one in (x, a, b))
        return rf"\begin{{cases}} {a_} & {x_} > 0 \\ {b_} & \text{{else}} \end{{cases}}"

    def table(self, table: Any, x: EquationFormula) -> str:
        return rf"f_{{{self.table_number(table)}}}({self.formula(x)})"

    def call(self, function: str, args: Sequence[EquationFormula]) -> str:
        if function == "sqrt" and printed(self.formula(args[0])) > LONGEST:
            return f"({self.formula(args[0])})^{{1/2}}"
        if function == "sqrt":
            return rf"\sqrt{{{_tied(self.formula(args[0]))}}}"
        if function == "abs":
            return rf"\lvert {self.formula(args[0])} \rvert"
        plain = function in ("sin", "cos", "tan") and args[0].op == "name"
        name = FUNCTIONS.get(function, rf"\operatorname{{{function}}}")
        inside = _together(", ".join(self.formula(a) for a in args))
        if plain:
            return f"{name} {inside}"
        tall = BREAK not in inside and any(x in inside for x in (r"\frac", r"\begin"))
        return rf"{name}\left({inside}\right)" if tall else f"{name}({inside})"

    def inside(self, x: EquationFormula, held: int) -> str:
        text, own = self.part(x)
        if x.op in ("sin", "cos", "tan") and x.args[0].op == "name" and held > POWER:
            return text  # \sin^2 \theta
        return text if own >= held or own == WHOLE else _together(f"({text})")


def _together(text: str) -> str:
    """Return a part of a formula that no line ends in, unless it is long."""
    return _tied(text) if printed(text) <= LONGEST // 2 else text


def _tied(text: str) -> str:
    return text.replace(BREAK, "")


def latex_of(w: Written) -> str:
    """Return a document with the equations of motion."""
    writer = LatexForm()
    blocks = [_display(_equations(w)), _display(_coordinates(w))]
    for term in w.terms:
        head = f"{term.term.meaning[0].upper()}{term.term.meaning[1:]}"
        rows = f" Rows: {latex_text(', '.join(term.term.rows))}." if term.term.name == "eta" else ""
        entries = _term(writer, term)
        zero = (
            ": zero."
            if not entries
            else "; entries that are not listed are zero."
            if _has_zeros(term)
            else "."
        )
        blocks.append(rf"\paragraph{{{latex_text(head)}}}${LETTERS.get(term.term.name, _force(term.term.name))}$"
                      f"{zero}{rows}\n{_display(entries)}")  # fmt: skip
    if w.where:
        entries = [(symbol.latex, writer.formula(formula)) for symbol, formula in w.where]
        blocks.append(f"\\paragraph{{where}}\n{_display(entries)}")
    blocks.append(_legend(w))
    blocks += [rf"\noindent $f_{{{k + 1}}}$: {table_text(table)}." for k, table in enumerate(writer.tables)]
    if w.source.notes:
        notes = "\n".join(rf"\item {latex_text(note)}" for note in w.source.notes)
        blocks.append(
            f"\\paragraph{{Not part of the equations}}\n\\begin{{itemize}}\n{notes}\n\\end{{itemize}}"
        )
    body = "\n\n".join(block for block in blocks if block)
    return (
        "\\documentclass{article}\n\\usepackage{amsmath}\n\\usepackage[margin=2cm]{geometry}\n\\allowdisplaybreaks\n"
        f"\\begin{{document}}\n\n\\section*{{{latex_text(w.title)}}}\n\n{body}\n\n\\end{{document}}"
    )


def _force(name: str) -> str:
    return rf"F_{{\mathrm{{{name.removeprefix('F_')}}}}}"


def _equations(w: Written) -> list[tuple[str, str]]:
    rate, second = ("v", r"\dot{v}") if w.source.quasi else (r"\dot{q}", r"\ddot{q}")
    left = [f"M(q)\\,{second}"]
    left += [f"C(q, {rate})"] if w.term("C") else []
    left += ["G(q)"] if w.term("G") else []
    right = [r"\tau"] if w.term("tau") or unknown_torques(w) else []
    right += [_force(kind) for kind in w.forces]
    right += [r"\Psi^{T} \lambda"] if w.term("Psi") else []
    lines = [(" + ".join(left), " + ".join(right) or "0")]
    if w.term("eta"):
        moved = f" + {LETTERS['eta_t']}" if w.term("eta_t") else ""
        lines += [(r"\eta(q, t)" if moved else r"\eta(q)", "0"), (rf"\Psi\,{rate}{moved}", "0"),
                  (rf"\Psi\,{second} + \gamma", "0")]  # fmt: skip
    return lines


def _coordinates(w: Written) -> list[tuple[str, str]]:
    def column(symbols: Iterable[str]) -> str:
        return "(" + f",{BREAK}".join(symbols) + ")^{T}"

    lines = [("q", column(s.latex for s in w.positions))]
    if w.source.quasi:
        lines.append(("v", column(s.latex for s in w.rates)))
    if unknown_torques(w) and not w.term("tau"):
        lines.append((r"\tau", column(LatexForm().formula(x) for x in w.unknown)))
    if w.multipliers:
        lines.append((r"\lambda", column(s.latex for s in w.multipliers)))
    return lines


def _has_zeros(term: WrittenTerm) -> bool:
    return any(entry.op == "number" and entry.value == 0.0 for row in term.rows for entry in row)


def _term(writer: LatexForm, term: WrittenTerm) -> list[tuple[str, str]]:
    name = term.term.name
    letter = LETTERS.get(name, _force(name))
    entries = []
    for i, k, entry in listed(term):
        comma = "," if max(len(term.rows), len(term.rows[0])) > 9 else ""
        below = f"{i + 1}{comma}{k + 1}" if term.is_matrix else f"{i + 1}"
        symbol = _indexed(letter, below)
        if name == "M" and i != k:
            symbol += f" = {_indexed(letter, f'{k + 1}{comma}{i + 1}')}"
        entries.append((symbol, writer.formula(entry)))
    return entries


def _indexed(letter: str, below: str) -> str:
    base, _, own = letter.partition("_")
    if not own:
        return f"{letter}_{{{below}}}"
    return f"{base}_{{{own.removeprefix('{').removesuffix('}')},{below}}}"


def _display(entries: Sequence[tuple[str, str]]) -> str:
    r"""Return lines `left &= right` of an align*, long ones broken before a sign."""
    lines = []
    for left, right in entries:
        first, *rest = broken(right)
        lines.append(f"{left} &= {first}")
        lines += [rf"&\qquad {line}" for line in rest]
    if not lines:
        return ""
    return "\\begin{align*}\n" + " \\\\\n".join(lines) + "\n\\end{align*}"


def broken(text: str) -> list[str]:
    """Return the lines of a formula."""
    lines = [""]
    for piece in text.split(BREAK):
        if lines[-1] and printed(lines[-1]) + printed(piece) > LONGEST:
            lines.append("")
        lines[-1] += piece
    return [f"{{}}{line}" if k and line.startswith((" +", " -")) else line for k, line in enumerate(lines)]


def printed(text: str) -> int:
    """Return about how many letters a piece of LaTeX prints."""
    text = re.sub(r"\\(mathrm|dot|ddot|frac|operatorname|text|sqrt)", "", text)
    text = re.sub(r"\\[A-Za-z]+", "x", text)
    return columns(re.sub(r"[{}\s\\^_,]", "", text))


def _legend(w: Written) -> str:
    lines = []
    for symbol in w.legend:
        relation = "=" if symbol.value is not None else ":"
        origin = textwrap.shorten(origin_text(symbol), 90, placeholder=" ...")
        lines.append(
            rf"$ {symbol.latex} $ & ${relation}$ {latex_text(value_text(symbol))} & {latex_text(origin)} \\"
        )
    if not lines:
        return ""
    # tables of more lines than a page has are many tables
    parts = [lines[k : k + 40] for k in range(0, len(lines), 40)]
    tables = "\n\n\\noindent\n".join(
        "\\begin{tabular}{@{}lll@{}}\n" + "\n".join(part) + "\n\\end{tabular}" for part in parts
    )
    return f"\\paragraph{{with}}\\mbox{{}}\\\\[1ex]\n{tables}"
