"""Optima of goals that are magnitudes, zero there: how far keys may be off where columns are nearly alike."""

from __future__ import annotations

import numpy as np
import pytest

from robodyn_cli.over.search.cones import cone_of, off_cone
from robodyn_cli.scene.load import Family, load_scene_text
from tests.unit.test_search import searched


@pytest.mark.parametrize("seed", range(40))
def test_keys_lie_within_what_a_cone_says(seed: int) -> None:
    """Random cones with columns that are alike to 1e-3 .. 1: all keys are covered, and not by much in the worst direction."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 5))
    M = rng.normal(size=(6, 1)) + 10.0 ** rng.uniform(-3, 0) * rng.normal(size=(6, n))
    step, size = 1e-2, 10.0 ** rng.uniform(-9, -4)
    w = rng.normal(size=n) if seed % 2 else np.linalg.svd(M)[2][-1]  # from the optimum
    w *= size / np.abs(w).max()
    places = w + step * np.stack([np.eye(n), -np.eye(n)], axis=1)  # (n, 2, n)
    f = np.linalg.norm(places @ M.T, axis=2)
    g = (places @ M.T @ M) / f[..., None]
    off = off_cone(cone_of(f, g, step), float(np.linalg.norm(M @ w)))
    assert (np.abs(w) <= off).all()
    if not seed % 2:
        assert off.max() <= 3.0 * size + 1e-15


def test_directions_without_a_slope_are_told() -> None:
    M = np.array([[1.0, 1.0, 0.0], [2.0, 2.0, 0.5]])  # of the first two keys only the sum counts
    off = off_cone(M.T @ M, 1e-6)
    assert np.isnan(off[:2]).all() and 1e-6 < off[2] < 1e-5
    assert np.isnan(off_cone(np.full((2, 2), np.nan), 1.0)).all()


def test_an_optimum_at_a_corner_has_errors_that_cover() -> None:
    """A counterweight of 2 kg carries a tip of 3 kg: its place is known; over 13 degrees both of its keys act alike."""
    text = """
schema: 1
command: inverse
gravity: [0, -9.81, 0]
robot:
  joints:
    - {name: arm, type: revolute, axis: [0, 0, 1], parent: base}
    - {name: weld, type: fixed, parent: beam, link: tip}
  links:
    - {name: beam, mass: 2, com: [-0.3, -0.1, 0], com_frame: joint, inertia: {zz: 0.1}}
    - {name: tip, mass: 3, com: [0.4, 0.12, 0], com_frame: joint, inertia: {zz: 0.1}}
trajectory: {type: joint, duration: 10, q: {arm: "40 deg + 1.3 deg * t"}}
inverse: {samples: 31}
search:
  vary: {"robot.links.beam.com#1": "uniform(-1, 0.2)", "robot.links.beam.com#2": "uniform(-1, 0.3)"}
  minimise: rms_torque.arm
"""
    result, *_ = searched(Family.of(load_scene_text(text)), starts=1)
    for key, exact in (("1", -0.6), ("2", -0.18)):
        told = result.summary["keys"][f"robot.links.beam.com#{key}"]
        assert abs(told["value"] - exact) <= told["uncertainty"] <= 1e-3
    assert "corner" in result.summary["proof"]["text"]
