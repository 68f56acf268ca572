"""A function of IR as declarations and statements: memory, numbers, jumps."""

from __future__ import annotations

import re
from collections.abc import Sequence

from robodyn_cli.kernels.as_c.ir_text import IrFunction, IrInstruction, vector_of
from robodyn_cli.kernels.as_c.words import LETTER, TYPES, CFile, bare, c_name, head, held, number

NESTED = 48  # characters of an expression that may stand inside another one


class FunctionBody:
    """One function. values : of registers, as C; those of ``lanes`` are vectors, others numbers in all lanes."""

    def __init__(self, file: CFile, function: IrFunction) -> None:
        self.file, self.function = file, function
        self.slots = function.slots
        self.uses = function.uses
        self.values: dict[str, str] = {}
        self.lanes: set[str] = set()
        self.variables: dict[str, list[str]] = {}
        self.rooms: list[str] = []
        self.lines: list[str] = []
        self.free: dict[str, list[str]] = {}
        self.last = function.last_uses  # instruction at which a register of one block is used last
        self.loops = False
        self.fixed: list[str] = []
        for place, i in enumerate(function.code):
            self._write(place, i)

    @property
    def text(self) -> str:
        """The definition."""
        declared = list(self.rooms)
        if self.loops:
            always = any("LANES(" in line or "for (k" in line for line in self.lines)
            declared.append("    int k;" if always else "#ifndef VECTORS\n    int k;\n#endif")
        for kind, names in self.variables.items():
            joined = (", *" if kind.endswith("*") else ", ").join(names)
            declared.append(f"    {kind.strip()}{'' if kind.endswith('*') else ' '}{joined};")
        unused = [f"    (void){c_name(x)};" for _, x in self.function.arguments if not self.uses.get(x)]
        return "\n".join([head(self.function), "{", *declared, "", *unused, *self.fixed, *self.lines, "}\n"])

    # -- operands -------------------------------------------------------------------------------------
    def value(self, x: str, kind: str = "") -> str:
        """Return an operand; of vectors that hold one number everywhere the number."""
        if x[0] == "@":
            self.file.tables.add(x)
            return f"(char *){c_name(x)}"
        if x[0] == "%":
            return self.values.get(x, c_name(x))
        if x[0] == "<":
            entries = [e.split()[-1] for e in x.strip("<>").split(",")]
            if len(set(entries)) > 1:
                return self._constant(x, entries)
            return held(number(entries[0]))
        return held(number("0.0" if x == "zeroinitializer" and "double" in kind else x))

    def _constant(self, x: str, entries: Sequence[str]) -> str:
        """Return the variable of a vector of several numbers, which is loaded where the function begins."""
        if x not in self.values:
            table = f"@lanes.{self.function.name}.{len(self.fixed)}"
            self.file.constants[table] = entries
            self.file.tables.add(table)
            kind, name = self.file.vector(f"<{len(entries)} x double>"), c_name(f"fixed_{len(self.fixed)}")
            self.variables.setdefault(f"{kind} ", []).append(name)
            self.fixed.append(f"    memcpy(&{name}, {c_name(table)}, sizeof {name});")
            self.values[x] = name
            self.lanes.add(x)
        return self.values[x]

    def _lane(self, x: str, kind: str, k: str = "k") -> str:
        own = self.value(x, kind)
        return f"{own}[{k}]" if x in self.lanes else own

    def _named(self, target: str, kind: str) -> str:
        """Return a variable for a register: vectors take those that others need no more."""
        width = vector_of(kind)
        if not width:
            own = self.values[target] = c_name(target)
            self.variables.setdefault(TYPES[kind], []).append(own)
            return own
        kind = self.file.vector(kind)
        pool = self.free.setdefault(kind, [])
        if pool:
            own = pool.pop()
        else:
            count = len(self.variables.setdefault(kind, []))
            own = f"{kind}_{count}"
            self.variables[kind].append(own)
        self.values[target] = own
        self.lanes.add(target)
        return own

    def _release(self, place: int, i: IrInstruction) -> None:
        for x in dict.fromkeys([*i.registers, *([i.target] if i.target else [])]):
            if self.last.get(x) == place and x in self.lanes and x not in self.slots:
                kind = self.values[x].split("_")[0]
                if self.values[x] not in self.free[kind]:
                    self.free[kind].append(self.values[x])

    def operation(self, i: IrInstruction) -> None:
        """Write what is no memory and no jump."""
        raise NotImplementedError

    # -- statements -----------------------------------------------------------------------------------
    def _write(self, place: int, i: IrInstruction) -> None:
        if i.op == "label":
            if i.target != "entry" and self.uses.get(f"%{i.target}"):
                self.lines.append(f"{c_name(i.target)}:;")
            return
        if i.target and i.pure and not self.uses.get(i.target):
            return
        getattr(self, f"_{i.op}", self.operation)(i)
        self._release(place, i)

    def _say(self, text: str) -> None:
        self.lines.append(f"    {text}")

    def _assign(self, i: IrInstruction, kind: str, expression: str, inline: bool = False) -> None:
        """Give a number to a register, or let it stand where it is used."""
        if inline and len(expression) <= NESTED and self.uses[i.target] == 1 and i.target in self.last:
            self.values[i.target] = f"({expression})"
            return
        self._say(f"{self._named(i.target, kind)} = {expression};")

    def _through(self, width: int, lane: str) -> None:
        self.loops = True
        self._say(f"LANES({width}, {lane});")

    def _alloca(self, i: IrInstruction) -> None:
        kind, count = i.kind, i.count
        name = c_name(i.target)
        width = vector_of(kind)
        if i.target in self.slots:
            own = self.file.vector(kind) if width else TYPES[kind]
            star = "" if own.endswith("*") else " "
            if width:
                self.lanes.add(i.target)
                self.rooms.append(f"    {own} {name};")
            else:
                self.rooms.append(f"    {own}{star}{name} = 0;")
            self.values[i.target] = name
            return
        own, size = ("double", (width[0] if width else 1) * count)
        if kind in ("i64", "ptr"):
            own = TYPES[kind]
        self.rooms.append(
            f"    {own}{'' if own.endswith('*') else ' '}{name}_room[{size}];\n    char *{name} = (char *){name}_room;"
        )

    def _load(self, i: IrInstruction) -> None:
        address, width = i.args[0], vector_of(i.kind)
        if address in self.slots:
            source = self.values[address]
            if width:
                self._say(f"memcpy(&{self._named(i.target, i.kind)}, &{source}, sizeof {source});")
            else:
                self._assign(i, i.kind, source)
            return
        if width:
            own = self._named(i.target, i.kind)
            self._say(f"memcpy(&{own}, {self.value(address)}, sizeof {own});")
            return
        load = self.file.help(f"load_{LETTER[i.kind]}")
        self._assign(i, i.kind, f"{load}({self.value(address)})")

    def _store(self, i: IrInstruction) -> None:
        x, address = i.args
        width = vector_of(i.kind)
        if width:
            self.value(x, i.kind)  # a constant of several numbers gets its variable
        if address in self.slots:
            target = self.values[address]
            if width and x in self.lanes:
                self._say(f"memcpy(&{target}, &{self.value(x)}, sizeof {target});")
            elif width:
                self._through(width[0], f"{target}[k] = {self.value(x, i.kind)}")
            else:
                self._say(f"{target} = {self.value(x, i.kind)};")
            return
        place = self.value(address)
        if width and x in self.lanes:
            own = self.value(x)
            self._say(f"memcpy({place}, &{own}, sizeof {own});")
        elif width:
            store = self.file.help("store_d")
            self._through(width[0], f"{store}({place} + 8 * k, {self.value(x, i.kind)})")
        else:
            store = self.file.help(f"store_{LETTER[i.kind]}")
            self._say(f"{store}({place}, {self.value(x, i.kind)});")

    def _getelementptr(self, i: IrInstruction) -> None:
        base, index = (self.value(x) for x in i.args)
        size = {"double": 8, "i64": 8, "i8": 1}[i.kind]
        offset = str(size * int(index)) if re.fullmatch(r"\d+", index) else f"{size} * {index}"
        self._assign(i, "ptr", base if offset == "0" else f"{base} + {offset}", inline=True)

    def _br(self, i: IrInstruction) -> None:
        if len(i.args) == 1:
            self._say(f"goto {c_name(i.args[0])};")
            return
        condition, yes, no = i.args
        self._say(f"if ({bare(self.value(condition))})")
        self._say(f"    goto {c_name(yes)};")
        self._say(f"goto {c_name(no)};")

    def _ret(self, i: IrInstruction) -> None:
        self._say(f"return {bare(self.value(i.args[0], i.kind))};" if i.args else "return;")
