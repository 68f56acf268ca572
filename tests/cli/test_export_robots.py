"""``robodyn export SCENE``: what is written, what is said of it, and what is refused with one message."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from robodyn_cli.cli.app import run
from robodyn_cli.scene.descriptions import load_robot

SCENE = """\
schema: 1
gravity: [0, 0, -9.81]
robot:
  joints:
    - {name: hip, type: revolute, axis: [0, 1, 0], limits: {lower: -1, upper: 1, speed: 4, acceleration: 5}}
    - {name: knee, type: revolute, axis: [0, 1, 0], origin: {xyz: [0, 0, -0.4], rpy: [0.1, 0, 0.3]}}
  links:
    - {name: world, mass: 2, com: [0, 0, -0.2], inertia: {xx: 0.03, yy: 0.03, zz: 0.01}}
    - {name: shank, mass: 1, com: [0, 0, -0.2], inertia: {xx: 0.02, yy: 0.02, zz: 0.01}, visual: [{sphere: 0.1}]}
  points: {foot: {link: shank, at: [0, 0, -0.4]}}
actuated: [hip]
torques: {hip: 0.1}
"""


def export(tmp_path: Path, kind: str, scene: str = SCENE) -> tuple[int, Path]:
    path = tmp_path / "leg.yaml"
    path.write_text(scene, encoding="utf-8")
    return run(["export", str(path), "--to", kind, "--out", str(tmp_path / "out")]), tmp_path / "out"


@pytest.mark.parametrize(
    ("kind", "files"),
    [
        ("urdf+", ["leg.urdf"]),
        ("extended-urdf", ["leg.urdf", "leg.yaml"]),
        ("mjcf", ["leg.xml"]),
        ("sdf", ["leg.sdf"]),
    ],
)
def test_what_is_written_and_said(kind: str, files: list[str], tmp_path: Path, capsys: Any) -> None:
    code, out = export(tmp_path, kind)
    said = capsys.readouterr()
    assert code == 0 and sorted(path.name for path in out.iterdir()) == files
    assert ("speed of hip" in said.err) == (kind == "mjcf")
    assert "acceleration of hip" in said.err and "1 shapes of links, 1 points, torques" in said.err
    assert ("world is world_2" in said.err) == (
        kind in ("mjcf", "sdf")
    )  # where the name is kept for the world
    assert kind != "extended-urdf" or "name_mot: [hip]" in (out / "leg.yaml").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("kind", "source"), [("extended-urdf", "leg.yaml"), ("urdf+", "leg.urdf"), ("mjcf", "leg.xml")]
)
def test_what_a_robot_is_read_from_is_not_replaced(
    kind: str, source: str, tmp_path: Path, capsys: Any
) -> None:
    """A scene is named like the file of the Extended URDF beside the robot, a robot like itself."""
    if source == "leg.yaml":
        path = tmp_path / source
        path.write_text(SCENE, encoding="utf-8")
    else:
        if kind == "mjcf":
            pytest.importorskip("mujoco")
        path = export(tmp_path, kind)[1] / source
    before = path.read_bytes()
    assert run(["export", str(path), "--to", kind, "--out", str(path.parent)]) == 2
    assert f"{path} is what the robot is read from; allowed: another directory" in capsys.readouterr().err
    assert path.read_bytes() == before


def test_origins_keep_their_digits(tmp_path: Path) -> None:
    _, out = export(tmp_path, "urdf+")
    assert 'xyz="0.0 0.0 -0.4" rpy="0.1 0.0 0.3"' in (out / "leg.urdf").read_text(encoding="utf-8")


def test_the_report_as_json(tmp_path: Path, capsys: Any) -> None:
    path = tmp_path / "leg.yaml"
    path.write_text(SCENE, encoding="utf-8")
    assert run(["export", str(path), "--to", "sdf", "--out", str(tmp_path / "o"), "--json", "--quiet"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["files"] == [str(tmp_path / "o" / "leg.sdf")] and any(
        "gravity" in x for x in report["notes"]
    )


def test_a_description_is_exported_as_it_is_read(tmp_path: Path) -> None:
    """From URDF to SDF and back, by files alone; without gravity of its own a robot has that of the earth."""
    _, out = export(tmp_path, "urdf+")
    urdf = out / "leg.urdf"
    assert load_robot(urdf).gravity == (0.0, 0.0, -9.81)
    assert run(["export", str(urdf), "--to", "sdf", "--out", str(out)]) == 0
    assert run(["export", str(out / "leg.sdf"), "--to", "mjcf", "--out", str(out)]) == 0
    assert 'gravity="0.0 0.0 -9.81"' in (out / "leg.xml").read_text(encoding="utf-8")
    changed = ["--set", "gravity=[0, 0, -1.62]"]
    assert run(["export", str(urdf), "--to", "mjcf", "--out", str(out / "moon"), *changed]) == 0
    assert 'gravity="0.0 0.0 -1.62"' in (out / "moon" / "leg.xml").read_text(encoding="utf-8")


@pytest.mark.parametrize(("kind", "file"), [("urdf+", "leg.urdf"), ("extended-urdf", "leg.urdf"), ("mjcf", "leg.xml"), ("sdf", "leg.sdf")])  # fmt: skip
def test_motors_come_back(kind: str, file: str, tmp_path: Path, capsys: Any) -> None:
    """By name_mot, by motors, or by an effort of 0 where there is none; where all have some, nothing is said."""
    if kind == "mjcf":
        pytest.importorskip("mujoco")
    for motors, read in (("[hip]", ("hip",)), ("[hip, knee]", None)):
        export(tmp_path, kind, SCENE.replace("[hip]", motors))
        scene = load_robot(tmp_path / "out" / file)
        kept = kind in ("mjcf", "extended-urdf")
        assert scene.actuated == scene.robot.actuated == (("hip", "knee") if kept and read is None else read)
        assert any("joints with motors: hip" in note for note in scene.notes) == (scene.actuated is not None)
    rotor = SCENE.replace("axis: [0, 1, 0], origin", "axis: [0, 1, 0], rotor_inertia: 0.1, origin")
    capsys.readouterr()
    export(tmp_path, kind, rotor)
    assert ("left out, that they have no motor: knee" in capsys.readouterr().err) != kept


LOOP = "loops: [{name: bar, type: distance, between: [foot, base.origin], length: 0.9}]\n"


@pytest.mark.parametrize(
    ("kind", "change", "words"),
    [
        ("urdf+", ("type: revolute, axis: [0, 1, 0], origin", "type: helical, pitch: 0.1, axis: [0, 1, 0], origin"),
         "joint 'knee': helical (allowed: revolute, prismatic, fixed, floating, planar)"),
        ("mjcf", ("actuated:", LOOP + "actuated:"), "loop 'bar': distance (allowed: spherical, fixed, revolute)"),
        ("extended-urdf", ("actuated:", LOOP.replace("distance", "revolute").replace(", length: 0.9", "") + "actuated:"),
         "loop 'bar': revolute (allowed: spherical, fixed); in urdf+ or mjcf or sdf it can be"),
        ("urdf+", ("acceleration: 5}", "acceleration: 5}, spring: {stiffness: 2}"), "spring of 'hip': springs are not"),
        ("sdf", ("acceleration: 5", "stop: {stiffness: 9}"), "limits of 'hip': how stops give way"),
        ("mjcf", ("acceleration: 5}", "acceleration: 5}, gear: {efficiency: 0.9}"), "gear of 'hip': losses of gears"),
        ("mjcf", ("acceleration: 5}", "acceleration: 5}, friction: {coulomb: {positive: 1, negative: -2}}"),
         "friction of 'hip': the format has one level"),
        ("sdf", ("actuated:", "forces: [{name: push, type: force, at: foot, force: [1, 0, 0]}]\nactuated:"), "force 'push'"),
        ("mjcf", ("actuated:", "payloads: [{name: box, at: foot, mass: 1}]\nactuated:"), "payload 'box'"),
        ("sdf", ("actuated:", 'couplers: [{name: c, terms: {hip: 1, knee: 2}, value: "t"}]\nactuated:'),
         "coupler 'c': its value changes in time"),
        ("mjcf", ("mass: 1, com: [0, 0, -0.2], inertia: {xx: 0.02, yy: 0.02, zz: 0.01}", "mass: 0"),
         "link 'shank' moves and has no mass"),
        ("mjcf", ("inertia: {xx: 0.02, yy: 0.02, zz: 0.01}", "inertia: {xx: 0, yy: 0, zz: 0}"),
         "link 'shank' has no moment of inertia about some axis"),
        ("mjcf", ("inertia: {xx: 0.02, yy: 0.02", "inertia: {xx: 0.02, yy: 0.06"), "that no body can have"),
        ("sdf", ("name: hip, type", "name: shank, type"), "'shank' names a joint and a link"),
        ("mjcf", ("mass: 1, com: [0, 0, -0.2]", "mass: 1"), "data that the scene does not give: com[0] of shank"),
    ],
)  # fmt: skip
def test_what_is_refused(kind: str, change: tuple[str, str], words: str, tmp_path: Path, capsys: Any) -> None:
    """One message with everything that the format has not; nothing is written."""
    text = SCENE.replace(*change).replace("[hip]", "[knee]").replace("{hip: 0.1}", "{knee: 0.1}")
    code, out = export(tmp_path, kind, text)
    said = capsys.readouterr().err
    assert (
        code == 2
        and said.count("robodyn: error: ") == 1
        and words in " ".join(said.split())
        and not out.exists()
    )


def test_a_scene_is_no_result_and_a_result_no_scene(tmp_path: Path, capsys: Any) -> None:
    code, _ = export(tmp_path, "csv")
    assert (
        code == 2
        and "is a scene, of which --to csv writes nothing; allowed: urdf+" in capsys.readouterr().err
    )
    assert run(["export", str(tmp_path), "--to", "mjcf", "--out", str(tmp_path)]) == 2
    assert "is a result, of which --to mjcf writes nothing; allowed: csv" in capsys.readouterr().err
