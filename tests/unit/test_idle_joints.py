"""Inverse kinematics of random arms with a joint that does not move the point."""

from __future__ import annotations

import numpy as np
import pytest

from robodyn_cli.model.build import build_model
from tests.numeric import assert_close
from tests.unit.arms import follow, forward, miss, scene


def random_arm(rng: np.random.Generator, joints: int, idle: str) -> str:
    """Return a robot of random revolute joints with the point ``tip``, and a joint ``idle`` that does not move it.

    idle : ``none``, ``beyond`` the point's link, or with its axis ``through`` the point.
    """
    rows = [
        f"    - {{name: q{k}, type: revolute, axis: {rng.normal(size=3).tolist()}, "
        f"origin: {{xyz: {rng.uniform(-1, 1, 3).tolist()}}}}}\n"
        for k in range(joints)
    ]
    tip, axis = rng.uniform(-1, 1, 3).tolist(), rng.normal(size=3).tolist()
    links = [f"{{name: l{k}}}" for k in range(joints)]
    if idle != "none":
        rows.append(f"    - {{name: idle, type: revolute, axis: {axis}, origin: {{xyz: {tip}}}}}\n")
        links.append("{name: last}")
    if idle == "through":
        point = f"{{link: last, at: {(0.3 * np.array(axis)).tolist()}}}"
    else:
        # the same point, on the link before
        point = f"{{link: l{joints - 1}, at: {(np.array(tip) + 0.3 * np.array(axis)).tolist()}}}"
    return f"  joints:\n{''.join(rows)}  links: [{', '.join(links)}]\n  points: {{tip: {point}}}\n"


@pytest.mark.parametrize("idle", ["beyond", "through"])
@pytest.mark.parametrize("seed", range(8))
def test_a_joint_that_does_not_move_the_point_keeps_its_value(seed: int, idle: str) -> None:
    """And the others move as they do without it, redundant arms (four joints) too."""
    joints, times = 3 + seed % 2, np.linspace(0.0, 0.5, 101)
    guess = np.random.default_rng(100 + seed).uniform(-1.5, 1.5, joints)
    plain = random_arm(np.random.default_rng(seed), joints, "none")
    start = ", ".join(f"q{k}: {x}" for k, x in enumerate(guess))
    model = build_model(scene(plain, "{type: circle, point: tip, center: [0, 0], radius: 1, duration: 1}"))
    x, y, z = forward(model, "tip", guess[None])[0]
    path = (
        f"{{type: circle, point: tip, center: [{x - 0.05}, {y}, {z}], radius: 0.05, duration: 0.5, "
        "ik: {guess: {%s}}}"
    )
    alone, *_ = follow(plain, path % start, times)
    arm = random_arm(np.random.default_rng(seed), joints, idle)
    found, model, s = follow(arm, path % f"{start}, idle: 0.7", times)
    assert np.all(found.motion.q[:, -1] == 0.7) and not np.any(found.motion.qd[:, -1])
    assert not np.any(found.motion.qdd[:, -1])
    assert_close(found.motion.q[:, :-1], alone.motion.q, 1e-8)
    assert miss(found, model, s, times) < 1e-9
