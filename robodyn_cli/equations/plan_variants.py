"""Variants of a scene's equations: one part taken out, or made as general as code for any scene has it.

The plan counts operations by building such variants: nothing in it is estimated. What is made general becomes
a symbol, so it cannot be folded.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

from robodyn_cli.equations.variant import Symbols, Variant
from robodyn_cli.forces.damper import Damper
from robodyn_cli.forces.friction import CoulombPair, Friction
from robodyn_cli.forces.limits import Limits, Stop
from robodyn_cli.forces.linear_spring import LinearSpring
from robodyn_cli.forces.spring import Spring
from robodyn_cli.loops.revolute import RevoluteLoop
from robodyn_cli.model.build import build_model
from robodyn_cli.model.model import BASE, Body, FixedFrame, Force, JointForce, Loop
from robodyn_cli.spatial.algebra import Matrix, Transform, Vector, identity, matrix, snap, vector, zeros
from robodyn_cli.spatial.inertia import RigidInertia

# -- one part made general -----------------------------------------------------------------------------------


def general_directions(v: Variant) -> Variant:
    """Joint axes in any direction: nine symbols a rotation between bodies."""
    s = Symbols(v.model.graph)
    return v.with_bodies(lambda b: dataclasses.replace(b, X_tree=Transform(s.matrix(), b.X_tree.r)))


def general_levers(v: Variant) -> Variant:
    """Joints anywhere on their bodies: three symbols a lever arm."""
    s = Symbols(v.model.graph)
    return v.with_bodies(lambda b: dataclasses.replace(b, X_tree=Transform(b.X_tree.E, s.vector())))


def planar_levers(v: Variant, normals: Sequence[Any]) -> Variant:
    """Joints anywhere in the plane of motion; ``normals`` : its normal in the axes of each body's parent."""
    s = Symbols(v.model.graph)
    bodies = []
    for b, normal in zip(v.model.bodies, normals):
        r = _in_plane(s, normal, b.X_tree.r)
        bodies.append(dataclasses.replace(b, X_tree=Transform(b.X_tree.E, r)))
    return v.with_model(bodies=tuple(bodies))


def _in_plane(s: Symbols, normal: Sequence[float], p: Vector) -> Vector:
    """Return p with symbols for the components along coordinate axes that lie in the plane."""
    return vector([s.one() if abs(n) < 1e-9 else x for n, x in zip(normal, p)])


def general_inertia(v: Variant) -> Variant:
    """Ten symbols a body."""
    s = Symbols(v.model.graph)
    return v.with_bodies(
        lambda b: dataclasses.replace(b, inertia=RigidInertia(s.one(), s.vector(), s.symmetric()))
    )


def general_gravity(v: Variant) -> Variant:
    """Gravity in any direction."""
    return v.with_model(gravity=Symbols(v.model.graph).vector())


def general_rotors(v: Variant) -> Variant:
    """A rotor's inertia on each joint."""
    s = Symbols(v.model.graph)
    return v.with_bodies(lambda b: dataclasses.replace(b, armature=s.one()))


def _with_force(v: Variant, kind: str, element: Callable[[Symbols], Any]) -> Variant:
    s = Symbols(v.model.graph)
    return v.with_bodies(lambda b: dataclasses.replace(b, forces=(*b.forces, JointForce(kind, element(s)))))


def general_viscous(v: Variant) -> Variant:
    """Viscous friction in each joint."""
    return _with_force(v, "friction", lambda s: Friction(viscous=s.one()))


def general_coulomb(v: Variant) -> Variant:
    """Coulomb friction in each joint, its level different for each direction."""
    return _with_force(
        v, "friction", lambda s: Friction(coulomb=CoulombPair(s.one(), s.one()), transition_speed=s.one())
    )


def general_springs(v: Variant) -> Variant:
    """A spring in each joint."""
    return _with_force(v, "spring", lambda s: Spring(stiffness=s.one(), rest=s.one()))


def general_dampers(v: Variant) -> Variant:
    """A damper in each joint."""
    return _with_force(v, "damper", lambda s: Damper(damping=s.one()))


def general_stops(v: Variant) -> Variant:
    """Stops with springs and dampers at both ends of each joint's travel."""
    return _with_force(
        v, "limits", lambda s: Limits(s.one(), s.one(), Stop(stiffness=s.one(), damping=s.one()))
    )


def general_loops(v: Variant) -> Variant:
    """Loop closures at any place and in any direction of both bodies."""
    s = Symbols(v.model.graph)

    def anywhere(frame: FixedFrame) -> FixedFrame:
        return FixedFrame(frame.body, s.vector(), s.matrix())

    return v.with_model(
        loops=tuple(
            dataclasses.replace(loop, first=anywhere(loop.first), second=anywhere(loop.second))
            for loop in v.model.loops
        )
    )


def general(v: Variant) -> Variant:
    """Every constant a symbol: what code for any scene with this tree of joints does."""
    bare = v.with_bodies(lambda b: dataclasses.replace(b, forces=()))
    for change in (
        general_directions, general_levers, general_inertia, general_gravity, general_rotors, general_viscous,
        general_coulomb, general_springs, general_dampers, general_loops,
    ):  # fmt: skip
        bare = change(bare)
    return dataclasses.replace(bare, drives=True, rows=None, dependent=())


def one_pin(v: Variant, here: Any, there: Any) -> Variant:
    """A pin between the last body and the base: what the smallest loop would bring.

    Parameters
    ----------
    here, there : normal of the plane of motion in the axes of the body and of the base; zero without a plane.
    """
    s = Symbols(v.model.graph)
    first = FixedFrame(len(v.model.bodies) - 1, _in_plane(s, here, zeros(3)), identity())
    second = FixedFrame(BASE, _in_plane(s, there, zeros(3)), identity())
    axis = (float(here[0]), float(here[1]), float(here[2])) if any(here) else (0.0, 0.0, 1.0)
    other = (float(there[0]), float(there[1]), float(there[2])) if any(there) else (0.0, 0.0, 1.0)
    element = RevoluteLoop(name="pin", type="revolute", between=("", ""), axis=axis, axis2=other)
    return v.with_model(loops=(Loop("pin", element, first, second),))


def one_spring(v: Variant, here: Any, there: Any) -> Variant:
    """A spring and damper between the last body and the base; parameters as for ``one_pin``."""
    s = Symbols(v.model.graph)
    ends = (
        FixedFrame(len(v.model.bodies) - 1, _in_plane(s, here, zeros(3)), identity()),
        FixedFrame(BASE, _in_plane(s, there, zeros(3)), identity()),
    )
    element = LinearSpring("spring", "spring", ("", ""), stiffness=s.one(), length=s.one(), damping=s.one())
    return v.with_model(forces=(*v.model.forces, Force("spring", element, ends)))


# -- one part taken out --------------------------------------------------------------------------------------


def without_velocity_terms(v: Variant) -> Variant:
    """No centrifugal and Coriolis forces."""
    return dataclasses.replace(v, velocity_terms=False)


def without_accelerations(v: Variant) -> Variant:
    """No inertia forces of the accelerations (inverse dynamics)."""
    return dataclasses.replace(v, accelerations=False)


def without_gravity(v: Variant) -> Variant:
    return v.with_model(gravity=zeros(3))


def without_rotors(v: Variant) -> Variant:
    return v.with_bodies(lambda b: dataclasses.replace(b, armature=0.0))


def parallel_axes(v: Variant) -> Variant:
    """All joint axes parallel, lever arms as they are."""
    return v.with_bodies(lambda b: dataclasses.replace(b, X_tree=Transform(identity(), b.X_tree.r)))


def without_levers(v: Variant) -> Variant:
    """All joint axes through one point."""
    return v.with_bodies(lambda b: dataclasses.replace(b, X_tree=Transform(b.X_tree.E, zeros(3))))


def planar_inertia(v: Variant) -> Variant:
    """Of each body only what acts in a plane: m, the centre of mass in it, the moment about its normal."""

    def flat(b: Body) -> Body:
        I = zeros(3, 3)
        I[2, 2] = b.inertia.I[2, 2]
        if (
            b.joint.nv > 1
        ):  # it turns about other axes too: their moments decide whether it can be accelerated
            I[0, 0], I[1, 1] = b.inertia.I[0, 0], b.inertia.I[1, 1]
        h = vector([b.inertia.h[0], b.inertia.h[1], 0.0])
        return dataclasses.replace(b, inertia=RigidInertia(b.inertia.m, h, I))

    return v.with_bodies(flat)


def without_force(v: Variant, change: Callable[[Any], Any]) -> Variant:
    """Change the elements in the joints; those for which ``change`` returns None go."""

    def keep(b: Body) -> Body:
        changed = [(f.kind, change(f.element)) for f in b.forces]
        return dataclasses.replace(b, forces=tuple(JointForce(k, e) for k, e in changed if e is not None))

    return v.with_bodies(keep)


def without_elements(v: Variant, names: Sequence[str]) -> Variant:
    """Without these forces on points and between bodies."""
    return v.with_model(forces=tuple(force for force in v.model.forces if force.name not in names))


def without_loops(v: Variant, names: Sequence[str] | None = None) -> Variant:
    """Without these loops, or without any."""
    return v.with_model(
        loops=tuple(loop for loop in v.model.loops if names is not None and loop.name not in names)
    )


def unmerged(v: Variant) -> Variant:
    """Links on fixed joints as bodies of their own: their joints turn, but are kept still."""
    joints, still = [], []
    for joint in v.scene.robot.joints:
        if joint.type == "fixed":
            still.append(joint.name)
            joint = dataclasses.replace(joint, type="revolute", offset=joint.theta or 0.0, theta=None)
        joints.append(joint)
    scene = dataclasses.replace(v.scene, robot=dataclasses.replace(v.scene.robot, joints=tuple(joints)))
    return Variant(scene, build_model(scene), still=tuple(still))


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
            b = dataclasses.replace(b, parent=k - 1, X_tree=Transform(_snapped(X.E), X.r))
        bodies.append(b)
    return without_loops(v.with_model(bodies=tuple(bodies)))


def _snapped(E: Matrix) -> Matrix:
    return matrix([[snap(x) for x in row] for row in E])
