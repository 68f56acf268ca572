"""Turn Programs into IR inside a function that is being written: in place, as functions, or as data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from robodyn_cli.kernels.arrays import Array
from robodyn_cli.kernels.ir import Function, Value
from robodyn_cli.kernels.mathematics import operation, sincos
from robodyn_cli.kernels.program import TRIGONOMETRIC, Instruction, Program

if TYPE_CHECKING:
    from robodyn_cli.kernels.bytecode.code import Bytecode

INLINE_LIMIT = 400  # operations; longer programs become functions
LANES = 8
REGISTERS = "registers"  # argument of functions that evaluate programs: memory for those that are data

Inputs = Mapping[str, "Sequence[Value] | Array"]


def _table(f: Function, x: Value, knots: Sequence[float], values: Sequence[float], order: int) -> Value:
    """Piecewise linear look-up by bisection, lane by lane."""
    n = len(knots)
    name = f"{f.title}.{f.fresh('table')}"
    slopes = [(values[k + 1] - values[k]) / (knots[k + 1] - knots[k]) for k in range(n - 1)]

    at, start = f.table(f"{name}.t", knots), f.table(f"{name}.y", values)
    slope = f.table(f"{name}.s", [*slopes, 0.0])
    results = []
    for k in range(x.width):
        u = f.lane(x, k)
        low, high = f.int_slot(), f.int_slot()
        f.store_int(0, low)
        f.store_int(n - 1, high)
        # bisection with a fixed number of halvings needs no test of its own
        for _ in range(max(1, (n - 1).bit_length())):
            a, b = f.load_int(low), f.load_int(high)
            middle = f.emit_int(f"lshr i64 {(a + b).ref}, 1")
            right = f.compare("oge", u, f.load(f.offset(at, middle)))
            wider = f.compare_int("sgt", b - a, 1)
            f.store_int(f.select_int(right & wider, middle, a), low)
            f.store_int(f.select_int((~right) & wider, middle, b), high)
        i = f.load_int(low)
        inside = f.compare("oge", u, knots[0]) & f.compare("olt", u, knots[-1])
        gradient = f.load(f.offset(slope, i))
        if order:
            results.append(f.select(inside, gradient, f.constant(0.0)))
            continue
        value = f.load(f.offset(start, i)) + (u - f.load(f.offset(at, i))) * gradient
        outside = f.select(f.compare("olt", u, knots[0]), f.constant(values[0]), f.constant(values[-1]))
        held = f.select(f.compare("uno", u, 0.0), u, outside)
        results.append(f.select(inside, value, held))
    return f.pack(results, x.width)


class _Lowering:
    """State of one lowering: values so far, and sines and cosines waiting to share a vector."""

    def __init__(
        self, f: Function, program: Program, inputs: Mapping[str, Sequence[Value]], width: int, fused: bool
    ) -> None:
        self.f = f
        self.code = program.instructions
        self.inputs = inputs
        self.width = width
        self.fused = fused
        self.values: list[Value | None] = [None] * len(self.code)
        self.groups = _trigonometric_levels(self.code)

    def need(self, k: int) -> None:
        """Compute instruction k and, before it, its arguments (an explicit stack: graphs may be deep)."""
        stack = [k]
        while stack:
            j = stack[-1]
            if self.values[j] is not None:
                stack.pop()
                continue
            instruction = self.code[j]
            if instruction.op in TRIGONOMETRIC:
                angles = self.groups[j]
                waiting = [a for a in angles if self.values[a] is None]
                if waiting:
                    stack.extend(waiting)
                    continue
                self._trigonometry(angles)
            else:
                waiting = [a for a in instruction.args if self.values[a] is None]
                if waiting:
                    stack.extend(waiting)
                    continue
                self.values[j] = self._apply(instruction)
            stack.pop()

    def _trigonometry(self, angles: dict[int, list[int]]) -> None:
        """Evaluate all sines and cosines of one level; scalars travel together in a vector."""
        f = self.f
        pending = list(angles)
        per_vector = 8 if self.width == 1 else 1
        for first in range(0, len(pending), per_vector):
            chunk = pending[first : first + per_vector]
            xs = [self.values[a] for a in chunk]
            if self.width == 1 and len(chunk) > 1 and self.fused:
                lanes = 2
                while lanes < len(chunk):
                    lanes *= 2
                s, c = sincos(f, f.pack([x for x in xs if x is not None], lanes), self.fused)
                pairs = [(f.lane(s, k), f.lane(c, k)) for k in range(len(chunk))]
            else:
                pairs = [sincos(f, x, self.fused) for x in xs if x is not None]
            for a, (sine, cosine) in zip(chunk, pairs):
                for user in angles[a]:
                    self.values[user] = sine if self.code[user].op == "sin" else cosine

    def _apply(self, i: Instruction) -> Value:
        f = self.f
        if i.op == "const":
            return f.constant(i.value, self.width)
        if i.op == "sym":
            group, position = i.value
            return f.splat(self.inputs[group][position], self.width)
        args = [v for v in (self.values[a] for a in i.args) if v is not None]
        if i.op == "table":
            return _table(f, args[0], *i.value)
        return operation(f, i.op, args, self.fused)


def _trigonometric_levels(code: Sequence[Instruction]) -> dict[int, dict[int, list[int]]]:
    """Group sines and cosines that do not wait for each other: {instruction: {angle: its users}}."""
    level = [0] * len(code)
    groups: dict[int, dict[int, list[int]]] = {}
    members: dict[int, dict[int, list[int]]] = {}
    for k, i in enumerate(code):
        below = max((level[a] for a in i.args), default=0)
        level[k] = below + (i.op in TRIGONOMETRIC)
        if i.op in TRIGONOMETRIC:
            group = groups.setdefault(below, {})
            group.setdefault(i.args[0], []).append(k)
            members[k] = group
    return members


def lower(
    f: Function, program: Program, inputs: Mapping[str, Sequence[Value]], width: int, fused: bool = True
) -> dict[str, list[Value]]:
    """Emit a program and return the values of its outputs.

    Parameters
    ----------
    inputs : for each symbol group, a value for each position (scalars are spread over the lanes).
    width : lanes of the arithmetic.
    fused : whether the machine has fused multiply-add.
    """
    state = _Lowering(f, program, inputs, width, fused)
    for k in range(len(program.instructions)):
        state.need(k)
    found: dict[str, list[Value]] = {}
    for name, entries in program.outputs.items():
        row = []
        for e in entries:
            value = f.constant(e, width) if isinstance(e, float) else state.values[e]
            assert value is not None
            row.append(value)
        found[name] = row
    return found


def call_program(
    f: Function, name: str, program: Program, inputs: Mapping[str, Sequence[Value] | Array], width: int
) -> dict[str, list[Value]]:
    """Call a program emitted by ``outline`` (for code too long to be repeated in place).

    Inputs that lie in memory as vectors of this width are read from where they are.
    """
    pointers = []
    for group, count in program.inputs.items():
        source = inputs[group]
        if isinstance(source, Array) and source.width == width and source.stride is None:
            pointers.append(source.base)
            continue
        address = f.slot(width, count)
        for k in range(count):
            f.store(f.splat(source[k], width), f.offset(address, k * width), 8 * width)
        pointers.append(address)
    results = {}
    for output, entries in program.outputs.items():
        results[output] = f.slot(width, max(1, len(entries)))
        pointers.append(results[output])
    f.call(name, [f"ptr {p}" for p in pointers])
    return {
        output: [f.load(f.offset(results[output], k * width), width, 8 * width) for k in range(len(entries))]
        for output, entries in program.outputs.items()
    }


def outline(name: str, program: Program, width: int, fused: bool, flags: str) -> Function:
    """Return a program as an internal function that works on memory."""
    arguments = [f"ptr noalias readonly %in.{g}" for g in program.inputs]
    arguments += [f"ptr noalias %out.{o}" for o in program.outputs]
    f = Function(name, arguments, internal=True, attributes="noinline", flags=flags)
    inputs = {
        g: [f.load(f.offset(f"%in.{g}", k * width), width, 8 * width) for k in range(n)]
        for g, n in program.inputs.items()
    }
    for output, values in lower(f, program, inputs, width, fused).items():
        for k, v in enumerate(values):
            f.store(f.splat(v, width), f.offset(f"%out.{output}", k * width), 8 * width)
    f.ret()
    return f


class Programs:
    """Where the programs of one module are: short ones in place, others once in ``functions``.

    interpreted : whether the others are data, which an interpreter works off, instead of machine code.
    room : doubles that the functions' argument ``%registers`` has to point to.
    """

    def __init__(self, fused: bool, interpreted: bool = False) -> None:
        self.fused, self.interpreted = fused, interpreted
        self.functions: dict[str, Function] = {}
        self.room = 0
        self._encoded: dict[str, tuple[Bytecode, str]] = {}
        self._registers: dict[tuple[str, int], int] = {}

    def evaluate(self, f: Function, program: Program, inputs: Inputs, width: int) -> dict[str, list[Value]]:
        """Emit the evaluation of a program in a function; return the values of its outputs.

        inputs : for each symbol group, a value for each position, or an array in memory.
        """
        if program.operations <= INLINE_LIMIT:
            return lower(f, program, _values(f, program, inputs, width), width, self.fused)
        if self.interpreted and not program.has_tables:
            return self._interpret(f, program, inputs, width)
        name = f"program.{program.digest[:12]}.{width}"
        if name not in self.functions:
            self.functions[name] = outline(name, program, width, self.fused, f.flags)
        return call_program(f, name, program, inputs, width)

    def _interpret(self, f: Function, program: Program, inputs: Inputs, width: int) -> dict[str, list[Value]]:
        """Emit the evaluation of a program that is data."""
        from robodyn_cli.kernels.bytecode.code import encode, kinds_of
        from robodyn_cli.kernels.bytecode.interpreter import interpreter, set_constants

        if program.digest not in self._encoded:
            code = encode(program, kinds_of(program))
            self._encoded[program.digest] = code, f.integers(f"code.{program.digest[:12]}", code.code)
        code, address = self._encoded[program.digest]
        function = f"interpret.{len(code.kinds)}.{width}"
        if function not in self.functions:
            self.functions[function] = interpreter(function, code.kinds, width, self.fused)
        place = program.digest, width
        if place not in self._registers:
            self._registers[place] = self.room
            # each where a vector of any width may be
            self.room += -(-code.registers * width // LANES) * LANES
        registers = Array(f, f.offset(f"%{REGISTERS}", self._registers[place]), width)
        set_constants(f, code, registers)
        first = 0
        for group, count in code.inputs.items():
            source, target = inputs[group], registers.part(first)
            first += count
            if isinstance(source, Array):
                with f.count(count) as k:
                    target[k] = source[k]
            else:
                for position, value in enumerate(source[:count]):
                    target[position] = value
        f.call(function, [f"ptr {address}", f"ptr {registers.base}"])
        return {
            output: [f.constant(e, width) if isinstance(e, float) else registers[e] for e in entries]
            for output, entries in code.outputs.items()
        }


def _values(f: Function, program: Program, inputs: Inputs, width: int) -> dict[str, Sequence[Value]]:
    """Load those inputs that are in memory, as far as they are used."""
    used = {i.value for i in program.instructions if i.op == "sym"}
    zero = f.constant(0.0, width)
    found: dict[str, Sequence[Value]] = {}
    for group, count in program.inputs.items():
        source = inputs[group]
        if isinstance(source, Array):
            source = [source[k] if (group, k) in used else zero for k in range(count)]
        found[group] = source
    return found
