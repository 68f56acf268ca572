"""Descriptions of robots with anything changed in them: read, or one error with a place; never another exception."""

from __future__ import annotations

import importlib.util
import random
import re
from pathlib import Path

import pytest

from robodyn_cli.errors import SceneError
from robodyn_cli.model.build import build_model
from robodyn_cli.record import record
from robodyn_cli.scene.descriptions import load_description
from robodyn_cli.scene.dialects import robot_yaml
from robodyn_cli.scene.load import load_scene_text

ROOT = Path(__file__).parents[2]
# numbers and words that fit nowhere, in every dialect
VALUES = (
    "", "0", "-1", "1e999", "1e308", "1e-320", "nan", "inf", "0 0 0", "1 2", "0 0 0 0 0 0", "0.5.5", "1_0", "٣", "&lt;", "a b",
    "é", "#", "a: [b",
)  # fmt: skip
PIECES = ("<a>", "</a>", "<!-- ", "-->", "&a;", "<![CDATA[x]]>", "\x00", "\ud800")


@record
class Sample:
    """A file of a dialect; values, names, pieces : of attributes or texts, of attributes, and of XML to put in."""

    file: str
    text: str
    values: tuple[str, ...]
    pieces: tuple[str, ...]
    names: tuple[str, ...] = ()


LOOPS = """<robot name="r" xmlns:drake="http://drake.mit.edu">
<link name="a"/>
<link name="b"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="c"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="d"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="j1" type="revolute"><parent link="a"/><child link="b"/><limit lower="-1" upper="1" effort="0" velocity="1"/></joint>
<joint name="j2" type="continuous" independent="false"><parent link="b"/><child link="c"/><origin xyz="1 0 0"/><axis xyz="0 1 0"/></joint>
<drake:joint name="j3" type="screw"><parent link="a"/><child link="d"/><axis xyz="0 1 0"/><drake:screw_thread_pitch value="0.1"/></drake:joint>
<joint name="j4" type="prismatic"><parent link="d"/><child link="e"/><limit effort="3" velocity="1"/></joint>
<link name="e"/>
<loop name="l" type="revolute"><predecessor link="c"><origin xyz="1 0 0"/></predecessor><successor link="d"/><axis xyz="0 0 1"/></loop>
<constraint name="m" type="revolute"><parent link="c"/><child link="e"/><parent_axis xyz="0 0 1"/></constraint>
<loop_joint name="n" type="spherical"><link1 link="c" xyz="1 0 0" rpy="0 0 0"/><link2 link="e" xyz="0 0 0" rpy="0 0 1"/></loop_joint>
<drake:ball_constraint><drake:ball_constraint_body_A name="b"/><drake:ball_constraint_p_AP value="0 0 1"/>
<drake:ball_constraint_body_B name="e"/><drake:ball_constraint_p_BQ value="0 0 1"/></drake:ball_constraint>
<coupling name="k"><predecessor link="c"/><successor link="a"/><ratio value="2"/></coupling>
<transmission name="t"><type>SimpleTransmission</type><joint name="j2"/><actuator name="m"><drake:rotor_inertia value="0.1"/>
<drake:gear_ratio value="7"/></actuator></transmission>
</robot>
"""
MJCF_BODY = '<inertial pos="0.1 0 0" mass="1" fullinertia="1 1 1 0.1 0 0"/>'
MJCF = f"""<mujoco model="m">
<compiler angle="radian" autolimits="true" meshdir="assets"/>
<option gravity="0 0 -9.81"><flag contact="disable"/></option>
<default class="main"><joint damping="0.1"/><default class="k"><joint armature="0.1"/></default></default>
<asset><mesh name="w" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/><material name="grey"/></asset>
<worldbody>
<geom type="plane" size="1 1 1"/>
<body name="a" pos="0 0 1" quat="1 0.1 0 0" childclass="main"><freejoint name="f"/>{MJCF_BODY}
<geom size="0.1" material="grey"/>
<body name="b" pos="1 0 0" euler="0.1 0.2 0.3">
<joint name="j1" class="k" axis="0 1 0" pos="0.1 0 0" ref="0.2" range="-1 1"/>
<joint name="j2" type="slide" axis="1 0 0" stiffness="3" springref="0.1"/>
{MJCF_BODY}
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
SDF_BODY = "<inertial><pose>0.1 0 0 0 0.2 0</pose><mass>1</mass><inertia><ixx>1</ixx><iyy>1</iyy><izz>1</izz></inertia></inertial>"
SDF = f"""<sdf version="1.11">
<model name="m" canonical_link="a" placement_frame="f">
<pose>0 0 1 0 0.1 0</pose>
<frame name="f" attached_to="a"><pose relative_to="b">0 0 1 0.1 0 0</pose></frame>
<link name="a"><pose>0 0 1 0 0 0.3</pose>{SDF_BODY}<visual name="v"><geometry><box><size>1 1 1</size></box></geometry></visual></link>
<link name="b"><pose relative_to="__model__">1 0 0 0 0 0</pose>{SDF_BODY}</link>
<link name="c">{SDF_BODY}</link>
<link name="d"><pose relative_to="n::e">1 0 0 0 0 0</pose>{SDF_BODY}</link>
<model name="n"><pose relative_to="c">0 1 0 0 0 0.2</pose><link name="e">{SDF_BODY}</link><frame name="f"/></model>
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
MJCF_VALUES = (
    "a", "b", "c0", "d", "f", "s", "t", "w", "world", "j1", "j2", "j4", "hinge", "ball", "slide", "free", "mesh",
    "plane", "capsule", "sdf", "true", "auto", "9" * 400, "99999999999", "k", "missing.stl", "/dev/zero",
)  # fmt: skip
MJCF_NAMES = (
    "name", "type", "pos", "quat", "euler", "mesh", "class", "childclass", "mocap", "ref", "fullinertia",
    "diaginertia", "fromto", "margin", "solref", "polycoef", "site1", "site2", "file", "user", "gravcomp", "armature",
    "limited", "springdamper", "inertiafromgeom", "settotalmass", "boundmass", "balanceinertia", "fusestatic",
    "eulerseq", "coordinate", "density", "mass", "group", "axisangle", "zaxis", "xyaxes", "dyntype", "gaintype",
    "gainprm", "lengthrange", "count", "sep", "offset", "file", "scale", "inertia", "builtin", "maxhullvert",
    "fitscale", "actuatorfrcrange", "align", "discardvisual", "strippath", "assetdir",
)  # fmt: skip
MJCF_PIECES = (
    "<body name='x'/>", "<body><joint/></body>", "<joint name='j9' axis='1e-200 0 0'/>", "<joint type='free'/>",
    "<include file='robot.xml'/>", "<include file='none.xml'/>", "<replicate count='100000000'><site/></replicate>",
    "<composite type='cable' count='9 1 1'/>", "<flexcomp/>", "<attach model='x'/>",
    "<geom type='hfield' hfield='x'/>", "<geom type='ellipsoid' size='1 2 3'/>", "<plugin/>", "<extension/>",
    "<inertial pos='0 0 0' mass='0'/>", "<frame euler='1 2 3'><joint/></frame>",
    "<geom fromto='0 0 0 0 0 0' size='1'/>", "<default class='z'/>", "<size memory='1T'/>", "<option density='1'/>",
    "<joint joint1='j1'/>", "<connect body1='a' anchor='0 0 0'/>", "<mesh name='v' file='v.obj'/>",
)  # fmt: skip
SDF_VALUES = (
    "a", "b", "c", "d", "f", "n::e", "n", "world", "__model__", "n::__model__", "j1", "j2", "revolute", "fixed",
    "ball", "gearbox", "continuous", "1.5", "1.7", "true",
)  # fmt: skip
SDF_PIECES = (
    "<link name='x'/>", "<static>1</static>", "<axis><xyz>1e-200 0 0</xyz></axis>",
    "<joint name='j9' type='fixed'><parent>c</parent><child>d</child></joint>", "<pose>1 2 3 4 5 6</pose>",
    "<joint name='j8' type='ball'><parent>world</parent><child>d</child></joint>", "<model name='x'/>",
    "<dynamics><damping>1e308</damping></dynamics>", "<limit><lower>1</lower><upper>1</upper></limit>",
    "<plugin name='p'/>",
)  # fmt: skip
URDF_VALUES = (
    "1 2 3 4", "${a}", "base", "tool", "left", "lift", "t", "revolute", "floating", "planar", "mimic",
)  # fmt: skip
URDF_PIECES = (
    "<link name='x'/>", "<mimic joint='swing' multiplier='-2' offset='1e308'/>", "<axis xyz='1e-200 0 0'/>",
    "<joint name='lift' type='fixed'><parent link='tool'/><child link='stand'/></joint>",
    "<dynamics damping='1e308' friction='1e308'/>", "<limit lower='1' upper='1'/>", "<origin quat_xyzw='0 0 0 0'/>",
    "<inertial><mass value='0'/><inertia ixx='0' ixy='0' ixz='0' iyy='0' iyz='0' izz='0'/></inertial>",
)  # fmt: skip
LOOPS_VALUES = (
    "a", "b", "e", "j1", "j4", "fixed", "planar", "ball", "LINK", "screw", "spherical", "1 2 3", "-2",
)  # fmt: skip
LOOPS_PIECES = (
    "<mimic joint='j1'/>", "<loop name='x' type='fixed'><predecessor link='a'/><successor link='e'/></loop>",
    "<axis xyz='1e-200 0 0'/>", "<drake:tendon_constraint/>", "<gazebo><joint name='g' type='ball'/></gazebo>",
    "<ratio value='0'/>", "<limit effort='0'/>",
)  # fmt: skip

SAMPLES = {
    "urdf": Sample(
        "robot.urdf",
        (ROOT / "configs" / "robots" / "lift_arm.urdf").read_text(encoding="utf-8"),
        URDF_VALUES,
        URDF_PIECES,
    ),
    "loops": Sample("robot.urdf", LOOPS, LOOPS_VALUES, LOOPS_PIECES),
    "sdf": Sample("robot.sdf", SDF, SDF_VALUES, SDF_PIECES),
    "mjcf": Sample("robot.xml", MJCF, MJCF_VALUES, MJCF_PIECES, MJCF_NAMES),
}
# values, attributes, texts and elements
SPOTS = (r'"[^"]*"', r' \w+="[^"]*"', r">[^<>\n]+<", r"<(\w+)[^<>]*>[^<>]*</\1>|<\w+[^<>]*/>")


def mutated(sample: Sample, rng: random.Random) -> str:
    """Return the file with one to three changes: of values, texts, attributes and elements, left out, put in, twice."""
    text = sample.text
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        way = rng.choice((0, 0, 1, 2, 2, 3, 3, 4, 4, 5, 6, 7))
        value = rng.choice((*VALUES, *sample.values))
        spots = list(re.finditer(SPOTS[way % 4], text))
        if way < 4 and spots:
            spot = rng.choice(spots)
            text = text[: spot.start()] + (f'"{value}"', "", f">{value}<", "")[way] + text[spot.end() :]
        elif way == 4:
            at = rng.choice([m.end() for m in re.finditer(">", text)] or [0])
            text = text[:at] + rng.choice((*PIECES, *sample.pieces)) + text[at:]
        elif way == 5:
            a = rng.randrange(len(text) + 1)
            text = text[:a] + text[min(len(text), a + rng.randint(1, 30)) :]
        elif way == 6 and sample.names and (starts := [m.start() for m in re.finditer(r' \w+="', text)]):
            at = rng.choice(starts)
            text = f'{text[:at]} {rng.choice(sample.names)}="{value}"{text[at:]}'
        else:
            lines = text.splitlines(keepends=True) or [""]
            k, again = rng.randrange(len(lines)), rng.random() < 0.5
            text = "".join([*lines[:k], *([lines[k]] * 2 if again else []), *lines[k + 1 :]])
    return text


def is_read(path: Path) -> bool:
    """Tell whether a robot is read, then the same again from the YAML that is written of it, or refused in one line."""
    try:
        found, scene = load_description(path)
    except SceneError as error:
        assert path.name in error.message and "\n" not in error.message
        return False
    build_model(scene)
    written = "".join(f"  {line}" for line in robot_yaml(found, ".").splitlines(keepends=True))
    again = load_scene_text(f"schema: 1\ngravity: [0, 0, 0]\nrobot:\n{written}")
    assert (again.robot, again.couplers, again.loops) == (scene.robot, scene.couplers, scene.loops)
    return True


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("dialect", SAMPLES)
def test_anything_in_a_file(
    dialect: str, seed: int, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    if dialect == "mjcf" and importlib.util.find_spec("mujoco") is None:
        pytest.skip("MJCF needs the package mujoco")
    rng, sample = random.Random(seed), SAMPLES[dialect]
    path, read = tmp_path / sample.file, 0
    for _ in range(60):
        path.write_bytes(mutated(sample, rng).encode("utf-8", "surrogatepass"))
        read += is_read(path)
    assert read > 1  # some changes are allowed
    assert capfd.readouterr() == ("", "")  # MuJoCo says nothing by itself
    assert not list(tmp_path.glob("MUJOCO_LOG*")) and not Path("MUJOCO_LOG.TXT").exists()
