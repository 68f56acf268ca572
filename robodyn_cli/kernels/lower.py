"""Turn Programs into IR inside a function that is being written: in place, as functions, or as data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from robodyn_cli.kernels.arrays import Array
from robodyn_cli.kernels.ir import Function, Int, Value
from robodyn_cli.kernels.mathematics import operation, piecewise, sincos
from robodyn_cli.kernels.program import NUMBERS, TRIGONOMETRIC, Instruction, Program

if TYPE_CHECKING:
    from robodyn_cli.kernels.bytecode import Bytecode

Inputs = Mapping[str, Sequence[Value] | Array]  # a value for each position, by group; the table of numbers

INLINE_LIMIT = 400  # operations; longer programs become functions
LANES = 8  # the most that an integrator evaluates at once
REGISTERS = "registers"  # argument of functions that evaluate programs: memory for those that are data


def is_inlined(program: Program) -> bool:
    """Tell whether a program's code goes where it is evaluated, instead of into a function of its own."""
    return program.operations <= INLINE_LIMIT


class LoadedNumbers(Array):
    """A program's table of numbers with its entries in registers.

    Make it before the program's inputs are loaded: LLVM orders the factors of a product by where they come from, and
    only with numbers first does it order them as it does constants, so that products of variables are shared.
    """

    def __init__(self, numbers: Sequence[Value] | Array, program: Program, width: int) -> None:
        assert isinstance(numbers, Array)
        super().__init__(numbers.f, numbers.base, numbers.width)
        places = [i.value for i in program.instructions if i.op == "number"]
        self.entries = {k: self.f.splat(numbers[k], width) for k in places}

    def __getitem__(self, k: Int | int) -> Value:
        assert isinstance(k, int)
        return self.entries[k]


class _Lowering:
    """State of one lowering: values so far, and sines and cosines waiting to share a vector."""

    def __init__(self, f: Function, program: Program, inputs: Inputs, width: int, fused: bool) -> None:
        self.f = f
        self.code = program.instructions
        self.inputs = inputs
        self.width = width
        self.fused = fused
        self.values: list[Value | None] = [None] * len(self.code)
        self.groups = _trigonometric_levels(self.code)

    @property
    def _numbers(self) -> Array:
        numbers = self.inputs[NUMBERS]
        assert isinstance(numbers, Array)
        return numbers

    def is_known(self, k: int) -> bool:
        """Tell whether an instruction needs no more code before its use."""
        return self.values[k] is not None or self.code[k].op == "number"

    def value(self, k: int) -> Value:
        """Return an instruction's value."""
        i = self.code[k]
        value = self.f.splat(self._numbers[i.value], self.width) if i.op == "number" else self.values[k]
        assert value is not None
        return value

    def need(self, k: int) -> None:
        """Compute instruction k and, before it, its arguments (an explicit stack: graphs may be deep)."""
        stack = [k]
        while stack:
            j = stack[-1]
            if self.is_known(j):
                stack.pop()
                continue
            instruction = self.code[j]
            if instruction.op in TRIGONOMETRIC:
                angles = self.groups[j]
                waiting = [a for a in angles if not self.is_known(a)]
                if waiting:
                    stack.extend(waiting)
                    continue
                self._trigonometry(angles)
            else:
                waiting = [a for a in instruction.args if not self.is_known(a)]
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
            xs = [self.value(a) for a in chunk]
            if self.width == 1 and len(chunk) > 1:
                lanes = 2
                while lanes < len(chunk):
                    lanes *= 2
                s, c = sincos(f, f.pack(xs, lanes), self.fused)
                pairs = [(f.lane(s, k), f.lane(c, k)) for k in range(len(chunk))]
            else:
                pairs = [sincos(f, x, self.fused) for x in xs]
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
        args = [self.value(a) for a in i.args]
        if i.op == "table":
            first, *shape = i.value
            return piecewise(f, args[0], f.offset(self._numbers.base, first), shape)
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
    f: Function, program: Program, inputs: Inputs, width: int, fused: bool = True
) -> dict[str, list[Value]]:
    """Emit a program and return the values of its outputs.

    Parameters
    ----------
    inputs : for each symbol group, a value for each position (scalars are spread over the lanes); ``NUMBERS``, the
        program's table of numbers, as an ``Array``.
    width : lanes of the arithmetic.
    fused : whether the target has fused multiply-add.
    """
    values = values_of(f, program, inputs, width, fused)
    return {
        name: [f.constant(e, width) if isinstance(e, float) else values[e] for e in entries]
        for name, entries in program.outputs.items()
    }


def values_of(f: Function, program: Program, inputs: Inputs, width: int, fused: bool) -> list[Value]:
    """Emit a program and return the value of each of its instructions; as ``lower``."""
    state = _Lowering(f, program, inputs, width, fused)
    for k in range(len(program.instructions)):
        state.need(k)
    return [state.value(k) for k in range(len(program.instructions))]


def call_program(
    f: Function, name: str, program: Program, inputs: Inputs, width: int
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
    if program.numbers:
        numbers = inputs[NUMBERS]
        assert isinstance(numbers, Array)
        pointers.append(numbers.base)
    results = {}
    for output, entries in program.outputs.items():
        results[output] = f.slot(width, max(1, len(entries)))
        pointers.append(results[output])
    f.call(name, [f"ptr {p}" for p in pointers])
    return {
        output: [f.load(f.offset(results[output], k * width), width, 8 * width) for k in range(len(entries))]
        for output, entries in program.outputs.items()
    }


def outline(name: str, program: Program, width: int, programs: Programs, flags: str) -> Function:
    """Return a program as an internal function that works on memory."""
    read = [*program.inputs, *([NUMBERS] if program.numbers else [])]
    arguments = [f"ptr noalias readonly %in.{g}" for g in read]
    arguments += [f"ptr noalias %out.{o}" for o in program.outputs]
    f = Function(name, arguments, internal=True, attributes="noinline", flags=flags)
    inputs: dict[str, Sequence[Value] | Array] = {
        NUMBERS: LoadedNumbers(Array(f, f"%in.{NUMBERS}", programs.number_lanes), program, width)
    }
    for g, n in program.inputs.items():
        inputs[g] = [f.load(f.offset(f"%in.{g}", k * width), width, 8 * width) for k in range(n)]
    for output, values in lower(f, program, inputs, width, programs.fused).items():
        for k, v in enumerate(values):
            f.store(f.splat(v, width), f.offset(f"%out.{output}", k * width), 8 * width)
    f.ret()
    return f


class Programs:
    """Where the programs of one module are: short ones in place, others once in ``functions``.

    number_lanes : of the tables of numbers; more than one where each lane has numbers of its own. interpreted : whether
    the others are data, which an interpreter works off, instead of machine code. room : doubles that the functions'
    argument ``%registers`` has to point to.
    """

    def __init__(self, fused: bool, interpreted: bool = False, number_lanes: int = 1) -> None:
        self.fused, self.interpreted, self.number_lanes = fused, interpreted, number_lanes
        self.functions: dict[str, Function] = {}
        self.room = 0
        self._encoded: dict[str, tuple[Bytecode, str]] = {}
        self._registers: dict[tuple[str, int], int] = {}

    def evaluate(self, f: Function, program: Program, inputs: Inputs, width: int) -> dict[str, list[Value]]:
        """Emit the evaluation of a program in a function; return the values of its outputs.

        inputs : as of ``lower``, or arrays in memory.
        """
        if is_inlined(program):
            return lower(f, program, loaded(f, program, inputs, width), width, self.fused)
        if self.interpreted:
            return self._interpret(f, program, inputs, width)
        name = f"program.{program.digest[:12]}.{width}"
        if name not in self.functions:
            self.functions[name] = outline(name, program, width, self, f.flags)
        return call_program(f, name, program, inputs, width)

    def _interpret(self, f: Function, program: Program, inputs: Inputs, width: int) -> dict[str, list[Value]]:
        """Emit the evaluation of a program that is data."""
        from robodyn_cli.kernels.bytecode import encode, interpreter, kinds_of, set_constants

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
        numbers = inputs[NUMBERS]
        assert isinstance(numbers, Array)
        set_constants(f, code, registers, numbers)
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
        f.call(function, [f"ptr {address}", f"ptr {registers.base}", f"ptr {numbers.base}"])
        return {
            output: [f.constant(e, width) if isinstance(e, float) else registers[e] for e in entries]
            for output, entries in code.outputs.items()
        }


def loaded(f: Function, program: Program, inputs: Inputs, width: int) -> Inputs:
    """Load those inputs that are in memory, as far as they are used."""
    used = {i.value for i in program.instructions if i.op == "sym"}
    zero = f.constant(0.0, width)
    loaded: dict[str, Sequence[Value] | Array] = {NUMBERS: LoadedNumbers(inputs[NUMBERS], program, width)}
    for group, count in program.inputs.items():
        source = inputs[group]
        if isinstance(source, Array):
            source = [source[k] if (group, k) in used else zero for k in range(count)]
        loaded[group] = source
    return loaded
