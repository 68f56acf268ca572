"""``robodyn import``: a URDF as readable YAML that gives the same robot, and never over another file."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import yaml

from robodyn_cli.scene.descriptions import load_description
from robodyn_cli.scene.load import load_scene, load_scene_text
from robodyn_cli.scene.text.yaml_text import MAX_BYTES
from tests.cli.tool import invoke
from tests.unit.test_urdf import ARM, INERTIA, LIMIT, MASS, joint
from tests.urdf_robots import random_urdf

SHAPE = '<visual><geometry><mesh filename="package://arm/meshes/a.stl"/></geometry></visual>'


def write(tmp_path: Path, text: str = ARM) -> Path:
    path = tmp_path / "arm.urdf"
    path.write_text(text, encoding="utf-8")
    return path


def test_the_robot_in_yaml_is_that_of_the_urdf(tmp_path: Path) -> None:
    path = write(tmp_path)
    done = invoke("import", path, tmp_path / "mine.yaml")
    assert done.code == 0 and "3 links, 2 joints that move. In a scene: robot: mine.yaml" in done.out
    assert "massless links: base" in done.err
    scene = load_scene_text("schema: 1\ngravity: [0, 0, 0]\nrobot: mine.yaml\n", str(tmp_path / "scene.yaml"))
    assert scene.robot == load_description(path)[1].robot
    text = (tmp_path / "mine.yaml").read_text(encoding="utf-8")
    assert text.startswith("# arm, from arm.urdf by `robodyn import`.")
    assert text.count("#") >= 6 and all(len(line) <= 115 for line in text.splitlines())
    assert "  # in the URDF: 'base'\n  # massless: no <inertial>\n  - {name: base_2, mass: 0}\n" in text


@pytest.mark.parametrize("seed", range(5))
def test_random_robots(seed: int, tmp_path: Path) -> None:
    """Every digit survives, mimics too."""
    path = write(tmp_path, random_urdf(np.random.default_rng(seed), 9, mimic=seed % 2 == 0))
    assert invoke("import", path, "-q").code == 0
    (tmp_path / "scene.yaml").write_text("schema: 1\ngravity: [0, 0, 0]\nrobot: arm.yaml\n")
    there = load_scene(tmp_path / "scene.yaml")
    given = load_description(path)[1]
    assert there.robot == given.robot and there.couplers == given.couplers


def test_never_over_another_file(tmp_path: Path) -> None:
    path = write(tmp_path)
    (tmp_path / "arm.yaml").write_text("mine")
    done = invoke("import", path)
    assert done.code == 74 and "arm.yaml exists already" in done.err
    assert (tmp_path / "arm.yaml").read_text() == "mine" and sorted(os.listdir(tmp_path)) == [
        "arm.urdf",
        "arm.yaml",
    ]
    assert invoke("import", path, tmp_path / "none" / "arm.yaml").code == 74


def test_names_in_the_file_stay_in_their_comment(tmp_path: Path) -> None:
    """Line ends of any kind in a name do not end a comment."""
    path = write(
        tmp_path,
        ARM.replace('name="arm"', 'name="a&#10;b: [&#x85;c&#x2028;d"').replace('"base"', '"b&#10;- x"'),
    )
    assert invoke("import", path).code == 0
    (tmp_path / "scene.yaml").write_text("schema: 1\ngravity: [0, 0, 0]\nrobot: arm.yaml\n")
    assert [link.name for link in load_scene(tmp_path / "scene.yaml").robot.links] == [
        "b___x",
        "upper",
        "lower",
    ]


def test_meshes_and_packages(tmp_path: Path) -> None:
    urdf = ARM.replace(f'<link name="lower">{MASS}', f'<link name="lower">{MASS}{SHAPE}')
    path = write(tmp_path, urdf)
    done = invoke("import", path, tmp_path / "a.yaml")
    assert (
        done.code == 0 and "a mesh is not there" in done.err and ":8: package://arm/meshes/a.stl" in done.err
    )
    (tmp_path / "stl" / "meshes").mkdir(parents=True)
    (tmp_path / "stl" / "meshes" / "a.stl").write_text("solid")
    done = invoke("import", path, tmp_path / "b.yaml", "--package", f"arm={tmp_path / 'stl'}")
    assert done.code == 0 and "mesh is" not in done.err
    for wrong in ("arm", "=x", f"arm={tmp_path / 'none'}"):
        done = invoke("import", path, tmp_path / "c.yaml", "--package", wrong)
        assert done.code == 2 and "NAME=DIR" in done.err and not (tmp_path / "c.yaml").exists()


def test_strict(tmp_path: Path) -> None:
    heavy = ARM.replace(
        "</robot>", joint("f", "lower", "camera", "fixed", "") + f'<link name="camera">{SHAPE}</link></robot>'
    )
    for urdf, words in (
        (heavy, "have a shape but no mass"),
        (ARM.replace(INERTIA, INERTIA.replace('izz="0.1"', 'izz="0.9"'), 1), "triangle inequality"),
    ):
        path = write(tmp_path, urdf)
        done = invoke("import", path, "--strict")
        assert done.code == 2 and words in done.err and not (tmp_path / "arm.yaml").exists()
        done = invoke("import", path)
        assert done.code == 0 and f"robodyn: warning: {path if urdf is heavy else 'upper'}" in done.err
        (tmp_path / "arm.yaml").unlink()


def test_what_cannot_be_read(tmp_path: Path) -> None:
    for name, text, words in (
        ("arm.yaml", "joints: []\n", "this is no URDF, SDF or MJCF"),
        ("arm.urdf", ARM.replace(LIMIT, '<limit lower="a"/>', 1), ":5:"),
        ("large.urdf", ARM + " " * MAX_BYTES, "larger than 10 MB"),
    ):
        (tmp_path / name).write_text(text)
        done = invoke("import", tmp_path / name, tmp_path / "out.yaml")
        assert (
            done.code == 2 and words in done.err and name in done.err and not (tmp_path / "out.yaml").exists()
        )
    done = invoke("import", tmp_path / "none.urdf")
    assert done.code == 2 and "there is no such file" in done.err


def test_a_file_that_is_not_there_is_named_once(tmp_path: Path) -> None:
    done = invoke("import", str(tmp_path / "none.urdf"))
    assert done.code == 2
    assert done.err == f"robodyn: error: {tmp_path / 'none.urdf'}: cannot be read: there is no such file\n"


def test_an_mjcf(tmp_path: Path) -> None:
    """What is left out is told, and the YAML has a chain of links for a body with several joints."""
    pytest.importorskip("mujoco")
    inertial = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
    (tmp_path / "arm.xml").write_text(
        f"""<mujoco model="arm"><worldbody><body name="a"><joint name="x" type="slide" axis="1 0 0"/><joint name="y" ref="10"/>{inertial}
        </body></worldbody><equality><connect body1="a" anchor="0 0 1"/></equality><sensor/></mujoco>"""
    )
    done = invoke("import", tmp_path / "arm.xml")
    assert done.code == 0 and "2 links, 2 joints that move" in done.out + done.err
    assert "left out: solref and solimp" in done.err and "1 <sensor>" in done.err
    robot = yaml.safe_load((tmp_path / "arm.yaml").read_text())
    assert [joint["type"] for joint in robot["joints"]] == ["prismatic", "revolute"]
    assert robot["loops"][0]["name"] == "connect1"
