"""A model as tables for rolled kernels: only these hold the model's numbers."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, cast

import numpy as np

from robodyn_cli.algorithms.kinematics import Motion
from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.graph import Expr, Scalar, free_symbols
from robodyn_cli.joints.base import Joint
from robodyn_cli.kernels.arrays import aligned_zeros
from robodyn_cli.kernels.rolled.loops import Header, Layout, Row
from robodyn_cli.kernels.rolled.recursion import make_recursion, structure_of
from robodyn_cli.kernels.rolled.steps import constants_of
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
    tables : 64-bit words, see ``Header`` and ``Row``. numbers : those in it that are needed.

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
                what = f"joint {body.joint_name} is {body.joint.type}"
                raise CapabilityError(f"{what}; rolled kernels take joints that move")
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

        words = np.zeros(Header.SIZE + len(bodies) * Row.SIZE)
        header = words[: Header.SIZE]
        header.view(np.int64)[[Header.BODIES, Header.SLOTS]] = len(bodies), self.slots
        rest = Motion.at_rest(gravity)
        header[Header.BASE_MOTION : Header.BASE_MOTION + 9] = [*rest.w, *rest.wd, *rest.a]
        rows = words[Header.SIZE :].reshape(len(bodies), Row.SIZE)
        whole = rows.view(np.int64)
        needed = [self.recursion.constants_used(kind) for kind in range(len(kinds))]
        for k, (index, body) in enumerate(zip(order, bodies)):
            whole[k, Row.KIND] = kind_of[k]
            whole[k, Row.PARENT_SLOT] = -1 if body.parent == before[k] else slot[body.parent]
            whole[k, Row.OWN_SLOT] = slot.get(index, -1)
            whole[k, Row.Q], whole[k, Row.V] = body.q, body.v
            rows[k, Row.CONSTANTS :] = _numbers(body, constants[k], needed[kind_of[k]])
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
        return aligned_zeros(Layout(self.recursion).vectors(self.bodies, self.slots) * width)


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
