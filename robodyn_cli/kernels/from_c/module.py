"""Declarations, statements and functions of C as LLVM IR.

What is read is the C that robodyn writes, not all of C: scalars, arrays, one kind of struct, enumerations, functions;
no ``switch``, no ``goto``, no strings but tables of names. Whatever else there is ends with an error.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

from robodyn_cli.kernels.from_c.expressions import CFunctionType, ExpressionReader, Module
from robodyn_cli.kernels.from_c.values import CType, CValue, alignment, ir_type, listed
from robodyn_cli.kernels.from_c.words import WordReader, words_of

QUALIFIERS = ("const", "restrict", "static")


def ir_of_c(texts: Sequence[str], defined: Collection[str] = ()) -> str:
    """Return the IR of C files that follow one another, headers first; each function is a section of its own.

    defined : macros, as ``-D`` gives them.
    """
    module, reader = Module(), WordReader(words_of(texts, defined))
    while reader.next:
        FunctionReader(module, reader).read()
    types = [
        f"%{name} = type {{ {', '.join(map(ir_type, members.values()))} }}"
        for name, members in module.structs.items()
    ]
    return "\n".join([*types, *module.constants, *module.declared.values(), *module.defined, ""])


class FunctionReader(ExpressionReader):
    """Reads one thing that stands outside of functions: a type, an enumeration, or a function."""

    def __init__(self, module: Module, reader: WordReader) -> None:
        super().__init__(module, reader)
        self.result: CType = "void"
        self.loops: list[tuple[str, str]] = []  # where each goes on, and ends

    def read(self) -> None:
        if self.reader.has("typedef"):
            return self._typedef()
        if self.reader.has("enum"):
            return self._enumeration()
        hidden = self.reader.next == "static"
        kind, name = self._declarator(self._type())
        self.reader.expect("(")
        takes = []
        while not self.reader.has(")"):
            takes.append(self._declarator(self._type()))
            self.reader.has(",")
        # an array is given by its address
        takes = [(("ptr", x[1]) if x[0] == "array" else x, own) for x, own in takes]
        self.module.functions[name] = CFunctionType(kind, tuple(x for x, _ in takes))
        if not self.reader.has(";"):
            self._define(name, kind, takes, hidden)
        return None

    # -- types ----------------------------------------------------------------------------------------------
    def _type(self) -> CType:
        """Read what a declaration begins with."""
        while self.reader.next in QUALIFIERS:
            self.reader.take()
        word = self.reader.take()
        if word not in self.module.types:
            raise NotImplementedError(f"C that is not written here: {word}")
        while self.reader.next in QUALIFIERS:
            self.reader.take()
        return self.module.types[word]

    def _declarator(self, kind: CType) -> tuple[CType, str]:
        """Read a name with what makes it an address or an array; return its type and the name."""
        while self.reader.next in ("*", *QUALIFIERS):
            kind = ("ptr", kind) if self.reader.take() == "*" else kind
        name, sizes = self.reader.take(), []
        while self.reader.has("["):
            self.reader.has("restrict")
            sizes.append(None if self.reader.next == "]" else self.expression().known)
            self.reader.expect("]")
        for size in reversed(sizes):
            kind = ("array", kind, size)
        return kind, name

    def _typedef(self) -> None:
        if not self.reader.has("struct"):
            kind, name = self._declarator(self._type())
            self.module.types[name] = kind
            return self.reader.expect(";")
        self.reader.expect("{")
        members = {}
        while not self.reader.has("}"):
            kind, name = self._declarator(self._type())
            members[name] = kind
            self.reader.expect(";")
        name = self.reader.take()
        self.module.structs[name], self.module.types[name] = members, ("struct", name)
        return self.reader.expect(";")

    def _enumeration(self) -> None:
        if self.reader.next != "{":
            self.module.types[self.reader.take()] = "i32"
        self.reader.expect("{")
        count = 0
        while not self.reader.has("}"):
            name = self.reader.take()
            if self.reader.has("="):
                count = int(self.expression().known or 0)
            self.module.numbers[name] = count
            count += 1
            self.reader.has(",")
        self.reader.expect(";")

    # -- functions ------------------------------------------------------------------------------------------
    def _define(self, name: str, kind: CType, takes: Sequence[tuple[CType, str]], hidden: bool) -> None:
        """Read the body of a function, and add it to the module."""
        self.result = kind
        for own, label in takes:
            place = self.slot(own)
            self.scopes[-1][label] = place
            self.lines.append(f"  store {ir_type(own)} %{label}, ptr {place.text}")
        self.reader.expect("{")
        self._block()
        self.lines.append("  ret void" if kind == "void" else f"  ret {ir_type(kind)} {_zero(kind)}")
        arguments = ", ".join(f"{ir_type(own)} %{label}" for own, label in takes)
        head = f'define {"internal " * hidden}{ir_type(kind)} @{name}({arguments}) nounwind section ".text.{name}"'
        self.module.defined.append("\n".join([f"{head} {{", *self.slots, *self.lines, "}"]))

    def _block(self) -> None:
        self.scopes.append({})
        while not self.reader.has("}"):
            self._statement()
        self.scopes.pop()

    def _statement(self) -> None:
        word = self.reader.next
        if self.reader.has("{"):
            self._block()
        elif self.reader.has("if"):
            self._if()
        elif self.reader.has("while"):
            self._loop(header=False)
        elif self.reader.has("for"):
            self._loop(header=True)
        elif word in ("break", "continue", "return"):
            self._leave(self.reader.take())
        elif word in QUALIFIERS or word in self.module.types:
            self._declaration()
        elif not self.reader.has(";"):
            self.expression()
            self.reader.expect(";")

    def _leave(self, word: str) -> None:
        if word == "return":
            x = self.convert(self.expression(), self.result) if self.reader.next != ";" else None
            self.lines.append("  ret void" if x is None else f"  ret {ir_type(x.type)} {x.text}")
        else:
            self.lines.append(f"  br label %{self.loops[-1][word == 'break']}")
        self.reader.expect(";")
        self.lines.append(f"{self.name('l')}:")  # nothing goes there

    def _if(self) -> None:
        yes, no, end = (self.name("l") for _ in range(3))
        self._condition(yes, no)
        self.block(yes)
        self._statement()
        self.lines.append(f"  br label %{end}")
        self.block(no)
        if self.reader.has("else"):
            self._statement()
        self.block(end)

    def _condition(self, yes: str, no: str) -> None:
        self.reader.expect("(")
        self.branch(self.expression(), yes, no)
        self.reader.expect(")")

    def _loop(self, header: bool) -> None:
        """Read ``for`` or ``while``: condition, step and body are blocks in this order."""
        again, step, body, end = (self.name("l") for _ in range(4))
        self.reader.expect("(")
        if header:
            self.expression()
            self.reader.expect(";")
        self.block(again)
        self.branch(self.expression(), body, end)
        self.reader.expect(";" if header else ")")
        self.block(step)
        if header:
            self.expression()
            self.reader.expect(")")
        self.lines.append(f"  br label %{again}")
        self.loops.append((step, end))
        self.block(body)
        self._statement()
        self.lines.append(f"  br label %{step}")
        self.loops.pop()
        self.block(end)

    def _declaration(self) -> None:
        fixed = self.reader.next == "static"
        first = self._type()
        while True:
            kind, name = self._declarator(first)
            if fixed:
                self.reader.expect("=", "{")
                self.scopes[-1][name] = self._table(kind)
            else:
                place = self.slot(kind)
                if self.reader.has("="):
                    self.store(place, self.expression())
                self.scopes[-1][name] = place
            if self.reader.has(";"):
                return
            self.reader.expect(",")

    def _table(self, kind: CType) -> CValue:
        """Read the entries of a table, which is a constant of the module."""
        of, values = kind[1], []
        while not self.reader.has("}"):
            x = self.expression()
            if x.known is None and x.type[0] != "ptr":
                raise NotImplementedError("C that is not written here: a table of what is no constant")
            values.append(self.convert(x, of))
            self.reader.has(",")
        count = len(values)
        address = self.module.keep(
            f"[{count} x {ir_type(of)}] {listed(of, values)}", alignment(of, self.module.structs)
        )
        return CValue(("array", of, count), address, place=True)


def _zero(kind: CType) -> str:
    return "0.0" if kind in ("float", "double") else "0"
