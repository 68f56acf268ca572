"""The steps of one body as programs: the algorithms run on the symbols of a single body.

A recursion over a tree is a few sweeps over its bodies, outward (base to leaves) or inward. What a body's step
takes and gives is of four sorts:

- its constants, one row of a table (group ``p``), and samples: ``q``, ``v``, ``x`` in, ``out`` out;
- ``DOWN`` quantities, handed from parent to child in an outward sweep (in: the parent's, out: the body's own);
- ``UP`` quantities, summed over the children in an inward sweep (in: the body's own start plus its children's
  shares, out: the share of its parent). An outward sweep may give the start; otherwise it is zero;
- ``kept`` values, computed in one sweep and read back in a later one.

No equation is written here: the same functions make the unrolled kernels and the plain numbers.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import lru_cache
from typing import Any, Union

import numpy as np

from robodyn_cli.algorithms.aba import JointFactor, factor_joint
from robodyn_cli.algorithms.kinematics import Motion, step_motion, step_transform
from robodyn_cli.algorithms.rnea import drive_torque, inertial_wrench
from robodyn_cli.expr.graph import Expr, Graph, Scalar, reachable
from robodyn_cli.expr.rebuild import apply
from robodyn_cli.joints.base import Joint
from robodyn_cli.kernels.program import TRIGONOMETRIC, Program, make_program
from robodyn_cli.model.model import BASE, Body
from robodyn_cli.spatial.algebra import Transform, Vector, matrix, vector, zeros
from robodyn_cli.spatial.inertia import ArticulatedInertia, RigidInertia

DOWN = {"motion": 9, "deviation": 6}
UP = {"wrench": 6, "inertia": 21}
UPPER = [(i, j) for i in range(3) for j in range(i, 3)]
ROTATION = 9  # the first constants of a body are those of E
BODY_CONSTANTS = 23  # E 9, r 3, m, h 3, I 6, armature
GROUPS = ("p", "q", "v", "x", "kept", *DOWN, *UP)

Present = Mapping[str, tuple[bool, ...]]  # per quantity, which entries can be other than zero
Structure = tuple[Union[float, None], ...]  # per constant of a body: its value where it is structure


def constants_of(body: Body) -> list[Scalar]:
    """Return the constants of a body in the order of the table."""
    X, inertia = body.X_tree, body.inertia
    rotational = [inertia.I[i, j] for i, j in UPPER]
    return [*X.E.ravel(), *X.r, inertia.m, *inertia.h, *rotational, body.armature]


def _symmetric(xs: Sequence[Scalar]) -> Any:
    out = zeros(3, 3)
    for x, (i, j) in zip(xs, UPPER):
        out[i, j] = out[j, i] = x
    return out


def body_with(joint: Joint, c: Sequence[Scalar]) -> Body:
    """Return a body with the given constants: the inverse of ``constants_of``."""
    X = Transform(matrix([c[0:3], c[3:6], c[6:9]]), vector(c[9:12]))
    inertia = RigidInertia(c[12], vector(c[13:16]), _symmetric(c[16:22]))
    return Body("body", "joint", joint, BASE, X, inertia, q=0, v=0, armature=c[22])


def _motion(xs: Sequence[Scalar]) -> Motion:
    return Motion(vector(xs[0:3]), vector(xs[3:6]), vector(xs[6:9]))


def _articulated(xs: Sequence[Scalar]) -> ArticulatedInertia:
    H = matrix([xs[6:9], xs[9:12], xs[12:15]])
    return ArticulatedInertia(_symmetric(xs[0:6]), H, _symmetric(xs[15:21]))


def _entries(I: ArticulatedInertia) -> list[Scalar]:
    A, M = ([block[i, j] for i, j in UPPER] for block in (I.A, I.M))
    return [*A, *I.H.ravel(), *M]


class _Kept:
    """Nodes that one sweep computes and later sweeps read back."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self.stored: dict[int, Expr] = {}

    def __len__(self) -> int:
        return len(self.stored)

    def add(self, nodes: Iterable[Scalar]) -> list[Scalar]:
        """Keep nodes from now on; returns them as the sweep that stores them has to compute them."""
        fresh: dict[int, Expr] = {}
        for node in nodes:
            if isinstance(node, Expr) and node.op != "sym" and node.index not in self.stored:
                fresh[node.index] = node
        values = self.read(list(fresh.values()))
        for index in fresh:
            place = len(self.stored)
            self.stored[index] = self.graph.symbol(f"kept{place}", "kept", place)
        return values

    def read(self, outputs: Sequence[Scalar]) -> list[Scalar]:
        """Return the outputs with what is kept read back instead of computed again."""
        value: dict[int, Scalar] = dict(self.stored)
        pending = [e for e in outputs if isinstance(e, Expr)]
        for node in reachable(pending):
            if node.index not in value:
                symbol = node.op in ("sym", "const")
                value[node.index] = node if symbol else apply(node, [value[a.index] for a in node.args])
        return [value[e.index] if isinstance(e, Expr) else e for e in outputs]


@dataclasses.dataclass(frozen=True)
class Step:
    """One kind of body in one sweep; ``kept`` outputs go to places from ``first_kept`` on."""

    program: Program
    first_kept: int


@dataclasses.dataclass(frozen=True)
class Sweep:
    """One pass over the bodies. ``steps`` has one entry a kind of body."""

    outward: bool
    steps: tuple[Step, ...]


@dataclasses.dataclass(frozen=True)
class Recursion:
    """A recursion over the bodies of a tree, whatever their number.

    present : of each quantity, which entries can be other than zero (the others are neither kept nor moved).
    kept : how many values a body keeps between sweeps.
    """

    sweeps: tuple[Sweep, ...]
    present: dict[str, tuple[bool, ...]]
    kept: int

    @property
    def digest(self) -> str:
        """Key of the compiled code."""
        steps = [f"{s.outward} {p.program.digest} {p.first_kept}" for s in self.sweeps for p in s.steps]
        masks = [f"{name} {''.join('01'[x] for x in mask)}" for name, mask in sorted(self.present.items())]
        return " ".join([*steps, *masks, str(self.kept)])

    @property
    def operations(self) -> int:
        """Operations per body, the largest kind."""
        return sum(max(p.program.operations for p in s.steps) for s in self.sweeps)

    def constants_used(self, kind: int) -> set[int]:
        """Return which constants of a body the arithmetic needs."""
        code = [i for s in self.sweeps for i in s.steps[kind].program.instructions]
        return {i.value[1] for i in code if i.op == "sym" and i.value[0] == "p"}


class _Stage:
    """The symbols of one body of a kind, and the outputs of its steps so far."""

    def __init__(self, joint: Joint, structure: Structure, present: Present) -> None:
        self.present = present
        self.graph = Graph()
        self.kept = _Kept(self.graph)
        self.steps: list[tuple[bool, dict[str, list[Scalar]], int]] = []
        known = [
            self.graph.symbol(f"p{k}", "p", k) if c is None else c for k, c in enumerate(structure)
        ]
        self.joint = joint
        self.body = body_with(joint, known)
        self.q = self.samples("q", joint.nq)
        self.v = self.samples("v", joint.nv)
        self.x = self.samples("x", joint.nv)
        self.X = step_transform(self.body, self.q)

    def samples(self, group: str, n: int) -> Vector:
        return vector([self.graph.symbol(f"{group}{k}", group, k) for k in range(n)])

    def quantity(self, name: str) -> list[Scalar]:
        """Return a quantity as symbols, and zeros where it is known to vanish."""
        mask = self.present[name]
        return [self.graph.symbol(f"{name}{k}", name, k) if x else 0.0 for k, x in enumerate(mask)]

    def step(self, outward: bool, keep: Iterable[Scalar], **outputs: Sequence[Scalar]) -> None:
        """End a step: its outputs, and values to keep for later steps."""
        found = {name: self.kept.read(xs) for name, xs in outputs.items()}
        first = len(self.kept)
        found["kept"] = self.kept.add(keep)
        self.steps.append((outward, found, first))

    def outward_motion(self, qdd: Vector) -> None:
        """Motion from the parent's, and the wrench it needs; the joint's sines and cosines are kept."""
        motion = step_motion(self.body, self.X, self.q, self.v, qdd, _motion(self.quantity("motion")))
        n, f = inertial_wrench(self.body, motion)
        placed = [*self.X.E.ravel(), *self.X.r, *self.joint.S(self.q).ravel()]
        keep = [node for node in reachable(placed) if node.op in TRIGONOMETRIC]
        self.step(True, keep, motion=[*motion.w, *motion.wd, *motion.a], wrench=[*n, *f])

    def inverse_dynamics(self) -> None:
        """The steps of ``rnea``; x is qdd."""
        self.outward_motion(self.x)
        f = self.quantity("wrench")
        wrench = vector(f[:3]), vector(f[3:])
        n_p, f_p = self.X.force_to_parent(*wrench)
        torque = drive_torque(self.body, self.q, self.x, wrench)
        self.step(False, [], wrench=[*n_p, *f_p], out=list(torque))

    def forward_dynamics(self) -> None:
        """The steps of ``aba``, its two inward passes in one; x is tau.

        The wrench of the motion with qdd = 0 and the pull of the children's shares are both carried by the same
        transforms and only ever used as a sum, so one quantity holds both.
        """
        self.outward_motion(zeros(self.joint.nv))
        f = self.quantity("wrench")
        inertia = ArticulatedInertia.from_rigid(self.body.inertia) + _articulated(self.quantity("inertia"))
        factor, felt = factor_joint(self.body, self.q, inertia)
        share, reaction = factor.bear(self.x, (vector(f[:3]), vector(f[3:])))
        n_p, f_p = self.X.force_to_parent(*reaction)
        keep = [*factor.U_D.ravel(), *share]
        self.step(False, keep, wrench=[*n_p, *f_p], inertia=_entries(felt.to_parent(self.X)))
        self._accelerations(factor, share)

    def _accelerations(self, factor: JointFactor, share: Vector) -> None:
        parent = self.quantity("deviation")
        own, (w, a) = factor.follow(self.X, share, (vector(parent[:3]), vector(parent[3:])))
        self.step(True, [], deviation=[*w, *a], out=list(own))


RECIPES: dict[str, tuple[Callable[[_Stage], None], tuple[str, ...]]] = {
    "inverse": (_Stage.inverse_dynamics, ("motion", "wrench")),
    "forward": (_Stage.forward_dynamics, ("motion", "wrench", "inertia", "deviation")),
}


def structure_of(rows: Sequence[Sequence[Scalar]]) -> Structure:
    """Return which constants all bodies of a kind share as structure, so that they need no arithmetic.

    Zeros (a planar chain, joints without rotors), and ones in rotations. Any other number stays in the table,
    equal or not: the code is to serve all models of one structure.
    """
    found: list[float | None] = []
    for k, column in enumerate(zip(*rows)):
        values = {None if isinstance(x, Expr) else float(x) for x in column}
        value = values.pop() if len(values) == 1 else None
        found.append(value if value == 0.0 or (value == 1.0 and k < ROTATION) else None)
    return tuple(found)


@lru_cache(maxsize=32)
def make_recursion(
    recipe: str, joints: tuple[Joint, ...], structures: tuple[Structure, ...], gravity: tuple[bool, ...]
) -> Recursion:
    """Stage a recursion for the kinds of joint that a model has.

    Parameters
    ----------
    recipe : ``inverse`` or ``forward``.
    joints, structures : one a kind.
    gravity : which components of gravity are not zero.
    """
    run, names = RECIPES[recipe]
    general = all(c is None for structure in structures for c in structure[:12])
    present = {name: (general,) * (DOWN | UP)[name] for name in names}
    if not general:
        present["motion"] = (False,) * 6 + gravity
    while True:
        stages = [_Stage(joint, structure, present) for joint, structure in zip(joints, structures)]
        for stage in stages:
            run(stage)
        grown = {
            name: tuple(
                bool(np.any([old, *(_can_differ(s, name, k) for s in stages)])) for k, old in enumerate(mask)
            )
            for name, mask in present.items()
        }
        if grown == present:
            break
        # zeros that the base has need not survive a body: start again with what remains of them
        present = grown
    sweeps = []
    for k, (outward, _, _) in enumerate(stages[0].steps):
        steps = []
        for stage in stages:
            _, outputs, first = stage.steps[k]
            steps.append(Step(make_program({n: xs for n, xs in outputs.items() if xs}, GROUPS), first))
        sweeps.append(Sweep(outward, tuple(steps)))
    return Recursion(tuple(sweeps), present, max(len(stage.kept) for stage in stages))


def _can_differ(stage: _Stage, name: str, k: int) -> bool:
    """Tell whether some step of a body gives entry k of a quantity another value than zero."""
    given = [outputs[name][k] for _, outputs, _ in stage.steps if name in outputs]
    return any(isinstance(x, Expr) or x != 0.0 for x in given)
