"""URDF files with anything changed in them: read, or one error with a place; never another exception."""

from __future__ import annotations

import random
import re
from pathlib import Path

import pytest

from robodyn_cli.errors import SceneError
from robodyn_cli.model.build import build_model
from robodyn_cli.scene.dialects import robot_yaml
from robodyn_cli.scene.load import load_description, load_scene_text

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "configs" / "robots" / "lift_arm.urdf").read_text(encoding="utf-8")
VALUES = (
    "", "0", "-1", "1e999", "1e308", "1e-320", "nan", "inf", "0 0 0", "1 2", "1 2 3 4", "0.5.5", "1_0", "٣", "${a}",
    "base", "tool", "left", "lift", "t", "revolute", "floating", "planar", "mimic", "&lt;", "a b", "é", "#", "a: [b",
)  # fmt: skip
PIECES = (
    "<link name='x'/>", "<mimic joint='swing' multiplier='-2' offset='1e308'/>", "<axis xyz='1e-200 0 0'/>", "<a>", "</a>",
    "<joint name='lift' type='fixed'><parent link='tool'/><child link='stand'/></joint>", "<!-- ", "<![CDATA[x]]>", "&a;",
    "<dynamics damping='1e308' friction='1e308'/>", "<limit lower='1' upper='1'/>", "<origin quat_xyzw='0 0 0 0'/>",
    "<inertial><mass value='0'/><inertia ixx='0' ixy='0' ixz='0' iyy='0' iyz='0' izz='0'/></inertial>", "\x00", "\ud800",
)  # fmt: skip


def mutated(rng: random.Random) -> str:
    """Return the file with one to three changes: values, names of tags, pieces put in, left out, twice."""
    text = TEXT
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        way = rng.randrange(5)
        if way == 0:
            spots = list(re.finditer(r'"[^"]*"', text))
            spot = rng.choice(spots) if spots else None
            text = (
                text if spot is None else f'{text[: spot.start()]}"{rng.choice(VALUES)}"{text[spot.end() :]}'
            )
        elif way == 1:
            spots = list(re.finditer(r"<(\w+)[^<>]*/?>", text))
            spot = rng.choice(spots) if spots else None
            text = text if spot is None else text[: spot.start()] + text[spot.end() :]
        elif way == 2:
            at = rng.choice([m.end() for m in re.finditer(">", text)] or [0])
            text = text[:at] + rng.choice(PIECES) + text[at:]
        elif way == 3:
            a = rng.randrange(len(text) + 1)
            text = text[:a] + text[min(len(text), a + rng.randint(1, 30)) :]
        else:
            lines = text.splitlines(keepends=True) or [""]
            k = rng.randrange(len(lines))
            text = "".join([*lines[: k + 1], lines[k], *lines[k + 1 :]])
    return text


@pytest.mark.parametrize("seed", range(6))
def test_anything_in_a_urdf(seed: int, tmp_path: Path) -> None:
    rng = random.Random(seed)
    path, read = tmp_path / "robot.urdf", 0
    for _ in range(200):
        path.write_bytes(mutated(rng).encode("utf-8", "surrogatepass"))
        try:
            found, scene = load_description(path)
        except SceneError as error:
            assert "robot.urdf" in error.message and "\n" not in error.message
            continue
        build_model(scene)
        again = load_scene_text(f"schema: 1\ngravity: [0, 0, 0]\nrobot:\n{_indented(robot_yaml(found, '.'))}")
        assert again.robot == scene.robot and again.couplers == scene.couplers
        read += 1
    assert read > 10  # many changes are allowed


def _indented(text: str) -> str:
    return "".join(f"  {line}" for line in text.splitlines(keepends=True))
