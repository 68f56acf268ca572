"""A slip of the pen in a description of a robot: each element and each attribute is one that is read, or an error."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from robodyn_cli.errors import SceneError
from robodyn_cli.scene.descriptions import load_description

_SDF_INERTIAL = (
    "<inertial auto='false'><pose>0.1 0 0 0 0 0</pose><mass>1</mass><inertia><ixx>.1</ixx><iyy>.1</iyy><izz>.1</izz>"
    "<ixy>0</ixy><ixz>0</ixz><iyz>0</iyz></inertia></inertial>"
)
SDF = f"""<sdf version="1.11" xmlns:drake="http://drake.mit.edu">
<model name="m" placement_frame="a" canonical_link="a"><static>false</static>
<pose degrees="true" rotation_format="euler_rpy">0 0 1 0 0 30</pose>
<link name="a"><gravity>1</gravity><kinematic>0</kinematic>
<velocity_decay><linear>0</linear><angular>0</angular></velocity_decay>{_SDF_INERTIAL}</link>
<link name="b"><pose relative_to="f">0.5 0 0 0 0 0</pose>{_SDF_INERTIAL}</link>
<link name="c"><pose relative_to="b">0.5 0 0 0 0 0</pose>{_SDF_INERTIAL}</link>
<frame name="f" attached_to="a"><pose relative_to="a">0.1 0 0 0 0 0.2</pose></frame>
<joint name="w" type="revolute"><parent>world</parent><child>a</child><axis><xyz>0 0 1</xyz>
<limit><lower>-1</lower><upper>1</upper><effort>3</effort><velocity>3</velocity></limit><dynamics><damping>0.1</damping>
<friction>0.1</friction><spring_stiffness>2</spring_stiffness><spring_reference>0.1</spring_reference></dynamics></axis>
<drake:rotor_inertia>0.01</drake:rotor_inertia><drake:gear_ratio>3</drake:gear_ratio></joint>
<joint name="j1" type="revolute"><pose relative_to="b">0.01 0 0 0 0 0</pose><parent>a</parent><child>b</child>
<axis><xyz expressed_in="a">0 0 1</xyz><mimic joint="w" axis="axis"><multiplier>2</multiplier><offset>0.1</offset>
<reference>0.1</reference></mimic></axis></joint>
<joint name="j2" type="screw"><parent>b</parent><child>c</child><axis><xyz>0 0 1</xyz></axis>
<drake:mimic joint="w" multiplier="2" offset="0"/><screw_thread_pitch>0.1</screw_thread_pitch></joint>
<joint name="l" type="ball"><parent>a</parent><child>c</child>
<physics><simbody><must_be_loop_joint>1</must_be_loop_joint></simbody></physics></joint>
<joint name="gb" type="gearbox"><parent>b</parent><child>c</child><gearbox_ratio>3</gearbox_ratio>
<gearbox_reference_body>a</gearbox_reference_body><axis><xyz>0 0 1</xyz></axis><axis2><xyz>0 0 1</xyz></axis2></joint>
<drake:distance_constraint><drake:distance_constraint_body_A>a</drake:distance_constraint_body_A>
<drake:distance_constraint_body_B>b</drake:distance_constraint_body_B>
<drake:distance_constraint_p_AP>0 0 0</drake:distance_constraint_p_AP>
<drake:distance_constraint_p_BQ>0 0 0</drake:distance_constraint_p_BQ>
<drake:distance_constraint_distance>0.6</drake:distance_constraint_distance></drake:distance_constraint>
</model></sdf>
"""
_INERTIAL = (
    '<inertial><origin xyz="0.1 0 0" rpy="0 0 0"/><mass value="1"/>'
    '<inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial>'
)
URDF = f"""<robot xmlns:drake="http://drake.mit.edu">
<link name="w">{_INERTIAL}</link><link name="a">{_INERTIAL}</link><link name="b">{_INERTIAL}</link>
<link name="c">{_INERTIAL}</link><link name="d">{_INERTIAL}</link>
<joint name="ja" type="revolute" independent="true"><parent link="w"/><child link="a"/><origin xyz="0 0 0.1" rpy="0 0 0"/>
<axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="3" velocity="4" drake:acceleration="9"/>
<dynamics damping="0.1" friction="0.1"/></joint>
<joint name="jb" type="continuous"><parent link="a"/><child link="b"/><origin xyz="0.3 0 0" quat_xyzw="0 0 0 1"/>
<axis xyz="0 0 1"/><mimic joint="ja" multiplier="2" offset="0.1"/></joint>
<joint name="jc" type="continuous"><parent link="w"/><child link="c"/><axis xyz="0 0 1"/></joint>
<drake:joint name="jd" type="screw"><parent link="c"/><child link="d"/><origin xyz="0.3 0 0"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1"/><dynamics damping="0.1"/><drake:screw_thread_pitch value="0.1"/></drake:joint>
<constraint name="k" type="revolute"><parent link="b"/><parent_origin xyz="0.1 0 0" rpy="0 0 0"/><parent_axis xyz="0 0 1"/>
<child link="d"/><child_origin xyz="0.1 0 0" rpy="0 0 0"/></constraint>
<loop_joint name="k2" type="spherical"><link1 link="b" xyz="0 0 0.1" rpy="0 0 0"/><link2 link="d" xyz="0.1 0 0"/></loop_joint>
<drake:ball_constraint><drake:ball_constraint_body_A name="b"/><drake:ball_constraint_body_B name="d"/>
<drake:ball_constraint_p_AP value="0 0 0"/><drake:ball_constraint_p_BQ value="0 0 0"/></drake:ball_constraint>
<transmission name="t"><type>SimpleTransmission</type><actuator name="m1"><drake:rotor_inertia value="0.01"/>
<drake:gear_ratio value="5"/></actuator><joint name="ja"/></transmission>
</robot>
"""
# in each dialect, what says nothing of the motion
HARMLESS = {
    ("sdf", "xmlns:drake"), ("robot", "xmlns:drake"), ("transmission", "name"), ("actuator", "name"),
}  # fmt: skip


def misspellings(text: str) -> Iterator[tuple[str, str]]:
    """Yield each attribute of each element, and each element inside another, by its name, with a text in which it
    has one letter more."""
    above: list[str] = []
    done = set()
    for tag in re.finditer(r"<(/?)([\w:]+)([^<>]*?)(/?)>", text):
        if tag[1]:
            above.pop()
            continue
        for name in re.finditer(r"\s([\w:]+)=", tag[3]):
            if (tag[2], name[1]) not in done | HARMLESS:
                end = tag.start(3) + name.end(1)
                yield f"{tag[2]} {name[1]}", f"{text[:end]}x{text[end:]}"
            done.add((tag[2], name[1]))
        if above and (above[-1], tag[2]) not in done:
            done.add((above[-1], tag[2]))
            opening, inside = f"{text[: tag.end(2)]}x", text[tag.end(2) :]
            yield (
                f"<{tag[2]}> in <{above[-1]}>",
                (opening + (inside if tag[4] else inside.replace(f"</{tag[2]}>", f"</{tag[2]}x>", 1))),
            )
        if not tag[4]:
            above.append(tag[2])


CASES = [
    pytest.param(dialect, wrong, id=f"{dialect} {name}")
    for dialect, text in (("sdf", SDF), ("urdf", URDF))
    for name, wrong in misspellings(text)
]


@pytest.mark.parametrize("dialect, text", [("sdf", SDF), ("urdf", URDF)])
def test_the_description_itself_is_read(tmp_path: Path, dialect: str, text: str) -> None:
    (tmp_path / f"robot.{dialect}").write_text(text, encoding="utf-8")
    assert load_description(tmp_path / f"robot.{dialect}")


@pytest.mark.parametrize("dialect, text", CASES)
def test_each_slip_is_an_error_with_its_place(tmp_path: Path, dialect: str, text: str) -> None:
    """The message has the line where the word stands, or where what it was is missing."""
    path = tmp_path / f"robot.{dialect}"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(SceneError, match=rf"robot.{dialect}:\d+:\d+: ") as caught:
        load_description(path)
    assert "internal" not in str(caught.value)
