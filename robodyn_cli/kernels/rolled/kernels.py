"""A model as tables for rolled kernels: only these hold the model's numbers.

Kernels whose code does not grow with the number of bodies, for long chains and large trees.
"""

from __future__ import annotations

import ctypes
import dataclasses
from collections.abc import Sequence
from typing import Any, cast

import numpy as np

from robodyn_cli.algorithms.kinematics import BodyMotion
from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.graph import Expr, Scalar, free_symbols
from robodyn_cli.joints.base import Joint
from robodyn_cli.kernels.arrays import address, aligned_zeros
from robodyn_cli.kernels.compiler import compile_module, machine
from robodyn_cli.kernels.rolled.loops import Header, TableLayout, TableRow, write_sample_kernel
from robodyn_cli.kernels.rolled.recursion import constants_of, make_recursion, structure_of
from robodyn_cli.model.model import BASE, Body, Model
from robodyn_cli.spatial.algebra import Array, Transform, Vector


def depth_first(model: Model) -> list[int]:
    """Return the bodies, parents first, so that as many as possible directly follow their parent."""
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


def place_root_alike(bodies: Sequence[Body], gravity: Vector) -> tuple[list[Body], Vector]:
    """Return the bodies with the only root placed like another body, and gravity turned to suit.

    The base does not move, so the place of the first joint matters only by the direction of gravity. A first
    joint placed unlike all others (an arm that stands upright) would hide the structure that they share.
    """
    root, *others = bodies
    numbers = not any(isinstance(x, Expr) for x in root.X_tree.E.ravel())
    if not numbers or any(b.parent == BASE for b in others):
        return list(bodies), gravity
    like = next((b.X_tree for b in others if b.joint == root.joint), Transform.identity())
    turned: Vector = like.E.T @ (root.X_tree.E @ gravity)
    return [dataclasses.replace(root, X_tree=like), *others], turned


class RolledPlan:
    """A model as tables, and the recursion that its kinds of joint take.

    recursion : the steps, shared with every model of the same kinds and structure.
    serial : every body hangs on the one before.
    tables : 64-bit words, see ``Header`` and ``TableRow``. numbers : those in it that are needed.

    Raises
    ------
    CapabilityError : gravity, a mass, an inertia or a place that the steps need is not a number.
    """

    def __init__(self, model: Model, recipe: str) -> None:
        self.recipe = recipe
        order = depth_first(model)
        if not order:
            raise CapabilityError("rolled kernels need at least one moving body")
        bodies, gravity = place_root_alike([model.bodies[k] for k in order], model.gravity)
        for body in bodies:
            if body.joint.nv == 0:
                cause = f"joint {body.joint_name} is {body.joint.type}"
                raise CapabilityError(f"{cause}; rolled kernels take joints that move")
        if any(isinstance(x, Expr) for x in gravity):
            raise CapabilityError("rolled kernels take gravity as numbers, not as symbols")
        joints = [_as_structure(b.joint) for b in bodies]
        kinds: list[Joint] = list(dict.fromkeys(joints))
        kind_of = [kinds.index(joint) for joint in joints]
        constants = [constants_of(b) for b in bodies]
        structures = tuple(
            structure_of([c for c, kind in zip(constants, kind_of) if kind == j]) for j in range(len(kinds))
        )
        self.recursion = make_recursion(
            recipe, tuple(kinds), structures, tuple(bool(x != 0.0) for x in gravity)
        )
        self.nq, self.nv, self.bodies = model.nq, model.nv, len(bodies)
        before = [BASE, *order[:-1]]
        late = [b.parent for b, previous in zip(bodies, before) if b.parent != previous]
        self.serial = not late
        # the base owns the first branch slot, used or not
        slot = {parent: k for k, parent in enumerate(dict.fromkeys([BASE, *late]))}
        self.slots = 0 if self.serial else len(slot)

        words = np.zeros(Header.SIZE + len(bodies) * TableRow.SIZE)
        header = words[: Header.SIZE]
        header.view(np.int64)[[Header.BODIES, Header.SLOTS]] = len(bodies), self.slots
        rest = BodyMotion.at_rest(gravity)
        header[Header.BASE_MOTION : Header.BASE_MOTION + 9] = [*rest.w, *rest.wd, *rest.a]
        rows = words[Header.SIZE :].reshape(len(bodies), TableRow.SIZE)
        whole = rows.view(np.int64)
        needed = [self.recursion.constants_used(kind) for kind in range(len(kinds))]
        for k, (index, body) in enumerate(zip(order, bodies)):
            whole[k, TableRow.KIND] = kind_of[k]
            whole[k, TableRow.PARENT_SLOT] = -1 if body.parent == before[k] else slot[body.parent]
            whole[k, TableRow.OWN_SLOT] = slot.get(index, -1)
            whole[k, TableRow.Q], whole[k, TableRow.V] = body.q, body.v
            rows[k, TableRow.CONSTANTS :] = _numbers(body, constants[k], needed[kind_of[k]])
        self.tables: Array = words
        self.numbers: tuple[Scalar, ...] = tuple(
            x for row, kind in zip(constants, kind_of) for k, x in enumerate(row) if k in needed[kind]
        )

    @property
    def inputs(self) -> dict[str, int]:
        """Sizes of what is read: positions, rates, and accelerations (inverse dynamics) or forces on the joints."""
        return {"q": self.nq, "v": self.nv, "a" if self.recipe == "inverse" else "f": self.nv}

    @property
    def operations(self) -> int:
        """Operations of one evaluation."""
        return self.bodies * self.recursion.operations

    @property
    def sizes(self) -> dict[str, int]:
        """Sizes of the outputs."""
        return {"out": self.nv}

    @property
    def digest(self) -> str:
        """Key of the compiled code: kinds of joint, shared structure, serial or tree; no numbers."""
        return f"{'serial' if self.serial else 'tree'} {self.recursion.digest}"

    def scratch(self, width: int) -> Array:
        """Return aligned scratch memory for ``width`` lanes."""
        return aligned_zeros(TableLayout(self.recursion).vectors(self.bodies, self.slots) * width)


def _as_structure(joint: Any) -> Joint:
    """Return a kind of joint with its parameters (a thread's pitch) as part of the code."""
    if not dataclasses.is_dataclass(joint):
        return cast("Joint", joint)
    own = {f.name: getattr(joint, f.name) for f in dataclasses.fields(joint)}
    plain = {name: float(x) for name, x in own.items() if isinstance(x, float)}
    return cast("Joint", dataclasses.replace(cast("Any", joint), **plain))


def _numbers(body: Body, row: Sequence[Scalar], needed: set[int]) -> list[float]:
    """Return a body's constants as numbers; NaN for one that is not known and that nothing depends on."""
    names = sorted({symbol.value[0] for symbol in free_symbols([row[k] for k in needed])})
    if names:
        listed = ", ".join(names)
        raise CapabilityError(f"{body.name}: rolled kernels take numbers, and {listed} is not one")
    return [float("nan") if isinstance(x, Expr) else float(x) for x in row]


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
        self._call(*map(address, (self.plan.tables, *columns, out, scratch)), padded)
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
