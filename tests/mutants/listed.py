"""The list of deliberate faults: each is a line of a function, found by its text, and what stands there instead.

A block of ``list.txt`` is a mutant: its file below ``robodyn_cli``, its function (``Class.method``, or ``<module>`` for
a constant), the line as it is (``-2`` for the second line of that text), as it becomes, and, where no test can tell the
two apart, why. A line that begins with ``#`` is a comment.

    drives/cycle.py other_limits
    - cube = samples.mean(rate * size**3)
    + cube = samples.mean(rate * size**2)
    = why this is no fault
"""

from __future__ import annotations

import ast
import dataclasses
import functools
import gc
import importlib
import sys
from collections.abc import Iterator
from pathlib import Path
from types import CodeType, FunctionType

import robodyn_cli

PACKAGE = Path(robodyn_cli.__file__).parent
LIST = Path(__file__).with_name("list.txt")
MODULE = "<module>"


class Gone(Exception):
    """The line of a mutant is no longer there."""


@dataclasses.dataclass(frozen=True)
class Mutant:
    """A fault. number : which line of this text in the function it is, from 1. equivalent : why it is none."""

    file: str
    function: str
    line: str
    becomes: str
    number: int = 1
    equivalent: str = ""

    def __str__(self) -> str:
        mark = "-" if self.number == 1 else f"-{self.number}"
        text = f"{self.file} {self.function}\n{mark} {self.line}\n+ {self.becomes}\n"
        return f"{text}= {self.equivalent}\n" if self.equivalent else text

    @property
    def path(self) -> Path:
        return PACKAGE / self.file

    @property
    def place(self) -> str:
        """Its function as ``runner`` names it."""
        return f"{self.file} {self.function}"

    def row(self) -> int:
        """Return the row of its line in its file, from 0. Raises Gone."""
        nodes = functions(self.path)
        if self.function not in nodes:
            raise Gone(f"{self.place}: no such function")
        lines = self.path.read_text(encoding="utf-8").splitlines()
        first, last = nodes[self.function]
        rows = [k for k in range(first, last) if lines[k].strip() == self.line]
        if len(rows) < self.number:
            raise Gone(f"{self.place}: no line {self.line!r}")
        return rows[self.number - 1]

    @property
    def is_gone(self) -> bool:
        """Whether its line is no longer there."""
        try:
            self.row()
        except Gone:
            return True
        return False

    def source(self) -> str:
        """Return the text of its file with the fault."""
        lines, row = self.path.read_text(encoding="utf-8").splitlines(), self.row()
        lines[row] = lines[row][: -len(lines[row].lstrip())] + self.becomes
        return "\n".join(lines) + "\n"

    def commit(self) -> None:
        """Put the fault into the functions, or the constant, that this process has loaded."""
        tree = ast.parse(self.source())
        module = importlib.import_module("robodyn_cli." + self.file[:-3].replace("/", "."))
        if self.function == MODULE:
            row = self.row() + 1
            (statement,) = (x for x in tree.body if x.lineno <= row <= (x.end_lineno or 0))
            target = statement.target if isinstance(statement, ast.AnnAssign) else statement.targets[0]  # type: ignore[attr-defined]
            old = vars(module)[target.id]
            exec(compile(ast.Module([statement], []), str(self.path), "exec"), vars(module))
            for other in [x for name, x in sys.modules.items() if name.startswith("robodyn_cli")]:
                if vars(other).get(target.id) is old:
                    setattr(other, target.id, vars(module)[target.id])
            return
        new = next(x for x in _codes(compile(tree, str(self.path), "exec")) if x.co_qualname == self.function)
        changed = 0
        gc.unfreeze()  # what tests/conftest.py has frozen is listed too
        for thing in gc.get_objects():
            if isinstance(thing, FunctionType):
                code = thing.__code__
                if code.co_qualname == self.function and code.co_filename == str(self.path):
                    thing.__code__ = new
                    changed += 1
        assert changed, f"{self.place} is not loaded"


def _codes(code: CodeType) -> Iterator[CodeType]:
    yield code
    for part in code.co_consts:
        if isinstance(part, CodeType):
            yield from _codes(part)


@functools.cache
def functions(path: Path) -> dict[str, tuple[int, int]]:
    """Return the rows [first, last) of the functions and methods of a file by their names, and of all of it."""
    text = path.read_text(encoding="utf-8")
    found = {MODULE: (0, text.count("\n"))}

    def look(node: ast.AST, prefix: str) -> None:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.FunctionDef):
                found[prefix + child.name] = child.lineno - 1, child.end_lineno or 0
            elif isinstance(child, ast.ClassDef):
                look(child, f"{prefix}{child.name}.")

    look(ast.parse(text), "")
    return found


def listed(path: Path = LIST) -> list[Mutant]:
    """Return the mutants of a list."""
    rows = [x for x in path.read_text(encoding="utf-8").splitlines() if not x.startswith("#")]
    blocks = [x.split("\n") for x in "\n".join(rows).split("\n\n")]
    return [_read([x for x in block if x.strip()]) for block in blocks if any(x.strip() for x in block)]


def _read(block: list[str]) -> Mutant:
    file, function = block[0].split(" ")
    mark, _, line = block[1].partition(" ")
    assert mark[0] == "-" and block[2].startswith("+ "), block
    equivalent = " ".join(x.removeprefix("=").strip() for x in block[3:])
    return Mutant(file, function, line, block[2][2:], int(mark[1:] or 1), equivalent)
