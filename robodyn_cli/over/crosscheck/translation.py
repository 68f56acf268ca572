"""What of a scene another engine computes, what it is given, and what it cannot be asked."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.rebuild import Evaluator
from robodyn_cli.forces.friction import Friction
from robodyn_cli.forces.springs import Damper, Spring
from robodyn_cli.model.build import build_model
from robodyn_cli.model.model import JointForce, Model
from robodyn_cli.over.crosscheck.engine import CLOSURES
from robodyn_cli.record import record
from robodyn_cli.scene.types import Inertia, Link, Robot, Scene
from robodyn_cli.spatial.algebra import Array


@record
class Translation:
    """A scene for another engine.

    model : with all numbers; data that the scene does not give, and that no result depends on, are made up. given :
    what the engine is handed as joint torques, in words. own : what the cross-check adds by formulas of its own.
    """

    scene: Scene
    model: Model
    given: tuple[str, ...]
    own: tuple[str, ...]
    rest: Problem

    def plain(self, q: Array, v: Array) -> Array:
        """Return the torques (nv,) of springs -k (q - q0), dampers -c q-dot and viscous friction -N^2 b q-dot."""
        tau = np.zeros(self.model.nv)
        for force in _plain_forces(self.model):
            element = force.element
            if isinstance(element, Spring):
                tau[force.v] -= float(element.stiffness) * (q[force.q] - float(element.rest))
            elif isinstance(element, Damper):
                tau[force.v] -= float(element.damping) * v[force.v]
            elif isinstance(element, Friction):
                ratio = float(force.gear_ratio) ** 2 if element.side == "motor" else 1.0
                tau[force.v] -= ratio * float(element.viscous) * v[force.v]
        return tau

    def evaluator(self, smooth: bool) -> Evaluator:
        """Return the torques that are handed over: in a simulation (``smooth``) those of the actuators too."""
        if smooth:
            return Evaluator(list(self.rest.applied))
        total = np.zeros(self.model.nv, dtype=object)
        for term in self.rest.passive_forces(smooth=False).values():
            total = total + term
        return Evaluator(list(total))


def translate(scene: Scene, simulated: bool) -> Translation:
    """Return what another engine is asked.

    Raises
    ------
    CapabilityError : with all that the other engine cannot be asked.
    """
    problem = Problem(scene)
    refused = list(_refused(problem, simulated))
    if refused:
        raise CapabilityError("not for another engine: " + "; ".join(refused))
    model = build_model(dataclasses.replace(scene, robot=_complete(scene)))
    bare = dataclasses.replace(
        problem.model,
        bodies=tuple(
            dataclasses.replace(body, forces=tuple(f for f in body.forces if not _is_plain(f)))
            for body in problem.model.bodies
        ),
    )
    own = [f"{force.kind} of {force.name}" for force in _plain_forces(model)]
    given = [f"{force.kind} of {force.name}" for body in bare.bodies for force in body.forces]
    given += [f"force {force.name}" for force in bare.forces]
    if simulated:
        given += [f"torque of {name}" for name in scene.torques]
    return Translation(scene, model, tuple(given), tuple(own), Problem(scene, model=bare))


def _refused(problem: Problem, simulated: bool) -> Iterator[str]:
    """Yield what makes a comparison impossible."""
    scene, model = problem.scene, problem.model
    if scene.couplers:
        yield f"couplers ({', '.join(coupler.name for coupler in scene.couplers)})"
    if scene.prescribed and simulated:
        yield "prescribed motion"
    if scene.control is not None and simulated:
        yield "a controller"
    if model.loops and not simulated:
        yield "inverse dynamics of loops, whose load sharing is a choice (simulate compares loops)"
    for loop in model.loops:
        if loop.element.type not in CLOSURES:
            yield f"closure {loop.name!r} of type {loop.element.type} (allowed: {', '.join(CLOSURES)})"
    changing = [payload.name for payload in scene.payloads if payload.changes]
    if changing:
        yield f"masses that are gripped or released ({', '.join(changing)})"
    if simulated and problem.contact_joints:
        yield f"sticking friction and rigid stops ({', '.join(joint.name for joint in problem.contact_joints)})"


def _plain_forces(model: Model) -> list[JointForce]:
    return [force for body in model.bodies for force in body.forces if _is_plain(force)]


def _is_plain(force: JointForce) -> bool:
    """Tell whether a force in a joint is linear in one coordinate."""
    element = force.element
    linear = isinstance(element, (Spring, Damper)) or (isinstance(element, Friction) and not element.dry)
    return linear and not force.in_space


def _complete(scene: Scene) -> Robot:
    """Return the robot with numbers in place of data that are not given."""
    links = tuple(_completed(link) for link in scene.robot.links)
    return dataclasses.replace(scene.robot, links=links)


def _completed(link: Link) -> Link:
    """Return a link with all numbers; no result depends on those that are made up."""
    given = link.inertia
    moments = [x for x in (given.xx, given.yy, given.zz) if x is not None]
    mass = 0.0 if link.mass is None else link.mass
    usual = max(moments) if moments else 1e-3 * mass
    filled = {
        name: (usual if name in ("xx", "yy", "zz") else 0.0)
        if getattr(given, name) is None
        else getattr(given, name)
        for name in ("xx", "yy", "zz", "xy", "xz", "yz")
    }
    if mass == 0.0 and not moments:
        filled = {name: x or 0.0 for name, x in filled.items()}
    return dataclasses.replace(link, mass=mass, com=link.com or (0.0, 0.0, 0.0), inertia=Inertia(**filled))
