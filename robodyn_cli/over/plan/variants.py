"""A scene's equations with changes.

Variants of a scene's equations: one part taken out, or made as general as code for any scene has it.

The plan counts operations by building such variants; it estimates nothing. A constant that is made general becomes a
symbol, so it cannot be folded.
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any

from robodyn_cli.equations.constraints import Braces, Constraints, Dependence
from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.graph import Graph
from robodyn_cli.forces.friction import CoulombPair, Friction
from robodyn_cli.forces.limits import JointStop, Limits
from robodyn_cli.forces.springs import Damper, LinearSpring, Spring
from robodyn_cli.loops.pairs import RevoluteLoop
from robodyn_cli.model.build import build_model
from robodyn_cli.model.model import BASE, PARAMETER_GROUP, Body, FixedFrame, Force, JointForce, Loop, Model
from robodyn_cli.over.plan.plane import Plane
from robodyn_cli.record import record
from robodyn_cli.scene import types as sc
from robodyn_cli.spatial.algebra import (
    Matrix,
    Transform,
    Values,
    Vector,
    identity,
    matrix,
    snap,
    vector,
    zeros,
)
from robodyn_cli.spatial.inertia import RigidInertia


class Symbols:
    """Parameters without a value, each a new one."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph

    def one(self) -> Any:
        number = len(self.graph.nodes)
        return self.graph.symbol(f"general {number}", PARAMETER_GROUP, number)

    def vector(self) -> Vector:
        return vector([self.one() for _ in range(3)])

    def matrix(self) -> Matrix:
        return matrix([list(self.vector()) for _ in range(3)])

    def symmetric(self) -> Matrix:
        xx, yy, zz, xy, xz, yz = (self.one() for _ in range(6))
        return matrix([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


@record
class Variant:
    """Everything that decides the equations, ready to be changed.

    velocity_terms, accelerations : whether the rigid bodies' equations contain qd and qdd. rows : names of the
    constraint rows to keep (all by default). dependent : rows that are combined.
    braces : inertias along constraint rows, by name.
    """

    scene: sc.Scene
    model: Model
    velocity_terms: bool = True
    accelerations: bool = True
    rows: tuple[str, ...] | None = None
    dependent: tuple[Dependence, ...] = ()
    braces: Braces | None = None

    def with_scene(self, **changes: Any) -> Variant:
        return dataclasses.replace(self, scene=dataclasses.replace(self.scene, **changes))

    def with_model(self, **changes: Any) -> Variant:
        return dataclasses.replace(self, model=dataclasses.replace(self.model, **changes))

    def with_bodies(self, **fields: Callable[[Body], Any]) -> Variant:
        """Return the variant with fields of every body, each as a function of the body."""
        bodies = (
            dataclasses.replace(b, **{name: value(b) for name, value in fields.items()})
            for b in self.model.bodies
        )
        return self.with_model(bodies=tuple(bodies))

    @property
    def symbols(self) -> Symbols:
        return Symbols(self.model.graph)

    @contextlib.contextmanager
    def apart(self) -> Iterator[Variant]:
        """Give the scene's equations, in which nothing is changed yet, in a graph of their own, empty afterwards."""
        # symbols of missing data are of the model's graph
        missing = bool(self.model.graph.nodes)
        model = build_model(self.scene) if missing else dataclasses.replace(self.model, graph=Graph())
        yield dataclasses.replace(self, model=model)
        model.graph.clear()

    def problem(self) -> Problem:
        """Return the equations of this variant."""
        return VariantProblem(self)


class VariantProblem(Problem):
    """The equations with a variant's changes; for the scene as it is, exactly those of ``Problem``."""

    is_variant = True

    def __init__(self, variant: Variant) -> None:
        super().__init__(
            variant.scene, model=variant.model, dependent=variant.dependent, braces=variant.braces
        )
        self.variant = variant

    def newton_euler(self, v: Values, a: Values, gravity: Vector | None) -> Vector:
        rest = zeros(self.model.nv)
        v = v if self.variant.velocity_terms else rest
        return super().newton_euler(v, a if self.variant.accelerations else rest, gravity)

    @cached_property
    def constraints(self) -> Constraints:
        constraints, rows = super().constraints, self.variant.rows
        if rows is None:
            return constraints
        return constraints.only([i for i, name in enumerate(constraints.names) if name in rows])


# -- one part made general -----------------------------------------------------------------------------------


def general_directions(v: Variant) -> Variant:
    """Joint axes in any direction: nine symbols for each rotation between bodies."""
    return v.with_bodies(X_tree=lambda b: Transform(v.symbols.matrix(), b.X_tree.r))


def general_levers(v: Variant, plane: Plane | None = None) -> Variant:
    """Joints anywhere on their bodies: three symbols for each lever arm; in planar motion anywhere in the plane."""
    return v.with_bodies(X_tree=lambda b: Transform(b.X_tree.E, _place(v, plane, b.parent, b.X_tree.r)))


def _place(v: Variant, plane: Plane | None, body: int, p: Vector) -> Vector:
    """Return p with symbols for its components; in planar motion for those along coordinate axes in the plane."""
    s = v.symbols
    if plane is None:
        return s.vector()
    return vector([s.one() if abs(n) < 1e-9 else x for n, x in zip(plane.normal_in(body), p)])


def general_inertia(v: Variant) -> Variant:
    """Ten symbols for each body."""
    s = v.symbols
    return v.with_bodies(inertia=lambda b: RigidInertia(s.one(), s.vector(), s.symmetric()))


def general_gravity(v: Variant) -> Variant:
    """Gravity in any direction."""
    return v.with_model(gravity=v.symbols.vector())


def general_rotors(v: Variant) -> Variant:
    """A rotor's inertia on each joint."""
    return v.with_bodies(armature=lambda b: v.symbols.one())


@record
class Element:
    """How elements of one kind in the joints count as a term.

    has : whether an element has this part. without : the element without it. general : an element with symbols
    for constants, None where none is counted. everywhere : code for any scene has one in every joint.
    """

    name: str
    kind: str
    nothing: str = "no joint has one"
    has: Callable[[Any], bool] = lambda element: True
    without: Callable[[Any], Any] = lambda element: None
    general: Callable[[Symbols], Any] | None = None
    everywhere: bool = False

    def acts_on(self, body: Body) -> bool:
        """Tell whether the joint of a body has this part."""
        return any(f.kind == self.kind and self.has(f.element) for f in body.forces)


ELEMENTS = (
    Element(
        "viscous friction", "friction", "no joint has any", lambda e: e.viscous != 0.0,
        lambda e: dataclasses.replace(e, viscous=0.0),
        lambda s: Friction(viscous=s.one()), everywhere=True,
    ),
    Element(
        "Coulomb friction", "friction", "no joint has any", lambda e: e.dry,
        lambda e: dataclasses.replace(e, coulomb=0.0, static=None, stribeck_speed=None, law="smooth"),
        lambda s: Friction(coulomb=CoulombPair(s.one(), s.one()), transition_speed=s.one()), everywhere=True,
    ),
    Element(
        "joint springs", "spring", general=lambda s: Spring(stiffness=s.one(), rest=s.one()), everywhere=True
    ),
    Element("joint dampers", "damper", general=lambda s: Damper(damping=s.one()), everywhere=True),
    Element("gear losses", "gear", "no gear has an efficiency"),
    Element(
        "joint stops", "limits", "no joint has any",
        general=lambda s: Limits(s.one(), s.one(), stop=JointStop(stiffness=s.one(), damping=s.one())),
    ),
)  # fmt: skip


def with_element(v: Variant, element: Element) -> Variant:
    """Another such element in each joint."""
    assert element.general is not None
    make = element.general

    def more(b: Body) -> tuple[JointForce, ...]:
        coordinates = (one for one in b.joint.freedoms if not one.in_space)
        return tuple(
            JointForce(element.kind, make(v.symbols), b.joint_name, b.q + one.q, b.v + one.v)
            for one in coordinates
        )

    return v.with_bodies(forces=lambda b: (*b.forces, *more(b)))


def without_element(v: Variant, element: Element) -> Variant:
    """No such element in any joint."""

    def left(b: Body) -> tuple[JointForce, ...]:
        others = ((f, element.without(f.element) if f.kind == element.kind else f.element) for f in b.forces)
        return tuple(dataclasses.replace(f, element=e) for f, e in others if e is not None)

    return v.with_bodies(forces=left)


def general_loops(v: Variant) -> Variant:
    """Loop closures at any place and in any direction of both bodies."""
    s = v.symbols

    def anywhere(frame: FixedFrame) -> FixedFrame:
        return FixedFrame(frame.body, s.vector(), s.matrix())

    return v.with_model(
        loops=tuple(
            dataclasses.replace(loop, first=anywhere(loop.first), second=anywhere(loop.second))
            for loop in v.model.loops
        )
    )


@record
class Polynomial:
    """A formula that is a polynomial of time."""

    coefficients: Sequence[Any]

    def evaluate(self, environment: Mapping[str, Any]) -> Any:
        first, *others = self.coefficients
        return first + environment["t"] * Polynomial(others).evaluate(environment) if others else first


def general_drives(v: Variant) -> Variant:
    """A torque, a symbol, on each joint that has none."""
    any_torque = {name: Polynomial([v.symbols.one()]) for name in v.model.v_names}
    return v.with_scene(torques={**any_torque, **v.scene.torques})


def one_prescribed(v: Variant) -> Variant:
    """The first coordinate whose rate is a velocity as a quadratic function of time; none may be such.

    It has numbers in place of symbols: the model of a controller, which has a graph of its own, moves as it does.
    """
    motion = Polynomial([0.3, 0.7, 0.9])
    driven = [name for name in v.model.q_names if name in v.model.v_names][:1]
    return v.with_scene(prescribed=dict.fromkeys(driven, motion))


def general(v: Variant) -> Variant:
    """Every constant a symbol: code for any scene with this tree of joints."""
    variant = v.with_bodies(forces=lambda b: ())
    for change in (
        general_directions, general_levers, general_inertia, general_gravity, general_rotors, general_loops,
        general_drives,
    ):  # fmt: skip
        variant = change(variant)
    for element in ELEMENTS:
        variant = with_element(variant, element) if element.everywhere else variant
    return dataclasses.replace(variant, rows=None, dependent=())


def _ends(v: Variant, plane: Plane) -> tuple[FixedFrame, FixedFrame]:
    """Return a place on the last body and one on the base, in planar motion in the plane."""
    last = len(v.model.bodies) - 1
    first, second = (FixedFrame(body, _place(v, plane, body, zeros(3)), identity()) for body in (last, BASE))
    return first, second


def one_pin(v: Variant, plane: Plane) -> Variant:
    """A pin between the last body and the base: the smallest loop."""
    first, second = _ends(v, plane)
    axis, axis2 = (
        (float(x), float(y), float(z)) if plane.normal is not None else (0.0, 0.0, 1.0)
        for x, y, z in (plane.normal_in(first.body), plane.normal_in(BASE))
    )
    element = RevoluteLoop(name="pin", type="revolute", between=("", ""), axis=axis, axis2=axis2)
    return v.with_model(loops=(Loop("pin", element, first, second),))


def one_spring(v: Variant, plane: Plane) -> Variant:
    """A spring and damper between the last body and the base."""
    s = v.symbols
    element = LinearSpring("spring", "spring", ("", ""), stiffness=s.one(), length=s.one(), damping=s.one())
    return v.with_model(forces=(*v.model.forces, Force("spring", element, _ends(v, plane))))


# -- one part taken out, or arranged otherwise ---------------------------------------------------------------


def planar_inertia(b: Body) -> RigidInertia:
    """Return the inertia of a body that acts in a plane: m, the centre of mass in it, the moment about its normal."""
    I = zeros(3, 3)
    I[2, 2] = b.inertia.I[2, 2]
    if b.joint.nv > 1:
        # it turns about other axes too: their moments decide whether it can be accelerated
        I[0, 0], I[1, 1] = b.inertia.I[0, 0], b.inertia.I[1, 1]
    return RigidInertia(b.inertia.m, vector([b.inertia.h[0], b.inertia.h[1], 0.0]), I)


def without_loops(v: Variant, names: Sequence[str] | None = None) -> Variant:
    """Without these loops, or without any."""
    return v.with_model(
        loops=tuple(loop for loop in v.model.loops if names is not None and loop.name not in names)
    )


def serial_chain(v: Variant) -> Variant:
    """The open chain of the same bodies and joints, each carried by the one before, at its link's far end."""
    model = v.model

    def link_frame(body: int) -> Transform:
        if body == BASE:
            return Transform.identity()
        frame = model.links[model.bodies[body].name]
        return Transform.from_pose(frame.R, frame.p)

    bodies = []
    for k, b in enumerate(model.bodies):
        if k and b.parent != k - 1:
            placed = b.X_tree @ link_frame(b.parent).inverse()
            carrier = link_frame(k - 1)
            # a link whose frame is at its own joint has no far end: the joint stays as far away as it was
            r = placed.r if not any(carrier.r) else zeros(3)
            X = Transform(placed.E, r) @ carrier
            b = dataclasses.replace(
                b, parent=k - 1, X_tree=Transform(matrix([[snap(x) for x in row] for row in X.E]), X.r)
            )
        bodies.append(b)
    return without_loops(v.with_model(bodies=tuple(bodies)))
