"""URDF files: what is read, under which names, what is refused and where."""

from __future__ import annotations

import gc
import time
from pathlib import Path

import numpy as np
import pytest

from robodyn_cli import inverse, simulate
from robodyn_cli.errors import NumericalError, SceneError
from robodyn_cli.model.build import build_model
from robodyn_cli.over.findings import findings
from robodyn_cli.scene.descriptions import load_description
from robodyn_cli.scene.load import examine, load_scene, load_scene_text
from robodyn_cli.scene.types import Scene
from robodyn_cli.scene.urdf.meshes import mesh_file
from robodyn_cli.scene.urdf.xml import joint_names, link_names, scene_names

INERTIA = '<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/>'
MASS = f'<inertial><origin xyz="0.2 0 0"/><mass value="1.5"/>{INERTIA}</inertial>'
LIMIT = '<limit lower="-1" upper="2" effort="5" velocity="3"/>'


def joint(name: str, parent: str, child: str, kind: str = "revolute", more: str = LIMIT) -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>{more}</joint>'
    )


ARM = f"""\
<?xml version="1.0"?>
<!-- an arm -->
<robot name="arm">
  <link name="base"/>
  {joint("j1", "base", "upper", more=LIMIT + '<axis xyz="0 1 0"/><dynamics damping="0.2" friction="0.1"/>')}
  <link name="upper">{MASS}</link>
  {joint("j2", "upper", "lower", "continuous", '<origin xyz="0.4 0 0"/><axis xyz="0 2 0"/>')}
  <link name="lower">{MASS}</link>
</robot>
"""


def scene_with(tmp_path: Path, urdf: str, more: str = "") -> Path:
    (tmp_path / "arm.urdf").write_text(urdf, encoding="utf-8")
    path = tmp_path / "scene.yaml"
    path.write_text(f"schema: 1\ngravity: [0, 0, -9.81]\nrobot: arm.urdf\n{more}", encoding="utf-8")
    return path


def load(tmp_path: Path, urdf: str, more: str = "") -> Scene:
    return load_scene(scene_with(tmp_path, urdf, more))


# -- what is read --------------------------------------------------------------------------------------------
def test_a_scene_with_a_urdf_is_the_scene_in_yaml(tmp_path: Path) -> None:
    scene = load(tmp_path, ARM)
    written = """\
schema: 1
gravity: [0, 0, -9.81]
robot:
  joints:
    - {name: root_joint, type: fixed, parent: base, link: base_2}
    - name: j1
      type: revolute
      parent: base_2
      link: upper
      axis: [0, 1, 0]
      limits: {lower: -1, upper: 2, speed: 3, effort: 5}
      friction: {viscous: 0.2, coulomb: 0.1, law: set_valued}
    - {name: j2, type: revolute, parent: upper, link: lower, origin: {xyz: [0.4, 0, 0]}, axis: [0, 2, 0]}
  links:
    - {name: base_2, mass: 0}
    - {name: upper, mass: 1.5, com: [0.2, 0, 0], inertia: {xx: 0.1, yy: 0.1, zz: 0.1, xy: 0, xz: 0, yz: 0}}
    - {name: lower, mass: 1.5, com: [0.2, 0, 0], inertia: {xx: 0.1, yy: 0.1, zz: 0.1, xy: 0, xz: 0, yz: 0}}
"""
    assert scene.robot == load_scene_text(written).robot
    assert scene.notes == (f"{tmp_path}/arm.urdf: massless links: base",) and scene.warnings == ()
    assert str(tmp_path / "arm.urdf") in scene.sources
    # the text that results carry holds the robot, without the file
    assert load_scene_text(scene.text).robot == scene.robot


def test_it_runs_and_keys_can_be_set(tmp_path: Path) -> None:
    motion = (
        'trajectory: {type: joint, duration: 1, q: {j1: "0.5*t^2", j2: "0.3*t"}}\ninverse: {samples: 11}\n'
    )
    path = scene_with(tmp_path, ARM, motion)
    tau = inverse(load_scene(path))["tau"]
    heavier = inverse(load_scene(path, ["robot.links.lower.mass=3", "robot.joints.j2.limits={effort: 1}"]))
    assert np.all(np.abs(heavier["tau"][:, 0]) > np.abs(tau[:, 0]))
    assert any("joint 'j2'" in text for text in heavier.summary["warnings"])


def test_friction_sticks_in_a_simulation(tmp_path: Path) -> None:
    """The friction of the URDF is taken as it is: it holds the joint, no speed smooths it."""
    still = ARM.replace('friction="0.1"', 'friction="100"').replace('"continuous"', '"fixed"')
    result = simulate(
        load(tmp_path, still, "initial: {q: {j1: 0.3}}\nsimulate: {duration: 1, samples: 11}\n")
    )
    assert np.all(result["q"][:, 0] == 0.3)


def test_a_root_that_is_set_free(tmp_path: Path) -> None:
    path = scene_with(tmp_path, ARM.replace('<link name="base"/>', f'<link name="base">{MASS}</link>'))
    model = build_model(load_scene(path, ["robot.joints.root_joint.type=floating"]))
    assert model.joint_names == ("root_joint", "j1", "j2") and model.nv == 8


def test_an_inertia_in_turned_axes() -> None:
    """About z by 90 degrees x and y change places; oracle/test_urdf.py has the general case."""
    urdf = f'<robot name="r"><link name="a">{MASS}</link></robot>'.replace(
        '<origin xyz="0.2 0 0"/>', '<origin rpy="0 0 1.5707963267948966"/>'
    ).replace('ixx="0.1" ixy="0"', 'ixx="0.3" ixy="0.02"')
    found, scene = _loaded(urdf)
    inertia = scene.robot.links[0].inertia
    assert (inertia.xx, inertia.yy, inertia.zz) == (0.1, 0.3, 0.1) and abs(inertia.xy + 0.02) < 1e-17
    assert "turned" in found.tree.link_remarks["a"][0]


def _loaded(urdf: str):  # type: ignore[no-untyped-def]
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "robot.urdf"
        path.write_text(urdf, encoding="utf-8")
        return load_description(path)


@pytest.mark.parametrize(
    ("limit", "limits", "remark"),
    [
        ('<limit effort="4" velocity="2"/>', {"speed": 2, "effort": 4}, "leave no room"),
        ('<limit lower="-1" upper="1" effort="0" velocity="0"/>', {"lower": -1, "upper": 1}, "not stated"),
        ('<limit upper="1" effort="2" velocity="3"/>', {"lower": 0, "upper": 1, "speed": 3, "effort": 2}, ""),
        ('<limit lower="2" upper="1" effort="2" velocity="3"/>', {"speed": 3, "effort": 2}, "leave no room"),
        ("", {}, "no limits"),
    ],
)
def test_limits(limit: str, limits: dict[str, float], remark: str) -> None:
    found, scene = _loaded(ARM.replace(LIMIT, limit))
    stated = dict(scene.robot.joints[1].forces).get("limits")
    names = ("lower", "upper", "speed", "effort")
    given = {name: getattr(stated, name) for name in names if getattr(stated, name, None) is not None}
    assert given == limits
    assert stated is None or stated.stop is None
    assert any(remark in text for text in found.tree.joint_remarks["j1"]) or not remark
    crossed = [text for text in scene.warnings if "j1 (line 5: lower 2, upper 1)" in text]
    assert len(crossed) == ('lower="2" upper="1"' in limit)


@pytest.mark.parametrize(
    ("name", "target"),
    [
        ("arm.urdf", "arm_expanded.urdf"),
        ("arm.urdf.xacro", "arm.urdf"),
        ("arm.xacro", "arm.urdf"),
        ("arm", "arm.urdf"),
    ],
)
def test_the_advice_for_xacro_does_not_overwrite_the_file(tmp_path: Path, name: str, target: str) -> None:
    path = tmp_path / name
    path.write_text(ARM.replace("</robot>", "<xacro:macro name='x'/></robot>"), encoding="utf-8")
    with pytest.raises(SceneError) as caught:
        load_description(path)
    assert caught.value.message.endswith(f"xacro {path} > {tmp_path / target}")


def test_names_that_scenes_do_not_allow() -> None:
    assert joint_names(["a.b", "a_b", "a-b", "9", "pi", "t"]) == {
        "a_b": "a_b", "a.b": "a_b_2", "a-b": "a_b_3", "9": "_9", "pi": "pi_2", "t": "t_2",
    }  # fmt: skip
    assert link_names(["base", "base_2", "LFoot/FSR", "é"]) == {
        "base_2": "base_2", "base": "base_3", "LFoot/FSR": "LFoot_FSR", "é": "_",
    }  # fmt: skip
    taken, scene = _loaded(ARM.replace('"j1"', '"root_joint"'))
    assert [joint.name for joint in scene.robot.joints] == ["root_joint_2", "root_joint", "j2"]
    assert "in the URDF: 'base'" in taken.tree.link_remarks["base_2"]


def test_mimics_are_couplers(tmp_path: Path) -> None:
    """A mimic of a mimic, written before it; q3 = 2 q2 + 0.1, q2 = -q1."""
    urdf = f"""\
<robot name="hand">
  <link name="palm"/><link name="a">{MASS}</link><link name="b">{MASS}</link><link name="c">{MASS}</link>
  {joint("q3", "b", "c", more=LIMIT + '<mimic joint="q2" multiplier="2" offset="0.1"/>')}
  {joint("q1", "palm", "a")}
  {joint("q2", "a", "b", more=LIMIT + '<mimic joint="q1" multiplier="-1"/>')}
</robot>
"""
    more = (
        'actuated: [q1]\ntrajectory: {type: joint, duration: 1, q: {q1: "0.3*t"}}\ninverse: {samples: 11}\n'
    )
    scene = load(tmp_path, urdf, more)
    assert {c.name: c.terms for c in scene.couplers} == {"q3": {"q3": 1, "q2": -2}, "q2": {"q2": 1, "q1": 1}}
    result = inverse(scene)
    q3, q1, q2 = result["q"].T
    assert np.abs(q2 + q1).max() < 1e-12 and np.abs(q3 - 2 * q2 - 0.1).max() < 1e-12
    assert np.abs(result["tau"][:, 0]).max() == 0.0 and np.abs(result["tau"][:, 2]).max() == 0.0


def test_massless_links(tmp_path: Path) -> None:
    """Listed once; one with a shape that moves is a warning, one on the ground or without a shape is not."""
    shape = "<visual><geometry><sphere radius='0.1'/></geometry></visual>"
    urdf = ARM.replace("</robot>", joint("f", "lower", "camera", "fixed", "") + joint("g", "base", "plate", "fixed", "")
                       + joint("h", "lower", "frame", "fixed", "")
                       + f'<link name="camera">{shape}</link><link name="plate">{shape}</link><link name="frame"/></robot>')  # fmt: skip
    path = scene_with(tmp_path, urdf)
    scene = load_scene(path)
    assert scene.notes == (f"{tmp_path}/arm.urdf: massless links: base, camera, plate, frame",)
    assert len(scene.warnings) == 1 and scene.warnings[0].endswith(": camera")
    assert [f.severity for f in findings(path)] == ["warning"]
    assert [f.exit_code for f in findings(path, strict=True)] == [2]


def test_a_joint_that_moves_no_mass_is_named(tmp_path: Path) -> None:
    urdf = ARM.replace(f'<link name="lower">{MASS}</link>', '<link name="lower"/>')
    with pytest.raises(NumericalError, match="joint 'j2' moves nothing that has inertia"):
        simulate(load(tmp_path, urdf, "initial: {q: {j1: 0, j2: 0}}\n"))


def test_an_inertia_that_cannot_be_is_a_warning(tmp_path: Path) -> None:
    path = scene_with(tmp_path, ARM.replace('iyy="0.1"', 'iyy="0.9"'))
    assert [f.severity for f in findings(path)] == ["warning", "warning"]
    assert str(findings(path)[0].file).endswith("arm.urdf") and findings(path)[0].line == 6


# -- what is refused -----------------------------------------------------------------------------------------
BOMB = """\
<!DOCTYPE robot [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;&a;">]>
<robot name="&b;"><link name="a"/></robot>
"""


@pytest.mark.parametrize(
    ("old", "new", "line", "words"),
    [
        ('<robot name="arm">', '<robot name="arm"', 4, "this is not XML"),
        (None, BOMB, 1, "document type"),
        (None, '<!DOCTYPE robot SYSTEM "file:///etc/passwd"><robot/>', 1, "document type"),
        (None, "<robot>" + "<a>" * 200_000, 1, "nested more than 50 deep"),
        (None, "<arm><link name='a'/></arm>", 1, "root element is <arm>; allowed: <robot>, <sdf>, <mujoco>"),
        (None, "<robot name='x'/>", 1, "no <link>"),
        ("</robot>", "<xacro:macro name='x'/></robot>", 9, "run it first: xacro"),
        ('value="1.5"', 'value="${m}"', 6, "is an expression of xacro"),
        ('value="1.5"', 'value="-1.5"', 6, "mass is negative .*allowed: a number >= 0"),
        ('value="1.5"', 'value="nan"', 6, "link 'upper': value of <mass> is 'nan'; allowed: a finite number"),
        ('value="1.5"', 'value="2,5"', 6, "is '2,5'"),
        ('value="1.5"', 'value="1e999"', 6, "is '1e999'"),
        ('izz="0.1"', "", 6, "izz of <inertia> is missing"),
        ('xyz="0.2 0 0"', 'xyz="0.2 0"', 6, "3 finite numbers"),
        (INERTIA, "", 6, "needs <mass value=...> and <inertia"),
        (MASS, MASS + MASS, 6, "second <inertial>"),
        ('"0 1 0"', '"0 0 0"', 5, "joint 'j1': the axis is zero"),
        ('name="j2"', 'name="j1"', 7, "joint 'j1' appears twice"),
        ('name="j2"', "", 7, "a joint: <joint> needs the attribute 'name'"),
        ("</robot>", '<link name="upper"/></robot>', 9, "link 'upper' appears twice"),
        ('"continuous"', '"hinge"', 7, "unknown type 'hinge'; allowed: revolute, continuous"),
        ('child link="lower"', 'child link="lowr"', 7, "its child 'lowr' is no link of this file .did you mean 'lower'"),
        ('<child link="lower"/>', "", 7, "needs <child link=...>"),
        ('child link="lower"', 'child link="upper"', 7, "moves link 'upper', which joint 'j1' moves already"),
        ("</robot>", "<link name='x'/></robot>", 9, "no joint moves the links 'base', 'x'; allowed: one root"),
        ('damping="0.2"', 'damping="-1"', 5, "damping is negative"),
        ("</joint>", '<mimic joint="j1"/></joint>', 5, "joint 'j1' mimics itself"),
        ("</joint>", '<mimic joint="j9"/></joint>', 5, "mimics 'j9', a joint that is not there; allowed: j2"),
        ("</joint>", "<mimic/></joint>", 5, "needs the attribute 'joint'"),
    ],
)  # fmt: skip
def test_what_is_refused(tmp_path: Path, old: str | None, new: str, line: int, words: str) -> None:
    """One message with file, line and what is allowed; a scene that names the file and `import` say the same."""
    urdf = new if old is None else ARM.replace(old, new, 1)
    path = scene_with(tmp_path, urdf)
    with pytest.raises(SceneError, match=words) as caught:
        load_scene(path)
    assert caught.value.details["file"] == str(tmp_path / "arm.urdf") and caught.value.details["line"] == line
    with pytest.raises(SceneError, match=words):
        load_description(tmp_path / "arm.urdf")


@pytest.mark.parametrize(
    "element, words",
    [
        ("<drake:linear_bushing_rpy/>", "<drake:linear_bushing_rpy>"),
        ('<transmission><drake:rotor_inertia value="1"/></transmission>', "rotor_inertia"),
        (
            '<drake:distance_constraint><drake:distance_constraint_stiffness value="9"/></drake:distance_constraint>',
            "distance_constraint_stiffness",
        ),
        ("<drake:a_tag_of_next_year/>", "<drake:a_tag_of_next_year>"),
        ('<gazebo><joint name="g" type="revolute"><parent>upper</parent></joint></gazebo>', "<joint> 'g'"),
        ('<gazebo><model><joint name="m" type="ball"/></model></gazebo>', "<joint> 'm'"),
        (
            '<gazebo reference="shoulder"><springStiffness> 0.5 </springStiffness></gazebo>',
            "<springStiffness>",
        ),
    ],
)
def test_what_acts_on_the_motion_is_never_left_out(tmp_path: Path, element: str, words: str) -> None:
    """At the end of the file, so in line 9; ``import`` says the same."""
    urdf = ARM.replace("</robot>", f"{element}\n</robot>")
    for read in (lambda: load(tmp_path, urdf), lambda: load_description(tmp_path / "arm.urdf", {})):
        with pytest.raises(SceneError, match="acts on the motion, and is not read; allowed: ") as caught:
            read()
        assert words in str(caught.value) and ":9:" in str(caught.value)


@pytest.mark.parametrize(
    "right, slip, words",
    [
        ("<axis ", "<Axis ", "<Axis> in <joint> is not known (did you mean 'axis'?)"),
        ("<origin ", "<orgin ", "<orgin> in "),
        ("xyz=", "xzy=", "'xzy' of <"),
        ("damping=", "dampng=", "'dampng' of <dynamics> is not known (did you mean 'damping'?)"),
        ("<joint name=", '<joint independent="no" name=', "independent is 'no'; allowed: true or false"),
        (
            "<dynamics ",
            '<dynamics spring_stiffness="3" ',
            "'spring_stiffness' of <dynamics> acts on the motion",
        ),
    ],
)
def test_a_slip_of_the_pen_is_never_left_out(tmp_path: Path, right: str, slip: str, words: str) -> None:
    assert right in ARM
    with pytest.raises(SceneError, match=r"arm\.urdf:\d+:\d+: ") as caught:
        load(tmp_path, ARM.replace(right, slip, 1))
    assert words in str(caught.value)


def test_attributes_of_other_programs_are_told(tmp_path: Path) -> None:
    scene = load(tmp_path, ARM.replace("<dynamics ", '<dynamics k_velocity="3" ', 1))
    assert "1 <dynamics k_velocity=...>" in scene.notes[0]


def test_a_yaml_file_beside_the_urdf_is_read_for_its_loops_alone(tmp_path: Path) -> None:
    (tmp_path / "arm.yaml").write_text("schema: 1\n", encoding="utf-8")
    assert str(tmp_path / "arm.yaml") not in load(tmp_path, ARM).sources


def test_what_is_left_out_is_told(tmp_path: Path) -> None:
    more = """<material name="red"/><transmission name="t"><joint name="j1"/></transmission>
<gazebo reference="j1"><plugin name="p"><joint>j1</joint></plugin></gazebo>
<drake:collision_filter_group name="f"/>"""
    urdf = ARM.replace("</robot>", f"{more}\n</robot>").replace(
        'friction="0.1"/>', '/><calibration rising="0"/>'
    )
    scene = load(tmp_path, urdf, "initial: {q: {j1: 0.3, j2: 0}}\nsimulate: {duration: 0.1, samples: 3}\n")
    told = "1 <material>, 1 <transmission>, 1 <gazebo>, 1 <drake:collision_filter_group>, 1 <calibration>"
    assert scene.notes[0] == f"{tmp_path}/arm.urdf: left out, for no equation reads it: {told}"
    assert simulate(scene).summary["notes"] == list(scene.notes)


def test_loops_and_mimics_in_circles(tmp_path: Path) -> None:
    loop = f'<robot name="r"><link name="r0"/>{joint("a", "x", "y")}{joint("b", "y", "x")}<link name="x"/><link name="y"/></robot>'
    with pytest.raises(SceneError, match="loop of links .x -> y -> x."):
        load(tmp_path, loop)
    circle = ARM.replace("</joint>", '<mimic joint="j2"/></joint>', 1)
    circle = circle[::-1].replace("</joint>"[::-1], '<mimic joint="j1"/></joint>'[::-1], 1)[::-1]
    with pytest.raises(SceneError, match="'j1' mimics itself .j1 -> j2 -> j1."):
        load(tmp_path, circle)


def test_a_mimic_of_a_mimic_of_nothing(tmp_path: Path) -> None:
    lost = ARM.replace("</joint>", '<mimic joint="j2"/></joint>', 1)
    lost = lost[::-1].replace("</joint>"[::-1], '<mimic joint="j9"/></joint>'[::-1], 1)[::-1]
    with pytest.raises(SceneError, match="'j2' mimics 'j9', a joint that is not there"):
        load(tmp_path, lost)


def test_all_errors_are_listed(tmp_path: Path) -> None:
    broken = ARM.replace('value="1.5"', 'value="x"').replace('"0 1 0"', '"0 0 0"') + " "
    found = examine(scene_with(tmp_path, broken, "actuatd: []\n")).errors
    assert [(e.details["file"][-4:], e.details["line"]) for e in found] == [
        ("urdf", 5), ("urdf", 6), ("urdf", 8), ("yaml", 4),
    ]  # fmt: skip


def test_a_trajectory_is_no_urdf(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="arm.urdf' is XML; allowed: the path of a YAML file"):
        load(tmp_path, ARM, "trajectory: arm.urdf\n")


def test_large_files_take_linear_time(tmp_path: Path) -> None:
    """A chain of thousands of links, written from its end: no search is repeated for each."""

    def seconds(n: int) -> float:
        links = "".join(f'<link name="l{k}"/>' for k in range(n + 1))
        joints = "".join(joint(f"j{k}", f"l{k}", f"l{k + 1}", "fixed", "") for k in reversed(range(n)))
        from robodyn_cli.scene.dialects import read_description
        from robodyn_cli.scene.text.nodes import Faults, Source

        gc.collect()
        gc.disable()  # it goes through all objects again and again
        try:
            start = time.process_time()
            read_description(f"<robot>{links}{joints}</robot>", Source("x", "."), Faults(), {})
            return time.process_time() - start
        finally:
            gc.enable()

    assert min(seconds(1600) for _ in range(2)) < 24 * min(seconds(200) for _ in range(2))


# -- meshes --------------------------------------------------------------------------------------------------
def test_where_meshes_are_looked_for(tmp_path: Path) -> None:
    for name in ("arm_description/meshes/a.stl", "arm_description/urdf/b.stl", "elsewhere/c.stl"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("solid")
    urdf = str(tmp_path / "arm_description" / "urdf" / "arm.urdf")
    expected = {
        "package://arm_description/meshes/a.stl": "arm_description/meshes/a.stl",
        "../meshes/a.stl": "arm_description/meshes/a.stl",
        "b.stl": "arm_description/urdf/b.stl",
        f"file://{tmp_path}/elsewhere/c.stl": "elsewhere/c.stl",
        "package://tools/c.stl": "elsewhere/c.stl",
        "package://arm_description/none.stl": None,
    }
    packages = {"tools": str(tmp_path / "elsewhere")}
    for name, file in expected.items():
        assert mesh_file(name, urdf, packages) == (None if file is None else str(tmp_path / file)), name
    assert mesh_file("package://tools/c.stl", urdf, {}) is None


def test_many_names_are_looked_up_and_not_searched_for() -> None:
    """Some 0.1 s; searching for each among those before it would take a minute."""
    names = [f"a{chr(0x4E00 + k)}" for k in range(20_000)]
    start = time.process_time()
    assert len(set(scene_names(names, ()).values())) == len(names)
    assert time.process_time() - start < 10.0
    assert list(scene_names(["a b", "a_b", "a.b", "a-b"], ()).values()) == ["a_b", "a_b_2", "a_b_3", "a_b_4"]


def test_of_very_many_links_notes_name_the_first(tmp_path: Path) -> None:
    file = tmp_path / "star.urdf"
    parts = [
        f'<link name="l{k}"/><joint name="j{k}" type="continuous"><parent link="b"/><child link="l{k}"/></joint>'
        for k in range(300)
    ]
    file.write_text(f'<robot name="r"><link name="b"/>{"".join(parts)}</robot>')
    (note,) = load_description(file)[0].notes
    assert note.startswith("massless links: b, l0, l1,") and note.endswith("l98, ... (301 in all)")
