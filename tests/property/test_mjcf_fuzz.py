"""MJCF files with anything changed in them: read, or one error with a place; never another exception."""

from __future__ import annotations

import random
import re
from pathlib import Path

import pytest

pytest.importorskip("mujoco")

from robodyn_cli.errors import SceneError
from robodyn_cli.model.build import build_model
from robodyn_cli.scene.dialects import robot_yaml
from robodyn_cli.scene.load import load_description, load_scene_text

BODY = '<inertial pos="0.1 0 0" mass="1" fullinertia="1 1 1 0.1 0 0"/>'
TEXT = f"""<mujoco model="m">
<compiler angle="radian" autolimits="true" meshdir="assets"/>
<option gravity="0 0 -9.81"><flag contact="disable"/></option>
<default class="main"><joint damping="0.1"/><default class="k"><joint armature="0.1"/></default></default>
<asset><mesh name="w" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/><material name="grey"/></asset>
<worldbody>
<geom type="plane" size="1 1 1"/>
<body name="a" pos="0 0 1" quat="1 0.1 0 0" childclass="main"><freejoint name="f"/>{BODY}
<geom size="0.1" material="grey"/>
<body name="b" pos="1 0 0" euler="0.1 0.2 0.3">
<joint name="j1" class="k" axis="0 1 0" pos="0.1 0 0" ref="0.2" range="-1 1"/>
<joint name="j2" type="slide" axis="1 0 0" stiffness="3" springref="0.1"/>
{BODY}
<site name="s" pos="0.1 0.2 0.3"/>
</body>
<frame pos="0 0.1 0">
<replicate count="2" euler="0 0 0.3">
<body name="c" pos="0 1 0"><joint name="j3" type="ball" pos="0.1 0 0"/><geom type="mesh" mesh="w"/></body>
</replicate>
</frame>
</body>
<body name="d" pos="0 0 2"><joint name="j4" frictionloss="0.1"/><geom type="box" size="0.1 0.2 0.3" density="100"/></body>
</worldbody>
<equality>
<connect name="e1" body1="b" body2="c0" anchor="0.1 0 0"/>
<weld body1="c1" body2="d" relpose="0 0 0.1 1 0 0 0" anchor="0 0.1 0" active="false"/>
<joint name="e2" joint1="j1" joint2="j4" polycoef="0.1 2 0 0 0"/>
<tendon tendon1="t"/>
</equality>
<tendon><fixed name="t"><joint joint="j1" coef="2"/><joint joint="j4" coef="1"/></fixed>
<spatial name="u"><site site="s"/><site site="s"/></spatial></tendon>
<actuator>
<motor name="m1" joint="j1" gear="3" ctrlrange="-2 2"/>
<position joint="j2" kp="3"/>
<muscle joint="j4"/>
<general tendon="t" biastype="affine"/>
</actuator>
<keyframe><key qpos="0"/></keyframe>
</mujoco>
"""
VALUES = (
    "", "0", "-1", "1e999", "1e308", "1e-320", "nan", "inf", "0 0 0", "1 2", "0 0 0 0 0 0", "0.5.5", "1_0", "٣", "a", "b",
    "c0", "d", "f", "s", "t", "w", "world", "j1", "j2", "j4", "hinge", "ball", "slide", "free", "mesh", "plane", "capsule",
    "sdf", "true", "auto", "&lt;", "a b", "é", "#", "a: [b", "9" * 400, "99999999999", "k", "missing.stl", "/dev/zero",
)  # fmt: skip
NAMES = (
    "name", "type", "pos", "quat", "euler", "mesh", "class", "childclass", "mocap", "ref", "fullinertia", "diaginertia", "fromto",
    "margin", "solref", "polycoef", "site1", "site2", "file", "user", "gravcomp", "armature", "limited", "springdamper",
    "inertiafromgeom", "settotalmass", "boundmass", "balanceinertia", "fusestatic", "eulerseq", "coordinate", "density", "mass",
    "group", "axisangle", "zaxis", "xyaxes", "dyntype", "gaintype", "gainprm", "lengthrange", "count", "sep", "offset", "file",
    "scale", "inertia", "builtin", "maxhullvert", "fitscale", "actuatorfrcrange", "align", "discardvisual", "strippath", "assetdir",
)  # fmt: skip
PIECES = (
    "<body name='x'/>", "<body><joint/></body>", "<a>", "</a>", "<!-- ", "-->", "&a;", "<![CDATA[x]]>", "\x00", "\ud800",
    "<joint name='j9' axis='1e-200 0 0'/>", "<joint type='free'/>", "<include file='robot.xml'/>", "<include file='none.xml'/>",
    "<replicate count='100000000'><site/></replicate>", "<composite type='cable' count='9 1 1'/>", "<flexcomp/>", "<attach model='x'/>",
    "<geom type='hfield' hfield='x'/>", "<geom type='ellipsoid' size='1 2 3'/>", "<plugin/>", "<extension/>", "<inertial pos='0 0 0' mass='0'/>",
    "<frame euler='1 2 3'><joint/></frame>", "<geom fromto='0 0 0 0 0 0' size='1'/>", "<default class='z'/>", "<size memory='1T'/>",
    "<option density='1'/>", "<joint joint1='j1'/>", "<connect body1='a' anchor='0 0 0'/>", "<mesh name='v' file='v.obj'/>",
)  # fmt: skip


def mutated(rng: random.Random) -> str:
    """Return the file with one to three changes: values, attributes, tags and elements left out, put in, twice."""
    text = TEXT
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        way = rng.randrange(8)
        pattern = (r'"[^"]*"', r' \w+="[^"]*"', r"<\w+[^<>]*/>")[way % 3]
        spots = list(re.finditer(pattern, text))
        spot = rng.choice(spots) if spots else None
        if way < 2 and spot:
            text = text[: spot.start()] + f'"{rng.choice(VALUES)}"'[way:] + text[spot.end() :]
        elif way == 2 and spot:
            text = text[: spot.start()] + text[spot.end() :]
        elif way == 3:
            spots = list(re.finditer(r' \w+="', text))
            spot = rng.choice(spots or [re.match("", text)])  # type: ignore[arg-type]
            text = (
                text[: spot.start()] + f' {rng.choice(NAMES)}="{rng.choice(VALUES)}"' + text[spot.start() :]
            )
        elif way == 4:
            at = rng.choice([m.end() for m in re.finditer(">", text)] or [0])
            text = text[:at] + rng.choice(PIECES) + text[at:]
        elif way == 5:
            a = rng.randrange(len(text) + 1)
            text = text[:a] + text[min(len(text), a + rng.randint(1, 30)) :]
        else:
            lines = text.splitlines(keepends=True) or [""]
            k, again = rng.randrange(len(lines)), rng.random() < 0.5
            text = "".join([*lines[:k], *([lines[k]] * 2 if again else []), *lines[k + 1 :]])
    return text


@pytest.mark.parametrize("seed", range(4))
def test_anything_in_an_mjcf(seed: int, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    rng = random.Random(seed)
    path, read = tmp_path / "robot.xml", 0
    for _ in range(150):
        path.write_bytes(mutated(rng).encode("utf-8", "surrogatepass"))
        try:
            found, scene = load_description(path)
        except SceneError as error:
            assert "robot.xml" in error.message and "\n" not in error.message
            continue
        build_model(scene)
        written = "".join(f"  {line}" for line in robot_yaml(found, ".").splitlines(keepends=True))
        again = load_scene_text(f"schema: 1\ngravity: [0, 0, 0]\nrobot:\n{written}")
        assert (again.robot, again.couplers, again.loops) == (scene.robot, scene.couplers, scene.loops)
        read += 1
    assert read > 15  # many changes are allowed
    assert capfd.readouterr() == ("", "")  # MuJoCo says nothing by itself
    assert not list(tmp_path.glob("MUJOCO_LOG*")) and not Path("MUJOCO_LOG.TXT").exists()
