"""Operations of numbers and of lanes, and calls, as statements."""

from __future__ import annotations

from collections.abc import Sequence

from robodyn_cli.kernels.as_c.body import FunctionBody
from robodyn_cli.kernels.as_c.ir_text import IrInstruction, vector_of
from robodyn_cli.kernels.as_c.words import TYPES, bare, own_name

SIGNS = {"fadd": "+", "fsub": "-", "fmul": "*", "fdiv": "/", "add": "+", "sub": "-", "mul": "*",
         "and": "&", "or": "|", "xor": "^"}  # fmt: skip
# u..: true where an operand is no number
COMPARED = {
    "oeq": "{0} == {1}", "olt": "{0} < {1}", "ole": "{0} <= {1}", "ogt": "{0} > {1}", "oge": "{0} >= {1}",
    "une": "{0} != {1}", "ult": "!({0} >= {1})", "ule": "!({0} > {1})", "ugt": "!({0} <= {1})", "uge": "!({0} < {1})",
    "one": "{0} < {1} || {0} > {1}", "ord": "{0} == {0} && {1} == {1}", "uno": "{0} != {0} || {1} != {1}",
    "ueq": "!({0} < {1} || {0} > {1})",
    "eq": "{0} == {1}", "ne": "{0} != {1}", "slt": "{0} < {1}", "sle": "{0} <= {1}",
    "sgt": "{0} > {1}", "sge": "{0} >= {1}",
}  # fmt: skip
WHOLE = frozenset(
    {"oeq", "olt", "ole", "ogt", "oge", "une", "eq", "ne", "slt", "sle", "sgt", "sge"}
)  # as in C
RENAMED = {"fabs": "fabs", "abs": "fabs", "maxnum": "fmax", "minnum": "fmin"}
HELPED = frozenset({"maximum", "minimum"})


class FunctionText(FunctionBody):
    """One function, whole."""

    # -- lanes ----------------------------------------------------------------------------------------
    def _insertelement(self, i: IrInstruction) -> None:
        before, x, k = i.args
        if i.spread:  # all lanes are to hold it
            self.values[i.target] = self.value(x)
            return
        if before in self.lanes and self.uses[before] == 1 and before in self.last:
            own = self.values[i.target] = self.values[before]
            self.lanes.add(i.target)
            self.lanes.discard(before)  # its variable lives on
        else:
            own = self._named(i.target, i.kind)
            if before in self.lanes:
                self._say(f"memcpy(&{own}, &{self.values[before]}, sizeof {own});")
            else:
                self._clear(own, i.kind)
        self._say(f"{own}[{k}] = {self.value(x)};")

    def _clear(self, own: str, kind: str) -> None:
        """Set a vector that is filled lane by lane: compilers take it for one that is not set."""
        width = (vector_of(kind) or (0, ""))[0]
        self.loops = True
        self._say(f"EACH({width}, {own} = ({self.file.vector(kind)}){{0}}, {own}[k] = 0);")

    def _extractelement(self, i: IrInstruction) -> None:
        x, k = i.args
        element = (vector_of(i.kind) or (0, "double"))[1]
        self._assign(i, element, self._lane(x, i.kind, k))

    def _shufflevector(self, i: IrInstruction) -> None:
        a, b = i.args
        half = (vector_of(i.kind) or (1, ""))[0]
        if a not in self.lanes and (b not in self.lanes or max(i.picks) < half):
            self.values[i.target] = self.value(a, i.kind)
            return
        if len(set(i.picks)) == 1 and a in self.lanes and i.picks[0] < half:
            self._assign(i, (vector_of(i.result) or (0, "double"))[1], f"{self.value(a)}[{i.picks[0]}]")
            return
        own = self._named(i.target, i.result)
        self._clear(own, i.result)
        for k, pick in enumerate(i.picks):
            source = (
                self._lane(a, i.kind, str(pick)) if pick < half else self._lane(b, i.kind, str(pick - half))
            )
            self._say(f"{own}[{k}] = {source};")

    # -- operations -----------------------------------------------------------------------------------
    def operation(self, i: IrInstruction) -> None:
        """Write an operation of numbers, or lane by lane."""
        whole, lane, element = self._expressions(i)
        width = vector_of(i.result)
        values = [self.value(x, kind) for x, kind in zip(i.args, i.kinds)]
        if not width or not any(x in self.lanes for x in i.args):
            kind = width[1] if width else i.result
            self._assign(i, kind, lane.format(*values), inline=i.free)
            return
        lanes = [self._lane(x, kind) for x, kind in zip(i.args, i.kinds)]
        own = self._named(i.target, i.result)
        one = lane.format(*lanes)
        if element == "i1":  # all bits, as vectors have them
            one = f"-(int64_t)({one})"
        if whole:
            self.loops = True
            self._say(f"EACH({width[0]}, {own} = {whole.format(*values)}, {own}[k] = {one});")
        else:
            self._through(width[0], f"{own}[k] = {one}")

    def _expressions(self, i: IrInstruction) -> tuple[str, str, str]:
        """Return an operation on whole vectors (nothing: there is none), on numbers, and the kind of its result."""
        op = i.op
        element = (vector_of(i.result) or (0, i.result))[1]
        if op in SIGNS:
            text = f"{{0}} {SIGNS[op]} {{1}}"
            return text, text, element
        if op == "fneg":
            return "-{0}", "-{0}", element
        if op in ("fcmp", "icmp"):
            text = COMPARED[i.predicate]
            return text if i.predicate in WHOLE else "", text, "i1"
        if op == "select":
            return self._selected(i), "{0} ? {1} : {2}", element
        if op in ("shl", "lshr"):
            way = "<<" if op == "shl" else ">>"
            return "{0} << {1}" if op == "shl" else "", f"(int64_t)((uint64_t){{0}} {way} {{1}})", element
        if op == "bitcast":
            return "", f"{self.file.help('bits' if element == 'i64' else 'of_bits')}({{0}})", element
        if op in ("sitofp", "fptosi", "zext", "trunc"):
            return "", f"({TYPES[element].strip()}){{0}}", element
        raise ValueError(op)

    def _selected(self, i: IrInstruction) -> str:
        """Return a choice between whole vectors, by their bits; nothing where one of them is a number."""
        if not vector_of(i.result) or not all(x in self.lanes for x in i.args):
            return ""
        kind = self.file.vector(i.result)
        whole = f"l{kind[1:]}"
        self.file.vectors.add(("l", int(kind[1:])))
        return f"({kind})(({{0}} & ({whole}){{1}}) | (~{{0}} & ({whole}){{2}}))"

    def _bitcast(self, i: IrInstruction) -> None:
        x = i.args[0]
        if i.result == "i8":  # the lanes of a condition as bits
            width = (vector_of(i.kind) or (1, ""))[0]
            own = self._named(i.target, "i8")
            if x not in self.lanes:
                self._say(f"{own} = {self.value(x)} ? {2**width - 1} : 0;")
                return
            self._say(f"{own} = 0;")
            self._through(width, f"{own} |= (int)({self.value(x)}[k] & 1) << k")
        elif x in self.lanes:
            own = self._named(i.target, i.result)
            self._say(f"memcpy(&{own}, &{self.value(x)}, sizeof {own});")
        else:
            self.operation(i)

    # -- calls ----------------------------------------------------------------------------------------
    def _call(self, i: IrInstruction) -> None:
        name = i.callee
        if name.startswith("@llvm."):
            self._intrinsic(i, name[6:].split("."))
            return
        own = name[1:] if name[0] == "@" else self.file.calls[name[1:]]
        values = ", ".join(bare(self.value(x, kind)) for x, kind in zip(i.args, i.kinds))
        function = own_name(own) if own in self.file.defined else own
        called = f"{function}({values})" if own else "-1"
        if i.result == "void":
            self._say(f"{called};")
        elif not self.uses.get(i.target):
            self._say(f"(void){called};")
        else:
            self._assign(i, i.result, called)

    def _intrinsic(self, i: IrInstruction, words: Sequence[str]) -> None:
        function = words[0]
        if function == "memcpy":
            values = [bare(self.value(x)) for x in i.args]
            self._say(f"memcpy({values[0]}, {values[1]}, (size_t){self.value(i.args[2])});")
        elif function == "cttz":
            self._assign(i, "i64", f"{self.file.help('lowest')}({bare(self.value(i.args[0]))})")
        elif function == "vector":
            self._reduced(i, words[2])
        elif function != "prefetch" and self.uses.get(i.target):
            self._of_numbers(i, function)

    def _reduced(self, i: IrInstruction, what: str) -> None:
        x, kind = i.args[-1], i.kinds[-1]
        width = (vector_of(kind) or (1, ""))[0]
        own, first = self._named(i.target, "double"), self._lane(x, kind, "0")
        if what == "fadd" and x not in self.lanes:
            self._say(f"{own} = {width} * {first};")
            return
        self._say(f"{own} = {first};")
        more = self._lane(x, kind)
        step = f"{own} + {more}" if what == "fadd" else f"{self.file.help('maximum')}({own}, {more})"
        if x in self.lanes:
            self.loops = True
            self._say(f"for (k = 1; k < {width}; ++k)")
            self._say(f"    {own} = {step};")

    def _of_numbers(self, i: IrInstruction, function: str) -> None:
        """Write a function of numbers, lane by lane."""
        if function in ("fmuladd", "fma"):
            whole = lane = "{0} * {1} + {2}"
        else:
            known = self.file.help(function) if function in HELPED else RENAMED.get(function, function)
            whole, lane = (
                self._absolute(i) if known == "fabs" else "",
                f"{known}({', '.join(f'{{{k}}}' for k in range(len(i.args)))})",
            )
        width = vector_of(i.result)
        values = [self.value(x, kind) for x, kind in zip(i.args, i.kinds)]
        if not width or not any(x in self.lanes for x in i.args):
            self._assign(i, width[1] if width else i.result, lane.format(*values))
            return
        lanes = [self._lane(x, kind) for x, kind in zip(i.args, i.kinds)]
        own = self._named(i.target, i.result)
        if whole:
            self.loops = True
            self._say(f"EACH({width[0]}, {own} = {whole.format(*values)}, {own}[k] = {lane.format(*lanes)});")
        else:
            self._through(width[0], f"{own}[k] = {lane.format(*lanes)}")

    def _absolute(self, i: IrInstruction) -> str:
        """Return the sizes of a whole vector: its bits but for the signs."""
        if i.args[0] not in self.lanes:
            return ""
        kind = self.file.vector(i.result)
        self.file.vectors.add(("l", int(kind[1:])))
        return f"({kind})((l{kind[1:]}){{0}} & INT64_MAX)"
