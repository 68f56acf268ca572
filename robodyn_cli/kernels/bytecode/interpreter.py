"""The compiled loop that works off bytecode."""

from __future__ import annotations

from collections.abc import Sequence

from robodyn_cli.kernels.arrays import Array
from robodyn_cli.kernels.bytecode.code import KINDS, SHAPE, Bytecode
from robodyn_cli.kernels.ir import RELAXED, Function
from robodyn_cli.kernels.mathematics import LIBRARY, operation, piecewise_of_shape


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
