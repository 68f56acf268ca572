"""The equations of a scene whose payloads come and go, and the momentum and energy that payloads bring."""

from __future__ import annotations

from collections.abc import Sequence

from robodyn_cli.algorithms.energy import body_kinetic_energy
from robodyn_cli.algorithms.external import PathKinematics, path_torques
from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.model.build import build_model
from robodyn_cli.model.model import BASE, FixedFrame, RigidPart
from robodyn_cli.model.parts import CarriedMass
from robodyn_cli.scene import types as sc
from robodyn_cli.spatial.algebra import Twist, Vector, cross, identity, vector, zeros

FLIGHT = 19  # numbers of a payload that moves with its carrier


def switched_problem(scene: sc.Scene) -> Problem:
    """Return the equations with parameters p that say which payloads are carried, 1 or 0 each."""
    return Problem(scene, model=build_model(scene, switched=True))


def own_motion(problem: Problem, payload: CarriedMass) -> tuple[Vector, Scalar]:
    """Return J^T I V (nv,) and V^T I V / 2 of a payload that moves with its given velocities V, at its place."""
    part = payload.part
    if part is None:
        return zeros(problem.model.nv), 0.0
    velocity = _own_velocity(problem, payload, part)
    wrenches = {payload.body: part.inertia @ velocity}
    momentum = path_torques(problem.model, problem.q, problem.X, wrenches)
    return momentum, body_kinetic_energy(part.inertia, velocity)


def carried_motions(problem: Problem, payloads: Sequence[CarriedMass]) -> list[Scalar]:
    """Return numbers of each payload that moves with its carrier: place (3) [m] and velocity (3) [m/s] of its centre of
    mass, angular velocity (3) [rad/s], all in the world, kinetic energy [J], and the rotation (9) from its own axes, in
    which its data are given, to those of the world."""
    model, motions = problem.model, list[Scalar]()
    kinematics = PathKinematics(model, problem.X, problem.q, problem.v, BASE)
    to_world = model.base.E.T
    for payload in payloads:
        if payload.part is None:
            motions += [0.0] * (FLIGHT - 9) + list(identity().flat)
            continue
        centre = payload.part.frame.point(payload.part.c)
        end = kinematics.end(FixedFrame(payload.body, centre, identity()))
        origin = kinematics.end(FixedFrame(payload.body, zeros(3), identity())).velocity
        own = origin.rotated(problem.pose[payload.body].R.T)
        motions += [*model.base.point(end.p), *(to_world @ end.v), *(to_world @ end.w)]
        motions.append(body_kinetic_energy(payload.part.inertia, own))
        turned = problem.pose[payload.body].R @ payload.part.frame.E.T
        motions += list((to_world @ turned).flat)
    return motions


def relative_energies(problem: Problem) -> list[Scalar]:
    """Return the kinetic energy of each payload's motion against what holds it, before it is gripped [J]."""
    kinematics = PathKinematics(problem.model, problem.X, problem.q, problem.v, BASE)
    energies: list[Scalar] = []
    for payload in problem.model.payloads:
        if payload.part is None or payload.spec.start is None:
            energies.append(0.0)
            continue
        origin = FixedFrame(payload.body, zeros(3), problem.model.base.E)
        held = kinematics.end(origin).velocity.rotated(problem.pose[payload.body].R.T)
        own = _own_velocity(problem, payload, payload.part)
        energies.append(body_kinetic_energy(payload.part.inertia, Twist(held.w - own.w, held.v - own.v)))
    return energies


def _own_velocity(problem: Problem, payload: CarriedMass, part: RigidPart) -> Twist:
    """Return the given velocity of a payload as that of the body that is to hold it, in body coordinates."""
    to_body = problem.pose[payload.body].R.T @ problem.model.base.E
    w, v = (to_body @ vector(x) for x in (payload.spec.angular_velocity, payload.spec.velocity))
    return Twist(w, v - cross(w, part.frame.point(part.c)))
