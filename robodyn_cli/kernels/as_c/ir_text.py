"""The text of IR as functions of instructions, for writers of other languages."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property

from robodyn_cli.record import record

KIND = r"(?:<\d+ x \w+>|double|i64|i32|i8|i1|ptr|void)"
FLAGS = re.compile(
    r"\b(?:reassoc|nsz|arcp|contract|nnan|ninf|afn|fast|nuw|nsw|exact|disjoint|noalias|private) ?"
)
BINARY = frozenset({"fadd", "fsub", "fmul", "fdiv", "add", "sub", "mul", "and", "or", "xor", "shl", "lshr"})
WITH_EFFECT = frozenset({"store", "br", "ret", "label"})
# what may stand where it is used: rounding does not depend on what stands beside it
STANDING = frozenset(
    {"icmp", "fcmp", "and", "or", "xor", "add", "sub", "mul", "shl", "lshr", "sitofp", "zext"}
)


@record
class IrInstruction:
    """One instruction.

    kinds : types of ``args``; kind : the first of them, or that of what is in memory. result : type of the value.
    free : whether it may be part of a larger expression. picks : lanes of a shuffle. count : entries of room.
    spread : whether an insertion is the number of all lanes.
    """

    op: str
    target: str = ""
    kind: str = ""
    args: tuple[str, ...] = ()
    kinds: tuple[str, ...] = ()
    result: str = ""
    callee: str = ""
    predicate: str = ""
    picks: tuple[int, ...] = ()
    count: int = 1
    free: bool = False
    spread: bool = False

    @property
    def pure(self) -> bool:
        own = self.op == "call" and bool(self.target) and self.callee.startswith("@llvm.")
        return own or (self.op not in WITH_EFFECT and self.op != "call")

    @property
    def registers(self) -> list[str]:
        return [x for x in self.args if x.startswith("%")]


@record
class IrFunction:
    """A function: type of its result, types and names of its arguments, instructions."""

    name: str
    result: str
    arguments: tuple[tuple[str, str], ...]
    code: tuple[IrInstruction, ...]

    @cached_property
    def uses(self) -> Counter[str]:
        """How often each register and label is used, by what is needed itself."""
        counts = Counter(x for i in self.code for x in i.registers)
        pending = [i for i in self.code if i.pure and not counts[i.target]]
        made = {i.target: i for i in self.code if i.pure}
        while pending:
            for x in pending.pop().registers:
                counts[x] -= 1
                if not counts[x] and x in made:
                    pending.append(made[x])
        return counts

    @cached_property
    def slots(self) -> set[str]:
        """Rooms of one value that only loads and stores use: they are variables."""
        rooms = {i.target for i in self.code if i.op == "alloca" and i.count == 1}
        for i in self.code:
            if i.op == "load":
                continue
            others = i.args[:1] if i.op == "store" else i.registers
            rooms -= set(others)
        return rooms

    @cached_property
    def last_uses(self) -> dict[str, int]:
        """The instruction at which a register is used last, of those that one block makes and uses."""
        block = 0
        made: dict[str, int] = {}
        last: dict[str, int] = {}
        elsewhere: set[str] = set()
        for place, i in enumerate(self.code):
            block += i.op == "label"
            for x in i.registers:
                last[x] = place
                if made.get(x) != block:
                    elsewhere.add(x)
            if i.target:
                made[i.target] = block
        return {x: place for x, place in last.items() if x not in elsewhere}


def vector_of(kind: str) -> tuple[int, str] | None:
    """Return width and element of a vector's type."""
    found = re.fullmatch(r"<(\d+) x (\w+)>", kind)
    return (int(found[1]), found[2]) if found else None


def functions_of(texts: Sequence[str]) -> tuple[dict[str, IrFunction], dict[str, Sequence[str]]]:
    """Return the functions of modules by name, and their tables of doubles."""
    functions: dict[str, IrFunction] = {}
    constants: dict[str, Sequence[str]] = {}
    for text in texts:
        head = ""
        lines: list[str] = []
        for line in text.split("\n"):
            if line.startswith("define"):
                head, lines = line, []
            elif line.startswith("@"):
                found = re.match(r"(@[\w.]+) = .*constant \[\d+ x double\] \[(.*)\]", line)
                assert found, line
                constants[found[1]] = [x.split()[-1] for x in found[2].split(", ")]
            elif line == "}":
                own = _function(head, lines)
                functions[own.name] = own
            elif line.strip():
                lines.append(line.strip())
    return functions, constants


def _function(head: str, lines: Sequence[str]) -> IrFunction:
    found = re.match(rf"define (?:internal )?({KIND}) @([\w.]+)\((.*)\)[^)]*{{", FLAGS.sub("", head))
    assert found, head
    arguments = tuple((x.split()[0], x.split()[-1]) for x in found[3].split(", ") if x)
    return IrFunction(found[2], found[1], arguments, tuple(_with_spreads([*map(_instruction, lines)])))


def _with_spreads(code: Sequence[IrInstruction]) -> Iterator[IrInstruction]:
    """Yield instructions with numbers that go into all lanes told apart from vectors that are filled one by one."""
    users: dict[str, list[IrInstruction]] = {}
    for i in code:
        for x in i.registers:
            users.setdefault(x, []).append(i)
    for i in code:
        spread = (
            i.op == "insertelement"
            and i.args[0] in ("poison", "undef")
            and i.args[2] == "0"
            and all(u.op == "shufflevector" and set(u.picks) == {0} for u in users.get(i.target, ()))
        )
        if not spread:
            yield i
            continue
        yield IrInstruction("insertelement", i.target, i.kind, i.args, i.kinds, i.kind, spread=True)


def _instruction(line: str) -> IrInstruction:
    if line.endswith(":"):
        return IrInstruction("label", line[:-1])
    contracts = "contract" in line
    line = re.sub(" +", " ", FLAGS.sub("", line))
    target, _, text = line.partition(" = ") if re.match(r"%[\w.]+ = ", line) else ("", "", line)
    op = text.split()[0]
    if op in BINARY:
        kind, a, b = _matched(rf"\w+ ({KIND}) (.*)", text, pair=True)
        free = contracts or op in STANDING
        return IrInstruction(op, target, kind, (a, b), (kind, kind), kind, free=free)
    if op in ("fcmp", "icmp"):
        found = re.fullmatch(rf"\w+ (\w+) ({KIND}) (.*)", text)
        assert found, text
        a, b = _operands(found[3])
        width = vector_of(found[2])
        result = f"<{width[0]} x i1>" if width else "i1"
        return IrInstruction(
            op, target, found[2], (a, b), (found[2],) * 2, result, predicate=found[1], free=True
        )
    parse = PARSERS.get(op)
    if parse is None:
        raise ValueError(line)
    return parse(target, text)


def _matched(pattern: str, text: str, pair: bool = False) -> tuple[str, ...]:
    found = re.fullmatch(pattern, text)
    if found is None:
        raise ValueError(text)
    groups = found.groups()
    return (*groups[:-1], *_operands(groups[-1])) if pair else groups


def _operands(text: str) -> list[str]:
    """Split at commas outside of brackets."""
    return [x.strip() for x in re.split(r",\s*(?![^<\[]*[>\]])", text)]


def _alloca(target: str, text: str) -> IrInstruction:
    (kind,) = _matched(r"alloca (.*?)(?:, align \d+)?", text)
    many = re.fullmatch(r"\[(\d+) x (.*)\]", kind)
    count, kind = (int(many[1]), many[2]) if many else (1, kind)
    # an array of one stays an array
    return IrInstruction("alloca", target, kind, count=count if count > 1 or not many else 1, result="ptr")


def _load(target: str, text: str) -> IrInstruction:
    kind, place = _matched(rf"load ({KIND}), ptr (\S+?)(?:, align \d+)?", text)
    return IrInstruction("load", target, kind, (place,), ("ptr",), kind)


def _store(target: str, text: str) -> IrInstruction:
    kind, x, place = _matched(rf"store ({KIND}) (.*), ptr (\S+?)(?:, align \d+)?", text)
    return IrInstruction("store", "", kind, (x, place), (kind, "ptr"))


def _getelementptr(target: str, text: str) -> IrInstruction:
    kind, base, index = _matched(r"getelementptr (?:inbounds )?(\w+), ptr (\S+), i64 (\S+)", text)
    return IrInstruction("getelementptr", target, kind, (base, index), ("ptr", "i64"), "ptr", free=True)


def _br(target: str, text: str) -> IrInstruction:
    if text.startswith("br label"):
        return IrInstruction("br", args=(text.split()[-1],))
    condition, yes, no = _matched(r"br i1 (\S+), label (\S+), label (\S+)", text)
    return IrInstruction("br", args=(condition, yes, no))


def _ret(target: str, text: str) -> IrInstruction:
    kind, _, x = text[4:].partition(" ")
    return IrInstruction("ret", kind=kind, args=(x,) if x else (), kinds=(kind,) if x else ())


def _select(target: str, text: str) -> IrInstruction:
    which, c, kind, a, _, b = _matched(rf"select ({KIND}) (%\S+), ({KIND}) (<.*?>|\S+), ({KIND}) (.*)", text)
    return IrInstruction("select", target, kind, (c, a, b), (which, kind, kind), kind)


def _fneg(target: str, text: str) -> IrInstruction:
    kind, a = _matched(rf"fneg ({KIND}) (.*)", text)
    return IrInstruction("fneg", target, kind, (a,), (kind,), kind, free=True)


def _insertelement(target: str, text: str) -> IrInstruction:
    kind, a, element, x, k = _matched(rf"insertelement ({KIND}) (\S+), (\w+) (\S+), i32 (\d+)", text)
    return IrInstruction("insertelement", target, kind, (a, x, k), (kind, element, "i32"), kind)


def _extractelement(target: str, text: str) -> IrInstruction:
    kind, a, k = _matched(rf"extractelement ({KIND}) (\S+), i32 (\d+)", text)
    return IrInstruction(
        "extractelement", target, kind, (a, k), (kind, "i32"), (vector_of(kind) or (0, ""))[1]
    )


def _shufflevector(target: str, text: str) -> IrInstruction:
    kind, a, b, width, places = _matched(
        rf"shufflevector ({KIND}) (<.*?>|\S+), {KIND} (<.*?>|\S+), <(\d+) x i32> (.*)", text
    )
    found = [0 if x == "poison" else int(x) for x in re.findall(r"i32 (\w+)", places)]
    picks = tuple(found or [0] * int(width))
    result = f"<{width} x {(vector_of(kind) or (0, ''))[1]}>"
    return IrInstruction("shufflevector", target, kind, (a, b), (kind, kind), result, picks=picks)


def _change(target: str, text: str) -> IrInstruction:
    op, kind, a, result = _matched(rf"(\w+) ({KIND}) (.*) to ({KIND})", text)
    return IrInstruction(op, target, kind, (a,), (kind,), result, free=op in STANDING)


def _call(target: str, text: str) -> IrInstruction:
    result, callee, rest = _matched(rf"call ({KIND}) ([@%][\w.]+)\((.*)\)", text)
    pairs = [re.split(r"(?<=>) " if x[0] == "<" else " ", x, maxsplit=1) for x in _operands(rest) if x]
    kinds = tuple(x[0] for x in pairs)
    return IrInstruction(
        "call", target, kinds[0] if kinds else "", tuple(x[1] for x in pairs), kinds, result, callee
    )


PARSERS: Mapping[str, Callable[[str, str], IrInstruction]] = {
    "alloca": _alloca, "load": _load, "store": _store, "getelementptr": _getelementptr, "br": _br, "ret": _ret,
    "select": _select, "fneg": _fneg, "insertelement": _insertelement, "extractelement": _extractelement,
    "shufflevector": _shufflevector, "bitcast": _change, "sitofp": _change, "fptosi": _change, "zext": _change,
    "sext": _change, "trunc": _change, "call": _call,
}  # fmt: skip
