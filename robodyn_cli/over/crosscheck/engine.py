"""Another engine: what of a scene it computes, what it has to answer, and the equations of motion from its answers.

Arrays are in our order of coordinates, and in our coordinates: quaternions scalar first, velocities of ball joints and
free bodies in the body's axes.
"""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.rebuild import Evaluator
from robodyn_cli.forces.friction import Friction
from robodyn_cli.forces.springs import Damper, Spring
from robodyn_cli.model.build import build_model
from robodyn_cli.model.model import BASE, Body, FixedFrame, JointForce, Loop, Model
from robodyn_cli.over.export.scene import filled
from robodyn_cli.record import record
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.load_sharing import accelerations
from robodyn_cli.spatial.algebra import Array, cross

MISSING = "{} is not installed: pip install 'robodyn[oracle]'"


@record
class PeerPlaces:
    """Frames (F) of the engine, all in base axes.

    p (F, 3) : position. R (F, 3, 3) : axes. J (F, 6, nv) : Jacobian, angular rows first. a (F, 6) : acceleration with
    v-dot = 0. w (F, 3) : angular velocity.
    """

    p: Array
    R: Array
    J: Array
    a: Array
    w: Array


class PeerEngine(ABC):
    """A mechanism in another engine.

    name, version : of the engine. size : nv. q_places, v_places : of its coordinates among ours.
    """

    name: str
    version: str

    def __init__(self, model: Model) -> None:
        self.size = model.nv
        self.q_places, self.v_places = np.zeros(model.nq, dtype=int), np.zeros(model.nv, dtype=int)

    @abstractmethod
    def torques(self, q: Array, v: Array, a: Array) -> Array:
        """Return M a + h (nv,), rotors included."""

    @abstractmethod
    def free_accelerations(self, q: Array, v: Array, tau: Array) -> Array:
        """Return the accelerations (nv,) of the open tree under torques tau (nv,)."""

    @abstractmethod
    def bring(self, q: Array, v: Array) -> None:
        """Bring the mechanism to a state, of which ``mass_matrix`` and ``places`` are then."""

    @abstractmethod
    def mass_matrix(self) -> Array:
        """Return M (nv, nv), rotors included."""

    @abstractmethod
    def places(self, frames: Sequence[FixedFrame]) -> PeerPlaces:
        """Return frames fixed to bodies."""

    def in_our_order(self, x: Array) -> Array:
        """Return an array whose last axis is in the engine's order of velocities in ours."""
        out = np.empty_like(x)
        out[..., self.v_places] = x
        return out

    def accelerations(
        self,
        state: tuple[Array, Array, Array],
        closures: Sequence[PeerClosure],
        couplers: Array,
        tolerance: float,
    ) -> Array:
        """Return the accelerations (nv,) at a state (q, v, tau) with closed loops: M a = tau - h + Psi^T lambda,
        Psi a + gamma = 0.

        M, h, Psi and gamma are the engine's, the solution is numpy's; the opened tree's M may be singular. couplers :
        rows (c, nv) of Psi whose gamma is zero. tolerance : ratio of singular values below which rows depend on each
        other.
        """
        q, v, tau = state
        if not closures and not len(couplers):
            return self.free_accelerations(q, v, tau)
        self.bring(q, v)
        psi, gamma = self._rows(closures)
        psi = np.concatenate([psi, couplers])
        gamma = np.concatenate([gamma, np.zeros(len(couplers))])
        M = self.mass_matrix()
        force = tau - self.torques(q, v, np.zeros_like(v))
        return np.asarray(accelerations(M[None], force[None], psi[None], gamma[None], tolerance)[0])

    def _rows(self, closures: Sequence[PeerClosure]) -> tuple[Array, Array]:
        """Return Psi (m, nv) and gamma (m,) of closures: equal points, and no turning about some directions."""
        if not closures:
            return np.zeros((0, self.size)), np.zeros(0)
        count = len(closures)
        at = self.places([*(one.first for one in closures), *(one.second for one in closures)])
        J, a, w = (x[count:] - x[:count] for x in (at.J, at.a, at.w))
        psi, gamma = [J[:, 3:].reshape(-1, self.size)], [a[:, 3:].ravel()]
        for k, closure in enumerate(closures):
            if len(closure.directions):
                u = closure.directions @ at.R[k].T
                psi.append(u @ J[k, :3])
                gamma.append(u @ a[k, :3] + w[k] @ cross(at.w[k], u.T))
        return np.concatenate(psi), np.concatenate(gamma)


@record
class PeerClosure:
    """A closure of a loop: its frames, and the directions (n, 3), in the axes of the first, about which nothing
    turns."""

    first: FixedFrame
    second: FixedFrame
    directions: Array


def closures_of(model: Model) -> list[PeerClosure]:
    """Return the closures of a model's loops, with frames of floats."""
    return [
        PeerClosure(_in_floats(loop.first), _in_floats(loop.second), _directions(loop))
        for loop in model.loops
    ]


def _in_floats(frame: FixedFrame) -> FixedFrame:
    return dataclasses.replace(frame, p=real(frame.p), R=real(frame.R))


def _directions(loop: Loop) -> Array:
    kind = loop.element.type
    if kind == "spherical":
        return np.zeros((0, 3))
    if kind == "fixed":
        return np.eye(3)
    axis = np.array(loop.element.axis, dtype=float)
    return np.linalg.svd(axis[None])[2][1:]


CLOSURES = ("revolute", "spherical", "fixed")


def mass_properties(body: Body) -> tuple[float, Array, Array]:
    """Return mass [kg], centre of mass [m] and inertia about it [kg m^2], body axes."""
    m, h, I = float(body.inertia.m), real(body.inertia.h), real(body.inertia.I)
    if m == 0.0:
        return 0.0, np.zeros(3), I
    c = h / m
    return m, c, I - m * (c @ c * np.eye(3) - np.outer(c, c))


def real(x: Any) -> Array:
    """Return numbers as an array of floats."""
    return np.array(x, dtype=float)


def children(model: Model) -> dict[int, list[int]]:
    """Return the bodies that hang on each body, and on the base."""
    below: dict[int, list[int]] = {k: [] for k in range(BASE, len(model.bodies))}
    for k, body in enumerate(model.bodies):
        below[body.parent].append(k)
    return below


def depth_first(model: Model) -> list[int]:
    """Return the bodies so that each subtree is contiguous."""
    below = children(model)
    order, stack = [], [BASE]
    while stack:
        k = stack.pop()
        order.append(k)
        stack.extend(reversed(below[k]))
    return order[1:]


def refuse_joint(engine: str, body: Body, known: Sequence[str]) -> CapabilityError:
    """Return the error of a joint that an engine has no counterpart for."""
    return CapabilityError(
        f"joint {body.joint_name!r} is {body.joint.type}, which is not built in {engine}; allowed: {', '.join(known)}"
    )


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

    @cached_property
    def _plain_forces(self) -> list[JointForce]:
        return _plain_forces(self.model)

    def plain(self, q: Array, v: Array) -> Array:
        """Return the torques (nv,) of springs -k (q - q0), dampers -c q-dot and viscous friction -N^2 b q-dot."""
        tau = np.zeros(self.model.nv)
        for force in self._plain_forces:
            element = force.element
            if isinstance(element, Spring):
                tau[force.v] -= float(element.stiffness) * (q[force.q] - float(element.rest))
            elif isinstance(element, Damper):
                tau[force.v] -= float(element.damping) * v[force.v]
            elif isinstance(element, Friction):
                ratio = float(force.gear_ratio) ** 2 if element.side == "motor" else 1.0
                tau[force.v] -= ratio * float(element.viscous) * v[force.v]
        return tau

    @property
    def couplers(self) -> Array:
        """Return the rows (c, nv) of Psi that are those of couplers."""
        rows = np.zeros((len(self.scene.couplers), self.model.nv))
        for row, coupler in zip(rows, self.scene.couplers):
            for name, x in coupler.terms.items():
                row[self.model.body_of(name).v] = float(x)
        return rows

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
    model = build_model(dataclasses.replace(scene, robot=filled(scene)))
    bare = dataclasses.replace(
        problem.model,
        bodies=tuple(
            dataclasses.replace(body, forces=tuple(f for f in body.forces if not is_plain(f)))
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
    moving = [one.name for one in scene.couplers if one.value is not None and "t" in one.value.names]
    if moving:
        yield f"couplers whose value changes in time ({', '.join(moving)})"
    if scene.prescribed and simulated:
        yield "prescribed motion"
    if scene.control is not None and simulated:
        yield "a controller"
    if model.closures and not simulated:
        yield "inverse dynamics of loops and couplers, whose load sharing is a choice (simulate compares loops)"
    for loop in model.loops:
        if loop.element.type not in CLOSURES:
            yield f"closure {loop.name!r} of type {loop.element.type} (allowed: {', '.join(CLOSURES)})"
    changing = [payload.name for payload in scene.payloads if payload.changes]
    if changing:
        yield f"masses that are gripped or released ({', '.join(changing)})"
    if simulated and problem.contact_joints:
        yield f"sticking friction and rigid stops ({', '.join(joint.name for joint in problem.contact_joints)})"


def _plain_forces(model: Model) -> list[JointForce]:
    return [force for body in model.bodies for force in body.forces if is_plain(force)]


def is_plain(force: JointForce) -> bool:
    """Tell whether a force in a joint is linear in one coordinate."""
    element = force.element
    linear = isinstance(element, (Spring, Damper)) or (isinstance(element, Friction) and not element.dry)
    return linear and not force.in_space
