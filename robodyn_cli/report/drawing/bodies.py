"""Bodies of a drawing one by one: mass, pose, velocity and what acts on each, for those who point at one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from robodyn_cli.algorithms.kinematics import velocities, world_pose
from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.expr.rebuild import Interpreter
from robodyn_cli.model.model import Body, FixedFrame
from robodyn_cli.record import record
from robodyn_cli.report.drawing.build import problem_of
from robodyn_cli.report.drawing.parts import numbers
from robodyn_cli.report.drawing.places import KNOWN, KnownNodes
from robodyn_cli.report.lines import finite
from robodyn_cli.results.result import Result, column_names, units_of
from robodyn_cli.spatial.algebra import Array, cross


@record
class TracedBody:
    """A moving link at T instants.

    tracks : (T, 13) in the world: origin of the link's frame [m], its attitude as (w, x, y, z), the velocity [m/s] of
    the centre of mass, or of the origin where that is not known, angular velocity [rad/s]; velocities are not a number
    where the result has none. mass : [kg], None where it is not known. centre : of mass (3,) in the link's frame [m],
    likewise. joint : that moves it. loads : names of joints, loops and forces that act on it. torque : of its joint,
    (T,) with its unit, None where the result has none.
    """

    name: str
    tracks: Array
    mass: float | None
    centre: Array | None
    joint: str
    loads: tuple[str, ...]
    torque: tuple[Array, str] | None


def traced_bodies(result: Result, samples: Array) -> list[TracedBody]:
    """Return the moving links of a result that can be drawn, at some of its samples; without those of unknown places.

    Raises
    ------
    CapabilityError : this version cannot read its scene.
    """
    problem = problem_of(result)
    model = problem.model
    q = result["q"][samples]
    moving = "qd" in result and result["qd"].shape[1] == model.nv
    v = result["qd"][samples] if moving else np.zeros((len(samples), model.nv))
    known, found, entries = KnownNodes(KNOWN), [], []
    for k, body in enumerate(model.bodies):
        centre = _centre(body, model.links[body.name])
        own = _expressions(problem, k, model.links[body.name], centre)
        if known(own):
            found.append((k, body, centre))
            entries += own
    with np.errstate(all="ignore"):
        values = Interpreter(entries)({"t": result.time[samples][None, :], "q": q.T, "v": v.T})
    table = (
        np.stack([np.broadcast_to(x, (len(samples),)) for x in values], axis=1)
        if values
        else np.empty((0, 0))
    )
    width = len(entries) // max(1, len(found))
    bodies = []
    for place, (k, body, centre) in enumerate(found):
        tracks = _tracks(finite(table[:, place * width : (place + 1) * width]), moving)
        mass = _mass(body)
        torque = _torque(result, body.joint_name, samples)
        bodies.append(
            TracedBody(body.name, tracks, mass, centre, body.joint_name, tuple(_loads(problem, k)), torque)
        )
    return bodies


def _expressions(problem: Problem, k: int, frame: FixedFrame, centre: Array | None) -> list[Scalar]:
    """Return place (3), rotation (9, row by row), velocity (3) and angular velocity (3) of a link, in the world."""
    model = problem.model
    pose = world_pose(model, problem.pose, frame)
    body = velocities(model, problem.X, problem.q, problem.v)[k]
    to_world = model.base.E.T @ problem.pose[k].R
    at = frame.p if centre is None else frame.p + frame.R @ centre
    return [*pose.p, *pose.R.flat, *(to_world @ (body.v + cross(body.w, at))), *(to_world @ body.w)]


def _tracks(values: Array, moving: bool) -> Array:
    from scipy.spatial.transform import Rotation

    place, rotation, rates = values[:, :3], values[:, 3:12].reshape(-1, 3, 3), values[:, 12:]
    there = np.isfinite(rotation).all(axis=(1, 2))
    attitude = np.full((len(values), 4), np.nan)
    if there.any():
        attitude[there] = Rotation.from_matrix(rotation[there]).as_quat()[:, [3, 0, 1, 2]]
    return np.concatenate([place, attitude, rates if moving else np.full_like(rates, np.nan)], axis=1)


def _mass(body: Body) -> float | None:
    """Return the mass of a body with all that is fixed to it [kg]."""
    masses = [part.m for part in body.parts]
    return float(sum(masses)) if masses and numbers(masses) else None


def _centre(body: Body, frame: FixedFrame) -> Array | None:
    """Return the centre of mass (3,) of a body in the frame of its link."""
    masses = [part.m for part in body.parts]
    if not masses or not numbers(masses) or not sum(masses) > 0.0:
        return None
    heavy = [part for part in body.parts if part.m > 0.0]
    if not all(numbers(list(part.c)) for part in heavy):
        return None
    centre = sum(part.m * np.array(part.frame.point(part.c), dtype=float) for part in heavy) / sum(masses)
    R = np.array(frame.R, dtype=float)
    return np.asarray(R.T @ (centre - np.array(frame.p, dtype=float)))


def _loads(problem: Problem, k: int) -> Iterator[str]:
    """Yield what acts on a body: its joint, joints of bodies that it carries, loops and forces."""
    model = problem.model
    yield model.bodies[k].joint_name
    yield from (body.joint_name for body in model.bodies if body.parent == k)
    yield from (loop.name for loop in model.loops if k in (loop.first.body, loop.second.body))
    for force in model.forces:
        if any(end.body == k for end in force.ends):
            yield force.name


def _torque(result: Result, joint: str, samples: Array) -> tuple[Array, str] | None:
    variable: Any = result.variables.get("tau")
    names: Sequence[str] = [] if variable is None else column_names(variable)
    if joint not in names or variable.data.ndim != 2:
        return None
    column = list(names).index(joint)
    values = variable.data[samples, column]
    # joints without an actuator have a torque of 0
    return (values, units_of(variable)[column]) if np.any(values) else None
