"""Kernels whose code does not grow with the number of bodies, for long chains and large trees."""

from __future__ import annotations

import ctypes

import numpy as np

from robodyn_cli.errors import CapabilityError
from robodyn_cli.kernels.compiler import compile_module, machine
from robodyn_cli.kernels.rolled.loops import write_sample_kernel
from robodyn_cli.kernels.rolled.tables import RolledPlan
from robodyn_cli.model.model import Model
from robodyn_cli.spatial.algebra import Array

# A block of samples visits every column of its arrays, each on a page of its own. With more columns than the
# processor translates pages for, and more bytes than its cache holds, samples are first copied to arrays of CHUNK rows,
# several columns to a page.
MANY_COLUMNS = 1000
MANY_BYTES = 1 << 23
CHUNK = 64


class RolledKernel:
    """A compiled recursion over the bodies of a model's open tree, for many samples at a time.

    The machine code depends on the kinds of joint, on the zeros that all bodies share and on serial or tree.
    One cached object serves all models of that sort, whatever their numbers and their number of bodies.
    Springs, dampers and friction in the joints are left to the caller.

    Raises
    ------
    CapabilityError : a constant that the motion depends on is not a number.
    """

    recipe = ""

    def __init__(self, model: Model) -> None:
        self.plan = plan = RolledPlan(model, self.recipe)
        host = machine()
        self.lanes = host.lanes
        compiled = compile_module(
            f"rolled samples {self.lanes} {plan.digest}",
            lambda: write_sample_kernel(plan.recursion, plan.serial, host.lanes, host.fused),
        )
        self._call = compiled.function("kernel", *[ctypes.c_void_p] * 6, ctypes.c_int64)
        self._scratch: list[Array] = []

    def evaluate(self, q: Array, v: Array, x: Array) -> Array:
        """Return the result (T, nv); arrays (T, n) in column order are read in place, others are copied."""
        plan = self.plan
        samples = len(q)
        arrays = [np.asarray(a, dtype=np.float64) for a in (q, v, x)]
        for array, n in zip(arrays, (plan.nq, plan.nv, plan.nv)):
            if array.shape != (samples, n):
                raise ValueError(f"an array of shape {(samples, n)} is needed, not {array.shape}")
        columns = plan.nq + 3 * plan.nv
        if columns < MANY_COLUMNS or 8 * columns * samples < MANY_BYTES or samples <= CHUNK:
            return self._block(*arrays)
        out = np.empty((samples, plan.nv), order="F")
        for start in range(0, samples, CHUNK):
            part = slice(start, start + CHUNK)
            out[part] = self._block(*(a[part] for a in arrays))
        return out

    def _block(self, *arrays: Array) -> Array:
        samples = len(arrays[0])
        padded = max(samples, self.lanes)
        out = np.empty((padded, self.plan.nv), order="F")
        if not samples:
            return out[:0]
        if padded != samples:
            arrays = tuple(np.concatenate([a, np.repeat(a[-1:], padded - samples, axis=0)]) for a in arrays)
        columns = [np.asfortranarray(a) for a in arrays]
        # calls from several threads need scratch memory of their own; a list's pop and append are atomic
        try:
            scratch = self._scratch.pop()
        except IndexError:
            scratch = self.plan.scratch(self.lanes)
        self._call(*(a.ctypes.data for a in (self.plan.tables, *columns, out, scratch)), padded)
        self._scratch.append(scratch)
        return out[:samples]


class RolledInverseDynamics(RolledKernel):
    """tau = M qdd + C qd + G at many samples, as ``rnea``; of a model with loops, of its open tree."""

    recipe = "inverse"

    def __call__(self, q: Array, qd: Array, qdd: Array) -> Array:
        """Return the joint torques (T, nv) for q (T, nq), qd (T, nv) and qdd (T, nv)."""
        return self.evaluate(q, qd, qdd)


class RolledForwardDynamics(RolledKernel):
    """qdd = M^-1 (tau - C qd - G) at many samples, as ``aba``.

    Raises
    ------
    CapabilityError : the model has closed loops (or see ``RolledKernel``).
    """

    recipe = "forward"

    def __init__(self, model: Model) -> None:
        if model.closures:
            raise CapabilityError("rolled forward dynamics takes open trees; the model has closed loops")
        super().__init__(model)

    def __call__(self, q: Array, qd: Array, tau: Array) -> Array:
        """Return the joint accelerations (T, nv) for q (T, nq), qd (T, nv) and tau (T, nv)."""
        return self.evaluate(q, qd, tau)
