"""Equations of motion as text for a terminal."""

from __future__ import annotations

import re
import textwrap
import unicodedata
from collections.abc import Iterable, Sequence
from typing import Any

from robodyn_cli.works.equations.names import Symbol
from robodyn_cli.works.equations.tree import EquationFormula
from robodyn_cli.works.equations.writer import (
    POWER,
    SUM,
    FormWriter,
    Part,
    listed,
    origin_text,
    table_text,
    unknown_torques,
    value_text,
)
from robodyn_cli.works.equations.written import Written, WrittenTerm

WIDTH = 80
TOGETHER = 40  # columns of a part that stays on one line
TIED = "\N{NO-BREAK SPACE}"
RAISED = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")
LOWERED = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")
# letters of the terms, and what they depend on
LETTERS = {
    "M": "M",
    "C": "C",
    "G": "G",
    "tau": "τ",
    "eta": "η",
    "Psi": "Ψ",
    "gamma": "γ",
    "eta_t": "η_t",
    "qdot": "q̇",
}


class TextForm(FormWriter):
    """Formulas in Unicode."""

    TIMES, PLUS, MINUS = "·", f" +{TIED}", f" -{TIED}"

    def plain(self, text: str) -> str:
        return text.replace(TIED, " ")

    def symbol(self, symbol: Symbol) -> str:
        return symbol.text

    def power(self, base: EquationFormula, exponent: Any) -> str:
        held = self.inside(base, POWER + 1)
        if isinstance(exponent, int):
            return held + str(exponent).translate(RAISED)
        return f"{held}^{self.inside(exponent, POWER + 1)}"

    def choice(self, x: EquationFormula, a: EquationFormula, b: EquationFormula) -> str:
        return f"[{self.formula(a)} if {self.formula(x)} > 0, else {self.formula(b)}]"

    def table(self, table: Any, x: EquationFormula) -> str:
        return f"table{self.table_number(table)}({self.formula(x)})"

    def call(self, function: str, args: Sequence[EquationFormula]) -> str:
        if function == "abs":
            return f"|{self.formula(args[0])}|"
        if function == "sqrt" and args[0].op in ("number", "name"):
            return f"√{self.formula(args[0])}"
        return together(super().call(function, args))

    def inside(self, x: EquationFormula, held: int) -> str:
        text = super().inside(x, held)
        return together(text) if text.startswith("(") else text

    def quotient(self, above: EquationFormula, below: EquationFormula) -> Part:
        text, held = super().quotient(above, below)
        return text, min(held, SUM + 1)


def together(text: str) -> str:
    """Return a part of a formula that no line ends in, unless it is long."""
    return text.replace(" ", TIED) if columns(text) <= TOGETHER else text


def columns(text: str) -> int:
    """Return how wide a text is on a terminal; marks above letters take no room."""
    return sum(not unicodedata.combining(letter) for letter in text)


def entry_lines(label: str, text: str, room: int) -> list[str]:
    """Return `label = text`, labels in a column so wide, on lines of at most 80 columns."""
    head = f"  {label}{' ' * (room - columns(label))} = "
    first, *rest = filled(text, max(WIDTH - columns(head), 30))
    return [head + first, *(" " * columns(head) + line for line in rest)]


def filled(text: str, room: int) -> list[str]:
    """Return the lines of a formula: they end before signs, and within long parts before signs or behind factors."""
    pieces: list[str] = []
    for word in text.split(" "):
        inner = [word] if columns(word) <= room else re.sub(f"{TIED}(?=[+-]{TIED})", " ", word).split(" ")
        for part in inner:
            cut = [part] if columns(part) <= room else re.split("(?<=·)", part)
            pieces += [f" {cut[0]}", *cut[1:]]
    lines = [""]
    for piece in pieces:
        if columns(lines[-1]) + columns(piece) > room and lines[-1]:
            lines.append("")
        lines[-1] += piece if lines[-1] else piece.removeprefix(" ")
    return [line.replace(TIED, " ") for line in lines]


def text_of(w: Written) -> str:
    """Return the equations of motion as text."""
    writer = TextForm()
    blocks = [[w.title, "", *(f"  {line}" for line in _equations(w))], _coordinates(w)]
    blocks += [_term(writer, term) for term in w.terms]
    if w.where:
        entries = [(symbol.text, writer.formula(formula)) for symbol, formula in w.where]
        blocks.append(["where", *_entries(entries)])
    blocks.append(_legend(w))
    if writer.tables:
        blocks.append([
            "Tables", *_entries((f"table{k + 1}(x)", table_text(table)) for k, table in enumerate(writer.tables))
        ])  # fmt: skip
    blocks.append(_notes(w))
    return "\n\n".join("\n".join(block) for block in blocks if block)


def _equations(w: Written) -> list[str]:
    quasi = w.source.quasi
    rate, second = ("v", "v̇") if quasi else ("q̇", "q̈")
    left = [f"M(q) {second}"]
    left += [f"C(q, {rate})"] if w.term("C") else []
    left += ["G(q)"] if w.term("G") else []
    right = ["τ"] if w.term("tau") or unknown_torques(w) else []
    right += [f"F_{kind}" for kind in w.forces]
    right += ["Ψᵀ λ"] if w.term("Psi") else []
    lines = [f"{' + '.join(left)} = {' + '.join(right) or '0'}"]
    if w.term("eta"):
        at = ", t" if w.term("eta_t") else ""
        lines += [f"η(q{at}) = 0,  Ψ {rate}{' + η_t' if w.term('eta_t') else ''} = 0,  Ψ {second} + γ = 0"]
    return lines


def _coordinates(w: Written) -> list[str]:
    groups: list[tuple[str, Sequence[Symbol]]] = [("q", w.positions)]
    if w.source.quasi:
        groups.append(("v", w.rates))
    lines = [entry for letter, symbols in groups
             for entry in entry_lines(letter, ", ".join(s.text for s in symbols), 1)]  # fmt: skip
    if unknown_torques(w):
        lines += entry_lines("τ", _torques(w), 1)
    if w.multipliers:
        lines += entry_lines("λ", ", ".join(s.text for s in w.multipliers), 1)
    return lines


def _torques(w: Written) -> str:
    """Return the torques of actuators, with those that the scene gives."""
    given = w.term("tau")
    return ", ".join(
        "given below" if given is not None and _is_given(given, k) else TextForm().formula(x)
        for k, x in enumerate(w.unknown)
    )


def _is_given(term: WrittenTerm, row: int) -> bool:
    entry = term.rows[row][0]
    return entry.op != "number" or entry.value != 0.0


def _term(writer: TextForm, term: WrittenTerm) -> list[str]:
    name = term.term.name
    letter = LETTERS.get(name, name)
    size = f" ({len(term.rows)} × {len(term.rows[0])})" if term.is_matrix else ""
    entries = []
    for i, k, entry in listed(term):
        below = label(i, k, max(len(term.rows), len(term.rows[0]))) if term.is_matrix else label(i)
        text = f"{letter}{below}"
        if name == "M" and i != k:
            text += f" = {letter}{label(k, i, len(term.rows))}"
        entries.append((text, writer.formula(entry)))
    named = name in ("eta", "Psi", "gamma", "eta_t")
    rows = f"; rows: {', '.join(term.term.rows)}" if name == "eta" else ""
    zero = "" if len(entries) else ": zero"
    others = "; entries that are not listed are zero" if named and 0 < len(entries) < _size(term) else ""
    head = f"{letter}{size}  {term.term.meaning}{zero}{rows}{others}"
    heads = textwrap.wrap(
        head, WIDTH, subsequent_indent="   ", break_long_words=False, break_on_hyphens=False
    )
    return [*heads, *_entries(entries)]


def _size(term: WrittenTerm) -> int:
    return sum(len(row) for row in term.rows)


def label(row: int, column: int | None = None, size: int = 0) -> str:
    """Return the index of an entry, counted from one."""
    text = str(row + 1).translate(LOWERED)
    if column is None:
        return text
    return text + ("," if size > 9 else "") + str(column + 1).translate(LOWERED)


def _entries(entries: Iterable[tuple[str, str]]) -> list[str]:
    listed_entries = list(entries)
    room = max([columns(name) for name, _ in listed_entries], default=0)
    return [line for name, text in listed_entries for line in entry_lines(name, text, room)]


def _legend(w: Written) -> list[str]:
    rows = [(s.text, value_text(s), origin_text(s)) for s in w.legend]
    if not rows:
        return []
    first = max(columns(name) for name, _, _ in rows)
    second = max([len(value) for _, value, origin in rows if origin], default=0)
    room = WIDTH - first - 7  # for value and origin
    apart = all(second + len(origin) <= room for _, _, origin in rows)
    lines = []
    for name, value, origin in rows:
        text = (
            f"{value:<{second}}  {origin}" if origin and apart else ", ".join(x for x in (value, origin) if x)
        )
        head = f"  {name}{' ' * (first - columns(name))} = "
        wrapped = textwrap.wrap(text, room + 2, break_long_words=False, break_on_hyphens=False)
        lines += [head + wrapped[0], *(f"{' ' * columns(head)}  {line}" for line in wrapped[1:])]
    return ["with", *lines]


def _notes(w: Written) -> list[str]:
    lines: list[str] = []
    for note in w.source.notes:
        lines += textwrap.wrap(note, WIDTH, initial_indent="  ", subsequent_indent="    ")
    return ["not part of the equations", *lines] if lines else []
