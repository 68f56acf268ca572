"""Arms as scene texts, and the inverse kinematics run on them with everything measured independently."""

from __future__ import annotations

from typing import Any

import numpy as np

from robodyn_cli.algorithms.kinematics import poses, transforms
from robodyn_cli.given.motion import compile_point
from robodyn_cli.model.build import build_model
from robodyn_cli.model.model import Model
from robodyn_cli.ready.doors import along
from robodyn_cli.scene import load_scene_text
from robodyn_cli.solve.inverse_kinematics import FollowedPath, PathTask, follow_point
from tests.numeric import real

STANDARD_2R = """\
  convention: standard
  joints:
    - {name: q1, type: revolute, a: 1.0, alpha: 0, d: 0}
    - {name: q2, type: revolute, a: 0.8, alpha: 0, d: 0}
  links: [{name: l1}, {name: l2}]
  points: {tip: {link: l2, at: end}}
"""
SEVEN = """\
  convention: modified
  joints:
    - {name: j1, type: revolute, a: 0, alpha: 0, d: 0.34}
    - {name: j2, type: revolute, a: 0, alpha: -90 deg, d: 0}
    - {name: j3, type: revolute, a: 0, alpha: 90 deg, d: 0.40}
    - {name: j4, type: revolute, a: 0.05, alpha: 90 deg, d: 0}
    - {name: j5, type: revolute, a: -0.05, alpha: -90 deg, d: 0.39}
    - {name: j6, type: revolute, a: 0, alpha: -90 deg, d: 0}
    - {name: j7, type: revolute, a: 0.08, alpha: 90 deg, d: 0}
  links: [{name: l1}, {name: l2}, {name: l3}, {name: l4}, {name: l5}, {name: l6}, {name: l7}]
  points: {tip: {link: l7, at: [0, 0, 0.12]}}
"""
SEVEN_GUESS = "{j1: 0.1, j2: 0.6, j3: 0.2, j4: -1.5, j5: 0.3, j6: 1.2, j7: 0.1}"


def scene(robot: str, trajectory: str, rest: str = "") -> Any:
    """Return the scene of a robot's YAML (indented) and a trajectory (in flow style)."""
    return load_scene_text(
        f"schema: 1\ngravity: [0, -9.81, 0]\nrobot:\n{robot}trajectory: {trajectory}\n{rest}\n"
    )


def follow(robot: str, trajectory: str, times: np.ndarray, rest: str = "") -> tuple[FollowedPath, Model, Any]:
    """Return what the inverse kinematics finds, the model and the scene."""
    s = along(scene(robot, trajectory, rest))
    model = build_model(s)
    start = s.trajectory.ik.guess or s.initial.q
    task = PathTask(model, model.points[s.trajectory.point], s.trajectory, start, s.parameters)
    return follow_point(task, times, compile_point), model, s


def forward(model: Model, point: str, q: np.ndarray) -> np.ndarray:
    """World positions (T, 3) of a point, by plain forward kinematics on numbers."""
    frame = model.points[point]
    found = []
    for row in q:
        pose = poses(model, transforms(model, [float(x) for x in row]))
        found.append(model.base.point(pose[frame.body].point(frame.p)))
    return real(np.array(found))


def miss(found: FollowedPath, model: Model, s: Any, times: np.ndarray) -> float:
    """Largest distance between the point and its target."""
    target = s.trajectory.target(times, s.parameters).p
    at = forward(model, s.trajectory.point, found.motion.q)[:, : target.shape[1]]
    return float(np.linalg.norm(at - target, axis=1).max())


# central differences of order 8 along a uniform grid
_FIRST = (4 / 5, -1 / 5, 4 / 105, -1 / 280)


def differences(x: np.ndarray, h: float) -> np.ndarray:
    """Rates (T - 8, n) of uniform samples."""
    n = len(x)
    return sum(c * (x[4 + k : n - 4 + k] - x[4 - k : n - 4 - k]) for k, c in enumerate(_FIRST, 1)) / h
