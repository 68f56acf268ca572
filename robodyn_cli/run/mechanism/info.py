"""What a scene is at one state: its tree, its frames, the matrices of its equations."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.algorithms.coriolis import coriolis
from robodyn_cli.algorithms.kinematics import point_jacobian
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import SceneError, did_you_mean
from robodyn_cli.expr.graph import Expr, Scalar, free_symbols
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.joints.registry import joint_types
from robodyn_cli.model.model import UNKNOWN_GROUP
from robodyn_cli.results.result import Result
from robodyn_cli.run.driver.prepare import prepare
from robodyn_cli.run.observation.places import quaternions, world_pose
from robodyn_cli.scene.checks.robot import moving
from robodyn_cli.scene.load import load_scene
from robodyn_cli.scene.types import Scene

Array = NDArray[np.float64]
_KEY = re.compile(r"(?:^|,)\s*([A-Za-z_][\w.]*)\s*=")
FORMS = "allowed: q=[0.1, 0.2], qd=[0, 1], or joint by joint: q.theta1=30 deg, qd.theta1=1"


def state_overrides(scene: Scene, given: Sequence[str]) -> list[str]:
    """Return the ``--set`` texts of a state such as ``q=[0.1, 0.2], qd.theta1=1``.

    A list has the joints in their order; in a mechanism with loops the joints given are held where they are put.
    """
    joints = moving(scene.robot)
    found: dict[str, str] = {}
    for text in given:
        parts = _KEY.split(text)
        if len(parts) < 3 or parts[0].strip():
            raise SceneError(f"--at {text!r}: is no state; {FORMS}")
        for key, value in zip(parts[1::2], parts[2::2]):
            what, _, joint = key.partition(".")
            if what not in ("q", "qd"):
                what, joint = "q", key
            if joint:
                _known(joint, joints, text)
                found[f"{what}.{joint}"] = value.strip()
            else:
                found |= {f"{what}.{name}": item for name, item in _items(value.strip(), joints, text)}
    overrides = [f"initial.{key}={value}" for key, value in found.items()]
    held = [key.partition(".")[2] for key in found if key.startswith("q.")]
    if (scene.loops or scene.couplers) and held:
        # all of them would leave nothing to close the loops with
        overrides.append(f"initial.hold=[{', '.join(held if len(held) < len(joints) else [])}]")
    return overrides


def _known(joint: str, joints: Sequence[str], text: str) -> None:
    if joint not in joints:
        hint = did_you_mean(joint, joints)
        raise SceneError(f"--at {text!r}: unknown joint {joint!r}{hint}; allowed: {', '.join(joints)}")


def _items(value: str, joints: Sequence[str], text: str) -> Iterable[tuple[str, str]]:
    if not value.startswith("[") and len(joints) == 1:
        return [(joints[0], value)]
    if not (value.startswith("[") and value.endswith("]")):
        raise SceneError(f"--at {text!r}: {value!r} is no list; {FORMS}")
    # commas within brackets belong to the value of one joint
    items = [item.strip() for item in re.split(r",(?![^\[]*\]|[^{]*\})", value[1:-1])]
    if len(items) != len(joints):
        raise SceneError(
            f"--at {text!r}: {len(items)} values for {len(joints)} joints; needed: one each of {', '.join(joints)}"
        )
    return zip(joints, items)


def info(path: Path, overrides: Sequence[str] = (), at: Sequence[str] = ()) -> tuple[dict[str, Any], Result]:
    """Return what the scene is at a state, and a result of that one sample to draw.

    The state is the initial one unless ``at`` gives another; joints of an open chain without a position are at 0,
    loops are closed. Numbers that depend on data which the scene does not give are None.
    """
    scene = load_scene(path, list(overrides))
    changes = [*overrides, *state_overrides(scene, at)]
    if not scene.loops and not scene.couplers:
        given = {name.partition(".")[0] for name in (*scene.initial.q, *scene.prescribed)}
        changes = [*(f"initial.q.{x}" for x in _neutral(scene, given)), *changes]
    scene = _changed(path, changes, at) if changes else scene
    setup = prepare(scene, modes=True)
    return _Numbers(setup.problem, setup.assembled.q, setup.assembled.v).report()


def _changed(path: Path, changes: Sequence[str], at: Sequence[str]) -> Scene:
    try:
        return load_scene(path, changes)
    except SceneError as error:
        # the user wrote no --set for the state
        label, mark, message = error.message.partition(": initial.")
        if at and mark and label.startswith("--set initial."):
            raise SceneError(f"--at {', '.join(at)!r}: {message}", **error.details) from None
        raise


def _neutral(scene: Scene, given: set[str]) -> Iterable[str]:
    """Return ``NAME=value`` for the joints that have no position."""
    for joint in scene.robot.joints:
        kind = joint_types[joint.type]
        if kind.nv and joint.name not in given:
            yield f"{joint.name}={kind.neutral() if kind.names else 0}"


class _Numbers:
    def __init__(self, problem: Problem, q: Array, v: Array) -> None:
        self.problem = problem
        self.q, self.v = q, v
        self.state = {"t": [0.0], "q": q.tolist(), "v": v.tolist(), "a": [0.0] * len(v), "p": []}

    def array(self, entries: Any) -> Array:
        """Return the values of expressions; NaN where data are missing."""
        entries = np.asarray(entries, dtype=object)
        flat: list[Scalar] = list(entries.ravel())
        known = [k for k, e in enumerate(flat) if not self._unknown(e)]
        found = np.full(len(flat), math.nan)
        found[known] = np.array(evaluate([flat[k] for k in known], self.state), dtype=float)
        return found.reshape(entries.shape)

    @staticmethod
    def _unknown(entry: Scalar) -> bool:
        return isinstance(entry, Expr) and any(s.value[1] == UNKNOWN_GROUP for s in free_symbols([entry]))

    def report(self) -> tuple[dict[str, Any], Result]:
        problem = self.problem
        scene, model = problem.scene, problem.model
        M = self.array(problem.mass_matrix)
        terms = problem.rigid_terms()
        gravity = self.array(terms["gravity"]) if "gravity" in terms else np.zeros(model.nv)
        found: dict[str, Any] = {
            "title": scene.title,
            "joints": self._joints(),
            "links": self._links(),
            "state": {"q": _named(model.q_names, self.q), "qd": _named(model.v_names, self.v)},
            "mass_matrix": M,
            "mass_matrix_singular_values": singular_values(M),
            "coriolis_matrix": self.array(coriolis(model, problem.q, problem.v, problem.X)),
            "gravity_torques": _named(model.v_names, gravity),
            "frames": self._frames(),
            "points": self._points(),
        }
        if problem.constraints.rows:
            psi = self.array(problem.psi)
            found["constraints"] = {
                "rows": list(problem.constraints.names), "psi": psi, "singular_values": singular_values(psi),
            }  # fmt: skip
        return found, self._result()

    def _joints(self) -> list[dict[str, Any]]:
        return [
            {"name": j.name, "type": j.type, "parent": j.parent, "link": j.link, "gear_ratio": j.gear_ratio}
            for j in self.problem.scene.robot.joints
        ]

    def _links(self) -> dict[str, Any]:
        return {
            link.name: {"mass": link.mass, "com": link.com, "com_frame": link.com_frame,
                        "inertia": {k: getattr(link.inertia, k) for k in ("xx", "yy", "zz", "xy", "xz", "yz")}}
            for link in self.problem.scene.robot.links
        }  # fmt: skip

    def _frames(self) -> dict[str, Any]:
        problem = self.problem
        found = {}
        for name, frame in {**problem.model.links, **problem.model.frames}.items():
            pose = world_pose(problem.model, problem.pose, frame)
            R = self.array(pose.R)
            found[name] = {
                "position": self.array(pose.p),
                "rotation": R,
                "quaternion": quaternions(R[None])[0],
            }
        return found

    def _points(self) -> dict[str, Any]:
        """Return position, velocity and Jacobian of the named points, in world coordinates."""
        problem = self.problem
        model = problem.model
        found = {}
        for name, frame in model.points.items():
            p = problem.pose[frame.body].point(frame.p)
            linear, angular = point_jacobian(model, problem.q, problem.pose, frame.body, p)
            to_world = model.base.E.T
            J, W = self.array(to_world @ linear), self.array(to_world @ angular)
            found[name] = {
                "position": self.array(problem.world_point(frame)), "velocity": J @ self.v, "jacobian": J,
                "angular_jacobian": W, "singular_values": singular_values(J),
            }  # fmt: skip
        return found

    def _result(self) -> Result:
        problem = self.problem
        result = Result("info", problem.scene.title or "info", "ok", problem.scene.text)
        result.add("time", np.zeros(1))
        for name, outline in problem.model.outlines.items():
            corners = [self.array(problem.world_point(corner)) for corner in outline]
            result.add(f"skeleton/{name}", np.array(corners)[None])
        for name, frame in problem.model.points.items():
            result.add(f"points/{name}", self.array(problem.world_point(frame))[None])
        return result


def _named(names: Sequence[str], values: Array) -> dict[str, float]:
    return dict(zip(names, values.tolist()))


def singular_values(matrix: Array) -> list[float] | None:
    """Return the singular values, largest first; None where data are missing."""
    if not np.all(np.isfinite(matrix)):
        return None
    found: list[float] = np.linalg.svd(matrix, compute_uv=False).tolist()
    return found


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
        lines.append(f"{indent}{branch}{joint['name']} ({joint['type']}) -> {joint['link']}, {weight}")
        below = children.get(str(joint["link"]), [])
        deeper = indent + ("    " if last else "|   ")
        stack = [(child, deeper, k == len(below) - 1) for k, child in enumerate(below)] + stack
    return lines
