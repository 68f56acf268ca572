"""The scenes in configs/: each loads, says what the lecture and the design say, and survives a round trip."""

from __future__ import annotations

import dataclasses
import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robodyn_cli.commands import SCENE_COMMANDS
from robodyn_cli.errors import SceneError
from robodyn_cli.scene import load_scene, load_scene_text
from robodyn_cli.scene.types import Link, Scene

CONFIGS = Path(__file__).parents[2] / "configs"
SCENES = sorted(
    path
    for folder in (".", "benchmarks", "mechanisms", "published", "search", "trajectories")
    for path in (CONFIGS / folder).glob("*.yaml")
)


def load(name: str) -> Scene:
    return load_scene(CONFIGS / f"{name}.yaml")


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_loads_and_its_text_loads_again(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = load_scene(path)
    assert scene.path == str(path)
    assert scene.sources[0] == str(path)
    assert scene.title and scene.command in SCENE_COMMANDS
    monkeypatch.chdir(tmp_path)  # the text must not need any file
    again = load_scene_text(scene.text)
    assert again == scene
    assert again.text == scene.text
    assert path.read_text().startswith("#"), "a comment says what the scene shows"


def test_every_robot_file_is_used() -> None:
    used = {Path(source).resolve() for path in SCENES for source in load_scene(path).sources}
    robots = [path for kind in ("*.yaml", "*.urdf") for path in CONFIGS.rglob(kind)]
    # the example catalogue of motors comes with the program
    assert {path.resolve() for path in robots} == {path for path in used if CONFIGS.resolve() in path.parents}


def numbers(link: Link) -> tuple[Any, ...]:
    assert link.com is not None
    return link.mass, link.com, link.com_frame, link.inertia.zz, link.inertia.xx


@pytest.mark.parametrize("name", ["2r_circle", "double_pendulum"])
def test_the_lectures_arm(name: str) -> None:
    scene = load(name)
    assert scene.gravity == (0.0, -9.81, 0.0)
    assert scene.robot.convention == "standard"
    assert [(j.name, j.type, j.a, j.alpha, j.d) for j in scene.robot.joints] == [
        ("theta1", "revolute", 1.0, 0.0, 0.0),
        ("theta2", "revolute", 1.0, 0.0, 0.0),
    ]
    assert [numbers(link) for link in scene.robot.links] == [
        (12.456, (0.773, 0.0, 0.0), "joint", 1.042, None),
        (12.456, (0.583, 0.0, 0.0), "joint", 1.042, None),
    ]
    assert scene.robot.points["tip"].link == "link2" and scene.robot.points["tip"].at == "end"


def test_circle() -> None:
    scene = load("2r_circle")
    circle = scene.trajectory
    assert scene.command == "inverse" and scene.inverse.samples == 1001
    assert (circle.type, circle.point, circle.center, circle.radius) == ("circle", "tip", (1.2, 1.2), 0.2)
    assert circle.duration == 10.0 and circle.turns == 1.0 and circle.ik.branch == "elbow_up"


def test_double_pendulum() -> None:
    scene = load("double_pendulum")
    assert scene.initial.q == {"theta1": -math.pi / 2, "theta2": math.pi / 4}
    assert scene.initial.qd == {"theta1": 0.0, "theta2": 0.0}
    assert scene.torques == {} and scene.command == "simulate"
    options = scene.simulate
    assert (options.duration, options.samples, options.rtol, options.atol) == (10.0, 1001, 1e-10, 1e-12)


@pytest.mark.parametrize("name", ["four_bar_deploy", "four_bar_prescribed"])
def test_the_lectures_four_bar(name: str) -> None:
    scene = load(name)
    assert scene.command == "deploy" and scene.gravity == (0.0, 0.0, 0.0)
    robot = scene.robot
    assert [(j.name, j.parent, j.link, j.a) for j in robot.joints] == [
        ("theta1", "base", "crank", 1.241),
        ("phi2", "crank", "coupler", 1.2),
        ("phi1", "base", "follower", 1.2),
    ]
    assert robot.joints[2].origin is not None and robot.joints[2].origin.xyz == (1.241, 0.0, 0.0)
    assert [numbers(link) for link in robot.links] == [
        (20.15, (1.2, 0.0, 0.0), "joint", 9.6, None),
        (8.25, (0.6, 0.0, 0.0), "joint", 0.06, None),
        (8.25, (0.6, 0.0, 0.0), "joint", 0.06, None),
    ]
    assert [(p.name, p.type, p.between) for p in scene.loops] == [
        ("pin", "revolute", ("coupler.end", "follower.end"))
    ]
    assert scene.actuated == ("theta1",)
    assert scene.initial.q == {"theta1": 0.01, "phi1": 0.0102} and scene.initial.hold == ("theta1",)
    assert (scene.deploy.criterion, scene.deploy.growth) == ("dead_point", 1000.0)
    assert scene.deploy.latch is not None and scene.deploy.latch.between == ("coupler", "follower")


def test_the_spring_of_the_four_bar() -> None:
    scene = load("four_bar_deploy")
    assert scene.torques["theta1"].evaluate({"q.theta1": 2.0}) == 1.96 - 0.1 * 2.0
    assert (scene.simulate.duration, scene.simulate.samples) == (20.0, 2001)
    assert scene.prescribed == {}


def test_the_prescribed_crank_passes_the_dead_point() -> None:
    scene = load("four_bar_prescribed")
    motion = scene.prescribed["theta1"]
    assert scene.torques == {}
    assert motion.evaluate({"t": 0.0}) == scene.initial.q["theta1"]
    assert motion.evaluate({"t": scene.simulate.duration}) > math.radians(150.462302)


def test_parallelogram_starts_closed_and_its_rods_are_uniform() -> None:
    scene = load("parallelogram")
    crank, coupler, follower = scene.robot.joints
    q = scene.initial.q
    assert (crank.a, coupler.a, follower.a) == (1.0, 2.0, 1.0)
    assert follower.origin is not None
    angle = q["theta1"]
    end = [crank.a * f(angle) + coupler.a * f(angle + q["phi2"]) for f in (math.cos, math.sin)]
    other = [follower.origin.xyz[0] + math.cos(q["phi1"]), math.sin(q["phi1"])]
    assert end == pytest.approx(other, abs=1e-15)
    for joint, link in zip(scene.robot.joints, scene.robot.links):
        assert joint.a is not None and link.com == (joint.a / 2, 0.0, 0.0)
        assert link.mass == joint.a  # 1 kg/m
        assert link.inertia.zz == pytest.approx(joint.a**3 / 12, rel=1e-15)
    assert scene.gravity == (0.0, 0.0, 0.0)


def test_the_three_arms_are_one() -> None:
    plane, tilted, weightless = (load(f"arm_{name}") for name in ("in_plane", "tilted", "weightless"))
    assert plane.robot == weightless.robot
    shoulder, elbow = tilted.robot.joints
    assert plane.robot.joints == (shoulder, dataclasses.replace(elbow, origin=None))
    assert elbow.origin is not None and elbow.origin.rpy == (math.radians(30), 0.0, 0.0)
    assert plane.robot.links == tilted.robot.links
    assert plane.trajectory == tilted.trajectory == weightless.trajectory
    assert plane.gravity == tilted.gravity == (0.0, -9.81, 0.0)
    assert weightless.gravity == (0.0, 0.0, 0.0)
    assert tilted.robot.base.rpy == (math.radians(30), 0.0, 0.0)


def test_seven_joints() -> None:
    scene = load("seven_joint_arm")
    assert scene.robot.convention == "modified" and len(scene.robot.joints) == 7
    assert all(dict(joint.forces).keys() == {"friction"} for joint in scene.robot.joints)
    assert sum(joint.rotor_inertia > 0.0 for joint in scene.robot.joints) == 4
    assert list(scene.trajectory.q) == [joint.name for joint in scene.robot.joints]


@pytest.mark.parametrize("name", ["seven_joint_arm", "arm_in_plane"])
def test_inertias_can_be_those_of_bodies(name: str) -> None:
    for link in load(name).robot.links:
        i = link.inertia
        tensor = np.array([[i.xx, i.xy, i.xz], [i.xy, i.yy, i.yz], [i.xz, i.yz, i.zz]], dtype=float)
        low, middle, high = np.linalg.eigvalsh(tensor)
        assert low > 0.0 and low + middle > high, link.name


def test_the_scene_layer_reads_yaml_and_nothing_heavy() -> None:
    code = (
        "import sys\n"
        "from robodyn_cli import scene\n"
        "assert 'yaml' not in sys.modules and 'numpy' not in sys.modules\n"
        f"scene.load_scene({str(SCENES[0])!r})\n"
        "heavy = {'scipy', 'h5py', 'matplotlib', 'llvmlite', 'typer', 'difflib'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=CONFIGS.parent)


def test_unknown_attribute_of_the_package() -> None:
    from robodyn_cli import scene

    with pytest.raises(AttributeError, match="nothing"):
        _ = scene.nothing
    assert scene.Scene is Scene
    assert issubclass(SceneError, Exception)
