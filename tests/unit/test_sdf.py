"""What an SDF may hold: one message with file, line, element and what is allowed; what is left out is told."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from robodyn_cli.errors import SceneError
from robodyn_cli.scene.descriptions import load_description
from robodyn_cli.scene.dialects import robot_yaml
from robodyn_cli.scene.load import load_scene, load_scene_text
from tests.cli.tool import invoke

INERTIAL = "<inertial><mass>2</mass><inertia><ixx>0.1</ixx><iyy>0.1</iyy><izz>0.1</izz></inertia></inertial>"
ARM = f"""<?xml version="1.0"?>
<sdf version="1.9">
<model name="arm">
<link name="upper"><pose>0 0 0.5 0 0 0</pose>{INERTIAL}</link>
<link name="lower"><pose>0 0 1.5 0 0 0</pose>{INERTIAL}</link>
<joint name="j1" type="revolute"><parent>world</parent><child>upper</child>
<axis><xyz>0 1 0</xyz><dynamics><damping>0.2</damping></dynamics></axis></joint>
<joint name="j2" type="revolute"><parent>upper</parent><child>lower</child>
<axis><xyz>0 1 0</xyz><limit><lower>-1</lower><upper>1</upper></limit></axis></joint>
<frame name="tip" attached_to="lower"><pose>0 0 0.4 0 0 0</pose></frame>
</model>
</sdf>
"""


def scene_with(tmp_path: Path, sdf: str) -> Path:
    (tmp_path / "arm.sdf").write_text(sdf, encoding="utf-8")
    path = tmp_path / "scene.yaml"
    path.write_text("schema: 1\ngravity: [0, 0, -9.81]\nrobot: arm.sdf\ninitial: {q: {j1: 0, j2: 0}}\n")
    return path


SCREW = '<joint name="j2" type="screw">'
REFUSED = [
    ('version="1.9"', 'version="1.4"', 2, "version '1.4' of SDF; allowed: 1.5 to 1.12"),
    ('version="1.9"', 'version="2.0"', 2, "version '2.0' of SDF"),
    ("</model>", '</model><model name="other"/>', 11, "has 2 <model> or <world>; allowed: one"),
    ('<model name="arm">', "<model>", 3, "needs the attribute 'name'"),
    ('<link name="upper">', '<include><uri>model://x</uri></include><link name="upper">', 4, "<include> in <model> acts"),
    ('<link name="upper">', '<lonk name="x"/><link name="upper">', 4, "<lonk> in <model> is not known (did you mean 'link'?)"),
    ('<link name="upper">', '<link name="world">', 4, "this name is reserved"),
    ('<link name="upper">', '<link name="__u__">', 4, "this name is reserved"),
    ('<link name="lower">', '<link name="upper">', 5, "'upper' names two of the links"),
    ('name="j2"', 'name="j1"', 8, "'j1' names two"),
    ('name="j2"', 'name="tip"', 10, "'tip' names two"),
    ("0 0 1.5 0 0 0", "0 0 1.5 0 0", 5, "<pose> is '0 0 1.5 0 0'; allowed: 6 finite numbers"),
    ("0 0 1.5 0 0 0", "0 0 nan 0 0 0", 5, "allowed: 6 finite numbers"),
    ("<pose>0 0 1.5", '<pose relative_to="uper">0 0 1.5', 5, "placed relative to 'uper', which is no frame"),
    ("<pose>0 0 1.5", '<pose relative_to="tip">0 0 1.5', 5, "is given relative to itself"),
    ("<pose>0 0 1.5", '<pose frame="tip">0 0 1.5', 5, "'frame' of <pose> acts on the motion, and is not read; allowed: relative_to"),
    ("<pose>0 0 1.5", '<pose rotation_format="matrix">0 0 1.5', 5, "unknown rotation_format 'matrix'"),
    ("<pose>0 0 1.5", '<pose degrees="maybe">0 0 1.5', 5, "'maybe' in <pose>; allowed: true, false, 1, 0"),
    ("<pose>0 0 1.5 0 0 0", '<pose rotation_format="quat_xyzw">0 0 1 0 0 0 2', 5, "has length 2; allowed: 1"),
    ('attached_to="lower"', 'attached_to="low"', 10, "is attached to 'low', which is no frame of this file"),
    ('attached_to="lower"', 'attached_to="tip"', 10, "is attached to itself"),
    ("<mass>2</mass>", "<mass>-2</mass>", 4, "mass is negative"),
    ("<mass>2</mass>", "<mass>two</mass>", 4, "<mass> is 'two'; allowed: a finite number"),
    ("<mass>2</mass>", "<fluid_added_mass/>", 4, "<fluid_added_mass> in <inertial> acts on the motion"),
    ("<inertial>", '<inertial auto="true">', 4, "takes the mass from shapes"),
    ("<inertial>", '<inertial><pose relative_to="tip">0 0 0 0 0 0</pose>', 4, "in the link's frame"),
    ("<inertial>", "<kinematic>true</kinematic><inertial>", 4, "<kinematic> acts on the motion"),
    ("<inertial>", "<velocity_decay><linear>0.1</linear></velocity_decay><inertial>", 4, "<velocity_decay> acts"),
    ('name="j2" type="revolute"', 'name="j2" type="planar"', 8, "unknown type 'planar'"),
    ("<child>lower</child>", "<child>world</child>", 8, "the world cannot be its child"),
    ("<child>lower</child>", "<child>upper</child>", 8, "joint 'j2' joins 'upper' with itself"),
    ("<child>lower</child>", "<child>loweer</child>", 8, "'loweer' is no link or frame of this file"),
    ("<child>lower</child>", "", 8, "needs <child>NAME</child>"),
    ("<xyz>0 1 0</xyz><limit>", "<xyz>0 0 0</xyz><limit>", 9, "the axis has the length 0; allowed: a direction"),
    ("<xyz>0 1 0</xyz><limit>", '<xyz expressed_in="x">0 1 0</xyz><limit>', 9, "unknown frame 'x'"),
    ("<limit><lower>", "<use_parent_model_frame>1</use_parent_model_frame><limit><lower>", 9, "of SDF 1.5 and 1.6"),
    ("<damping>0.2", "<damping>-0.2", 7, "is negative; allowed: numbers >= 0"),
    ("<limit>", '<mimic joint="j9"/><limit>', 9, "unknown joint with one axis 'j9'"),
    ("<limit>", '<mimic joint="j2"/><limit>', 9, "unknown joint with one axis 'j2'"),
    ("<limit>", '<mimic joint="j1" axis="axis2"/><limit>', 9, "the mimic of a second axis is not read"),
    ("<limit>", '<mimic joint="j1"><multiplier>0</multiplier></mimic><limit>', 9, "the multiplier of its mimic is 0"),
    ('<joint name="j2" type="revolute">', SCREW, 8, "is a screw and needs <screw_thread_pitch>"),
    ('<joint name="j2" type="revolute">', f"{SCREW}<thread_pitch>0</thread_pitch>", 8, "<thread_pitch> is 0"),
    ('<joint name="j2" type="revolute">', f"{SCREW}<screw_thread_pitch>0.1</screw_thread_pitch><thread_pitch>3</thread_pitch>", 8, "<thread_pitch> says -2.0944 m per turn, and <screw_thread_pitch> 0.1"),
    ('name="j2" type="revolute">', 'name="j2" type="revolute"><axis2/>', 8, "joint 'j2' is revolute and has no <axis2>"),
    ('name="j2" type="revolute">', 'name="j2" type="revolute"><gearbox_ratio>2</gearbox_ratio>', 8, "has no <gearbox_ratio>"),
    ("<ixx>0.1</ixx>", '<ixx unit="g">0.1</ixx>', 4, "'unit' of <ixx> is not known; read: no attribute"),
    ('name="j2" type="revolute"', 'name="j2" type="universal"', 8, "is universal and needs <axis2>"),
    ('name="j2" type="revolute"', 'name="j2" type="ball"', 9, "a coordinate that it does not have"),
    ('name="j2" type="revolute">', 'name="j2" type="revolute2"><axis2><xyz>0 1 1</xyz></axis2>', 8, "have the cosine 0.7071"),
    ('name="j2" type="revolute">', 'name="j2" type="revolute"><drake:tendon/>', 8, "<drake:tendon> acts"),
    ("</model>", "<joint name='g' type='gearbox'><parent>upper</parent><child>lower</child><axis/><axis2/></joint></model>", 11, "needs <gearbox_reference_body>NAME"),
    ("<?xml", "<!DOCTYPE sdf><?xml", 1, ""),
]  # fmt: skip


@pytest.mark.parametrize("old, new, line, words", REFUSED)
def test_what_is_refused(tmp_path: Path, old: str, new: str, line: int, words: str) -> None:
    """A scene that names the file and `import` say the same."""
    path = scene_with(tmp_path, ARM.replace(old, new, 1))
    with pytest.raises(SceneError) as caught:
        load_scene(path)
    assert words in str(caught.value) and f"arm.sdf:{line}:" in str(caught.value)
    with pytest.raises(SceneError):
        load_description(tmp_path / "arm.sdf")


@pytest.mark.parametrize(
    "old, new, words",
    [
        (
            "<pose>0 0 1",
            '<pose relative_to="upper">0 0 1',
            "5:.*relative_to of <pose> means nothing in SDF 1.6",
        ),
        ("<frame", "<frame", "10:.*attached_to of <frame> means nothing in SDF 1.6"),
        ("<xyz>", '<xyz expressed_in="upper">', "7:.*expressed_in of <xyz> means nothing in SDF 1.6"),
    ],
)
def test_frames_before_they_meant_something(tmp_path: Path, old: str, new: str, words: str) -> None:
    sdf = ARM.replace('version="1.9"', 'version="1.6"').replace(old, new, 1)
    if old != "<frame":
        sdf = sdf.replace(' attached_to="lower"', "")
    with pytest.raises(SceneError, match=f"arm.sdf:{words}"):
        load_scene(scene_with(tmp_path, sdf))


def test_all_errors_are_listed(tmp_path: Path) -> None:
    sdf = (
        ARM.replace("<mass>2", "<mass>x", 1)
        .replace('type="revolute"', 'type="hinge"')
        .replace("0 0 0.4", "4")
    )
    done = invoke("validate", scene_with(tmp_path, sdf))
    assert done.code == 2 and "4 errors" in done.out + done.err


def test_import_writes_the_same_robot(tmp_path: Path) -> None:
    """Names that scenes do not allow are changed, and it is said; comments may hold two dashes."""
    sdf = (
        ARM.replace('"upper"', '"a b"')
        .replace(">upper<", ">a b<")
        .replace("<model", "<!-- a -- b\n -- -->\n<model")
    )
    path = scene_with(tmp_path, sdf)
    assert invoke("import", tmp_path / "arm.sdf", "-q").code == 0
    written = (tmp_path / "arm.yaml").read_text(encoding="utf-8")
    assert "# in the SDF: 'a b'" in written and "The poses of the SDF are q = 0" in written
    path.write_text(path.read_text().replace("arm.sdf", "arm.yaml"))
    assert load_scene(path).robot == load_description(tmp_path / "arm.sdf")[1].robot


def test_comments_keep_their_lines(tmp_path: Path) -> None:
    """They end at the first -->; inside of CDATA there are none, and one that is not closed is no XML."""
    text = ARM.replace("<model", "<!-- é -- <link> -- -->\n<![CDATA[ <!-- ]]>\n<model", 1)
    load_scene(scene_with(tmp_path, text))
    with pytest.raises(SceneError, match=r"arm\.sdf:6:.*'two'"):
        load_scene(scene_with(tmp_path, text.replace("<mass>2", "<mass>two", 1)))
    with pytest.raises(SceneError, match="this is not XML"):
        load_scene(scene_with(tmp_path, text.replace(" -- -->", "", 1)))


def test_what_is_left_out_is_told(tmp_path: Path) -> None:
    plugin = '<plugin name="gz::sim::systems::DetachableJoint" filename="x"><parent_link>upper</parent_link></plugin>'
    sdf = ARM.replace("</model>", f"{plugin}<self_collide>1</self_collide><gz:made_up/></model>")
    scene = load_scene(scene_with(tmp_path, sdf))
    assert any(
        "left out, for no equation reads it: 1 <plugin>, 1 <self_collide>, 1 <gz:made_up>" in x
        for x in scene.notes
    )
    assert any("the plugin on line 11 ties two links, and is not run" in x for x in scene.warnings)


def test_what_is_doubtful_is_told(tmp_path: Path) -> None:
    """Bodies of 1 kg by default, no gravity, joints away from their parents' frames, limits without room."""
    sdf = ARM.replace(INERTIAL, "", 1).replace("<inertial>", "<gravity>0</gravity><inertial>")
    sdf = sdf.replace("<parent>upper</parent>", "<parent>off</parent>").replace("<upper>1<", "<upper>-1<")
    sdf = sdf.replace(
        "</model>", '<frame name="off" attached_to="upper"><pose>0 9 1.1 0 0 0</pose></frame></model>'
    )
    scene = load_scene(scene_with(tmp_path, sdf))
    upper = next(link for link in scene.robot.links if link.name == "upper")
    assert upper.mass == 1.0 and upper.inertia.xx == 1.0
    words = (
        "1 kg and 1 kg m^2: upper",
        "links without gravity",
        "leave no room, which are left out: j2",
        "is: j2",
    )
    assert all(any(word in x for x in scene.warnings) for word in words), scene.warnings


def test_worlds_and_static_models(tmp_path: Path) -> None:
    """Names have those of their models before them; a static model is part of the ground."""
    ground = f'<model name="ground"><static>1</static><link name="l">{INERTIAL}</link></model>'
    arm = ARM.partition("<model")[2].partition("</sdf>")[0]
    joint = "<joint name='hinge' type='revolute'><parent>ground::l</parent><child>cart::l</child><axis><xyz>1 0 0</xyz></axis></joint>"
    cart = f'<model name="cart"><link name="l"><pose>1 0 0 0 0 0</pose>{INERTIAL}</link></model>'
    sdf = f'<sdf version="1.9"><world name="w"><gravity>0 0 -9.8</gravity>{ground}<model{arm}{cart}{joint}</world></sdf>'
    (tmp_path / "arm.sdf").write_text(sdf)
    scene = load_scene_text("schema: 1\ngravity: [0, 0, 0]\nrobot: arm.sdf\n", str(tmp_path / "s.yaml"))
    assert [(j.name, j.type, j.parent, j.link) for j in scene.robot.joints] == [
        ("root_joint", "fixed", "base", "ground__l"),
        ("arm__j1", "revolute", "base", "arm__upper"),
        ("arm__j2", "revolute", "arm__upper", "arm__lower"),
        ("hinge", "revolute", "ground__l", "cart__l"),
    ]


def test_the_cut_is_the_last_joint_that_says_nothing(tmp_path: Path) -> None:
    """A four-bar linkage: bare joints are cut before those with limits or damping, wherever they stand."""
    links = "".join(
        f'<link name="{x}"><pose>{k} 0 0 0 0 0</pose>{INERTIAL}</link>' for k, x in enumerate("abc")
    )
    bare, damped = "<xyz>0 0 1</xyz>", "<xyz>0 0 1</xyz><dynamics><damping>1</damping></dynamics>"

    def closing(*axes: str) -> list[str]:
        ends = (("world", "a"), ("a", "b"), ("c", "b"), ("world", "c"))
        joints = "".join(
            f'<joint name="j{k}" type="revolute"><parent>{p}</parent><child>{c}</child><axis>{axis}</axis></joint>'
            for k, ((p, c), axis) in enumerate(zip(ends, axes), 1)
        )
        (tmp_path / "arm.sdf").write_text(f'<sdf version="1.7"><model name="m">{links}{joints}</model></sdf>')
        text = "schema: 1\ngravity: [0, 0, 0]\nrobot: arm.sdf\n"
        scene = load_scene_text(text, str(tmp_path / "s.yaml"))
        return [loop.name for loop in scene.loops]

    assert closing(bare, bare, bare, bare) == ["j4"]
    assert closing(bare, bare, bare, damped) == ["j3"]
    assert closing(damped, bare, damped, damped) == ["j2"]
    assert closing(damped, damped, damped, damped) == ["j4_weld"]


def test_hostile_files_end_soon(tmp_path: Path) -> None:
    """Chains of frames, comments that are not closed, long texts."""
    n = 5000
    chain = "".join(
        f'<frame name="f{k}" attached_to="f{k + 1}"><pose>0 0 1e-3 0 0 0</pose></frame>' for k in range(n)
    )
    cases = (
        ARM.replace("</model>", f'{chain}<frame name="f{n}" attached_to="lower"/></model>'),
        ARM.replace("</model>", chain.replace(f'"f{n}"', '"f0"') + "</model>"),
        ARM.replace("</model>", "<!--" * 500_000),
        ARM.replace("<mass>2</mass>", f"<mass>{'2 ' * 1_000_000}</mass>", 1),
        ARM.replace("<mass>2</mass>", "<mass>2" + "\n" * 2_000_000 + "</mass>", 1),
    )
    for text in cases:
        (tmp_path / "arm.sdf").write_text(text)
        start = time.perf_counter()
        try:
            robot_yaml(load_description(tmp_path / "arm.sdf")[0], ".")
        except SceneError as error:
            assert len(error.message) < 1000
        assert time.perf_counter() - start < 20.0
