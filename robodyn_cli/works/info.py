"""A scene at one state: its tree, its frames, the matrices of its equations."""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from robodyn_cli.algorithms.composite import coriolis, crba
from robodyn_cli.algorithms.kinematics import world_jacobian, world_pose
from robodyn_cli.algorithms.rnea import rnea
from robodyn_cli.expr.graph import Expr
from robodyn_cli.expr.rebuild import Values
from robodyn_cli.joints.registry import joint_types
from robodyn_cli.model.model import BASE, Model
from robodyn_cli.model.parts import carried_at_start
from robodyn_cli.observe.places import quaternions
from robodyn_cli.observe.units import joint_columns
from robodyn_cli.ready.prepare import Setup, prepare
from robodyn_cli.results.result import Result
from robodyn_cli.scene.load import load_scene
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array, Transform
from robodyn_cli.spatial.inertia import RigidInertia
from robodyn_cli.summaries.facts import ABSENT
from robodyn_cli.summaries.mechanism import (
    ConstraintsAt,
    FrameAt,
    InfoJoint,
    InfoLink,
    InfoReport,
    InfoState,
    PointAt,
)
from robodyn_cli.works.state_text import state_overrides

LIGHT = 1e-6  # of the mass of all links


@np.errstate(all="ignore")  # the report shows numbers without a value as NaN
def info(path: Path, overrides: Sequence[str] = (), at: Sequence[str] = ()) -> Result:
    """Return the report of a scene at a state as the summary of a result, which holds that one sample to draw.

    The state is the initial one unless ``at`` gives another; joints of an open chain without a position are at 0,
    loops are closed. Numbers that depend on data which the scene does not give are None.

    Raises
    ------
    SceneError : the scene or the state cannot be read. Others as in ``prepare``.
    """
    numbers = InfoNumbers(prepare(scene_at(path, overrides, at)))
    result = numbers.drawing()
    result.summarise(numbers.report())
    return result


def scene_at(path: Path, overrides: Sequence[str], at: Sequence[str]) -> Scene:
    """Return the scene with the state of ``at``, and all joints of an open chain somewhere."""
    scene = load_scene(path, list(overrides))
    changes = changes_at(scene, overrides, at)
    if not changes:
        return scene
    return load_scene(path, changes)


def changes_at(scene: Scene, overrides: Sequence[str], at: Sequence[str]) -> list[str]:
    """Return the ``--set`` texts that give a scene the state of ``at``, and all joints of an open chain a position."""
    changes = [*overrides, *state_overrides(scene, at)]
    if not scene.loops and not scene.couplers:
        given = {name.partition(".")[0] for name in (*scene.initial.q, *scene.prescribed)}
        changes = [*(f"initial.q.{x}" for x in _neutral(scene, given)), *changes]
    return changes


def _neutral(scene: Scene, given: set[str]) -> Iterable[str]:
    """Return ``NAME=value`` for the joints that have no position."""
    for joint in scene.robot.joints:
        kind = joint_types[joint.type]
        if kind.nv and joint.name not in given:
            yield f"{joint.name}={kind.neutral() if kind.names else 0}"


class InfoNumbers:
    """A scene's equations at its initial state."""

    def __init__(self, setup: Setup) -> None:
        self.problem = setup.problem
        self.q, self.v = setup.assembled.q, setup.assembled.v
        still = [0.0] * len(self.v)
        carried = carried_at_start(self.problem.model)
        # without data that are missing: what depends on them has no value
        self.values = Values(
            {"t": [0.0], "q": self.q.tolist(), "v": self.v.tolist(), "a": still, "p": carried}
        )

    def array(self, entries: Any) -> Array:
        """Return the values of expressions; NaN where data are missing."""
        with contextlib.suppress(TypeError):  # of an expression, which is no number
            return np.array(entries, dtype=float)
        entries = np.asarray(entries, dtype=object)
        numbers = [math.nan if x is None else x for x in self.values.of(list(entries.ravel()))]
        return np.array(numbers, dtype=float).reshape(entries.shape)

    def bodies(self) -> Model:
        """Return the bodies with plain numbers, which the algorithms take far quicker than expressions; missing data
        stay symbols."""
        rigid = self.problem.rigid
        inertias = [
            RigidInertia(*(plain(x) for x in (b.inertia.m, b.inertia.h, b.inertia.I))) for b in rigid.bodies
        ]
        bodies = [dataclasses.replace(b, inertia=I) for b, I in zip(rigid.bodies, inertias)]
        return dataclasses.replace(rigid, bodies=tuple(bodies))

    def report(self) -> InfoReport:
        """Return the report of the state."""
        problem = self.problem
        scene, model = problem.scene, problem.model
        bodies = self.bodies()
        X = [Transform(plain(self.array(x.E)), plain(self.array(x.r))) for x in problem.X]
        M = self.array(crba(bodies, self.q, X))
        sigma = singular_values(M)
        g, rest = problem.gravity, [0.0] * model.nv
        held = rest if g is None else rnea(bodies, self.q, rest, rest, plain(g), X)
        return InfoReport(
            joints=_joints(scene),
            links=_links(scene),
            light_links=_light(scene, model),
            state=InfoState(_named(model.q_names, self.q), _named(model.v_names, self.v)),
            mass_matrix=M.tolist(),
            mass_matrix_singular_values=sigma,
            mass_matrix_condition=condition(sigma),
            coriolis_matrix=self.coriolis(bodies, X).tolist(),
            gravity_torques=_named(model.v_names, self.array(held)),
            frames=self.frames(),
            points=self.points(),
            constraints=self.constraints() if problem.constraints.rows else ABSENT,
        )

    def coriolis(self, bodies: Model, X: Sequence[Transform]) -> Array:
        """Return C, which is linear in qd: at rest zero, which the n^2 entries of a long chain need not find out."""
        if not self.v.any():
            return np.zeros((len(self.v), len(self.v)))
        return self.array(coriolis(bodies, self.q, self.v, X))

    def frames(self) -> dict[str, FrameAt]:
        """Return the frames of links and the named frames."""
        problem = self.problem
        frames = {}
        for name, frame in {**problem.model.links, **problem.model.frames}.items():
            pose = world_pose(problem.model, problem.pose, frame)
            R = self.array(pose.R)
            frames[name] = FrameAt(self.array(pose.p).tolist(), R.tolist(), quaternions(R[None])[0].tolist())
        return frames

    def points(self) -> dict[str, PointAt]:
        """Return the named points."""
        problem = self.problem
        model = problem.model
        points = {}
        for name, frame in model.points.items():
            J, W = (self.array(x) for x in world_jacobian(model, problem.q, problem.pose, frame))
            position = self.array(problem.world_point(frame))
            at, velocity = position.tolist(), (J @ self.v).tolist()
            points[name] = PointAt(at, velocity, J.tolist(), W.tolist(), singular_values(J))
        return points

    def constraints(self) -> ConstraintsAt:
        """Return Psi of all rows."""
        psi = self.array(self.problem.psi)
        return ConstraintsAt(list(self.problem.constraints.names), psi.tolist(), singular_values(psi))

    def drawing(self) -> Result:
        """Return the state as a result of one sample, to draw."""
        problem = self.problem
        result = Result.of("info", problem.scene)
        if not problem.scene.payloads:  # which drawings take as they are carried at first
            result.problem = problem
        result.add("time", np.zeros(1))
        columns = joint_columns(problem.model)
        for path, values in (("q", self.q), ("qd", self.v)):
            result.add(path, values[None], long_name=path, **columns[path].described())
        for name, frame in problem.model.points.items():
            result.add(f"points/{name}", self.array(problem.world_point(frame))[None])
        return result


def plain(entries: Any) -> Any:
    """Return numbers as plain floats, in an array or alone; expressions stay as they are."""
    array = np.asarray(entries, dtype=object)
    numbers = np.array([x if isinstance(x, Expr) else float(x) for x in array.ravel()], dtype=object)
    return numbers.reshape(array.shape) if array.shape else numbers[0]


def _joints(scene: Scene) -> list[InfoJoint]:
    motors = scene.actuated
    return [
        InfoJoint(
            j.name, j.type, j.parent, j.link, j.gear_ratio, None if motors is None else j.name in motors
        )
        for j in scene.robot.joints
    ]


def _links(scene: Scene) -> dict[str, InfoLink]:
    found = {}
    for link in scene.robot.links:
        com = None if link.com is None else list(link.com)
        inertia = {k: getattr(link.inertia, k) for k in ("xx", "yy", "zz", "xy", "xz", "yz")}
        found[link.name] = InfoLink(link.mass, com, link.com_frame, inertia)
    return found


def _light(scene: Scene, model: Model) -> list[str]:
    """Return the links off the ground that weigh next to nothing beside the others."""
    masses = {link.name: link.mass for link in scene.robot.links if link.mass is not None}
    least = LIGHT * sum(masses.values())
    return [name for name, mass in masses.items() if mass <= least and model.links[name].body != BASE]


def condition(sigma: list[float] | None) -> float | None:
    """Return the largest of singular values over the smallest; None where there is none."""
    return sigma[0] / sigma[-1] if sigma and sigma[-1] > 0.0 else None


def _named(names: Sequence[str], values: Array) -> dict[str, float]:
    return dict(zip(names, values.tolist()))


def singular_values(matrix: Array) -> list[float] | None:
    """Return the singular values, largest first; None where data are missing."""
    if not np.all(np.isfinite(matrix)):
        return None
    sigma: list[float] = np.linalg.svd(matrix, compute_uv=False).tolist()
    return sigma


def tree(joints: Sequence[dict[str, Any]], links: dict[str, Any]) -> list[str]:
    """Return the kinematic tree as lines of text."""
    children: dict[str, list[dict[str, Any]]] = {}
    for joint in joints:
        children.setdefault(str(joint["parent"]), []).append(joint)
    lines = ["base"]
    stack = [(joint, "", k == 0) for k, joint in enumerate(reversed(children.get("base", [])))][::-1]
    while stack:
        joint, indent, last = stack.pop(0)
        mass = links[joint["link"]]["mass"]
        weight = "mass not given" if mass is None else f"{mass:g} kg"
        branch = "`-- " if last else "|-- "
        kind = joint["type"] + (", motor" if joint["actuated"] else "")
        lines.append(f"{indent}{branch}{joint['name']} ({kind}) -> {joint['link']}, {weight}")
        below = children.get(str(joint["link"]), [])
        deeper = indent + ("    " if last else "|   ")
        stack = [(child, deeper, k == len(below) - 1) for k, child in enumerate(below)] + stack
    return lines
