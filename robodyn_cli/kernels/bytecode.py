"""A program as data: lists of equal operations that a compiled loop works off, also at many samples."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.kernels.arrays import Array, aligned_zeros
from robodyn_cli.kernels.compiler import LASTING, QUICK, compile_module, machine
from robodyn_cli.kernels.ir import RELAXED, Function, Int, module
from robodyn_cli.kernels.mathematics import LIBRARY, halvings, operation, piecewise_of_shape
from robodyn_cli.kernels.program import PARAMETERS, Instruction, Program
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array as Floats

# kinds of operation with their numbers of arguments, in the order in which a round takes them
KINDS = {
    "mul": 2, "add": 2, "sub": 2, "neg": 1, "div": 2, "sqrt": 1, "sin": 1, "cos": 1, "abs": 1, "sign": 1,
    "min": 2, "max": 2, "where": 3, "pow": 2, "atan2": 2, "exp": 1, "log": 1, "tan": 1, "asin": 1, "acos": 1,
    "atan": 1, "sinh": 1, "cosh": 1, "tanh": 1, "round": 1, "table": 1,
}  # fmt: skip
# Samples times operations of one call up to which a program is worked off by a loop that is made quickly, in a third of
# the time, and takes twice as long: that loses 7 ms. By the call, so that a call gives the same bits again.
LITTLE = 10_000_000
# behind its registers a look-up has: the first of its numbers, knots, degree, whether it is held, halvings to find
SHAPE = {"table": 5}


@record
class Bytecode:
    """A program as data.

    kinds : the kinds of operation that a round takes, in order.
    code : int32; the number of rounds, then for each round and kind how many operations there are and, for each of
    them, the registers of its result and of its arguments, and the ``SHAPE`` of a look-up.
    inputs : how many registers each input group has, in order from the first register on.
    constants : values in the registers from ``first_constant`` on. numbers : places in the program's table of what is
    in the registers after those; knots and coefficients of look-ups stay in the table.
    outputs : per output array, the register of each entry, or a float where it is constant.
    registers : how many there are.
    """

    kinds: tuple[str, ...]
    code: NDArray[np.int32]
    inputs: dict[str, int]
    first_constant: int
    constants: NDArray[np.float64]
    numbers: NDArray[np.int32]
    outputs: dict[str, tuple[int | float, ...]]
    registers: int

    @property
    def first_number(self) -> int:
        return self.first_constant + len(self.constants)


def kinds_of(program: Program) -> tuple[str, ...]:
    """Return the first kinds of operation, as many as a program needs."""
    used = {i.op for i in program.instructions}
    last = max((k for k, kind in enumerate(KINDS) if kind in used), default=0)
    return tuple(KINDS)[: last + 1]


def encode(program: Program, order: tuple[str, ...]) -> Bytecode:
    """Return a program as data, of which each round takes the kinds in ``order``."""
    registers = _Registers(program)
    text: list[int] = []
    turns = _turns(program.instructions, order)
    for chosen in turns:
        text.append(len(chosen))
        registers.write(chosen, text)
    return Bytecode(
        kinds=order,
        code=np.array([len(turns) // len(order), *text], dtype=np.int32),
        inputs=program.inputs,
        first_constant=sum(program.inputs.values()),
        constants=np.array(registers.constants),
        numbers=np.array(registers.numbers, dtype=np.int32),
        outputs={
            name: tuple(e if isinstance(e, float) else registers.of[e] for e in entries)
            for name, entries in program.outputs.items()
        },
        registers=registers.count,
    )


def _turns(code: Sequence[Instruction], order: Sequence[str]) -> list[list[int]]:
    """Return the operations that each kind works off when it has its turn, round by round: as soon as their arguments
    are there."""
    kinds, place = len(order), {kind: k for k, kind in enumerate(order)}
    turns: list[list[int]] = []
    turn: list[int] = []  # of each instruction; -1 for what is there from the start
    for k, (op, args, _) in enumerate(code):
        if op not in place:
            turn.append(-1)
            continue
        own = place[op]
        known = max(map(turn.__getitem__, args))
        at = own + kinds * ((known - own) // kinds + 1)
        turn.append(at)
        while at >= len(turns):
            turns += [[] for _ in order]
        turns[at].append(k)
    return turns


class _Registers:
    """Places of values; those of inputs, constants and outputs are not used again."""

    def __init__(self, program: Program) -> None:
        self._code = code = program.instructions
        self.of = [-1] * len(code)
        self.constants = [i.value for i in code if i.op == "const"]
        first: dict[str, int] = {}
        self.count = 0
        for group, count in program.inputs.items():
            first[group] = self.count
            self.count += count
        self.numbers = [i.value for i in code if i.op == "number"]
        at_number = {place: self.count + len(self.constants) + k for k, place in enumerate(self.numbers)}
        self._uses = [0] * len(code)
        for k, i in enumerate(code):
            for a in i.args:
                self._uses[a] += 1
            if i.op == "sym":
                group, position = i.value
                self.of[k] = first[group] + position
            elif i.op == "const":
                self.of[k] = self.count
                self.count += 1
            elif i.op == "number":
                self.of[k] = at_number[i.value]
        self.count += len(self.numbers)
        kept = {e for entries in program.outputs.values() for e in entries if not isinstance(e, float)}
        for k, i in enumerate(code):
            if not i.args or k in kept:
                self._uses[k] = len(code) * len(KINDS)  # never free
        self._free: list[int] = []

    def write(self, chosen: Sequence[int], text: list[int]) -> None:
        """Append the registers of operations, of results, then of arguments, and the shapes of look-ups."""
        code, of, uses, free = self._code, self.of, self._uses, self._free
        for k in chosen:
            op, args, _ = code[k]
            at = len(text)
            text.append(0)
            for a in args:
                text.append(of[a])
                uses[a] -= 1
                if not uses[a]:
                    free.append(of[a])
            if free:
                place = free.pop()
            else:
                place = self.count
                self.count += 1
            of[k] = text[at] = place
            if op in SHAPE:
                text += shape(code[k])


def shape(look_up: Instruction) -> list[int]:
    """Return the first of its numbers, how many knots, degree, whether it is held, and how many halvings find a
    segment."""
    first, n, degree, held = look_up.value
    return [first, n, degree, int(held), halvings(n)]


def interpreter(name: str, kinds: Sequence[str], width: int, fused: bool) -> Function:
    """Return ``void name(code, registers, numbers)``: work off bytecode whose rounds take these kinds.

    Each register holds ``width`` doubles; inputs and constants are there already. numbers : the program's table.
    """
    arguments = ["ptr noalias readonly %code", "ptr %registers", "ptr readonly %numbers"]
    f = Function(name, arguments, internal=True, attributes="noinline", flags=RELAXED)
    at = f.int_slot()
    f.store_int(1, at)
    with f.count(f.load_index("%code", 0)):
        for kind in kinds:
            _work_off(f, kind, at, width, fused)
    f.ret()
    return f


def _work_off(f: Function, kind: str, at: str, width: int, fused: bool) -> None:
    """Work off the operations of one kind in a round, and move ``at`` behind them."""
    first = f.load_int(at) + 1
    count = f.load_index("%code", first - 1)
    size = 1 + KINDS[kind] + SHAPE.get(kind, 0)
    f.store_int(first + count * size, at)
    # library functions take doubles one by one in any case
    lanes = 1 if kind in LIBRARY else width
    with f.count(count) as k:
        places = [f.load_index("%code", first + k * size + j) * width for j in range(1 + KINDS[kind])]
        if kind == "table":
            shape = [f.load_index("%code", first + k * size + j) for j in range(2, size)]
            at = f.offset("%numbers", shape[0])
            with f.count(width) as lane:
                target, source = (f.offset("%registers", place + lane) for place in places)
                piecewise_of_shape(f, f.load(source), at, shape[1:], target)
            return
        with f.count(width, step=lanes) as lane:
            target, *sources = [f.offset("%registers", place + lane) for place in places]
            values = [f.load(source, lanes, 8 * lanes) for source in sources]
            f.store(operation(f, kind, values, fused), target, 8 * lanes)


def set_constants(f: Function, code: Bytecode, registers: Array, numbers: Array) -> None:
    """Put the constants of a bytecode, and the numbers of its table, into their registers."""
    constants = Array(f, f.table(f"{f.title}.{f.fresh('constants')}", [*code.constants.tolist(), 0.0]))
    if len(code.constants):
        with f.count(len(code.constants)) as k:
            registers[k + code.first_constant] = constants[k]
    if len(code.numbers):
        places = f.integers(f"{f.title}.{f.fresh('numbers')}", code.numbers)
        with f.count(len(code.numbers)) as k:
            registers[k + code.first_number] = numbers[f.load_index(places, k)]


def write_sample_interpreter(kinds: Sequence[str], lanes: int, fused: bool) -> str:
    """Return the IR of ``kernel(code, registers, numbers, sources, n, results, places, m, T)`` for bytecode of these
    kinds.

    sources : addresses of the n columns of input. results, places : addresses of the m columns of output, and the
    registers that they come from. T : samples, not fewer than lanes. Constants are in their registers already.
    """
    arguments = ["ptr noalias %code", "ptr %registers", "ptr %numbers", "ptr %sources", "i64 %n"]
    arguments += ["ptr %results", "ptr %places", "i64 %m", "i64 %T"]
    f = Function("kernel", arguments, flags=RELAXED)
    samples = f.int_argument("T")
    with f.blocks(samples, lanes) as t:
        with f.count(f.int_argument("n")) as k:
            column = f.load_address(f.offset("%sources", k))
            f.store(f.load(f.offset(column, t), lanes), f.offset("%registers", k * lanes), 8 * lanes)
        f.call("interpret", ["ptr %code", "ptr %registers", "ptr %numbers"])
        with f.count(f.int_argument("m")) as k:
            place: Int = f.load_int(f.offset("%places", k))
            value = f.load(f.offset("%registers", place * lanes), lanes, 8 * lanes)
            f.store(value, f.offset(f.load_address(f.offset("%results", k)), t))
    f.ret()
    return module([f, interpreter("interpret", kinds, lanes, fused)])


class InterpretedSamples:
    """A program as data, evaluated at samples by a compiled loop that serves all programs."""

    def __init__(self, program: Program) -> None:
        self.lanes = machine().lanes
        kinds = kinds_of(program)
        self._code = code = encode(program, kinds)
        # of each output the numbers of its columns that vary, and the whole row where nothing does
        self._varying, self._rows = {}, {}
        for name, entries in code.outputs.items():
            fixed = np.array([isinstance(e, float) for e in entries], dtype=bool)
            self._varying[name] = np.flatnonzero(~fixed)
            self._rows[name] = np.where(fixed, entries, 0.0)
        self._places = np.array(
            [entries[k] for name, entries in code.outputs.items() for k in self._varying[name]],
            dtype=np.int64,
        )
        self._kinds = kinds
        self._operations = program.operations
        self._loops: dict[int, Callable[..., None]] = {}

    def _loop(self, samples: int) -> Callable[..., None]:
        """Return the compiled loop for so many samples."""
        level = LASTING if samples * self._operations > LITTLE else QUICK
        if level not in self._loops:
            kinds, lanes, fused = self._kinds, self.lanes, machine().fused
            compiled = compile_module(
                f"sample interpreter {lanes} {len(kinds)}",
                lambda: write_sample_interpreter(kinds, lanes, fused),
                level,
            )
            pointer, number = ctypes.c_void_p, ctypes.c_int64
            types = [*[pointer] * 4, number, *[pointer] * 2, number, number]
            self._loops[level] = compiled.function("kernel", *types)
        return self._loops[level]

    def __call__(
        self, inputs: Mapping[str, Floats], results: Mapping[str, Floats], samples: int, table: Floats
    ) -> None:
        """Fill the columns of ``results`` from those of ``inputs``, both (samples, n), and a table of numbers."""
        code = self._code
        # of this call alone, since several threads may call
        memory = aligned_zeros(code.registers * self.lanes)
        registers = memory.reshape(code.registers, self.lanes)
        registers[code.first_constant :][: len(code.constants)] = code.constants[:, None]
        registers[code.first_number :][: len(code.numbers)] = table[code.numbers, None]
        read, written = [], []
        for group, count in code.inputs.items():
            columns = inputs[group]
            if group == PARAMETERS:
                columns = np.tile(columns, (samples, 1)).T.copy().T
            read.append((columns, np.arange(count)))
        for name, varying in self._varying.items():
            results[name][:] = self._rows[name]
            written.append((results[name], varying))
        sources, targets = _addresses(read), _addresses(written)
        at = [a.ctypes.data for a in (code.code, memory, table, sources, targets, self._places)]
        self._loop(samples)(*at[:4], len(sources), *at[4:], len(targets), samples)


def _addresses(columns: Sequence[tuple[Floats, Floats]]) -> Floats:
    """Return the addresses of columns, each of which is contiguous; of each array those with the numbers given."""
    parts = [array.ctypes.data + array.strides[-1] * numbers for array, numbers in columns]
    return np.concatenate([np.zeros(0, dtype=np.int64), *parts])
