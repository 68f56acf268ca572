"""The model: the data of a mechanism that the algorithms need, and nothing else."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from functools import reduce
from typing import TYPE_CHECKING, Any

from robodyn_cli.expr.functions import maximum
from robodyn_cli.expr.graph import Expr, Graph, Scalar, free_symbols, reachable
from robodyn_cli.joints.base import Joint
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Matrix, Transform, Vector, congruence
from robodyn_cli.spatial.inertia import RigidInertia

if TYPE_CHECKING:
    from robodyn_cli.forces.element import ForceElement

BASE = -1
LONG = 64  # bodies in a row beyond which masses stay where they are: each would be computed from all beyond


@record
class JointForce:
    """A force element that acts in one joint (spring, damper, friction).

    name : the joint's, or the coordinate's where the joint has several. q, v : places of what it acts on in q and v,
    slices for a rotation or translation in space. unit : of that coordinate, ``rad`` or ``m``.
    """

    kind: str
    element: Any
    name: str
    q: Any
    v: Any
    unit: str = "rad"
    gear_ratio: float = 1.0

    @property
    def in_space(self) -> bool:
        """Whether it acts on a rotation or translation in any direction."""
        return isinstance(self.v, slice)


@record
class RigidPart:
    """A link of a body: mass m [kg], centre of mass c [m] and inertia about it [kg m^2], in the axes of ``frame``.

    frame : from body coordinates to those.
    """

    m: Any
    c: Vector
    I_com: Matrix
    frame: Transform

    @property
    def numbers(self) -> list[Any]:
        """All its numbers: m, c, I_com, then E and r of the frame."""
        return [self.m, *self.c, *self.I_com.flat, *self.frame.E.flat, *self.frame.r]

    @property
    def inertia(self) -> RigidInertia:
        """In body coordinates, about the body's origin."""
        return RigidInertia.from_com(self.m, self.c, self.I_com).to_parent(self.frame)


@record
class Body:
    """A moving body with the joint that carries it. Body axes: z is the joint axis, origin on the axis.

    parent : index of the parent body, or ``BASE``.
    X_tree : transform from the parent's body frame to the frame before the joint.
    inertia : in body coordinates, about the body's origin. parts : the links that it is the sum of, () where that is
    not known. armature, gear_ratio : of the joint's rotor, N^2 J and N; a tuple where each coordinate has its own.
    """

    name: str
    joint_name: str
    joint: Joint
    parent: int
    X_tree: Transform
    inertia: RigidInertia
    q: int
    v: int
    armature: Any = 0.0
    gear_ratio: Any = 1.0
    forces: tuple[JointForce, ...] = ()
    parts: tuple[RigidPart, ...] = ()

    @property
    def rotors(self) -> tuple[Any, ...]:
        """Inertia N^2 J of the rotor of each velocity coordinate."""
        return self.armature if isinstance(self.armature, tuple) else (self.armature,) * self.joint.nv

    @property
    def gear_ratios(self) -> tuple[float, ...]:
        """Gear ratio N of each velocity coordinate."""
        return self.gear_ratio if isinstance(self.gear_ratio, tuple) else (self.gear_ratio,) * self.joint.nv

    @property
    def cancellation(self) -> float:
        """Moments of inertia across the joint's axis over what of them acts; 1 where all does, or may.

        A body far from its joint along the axis has m c^2 about both transverse axes. A hinge feels only the
        difference, and a double that holds m c^2 + I does not hold the small I.
        """
        moments = self.inertia.I[0, 0], self.inertia.I[1, 1]
        numbers = (x for part in self.parts for x in part.numbers)
        if self.joint.divided(self.inertia) is None or any(isinstance(x, Expr) for x in (*moments, *numbers)):
            return 1.0
        acting: list[float] = [0.0]
        for part in self.parts:
            x, y, _ = part.frame.point(part.c)
            I = congruence(part.frame.E, part.I_com)
            acting += [abs(I[0, 0] - I[1, 1]), abs(I[0, 1]), part.m * x * x, part.m * y * y]
        # which of them is the largest decides nothing, as a comparison of numbers of the scene would
        most: float = reduce(maximum, acting)
        return maximum(*(abs(x) for x in moments)) / most if most else 1.0


@record
class FixedFrame:
    """A frame (or point) fixed to a body: origin p [m] and axes R in body coordinates."""

    body: int
    p: Vector
    R: Matrix


@record
class Loop:
    """A loop closure between two frames; ``element`` knows the equations."""

    name: str
    element: Any
    first: FixedFrame
    second: FixedFrame


@record
class Force:
    """A force element at one place or between two."""

    name: str
    element: ForceElement
    ends: tuple[FixedFrame, ...]


@record
class Model:
    """A tree of bodies in topological order, and the loops that close it.

    gravity : in base coordinates [m/s^2].
    graph : owner of the symbols among the constants (unknown or deliberately symbolic ones).
    joint_names : of the joints that move, in the order of the YAML, which places in q and v follow. q_names,
        v_names : of the columns of q and v (``hinge``, ``ball.qw``, ``ball.wx``). q_units : ``rad``, ``m`` or ``1``;
        v_units : ``rad`` or ``m``, per second those of v.
    outlines : for each link, the points that a drawing connects. of_points : points of which formulas ask
        something, by the name that they give it. payloads : masses that bodies carry or pick up.
    switched : of payloads that parameters p switch, the last of ``parameters``, their values at t = 0.
    """

    name: str
    bodies: tuple[Body, ...]
    nq: int
    nv: int
    gravity: Vector
    graph: Graph
    base: Transform
    points: dict[str, FixedFrame]
    frames: dict[str, FixedFrame]
    links: dict[str, FixedFrame]
    outlines: dict[str, tuple[FixedFrame, ...]]
    loops: tuple[Loop, ...] = ()
    couplers: tuple[str, ...] = ()
    forces: tuple[Force, ...] = ()
    joint_names: tuple[str, ...] = ()
    q_names: tuple[str, ...] = ()
    v_names: tuple[str, ...] = ()
    q_units: tuple[str, ...] = ()
    v_units: tuple[str, ...] = ()
    parameters: tuple[str, ...] = ()
    of_points: Mapping[str, tuple[FixedFrame, ...]] = dataclasses.field(default_factory=dict)
    payloads: tuple[Any, ...] = ()
    switched: tuple[float, ...] = ()

    @property
    def closures(self) -> tuple[str, ...]:
        """Names of everything that makes the coordinates depend on each other: loops and couplers."""
        return (*(loop.name for loop in self.loops), *self.couplers)

    def place(self, name: str) -> FixedFrame:
        """Return a named frame, or a named point with the axes of its link."""
        return self.frames[name] if name in self.frames else self.points[name]

    def body_of(self, joint_name: str) -> Body:
        """Return the body carried by a joint."""
        return next(b for b in self.bodies if b.joint_name == joint_name)

    def carrier(self, velocity: int) -> Body:
        """Return the body whose joint a velocity coordinate belongs to."""
        return next(b for b in self.bodies if b.v <= velocity < b.v + b.joint.nv)

    def joint_of(self, velocity: int) -> str:
        """Return the joint that a velocity coordinate belongs to."""
        return self.carrier(velocity).joint_name

    def q_columns(self, joint_name: str) -> tuple[str, ...]:
        """Return the columns of q of a joint."""
        return self.body_of(joint_name).joint.coordinates(joint_name, self.body_of(joint_name).joint.names)

    def v_columns(self, joint_name: str) -> tuple[str, ...]:
        """Return the columns of v of a joint."""
        return self.body_of(joint_name).joint.coordinates(joint_name, self.body_of(joint_name).joint.v_names)

    def path_to(self, body: int) -> list[int]:
        """Return the bodies from the base to ``body``, the base left out."""
        path: list[int] = []
        while body != BASE:
            path.append(body)
            body = self.bodies[body].parent
        return path[::-1]

    @property
    def coordinate_units(self) -> dict[str, str]:
        """Units by name of the columns of q, and of what those of v are rates of: ``rad``, ``m`` or ``1``."""
        return {**dict(zip(self.v_names, self.v_units)), **dict(zip(self.q_names, self.q_units))}

    def with_masses_at_joints(self) -> Model:
        """Return the same bodies with what of their inertias moves as if it were fixed to the parents counted to these.

        M, C and G stay. Unlike base parameters, which are fewer still, this only adds, so that nothing cancels, and it
        serves symbols and derivatives. Loads in the joints, and momenta and energies of single bodies, do not stay.
        Trees with long branches are left as they are.
        """
        rows = list[int]()  # of bodies from the base to each
        for body in self.bodies:
            rows.append(1 if body.parent == BASE else rows[body.parent] + 1)
        if max(rows, default=0) > LONG:
            return self
        inertia = [body.inertia for body in self.bodies]
        for k, body in reversed(list(enumerate(self.bodies))):
            parts = body.joint.divided(inertia[k])
            if parts is None:
                continue
            inertia[k], moved = parts
            if body.parent != BASE:
                inertia[body.parent] = inertia[body.parent] + moved.to_parent(body.X_tree)
        bodies = [dataclasses.replace(body, inertia=I, parts=()) for body, I in zip(self.bodies, inertia)]
        return dataclasses.replace(self, bodies=tuple(bodies))

    def common_ancestor(self, first: int, second: int) -> int:
        """Return the last body that the paths to two bodies share, or ``BASE``."""
        ancestor = BASE
        for a, b in zip(self.path_to(first), self.path_to(second)):
            if a != b:
                break
            ancestor = a
        return ancestor


# unit of a torque or force by that of the position that it works along
TORQUE = {"rad": "N m", "m": "N"}
UNKNOWN_GROUP = "unknown"  # of data that the scene does not give
PARAMETER_GROUP = "p"
# orders in which compiled functions take the arrays of the symbol groups
STATE_GROUPS = ("t", "q", "v", "z", "p")  # at a state: time, q, v, integrals z, parameters
MOTION_GROUPS = ("t", "q", "v", "a", "p")  # along a given motion: accelerations too


def unknown_among(entries: Iterable[Scalar]) -> list[str]:
    """Return the names of data that expressions depend on and the scene does not give."""
    return [symbol.value[0] for symbol in free_symbols(entries) if symbol.value[1] == UNKNOWN_GROUP]


def are_known(entries: Sequence[Scalar]) -> list[bool]:
    """Tell of each expression whether the scene gives all data that it depends on, in one pass over the graph."""
    lacking: set[int] = set()
    for node in reachable(entries):
        unknown = node.op == "sym" and node.value[1] == UNKNOWN_GROUP
        if unknown or any(a.index in lacking for a in node.args):
            lacking.add(node.index)
    return [not (isinstance(e, Expr) and e.index in lacking) for e in entries]
