"""Velocities and accelerations of points, as simulate and deploy write them: against differences and Pinocchio."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from robodyn_cli import deploy, load_scene, load_scene_text, simulate
from robodyn_cli.equations.problem import Problem
from robodyn_cli.results.result import Result
from tests.engines import to_pinocchio

pin = pytest.importorskip("pinocchio")
CONFIGS = Path(__file__).parents[2] / "configs"


def tree(seed: int, samples: int) -> str:
    """A random tree with full inertias and a point on each link, off all axes; the base is turned and lifted."""
    rng = np.random.default_rng(seed)

    def triple(size: float = 1.0) -> str:
        return str((size * rng.normal(size=3)).round(3).tolist())

    joints, links, points, q, v = [], [], [], [], []
    for k in range(5):
        parent = "base" if k == 0 else f"l{int(rng.integers(k))}"
        kind = "prismatic" if k == 2 else "revolute"
        joints.append(
            f"{{name: j{k}, type: {kind}, parent: {parent}, axis: {triple()}, "
            f"origin: {{xyz: {triple(0.4)}, rpy: {triple()}}}}}"
        )
        inertia = {"xx": 0.3, "yy": 0.4, "zz": 0.5, "xy": 0.02, "xz": -0.03, "yz": 0.04}
        links.append(f"{{name: l{k}, mass: {rng.uniform(1, 2):.3f}, com: {triple(0.2)}, inertia: {inertia}}}")
        points.append(f"p{k}: {{link: l{k}, at: {triple(0.5)}}}")
        q.append(f"j{k}: {rng.normal():.3f}")
        v.append(f"j{k}: {rng.normal():.3f}")
    text = f"""
schema: 1
gravity: [0.3, -0.4, -9.7]
robot:
  base: {{xyz: {triple()}, rpy: {triple()}}}
  joints: [{", ".join(joints)}]
  links: [{", ".join(links)}]
  points: {{{", ".join(points)}}}
initial: {{q: {{{", ".join(q)}}}, qd: {{{", ".join(v)}}}}}
simulate: {{duration: 0.4, samples: {samples}}}
"""
    return text.replace("'", "")


def agrees_with_differences(result: Result, name: str, relative: float) -> None:
    """Central differences of order 4 over the samples."""
    h = result.time[1] - result.time[0]
    for base, rate in (("points", "point_velocities"), ("point_velocities", "point_accelerations")):
        x, found = result[f"{base}/{name}"], result[f"{rate}/{name}"][2:-2]
        differences = (8.0 * (x[3:-1] - x[1:-3]) - (x[4:] - x[:-4])) / (12.0 * h)
        assert np.abs(differences - found).max() < relative * np.abs(found).max()


@pytest.mark.parametrize("seed", range(6))
def test_points_of_a_tree(seed: int) -> None:
    scene = load_scene_text(tree(seed, 401))
    result = simulate(scene)
    model = Problem(scene).model
    p = to_pinocchio(model)
    for k in range(5):
        agrees_with_differences(result, f"p{k}", 1e-7)
    base = model.base
    turn, lift = np.array(base.E, dtype=float).T, np.array(base.r, dtype=float)
    aligned = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    for i in (0, 133, 400):
        q, v, a = (p.to(result[path][i]) for path in ("q", "qd", "qdd"))
        pin.forwardKinematics(p.model, p.data, q, v, a)
        pin.updateFramePlacements(p.model, p.data)
        for k in range(5):
            place = p.model.getFrameId(f"p{k}")
            velocity = pin.getFrameVelocity(p.model, p.data, place, aligned).linear
            acceleration = pin.getFrameClassicalAcceleration(p.model, p.data, place, aligned).linear
            close(result[f"points/p{k}"][i], turn @ p.data.oMf[place].translation + lift)
            close(result[f"point_velocities/p{k}"][i], turn @ velocity)
            close(result[f"point_accelerations/p{k}"][i], turn @ acceleration)


def close(found: np.ndarray, expected: np.ndarray) -> None:
    assert np.abs(found - expected).max() < 1e-11 * (1.0 + np.abs(expected).max())


def test_points_of_a_mechanism_that_deploys() -> None:
    scene = load_scene(CONFIGS / "four_bar_deploy.yaml")
    moving = dataclasses.replace(
        scene, simulate=dataclasses.replace(scene.simulate, duration=2.0, samples=2001)
    )
    for result in (deploy(moving), simulate(moving)):
        names = [
            name for name, item in result.group("points").items() if np.ptp(item.data, axis=0).max() > 0.0
        ]
        assert names and set(names) <= set(result.group("point_velocities"))
        for name in names:
            agrees_with_differences(result, name, 1e-5)
