"""Paths in the least time against toppra (``pip install toppra``, which is no dependency of the tests for its size)."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from robodyn_cli import load_scene_text
from robodyn_cli.fastest.resolve import fastest_on, limited_path, special_points
from robodyn_cli.ready.doors import along
from robodyn_cli.torques.build import build_inverse
from tests.source import ROOT

ta = pytest.importorskip("toppra")
GRID = 800


def scene_of(seed: int) -> Any:
    """Return the 2R arm on a random spline under random limits of torque and speed."""
    rng = np.random.default_rng(seed)
    q = np.cumsum(rng.uniform(-1.0, 1.0, (3, 2)), axis=0)
    points = ", ".join(f"{{q: {{theta1: {a:.6f}, theta2: {b:.6f}}}}}" for a, b in q)
    effort, speed = rng.uniform([320.0, 140.0], [600.0, 250.0]), rng.uniform(1.0, 4.0, 2)
    path = ROOT / "configs" / "trajectories" / "fastest_2r.yaml"
    text = (
        path.read_text().split("trajectory:")[0]
        + f"trajectory: {{type: fastest, points: [{points}], "
        + f"effort: {{theta1: {effort[0]}, theta2: {effort[1]}}}, speed: {{theta1: {speed[0]}, theta2: {speed[1]}}}}}\n"
    )
    return load_scene_text(text, str(path))


def by_toppra(path: Any, length: float) -> float:
    """Return the duration that toppra finds, its limits interpolated between grid points."""

    class Way(ta.interpolator.AbstractGeometricPath):  # type: ignore[misc]
        path_interval = np.array([0.0, length])
        dof = 2

        def __call__(self, s: Any, order: int = 0) -> Any:
            found = path.motion(np.atleast_1d(np.asarray(s, dtype=float)))
            value = (found.q, found.qd, found.qdd)[order]
            return value[0] if np.ndim(s) == 0 else value

    def torques(q: Any, qd: Any, qdd: Any) -> Any:
        return path.torques(*(np.asfortranarray(x[None]) for x in (q, qd, qdd)))[0]

    two = ta.constraint.DiscretizationType.Interpolation
    limit = np.column_stack([path.effort.low, path.effort.high])
    limits = [
        ta.constraint.JointTorqueConstraint(torques, limit, np.zeros(2), discretization_scheme=two),
        ta.constraint.JointVelocityConstraint(np.column_stack([path.speed.low, path.speed.high])),
    ]
    solver = ta.algorithm.TOPPRA(
        limits, Way(), gridpoints=np.linspace(0.0, length, GRID + 1), parametrizer="ParametrizeConstAccel"
    )
    return float(solver.compute_trajectory(0, 0).duration)


@pytest.mark.parametrize("seed", range(6))
def test_durations(seed: int) -> None:
    """toppra keeps limits between grid points only about, and converges with the first order of the grid."""
    scene = scene_of(seed)
    trajectory = scene.trajectory
    program = build_inverse(along(dataclasses.replace(scene, trajectory=trajectory.way)))
    path = limited_path(trajectory, program)
    special = special_points(trajectory, program, path)
    found = fastest_on(path, trajectory, special, program).law.duration
    assert found == pytest.approx(by_toppra(path, trajectory.way.duration), rel=3e-3)
