"""Kernels that repeat a step for many samples at once, each lane until its own measure is small enough."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property

import numpy as np

from robodyn_cli.expr.graph import Scalar
from robodyn_cli.kernels.arrays import Array as Rows
from robodyn_cli.kernels.compiler import compile_module, machine
from robodyn_cli.kernels.ir import RELAXED, Function, Value, module
from robodyn_cli.kernels.lower import Loaded, lower
from robodyn_cli.kernels.program import NUMBERS, PARAMETERS, Program, make_program
from robodyn_cli.spatial.algebra import Array

STATE, DATA = "q", "d"  # groups of symbols: what the step changes, and what stays as it is for a sample


def write_iteration_kernel(program: Program, size: int, lanes: int, fused: bool) -> str:
    """Return the IR of ``kernel(q, d, p, numbers, out, measure, T, limit, rounds)``; rows of T samples.

    A lane whose measure is no longer above the limit, or is not a number, stays as it is.
    """
    arguments = [f"ptr noalias %{name}" for name in ("q", "d", "p", NUMBERS, "out", "measure")]
    f = Function("kernel", [*arguments, "i64 %T", "double %limit", "i64 %rounds"], flags=RELAXED)
    samples, rounds, limit = f.int_argument("T"), f.int_argument("rounds"), f.argument("limit")
    state = [f.slot(lanes) for _ in range(size)]
    with f.count(samples, step=lanes) as start:
        # the last block is moved back so that it ends at T; it repeats a few samples instead of needing masks
        t = f.select_int(f.compare_int("sgt", start + lanes, samples), samples - lanes, start)
        for k, slot in enumerate(state):
            f.store(f.load(f.offset("%q", samples * k + t), lanes), slot, 8 * lanes)
        inputs: dict[str, list[Value] | Rows] = {NUMBERS: Loaded(Rows(f, f"%{NUMBERS}"), program, lanes)}
        counts = program.inputs
        inputs[PARAMETERS] = [f.splat(f.load(f.offset("%p", k)), lanes) for k in range(counts.get("p", 0))]
        inputs[DATA] = [f.load(f.offset("%d", samples * k + t), lanes) for k in range(counts.get(DATA, 0))]
        done = f.int_slot()
        f.store_int(0, done)
        with f.loop() as loop:
            now = [f.load(slot, lanes, 8 * lanes) for slot in state]
            found = lower(f, program, {**inputs, STATE: now}, lanes, fused)
            measure = f.splat(found["measure"][0], lanes)
            f.store(measure, f.offset("%measure", t))
            unsolved = f.compare("ogt", measure, f.splat(limit, lanes))
            loop.leave(unless=unsolved.any())
            loop.leave(f.compare_int("sgt", f.bump(done), rounds))
            for slot, before, after in zip(state, now, found["next"]):
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
        self._compiled(*(a.ctypes.data for a in arrays), padded, limit, rounds)
        return out[:samples], measure[:samples]
