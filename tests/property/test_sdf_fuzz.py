"""SDF files with anything changed in them: read, or one error with a place; never another exception."""

from __future__ import annotations

import random
import re
from pathlib import Path

import pytest

from robodyn_cli.errors import SceneError
from robodyn_cli.model.build import build_model
from robodyn_cli.scene.dialects import robot_yaml
from robodyn_cli.scene.load import load_description, load_scene_text

BODY = "<inertial><pose>0.1 0 0 0 0.2 0</pose><mass>1</mass><inertia><ixx>1</ixx><iyy>1</iyy><izz>1</izz></inertia></inertial>"
TEXT = f"""<sdf version="1.11">
<model name="m" canonical_link="a" placement_frame="f">
<pose>0 0 1 0 0.1 0</pose>
<frame name="f" attached_to="a"><pose relative_to="b">0 0 1 0.1 0 0</pose></frame>
<link name="a"><pose>0 0 1 0 0 0.3</pose>{BODY}<visual name="v"><geometry><box><size>1 1 1</size></box></geometry></visual></link>
<link name="b"><pose relative_to="__model__">1 0 0 0 0 0</pose>{BODY}</link>
<link name="c">{BODY}</link>
<link name="d"><pose relative_to="n::e">1 0 0 0 0 0</pose>{BODY}</link>
<model name="n"><pose relative_to="c">0 1 0 0 0 0.2</pose><link name="e">{BODY}</link><frame name="f"/></model>
<joint name="j1" type="revolute"><parent>world</parent><child>a</child><axis><xyz expressed_in="f">0 1 0</xyz></axis></joint>
<joint name="j2" type="screw"><parent>a</parent><child>b</child><screw_thread_pitch>0.1</screw_thread_pitch><axis>
<xyz>0 1 0</xyz><limit><lower>-1</lower><upper>1</upper></limit><dynamics><damping>1</damping></dynamics></axis></joint>
<joint name="j3" type="revolute"><parent>c</parent><child>b</child><pose>0 0.1 0 0 0 0</pose><axis><xyz>0 1 0</xyz></axis></joint>
<joint name="j4" type="revolute"><parent>c</parent><child>a</child><axis><xyz>0 1 0</xyz></axis></joint>
<joint name="j5" type="prismatic"><parent>c</parent><child>n::f</child><axis><xyz>1 0 0</xyz><mimic joint="j2">
<multiplier>2</multiplier><offset>0.1</offset></mimic></axis></joint>
<joint name="j6" type="universal"><parent>n::e</parent><child>d</child><axis><xyz>1 0 0</xyz></axis><axis2><xyz>0 1 0</xyz></axis2></joint>
<joint name="g" type="gearbox"><parent>b</parent><child>c</child><gearbox_ratio>2</gearbox_ratio>
<gearbox_reference_body>a</gearbox_reference_body><axis><xyz expressed_in="c">0 1 0</xyz></axis><axis2><xyz>0 1 0</xyz></axis2></joint>
</model>
</sdf>
"""
VALUES = (
    "", "0", "-1", "1e999", "1e308", "1e-320", "nan", "inf", "0 0 0", "1 2", "0 0 0 0 0 0", "0.5.5", "1_0", "٣", "a", "b",
    "c", "d", "f", "n::e", "n", "world", "__model__", "n::__model__", "j1", "j2", "revolute", "fixed", "ball", "gearbox",
    "continuous", "1.5", "1.7", "true", "&lt;", "a b", "é", "#", "a: [b",
)  # fmt: skip
PIECES = (
    "<link name='x'/>", "<static>1</static>", "<axis><xyz>1e-200 0 0</xyz></axis>", "<a>", "</a>", "<!-- ", "-->", "&a;",
    "<joint name='j9' type='fixed'><parent>c</parent><child>d</child></joint>", "<![CDATA[x]]>", "<pose>1 2 3 4 5 6</pose>",
    "<joint name='j8' type='ball'><parent>world</parent><child>d</child></joint>", "<model name='x'/>", "\x00", "\ud800",
    "<dynamics><damping>1e308</damping></dynamics>", "<limit><lower>1</lower><upper>1</upper></limit>", "<plugin name='p'/>",
)  # fmt: skip


def mutated(rng: random.Random) -> str:
    """Return the file with one to three changes: values, texts, tags and elements left out, put in, twice."""
    text = TEXT
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        way = rng.choice((0, 0, 1, 1, 2, 2, 3, 4, 5))
        pattern = (r'"[^"]*"', r">[^<>\n]+<", r"<(\w+)[^<>]*>[^<>]*</\1>")[way % 3]
        spots = list(re.finditer(pattern, text))
        if way < 3 and spots:
            spot = rng.choice(spots)
            value = rng.choice(VALUES)
            text = text[: spot.start()] + (f'"{value}"', f">{value}<", "")[way] + text[spot.end() :]
        elif way == 3:
            at = rng.choice([m.end() for m in re.finditer(">", text)] or [0])
            text = text[:at] + rng.choice(PIECES) + text[at:]
        elif way == 4:
            a = rng.randrange(len(text) + 1)
            text = text[:a] + text[min(len(text), a + rng.randint(1, 30)) :]
        else:
            lines = text.splitlines(keepends=True) or [""]
            k, again = rng.randrange(len(lines)), rng.random() < 0.5
            text = "".join([*lines[:k], *([lines[k]] * 2 if again else []), *lines[k + 1 :]])
    return text


@pytest.mark.parametrize("seed", range(4))
def test_anything_in_an_sdf(seed: int, tmp_path: Path) -> None:
    rng = random.Random(seed)
    path, read = tmp_path / "robot.sdf", 0
    for _ in range(150):
        path.write_bytes(mutated(rng).encode("utf-8", "surrogatepass"))
        try:
            found, scene = load_description(path)
        except SceneError as error:
            assert "robot.sdf" in error.message and "\n" not in error.message
            continue
        build_model(scene)
        written = "".join(f"  {line}" for line in robot_yaml(found, ".").splitlines(keepends=True))
        again = load_scene_text(f"schema: 1\ngravity: [0, 0, 0]\nrobot:\n{written}")
        assert (again.robot, again.couplers, again.loops) == (scene.robot, scene.couplers, scene.loops)
        read += 1
    assert read > 15  # many changes are allowed
