"""The steps of one body as expressions: the algorithms run on the symbols of a single body.

A recursion over a tree is a few sweeps over its bodies, outward (base to leaves) or inward. What a body's
step takes and gives is of four sorts:

- its constants, one row of a table (group ``p``), and samples: ``q``, ``v``, ``x`` in, ``out`` out;
- ``DOWN`` quantities, handed from parent to child in an outward sweep (in: the parent's, out: the body's);
- ``UP`` quantities, summed over the children in an inward sweep (in: the body's own start and its children's
  shares, out: the share of its parent). An outward sweep may give the start; otherwise it is zero;
- ``kept`` values, computed in one sweep and read back in a later one.

No equation is written here: the functions called make the unrolled kernels and the plain numbers as well.

Recursions over the bodies of a tree: the steps of each kind of body as programs, reduced to the needed.

Values that no torque or acceleration depends on (the moments out of the plane of a planar chain), or that are zero in
every body, are neither computed nor carried.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import lru_cache
from typing import Any

from robodyn_cli.algorithms.aba import factor_joint
from robodyn_cli.algorithms.kinematics import BodyMotion, step_motion, step_transform
from robodyn_cli.algorithms.rnea import drive_torque, inertial_wrench
from robodyn_cli.expr.graph import Expr, Graph, Scalar, is_nonzero, reachable
from robodyn_cli.expr.rebuild import apply
from robodyn_cli.joints.base import Joint
from robodyn_cli.kernels.program import TRIGONOMETRIC, Program, make_program
from robodyn_cli.model.model import BASE, Body
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Transform, Twist, Vector, Wrench, matrix, vector, zeros
from robodyn_cli.spatial.inertia import ArticulatedInertia, RigidInertia

DOWN = {"motion": 9, "deviation": 6}
UP = {"wrench": 6, "inertia": 21}
QUANTITIES = DOWN | UP
UPPER = [(i, j) for i in range(3) for j in range(i, 3)]
ROTATION = 9  # the first constants of a body are those of E
ROTORS = 22  # the constants before: E 9, r 3, m, h 3, I 6
BODY_CONSTANTS = ROTORS + 6  # a rotor for each coordinate of the joint, and zeros

Place = tuple[str, int]  # group and entry
Present = Mapping[str, tuple[bool, ...]]  # per quantity, which entries can be other than zero
Structure = tuple[Any, ...]  # per constant of a body: its value where it is structure, else None


def constants_of(body: Body) -> list[Scalar]:
    """Return the constants of a body in the order of the table."""
    X, inertia = body.X_tree, body.inertia
    rotational = [inertia.I[i, j] for i, j in UPPER]
    return [
        *X.E.ravel(),
        *X.r,
        inertia.m,
        *inertia.h,
        *rotational,
        *body.rotors,
        *[0.0] * (6 - body.joint.nv),
    ]


def body_with(joint: Joint, c: Sequence[Scalar]) -> Body:
    """Return a body with the given constants: the inverse of ``constants_of``."""
    X = Transform(matrix([c[0:3], c[3:6], c[6:9]]), vector(c[9:12]))
    inertia = RigidInertia(c[12], vector(c[13:16]), _symmetric(c[16:22]))
    return Body(
        "body", "joint", joint, BASE, X, inertia, q=0, v=0, armature=tuple(c[ROTORS : ROTORS + joint.nv])
    )


def _symmetric(xs: Sequence[Scalar]) -> Any:
    out = zeros(3, 3)
    for x, (i, j) in zip(xs, UPPER):
        out[i, j] = out[j, i] = x
    return out


def _wrench(xs: Sequence[Scalar]) -> Wrench:
    return Wrench(vector(xs[0:3]), vector(xs[3:6]))


def _twist(xs: Sequence[Scalar]) -> Twist:
    return Twist(vector(xs[0:3]), vector(xs[3:6]))


def _motion(xs: Sequence[Scalar]) -> BodyMotion:
    return BodyMotion(vector(xs[0:3]), vector(xs[3:6]), vector(xs[6:9]))


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

    def add(self, nodes: Iterable[Scalar]) -> dict[Place, Scalar]:
        """Keep nodes from now on; returns them as the sweep that stores them computes them."""
        fresh = {
            e.index: e for e in nodes if isinstance(e, Expr) and e.op != "sym" and e.index not in self.stored
        }
        values = self.read(list(fresh.values()))
        outputs: dict[Place, Scalar] = {}
        for index, value in zip(fresh, values):
            place = len(self.stored)
            self.stored[index] = self.graph.symbol(f"kept{place}", "kept", place)
            outputs["kept", place] = value
        return outputs

    def read(self, outputs: Sequence[Scalar]) -> list[Scalar]:
        """Return the outputs with what is kept read back instead of computed again."""
        value: dict[int, Scalar] = dict(self.stored)
        for node in reachable(outputs):
            if node.index not in value:
                leaf = node.op in ("sym", "const")
                value[node.index] = node if leaf else apply(node, [value[a.index] for a in node.args])
        return [value[e.index] if isinstance(e, Expr) else e for e in outputs]


@record
class Draft:
    """A body's step as expressions: its part of one sweep."""

    outward: bool
    outputs: dict[Place, Scalar]


class BodyStage:
    """The symbols of one body of a kind, and its steps so far.

    structure : constants that are known for all bodies of the kind.
    present : entries of the quantities that are symbols; the others are zeros.
    """

    def __init__(self, joint: Joint, structure: Structure, present: Present) -> None:
        self.present = present
        self.graph = Graph()
        self.kept = _Kept(self.graph)
        self.drafts: list[Draft] = []
        self.joint = joint
        self.body = body_with(
            joint, [self.graph.symbol(f"p{k}", "p", k) if c is None else c for k, c in enumerate(structure)]
        )
        self.q = self._samples("q", joint.nq)
        self.v = self._samples("v", joint.nv)
        self.x = self._samples("x", joint.nv)
        self.X = step_transform(self.body, self.q)

    def _samples(self, group: str, n: int) -> Vector:
        return vector([self.graph.symbol(f"{group}{k}", group, k) for k in range(n)])

    def _quantity(self, name: str) -> list[Scalar]:
        mask = self.present[name]
        return [self.graph.symbol(f"{name}{k}", name, k) if x else 0.0 for k, x in enumerate(mask)]

    def _step(self, outward: bool, keep: Iterable[Scalar] = (), **outputs: Sequence[Scalar]) -> None:
        """End a step: its outputs, and values to keep for later steps."""
        by_place: dict[Place, Scalar] = {}
        for name, xs in outputs.items():
            for k, x in enumerate(self.kept.read(xs)):
                by_place[name, k] = x
        by_place.update(self.kept.add(keep))
        self.drafts.append(Draft(outward, by_place))

    def _outward_motion(self, qdd: Vector) -> None:
        """Motion from the parent's, and the wrench that it needs; the joint's sines and cosines are kept."""
        motion = step_motion(self.body, self.X, self.q, self.v, qdd, _motion(self._quantity("motion")))
        wrench = inertial_wrench(self.body, motion)
        placed = [*self.X.E.ravel(), *self.X.r, *self.joint.S(self.q).ravel()]
        keep = [node for node in reachable(placed) if node.op in TRIGONOMETRIC]
        self._step(True, keep, motion=[*motion.w, *motion.wd, *motion.a], wrench=list(wrench.components))

    def inverse_dynamics(self) -> None:
        """The steps of ``rnea``; x is qdd."""
        self._outward_motion(self.x)
        wrench = _wrench(self._quantity("wrench"))
        felt = wrench.to_parent(self.X)
        torque = drive_torque(self.body, self.q, self.x, wrench)
        self._step(False, wrench=list(felt.components), out=list(torque))

    def forward_dynamics(self) -> None:
        """The steps of ``aba``, its two inward passes in one; x is tau.

        The wrench of the motion with qdd = 0 and the pull of the children's shares take the same transforms
        and are only ever used as a sum, so one quantity holds both.
        """
        self._outward_motion(zeros(self.joint.nv))
        IA = ArticulatedInertia.from_rigid(self.body.inertia) + _articulated(self._quantity("inertia"))
        factor, Ia = factor_joint(self.body, self.q, IA)
        D_u, pa = factor.inward(self.x, _wrench(self._quantity("wrench")))
        wrench = pa.to_parent(self.X)
        keep = [*factor.U_D.ravel(), *D_u]
        self._step(False, keep, wrench=list(wrench.components), inertia=_entries(Ia.to_parent(self.X)))
        qdd, a = factor.outward(self.X, D_u, _twist(self._quantity("deviation")))
        self._step(True, deviation=list(a.components), out=list(qdd))


RECIPES: dict[str, tuple[Callable[[BodyStage], None], tuple[str, ...]]] = {
    "inverse": (BodyStage.inverse_dynamics, ("motion", "wrench")),
    "forward": (BodyStage.forward_dynamics, ("motion", "wrench", "inertia", "deviation")),
}


BODY_GROUPS = ("p", "q", "v", "x", "kept", *QUANTITIES)


@record
class BodyStep:
    """One kind of body in one sweep. ``places`` are the entries that the program's outputs are, by group."""

    program: Program
    places: Mapping[str, tuple[int, ...]]


@record
class BodySweep:
    """One pass over the bodies. ``steps`` has one entry for each kind of body."""

    outward: bool
    steps: tuple[BodyStep, ...]


@record
class Recursion:
    """A recursion over the bodies of a tree, whatever their number.

    carried : of each quantity, the entries that pass from body to body.
    kept : how many values a body keeps between sweeps.
    """

    sweeps: tuple[BodySweep, ...]
    carried: dict[str, tuple[int, ...]]
    kept: int

    @property
    def digest(self) -> str:
        """Key of the compiled code."""
        steps = [f"{s.outward} {p.program.digest} {p.places}" for s in self.sweeps for p in s.steps]
        return " ".join([*steps, str(self.carried), str(self.kept)])

    @property
    def operations(self) -> int:
        """Operations per body, of the largest kind."""
        return sum(max(p.program.operations for p in s.steps) for s in self.sweeps)

    def constants_used(self, kind: int) -> set[int]:
        """Return which constants of a body the arithmetic needs."""
        code = [i for s in self.sweeps for i in s.steps[kind].program.instructions]
        return {i.value[1] for i in code if i.op == "sym" and i.value[0] == "p"}


def structure_of(rows: Sequence[Sequence[Scalar]]) -> Structure:
    """Return which constants all bodies of a kind share as structure, so that they need no arithmetic.

    Zeros (a planar chain, joints without rotors), and ones in rotations. Any other number stays in the table,
    equal or not: the code is to serve all models of one structure.
    """
    constants: list[float | None] = []
    for k, column in enumerate(zip(*rows)):
        values = {None if isinstance(x, Expr) else float(x) for x in column}
        value = values.pop() if len(values) == 1 else None
        constants.append(value if value == 0.0 or (value == 1.0 and k < ROTATION) else None)
    return tuple(constants)


@lru_cache(maxsize=32)
def make_recursion(
    recipe: str, joints: tuple[Joint, ...], structures: tuple[Structure, ...], gravity: tuple[bool, ...]
) -> Recursion:
    """Stage a recursion for the kinds of joint that a model has.

    Parameters
    ----------
    recipe : ``inverse`` or ``forward``.
    joints, structures : one for each kind.
    gravity : which components of gravity are not zero.
    """
    run, names = RECIPES[recipe]
    # with bodies in general places no entry stays zero, so there is nothing to search for
    anyhow = all(c is None for structure in structures for c in structure[: ROTATION + 3])
    present = {name: (anyhow,) * QUANTITIES[name] for name in names}
    if not anyhow:
        present["motion"] = (False,) * 6 + gravity
    while True:
        stages = [BodyStage(joint, structure, present) for joint, structure in zip(joints, structures)]
        for stage in stages:
            run(stage)
        grown = {
            name: tuple(old or any(_can_differ(s, (name, k)) for s in stages) for k, old in enumerate(mask))
            for name, mask in present.items()
        }
        if grown == present:
            break
        present = grown  # zeros of the base that do not survive a body; another body may undo more
    needed = _needed(stages)
    sweeps = []
    for number, draft in enumerate(stages[0].drafts):
        steps = []
        for j, stage in enumerate(stages):
            steps.append(_step(stage.drafts[number].outputs, needed[j], present))
        sweeps.append(BodySweep(draft.outward, tuple(steps)))
    carried = {
        name: tuple(k for k, x in enumerate(mask) if x and (name, k) in needed[0])
        for name, mask in present.items()
    }
    return Recursion(tuple(sweeps), carried, max(len(stage.kept.stored) for stage in stages))


def _can_differ(stage: BodyStage, place: Place) -> bool:
    """Tell whether some step of a body gives an entry of a quantity another value than zero."""
    given = (draft.outputs.get(place, 0.0) for draft in stage.drafts)
    return any(is_nonzero(x) for x in given)


def _needed(stages: Sequence[BodyStage]) -> list[set[Place]]:
    """Return, for each kind, the entries of quantities and kept values that some ``out`` depends on.

    Quantities pass between bodies of all kinds; what is kept stays with its body.
    """
    needed: list[set[Place]] = [set() for _ in stages]
    seen: list[set[int]] = [set() for _ in stages]
    pending: list[tuple[int, Scalar]] = []

    def want(place: Place, kinds: Sequence[int]) -> None:
        for j in kinds:
            if place not in needed[j]:
                needed[j].add(place)
                outputs = (draft.outputs for draft in stages[j].drafts)
                pending.extend((j, own[place]) for own in outputs if place in own)

    everywhere = range(len(stages))
    for j, stage in enumerate(stages):
        for k in range(stage.joint.nv):
            want(("out", k), [j])
    while pending:
        j, node = pending.pop()
        if not isinstance(node, Expr) or node.index in seen[j]:
            continue
        seen[j].add(node.index)
        pending.extend((j, a) for a in node.args)
        if node.op == "sym":
            _, group, k = node.value
            if group == "kept" or group in QUANTITIES:
                want((group, k), [j] if group == "kept" else everywhere)
    return needed


def _step(
    outputs: Mapping[Place, Scalar], needed: set[Place], present: Mapping[str, Sequence[bool]]
) -> BodyStep:
    """Return a step with the outputs that are needed and can be other than zero."""
    values: dict[str, list[Scalar]] = {}
    places: dict[str, list[int]] = {}
    for (group, k), value in outputs.items():
        if (group, k) in needed and (group not in present or present[group][k]):
            values.setdefault(group, []).append(value)
            places.setdefault(group, []).append(k)
    return BodyStep(
        make_program(dict(values), BODY_GROUPS), {group: tuple(ks) for group, ks in places.items()}
    )
