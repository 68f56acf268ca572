"""What of an MJCF is read as what, what is left out by name, and what is refused at its line."""

from __future__ import annotations

import importlib.util
import math
import struct
from pathlib import Path
from typing import Any

import pytest
import yaml

pytest.importorskip("mujoco")

from robodyn_cli.errors import SceneError
from robodyn_cli.scene.descriptions import load_description
from robodyn_cli.scene.dialects import Description, robot_yaml
from robodyn_cli.scene.load import load_scene
from tests.mjcf_robots import inertial

BODY = inertial()
# lines 2 to 7
ARM = f"""
<body name="a"><joint name="j" axis="0 1 0"/>{BODY}
<body name="b"><joint name="k" type="slide"/>{BODY}
<site name="s" pos="0 0 0.1"/>
</body></body>
<body name="c"><joint name="l" type="ball"/>{BODY}</body>
"""


def written(tmp_path: Path, more: str = "", bodies: str = ARM) -> Path:
    path = tmp_path / "robot.xml"
    path.write_text(f"<mujoco><worldbody>{bodies}</worldbody>{more}</mujoco>", encoding="utf-8")
    return path


def read(tmp_path: Path, more: str = "", bodies: str = ARM) -> tuple[Description, dict[str, Any]]:
    found, _ = load_description(written(tmp_path, more, bodies))
    return found, yaml.safe_load(robot_yaml(found, str(tmp_path)))


def refused(path: Path) -> str:
    with pytest.raises(SceneError) as caught:
        load_description(path)
    assert "\n" not in caught.value.message
    return caught.value.message


TENDON = '<tendon><fixed name="t" {}><joint joint="j" coef="1"/></fixed></tendon>'
REFUSED = {
    '\n<composite type="cable" count="9 1 1"/>': ":2:1: <composite> in <worldbody> acts on the motion, and is not read; allowed: the bodies",
    '\n<flexcomp name="f"/>': ":2:1: <flexcomp> in <worldbody> acts on the motion, and is not read; allowed: rigid bodies",
    '\n<attach model="m"/>': ":2:1: <attach> in <worldbody> acts on the motion",
    "\n<bodie/>": ":2:1: <bodie> in <worldbody> is not known (did you mean 'body'?)",
    f'<body name="a">{BODY}</body>\n<body name="a">{BODY}</body>': ":2:1: MuJoCo's compiler: repeated name 'a' in body",
    f'\n<body pos="1 2">{BODY}</body>': ":2:1: MuJoCo's compiler: attribute 'pos' does not have enough data",
    '\n<body foo="1"/>': ":2:1: MuJoCo's compiler: Schema violation: unrecognized attribute: 'foo'",
    "\n<body><joint/></body>": ":2:1: MuJoCo's compiler: mass and inertia of moving bodies must be larger than mjMINVAL",
    f'\n<body>{BODY}\n<joint ref="nan"/></body>': ":3:1: ref of <joint> is 'nan'; allowed: finite numbers",
    f'\n<body>{BODY}\n<joint name="x" stiffness="1 2"/></body>': ":3:1: joint 'x': its stiffness is a curve; allowed: one number",
    f'\n<body>{BODY}\n<joint name="x" damping="1 0 2"/></body>': ":3:1: joint 'x': its damping is a curve",
    f'\n<body>{BODY}\n<joint name="x" type="ball" frictionloss="1"/></body>': ":3:1: joint 'x': its frictionloss is that of a ball joint",
    f'\n<body>{BODY}\n<joint name="x" type="free" armature="1"/></body>': ":3:1: joint 'x': its armature is that of a free joint",
    '\n<body><joint/><geom type="mesh" mesh="m"/></body>': ":2:15: MuJoCo's compiler: mesh 'm' not found in geom 0",
}
REFUSED_BELOW = {
    '\n<equality><joint joint1="j" joint2="k" polycoef="0 1 0.5 0 0"/></equality>': ":8:11: <joint> 'joint1': polycoef is 0 1 0.5 0 0, which is no straight line",
    '\n<equality><joint joint1="l"/></equality>': ":8:11: MuJoCo's compiler: only HINGE and SLIDE joint allowed in constraint",
    '\n<equality><joint joint1="j" polycoef="1"/><joint joint1="j" polycoef="2"/></equality>': ":8:11: 'joint1' asks for another position of 'j' than 2",
    '\n<equality><flexvert flex="f"/></equality>': ":8:11: <flexvert> in <equality> acts on the motion, and is not read; allowed: rigid bodies",
    "\n" + TENDON.format('stiffness="3"'): ":8:9: tendon 't': its stiffness acts on the motion, and is not read",
    "\n" + TENDON.format('frictionloss="3"'): ":8:9: tendon 't': its frictionloss acts on the motion",
    '\n<equality><tendon name="q" tendon1="u"/></equality><tendon><spatial name="u"><site site="s"/><site site="s"/></spatial></tendon>': ":8:11: <tendon> 'q': tendon 'u' is spatial; allowed: fixed ones",
    '\n<extension><plugin plugin="p"/></extension>': ":8:1: <extension> in <mujoco> acts on the motion, and is not read; allowed: a file without plugins",
    '\n<asset><model file="other.xml"/></asset>': ":8:8: <model> in <asset> acts on the motion, and is not read; allowed: the model itself",
    '\n<deformable><flex name="f"/></deformable>': ":8:13: <flex> in <deformable> acts on the motion",
    '\n<option density="1.2"/>': "<option density> is 1.2: the fluid acts on the motion, and is not read; allowed: 0",
    '\n<include file="none.xml"/>': ":8:1: cannot read",
    '\n<include file="robot.xml"/>': ":8:1: ",
    "\n<include/>": ":8:1: include: <include> needs the attribute 'file'",
    '\n<actuator><motor tendon="t" armature="1"/></actuator>' + TENDON.format(""): ":8:11: <motor> '': its armature acts on the motion",
    '\n<actuator><motor joint="j" damping="1 2"/></actuator>': "joint 'j': its damping is a curve",
    '\n<actuator><motor joint="l" damping="1"/></actuator>': "joint 'l': its damping is that of a ball joint",
}  # fmt: skip


@pytest.mark.parametrize("body", REFUSED)
def test_bodies_that_are_refused(tmp_path: Path, body: str) -> None:
    assert f"robot.xml{REFUSED[body]}" in refused(written(tmp_path, bodies=body))


@pytest.mark.parametrize("more", REFUSED_BELOW)
def test_what_is_refused_beside_bodies(tmp_path: Path, more: str) -> None:
    assert REFUSED_BELOW[more] in refused(written(tmp_path, more))


LEFT = {
    '<actuator><position name="p" joint="j" kp="3"/><muscle joint="k"/><motor site="s"/></actuator>': "left out: actuators that are no torques: (no name) (muscle, joint), (no name) (motor, site), p (position)",
    '<actuator><general name="g" joint="j" dyntype="filter" dynprm="1"/><motor name="m" joint="l"/></actuator>': "actuators that are no torques: g (general), m (motor)",
    '<actuator><motor joint="k"/></actuator>': "joints with motors: k",
    TENDON.format('limited="true" range="0 1"'): "Doubtful: limits of tendons, which are left out: t",
    '<tendon><spatial name="u"><site site="s"/><site site="s"/></spatial></tendon>': "left out: tendons: u",
    '<equality><tendon name="q" tendon1="u" active="false"/></equality><tendon><spatial name="u"><site site="s"/><site site="s"/></spatial></tendon>': "left out: equalities that are not active: q",
    '<equality><weld name="w" body1="a" body2="c" active="false"/></equality>': "left out: equalities that are not active: w",
    '<equality><weld name="w" body1="a" body2="c" solref="0.1 1"/></equality>': "left out: solref and solimp, by which equalities give way; they are exact here",
    '<sensor><clock/></sensor><keyframe><key/></keyframe><keyframe/>': "left out, for no equation reads it: 1 <sensor>, 2 <keyframe>",
    f'<worldbody><body>{BODY}<joint name="q" type="ball" range="0 30" limited="true"/></body></worldbody>': "left out: limits of ball joints: q",
    '<option><flag equality="disable"/></option><equality><joint joint1="j"/></equality>': "left out: switched off by <flag>: equalities",
    f'<option><flag spring="disable"/></option><worldbody><body>{BODY}<joint stiffness="2"/></body></worldbody>': "left out: switched off by <flag>: springs",
    '<equality><joint joint1="j" polycoef="0.3 0 0 0 0"/></equality>': "joints held by equalities: j at 0.3",
    '<option gravity="0 1 -2"/>': "gravity in the file, which that of the scene replaces: [0, 1, -2]",
    '<option gravity="0 1 -2"><flag gravity="disable"/></option>': "gravity in the file, which that of the scene replaces: [0, 0, 0]",
    '<worldbody><body name="x" gravcomp="1"><freejoint/><geom size="1"/><geom size="2"/></body></worldbody>': "Doubtful: bodies with gravcomp, on which the gravity of the scene acts in full: x",
    '<worldbody><body name="x"><freejoint/><geom size="1"/><geom size="2"/></body></worldbody>': "left out: contacts of the geoms of: x (2)",
    '<worldbody><body name="x"><freejoint/><geom size="1"/></body></worldbody>': "free joints: x",
    '<worldbody><body name="x" mocap="true"/></worldbody>': "Doubtful: mocap bodies, which stand still: x",
}  # fmt: skip


@pytest.mark.parametrize("more", LEFT)
def test_what_is_left_out_is_told(tmp_path: Path, more: str) -> None:
    found, _ = read(tmp_path, more)
    assert any(LEFT[more] in remark for remark in found.remarks), found.remarks


def test_what_acts_in_joints(tmp_path: Path) -> None:
    """Limits from ref on, torques of motors by gear, gain and both limits, of several motors, within those of the joint."""
    body = f"""<body><joint name="j" ref="30" range="10 60" limited="true" stiffness="2" springref="45" frictionloss="0.3" damping="0.2"
    armature="0.1"/>{BODY}</body><body><joint name="k" type="slide" actuatorfrcrange="-9 4" actuatorfrclimited="true"/>{BODY}</body>
    <body><joint name="l"/>{BODY}</body>"""
    more = """<actuator><motor joint="j" gear="-3" ctrlrange="-1 2" ctrllimited="true" armature="0.2" damping="0.1"/>
    <general joint="j" gear="2" gainprm="4" ctrlrange="-1 1" ctrllimited="true" forcerange="-3 5" forcelimited="true"/>
    <motor joint="k" gear="100"/><motor joint="l"/></actuator>"""
    joints = {joint["name"]: joint for joint in read(tmp_path, more, body)[1]["joints"]}
    j, degree = joints["j"], math.pi / 180
    assert j["limits"] == {
        "lower": pytest.approx(-20 * degree), "upper": pytest.approx(30 * degree), "effort": [-12, 11]
    }  # fmt: skip
    assert j["spring"] == {"stiffness": 2, "rest": pytest.approx(15 * degree)}
    assert j["friction"] == {"viscous": pytest.approx(0.2 + 9 * 0.1), "coulomb": 0.3, "law": "set_valued"}
    assert j["rotor_inertia"] == pytest.approx(0.1 + 9 * 0.2)
    assert joints["k"]["limits"] == {"effort": [-9, 4]} and "limits" not in joints["l"]


def test_names(tmp_path: Path) -> None:
    """Bodies and joints without names get some that no other has; chains of joints get links between them."""
    bodies = f"""<body><joint/><joint/>{BODY}</body><body name="x"><joint name="body1_hinge"/>{BODY}
    <body name="2 y"><geom size="1"/></body></body><body name="body1::body1_hinge2"/>"""
    found, robot = read(tmp_path, bodies=bodies)
    joints = [(joint["name"], joint["parent"], joint["link"]) for joint in robot["joints"]]
    assert joints == [
        ("body1_hinge2", "base", "body1__body1_hinge2_"),
        ("body1_hinge3", "body1__body1_hinge2_", "body1"),
        ("body1_hinge", "base", "x"),
        ("_2_y_fixed", "x", "_2_y"),
        ("body1__body1_hinge2_fixed", "base", "body1__body1_hinge2"),
    ]
    assert robot["links"][0] == {"name": "body1__body1_hinge2_", "mass": 0}
    assert "in the MJCF: '2 y'" in robot_yaml(found, ".")


def test_shapes_and_sites(tmp_path: Path) -> None:
    body = f"""<body name="x"><joint pos="0.1 0 0"/>{BODY}<geom type="box" size="0.1 0.2 0.3" pos="0.5 0 0" contype="0" conaffinity="0"/>
    <geom size="1"/><geom type="capsule" size="0.1 0.4" contype="0" conaffinity="0"/><site name="s" pos="0 0 1" euler="0 0 90"/></body>"""
    _, robot = read(tmp_path, bodies=body)
    assert robot["links"][0]["visual"] == [
        {"box": [0.2, 0.4, 0.6], "origin": {"xyz": [0.4, 0, 0]}},
        {"cylinder": [0.1, 0.8], "origin": {"xyz": [-0.1, 0, 0]}},
    ]
    assert robot["frames"]["s"] == {
        "link": "x",
        "at": [-0.1, 0, 1],
        "rpy": [0, 0, pytest.approx(math.pi / 2)],
    }


def test_meshes(tmp_path: Path) -> None:
    """A mesh is needed where it gives a moving body its inertia, and nowhere else; it is read within bounds."""
    asset = '<compiler meshdir="m"/>\n<asset><mesh name="w" file="w.{}"/></asset>'
    needed = '<body name="x"><joint/><geom type="mesh" mesh="w"/></body>'
    for bodies in (needed.replace("<joint/>", ""), needed.replace("<joint/>", f"<joint/>{BODY}")):
        assert "visual" not in read(tmp_path, asset.format("stl"), bodies)[1]["links"][0]
    assert "the mass of meshes of what stands still" in "".join(read(tmp_path, asset.format("stl"), needed.replace("<joint/>", ""))[0].notes)  # fmt: skip
    words = (
        ":2:8: mesh 'w' gives a body its inertia, and '" + str(tmp_path / "m/w.stl") + "' cannot be read: "
    )
    assert words + "No such file" in refused(written(tmp_path, asset.format("stl"), needed))
    (tmp_path / "m").mkdir()
    (tmp_path / "m/w.stl").write_bytes(bytes(80) + struct.pack("<I", 1 << 31))
    assert words + "no STL, or cut off" in refused(written(tmp_path, asset.format("stl"), needed))
    assert "allowed: .stl, .obj" in refused(written(tmp_path, asset.format("msh"), needed))
    device = asset.format("stl").replace("w.stl", "../p.stl")
    (tmp_path / "p.stl").symlink_to("/dev/zero")
    assert "pipe or a device" in refused(written(tmp_path, device, needed))


def test_errors_of_included_files(tmp_path: Path) -> None:
    """Places are those of the file that the element stands in; each file is read once."""
    (tmp_path / "part.xml").write_text("<x>\n\n<body pos='1 2'/></x>")
    message = refused(written(tmp_path, bodies='\n<include file="part.xml"/>'))
    assert f"{tmp_path / 'part.xml'}:3:1: MuJoCo's compiler: attribute 'pos'" in message
    (tmp_path / "part.xml").write_text("<x><body name='q'/></x>")
    twice = '<include file="part.xml"/>\n<include file="./part.xml"/>'
    assert (
        ":2:1: " in (message := refused(written(tmp_path, bodies=twice))) and "is included already" in message
    )
    for text, words in (
        ("<x><include file='robot.xml'/></x>", "already"),
        ("<!DOCTYPE x><x/>", "document type"),
        ("<x", "no"),
    ):
        (tmp_path / "part.xml").write_text(text)
        assert "part.xml:1:" in (message := refused(written(tmp_path, bodies=twice))) and words in message
    assert "large" in _large(tmp_path)


def _large(tmp_path: Path) -> str:
    for k in range(3):
        (tmp_path / f"part{k}.xml").write_text(f"<x>{'<!-- -->' * 600_000}</x>")
    return refused(written(tmp_path, bodies="".join(f'<include file="part{k}.xml"/>' for k in range(3))))


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ('<replicate count="1000"><replicate count="1000"><site/></replicate></replicate>', "20000 elements"),
        ('<replicate count="9999999999999"><body/></replicate>', "1000 bodies"),
        ('<replicate count="x"><body/></replicate>', "count of <replicate> is 'x'"),
        ("<body/>" * 1001, "1000 bodies"),
        ("<site/>", "the file has no <body>"),
        ("<body>" * 60 + "</body>" * 60, "more than 50 deep"),
        ("<frame>" * 30 + '<include file="deep.xml"/>' + "</frame>" * 30, "more than 50 deep"),
    ],
)
def test_bombs(tmp_path: Path, body: str, words: str) -> None:
    (tmp_path / "deep.xml").write_text("<x>" + "<frame>" * 30 + "</frame>" * 30 + "</x>")
    assert words in refused(written(tmp_path, bodies=body))


def test_without_the_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(tmp_path)
    monkeypatch.setattr("robodyn_cli.scene.mjcf.compiled.version", lambda name: "3.2.10")
    assert "needs the package mujoco 3.3.7 or newer (here 3.2.10): pip install 'robodyn[mjcf]'" in refused(
        path
    )
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert ":1:1: a robot in MJCF needs the package mujoco: pip install 'robodyn[mjcf]'" in refused(path)


def test_a_compiler_that_does_not_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("robodyn_cli.scene.mjcf.compiled.SECONDS", 0.0)
    assert "robot.xml:1:1: MuJoCo's compiler: reading it does not end within 0 s" in refused(
        written(tmp_path)
    )


def test_a_scene_tells_what_is_left_out(tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    written(
        tmp_path,
        '<equality><weld body1="a" body2="c"/></equality>' + TENDON.format('limited="true" range="0 1"'),
    )
    path.write_text("schema: 1\ngravity: [0, 0, -9.81]\nrobot: robot.xml\n")
    scene = load_scene(path)
    assert any("robot.xml: left out: solref and solimp" in note for note in scene.notes)
    assert any("robot.xml: limits of tendons" in warning for warning in scene.warnings)
    assert str(tmp_path / "robot.xml") in scene.sources
