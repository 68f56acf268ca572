"""Attachments of any shape: a robot, or errors with places; never another exception."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from robodyn_cli.scene.load import examine

ROOT = Path(__file__).parents[2]
VALUES = (
    "", "null", "3", "x", "'3x'", "[]", "{}", "[1, 2]", "{a: 1}", "[[]]", "fore", "base", "true", ".nan", "*none", "1e400",
    "{xyz: [0, 0, 1]}", "{name: j, type: revolute, axis: [0, 0, 1]}", "{name: [1], type: {}}", "none.yaml", "hand.yaml",
    "arm.urdf", "scene.yaml", "broken.yaml", "{include: hand.yaml}",
)  # fmt: skip
KEYS = (
    "link",
    "to",
    "origin",
    "joint",
    "mass",
    "com",
    "com_frame",
    "inertia",
    "include",
    "prefix",
    "nonsense",
)
BROKEN = (
    "joints: 3\nlinks: [a, {name: b}, {name: [1]}]\npoints: [1]\n",
    "joints: [{name: a}, 3, {link: [b]}]\nlinks: {}\ncouplers: [{name: 1, terms: [1]}, 2]\n",
    "[1, 2]\n",
    "base: 3\nconvention: [x]\njoints: []\nlinks: []\nframes: {a: 3, 4: {link: {}}}\n",
    "attach: [{include: hand.yaml}]\n",
)
HOST = "joints: [{name: a, type: revolute, axis: [0, 0, 1]}]\nlinks: [{name: fore, mass: 1}]\n"


def item(rng: random.Random) -> str:
    keys = rng.sample(KEYS, rng.randint(0, 5))
    return "{" + ", ".join(f"{key}: {rng.choice(VALUES)}" for key in keys) + "}"


@pytest.mark.parametrize("seed", range(6))
def test_anything_attached(seed: int, tmp_path: Path) -> None:
    rng = random.Random(seed)
    (tmp_path / "hand.yaml").write_text(HOST.replace("fore", "palm"), encoding="utf-8")
    (tmp_path / "arm.urdf").write_bytes((ROOT / "configs" / "robots" / "lift_arm.urdf").read_bytes())
    path = tmp_path / "scene.yaml"
    for _ in range(100):
        (tmp_path / "broken.yaml").write_text(rng.choice(BROKEN), encoding="utf-8")
        (tmp_path / "host.yaml").write_text(rng.choice((HOST, *BROKEN)), encoding="utf-8")
        items = ", ".join(
            item(rng) if rng.random() < 0.9 else rng.choice(VALUES) for _ in range(rng.randint(0, 3))
        )
        prefix = f"prefix: {rng.choice(VALUES)}, " if rng.random() < 0.2 else ""
        robot = f"{{include: host.yaml, {prefix}attach: [{items}]}}"
        path.write_text(f"schema: 1\ngravity: [0, 0, 0]\nrobot: {robot}\n", encoding="utf-8")
        overrides = rng.choice(([], [], [f"robot.attach+={item(rng)}"], ["robot.links+={name: z}"]))
        found = examine(path, overrides)
        assert found.scene is not None or found.errors
        assert all("\n" not in error.message for error in found.errors)
