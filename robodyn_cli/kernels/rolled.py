"""Kernels whose code does not grow with the number of bodies, for long chains and large trees."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.algorithms.kinematics import Motion
from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.graph import Expr, free_symbols
from robodyn_cli.kernels.compiler import compile_module, machine
from robodyn_cli.kernels.ir import module
from robodyn_cli.kernels.program import unknown_data
from robodyn_cli.kernels.rolled_loops import Header, Layout, Row, rolled_function, write_sample_kernel
from robodyn_cli.kernels.rolled_steps import Recursion, constants_of, make_recursion, structure_of
from robodyn_cli.model.model import BASE, PARAMETER_GROUP, Model

Array = NDArray[np.float64]
ALIGNMENT = 64


def depth_first(model: Model) -> list[int]:
    """Return the bodies so that as many as possible follow their parent."""
    children: dict[int, list[int]] = {}
    for k, body in enumerate(model.bodies):
        children.setdefault(body.parent, []).append(k)
    order: list[int] = []
    stack = children.get(BASE, [])[::-1]
    while stack:
        k = stack.pop()
        order.append(k)
        stack.extend(reversed(children.get(k, [])))
    return order


class RolledPlan:
    """A model as tables, and the recursion that its kinds of joint take.

    serial : every body hangs on the one before.
    tables : see ``rolled_loops``; the only thing that knows the model's numbers.
    """

    def __init__(self, model: Model, recipe: str) -> None:
        if not model.bodies:
            raise CapabilityError("rolled kernels need at least one moving body")
        order = depth_first(model)
        bodies = [model.bodies[k] for k in order]
        kinds = list(dict.fromkeys(b.joint for b in bodies))
        constants = [constants_of(b) for b in bodies]
        kind_of = [kinds.index(b.joint) for b in bodies]
        structures = tuple(
            structure_of([c for c, kind in zip(constants, kind_of) if kind == j]) for j in range(len(kinds))
        )
        at_rest = Motion.at_rest(model.gravity)
        if any(isinstance(x, Expr) for x in at_rest.a):
            raise CapabilityError("rolled kernels need gravity as numbers")
        present = tuple(bool(x != 0.0) for x in at_rest.a)
        self.recursion: Recursion = make_recursion(recipe, tuple(kinds), structures, present)
        before = [BASE, *order[:-1]]
        late = [b.parent for b, previous in zip(bodies, before) if b.parent != previous]
        # the base owns the first branch slot, used or not
        slot = {parent: k for k, parent in enumerate(dict.fromkeys([BASE, *late]))}
        self.serial = not late
        self.slots = 0 if self.serial else len(slot)
        words = np.zeros(Header.SIZE + len(bodies) * Row.SIZE)
        whole = words.view(np.int64)
        whole[Header.BODIES], whole[Header.SLOTS] = len(bodies), self.slots
        words[Header.BASE_MOTION : Header.BASE_MOTION + 9] = [*at_rest.w, *at_rest.wd, *at_rest.a]
        for k, (index, body) in enumerate(zip(order, bodies)):
            start = int(Header.SIZE) + k * int(Row.SIZE)
            whole[start : start + int(Row.CONSTANTS)] = [
                kind_of[k],
                -1 if body.parent == before[k] else slot[body.parent],
                slot.get(index, -1),
                body.q,
                body.v,
            ]
            needed = self.recursion.constants_used(kind_of[k])
            words[start + int(Row.CONSTANTS) : start + int(Row.SIZE)] = _numbers(constants[k], needed)
        self.tables: Array = words
        self.nq, self.nv = model.nq, model.nv
        self.bodies = len(bodies)

    @property
    def digest(self) -> str:
        """Key of the compiled code: kinds of joint, structure they share, serial or tree; no numbers."""
        return f"{'serial' if self.serial else 'tree'} {self.recursion.digest}"

    def scratch(self, width: int) -> Array:
        """Return aligned scratch memory for ``width`` lanes."""
        size = Layout(self.recursion).vectors(self.bodies, self.slots) * width
        memory = np.zeros(size + ALIGNMENT // 8)
        skip = (-memory.ctypes.data // 8) % (ALIGNMENT // 8)
        return memory[skip : skip + size]


def _numbers(row: Sequence[object], needed: set[int]) -> list[float]:
    """Return constants as numbers; NaN for one that nothing depends on and that is not known."""
    symbols = [s for k in needed for s in free_symbols([row[k]])]  # type: ignore[list-item]
    unknown = [s.value[0] for s in symbols if s.value[1] != PARAMETER_GROUP]
    if unknown:
        raise unknown_data(unknown)
    if symbols:
        names = ", ".join(sorted({s.value[0] for s in symbols}))
        raise CapabilityError(f"rolled kernels take no symbolic parameters (here {names})")
    return [float("nan") if isinstance(x, Expr) else float(x) for x in row]  # type: ignore[arg-type]


class RolledKernel:
    """A compiled recursion over the bodies of a model, for many samples at a time.

    The machine code depends on the kinds of joint and on serial or tree only, so one cached object serves all
    models of that sort. Springs, dampers and friction in the joints are not included.

    Raises
    ------
    CapabilityError : symbolic parameters.
    SceneError : the motion depends on a mass or inertia that the scene does not give.
    """

    recipe = ""

    def __init__(self, model: Model) -> None:
        self.plan = RolledPlan(model, self.recipe)
        host = machine()
        self.lanes = host.lanes
        plan = self.plan
        compiled = compile_module(
            f"rolled samples {self.lanes} {plan.digest}",
            lambda: write_sample_kernel(plan.recursion, plan.serial, host.lanes, host.fused),
        )
        self._call = compiled.function("kernel", *[ctypes.c_void_p] * 6, ctypes.c_int64)
        self._scratch: list[Array] = []

    def evaluate(self, q: Array, v: Array, x: Array) -> Array:
        """Return the result (T, nv); arrays (T, n) in column order are read in place, others copied once."""
        samples = np.shape(q)[0]
        padded = max(samples, self.lanes)
        columns = [
            self._columns(a, n, samples, padded)
            for a, n in ((q, self.plan.nq), (v, self.plan.nv), (x, self.plan.nv))
        ]
        out = np.empty((padded, self.plan.nv), order="F")
        if samples:
            # calls from several threads each need their own scratch memory; list operations are atomic
            scratch = self._scratch.pop() if self._scratch else self.plan.scratch(self.lanes)
            arrays = [self.plan.tables, *columns, out, scratch]
            self._call(*(a.ctypes.data for a in arrays), padded)
            self._scratch.append(scratch)
        return out[:samples]

    @staticmethod
    def _columns(array: Array, n: int, samples: int, padded: int) -> Array:
        array = np.asarray(array, dtype=np.float64)
        if array.shape != (samples, n):
            raise ValueError(f"an array of shape {(samples, n)} is needed, not {array.shape}")
        if padded != samples:
            array = np.concatenate([array, np.repeat(array[-1:], padded - samples, axis=0)])
        return np.asfortranarray(array)


class RolledInverseDynamics(RolledKernel):
    """tau = M qdd + C qd + G at many samples, as ``rnea`` of the open tree."""

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
        if model.loops:
            raise CapabilityError("rolled forward dynamics is for open trees; the model has closed loops")
        super().__init__(model)

    def __call__(self, q: Array, qd: Array, tau: Array) -> Array:
        """Return the joint accelerations (T, nv) for q (T, nq), qd (T, nv) and tau (T, nv)."""
        return self.evaluate(q, qd, tau)


class RolledState:
    """A recursion at one state, without lanes: what a stepping loop calls.

    ``address`` is that of ``rhs(tables, q, v, x, out, scratch)``; the arrays' entries lie side by side.
    """

    def __init__(self, model: Model, recipe: str = "forward") -> None:
        self.plan = plan = RolledPlan(model, recipe)
        host = machine()
        compiled = compile_module(
            f"rolled state {plan.digest}",
            lambda: module(
                [rolled_function("rhs", plan.recursion, plan.serial, 1, host.fused, internal=False)]
            ),
        )
        self.address = compiled.address("rhs")
        self._call = compiled.function("rhs", *[ctypes.c_void_p] * 6)
        self._scratch = plan.scratch(1)

    def __call__(self, q: Array, v: Array, x: Array) -> Array:
        """Return tau from qdd, or qdd from tau (nv,)."""
        out = np.empty(self.plan.nv)
        arrays = [np.ascontiguousarray(a, dtype=np.float64) for a in (q, v, x)]
        pointers = [a.ctypes.data for a in (self.plan.tables, *arrays, out, self._scratch)]
        self._call(*pointers)
        return out
