"""Expressions of C as LLVM IR, written while they are read."""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping, Sequence

from robodyn_cli.kernels.from_c.values import (
    CType,
    CValue,
    alignment,
    bytes_of,
    common,
    constant,
    ir_type,
    is_real,
    listed,
    size_of,
)
from robodyn_cli.kernels.from_c.words import WordReader
from robodyn_cli.record import record

LEVELS = (("||",), ("&&",), ("==", "!="), ("<", ">", "<=", ">="), ("+", "-"), ("*", "/"))
FOLDED: Mapping[str, Callable[[int, int], int]] = {
    "+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.floordiv,
}  # fmt: skip
ARITHMETIC = {"+": ("add", "fadd"), "-": ("sub", "fsub"), "*": ("mul", "fmul"), "/": ("sdiv", "fdiv")}
COMPARED = {
    "==": ("eq", "oeq"), "!=": ("ne", "une"), "<": ("slt", "olt"), ">": ("sgt", "ogt"), "<=": ("sle", "ole"),
    ">=": ("sge", "oge"),
}  # fmt: skip
# what processors have instructions for, or LLVM has code for
INTRINSIC = ("fabs", "sqrt", "rint")
LIBM = frozenset(
    [
        *INTRINSIC,
        "sin",
        "cos",
        "tan",
        "asin",
        "acos",
        "atan",
        "atan2",
        "sinh",
        "cosh",
        "tanh",
        "exp",
        "log",
        "pow",
    ]
)
NUMBERS = {"HUGE_VAL": float("inf"), "NAN": float("nan")}
REAL_FLAGS = " contract"  # a * b + c may be one operation, as compilers of C take it


@record
class CFunctionType:
    """What a function gives and takes."""

    result: CType
    takes: tuple[CType, ...]


class Module:
    """The parts of a module of IR, and the names that all its functions know."""

    def __init__(self) -> None:
        self.types: dict[str, CType] = {
            "int": "i32",
            "double": "double",
            "float": "float",
            "char": "i8",
            "void": "void",
        }
        self.structs: dict[str, dict[str, CType]] = {}
        self.numbers: dict[str, int] = {}  # of enumerations
        self.functions: dict[str, CFunctionType] = {}
        self.constants: list[str] = []
        self.declared: dict[str, str] = {}
        self.defined: list[str] = []

    def keep(self, initial: str, align: int) -> str:
        """Return the address of a constant."""
        name = f"@constant.{len(self.constants)}"
        self.constants.append(f"{name} = private unnamed_addr constant {initial}, align {align}")
        return name

    def call_outside(self, name: str, result: CType, takes: Sequence[CType]) -> str:
        """Return how a function of another library is called."""
        self.declared[name] = f"declare {ir_type(result)} @{name}({', '.join(map(ir_type, takes))}) nounwind"
        return f"{ir_type(result)} @{name}"


class ExpressionReader:
    """Reads expressions, and writes what computes them into ``lines``; slots : memory of the function."""

    def __init__(self, module: Module, reader: WordReader) -> None:
        self.module, self.reader = module, reader
        self.lines: list[str] = []
        self.slots: list[str] = []
        self.scopes: list[dict[str, CValue]] = [{}]
        self._count = 0

    # -- what is written ------------------------------------------------------------------------------------
    def name(self, kind: str = "t") -> str:
        self._count += 1
        return f"{kind}{self._count}"

    def emit(self, text: str) -> str:
        """Write an instruction that has a value; return its name."""
        name = f"%{self.name()}"
        self.lines.append(f"  {name} = {text}")
        return name

    def slot(self, kind: CType) -> CValue:
        """Return a place in the memory of the function."""
        name = f"%{self.name('slot')}"
        self.slots.append(f"  {name} = alloca {ir_type(kind)}, align {alignment(kind, self.module.structs)}")
        return CValue(kind, name, place=True)

    def block(self, label: str) -> None:
        """Begin a block, to which what is before goes on."""
        if not self.lines or not self.lines[-1].startswith(("  br ", "  ret ")):
            self.lines.append(f"  br label %{label}")
        self.lines.append(f"{label}:")

    def branch(self, condition: CValue, yes: str, no: str) -> None:
        self.lines.append(f"  br i1 {self.truth(condition)}, label %{yes}, label %{no}")

    def value(self, x: CValue) -> CValue:
        """Return what is at a place; of an array the address of its first entry."""
        if not x.place:
            return x
        if x.type[0] == "array":
            return CValue(("ptr", x.type[1]), x.text)
        align = alignment(x.type, self.module.structs)
        return CValue(x.type, self.emit(f"load {ir_type(x.type)}, ptr {x.text}, align {align}"))

    def convert(self, x: CValue, kind: CType) -> CValue:
        x = self.value(x)
        if x.type == kind or not isinstance(kind, str) or not isinstance(x.type, str):
            return x
        if x.known is not None:
            return constant(kind, x.known)
        a, b = x.type, kind
        if is_real(a) and is_real(b):
            op = "fpext" if b == "double" else "fptrunc"
        elif is_real(b):
            op = "sitofp"
        elif is_real(a):
            op = "fptosi"
        else:
            op = "sext"
        return CValue(kind, self.emit(f"{op} {a} {x.text} to {b}"))

    def store(self, place: CValue, x: CValue) -> CValue:
        """Write a value to a place; return it."""
        kind, size = place.type, alignment(place.type, self.module.structs)
        if kind[0] == "struct":
            count = size_of(kind, self.module.structs)
            called = self.module.call_outside(
                "llvm.memcpy.p0.p0.i32", "void", (("ptr",), ("ptr",), "i32", "i1")
            )
            self.lines.append(
                f"  call {called}(ptr align {size} {place.text}, ptr align {size} {x.text}, i32 {count}, i1 false)"
            )
            return place
        x = self.convert(x, kind)
        self.lines.append(f"  store {ir_type(kind)} {x.text}, ptr {place.text}, align {size}")
        return x

    def truth(self, x: CValue) -> str:
        """Return whether a number is not zero, as one bit."""
        x = self.value(x)
        if is_real(x.type):
            return self.emit(f"fcmp une {x.type} {x.text}, 0.0")
        return self.emit(f"icmp ne {ir_type(x.type)} {x.text}, 0")

    def number(self, bit: str) -> CValue:
        return CValue("i32", self.emit(f"zext i1 {bit} to i32"))

    # -- what is read ---------------------------------------------------------------------------------------
    def expression(self) -> CValue:
        """Read an expression, assignments included."""
        left = self._chosen()
        word = self.reader.next
        if word == "=":
            self.reader.take()
            return self.store(left, self.expression())
        if word in ("+=", "-=", "*=", "/="):
            self.reader.take()
            return self.store(left, self._operation(word[0], self.value(left), self.expression()))
        return left

    def _chosen(self) -> CValue:
        """Read ``condition ? a : b``, of which one side is computed."""
        condition = self._binary(0)
        if not self.reader.has("?"):
            return condition
        yes, no, end = (self.name("l") for _ in range(3))
        self.branch(condition, yes, no)
        self.block(yes)
        a = self.value(self.expression())
        at = len(self.lines)
        self.lines.append(f"  br label %{end}")
        self.reader.expect(":")
        self.block(no)
        b = self.value(self._chosen())
        kind = common(a.type, b.type)
        slot = self.slot(kind)
        self.store(slot, b)
        rest = self.lines[at:]
        del self.lines[at:]
        self.store(slot, a)  # its type is known only now
        self.lines += rest
        self.block(end)
        return self.value(slot)

    def _binary(self, level: int) -> CValue:
        if level == len(LEVELS):
            return self._unary()
        left = self._binary(level + 1)
        while self.reader.next in LEVELS[level]:
            sign = self.reader.take()
            if sign in ("&&", "||"):
                left = self._either(left, sign == "||", level)
            else:
                left = self._operation(sign, self.value(left), self._binary(level + 1))
        return left

    def _either(self, left: CValue, decides: bool, level: int) -> CValue:
        """Read the right side of && or ||, which is computed unless the left side decides."""
        slot, more, end = self.slot("i32"), self.name("l"), self.name("l")
        self.store(slot, constant("i32", decides))
        self.branch(left, *((end, more) if decides else (more, end)))
        self.block(more)
        self.store(slot, self.number(self.truth(self._binary(level + 1))))
        self.block(end)
        return self.value(slot)

    def _operation(self, sign: str, a: CValue, b: CValue) -> CValue:
        if a.type[0] == "ptr":
            if sign != "+":
                raise NotImplementedError(f"C that is not written here: an address {sign}")
            return self._entry(a, self.value(b))
        kind = common(a.type, self.value(b).type if b.place else b.type)
        a, b = self.convert(a, kind), self.convert(b, kind)
        if sign in COMPARED:
            op = f"fcmp {COMPARED[sign][1]}" if is_real(kind) else f"icmp {COMPARED[sign][0]}"
            return self.number(self.emit(f"{op} {kind} {a.text}, {b.text}"))
        if isinstance(a.known, int) and isinstance(b.known, int):
            return constant(kind, FOLDED[sign](a.known, b.known))
        op = ARITHMETIC[sign][1] + REAL_FLAGS if is_real(kind) else ARITHMETIC[sign][0]
        return CValue(kind, self.emit(f"{op} {kind} {a.text}, {b.text}"))

    def _unary(self) -> CValue:
        reader = self.reader
        word = reader.next
        if word in ("++", "--"):
            reader.take()
            place = self._unary()
            return self.store(place, self._operation(word[0], self.value(place), constant("i32", 1)))
        if reader.has("-"):
            x = self.value(self._unary())
            if x.known is not None:
                return constant(x.type, -x.known)
            return CValue(
                x.type,
                self.emit(
                    f"{'fneg' if is_real(x.type) else 'sub'} {x.type} {'' if is_real(x.type) else '0, '}{x.text}"
                ),
            )
        if reader.has("!"):
            return self.number(self.emit(f"xor i1 {self.truth(self._unary())}, true"))
        if reader.has("*"):
            x = self.value(self._unary())
            return CValue(x.type[1], x.text, place=True)
        if reader.has("&"):
            x = self._unary()
            return CValue(("ptr", x.type), x.text)
        if reader.has("sizeof"):
            return constant("i32", size_of(self._unary().type, self.module.structs))
        if word == "(" and reader.beyond(1) in self.module.types:
            reader.take()
            kind = self.module.types[reader.take()]
            reader.expect(")")
            x = self._unary()
            return x if kind == "void" else self.convert(x, kind)
        return self._behind(self._first())

    def _first(self) -> CValue:
        """Read a number, a name or brackets."""
        word = self.reader.take()
        if word == "(":
            inside = self.expression()
            self.reader.expect(")")
            return inside
        if word[0].isdigit():
            if word.isdigit():
                return constant("i32", int(word))
            return constant("float" if word[-1] in "fF" else "double", float(word.rstrip("fF")))
        if word[0] == '"':
            return self._text(word)
        for scope in reversed(self.scopes):
            if word in scope:
                return scope[word]
        if word in self.module.numbers:
            return constant("i32", self.module.numbers[word])
        if word in NUMBERS:
            return constant("double", NUMBERS[word])
        self.reader.expect("(")
        return self._call(word)

    def _text(self, word: str) -> CValue:
        values = [constant("i8", x) for x in bytes_of(word)]
        address = self.module.keep(f"[{len(values)} x i8] {listed('i8', values)}", 1)
        return CValue(("ptr", "i8"), address)

    def _behind(self, x: CValue) -> CValue:
        """Read entries and members."""
        while True:
            if self.reader.has("["):
                x = self._entry(self.value(x), self.value(self.expression()))
                x = CValue(x.type[1], x.text, place=True)
                self.reader.expect("]")
            elif self.reader.has("."):
                x = self._member(x)
            elif self.reader.has("->"):
                pointer = self.value(x)
                x = self._member(CValue(pointer.type[1], pointer.text, place=True))
            else:
                return x

    def _entry(self, pointer: CValue, k: CValue) -> CValue:
        kind = ir_type(pointer.type[1])
        return CValue(
            pointer.type, self.emit(f"getelementptr inbounds {kind}, ptr {pointer.text}, i32 {k.text}")
        )

    def _member(self, x: CValue) -> CValue:
        name, members = self.reader.take(), self.module.structs[x.type[1]]
        place = list(members).index(name)
        address = self.emit(f"getelementptr inbounds {ir_type(x.type)}, ptr {x.text}, i32 0, i32 {place}")
        return CValue(members[name], address, place=True)

    def _call(self, name: str) -> CValue:
        """Read the arguments of a call, and write it."""
        given: list[CValue] = []
        while not self.reader.has(")"):
            given.append(self.value(self.expression()))
            self.reader.has(",")
        if name == "memset":
            called = self.module.call_outside("llvm.memset.p0.i32", "void", (("ptr",), "i8", "i32", "i1"))
            self.lines.append(
                f"  call {called}(ptr {given[0].text}, i8 {given[1].text}, i32 {given[2].text}, i1 false)"
            )
            return given[0]
        own = self.module.functions.get(name)
        if own is not None:
            called, takes, result = f"{ir_type(own.result)} @{name}", own.takes, own.result
        elif name == "strcmp":
            takes, result = (("ptr", "i8"), ("ptr", "i8")), "i32"
            called = self.module.call_outside(name, result, takes)
        else:
            called, result = self._of_library(name, given)
            takes = (result,) * len(given)
        given = [self.convert(x, kind) for x, kind in zip(given, takes)]
        call = f"call {called}({', '.join(f'{ir_type(x.type)} {x.text}' for x in given)})"
        if result == "void":
            self.lines.append(f"  {call}")
            return CValue("void", "")
        x = CValue(result, self.emit(call))
        if name == "isfinite":  # of the size
            return self.number(
                self.emit(f"fcmp olt {result} {x.text}, {constant(result, float('inf')).text}")
            )
        return x

    def _of_library(self, name: str, given: Sequence[CValue]) -> tuple[str, CType]:
        """Return how a function of ``math.h`` is called, and the type of its values; of ``isfinite`` the size."""
        base = name.removesuffix("f")
        if name == "isfinite":
            base, kind = "fabs", given[0].type
        elif base in LIBM and name not in LIBM:
            kind = "float"
        elif name in LIBM:
            base, kind = name, "double"
        else:
            raise NotImplementedError(f"C that is not written here: {name}()")
        if base in INTRINSIC:
            name = f"llvm.{base}.{'f64' if kind == 'double' else 'f32'}"
        return self.module.call_outside(name, kind, [kind] * len(given)), kind
