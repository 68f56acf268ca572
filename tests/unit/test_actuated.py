"""Joints with motors: those of the scene, or of its robot, in whatever format that is."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from robodyn_cli import inverse
from robodyn_cli.cli.app import run
from robodyn_cli.errors import CapabilityError, SceneError
from robodyn_cli.scene.descriptions import load_description
from robodyn_cli.scene.load import load_scene, load_scene_text

INERTIA = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
YAML = """\
joints: [{name: a, type: revolute, axis: [0, 0, 1]}, {name: b, type: prismatic, axis: [1, 0, 0]}]
links: [{name: l, mass: 1, com: [0, 0, 0]}, {name: m, mass: 1, com: [0, 0, 0]}]
"""
TEXT = "schema: 1\ngravity: [0, 0, 0]\nrobot: {}\ninitial: {{q: {{a: 0, b: 0}}}}\n"


def urdf(folder: Path, *limits: str) -> Path:
    """Return a URDF with a joint for each limit, empty for none."""
    joints = "".join(
        f'<joint name="j{k}" type="{"revolute" if limit else "continuous"}"><parent link="l{k}"/><child link="l{k + 1}"/>'
        f'<origin xyz="1 0 0"/>{limit and f"<limit {limit}/>"}</joint>'
        for k, limit in enumerate(limits)
    )
    links = "".join(f'<link name="l{k}">{INERTIA}</link>' for k in range(len(limits) + 1))
    path = folder / "robot.urdf"
    path.write_text(f'<robot name="r">{links}{joints}</robot>', encoding="utf-8")
    return path


SOME, NONE = 'effort="2" velocity="1"', 'effort="0" velocity="1"'


@pytest.mark.parametrize(
    ("limits", "motors"),
    [
        ((SOME, NONE, ""), ("j0", "j2")),
        ((SOME, SOME), None),
        ((NONE, NONE), None),  # placeholders
        ((NONE, ""), None),
    ],
)
def test_efforts_of_a_urdf(limits: tuple[str, ...], motors: tuple[str, ...] | None, tmp_path: Path) -> None:
    scene = load_description(urdf(tmp_path, *limits))[1]
    assert scene.actuated == motors


def test_efforts_of_an_sdf(tmp_path: Path) -> None:
    """No effort is none that is bounded; ``0`` is no motor, as Drake reads it."""
    parts = "".join(
        f'<link name="{k}"/><joint name="j{k}" type="revolute"><parent>world</parent><child>{k}</child>'
        f"<axis><xyz>0 0 1</xyz>{limit}</axis></joint>"
        for k, limit in (("x", ""), ("y", "<limit><effort>0</effort></limit>"))
    )
    path = tmp_path / "robot.sdf"
    path.write_text(f'<sdf version="1.9"><model name="m">{parts}</model></sdf>', encoding="utf-8")
    assert load_description(path)[1].actuated == ("jx",)


def test_actuators_of_an_mjcf(tmp_path: Path) -> None:
    """Whatever acts on joints; with one that acts on something else nobody knows which joints it moves."""
    pytest.importorskip("mujoco")
    body = '<body><joint name="{0}"/><joint name="{0}2"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body>'
    tendon = '<tendon><fixed name="t"><joint joint="c" coef="1"/></fixed></tendon>'
    held = '<equality><joint joint1="a2"/></equality>'
    path = tmp_path / "robot.xml"
    for more, motors in (("", ("a", "c")), ('<motor tendon="t"/>', None), ('<muscle joint="c2"/>', None)):
        path.write_text(
            f"<mujoco><worldbody>{body.format('a')}{body.format('c')}</worldbody>{tendon}{held}<actuator>"
            f'<motor joint="a2"/><position joint="c"/><motor joint="a"/>{more}</actuator></mujoco>'
        )
        assert load_description(path)[1].actuated == motors


def test_a_scene_says_otherwise(tmp_path: Path) -> None:
    robot = str(urdf(tmp_path, SOME, NONE))
    text = f"schema: 1\ngravity: [0, 0, 0]\nrobot: {robot}\n"
    assert load_scene_text(text).actuated == ("j0",)
    assert load_scene_text(f"{text}actuated: [j1, j0]\n").actuated == ("j1", "j0")
    with pytest.raises(SceneError, match="joint 'j1' is not in 'actuated'; allowed: j0"):
        load_scene_text(f"{text}torques: {{j1: 3}}\n")
    beside = text.replace(f"robot: {robot}", f"robot: {{include: {robot}, actuated: [j1]}}")
    assert load_scene_text(beside).actuated == ("j1",)


def test_robots_that_are_attached(tmp_path: Path) -> None:
    """All joints of a part that does not say count, with the prefix of their names."""
    (tmp_path / "some.yaml").write_text(f"{YAML}actuated: [b]\n", encoding="utf-8")
    (tmp_path / "all.yaml").write_text(YAML, encoding="utf-8")
    for first, second, motors in (
        ("some", "all", ("b", "x_a", "x_b")),
        ("all", "some", ("a", "b", "x_b")),
        ("all", "all", None),
        ("some", "some", ("b", "x_b")),
    ):
        robot = f"{{include: {first}.yaml, attach: [{{include: {second}.yaml, prefix: x_, to: m}}]}}"
        scene = load_scene_text(TEXT.format(robot), str(tmp_path / "scene.yaml"))
        assert scene.actuated == motors


def test_errors_are_where_the_motors_are_named(tmp_path: Path) -> None:
    robot = (
        "{joints: [{name: a, type: revolute, axis: [0, 0, 1]}], links: [{name: l, mass: 1}],\n actuated: [c]}"
    )
    with pytest.raises(SceneError, match=r"<text>:4:13: robot.actuated.0: unknown joint 'c'; allowed: a"):
        load_scene_text(TEXT.format(robot))


def test_a_chain_with_a_joint_that_nothing_drives(tmp_path: Path, capsys: Any) -> None:
    """Refused with the place at which the robot says so."""
    path = tmp_path / "scene.yaml"
    path.write_text(
        f"schema: 1\ngravity: [0, 0, 0]\nrobot: {urdf(tmp_path, SOME, NONE)}\n"
        "trajectory: {type: joint, duration: 1, q: {j0: t, j1: 0}}\n"
    )
    with pytest.raises(CapabilityError, match="'actuated' lacks 'j1'"):
        inverse(load_scene(path))
    assert run(["inverse", str(path), "--no-plots", "--out", str(tmp_path / "out")]) == 2
    assert "robot.urdf:1:1: robot.actuated: inverse dynamics needs" in " ".join(
        capsys.readouterr().err.split()
    )


def test_info_says_which_joints_have_motors(tmp_path: Path, capsys: Any) -> None:
    path = tmp_path / "scene.yaml"
    for limits, said in (((SOME, NONE), [True, False]), ((SOME, SOME), [None, None])):
        path.write_text(f"schema: 1\ngravity: [0, 0, 0]\nrobot: {urdf(tmp_path, *limits)}\n")
        words = ["info", str(path), "--no-plots", "--out", str(tmp_path / "out")]
        assert run(words) == 0
        assert ("j0 (revolute, motor) -> l1" in capsys.readouterr().out) == (said[0] is True)
        assert run([*words, "--json"]) == 0
        assert [joint["actuated"] for joint in json.loads(capsys.readouterr().out)["joints"]][1:] == said
