"""Mutants to choose a list from: ``python -m tests.mutants.propose COUNT --seed 1``, spread over the modules of the rooms."""

from __future__ import annotations

import argparse
import ast
import itertools
import random
from collections.abc import Iterator
from pathlib import Path

from tests.mutants.listed import LIST, MODULE, PACKAGE, Mutant, functions, listed
from tests.mutants.rooms import files

SIGNS = {
    ast.Add: ("+", "-"),
    ast.Sub: ("-", "+"),
    ast.Mult: ("*", "/"),
    ast.Div: ("/", "*"),
    ast.FloorDiv: ("//", "*"),
}
COMPARISONS = {
    ast.Lt: ("<", ">="), ast.LtE: ("<=", ">"), ast.Gt: (">", "<="), ast.GtE: (">=", "<"), ast.Eq: ("==", "!="),
    ast.NotEq: ("!=", "=="),
}  # fmt: skip
SMALL = 1e-2  # constants below it bound rounding: no test knows them
BOUNDS = {"abs", "max", "min", "maximum", "minimum", "sqrt", "nanmax"}
SWAPPED = {"max": "min", "min": "max", "maximum": "minimum", "minimum": "maximum", "sum": "max", "any": "all", "all": "any", "argmax": "argmin"}  # fmt: skip


class _Sites(ast.NodeVisitor):
    """Replacements of text in one file: (row, first column, last column, text, function)."""

    def __init__(self, text: str) -> None:
        self.text, self.lines = text, text.splitlines()
        self.found: list[tuple[int, int, int, str, str]] = []
        self.place = MODULE

    def add(self, node: ast.expr | ast.stmt, text: str | None) -> None:
        if text is not None and node.lineno == node.end_lineno:
            self.found.append((node.lineno - 1, node.col_offset, node.end_col_offset or 0, text, self.place))

    def part(self, node: ast.expr) -> str:
        return ast.get_source_segment(self.text, node) or ""

    def visit_ClassDef(self, node: ast.ClassDef) -> None:
        outer, self.place = self.place, "" if self.place == MODULE else self.place
        self.place += f"{node.name}."
        for child in node.body:
            if isinstance(child, (ast.FunctionDef, ast.ClassDef)):
                self.visit(child)
        self.place = outer

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        if self.place.endswith(".") or self.place == MODULE:
            outer, self.place = self.place, f"{self.place.removeprefix(MODULE)}{node.name}"
        else:
            outer = self.place
        for child in node.body:
            self.visit(child)
        self.place = outer

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        if node.value is not None:
            self.visit(node.value)

    def visit_Expr(self, node: ast.Expr) -> None:
        if not isinstance(node.value, ast.Constant):
            self.generic_visit(node)

    def visit_JoinedStr(self, node: ast.JoinedStr) -> None:
        """Text for people is not looked at."""

    def visit_Raise(self, node: ast.Raise) -> None:
        """Nor are messages."""

    def visit_Subscript(self, node: ast.Subscript) -> None:
        self.visit(node.value)  # places are not: most of these faults are seen at once

    def between(self, left: ast.expr, right: ast.expr) -> str | None:
        """Return the text between two operands of one row, their brackets included."""
        if left.end_lineno != right.lineno:
            return None
        line = self.lines[right.lineno - 1].encode()
        return line[left.end_col_offset : right.col_offset].decode()

    def with_sign(self, node: ast.expr, operands: list[ast.expr], old: str, new: str) -> str | None:
        """Return the text of an operation with another sign."""
        if node.lineno != node.end_lineno:
            return None
        line = self.lines[node.lineno - 1].encode()
        text = line[node.col_offset : operands[0].end_col_offset].decode()
        for left, right in itertools.pairwise(operands):
            text += (self.between(left, right) or "").replace(old, new, 1) + self.part(right)
        return text + line[operands[-1].end_col_offset : node.end_col_offset].decode()

    def visit_BinOp(self, node: ast.BinOp) -> None:
        old, new = SIGNS.get(type(node.op), ("", ""))
        of_text = any(
            isinstance(x, (ast.JoinedStr, ast.List)) or '"' in self.part(x) for x in (node.left, node.right)
        )
        if new and node.lineno == node.end_lineno and not of_text:
            self.add(node, self.with_sign(node, [node.left, node.right], old, new))
            self.add(node, self.inner(node.left))
        elif isinstance(node.op, ast.Pow) and self.part(node.right) in ("2", "3"):
            self.add(node, f"{self.inner(node.left)}**{5 - int(self.part(node.right))}")
        self.generic_visit(node)

    def inner(self, node: ast.expr) -> str:
        """Return the text of an operand, in brackets where it may need them."""
        simple = isinstance(node, (ast.Name, ast.Attribute, ast.Call, ast.Subscript, ast.Constant))
        return self.part(node) if simple else f"({self.part(node)})"

    def visit_Compare(self, node: ast.Compare) -> None:
        old, new = COMPARISONS.get(type(node.ops[0]), ("", ""))
        if new and len(node.ops) == 1:
            self.add(node, self.with_sign(node, [node.left, node.comparators[0]], old, new))
        self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> None:
        value = node.value
        if isinstance(value, bool):
            self.add(node, str(not value))
        elif isinstance(value, float) and (value == 0.0 or SMALL <= value < 1.0 / SMALL):
            self.add(node, "1.0" if value == 0.0 else f"{2.0 * value!r}")

    def visit_Call(self, node: ast.Call) -> None:
        name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        of_numpy = isinstance(node.func, ast.Name) or self.part(node.func).startswith("np.")
        if (
            name in BOUNDS
            and of_numpy
            and node.args
            and not isinstance(node.args[0], (ast.Starred, ast.GeneratorExp))
        ):
            self.add(node, self.inner(node.args[-1] if len(node.args) == 2 else node.args[0]))
        elif name in SWAPPED and not any(x.arg == "initial" for x in node.keywords):
            self.add(
                node,
                f"{self.part(node.func)[: -len(name)]}{SWAPPED[name]}{self.part(node)[len(self.part(node.func)) :]}",
            )
        self.generic_visit(node)

    def visit_UnaryOp(self, node: ast.UnaryOp) -> None:
        if isinstance(node.op, (ast.USub, ast.Not)) and not isinstance(node.operand, ast.Constant):
            self.add(node, self.inner(node.operand))
        self.generic_visit(node)

    def visit_BoolOp(self, node: ast.BoolOp) -> None:
        old, new = ("and", "or") if isinstance(node.op, ast.And) else ("or", "and")
        self.add(node, self.with_sign(node, node.values, old, new))
        self.generic_visit(node)

    def visit_If(self, node: ast.If) -> None:
        self.add(node.test, "False")
        self.generic_visit(node)

    def visit_IfExp(self, node: ast.IfExp) -> None:
        self.add(node, self.part(node.body))
        self.generic_visit(node)


def mutants_of(path: Path) -> Iterator[Mutant]:
    """Yield the mutants of a file that the operators make, in the order of the source."""
    text = path.read_text(encoding="utf-8")
    sites = _Sites(text)
    sites.visit(ast.parse(text))
    lines = sites.lines
    for row, first, last, new, place in sorted(set(sites.found)):
        line = lines[row].encode()
        becomes = (line[:first] + new.encode() + line[last:]).decode()
        begin, end = functions(path)[place]
        alike = [k for k in range(begin, end) if lines[k].strip() == lines[row].strip()]
        if place == MODULE or "\n" in new or becomes == lines[row]:
            continue
        yield Mutant(
            path.relative_to(PACKAGE).as_posix(),
            place,
            lines[row].strip(),
            becomes.strip(),
            alike.index(row) + 1,
        )


def proposed(count: int, seed: int, known: list[Mutant]) -> list[Mutant]:
    """Return mutants at different lines, from each file as many as the root of what there are, by chance but the same
    for the same seed."""
    random_ = random.Random(seed)
    taken = {(x.file, x.function, x.line) for x in known}
    by_file = {path: list(mutants_of(path)) for path in files()}
    weights = {path: len(own) ** 0.5 for path, own in by_file.items()}
    whole, chosen = sum(weights.values()), []
    for path, own in by_file.items():
        left = round(count * weights[path] / whole + random_.random() - 0.5)
        random_.shuffle(own)
        for mutant in own:
            key = mutant.file, mutant.function, mutant.line
            if left > 0 and key not in taken:
                taken.add(key)
                chosen.append(mutant)
                left -= 1
    return sorted(chosen, key=lambda x: (x.file, x.row()))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", type=int)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    print("\n".join(str(x) for x in proposed(asked.count, asked.seed, listed() if LIST.exists() else [])))
