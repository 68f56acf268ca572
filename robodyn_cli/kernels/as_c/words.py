"""What names, types and numbers of IR are called in C."""

from __future__ import annotations

import re
import struct
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

from robodyn_cli.kernels.as_c.ir_text import IrFunction, vector_of
from robodyn_cli.kernels.c99 import literal

TYPES = {
    "double": "double",
    "i64": "int64_t",
    "i32": "int",
    "i8": "int",
    "i1": "int",
    "ptr": "char *",
    "void": "void",
}
LETTER = {"double": "d", "i64": "l", "i1": "l", "ptr": "p"}


def c_name(x: str) -> str:
    """Return what a register, label or function is called."""
    plain = re.sub(r"\W", "_", x.lstrip("%@"))
    return f"x{plain}" if plain[0].isdigit() else f"{plain}_" if plain == "k" else plain


def own_name(x: str) -> str:
    """Return what a function of the file is called."""
    return f"loop_{c_name(x)}"


def head(function: IrFunction) -> str:
    """Return the declaration of a function."""
    listed = [f"{declared(kind, c_name(name))}" for kind, name in function.arguments]
    return f"static {declared(function.result, own_name(function.name))}({', '.join(listed) or 'void'})"


def declared(kind: str, name: str) -> str:
    """Return the declaration of a variable."""
    kind = TYPES[kind]
    return f"{kind}{'' if kind.endswith('*') else ' '}{name}"


def table(name: str, values: Sequence[str]) -> str:
    """Return a table of doubles."""
    entries = ", ".join(number(x) for x in values)
    return f"static const double {c_name(name)}[{len(values)}] = {{{entries}}};"


def number(x: str) -> str:
    """Return a constant of IR."""
    if x.startswith("0x"):
        return literal(struct.unpack(">d", bytes.fromhex(x[2:].rjust(16, "0")))[0])
    if re.fullmatch(r"-?\d+", x):
        n = int(x)
        return "INT64_MIN" if n == -(2**63) else f"INT64_C({n})" if abs(n) >= 2**31 else str(n)
    words = {"true": "1", "false": "0", "poison": "0", "undef": "0", "null": "NULL", "zeroinitializer": "0"}
    return words[x] if x in words else literal(float(x))


class CFile:
    """What functions of one file share: vectors, helpers and tables that they need."""

    def __init__(
        self, calls: Mapping[str, str], constants: dict[str, Sequence[str]], defined: Collection[str]
    ) -> None:
        self.calls, self.constants, self.defined = calls, constants, defined
        self.vectors: set[tuple[str, int]] = set()
        self.helpers: set[str] = set()
        self.tables: set[str] = set()

    def help(self, name: str) -> str:
        """Return a helper, which the file gets."""
        self.helpers.add(name)
        return name

    def vector(self, kind: str) -> str:
        """Return the type of a vector."""
        width, element = vector_of(kind) or (0, "")
        self.vectors.add((LETTER[element], width))
        return f"{LETTER[element]}{width}"


def held(text: str) -> str:
    """Return an operand that signs do not touch."""
    return f"({text})" if text.startswith("-") else text


def bare(text: str) -> str:
    """Return an expression without parentheses around all of it."""
    if not (text.startswith("(") and text.endswith(")")):
        return text
    depth = 0
    for k, x in enumerate(text):
        depth += (x == "(") - (x == ")")
        if depth == 0 and k < len(text) - 1:
            return text
    return text[1:-1]


def used_functions(library: str, users: Sequence[str]) -> str:
    """Return the static functions of a text of C that others call, and those that these call."""
    chunks = re.findall(r"(?:/\*(?:(?!\*/)[\s\S])*\*/\n)?static [\s\S]*?\n}\n", library)
    names = [re.search(r"(\w+)\(", re.sub(r"/\*[\s\S]*?\*/", "", chunk)) for chunk in chunks]
    found = {m[1]: chunk for m, chunk in zip(names, chunks) if m}
    needed: set[str] = set()
    pending = list(users)
    while pending:
        called = set(re.findall(r"\b(\w+)\(", pending.pop())) & found.keys() - needed
        needed |= called
        pending += [found[name] for name in called]
    return "\n".join(found[name] for name in found if name in needed)


def text_beside(module: str, name: str) -> str:
    """Return a file of C that lies beside a module."""
    return (Path(module).parent / name).read_text(encoding="utf-8")
