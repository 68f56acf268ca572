"""Kernels that evaluate a program at many samples, eight (or four, or two) at a time in SIMD lanes.

A program begins as machine code that is made quickly, or a long one as data that a compiled loop works off, and becomes
lasting machine code when it has been evaluated at so many samples that this pays. Kernels of iterations repeat a
program, each lane until its own measure is small enough.
"""

from __future__ import annotations

import ctypes
import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.kernels.arrays import Array as Rows
from robodyn_cli.kernels.arrays import address
from robodyn_cli.kernels.compiler import LASTING, QUICK, compile_module, is_at_hand, machine
from robodyn_cli.kernels.ir import BLOCKS_AHEAD, RELAXED, Function, Int, Value, module
from robodyn_cli.kernels.lower import LoadedNumbers, lower
from robodyn_cli.kernels.program import NUMBERS, PARAMETERS, Program, make_program
from robodyn_cli.spatial.algebra import Array

if TYPE_CHECKING:
    # fills results (samples, n) from inputs and a table of numbers
    Evaluation = Callable[[Mapping[str, "Array"], Mapping[str, "Array"], int, "Array"], None]

# measured: lasting code takes 80 us an operation to make, and saves 0.3 ns for each operation at each sample over the
# interpreter; over code that is made quickly, 50 us and a tenth of that
LONG = 200  # operations up to which a program is machine code at once
MANY = 200_000  # samples from which on a program is lasting machine code
FOLLOWED = 16  # columns that the processor prefetches by itself while they are written in turn
STATE, DATA = (
    "q",
    "d",
)  # groups of symbols of an iteration: what its step changes, and what stays for a sample


def sample_function(name: str, program: Program, lanes: int, fused: bool) -> Function:
    """Return ``name(in..., p, out..., numbers, T)``: inputs and outputs are rows of T samples."""
    # by number: names of outputs are paths and names from the scene, which the IR would not take
    arguments = [f"ptr noalias %in.{k}" for k in range(len(program.inputs))]
    arguments += [f"ptr noalias %out.{k}" for k in range(len(program.outputs))]
    arguments += [f"ptr noalias readonly %{NUMBERS}", "i64 %T"]
    f = Function(name, arguments, flags=RELAXED)
    samples = f.int_argument("T")
    with f.blocks(samples, lanes) as t:
        inputs: dict[str, list[Value] | Rows] = {
            NUMBERS: LoadedNumbers(Rows(f, f"%{NUMBERS}"), program, lanes)
        }
        for place, (group, count) in enumerate(program.inputs.items()):
            address = f"%in.{place}"
            if group == PARAMETERS:
                inputs[group] = [f.splat(f.load(f.offset(address, k)), lanes) for k in range(count)]
            else:
                inputs[group] = [f.load(f.offset(address, samples * k + t), lanes) for k in range(count)]
        for place, entries in enumerate(program.outputs.values()):
            if len(entries) > FOLLOWED:
                with f.count(len(entries)) as j:
                    later = samples * j + t + BLOCKS_AHEAD * lanes
                    f.prefetch(f.offset(f"%out.{place}", later), write=True)
            _store_constants(f, place, entries, t, lanes)
        outputs = zip(program.outputs.values(), lower(f, program, inputs, lanes, fused).values())
        for place, (entries, values) in enumerate(outputs):
            for k, value in enumerate(values):
                if not isinstance(entries[k], float):
                    f.store(f.splat(value, lanes), f.offset(f"%out.{place}", samples * k + t))
    f.ret()
    return f


def _store_constants(f: Function, place: int, entries: Sequence[int | float], t: Int, lanes: int) -> None:
    """Store the entries of an output that are the same for all samples: in a loop, since matrices have many zeros."""
    constants = {k: e for k, e in enumerate(entries) if isinstance(e, float)}
    if not constants:
        return
    columns = f.integers(f"{f.title}.columns.{place}", np.array(list(constants), dtype=np.int32))
    values = f.table(f"{f.title}.constants.{place}", constants.values())
    with f.count(len(constants)) as j:
        address = f.offset(f"%out.{place}", f.int_argument("T") * f.load_index(columns, j) + t)
        f.store(f.splat(f.load(f.offset(values, j)), lanes), address)


class SampleKernel:
    """A function of samples.

    Calling it takes arrays by group, shape (T, n) or (T,) for a group of one, and returns {output: (T, n)}.
    Arrays in column order (``order="F"``) are read in place; others are copied once. Parameters ``p`` have
    shape (n,), or (T, n) where they change a few times: the samples between changes are evaluated piece by piece.

    table : numbers of another scene of this structure, which are read in place of the program's own. stepwise : whether
    a short program is worked off operation by operation, too. eager : whether lasting code is taken at once where the
    cache has it; its last bits may differ from those of what else serves at first, so not for what results hold.
    """

    compiled = True
    table: Array | None = None

    def __init__(
        self,
        outputs: Mapping[str, Sequence[Scalar]],
        known: Sequence[str],
        stepwise: bool = False,
        eager: bool = False,
    ) -> None:
        self.program, self._eager = make_program(dict(outputs), known), eager
        self._short = self.program.operations <= LONG and not stepwise  # machine code at once
        self.lanes = machine().lanes
        self._module: Sequence[Program] = [self.program]  # what is compiled together
        self._seen = 0  # samples so far

    @property
    def numbers(self) -> list[Sequence[float]]:
        """The numbers that it reads."""
        return [self.program.numbers or (0.0,)]

    def take(self, numbers: Sequence[Array]) -> None:
        """Take the numbers of another scene of this structure in place of ``numbers``; see ``_serve_many``."""
        self._serve_many()
        self.table = np.ascontiguousarray(numbers[0])

    def _serve_many(self) -> None:
        """Take lasting code of a short program from now on: many runs have the same bits in any order."""
        if self._short:
            self._seen = MANY

    @cached_property
    def _compiled(self) -> Evaluation:
        """The lasting code, made when it is first needed: ``program`` alone needs no compiler."""
        return self._machine_code(LASTING)

    def _machine_code(self, level: int) -> Evaluation:
        host = machine()
        names = [f"kernel.{k}" for k in range(len(self._module))]
        compiled = compile_module(
            self._key,
            lambda: module(
                [sample_function(*each, host.lanes, host.fused) for each in zip(names, self._module)]
            ),
            level,
        )
        own = next(name for name, program in zip(names, self._module) if program is self.program)
        count = len(self.program.inputs) + len(self.program.outputs) + 1
        function = compiled.function(own, *[ctypes.c_void_p] * count, ctypes.c_int64)

        def evaluate(
            inputs: Mapping[str, Array], results: Mapping[str, Array], samples: int, table: Array
        ) -> None:
            function(*map(address, (*inputs.values(), *results.values(), table)), samples)

        return evaluate

    def load(self) -> None:
        """Make now what the first call would, which then takes no longer than others; of a short program what lasts."""
        self._serve_many()
        if self._seen >= MANY or self._first is None:
            _ = self._compiled

    @property
    def _key(self) -> str:
        return f"samples {machine().lanes} {' '.join(program.digest for program in self._module)}"

    @cached_property
    def _first(self) -> Evaluation | None:
        """What evaluates the first samples; None where lasting code does."""
        if self._eager and is_at_hand(self._key):
            return None
        if self._short:
            return self._machine_code(QUICK)
        from robodyn_cli.kernels.bytecode import InterpretedSamples

        return InterpretedSamples(self.program)

    def _run(
        self, inputs: Mapping[str, Array], results: Mapping[str, Array], samples: int, table: Array
    ) -> None:
        """Fill ``results`` (samples, n) from ``inputs`` and a table of numbers, in whichever way takes less time in the
        long run.
        """
        self._seen += samples
        first = self._first if self._seen < MANY else None
        (first or self._compiled)(inputs, results, samples, table)

    def __call__(self, **groups: Array) -> dict[str, Array]:
        lengths = {np.shape(a)[0] for g, a in groups.items() if g != PARAMETERS}
        if len(lengths) != 1:
            raise ValueError(f"arrays of different lengths: {sorted(lengths)}")
        samples = lengths.pop()
        return self.evaluate(samples, groups)

    def evaluate(
        self, samples: int, groups: Mapping[str, Array], memory: Mapping[str, Array] | None = None
    ) -> dict[str, Array]:
        """Evaluate so many samples; a constant program needs no input.

        memory : where the outputs go, column-ordered arrays (T, n) with a row for each lane at least; by default
        arrays of their own.
        """
        if _varies(groups):
            parts = [self.evaluate(n, part) for n, part in _pieces(groups)]
            joined = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
            for name, array in (memory or {}).items():
                array[:samples] = joined[name]
            return {name: np.asfortranarray(array) for name, array in joined.items()}
        padded = max(samples, self.lanes)
        inputs = self._inputs(samples, padded, groups)
        results = memory or {
            name: np.empty((padded, len(entries)), order="F")
            for name, entries in self.program.outputs.items()
        }
        if samples:
            self._run(inputs, results, padded, self.program.table if self.table is None else self.table)
        return {name: r[:samples] for name, r in results.items()}

    def of_tables(self, tables: Array, samples: int, groups: Mapping[str, Array]) -> dict[str, Array]:
        """Evaluate so many samples with each row of tables (N, numbers) in place of its own: {output: (N, n, T)}.

        Groups of shape (N, T, n) are those of each row.
        """
        self._serve_many()
        own = {group: array for group, array in groups.items() if np.ndim(array) == 3}
        if own:
            shared = {group: array for group, array in groups.items() if group not in own}
            each = [
                self.of_tables(table[None], samples, {**shared, **{name: x[k] for name, x in own.items()}})
                for k, table in enumerate(tables)
            ]
            return {name: np.concatenate([x[name] for x in each]) for name in self.program.outputs}
        if _varies(groups):
            parts = [self.of_tables(tables, n, part) for n, part in _pieces(groups)]
            return {name: np.concatenate([part[name] for part in parts], axis=2) for name in parts[0]}
        padded = max(samples, self.lanes)
        inputs = self._inputs(samples, padded, groups)
        results = {
            name: np.empty((len(tables), len(entries), padded))
            for name, entries in self.program.outputs.items()
        }
        for k, table in enumerate(np.ascontiguousarray(tables, dtype=np.float64)):
            self._run(inputs, {name: r[k].T for name, r in results.items()}, padded, table)
        return {name: r[:, :, :samples] for name, r in results.items()}

    def _inputs(self, samples: int, padded: int, groups: Mapping[str, Array]) -> dict[str, Array]:
        """Return the inputs as code reads them, the last sample repeated up to ``padded``."""
        inputs: dict[str, Array] = {}
        for group, count in self.program.inputs.items():
            if group not in groups:
                raise CapabilityError(f"input {group} is missing")
            array = np.asarray(groups[group], dtype=np.float64)
            if array.ndim == 1 and group != PARAMETERS:
                array = array[:, None]
            if array.shape[-1] < count:
                raise CapabilityError(f"input {group}: {array.shape[-1]} columns, but {count} are needed")
            if group != PARAMETERS:
                if array.shape[0] != samples:
                    raise ValueError(f"input {group}: {array.shape[0]} samples, but {samples} are needed")
                if padded != samples:
                    array = np.concatenate([array, np.repeat(array[-1:], padded - samples, axis=0)])
                array = np.asfortranarray(array)
            else:
                array = np.ascontiguousarray(array if array.ndim == 1 else array[:1].ravel())
            inputs[group] = array
        return inputs


def compile_together(*kernels: object) -> None:
    """Make one module of the sample kernels among ``kernels`` that are short, when the first of them is compiled.

    A module takes some 5 ms to compile and 1 ms to load beside its operations, as much as those of a short kernel.
    """
    short = [k for k in kernels if isinstance(k, SampleKernel) and k._short]
    for kernel in short:
        kernel._module = [each.program for each in short]


def _varies(groups: Mapping[str, Array]) -> bool:
    """Tell whether parameters are given for each sample and are not always the same."""
    p = groups.get(PARAMETERS)
    return p is not None and np.ndim(p) == 2 and bool(np.any(p != p[:1]))


def _pieces(groups: Mapping[str, Array]) -> Iterator[tuple[int, dict[str, Array]]]:
    """Yield the samples between changes of the parameters: how many there are, and their groups."""
    p = groups[PARAMETERS]
    cuts = [0, *(np.flatnonzero(np.any(p[1:] != p[:-1], axis=1)) + 1).tolist(), len(p)]
    for first, end in itertools.pairwise(cuts):
        own = {group: array[first:end] for group, array in groups.items() if group != PARAMETERS}
        yield end - first, {**own, PARAMETERS: p[first]}


def of_one_sample(kernel: SampleKernel, **sizes: int) -> Callable[..., dict[str, Array]]:
    """Return a kernel as a function of one sample, quick since it fills the lanes of arrays that are in place already.

    sizes : of its inputs by group. The function takes these groups, arrays (n,) or numbers, and returns {output: (n,)}.
    """
    lanes = {group: np.zeros((kernel.lanes, n), order="F") for group, n in sizes.items()}

    def function(**values: Array | float) -> dict[str, Array]:
        for group, value in values.items():
            lanes[group][:] = value
        return {name: array[0] for name, array in kernel.evaluate(kernel.lanes, lanes).items()}

    return function


def write_iteration_kernel(program: Program, size: int, lanes: int, fused: bool) -> str:
    """Return the IR of ``kernel(q, d, p, numbers, out, measure, T, limit, rounds)``; rows of T samples.

    A lane whose measure is no longer above the limit, or is not a number, stays as it is.
    """
    arguments = [f"ptr noalias %{name}" for name in ("q", "d", "p", NUMBERS, "out", "measure")]
    f = Function("kernel", [*arguments, "i64 %T", "double %limit", "i64 %rounds"], flags=RELAXED)
    samples, rounds, limit = f.int_argument("T"), f.int_argument("rounds"), f.argument("limit")
    state = [f.slot(lanes) for _ in range(size)]
    with f.blocks(samples, lanes) as t:
        for k, slot in enumerate(state):
            f.store(f.load(f.offset("%q", samples * k + t), lanes), slot, 8 * lanes)
        inputs: dict[str, list[Value] | Rows] = {
            NUMBERS: LoadedNumbers(Rows(f, f"%{NUMBERS}"), program, lanes)
        }
        counts = program.inputs
        inputs[PARAMETERS] = [
            f.splat(f.load(f.offset("%p", k)), lanes) for k in range(counts.get(PARAMETERS, 0))
        ]
        inputs[DATA] = [f.load(f.offset("%d", samples * k + t), lanes) for k in range(counts.get(DATA, 0))]
        done = f.int_slot()
        f.store_int(0, done)
        with f.loop() as loop:
            now = [f.load(slot, lanes, 8 * lanes) for slot in state]
            values = lower(f, program, {**inputs, STATE: now}, lanes, fused)
            measure = f.splat(values["measure"][0], lanes)
            f.store(measure, f.offset("%measure", t))
            unsolved = f.compare("ogt", measure, f.splat(limit, lanes))
            loop.leave(unless=unsolved.any())
            loop.leave(f.compare_int("sgt", f.bump(done), rounds))
            for slot, before, after in zip(state, now, values["next"]):
                f.store(f.select(unsolved, after, before), slot, 8 * lanes)
        for k, slot in enumerate(state):
            f.store(f.load(slot, lanes, 8 * lanes), f.offset("%out", samples * k + t))
    f.ret()
    return module([f])


class IterationKernel:
    """A step, repeated for T samples until ``measure`` is at most a limit, or the rounds are used up.

    Parameters
    ----------
    step : the next state (n,) as expressions of the state ``q``, the sample's data ``d`` and parameters ``p``.
    measure : of the present state; at most the limit where the sample is done.
    """

    def __init__(self, step: Sequence[Scalar], measure: Scalar) -> None:
        self.size = len(step)
        self.program = make_program({"next": list(step), "measure": [measure]}, (STATE, DATA, PARAMETERS))
        self.lanes = machine().lanes

    @cached_property
    def _compiled(self) -> Callable[..., None]:
        host = machine()
        compiled = compile_module(
            f"iterations {host.lanes} {self.program.digest}",
            lambda: write_iteration_kernel(self.program, self.size, host.lanes, host.fused),
        )
        types = [*[ctypes.c_void_p] * 6, ctypes.c_int64, ctypes.c_double, ctypes.c_int64]
        return compiled.function("kernel", *types)

    def __call__(self, groups: Mapping[str, Array], limit: float, rounds: int) -> tuple[Array, Array]:
        """Return the states (T, n) after at most so many rounds, and their measures (T,).

        groups : q (T, n), d (T, k) and p (l,).
        """
        q, d = (np.asarray(groups[name], dtype=float) for name in (STATE, DATA))
        samples = len(q)
        if samples == 0:
            return q.copy(), np.zeros(0)
        padded = max(samples, self.lanes)
        if padded != samples:
            q, d = (np.concatenate([x, np.repeat(x[-1:], padded - samples, axis=0)]) for x in (q, d))
        q, d = np.asfortranarray(q), np.asfortranarray(d)
        p = np.ascontiguousarray(groups[PARAMETERS], dtype=float)
        out, measure = np.empty((padded, self.size), order="F"), np.empty(padded)
        arrays = (q, d, p, self.program.table, out, measure)
        self._compiled(*map(address, arrays), padded, limit, rounds)
        return out[:samples], measure[:samples]
