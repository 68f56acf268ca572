"""The steps of one body as expressions: the algorithms run on the symbols of a single body.

A recursion over a tree is a few sweeps over its bodies, outward (base to leaves) or inward. What a body's
step takes and gives is of four sorts:

- its constants, one row of a table (group ``p``), and samples: ``q``, ``v``, ``x`` in, ``out`` out;
- ``DOWN`` quantities, handed from parent to child in an outward sweep (in: the parent's, out: the body's);
- ``UP`` quantities, summed over the children in an inward sweep (in: the body's own start and its children's
  shares, out: the share of its parent). An outward sweep may give the start; otherwise it is zero;
- ``kept`` values, computed in one sweep and read back in a later one.

No equation is written here: the functions called make the unrolled kernels and the plain numbers as well.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from robodyn_cli.algorithms.aba import factor_joint
from robodyn_cli.algorithms.kinematics import Motion, step_motion, step_transform
from robodyn_cli.algorithms.rnea import drive_torque, inertial_wrench
from robodyn_cli.expr.graph import Expr, Graph, Scalar, reachable
from robodyn_cli.expr.rebuild import apply
from robodyn_cli.joints.base import Joint
from robodyn_cli.kernels.program import TRIGONOMETRIC
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
        found: dict[Place, Scalar] = {}
        for name, xs in outputs.items():
            for k, x in enumerate(self.kept.read(xs)):
                found[name, k] = x
        found.update(self.kept.add(keep))
        self.drafts.append(Draft(outward, found))

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
