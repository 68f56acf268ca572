"""What the equations of motion of a scene consist of: the entries of M, C, G, forces and constraints, from the graph
that the program's kernels are made of."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from robodyn_cli.equations.gears import geared
from robodyn_cli.equations.payloads import switched_problem
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.graph import is_nonzero
from robodyn_cli.ready.integrable import integrable
from robodyn_cli.record import record
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array, Vector, zeros

FORCES = {
    "passive": "springs and dampers",
    "friction": "friction",
    "stops": "stops of joints",
    "external": "forces and torques on bodies",
    "gear": "losses of gears",
}


@record
class MotionTerm:
    """One matrix or vector of the equations.

    name : in Python. entries : of the graph (rows, columns) or (rows,). rows : what its rows belong to.
    """

    name: str
    meaning: str
    entries: Array
    rows: tuple[str, ...]


@record
class Terms:
    """The equations of motion: problem, terms by their order, velocity indices of torques that stay unknown, notes
    about what is not part."""

    problem: Problem
    terms: tuple[MotionTerm, ...]
    asked: tuple[int, ...]
    notes: tuple[str, ...]

    @property
    def quasi(self) -> bool:
        """Whether rates are not those of the coordinates, as in ball joints."""
        return any(body.joint.quasi for body in self.problem.model.bodies)

    def has(self, name: str) -> bool:
        return any(term.name == name for term in self.terms)

    @property
    def forces(self) -> list[str]:
        """The kinds of forces that act."""
        return [name for name in FORCES if self.has(f"F_{name}")]


def terms_of(scene: Scene) -> Terms:
    """Return the terms of a scene's equations of motion.

    Raises
    ------
    SceneError : no joint of the robot moves. RobodynError : what finding prescribed motions raises.
    """
    notes = list(_notes(scene))
    ready = integrable(dataclasses.replace(scene, control=None))
    changes = any(payload.changes for payload in scene.payloads)
    problem = switched_problem(ready) if changes else Problem(ready)
    asked = tuple(k for k, name in enumerate(problem.model.v_names) if _is_asked(scene, name))
    notes += [
        f"joint {joint.name}: {_held(joint)} by events, which no equation of a state has"
        for joint in problem.contact_joints
    ]
    terms = [*_rigid(problem), *_torques(problem, scene.trajectory is not None, notes)]
    return Terms(problem, (*terms, *_constraints(problem)), asked, tuple(notes))


def _is_asked(scene: Scene, name: str) -> bool:
    """Tell whether the torque of a coordinate is an actuator's and the scene does not say what it is."""
    joint = name.partition(".")[0]
    if {joint, name} & {*scene.torques, *scene.prescribed}:
        return False
    listed = scene.control.joints if scene.control is not None and scene.control.joints else scene.actuated
    if listed is None:
        return scene.control is not None or not (scene.loops or scene.couplers)
    return bool({joint, name} & set(listed))


def _notes(scene: Scene) -> Iterator[str]:
    """Yield what acts in the scene and is no part of its equations."""
    if scene.control is not None:
        yield f"the controller ({scene.control.type}): the torques of its joints are symbols"
    if scene.deploy.latch is not None:
        yield "the latch: it closes at an event; the equations are those before"
    if scene.deploy.latches:
        names = ", ".join(latch.name for latch in scene.deploy.latches)
        yield f"latches ({names}): they close at events; the equations are those while all are open"
    if any(drive.brake for drive in scene.drives.values()):
        yield "brakes of drives: they hold by events"


def _held(joint: Any) -> str:
    friction = joint.friction is not None
    return "sticking holds it" if friction and joint.limits is None else (
        "sticking and rigid stops hold it" if friction else "a rigid stop holds it"
    )  # fmt: skip


def _rigid(p: Problem) -> Iterator[MotionTerm]:
    names = p.model.v_names
    yield MotionTerm("M", "mass matrix, symmetric", p.tree_mass_matrix, names)
    rigid = p.rigid_terms()
    for name, own, meaning in (
        ("C", "coriolis", "centrifugal and Coriolis torques"),
        ("G", "gravity", "gravity"),
    ):
        if any(is_nonzero(x) for x in rigid.get(own, ())):
            yield MotionTerm(name, meaning, rigid[own], names)


def _torques(p: Problem, given: bool, notes: list[str]) -> Iterator[MotionTerm]:
    """Yield torques that the scene gives, and what else acts in joints and on bodies, with friction as it slides.

    given : whether the motion is given; then friction has the exact sign of the rate and losses of gears are those of
    the load, else those that a simulation uses.
    """
    names = p.model.v_names
    if p.scene.torques:
        yield MotionTerm("tau", "torques that the scene gives", p.actuator_torques, names)
    if geared(p.model) and (not given or p.model.closures):
        notes.append("losses of gears: they follow from the load, or from the torque of the drive")
    forces = _forces(p, given)
    for name, meaning in FORCES.items():
        if name == "gear" and (not given or p.model.closures):
            continue
        entries = forces.get(name, zeros(p.model.nv))
        if any(is_nonzero(x) for x in entries):
            yield MotionTerm(f"F_{name}", meaning, entries, names)


def _forces(p: Problem, given: bool) -> dict[str, Vector]:
    if not given:
        try:
            return p.passive_forces(smooth=True)
        except CapabilityError:  # the scene does not say how a simulation smooths friction
            pass
    return p.passive_forces(smooth=False)


def _constraints(p: Problem) -> Iterator[MotionTerm]:
    rows = p.constraints
    quasi = [body for body in p.model.bodies if body.joint.quasi]
    if quasi:
        rates = _rates(p)
        yield MotionTerm("qdot", "rates of the coordinates", rates, p.model.q_names)
    if not rows.rows:
        return
    yield MotionTerm("eta", "constraints, zero where they hold", _vector(rows.eta), rows.names)
    yield MotionTerm("Psi", "Jacobian of the constraints", p.psi, rows.names)
    if any(is_nonzero(x) for x in rows.eta_t):
        yield MotionTerm("eta_t", "rates of the constraints at rest", _vector(rows.eta_t), rows.names)
    yield MotionTerm("gamma", "second rates of the constraints without accelerations", _vector(rows.gamma),
               rows.names)  # fmt: skip


def _rates(p: Problem) -> Array:
    """Return q-dot (nq,)."""
    out: list[Any] = []
    for body in p.model.bodies:
        joint = body.joint
        q, v = (np.array(list(x), dtype=object) for x in (p.q[body.q : body.q + joint.nq],
                                                            p.v[body.v : body.v + joint.nv]))  # fmt: skip
        out += list(joint.velocity_map(q, v))
    return _vector(out)


def _vector(entries: Sequence[Any]) -> Array:
    return np.array(list(entries), dtype=object)
