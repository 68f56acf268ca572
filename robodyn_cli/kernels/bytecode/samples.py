"""Programs as data, evaluated at many samples by a compiled loop that serves all programs."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence

import numpy as np

from robodyn_cli.kernels.arrays import aligned_zeros
from robodyn_cli.kernels.bytecode.code import encode, interpreter, kinds_of
from robodyn_cli.kernels.compiler import compile_module, machine
from robodyn_cli.kernels.ir import RELAXED, Function, Int, module
from robodyn_cli.kernels.program import PARAMETERS, Program
from robodyn_cli.spatial.algebra import Array


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
        host = machine()
        self.lanes = host.lanes
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
        compiled = compile_module(
            f"sample interpreter {host.lanes} {len(kinds)}",
            lambda: write_sample_interpreter(kinds, host.lanes, host.fused),
        )
        pointer, number = ctypes.c_void_p, ctypes.c_int64
        self._call = compiled.function("kernel", *[pointer] * 4, number, *[pointer] * 2, number, number)

    def __call__(
        self, inputs: Mapping[str, Array], results: Mapping[str, Array], samples: int, table: Array
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
        self._call(*at[:4], len(sources), *at[4:], len(targets), samples)


def _addresses(columns: Sequence[tuple[Array, Array]]) -> Array:
    """Return the addresses of columns, each of which is contiguous; of each array those with the numbers given."""
    parts = [array.ctypes.data + array.strides[-1] * numbers for array, numbers in columns]
    return np.concatenate([np.zeros(0, dtype=np.int64), *parts])
