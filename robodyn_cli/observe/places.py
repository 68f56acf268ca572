"""Where points, frames and outlines of links are along a motion."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from robodyn_cli.algorithms.kinematics import motions, poses, transforms, velocities, world_pose
from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.model.model import BASE, FixedFrame, Model
from robodyn_cli.results.result import Result
from robodyn_cli.spatial.algebra import Array, cross

FORCES = ("forces/potential", "forces/power")  # datasets with a column for each force element


def place_outputs(problem: Problem) -> dict[str, list[Scalar]]:
    """Return the expressions of all named points, frames and outlines in world coordinates, by result path.

    For a frame: position (3), rotation (9, row by row) and twist (6: angular velocity, velocity of its
    origin).
    """
    model = problem.model
    out: dict[str, list[Scalar]] = {}
    for name, frame in model.points.items():
        out[f"points/{name}"] = list(problem.world_point(frame))
    for name, outline in model.outlines.items():
        out[f"skeleton/{name}"] = [x for corner in outline for x in problem.world_point(corner)]
    if model.frames:
        moving = velocities(model, problem.X, problem.q, problem.v)
    for name, frame in model.frames.items():
        pose = world_pose(model, problem.pose, frame)
        to_world = model.base.E.T @ problem.pose[frame.body].R
        body = moving[frame.body]
        out[f"frames/{name}/position"] = list(pose.p)
        out[f"frames/{name}/rotation"] = list(pose.R.flat)
        out[f"frames/{name}/twist"] = [*(to_world @ body.w), *(to_world @ (body.v + cross(body.w, frame.p)))]
    return out


def in_world(
    model: Model, reference: FixedFrame | None, p: Array, R: Array | None, q: Array
) -> tuple[Array, Array | None]:
    """Return a point's places p (T, 2 or 3), and axes R (T, 3, 3) if there are any, in the world.

    They are given in those of ``reference``, which is where the positions q (T, nq) say; None: in the world's.
    """
    if reference is None:
        return p, R
    from robodyn_cli.observe.evaluation import SampleFunction

    symbols = model.graph.symbols(model.q_names, "q")
    pose = world_pose(model, poses(model, transforms(model, symbols)), reference)
    values = SampleFunction({"p": list(pose.p), "R": list(pose.R.flat)}, ("q",), len(q))(q=q)
    axes = values["R"].reshape(-1, 3, 3)
    return values["p"] + np.einsum("tij,tj->ti", axes, p), None if R is None else axes @ R


def point_motion(problem: Problem) -> dict[str, list[Scalar]]:
    """Return velocities and accelerations of the named points in world coordinates, by result path."""
    model = problem.model
    speed = velocities(model, problem.X, problem.q, problem.v)
    motion = motions(model, problem.X, problem.q, problem.v, problem.a)
    out: dict[str, list[Scalar]] = {}
    for name, frame in model.points.items():
        if frame.body == BASE:
            continue
        to_world = model.base.E.T @ problem.pose[frame.body].R
        here = speed[frame.body]
        out[f"point_velocities/{name}"] = list(to_world @ (here.v + cross(here.w, frame.p)))
        out[f"point_accelerations/{name}"] = list(to_world @ motion[frame.body].acceleration_of(frame.p))
    return out


def place_dataset(path: str, array: Array) -> tuple[str, Array]:
    """Return the path and the array of the dataset that an output of ``place_outputs`` becomes."""
    if path.startswith("skeleton/"):
        return path, array.reshape(len(array), -1, 3)
    if path.startswith("frames/") and path.endswith("/rotation"):
        return path.removesuffix("rotation") + "quaternion", quaternions(array.reshape(-1, 3, 3))
    return path, array


def add_places(result: Result, arrays: Mapping[str, Array]) -> None:
    """Add the outputs of ``place_outputs``, evaluated at T samples, to a result."""
    for path, array in arrays.items():
        name, data = place_dataset(path, array)
        result.add(name, data)


def quaternions(R: Array) -> Array:
    """Return unit quaternions (T, 4), scalar first, of rotations (T, 3, 3), without jumps of sign along T.

    The largest of the four components is taken from the diagonal, the others from it (Shepperd 1978).
    """
    diagonal = np.diagonal(R, axis1=1, axis2=2)
    trace = diagonal.sum(axis=1)
    # 4 w^2, 4 x^2, 4 y^2, 4 z^2
    squares = np.concatenate([trace[:, None], 2.0 * diagonal - trace[:, None]], axis=1) + 1.0
    products = np.zeros((len(R), 4, 4))  # 4 times each product of two components
    products[:, range(4), range(4)] = squares
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        products[:, 0, i + 1] = products[:, i + 1, 0] = R[:, k, j] - R[:, j, k]
        products[:, j + 1, k + 1] = products[:, k + 1, j + 1] = R[:, k, j] + R[:, j, k]
    rows = products[np.arange(len(R)), np.argmax(squares, axis=1)]
    q = rows / np.linalg.norm(rows, axis=1)[:, None]
    if q[0, 0] < 0.0:
        q[0] = -q[0]
    agree = np.einsum("ti,ti->t", q[1:], q[:-1])
    q[1:] *= np.cumprod(np.where(agree < 0.0, -1.0, 1.0))[:, None]
    return q
